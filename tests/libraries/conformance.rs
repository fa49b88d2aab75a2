//! The conformance tests on the examples and on faulty libraries.

use serde_json::Value;

use super::{bad, c_library, cargo_library};
use crate::support::{abbe, temporary};

#[test]
fn the_conformance_kit_passes_the_examples() {
    let folder = temporary();
    let files = [
        c_library(folder.path(), "plugins/vendor-three-axis-c/three_axis.c", "threeaxis", &[]),
        cargo_library("abbe-vendor-hexapod"),
        cargo_library("abbe-vendor-nutating-head"),
    ];
    for file in files {
        let file = file.to_string_lossy();
        let limits = ["--time-limit", "600", "--total-time-limit", "3600"];
        let printed = abbe(folder.path(), &[&["plugin", "check", &*file][..], &limits].concat());
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        assert_eq!(printed.stdout.matches("PASS").count(), 13, "{}", printed.stdout);
    }
}

#[test]
fn the_conformance_kit_finds_what_is_wrong() {
    let cases = [
        ("slope", "derivatives", "the derivative of the position to EXX[1] is off by"),
        ("random", "threads", "answers on 8 threads differ"),
        ("leak", "leaks", "poses: 10,000 of them leave"),
        ("rounding", "surroundings", "the floating-point state of the thread was changed"),
        ("directory", "surroundings", "changes the working directory"),
        ("hang", "empty-batch", "no end within 1 s"),
        ("abort", "threads", "signal: 6 (SIGABRT)"),
        ("orientation", "derivatives", "gave orientations that are no unit quaternions"),
        ("nan", "derivatives", "gave positions that are not finite numbers"),
        ("zeros", "computes", "computes nothing: the tip is at the same place for all commands"),
        ("stubborn", "computes", "no parameter changes any position"),
        ("once", "twice", "cannot be created a second time: there is one already"),
        ("stdout", "computes", "writes to standard output, which is not the library's"),
    ];
    for (mode, test, expected) in cases {
        let folder = temporary();
        let library = bad(folder.path(), "bad", &[&format!("-DMODE=\"{mode}\"")]);
        let limit = if mode == "hang" { "1" } else { "600" };
        let arguments =
            ["plugin", "check", &library.to_string_lossy(), "--time-limit", limit, "--json"].map(str::to_owned);
        let printed = abbe(folder.path(), &arguments);
        assert_eq!(printed.status, 1, "{mode}: {}{}", printed.stdout, printed.stderr);
        let report: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        let tests = report["tests"].as_array().expect("tests");
        let found = tests.iter().find(|found| found["test"] == test).expect("the test was run");
        assert!(found.to_string().contains(expected), "{mode}: {report:#}");
    }
}

/// A library that tries what no plugin needs is found out, and gets neither files nor processes.
#[test]
#[cfg(target_os = "linux")]
fn the_conformance_kit_finds_who_writes_files_or_starts_processes() {
    for mode in ["write", "truncate", "fork", "exec", "network", "signal", "shared-memory"] {
        let folder = temporary();
        let library = bad(folder.path(), "bad", &[&format!("-DMODE=\"{mode}\"")]);
        let printed = abbe(folder.path(), &["plugin", "check", &library.to_string_lossy()]);
        assert_eq!(printed.status, 1, "{mode}: {}", printed.stdout);
        assert!(printed.stdout.contains("does what a plugin must not do"), "{mode}: {}", printed.stdout);
        assert!(!folder.path().join("written-by-a-plugin").exists(), "{mode}");
    }
}

/// Endless output, endless work and much memory end the tests of the kit, and take nothing from the machine. The shell bounds all of it.
#[test]
#[cfg(target_os = "linux")]
fn the_conformance_kit_ends_whatever_a_library_does() {
    let kit = |mode: &str, limits: &[&str]| {
        let folder = temporary();
        let library = bad(folder.path(), "bad", &[&format!("-DMODE=\"{mode}\"")]);
        let mut shell = std::process::Command::new("bash");
        shell.args(["-c", "ulimit -t 60; ulimit -v 3000000; ulimit -f 1000; exec \"$0\" \"$@\""]);
        shell.arg(env!("CARGO_BIN_EXE_abbe-under-test")).args(["plugin", "check"]).arg(library).args(limits);
        let output = shell.current_dir(folder.path()).output().expect("a shell starts");
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.stdout.len() < 100_000, "{mode}: {} bytes", output.stdout.len());
        (output.status.code(), said)
    };
    let (status, said) = kit("flood-stdout", &["--time-limit", "1"]);
    assert!(status == Some(1) && said.contains("no end within 1 s"), "{said}");
    let (status, said) = kit("hang", &["--total-time-limit", "2"]);
    assert!(status == Some(1) && said.contains("no end within 2 s for all tests together"), "{said}");
    assert!(said.contains("not run"), "{said}");
    // It does not get the memory, and does without.
    let (status, said) = kit("memory", &[]);
    assert_eq!(status, Some(0), "{said}");
}
