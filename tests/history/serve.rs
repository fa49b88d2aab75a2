//! `abbe serve`: pages of a history over a socket. It answers what it should, refuses the rest, and goes on.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::kept::results;
use crate::support::{Small, abbe, program, read, root, temporary, write};

/// How long a test waits for an answer.
const LONGEST: Duration = Duration::from_secs(300);

/// A server that ends with the test.
pub struct Served {
    process: Child,
    pub address: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// What came back.
struct Response {
    status: u16,
    head: String,
    body: String,
}

impl Served {
    /// Starts a server for a history on a free port.
    pub fn start(at: &Path, history: &str) -> Self {
        let mut command = program(at, &["serve", history, "--listen", "127.0.0.1:0"]);
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("it starts");
        let mut line = String::new();
        let out = process.stdout.take().expect("an output");
        BufReader::new(out).read_line(&mut line).expect("a line");
        let address = line.strip_prefix("http://").and_then(|rest| rest.split('/').next()).expect("an address");
        Self { address: address.to_owned(), process }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.address).expect("it listens");
        stream.set_read_timeout(Some(LONGEST)).and_then(|()| stream.set_write_timeout(Some(LONGEST))).expect("times");
        stream
    }

    /// What comes back for bytes.
    fn raw(&self, bytes: &[u8]) -> Response {
        let mut stream = self.connect();
        // A refusal may come, and the connection end, before all is sent.
        let _ = stream.write_all(bytes);
        let mut all = Vec::new();
        let _ = stream.read_to_end(&mut all);
        let text = String::from_utf8_lossy(&all).into_owned();
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Response { status, head: head.to_lowercase(), body: body.to_owned() }
    }

