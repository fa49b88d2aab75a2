//! A browser that is driven as a user drives it: it loads a page, gets clicks, keys and windows, and says what it sees. It listens
//! on a pipe (Chrome DevTools Protocol), so that no port is open.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use serde_json::{Value, json};
use tempfile::TempDir;

/// How long an answer may take.
const LONGEST: Duration = Duration::from_secs(300);

/// A browser with one page.
pub struct Driver {
    browser: Child,
    commands: ChildStdin,
    answers: Receiver<Value>,
    session: Option<String>,
    number: u64,
    events: Vec<Value>,
    _profile: TempDir,
}

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.browser.kill();
        let _ = self.browser.wait();
    }
}

impl Driver {
    /// Starts a browser.
    pub fn start(browser: &str, more: &[&str]) -> Self {
        let profile = tempfile::tempdir().expect("a folder");
        let mut command = Command::new("sh");
        // The browser listens on 3 and answers on 4.
        command.args(["-c", "exec \"$@\" 3<&0 4>&1 </dev/null >/dev/null", "sh", browser]);
        command.args(["--headless", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe", "--no-first-run"]);
        command.args(["--disable-background-networking", "--disable-component-update", "--disable-sync"]);
        command.args(["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]);
        command.arg("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1").args(more);
        command.arg(format!("--user-data-dir={}", profile.path().display()));
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut browser = command.spawn().expect("it starts");
        let (commands, told) = (browser.stdin.take().expect("a pipe"), browser.stdout.take().expect("a pipe"));
        let (sender, answers) = channel();
        std::thread::spawn(move || {
            for text in BufReader::new(told).split(0) {
                let Ok(text) = text else { break };
                let Ok(answer) = serde_json::from_slice(&text) else { break };
                if sender.send(answer).is_err() {
                    break;
                }
            }
        });
        let (session, number, events) = (None, 0, Vec::new());
        let mut driver = Self { browser, commands, answers, session, number, events, _profile: profile };
        let page = driver.ask("Target.createTarget", json!({ "url": "about:blank" }))["targetId"].clone();
        let session =
            driver.ask("Target.attachToTarget", json!({ "targetId": page, "flatten": true }))["sessionId"].clone();
        driver.session = session.as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log", "Network"] {
            driver.ask(&format!("{domain}.enable"), json!({}));
        }
        driver
    }

    fn receive(&self) -> Value {
        self.answers.recv_timeout(LONGEST).expect("the browser answers")
    }

    /// Sends a command and gives its result.
    pub fn ask(&mut self, method: &str, parameters: Value) -> Value {
        self.number += 1;
        let mut command = json!({ "id": self.number, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            command["sessionId"] = json!(session);
        }
        let text = command.to_string() + "\0";
        self.commands.write_all(text.as_bytes()).and_then(|()| self.commands.flush()).expect("the browser listens");
        loop {
            let answer = self.receive();
            if answer["id"] == json!(self.number) {
                assert!(answer.get("error").is_none(), "{method}: {answer}");
                return answer["result"].clone();
            }
            self.events.push(answer);
        }
    }

    /// Shows a page in a window of this size, and waits until it is there.
    pub fn open(&mut self, page: &Path, size: [u32; 2], is_dark: bool) {
        self.go(&format!("file://{}", page.display()), size, is_dark);
    }

    /// Shows what an address has in a window of this size, and waits until it is there.
    pub fn go(&mut self, address: &str, [width, height]: [u32; 2], is_dark: bool) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.ask("Emulation.setDeviceMetricsOverride", size);
        let scheme = if is_dark { "dark" } else { "light" };
        let wanted = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.ask("Emulation.setEmulatedMedia", wanted);
        self.events.clear();
        self.ask("Page.navigate", json!({ "url": address }));
        self.loaded();
    }

    /// Forgets what happened, before something leads to another page.
    pub fn forget(&mut self) {
        self.events.clear();
    }

    /// Waits until a page is there.
    pub fn loaded(&mut self) {
        while !self.events.iter().any(|event| event["method"] == "Page.loadEventFired") {
            let event = self.receive();
            self.events.push(event);
        }
        self.rest();
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.ask("Runtime.evaluate", asked);
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// The text of an expression.
    pub fn text(&mut self, expression: &str) -> String {
        let value = self.value(expression);
        value.as_str().unwrap_or_else(|| panic!("{expression}: {value} is no text")).to_owned()
    }

    /// Waits until what changed is drawn.
    pub fn rest(&mut self) {
        self.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))");
    }

    /// Moves a slider, or chooses from a list, as its event says.
    pub fn set(&mut self, selector: &str, value: &str) {
        let [selector, value] = [selector, value].map(|text| json!(text));
        self.value(&format!(
            "(() => {{ const it = document.querySelector({selector}); it.value = {value}; it.dispatchEvent(new Event('input')); }})()"
        ));
        self.rest();
    }

    /// Clicks at a place of the window.
    pub fn click(&mut self, [x, y]: [f64; 2]) {
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 });
            self.ask("Input.dispatchMouseEvent", event);
        }
        self.rest();
    }

    /// Presses a key: its name and its number.
    pub fn press(&mut self, key: &str, number: u32) {
        let text = if key == "Enter" { "\r" } else { "" };
        for kind in ["keyDown", "keyUp"] {
            let mut event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": number });
            if kind == "keyDown" && !text.is_empty() {
                event["text"] = json!(text);
            }
            self.ask("Input.dispatchKeyEvent", event);
        }
        self.rest();
    }

    /// The picture of the first viewer.
    pub fn picture(&mut self) -> String {
        self.rest();
        self.text("document.querySelector('.viewer canvas').toDataURL()")
    }

    /// What the page said to the console since it was opened, and what it asked for beside itself.
    pub fn complaints(&self) -> Vec<String> {
        self.complaints_but("file:")
    }

    /// The same, where addresses that begin so are its own.
    pub fn complaints_but(&self, own: &str) -> Vec<String> {
        let said = |event: &&Value| {
            let text = event["params"]["entry"]["text"].as_str().unwrap_or_default();
            match event["method"].as_str().unwrap_or_default() {
                "Runtime.exceptionThrown" | "Runtime.consoleAPICalled" => true,
                // A driver without a graphics card tells how slow it is; that is none of the page.
                "Log.entryAdded" => !text.contains("GL Driver Message"),
                "Network.requestWillBeSent" => {
                    let url = event["params"]["request"]["url"].as_str().unwrap_or_default();
                    !url.starts_with(own)
                }
                _ => false,
            }
        };
        self.events.iter().filter(said).map(Value::to_string).collect()
    }
}
