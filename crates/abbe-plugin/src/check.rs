//! The conformance tests: whether a library keeps the rules for plugins.
//!
//! Every test runs in a process of its own with a time limit, so that a crash or a hang is a result like any other.

mod promises;
mod stages;
mod work;

use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use abbe_core::{Error, Result, harmless};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::loader::{Library, hashed, load_sealed, open_library};
use crate::sandbox::{Allowance, confine};
use crate::threads::too_many;

/// A test: its name, what it asks for, and how.
struct Test {
    name: &'static str,
    requires: &'static str,
    run: fn(&Library, &mut Findings),
}

const TESTS: [Test; 13] = [
    Test { name: "abi", requires: "the library loads and speaks this version of the interface", run: |_, _| {} },
    Test {
        name: "names",
        requires: "names, versions and descriptions are in order and taken by nobody",
        run: promises::names,
    },
    Test {
        name: "settings",
        requires: "the example builds, unknown and wrong settings are refused",
        run: promises::settings,
    },
    Test {
        name: "derivatives",
        requires: "machines keep the laws: derivatives, poses alone and together, names",
        run: promises::derivatives,
    },
    Test {
        name: "estimators",
        requires: "estimators find the errors of a virtual machine, whatever the order and the origin",
        run: promises::estimators,
    },
    Test { name: "not-a-number", requires: "numbers that are none do no harm", run: promises::not_a_number },
    Test { name: "no-data", requires: "data that are none are refused or used, without a bug", run: stages::no_data },
    Test { name: "computes", requires: "machines move with commands and with parameters", run: work::computes },
    Test { name: "twice", requires: "two stages at once are possible and independent", run: work::twice },
    Test { name: "empty-batch", requires: "no poses give no poses", run: promises::empty_batch },
    Test { name: "threads", requires: "many threads at once get the same answers", run: promises::threads },
    Test { name: "leaks", requires: "10,000 calls leave no memory behind", run: promises::leaks },
    Test {
        name: "surroundings",
        requires: "floating-point state and working directory stay as they are",
        run: promises::surroundings,
    },
];

/// What a test found.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Findings {
    /// What is wrong.
    pub wrong: Vec<String>,
    /// What was not tested.
    pub skipped: Vec<String>,
}

impl Findings {
    /// The findings as the last line that a test prints.
    pub fn line(&self) -> Result<String> {
        let line = serde_json::to_string(self);
        line.map(|line| format!("\n{line}\n"))
            .map_err(|error| Error::data(format!("findings cannot be written: {error}")))
    }

    fn wrong(&mut self, what: impl Into<String>) {
        self.wrong.push(what.into());
    }

    fn skip(&mut self, what: impl Into<String>) {
        self.skipped.push(what.into());
    }
}

/// How long the tests may take.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// One test.
    pub of_test: Duration,
    /// All tests together.
    pub total: Duration,
}

impl Limits {
    fn total_is_over(&self) -> String {
        format!("no end within {} s for all tests together", self.total.as_secs_f64())
    }
}

/// The results of all tests of a library.
pub struct Report {
    file: String,
    results: Vec<(&'static Test, Findings)>,
}

impl Report {
    /// Whether nothing is wrong.
    pub fn passes(&self) -> bool {
        self.results.iter().all(|(_, findings)| findings.wrong.is_empty())
    }

    /// The report as text, one line for every test.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n", self.file);
        for (test, findings) in &self.results {
            let result = if findings.wrong.is_empty() { "PASS" } else { "FAIL" };
            text.push_str(&format!("  {result}  {:<13}{}\n", test.name, test.requires));
            findings.wrong.iter().for_each(|what| text.push_str(&format!("        {what}\n")));
            findings.skipped.iter().for_each(|what| text.push_str(&format!("        not looked at: {what}\n")));
        }
        let failed = self.results.iter().filter(|(_, findings)| !findings.wrong.is_empty()).count();
        text.push_str(&match failed {
            0 => "The library keeps to all of it.\n".to_owned(),
            1 => "1 test failed.\n".to_owned(),
            more => format!("{more} tests failed.\n"),
        });
        text
    }

    /// The report as JSON.
    pub fn json(&self) -> Value {
        let results = self.results.iter().map(|(test, findings)| {
            json!({ "test": test.name, "asks": test.requires, "pass": findings.wrong.is_empty(), "wrong": findings.wrong,
                    "skipped": findings.skipped })
        });
        json!({ "library": self.file, "pass": self.passes(), "tests": results.collect::<Vec<_>>() })
    }
}

/// The test that runs over a recipe, where there is one.
const RECIPE: Test = Test {
    name: "recipe",
    requires: "what the recipe uses keeps the laws, on data that a virtual machine makes",
    run: |_, _| {},
};

/// Runs all tests of a library; `program` is started as `program plugin test FILE NAME` and calls [`test()`]. With a recipe it is
/// started once more, with `--recipe RECIPE`, to run the laws over that. What has not ended after the time of `limits` has failed.
pub fn check(file: &Path, program: &Path, limits: Limits, recipe: Option<&Path>) -> Result<Report> {
    open_library(file)?;
    let started = Instant::now();
    let mut report = Report { file: file.display().to_string(), results: Vec::new() };
    for test in TESTS.iter().chain(recipe.map(|_| &RECIPE)) {
        let mut arguments = vec![file.as_os_str(), test.name.as_ref()];
        if let Some(recipe) = recipe.filter(|_| test.name == RECIPE.name) {
            arguments.extend(["--recipe".as_ref(), recipe.as_os_str()]);
        }
        let left = limits.total.saturating_sub(started.elapsed());
        let findings = match left.is_zero() {
            true => Findings { wrong: vec![format!("not run: {}", limits.total_is_over())], ..Findings::default() },
            false => apart(program, &arguments, limits.of_test.min(left), limits)?,
        };
        let loads = test.name != "abi" || findings.wrong.is_empty();
        report.results.push((test, findings));
        if !loads {
            break;
        }
    }
    Ok(report)
}

