//! A page as PDF, printed by a browser that is installed.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use abbe_core::{Error, Result};

use crate::children;
use crate::interrupt::{self, TemporaryFolder};

/// The variable with the browser's program, and names that are tried without it.
const VARIABLE: &str = "ABBE_BROWSER";
const NAMES: [&str; 6] =
    ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge", "msedge"];

/// How long printing may take.
const LONGEST: Duration = Duration::from_secs(120);

/// Largest text that is told of a browser that fails.
const SAID: u64 = 4000;

/// What a browser prints of a page. It runs without a display, without a network and with a profile of its own.
///
/// Fails without a browser, or where it fails or takes too long.
pub fn pdf(page: &str) -> Result<Vec<u8>> {
    let failed = |error: std::io::Error| Error::data(format!("the page cannot be printed: {error}"));
    let folder = TemporaryFolder::new().map_err(failed)?;
    let [source, paper, profile, log] =
        ["page.html", "page.pdf", "profile", "log"].map(|name| folder.path().join(name));
    std::fs::File::create(&source).and_then(|mut file| file.write_all(page.as_bytes())).map_err(failed)?;
    let name = program()?;
    let mut command = Command::new(&name);
    command.args([
        "--headless",
        "--disable-gpu",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-sync",
    ]);
    command.args(["--disable-component-update", "--disable-extensions", "--host-resolver-rules=MAP * ~NOTFOUND"]);
    command.args(["--no-pdf-header-footer", "--run-all-compositor-stages-before-draw", "--virtual-time-budget=4000"]);
    if is_root(folder.path()) {
        // Its sandbox needs a user that is not root. The page allows no script but its own.
        command.arg("--no-sandbox");
    }
    command.arg(format!("--user-data-dir={}", profile.display()));
    command.arg(format!("--print-to-pdf={}", paper.display()));
    command.arg(format!("file://{}", source.display()));
    // What it keeps elsewhere than in its profile goes with the folder, too.
    command.env("TMPDIR", folder.path());
    children::apart(&mut command);
    let told = std::fs::File::create(&log).map_err(failed)?;
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(told);
    let mut browser = command
        .spawn()
        .map_err(|error| Error::usage(format!("the browser `{name}` does not start: {error}")).help(help()))?;
    let began = Instant::now();
    let status = loop {
        if let Some(status) = browser.try_wait().map_err(failed)? {
            break status;
        }
        if interrupt::happened() {
            children::end(&mut browser);
            return Err(Error::interrupted());
        }
        if began.elapsed() > LONGEST {
            children::end(&mut browser);
            let seconds = LONGEST.as_secs();
            return Err(Error::data(format!("the browser `{name}` did not print the page within {seconds} s")));
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    match std::fs::read(&paper) {
        Ok(printed) if status.success() && printed.starts_with(b"%PDF-") => Ok(printed),
        _ => {
            let mut said = String::new();
            let _ = std::fs::File::open(&log).and_then(|file| file.take(SAID).read_to_string(&mut said));
            let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it says nothing");
            Err(Error::data(format!("the browser `{name}` printed no page ({status}): {last}")).help(help()))
        }
    }
}

fn help() -> String {
    format!("install Chromium (Debian: `apt-get install chromium`), or name a browser of its kind in {VARIABLE}")
}

/// The browser.
fn program() -> Result<String> {
    if let Some(name) = std::env::var(VARIABLE).ok().filter(|name| !name.is_empty()) {
        return Ok(name);
    }
    let mut why = None;
    for name in NAMES {
        match Command::new(name).arg("--version").stdin(Stdio::null()).output() {
            Ok(answer) if answer.status.success() => return Ok(name.to_owned()),
            Ok(answer) => why = why.or_else(|| Some(format!("`{name}` does not start here ({})", answer.status))),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => why = why.or_else(|| Some(format!("`{name}` does not start here: {error}"))),
        }
    }
    // What is installed may not start where processes, files or memory are limited.
    let why = why.unwrap_or_else(|| "there is no browser that prints the page as PDF".to_owned());
    Err(Error::usage(why).help(help()))
}

/// Whether a folder that was just made belongs to root.
#[cfg(unix)]
fn is_root(folder: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    folder.metadata().is_ok_and(|metadata| metadata.uid() == 0)
}

#[cfg(not(unix))]
fn is_root(_: &Path) -> bool {
    false
}
