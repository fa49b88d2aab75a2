//! The Python package: it is put together from what is built, and its tests and doctests are run.
//!
//! The extension module is one more library of the workspace, built with what the other tests are built with: only
//! its own code is compiled for it. `pip install ./python` builds it by maturin, with the release profile.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::gate::FEATURES;
use crate::{Outcome, cargo, root, run as run_command};

/// The Python that the package needs.
const OLDEST: &str = "import sys; assert sys.version_info >= (3, 11)";

/// What no test can do without.
const NEEDED: &str = "import numpy, pytest";

/// What tests found.
#[derive(Debug, Default, PartialEq)]
pub struct Found {
    pub passed: usize,
    pub failed: usize,
    /// Tests that were skipped, with the reasons.
    pub skipped: Vec<String>,
}

/// Builds the package with this Cargo and runs its tests; skipped, with a word, where Python is absent.
pub fn tests(cargo: impl Fn(&[&str]) -> Command) -> Result<Found, String> {
    let skipped = |why: &str| Ok(Found { skipped: vec![format!("python: {why}")], ..Found::default() });
    if !succeeds(OLDEST) {
        return skipped("there is no Python 3.11 or later");
    }
    if !succeeds(NEEDED) {
        return skipped("numpy and pytest are not installed");
    }
    // With a test, because tests ask for more features of some libraries: without one all would be built once more.
    let build = ["build", "--workspace", "--lib", "--test", "whole", "--locked"];
    run_command(cargo(&[&build[..], &FEATURES].concat()))?;
    let package = put_together().map_err(|error| format!("the Python package cannot be put together: {error}"))?;
    let mut pytest = python();
    pytest.args([
        "-m",
        "pytest",
        "-q",
        "-rs",
        "-p",
        "no:cacheprovider",
        "-c",
        "python/pyproject.toml",
        "--rootdir",
        ".",
    ]);
    pytest.arg("python/tests").arg(&package).arg("docs/python.md").current_dir(root());
    println!("$ {pytest:?}");
    let output = pytest.stderr(Stdio::inherit()).output().map_err(|error| format!("pytest cannot be run: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}");
    let found = found(&text);
    match (output.status.success(), found.passed) {
        (true, 1..) => Ok(found),
        _ => Err(format!("the tests of the Python package: {} failed, {}", found.failed, output.status)),
    }
}

/// Runs the tests and prints what was skipped.
pub fn run() -> Outcome {
    let found = tests(cargo)?;
    found.skipped.iter().for_each(|what| println!("skipped: {what}"));
    Ok(())
}

/// Python with the libraries that `.ci/run` installs, and the package.
fn python() -> Command {
    let mut command = Command::new("python3");
    let own = [folder(), root().join("target/python-tests")];
    let others = std::env::var_os("PYTHONPATH").unwrap_or_default();
    let all = own.into_iter().chain(std::env::split_paths(&others));
    command.env("PYTHONPATH", std::env::join_paths(all).unwrap_or(others));
    // What Python compiles is kept, and not beside the sources: libraries that are compiled for every test take minutes.
    command.env("PYTHONPYCACHEPREFIX", root().join("target/python-cache")).env_remove("PYTHONDONTWRITEBYTECODE");
    command
}

fn succeeds(program: &str) -> bool {
    let status = python().args(["-c", program]).stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}

fn folder() -> PathBuf {
    root().join("target/python-package")
}

/// The folder of the package with the library in it.
fn put_together() -> std::io::Result<PathBuf> {
    let package = folder().join("abbe");
    if package.exists() {
        fs::remove_dir_all(&package)?;
    }
    fs::create_dir_all(&package)?;
    for file in fs::read_dir(root().join("python/abbe"))? {
        let file = file?.path();
        if file.is_file() {
            fs::copy(&file, package.join(file.file_name().unwrap_or_default()))?;
        }
    }
    let (library, module) = if cfg!(windows) {
        ("_abbe.dll", "_abbe.pyd")
    } else if cfg!(target_os = "macos") {
        ("lib_abbe.dylib", "_abbe.abi3.so")
    } else {
        ("lib_abbe.so", "_abbe.abi3.so")
    };
    fs::copy(built().join(library), package.join(module))?;
    Ok(package)
}

/// Where Cargo puts what it builds: this program stands there.
fn built() -> PathBuf {
    let this = std::env::current_exe().ok();
    this.as_deref().and_then(Path::parent).map_or_else(|| root().join("target/debug"), Path::to_owned)
}

/// What the last lines of pytest say.
fn found(text: &str) -> Found {
    let mut found = Found::default();
    for line in text.lines() {
        found.skipped.extend(line.strip_prefix("SKIPPED ").map(|what| format!("python {what}")));
    }
    let last = text.lines().rev().find(|line| line.contains(" in ")).unwrap_or_default();
    for part in last.trim_matches(['=', ' ']).split(", ") {
        let mut words = part.split_whitespace();
        let (number, what) = (words.next().and_then(|number| number.parse().ok()), words.next());
        match (number, what) {
            (Some(number), Some("passed")) => found.passed = number,
            (Some(number), Some("failed" | "error" | "errors")) => found.failed += number,
            _ => {}
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_pytest_says_is_counted() {
        let text =
            "...s.F\nSKIPPED [1] python/tests/a.py:3: no polars\n2 failed, 54 passed, 1 skipped, 1 error in 6.7s\n";
        let skipped = vec!["python [1] python/tests/a.py:3: no polars".to_owned()];
        assert_eq!(found(text), Found { passed: 54, failed: 3, skipped });
        assert_eq!(found("61 passed in 20.11s (0:00:20)").passed, 61);
        assert_eq!(found("no tests ran in 0.01s"), Found::default());
    }
}