    fn request(&self, method: &str, path: &str, more: &str) -> Response {
        let host = &self.address;
        self.raw(format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n").as_bytes())
    }

    /// The page at a path, which has to be there.
    pub fn page(&self, path: &str) -> String {
        let response = self.get(path);
        assert_eq!(response.status, 200, "{path}: {}", response.head);
        response.body
    }

    fn get(&self, path: &str) -> Response {
        self.request("GET", path, "")
    }

    fn is_alive(&self) {
        assert_eq!(self.get("/").status, 200, "it does not answer any more");
    }
}

/// A small history with one entry, and its server.
fn small() -> (Small, Served) {
    let small = Small::new();
    let all = results(&small, 1);
    assert_eq!(small.abbe(&["history", "add", "plant.sqlite", &all[0], "--machine", "mill 7"]).status, 0);
    let served = Served::start(&small.path(""), "plant.sqlite");
    (small, served)
}

/// The history of the recipe with forty weeks, in a folder.
pub fn forty_weeks(folder: &Path) {
    let out = folder.join("out").to_string_lossy().into_owned();
    let (plant, results) = (folder.join("plant.sqlite"), folder.join("out/history"));
    assert_eq!(abbe(&root(), &["run", "pipelines/history.yaml", "--out", &out]).status, 0);
    let added = abbe(folder, &["history".as_ref(), "add".as_ref(), plant.as_os_str(), results.as_os_str()]);
    assert_eq!(added.status, 0, "{}", added.stderr);
}

#[test]
fn pages_show_machines_trends_and_reports() {
    let folder = temporary();
    forty_weeks(folder.path());
    let served = Served::start(folder.path(), "plant.sqlite");
    let first = served.get("/");
    assert_eq!(first.status, 200);
    let link = |page: &str, start: &str| {
        let from = page.find(&format!("href=\"{start}")).unwrap_or_else(|| panic!("no link to {start}")) + 6;
        page[from..].split('"').next().expect("its end").replace("&amp;", "&")
    };
    let machine = served.get(&link(&first.body, "/machine?name="));
    assert!(machine.status == 200 && machine.body.contains("Chart another estimate"), "{}", machine.body.len());
    let of_weeks = served.get(&(link(&first.body, "/machine?name=") + "&estimate=weekly&baseline=baseline"));
    for told in ["jump in week 23: EY0C", "week 14 is rejected", "Control chart of EXX[b]", ">Alarm<"] {
        assert!(of_weeks.body.contains(told), "{told}");
    }
    let entry = served.get("/entry/1");
    for told in ["40 calibrations", "/entry/1/weekly.week-14", "href=\"#verdict\"", "EC0Y"] {
        assert!(entry.status == 200 && entry.body.contains(told), "{told}");
    }
    let one = served.get("/entry/1/weekly.week-14");
    assert!(one.status == 200 && one.body.contains("week 14"), "{}", one.head);
    let file = served.get("/entry/1/weekly.week-14.calibration.json");
    assert!(file.head.contains("application/json"), "{}", file.head);
    assert_eq!(file.body, read(&folder.path().join("out/history/weekly.week-14.calibration.json")));
}

#[test]
fn only_this_computer_is_listened_to() {
    let small = Small::new();
    let all = results(&small, 1);
    assert_eq!(small.abbe(&["history", "add", "plant.sqlite", &all[0]]).status, 0);
    for address in ["0.0.0.0:8321", "[::]:0", "192.0.2.1:80", "plant.example:80", "8321"] {
        let refused = small.abbe(&["serve", "plant.sqlite", "--listen", address]);
        assert!(refused.status == 2 && refused.stderr.contains("127.0.0.1:8321"), "{address}: {}", refused.stderr);
    }
    assert_eq!(small.abbe(&["serve", "absent.sqlite"]).status, 2);
}

/// Nobody would know at which port.
#[cfg(target_os = "linux")]
#[test]
fn an_address_that_cannot_be_told_is_an_error() {
    let (small, served) = small();
    drop(served);
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("a full disk");
    let mut command = program(small.folder.path(), &["serve", "plant.sqlite", "--listen", "127.0.0.1:0"]);
    let process = command.stdin(Stdio::null()).stdout(full).stderr(Stdio::null()).spawn().expect("it starts");
    let mut ended = Served { process, address: String::new() };
    let begun = Instant::now();
    while ended.process.try_wait().expect("a process").is_none() && begun.elapsed() < LONGEST {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(ended.process.try_wait().expect("a process").and_then(|status| status.code()), Some(1));
}

#[test]
fn nothing_can_be_written_and_no_file_can_be_named() {
    let (small, served) = small();
    let before = std::fs::read(small.path("plant.sqlite")).expect("a file");
    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "PROPFIND", "BREW"] {
        let refused = served.request(method, if method == "CONNECT" { &served.address } else { "/" }, "");
        assert_eq!(refused.status, 405, "{method}: {}", refused.head);
        assert!(refused.head.contains("allow: get, head"), "{}", refused.head);
    }
    for path in [
        "/../plant.sqlite",
        "/..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/entry/../../etc/passwd",
        "/entry/1/../../../etc/passwd",
        "/entry/1/..%2f..%2fplant.sqlite",
        "/entry/1/%00",
        "/plant.sqlite",
        "//etc/passwd",
        "/entry/-1",
        "/entry/99999999999999999999",
        "/entry/1;drop",
        "/machine?name=../../etc/passwd",
        "/machine?name=%27%20OR%201=1--",
        "/machine",
    ] {
        let refused = served.get(path);
        assert_eq!(refused.status, 404, "{path}");
        assert!(!refused.body.contains("root:") && !refused.body.contains("SQLite format"), "{path}");
    }
    let head = served.request("HEAD", "/", "");
    assert!(head.status == 200 && head.body.is_empty(), "{}", head.body);
    assert_eq!(std::fs::read(small.path("plant.sqlite")).expect("a file"), before);
    served.is_alive();
}

#[test]
fn headers_keep_pages_to_themselves() {
    let (_small, served) = small();
    let page = served.get("/");
    for header in [
        "x-content-type-options: nosniff",
        "x-frame-options: deny",
        "referrer-policy: no-referrer",
        "cache-control: no-store",
        "content-security-policy: frame-ancestors 'none'",
    ] {
        assert!(page.head.contains(header), "{header}: {}", page.head);
    }
    assert!(!page.head.contains("access-control") && page.body.contains("default-src 'none'"));
    // A page from elsewhere whose name was made to mean this computer names itself.
    for host in ["evil.example", "127.0.0.1.evil.example:8321", "192.0.2.1"] {
        let refused = served.raw(format!("GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes());
        assert!(refused.status == 403 && !refused.body.contains("mill 7"), "{host}: {}", refused.head);
    }
    let refused = served.raw(b"GET / HTTP/1.1\r\nConnection: close\r\n\r\n");
    assert_eq!(refused.status, 403, "{}", refused.head);
    let refused = served.raw(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    assert_eq!(refused.status, 403, "{}", refused.head);
}

#[test]
fn requests_that_are_too_large_or_wrong_are_refused() {
    let (_small, served) = small();
    let long = "a".repeat(5000);
    assert_eq!(served.get(&format!("/{long}")).status, 414);
    assert_eq!(served.get(&format!("/machine?name={long}")).status, 414);
    let huge = "a".repeat(100_000);
    assert!([414, 431].contains(&served.get(&format!("/{huge}")).status));
    assert_eq!(served.request("GET", "/", &format!("X: {huge}\r\n")).status, 431);
    let many: String = (0..200).map(|number| format!("X-{number}: 1\r\n")).collect();
    assert_eq!(served.request("GET", "/", &many).status, 431);
    for body in ["Content-Length: 5\r\n", "Content-Length: 99999999999\r\n", "Transfer-Encoding: chunked\r\n"] {
        assert_eq!(served.request("GET", "/", body).status, 413, "{body}");
    }
    for wrong in [
        "GET / HTTP/9.9\r\n\r\n",
        "GET\r\n\r\n",
        "\x16\x03\x01\x02\x00\x01\x00\x01\u{fc}\x03\x03 a greeting of TLS\r\n\r\n",
        "GET / HTTP/1.1\r\nHost 127.0.0.1\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: -1\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
        "GET /\0 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        "GET http://[ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        "GET /%zz HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n",
        "GET /%ff HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n",
    ] {
        let refused = served.raw(wrong.as_bytes());
        assert!(refused.status == 400 || refused.status == 0, "{wrong:?}: {}", refused.head);
    }
    served.is_alive();
}

/// Clients that send nothing, or one letter after the other, lose their connection; others are served meanwhile.
#[test]
fn slow_clients_hold_nobody_up() {
    let (_small, served) = small();
    let mut silent: Vec<TcpStream> = (0..20).map(|_| served.connect()).collect();
    for (number, stream) in silent.iter_mut().enumerate() {
        let _ = stream.write_all(&b"GET / HTTP/1.1\r\nHost: 127"[..number]);
    }
    served.is_alive();
    // Each is ended by the server: reading comes to an end, long before the test gives up.
    let begun = Instant::now();
    for stream in &mut silent {
        let mut rest = Vec::new();
        let ended = stream.read_to_end(&mut rest);
        let is_over = matches!(&ended, Err(error) if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut));
        assert!(!is_over, "{ended:?}");
    }
    assert!(begun.elapsed() < LONGEST);
    // More than there is room for: the rest are turned away, and room comes back.
    let crowd: Vec<TcpStream> = (0..100).map(|_| served.connect()).collect();
    drop(crowd);
    let mut answered = false;
    for _ in 0..100 {
        answered = answered || served.get("/").status == 200;
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(answered);
}

/// Names come from whoever adds results: they are text on every page.
#[test]
fn names_become_no_markup() {
    let small = Small::new();
    let name = "<script>document.title='taken'</script><img src=x onerror=alert(1)>\"'&";
    let recipe = small.read("recipe.yaml").replace("name: Eight facets", &format!("name: {:?}", name));
    small.write("recipe.yaml", &recipe);
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "out"]).status, 0);
    let file = small.path("out/recipe/run.json");
    write(&file, &read(&file).replace("\"recipe\": \"recipe\"", &format!("\"recipe\": {name:?}")));
    assert_eq!(small.abbe(&["history", "add", "plant.sqlite", "out/recipe", "--machine", name]).status, 0);
    let served = Served::start(&small.path(""), "plant.sqlite");
    let encoded: String = name.bytes().map(|byte| format!("%{byte:02X}")).collect();
    for path in [
        "/",
        "/entry/1",
        "/entry/1/fine",
        &format!("/machine?name={encoded}"),
        &format!("/machine?name={encoded}&estimate={encoded}&baseline={encoded}"),
    ] {
        let page = served.get(path);
        assert_eq!(page.status, 200, "{path}");
        assert!(page.body.contains("&lt;script&gt;document"), "{path}");
        assert!(!page.body.contains("<script>document") && !page.body.contains("<img"), "{path}");
    }
}
