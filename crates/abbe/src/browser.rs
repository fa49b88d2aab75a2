//! A page as PDF, printed by a browser that is installed.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
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

/// How long a browser may take to tell its version.
const LONGEST_ANSWER: Duration = Duration::from_secs(10);

/// Largest text that is told of a browser that fails.
const SAID: u64 = 4000;

/// What a browser prints of a page. It runs without a display, without a network and with a profile of its own.
///
/// Fails without a browser, or where it fails or takes too long.
pub fn pdf(page: &str) -> Result<Vec<u8>> {
    let failed = |error: std::io::Error| Error::data(format!("the page cannot be printed: {error}"));
    let folder = TemporaryFolder::new().map_err(interrupt::no_temporary_file)?;
    let [source, paper, profile, log] =
        ["page.html", "page.pdf", "profile", "log"].map(|name| folder.path().join(name));
    std::fs::File::create(&source)
        .and_then(|mut file| file.write_all(page.as_bytes()))
        .map_err(interrupt::no_temporary_file)?;
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
    let told = std::fs::File::create(&log).map_err(interrupt::no_temporary_file)?;
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(told);
    let mut browser = command
        .spawn()
        .map_err(|error| Error::usage(format!("the browser `{name}` does not start: {error}")).help(help()))?;
    let status = match ended_within(&mut browser, LONGEST).map_err(failed)? {
        Some(status) => status,
        None if interrupt::happened() => return Err(Error::interrupted()),
        None => {
            let seconds = LONGEST.as_secs();
            return Err(Error::data(format!("the browser `{name}` did not print the page within {seconds} s")));
        }
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

/// How a program ended; none if it did not within this time, or until a signal came. Then it is ended.
fn ended_within(program: &mut Child, longest: Duration) -> std::io::Result<Option<ExitStatus>> {
    let began = Instant::now();
    while !interrupt::happened() && began.elapsed() <= longest {
        if let Some(status) = program.try_wait()? {
            return Ok(Some(status));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    children::end(program);
    Ok(None)
}

fn help() -> String {
    format!("install Chromium (Debian: `apt-get install chromium`), or name a browser of its kind in {VARIABLE}")
}

/// How a browser ended that was asked for its version; none if it did not.
fn version_asked(name: &str) -> std::io::Result<Option<ExitStatus>> {
    let mut command = Command::new(name);
    children::apart(&mut command);
    command.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    ended_within(&mut command.spawn()?, LONGEST_ANSWER)
}

/// The browser.
fn program() -> Result<String> {
    if let Some(name) = std::env::var(VARIABLE).ok().filter(|name| !name.is_empty()) {
        return Ok(name);
    }
    let mut why = None;
    for name in NAMES {
        match version_asked(name) {
            Ok(Some(status)) if status.success() => return Ok(name.to_owned()),
            Ok(Some(status)) => why = why.or_else(|| Some(format!("`{name}` does not start here ({status})"))),
            Ok(None) if interrupt::happened() => return Err(Error::interrupted()),
            Ok(None) => why = why.or_else(|| Some(format!("`{name}` does not answer here"))),
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
