//! Writing that goes wrong at any system call: what was there stays whole, or what is new is whole, and the message names a file.
//!
//! `tests/faults/inject.c` lets the n-th call that changes something in a folder fail. The gate tries some of the calls;
//! `ABBE_FAULTS=all` tries each (`cargo xtask campaign faults all`).

#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Small, program, root, skipped, tree, write};

const KINDS: [&str; 4] = ["ENOSPC", "EIO", "EINTR", "SHORT"];

/// Every call is tried up to this one, then one of `STRIDE`.
const FIRST: usize = 2;
const STRIDE: usize = 7;

/// What the system says of each error, in the words of the program or its own.
fn words(kind: &str) -> &'static [&'static str] {
    match kind {
        "ENOSPC" => &["the disk is full"],
        "EIO" => &["Input/output error"],
        _ => &["Interrupted system call"],
    }
}

/// A command with what it works on.
struct Case {
    name: &'static str,
    arguments: Vec<&'static str>,
    /// Whether contents of files are compared, or what `history list` tells.
    is_history: bool,
}

/// How a command ended, the name of the call that failed (none if there are fewer calls), and what it said.
struct Ended {
    status: Option<i32>,
    call: String,
    said: String,
}

fn injected(injector: &Path, folder: &Path, kind: &str, number: usize, arguments: &[&str]) -> Ended {
    let run = program(folder, arguments);
    let report = folder.join("report");
    let mut command = Command::new("bash");
    // Bounds on processor time and on the size of files.
    command.args(["-c", "ulimit -t 60; ulimit -f 200000; exec \"$0\" \"$@\""]).arg(injector);
    command.arg(folder.join("disk")).args([kind, &number.to_string()]).arg(&report);
    command.arg(run.get_program()).args(run.get_args()).current_dir(folder).env("NO_COLOR", "1");
    let output = command.output().expect("the injector starts");
    let said = [output.stdout, output.stderr].map(|said| String::from_utf8_lossy(&said).into_owned()).concat();
    // Long lines are folded between words.
    let said = said.replace(['│', '╰', '─'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
    Ended {
        status: output.status.code(),
        call: fs::read_to_string(&report).unwrap_or_default().trim().to_owned(),
        said,
    }
}

/// What is in a folder.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    tree(folder).into_iter().map(|file| (file.clone(), fs::read(folder.join(&file)).expect("a file"))).collect()
}

/// The same files, but for times of runs, which change the length hardly.
fn is_alike(one: &BTreeMap<PathBuf, Vec<u8>>, other: &BTreeMap<PathBuf, Vec<u8>>) -> bool {
    one.keys().eq(other.keys())
        && one.values().zip(other.values()).all(|(one, other)| one.len().abs_diff(other.len()) < 64)
}

fn copy(from: &Path, to: &Path) {
    let _ = fs::remove_dir_all(to);
    fs::create_dir_all(to).expect("a folder");
    for file in tree(from) {
        let place = to.join(&file);
        fs::create_dir_all(place.parent().expect("a folder")).expect("a folder");
        fs::copy(from.join(&file), place).expect("a copy");
    }
}

/// The folder `template`, as it is before each command, and the commands.
fn cases(small: &Small) -> Vec<Case> {
    fs::create_dir(small.path("template")).expect("a folder");
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "template"]).status, 0);
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "known"]).status, 0);
    let history = ["history", "add", "template/plant.sqlite", "known/recipe", "--date", "2026-01-02"];
    assert_eq!(small.abbe(&history).status, 0);
    assert_eq!(small.abbe(&["test", "recipe.yaml", "--accept"]).status, 0);
    write(&small.path("template/recipe.yaml"), &small.read("recipe.yaml").replace("data/", "../data/"));
    write(&small.path("template/recipe.expected"), "format 1\nrun = fail\n");
    small.write("truth.json", "{ \"parameters\": {} }");
    small.write("points.csv", "X_mm,Y_mm,Z_mm,B_deg,C_deg,dir_X\n0,0,300,0,0,1\n10,5,297,0,0,1\n20,9,295,0,0,1\n");
    small.write(
        "part.ngc",
        &"G21 G90 G17\nG0 X0 Y0 Z300 B0 C0\nG1 X10 F500\nG1 Y9 Z297\nM2\n".replace("M2", &"G1 X1\nG1 X2\n".repeat(400)),
    );
    small.write("recipe.yaml", &small.read("recipe.yaml").replace("step_mm: 100", "step_mm: 50"));
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "other"]).status, 0);
    let fine = "known/recipe/fine.calibration.json";
    let case = |name, arguments: &[&'static str]| Case { name, arguments: arguments.to_vec(), is_history: false };
    vec![
        case("run", &["run", "recipe.yaml", "--out", "disk"]),
        case("run to a new folder", &["run", "recipe.yaml", "--out", "disk/new"]),
        case(
            "simulate",
            &["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "disk/simulated"],
        ),
        case("test --accept", &["test", "disk/recipe.yaml", "--accept"]),
        case("report", &["report", "known/recipe", "--out", "disk/page.html"]),
        case("compensate set-points", &["compensate", fine, "points.csv", "--out", "disk/new.csv"]),
        case(
            "compensate a program",
            &["compensate", fine, "part.ngc", "--dialect", "linuxcnc", "--out", "disk/new.ngc"],
        ),
        Case {
            name: "history add",
            arguments: vec!["history", "add", "disk/plant.sqlite", "other/recipe", "--date", "2026-02-03"],
            is_history: true,
        },
    ]
}

/// What the history says of itself.
fn told(small: &Small) -> String {
    let printed = small.abbe(&["history", "list", "disk/plant.sqlite"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    printed.stdout
}

#[test]
fn writing_that_fails_at_any_call_leaves_old_results_or_new_ones() {
    const TEST: &str = "writing_that_fails_at_any_call_leaves_old_results_or_new_ones";
    let small = Small::new();
    let injector = small.path("inject");
    let built =
        Command::new("cc").arg("-O1").arg(root().join("tests/faults/inject.c")).arg("-o").arg(&injector).status();
    assert!(built.expect("the C compiler runs").success());
    let every = std::env::var_os("ABBE_FAULTS").is_some();
    let (mut runs, mut broken) = (0, Vec::new());
    for case in cases(&small) {
        copy(&small.path("template"), &small.path("disk"));
        let (before, old) = (contents(&small.path("disk")), told(&small));
        let ended = injected(&injector, small.folder.path(), "EIO", usize::MAX >> 1, &case.arguments);
        match ended.status {
            Some(77) => return skipped(TEST, "no process can be traced here"),
            status => assert!(matches!(status, Some(0 | 3)), "{}: {status:?} {}", case.name, ended.said),
        }
        let (whole, new) = (contents(&small.path("disk")), told(&small));
        let mut calls = 0;
        for kind in KINDS {
            let mut number = 1;
            loop {
                copy(&small.path("template"), &small.path("disk"));
                let found = injected(&injector, small.folder.path(), kind, number, &case.arguments);
                if found.call.is_empty() {
                    break;
                }
                runs += 1;
                calls = calls.max(number);
                let mut law = |holds: bool, what: &str| {
                    if !holds {
                        let Ended { status, call, said } = &found;
                        broken.push(format!(
                            "{}, {kind} at call {number} ({call}): {what}; {status:?} {said}",
                            case.name
                        ));
                    }
                };
                let after = contents(&small.path("disk"));
                let is_done = matches!(found.status, Some(0 | 3));
                // What SQLite cannot open may be a wrong file.
                let is_failure = found.status == Some(1) || (case.is_history && found.status == Some(2));
                law(is_done || is_failure, "another status");
                law(!found.said.contains("panicked"), "a panic");
                if case.is_history {
                    let now = told(&small);
                    law(
                        if is_done { now == new } else { now == old || now == new },
                        "the history is neither old nor new",
                    );
                } else {
                    // What could not be put in its place, or be removed, has a name of its own, and the message tells it.
                    let own = |file: &PathBuf| {
                        let mut parts = file.iter().map(|part| part.to_string_lossy().into_owned());
                        parts.find(|part| part.starts_with('.') || part.contains("-old-") || part.contains("-new-"))
                    };
                    let is_removal = found.call.starts_with("unlink") || found.call == "rmdir";
                    let is_told = |name: String| is_removal || found.said.contains(&name);
                    law(after.keys().filter_map(own).all(is_told), "something half-written stays");
                    let seen = after.into_iter().filter(|(file, _)| own(file).is_none()).collect();
                    let is_whole = is_alike(&seen, &whole);
                    law(if is_done { is_whole } else { is_whole || seen == before }, "results are neither old nor new");
                }
                if !is_done {
                    law(found.said.contains("disk"), "no file is named");
                    // SQLite has its own words, and few of them.
                    let of_database = ["disk I/O error", "unable to open", "cannot be written", "disk is full"];
                    let words = if case.is_history { &of_database[..] } else { words(kind) };
                    law(words.iter().any(|word| found.said.contains(word)), "the reason is not told");
                }
                number += if every || number < FIRST { 1 } else { STRIDE };
            }
        }
        println!("{}: {calls} calls", case.name);
    }
    println!("{runs} runs");
    assert!(runs > 50, "{runs}");
    assert!(broken.is_empty(), "{} of {runs}:\n{}", broken.len(), broken.join("\n"));
}
