//! Pages about runs in a real browser without a display: what the console says, what is asked of the network, what stands in the
//! page, what is printed.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{as_typed, read, recipes, root, skipped, temporary, write};

/// Names of the browser.
const BROWSERS: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Whom the browser asks for itself.
const MAKER: [&str; 2] = ["google.com", "googleapis.com"];

pub fn answers(program: &str, arguments: &[&str]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|output| output.status.success())
}

/// The browser; none, and the test is skipped, without one.
pub fn browser(test: &str) -> Option<&'static str> {
    let found = BROWSERS.into_iter().find(|name| answers(name, &["--version"]));
    if found.is_none() {
        skipped(test, "there is no browser (Debian: apt-get install chromium)");
    }
    found
}

/// What root has to say: the sandbox needs another user.
pub fn for_root() -> &'static [&'static str] {
    if answers("sh", &["-c", "test \"$(id -u)\" = 0"]) { &["--no-sandbox"] } else { &[] }
}

/// What the browser said of a page: its elements, the lines of its console, the addresses that were asked for.
struct Seen {
    dom: String,
    console: Vec<String>,
    asked: Vec<String>,
}

fn see(browser: &str, page: &Path, fragment: &str, more: &[String]) -> Seen {
    let folder = temporary();
    let log = folder.path().join("net.json");
    let mut command = Command::new(browser);
    command.args(["--headless", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr", "--v=0"]);
    // Nothing leaves the computer: names have no addresses. The browser itself asks its maker all the same.
    command.arg("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1");
    command.args(["--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"]);
    command.args(["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]);
    command.arg("--virtual-time-budget=4000");
    command.arg(format!("--user-data-dir={}", folder.path().join("profile").display()));
    command.arg(format!("--log-net-log={}", log.display()));
    command.args(for_root());
    if more.is_empty() {
        command.arg("--dump-dom");
    }
    let output = command.args(more).arg(format!("file://{}{fragment}", page.display())).output().expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    // A driver without a graphics card tells how slow it is; that is none of the page.
    let of_page = |line: &&str| line.contains("CONSOLE") && !line.contains("GL Driver Message");
    let console = said.lines().filter(of_page).map(str::to_owned).collect();
    // Addresses of requests; names of the log's own constants have none.
    let text = read(&log);
    let asked = text.split("\"url\":\"").skip(1).filter_map(|rest| rest.split('"').next()).map(str::to_owned);
    let is_own = |url: &String| MAKER.iter().any(|host| url.split('/').nth(2).is_some_and(|name| name.ends_with(host)));
    let asked = asked.filter(|url| url.contains("://") && !url.starts_with("file:") && !is_own(url)).collect();
    Seen { dom: String::from_utf8_lossy(&output.stdout).into_owned(), console, asked }
}

pub fn page_of(name: &str, out: &Path) -> PathBuf {
    let file = recipes()[name].clone();
    let arguments = ["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()];
    let printed = as_typed(&root(), &arguments);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    out.join(name).join("report.html")
}

#[test]
fn a_page_says_nothing_to_the_console_and_asks_for_nothing() {
    let Some(browser) = browser("a_page_says_nothing_to_the_console_and_asks_for_nothing") else { return };
    let out = temporary();
    for name in ["tango-hu40t", "cylinder-kx8"] {
        let page = page_of(name, out.path());
        let seen = see(browser, &page, "", &[]);
        assert_eq!(seen.console, [""; 0], "{name}");
        assert_eq!(seen.asked, [""; 0], "{name}");
        assert!(seen.dom.contains("<section id=\"verdict\">"), "{name}");
    }
}

/// A point is picked by its address, as by a click on a row of the largest residuals: file, line and residual are told.
#[test]
fn a_picked_point_says_where_it_was_read() {
    let test = "a_picked_point_says_where_it_was_read";
    let Some(browser) = browser(test) else { return };
    let out = temporary();
    let page = page_of("first-steps", out.path());
    let seen = see(browser, &page, "#point-1-3", &[]);
    assert_eq!(seen.console, [""; 0]);
    if seen.dom.contains("id=\"viewer-1\" hidden") {
        return skipped(test, "the browser has no WebGL 2");
    }
    let said = seen.dom.split("<output data-part=\"picked\" aria-live=\"polite\">").nth(1).expect("the output");
    let said = said.split("</output>").next().expect("its end");
    // The fourth residual is that of the fourth row of the table.
    let table = read(&page.with_file_name("fit.residuals.csv"));
    let cells: Vec<&str> = table.lines().nth(4).expect("a row").split(',').collect();
    let expected = format!("{}:{} (row {}), {}: residual ", cells[1], cells[2], cells[3], cells[0]);
    assert!(said.starts_with(&expected), "{said}, not {expected}");
    let told: f64 = said[expected.len()..].split(' ').next().and_then(|number| number.parse().ok()).expect("a number");
    let residual: f64 = cells[4].parse().expect("a number");
    assert!((told - residual).abs() <= 1e-3 * residual.abs(), "{told}, not {residual}");
}

/// The two tests above can fail: a script that is not the page's own is refused and told, and so is an image from elsewhere.
#[test]
fn what_does_not_belong_into_a_page_is_refused() {
    let Some(browser) = browser("what_does_not_belong_into_a_page_is_refused") else { return };
    let out = temporary();
    let page = page_of("first-steps", out.path());
    let other = out.path().join("other.html");
    let hostile = "<script>document.title = 'taken';</script><img src=\"http://127.0.0.1:9/x.png\"></main>";
    write(&other, &read(&page).replace("</main>", hostile));
    let seen = see(browser, &other, "", &[]);
    assert!(seen.console.iter().any(|line| line.contains("script")), "{:?}", seen.console);
    assert!(seen.console.iter().any(|line| line.contains("x.png")), "{:?}", seen.console);
    assert!(!seen.dom.contains("<title>taken</title>"));
    assert_eq!(seen.asked, [""; 0]);
    // Without its policy the page would ask.
    write(&other, &read(&other).replace("Content-Security-Policy", "X-Other"));
    let seen = see(browser, &other, "", &[]);
    assert!(seen.asked.iter().any(|url| url.contains("x.png")), "{:?}", seen.asked);
}

#[test]
fn paper_has_all_parts() {
    let Some(browser) = browser("paper_has_all_parts") else { return };
    let out = temporary();
    let page = page_of("first-steps", out.path());
    let paper = out.path().join("page.pdf");
    let arguments = ["--no-pdf-header-footer".to_owned(), format!("--print-to-pdf={}", paper.display())];
    see(browser, &page, "", &arguments);
    let printed = std::fs::read(&paper).expect("a PDF");
    let text = String::from_utf8_lossy(&printed);
    assert!(text.starts_with("%PDF-"));
    let sheets = text.matches("/Type /Page\n").count() + text.matches("/Type/Page\n").count();
    assert!((3..40).contains(&sheets), "{sheets} sheets");
    // A4 in points.
    assert!(text.contains("/MediaBox [0 0 594.9") || text.contains("/MediaBox [0 0 595"), "no A4");
}