/// Bytes that are kept of what a test says, from its end.
const KEPT: usize = 1 << 20;

/// What a process says while it works: the end of it, as much as is kept.
struct Said(JoinHandle<Vec<u8>>);

impl Said {
    fn by(from: Option<impl Read + Send + 'static>, kept: usize) -> Self {
        Self(std::thread::spawn(move || {
            let (mut bytes, mut more) = (Vec::new(), vec![0; 1 << 16]);
            let Some(mut from) = from else { return bytes };
            while let Ok(length @ 1..) = from.read(&mut more) {
                bytes.extend_from_slice(&more[..length]);
                if bytes.len() > 2 * kept {
                    bytes.drain(..bytes.len() - kept);
                }
            }
            bytes
        }))
    }

    /// The text after the end of the process; nothing if another process still holds its output.
    fn text(self) -> String {
        for _ in 0..100 {
            if self.0.is_finished() {
                return String::from_utf8_lossy(&self.0.join().unwrap_or_default()).into_owned();
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        String::new()
    }
}

/// Whether the system ended a process for a call that is refused ([`Allowance::is_on_trial`]).
fn is_refused(status: ExitStatus) -> bool {
    #[cfg(target_os = "linux")]
    return std::os::unix::process::ExitStatusExt::signal(&status) == Some(libc::SIGSYS);
    #[cfg(not(target_os = "linux"))]
    {
        let _ = status;
        false
    }
}

/// One test in a process of its own.
fn apart(program: &Path, arguments: &[&OsStr], limit: Duration, limits: Limits) -> Result<Findings> {
    let test = arguments[1].display();
    let failed = |error: std::io::Error| Error::data(format!("the test `{test}` cannot be run: {error}"));
    let mut command = Command::new(program);
    command.args(["plugin", "test"]).args(arguments).stdin(Stdio::null());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(failed)?;
    let (out, err) = (child.stdout.take(), child.stderr.take());
    let (out, err) = (Said::by(out, KEPT), Said::by(err, KEPT));
    let started = Instant::now();
    let mut findings = Findings::default();
    let status = loop {
        match child.try_wait().map_err(failed)? {
            Some(status) => break Some(status),
            None if started.elapsed() > limit => {
                child.kill().map_err(failed)?;
                child.wait().map_err(failed)?;
                break None;
            }
            None => match too_many(child.id()) {
                Some(wrong) => {
                    child.kill().map_err(failed)?;
                    child.wait().map_err(failed)?;
                    findings.wrong(format!("{wrong}; its process was ended"));
                    return Ok(findings);
                }
                None => std::thread::sleep(Duration::from_millis(5)),
            },
        }
    };
    let Some(status) = status else {
        findings.wrong(match limit < limits.of_test {
            true => limits.total_is_over(),
            false => format!("no end within {} s", limit.as_secs_f64()),
        });
        return Ok(findings);
    };
    let text = out.text();
    // The findings are the last line; there is nothing before it unless the library prints.
    let mut lines = text.lines().rev();
    match lines.next().and_then(|line| serde_json::from_str::<Findings>(line).ok()) {
        Some(mut found) if status.success() => {
            if let Some(said) = lines.find(|line| !line.trim().is_empty()) {
                found.wrong(format!("writes to standard output, which is not the library's: {}", harmless(said)));
            }
            Ok(found)
        }
        _ => {
            if is_refused(status) {
                findings.wrong(
                    "does what a plugin must not do (writing files, network, processes, signals): the system ended its process",
                );
                return Ok(findings);
            }
            let said = err.text();
            let said = said.trim().lines().map(str::trim).collect::<Vec<_>>().join(" ");
            findings.wrong(format!("the process ended with {status}{}{said}", if said.is_empty() { "" } else { ": " }));
            Ok(findings)
        }
    }
}

/// Runs one test in this process; gives its findings as a line of JSON.
pub fn test(file: &Path, name: &str) -> Result<String> {
    let test = TESTS.iter().find(|test| test.name == name);
    let test = test.ok_or_else(|| Error::usage(format!("there is no test `{name}`")))?;
    let mut findings = Findings::default();
    let directory = std::env::current_dir().ok();
    let confined = hashed(file, None).and_then(|hashed| hashed.sealed(file)).and_then(|sealed| {
        // A test looks at the memory of its process.
        let allowance = Allowance { may_read: vec!["/proc/self".into()], is_on_trial: true, ..Allowance::default() };
        confine(&allowance).map_err(|what| Error::data(format!("a test cannot be confined: {what}")))?;
        load_sealed(file, sealed)
    });
    match confined {
        Ok(library) => (test.run)(&library, &mut findings),
        Err(error) => findings.wrong(error.to_string()),
    }
    if std::env::current_dir().ok() != directory {
        findings.wrong("the working directory is another one than before");
    }
    findings.line()
}
