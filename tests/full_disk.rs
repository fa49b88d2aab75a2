//! A disk that is full: old files stay whole, or new ones are whole.

#![cfg(target_os = "linux")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::fleet::plant::{Plant, ok, quiet};
use crate::support::{Small, program, skipped, tree};

/// KiB that are free on the disk; the last ones are enough for everything.
const FREE: [u32; 10] = [0, 4, 12, 28, 60, 124, 252, 508, 1020, 8000];

/// Mounts a small disk at `disk` for itself alone, puts what `before` holds on it, leaves `free` KiB, and runs a command there. What is
/// on the disk then is copied to `after`.
const SCRIPT: &str = r#"
mount -t tmpfs -o size=16m none disk || exit 77
cp -a before/. disk/
dd if=/dev/zero of=disk/filler bs=4k 2>/dev/null
truncate -s "-${FREE}K" disk/filler
"$@"
status=$?
rm disk/filler
cp -a disk/. after/
exit $status
"#;

/// Runs a command in a mount namespace of its own, as root or as a user that is root in it; none, with the reason, where neither may be.
fn on_a_disk(small: &Small, free: u32, arguments: &[&str]) -> Result<Output, String> {
    let run = program(small.folder.path(), arguments);
    let mut why = String::new();
    for rights in ["-m", "-rm"] {
        let mut shell = Command::new("unshare");
        shell.args([rights, "sh", "-c", SCRIPT, "sh"]).arg(run.get_program()).args(run.get_args());
        let output = shell.env("FREE", free.to_string()).env("NO_COLOR", "1").current_dir(small.folder.path()).output();
        match output {
            Ok(output) if output.status.code().is_some_and(|status| status <= 3) && !is_refused(&output) => {
                return Ok(output);
            }
            Ok(output) => why = String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            Err(error) => why = format!("`unshare` cannot be started: {error}"),
        }
    }
    Err(format!("no disk can be mounted here: {why}"))
}

/// Whether no disk was mounted.
fn is_refused(output: &Output) -> bool {
    output.status.code() == Some(77) || output.stderr.starts_with(b"unshare:")
}

fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    tree(folder).into_iter().map(|file| (file.clone(), fs::read(folder.join(&file)).expect("a file"))).collect()
}

#[test]
fn what_does_not_fit_on_a_disk_leaves_what_was_there() {
    let small = Small::new();
    for folder in ["disk", "after"] {
        fs::create_dir(small.path(folder)).expect("a folder");
    }
    small.write("truth.json", "{ \"parameters\": {} }");
    // Of an earlier run of the recipe as it was; the other files are replaced where a command may.
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "before"]).status, 0);
    small.write("before/recipe.yaml", &small.read("recipe.yaml").replace("data/", "../data/"));
    small.write("before/recipe.expected", "format 1\nrun = fail\n");
    assert_eq!(small.abbe(&["test", "before/recipe.yaml", "--junit", "before/test.xml"]).status, 1);
    assert_eq!(small.abbe(&["plugins", "--pages", "before/pages"]).status, 0);
    small.write("recipe.yaml", &small.read("recipe.yaml").replace("step_mm: 100", "step_mm: 50"));
    let plant = small.path("plant");
    Plant::of(3).write(&plant);
    ok(&quiet(&plant, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(&plant, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
    let merge = ["fleet", "merge", "fleet.manifest.jsonl", "--calibrations", "--out"];
    ok(&quiet(&plant, &[&merge[..], &["../before/tables"]].concat()));
    // Other tables: a machine fails.
    Plant::of(2).write(&plant);
    ok(&quiet(&plant, &["fleet", "plan", "fleet.yaml"]));
    let before = contents(&small.path("before"));

    let result = "before/recipe/fine.calibration.json";
    let commands: [&[&str]; 12] = [
        &["run", "recipe.yaml", "--out", "disk"],
        &["run", "recipe.yaml", "--out", "disk/new"],
        &["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "disk/simulated"],
        &["test", "disk/recipe.yaml", "--accept"],
        &["test", "disk/recipe.yaml", "--junit", "disk/test.xml", "--markdown", "disk/test.md"],
        &["report", "before/recipe", "--out", "disk/page.html"],
        &["report", result, "--out", "disk/table.csv"],
        &["plugins", "--pages", "disk/pages"],
        &["plugins", "--pages", "disk/new"],
        &["fleet", "merge", "plant/fleet.manifest.jsonl", "--calibrations", "--out", "disk/tables"],
        &["fleet", "merge", "plant/fleet.manifest.jsonl", "--calibrations", "--out", "disk/new"],
        &["history", "add", "disk/plant.sqlite", "before/recipe", "--date", "2026-01-02"],
    ];
    for (command, arguments) in commands.into_iter().enumerate() {
        let (mut failed, mut whole) = (0, None);
        // From the largest down: the first one shows what a whole result is. Each command has the ends, and every other one between.
        let is_taken = |size: usize| size == 0 || size == FREE.len() - 1 || (size + command).is_multiple_of(2);
        for free in (0..FREE.len()).rev().filter(|size| is_taken(*size)).map(|size| FREE[size]) {
            fs::remove_dir_all(small.path("after"))
                .and_then(|()| fs::create_dir(small.path("after")))
                .expect("a folder");
            let output = match on_a_disk(&small, free, arguments) {
                Ok(output) => output,
                Err(why) => return skipped("what_does_not_fit_on_a_disk_leaves_what_was_there", &why),
            };
            // Whole sentences are looked for.
            let words = |bytes: &Vec<u8>| String::from_utf8_lossy(bytes).replace('│', " ");
            let said = [&output.stdout, &output.stderr].map(words).concat();
            let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
            let after = contents(&small.path("after"));
            let told = format!("{arguments:?} with {free} KiB: {} {said}", output.status);
            assert!(!said.contains("panicked"), "{told}");
            let is_temporary =
                |file: &&PathBuf| file.components().any(|part| part.as_os_str().to_string_lossy().starts_with('.'));
            assert_eq!(after.keys().find(is_temporary), None, "{told}");
            let all: &BTreeMap<PathBuf, Vec<u8>> = whole.get_or_insert_with(|| after.clone());
            assert!(after.keys().all(|file| all.contains_key(file)), "{told}");
            let is_full = said.contains("the disk is full");
            if is_full {
                assert_eq!(output.status.code(), Some(1), "{told}");
                failed += 1;
                // Two files are written one by one; each is whole.
                if !arguments.contains(&"--markdown") {
                    assert_eq!(after, before, "{told}");
                }
            } else {
                assert_eq!(after.keys().collect::<Vec<_>>(), all.keys().collect::<Vec<_>>(), "{told}");
            }
            // Times differ from run to run, and the length of a file hardly.
            for (file, content) in &after {
                let of_all =
                    |there: Option<&Vec<u8>>| there.is_some_and(|there| there.len().abs_diff(content.len()) < 64);
                assert!(before.get(file) == Some(content) || of_all(all.get(file)), "{}: {told}", file.display());
            }
        }
        assert!(failed > 0, "{arguments:?} fits on a disk that is full");
    }
}
