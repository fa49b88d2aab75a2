//! Programs and set-points without anything to correct.

use crate::compensation::calibration;
use crate::support::{abbe, read, temporary, write};

/// A file that was cut off, or another one, is not corrected to nothing.
#[test]
fn nothing_is_no_program() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("fit.calibration.json"), &calibration("three-axis").to_string());
    let compensate = |dialect: &str, text: &str, more: &[&str]| {
        write(&at.join("part.nc"), text);
        let fixed = ["compensate", "fit.calibration.json", "part.nc", "--dialect", dialect];
        abbe(at, &[&fixed, more].concat())
    };
    let empty = ["", "\n\n \n\t\r\n", "%\n%\n"];
    for (dialect, own) in [
        ("linuxcnc", &["(a comment)\n; another\n"][..]),
        ("iso", &["(a comment)\n", "%\nO1000 (part)\n%\n"]),
        ("fanuc", &["(a comment)\n\n", "O1000 (part)\n"]),
        ("siemens", &["; a comment\n\n"]),
        ("heidenhain", &["; a comment\n", "BEGIN PGM A MM\nEND PGM A MM\n"]),
        ("grbl", &["(a comment)\n; another"]),
    ] {
        // `%` frames programs of ISO alone.
        let framed = dialect != "heidenhain";
        for text in own.iter().chain(empty.iter().filter(|text| framed || !text.contains('%'))) {
            for more in [&["--out", "new.nc"][..], &["--out", "new.nc", "--check"], &[]] {
                let found = compensate(dialect, text, more);
                let says = found.stderr.contains("no block") && found.stderr.contains("part.nc");
                assert!(found.status == 1 && says, "{dialect} {text:?}: {}{}", found.stdout, found.stderr);
                assert!(!at.join("new.nc").exists());
            }
        }
    }
    // A block that does nothing is one, and so is one that a switch leaves out.
    for (dialect, text) in [
        ("linuxcnc", "M2\n"),
        ("iso", "N10\nG21\n"),
        ("fanuc", "/ G0 X0.\n"),
        ("heidenhain", "BEGIN PGM A MM\nSTOP\nEND PGM A MM\n"),
    ] {
        let _ = std::fs::remove_file(at.join("new.nc"));
        let found = compensate(dialect, text, &["--out", "new.nc", "--block-delete", "on"]);
        if dialect == "fanuc" || found.status == 0 {
            assert_eq!(found.status, 0, "{dialect}: {}", found.stderr);
            let written = read(&at.join("new.nc"));
            assert!(text.lines().all(|line| written.contains(line)), "{dialect}: {written}");
        } else {
            assert!(!found.stderr.contains("no block"), "{dialect}: {}", found.stderr);
        }
    }
}

#[test]
fn nothing_is_no_set_point() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("fit.calibration.json"), &calibration("three-axis").to_string());
    for text in ["", "\n\n", "X_mm,Y_mm,Z_mm\n", "X_mm,Y_mm,Z_mm\n\n\n"] {
        write(&at.join("points.csv"), text);
        for command in ["compensate", "correct"] {
            let found = abbe(at, &[command, "fit.calibration.json", "points.csv", "--out", "new.csv"]);
            assert!(found.status != 0 && found.stderr.contains("points.csv"), "{command} {text:?}: {}", found.stderr);
            assert!(!at.join("new.csv").exists());
        }
    }
}
