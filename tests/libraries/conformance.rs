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
        let printed = abbe(folder.path(), &["plugin", "check", &file.to_string_lossy()]);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        assert_eq!(printed.stdout.matches("PASS").count(), 11, "{}", printed.stdout);
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
    ];
    for (mode, test, expected) in cases {
        let folder = temporary();
        let library = bad(folder.path(), "bad", &[&format!("-DMODE=\"{mode}\"")]);
        let limit = if mode == "hang" { "1" } else { "60" };
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
