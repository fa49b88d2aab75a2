//! A folder in which every command of the program works, with what it then writes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use crate::process::{Bounds, ended};
use crate::source::{Source, pipelines};

use super::snapshot::{self, Snapshot, snapshot};

/// A command with the files that it reads and writes.
pub struct Command {
    pub arguments: &'static [&'static str],
    pub reads: &'static [&'static str],
    pub writes: &'static [&'static str],
}

/// Every command that has files as arguments.
pub const COMMANDS: [Command; 12] = [
    Command {
        arguments: &["run", "first.yaml", "--out", "out"],
        reads: &["first.yaml", "touches.csv", "facets.csv", "machine.yaml"],
        writes: &["out"],
    },
    Command {
        arguments: &["run", "first.yaml", "--out", "out", "--json"],
        reads: &["first.yaml", "touches.csv"],
        writes: &["out"],
    },
    Command {
        arguments: &["check", "first.yaml"],
        reads: &["first.yaml", "touches.csv", "facets.csv", "machine.yaml"],
        writes: &[],
    },
    Command {
        arguments: &["test", "first.yaml", "--out", "tested", "--junit", "junit.xml", "--markdown", "summary.md"],
        reads: &["first.yaml", "first.expected", "touches.csv"],
        writes: &["tested", "junit.xml", "summary.md"],
    },
    Command {
        arguments: &["simulate", "first.yaml", "--truth", "truth.json", "--seed", "1", "--out", "simulated"],
        reads: &["first.yaml", "truth.json", "touches.csv", "machine.yaml"],
        writes: &["simulated"],
    },
    Command {
        arguments: &["plan", "design-2d.yaml", "--out", "planned"],
        reads: &["design-2d.yaml", "data/design-2d/candidates.csv"],
        writes: &["planned"],
    },
    Command {
        arguments: &[
            "compensate",
            "warm.calibration.json",
            "points.csv",
            "--log",
            "log.csv",
            "--at",
            "end",
            "--machine",
            "warm.yaml",
            "--out",
            "corrected.csv",
            "--report",
            "errors.csv",
        ],
        reads: &["warm.calibration.json", "points.csv", "log.csv", "warm.yaml"],
        writes: &["corrected.csv", "errors.csv"],
    },
    Command {
        arguments: &[
            "correct",
            "warm.calibration.json",
            "points.csv",
            "--log",
            "log.csv",
            "--at",
            "end",
            "--out",
            "measured.csv",
        ],
        reads: &["warm.calibration.json", "points.csv", "log.csv"],
        writes: &["measured.csv"],
    },
    Command {
        arguments: &["report", "kept/first", "--out", "page.html"],
        reads: &["kept/first/run.json", "kept/first/fit.calibration.json"],
        writes: &["page.html"],
    },
    Command {
        arguments: &["report", "kept/first", "first.calibration.json", "--out", "page.html"],
        reads: &["first.calibration.json", "kept/first/run.json"],
        writes: &["page.html"],
    },
    Command {
        arguments: &["run", "combine.yaml", "--out", "out"],
        reads: &["combine.yaml", "first.calibration.json", "second.calibration.json", "stated.csv"],
        writes: &["out"],
    },
    Command {
        arguments: &["run", "update.yaml", "--out", "out"],
        reads: &["update.yaml", "first.calibration.json", "touches.csv"],
        writes: &["out"],
    },
];

const COMBINE: &str = "abbe: 1
name: Two days and a report
stages:
  first:  { estimate: calibration, path: first.calibration.json }
  second: { estimate: calibration, path: second.calibration.json }
  laser:  { estimate: stated, machine: first, path: stated.csv }
  both:   { estimate: combine, of: [first, laser] }
  change: { validate: compare, of: [second, first] }
";

const UPDATE: &str = "
  first: { estimate: calibration, path: first.calibration.json }
  today:
    estimate: sequential
    machine: machine
    observations: [table]
    known: first
    parameters: [dxt, dyt, dzt, EA0B, \"table.*\"]
    shared_rows: accepted
    on_disagreement: warn
";

/// The folder, and what commands do in it.
pub struct Stock {
    pub files: Snapshot,
    /// By the place of the command: what it writes, and how long it takes, s.
    pub undisturbed: Vec<(Snapshot, f64)>,
    /// Recipes of the repository that run fast, with what they say when nothing is wrong.
    pub sources: Vec<Source>,
}

/// Recipes of the repository on which calibrations, numbers and texts are tried.
const RECIPES: [&str; 14] = [
    "first-steps",
    "positioner",
    "design-2d",
    "cmm-fifty-lengths",
    "rapid-verify-three-axis",
    "rapid-verify-five-axis",
    "cylinder-kx8-exact",
    "ballbar-c600u-exact",
    "before-the-cut",
    "tool-check",
    "mfb-ucp710-exact",
    "robot-ur5",
    "samba-exact",
    "thermal-spindle-exact",
];

impl Stock {
    /// Makes the folder; every command has to work in it, or nothing would be tried.
    pub fn new(program: &Path) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let folder = folder.path();
        write(folder);
        prepare(program, folder);
        let files = snapshot(folder);
        let undisturbed = COMMANDS.iter().map(|command| {
            let clock = Instant::now();
            run(program, folder, command.arguments);
            let seconds = clock.elapsed().as_secs_f64();
            let after = snapshot(folder);
            let lost = snapshot::lost(&files, &after);
            assert!(lost.is_empty(), "{:?} changes {lost:?}", command.arguments);
            let written: Snapshot = after.into_iter().filter(|(path, _)| !files.contains_key(path)).collect();
            command.writes.iter().map(|name| folder.join(name)).for_each(|path| remove(&path));
            (written, seconds)
        });
        let undisturbed = undisturbed.collect();
        Self { files, undisturbed, sources: RECIPES.into_iter().map(Source::read).collect() }
    }

    /// A copy of the folder.
    pub fn copy(&self) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a temporary folder");
        put(&self.files, folder.path());
        folder
    }
}

/// Writes what a snapshot has.
pub fn put(files: &Snapshot, folder: &Path) {
    for (path, entry) in files {
        let path = folder.join(path);
        match entry {
            snapshot::Entry::Folder => fs::create_dir_all(&path).expect("a folder"),
            snapshot::Entry::File(content) => {
                fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
                fs::write(&path, content).expect("a file");
            }
            other => panic!("{}: {other:?}", path.display()),
        }
    }
}

/// Removes whatever is there.
pub fn remove(path: &Path) {
    let is_folder = path.symlink_metadata().is_ok_and(|own| own.is_dir());
    let _ = if is_folder { fs::remove_dir_all(path) } else { fs::remove_file(path) };
}

fn run(program: &Path, folder: &Path, arguments: &[&str]) {
    let end = ended(program, folder, arguments, Bounds::default()).expect("it ends");
    assert!(matches!(end.status.code(), Some(0 | 3)), "{arguments:?}: {} {}", end.status, end.stderr);
}

fn write(folder: &Path) {
    let from = |path: &str| fs::read_to_string(pipelines().join(path)).expect("a file of the repository");
    let data = "data/tango-hu40t/realistic";
    let mut files: BTreeMap<&str, String> = BTreeMap::new();
    let first = from("first-steps.yaml").replace(&format!("{data}/"), "");
    let first = first.replace(
        "    chain: \"w C' B' X' b Z Y (S) t\"",
        "    file: machine.yaml\n    chain: \"w C' B' X' b Z Y (S) t\"",
    );
    files.insert("first.yaml", first.clone());
    files.insert("second.yaml", first.replace("standard_uncertainty_um: 1.6", "standard_uncertainty_um: 1.7"));
    for name in ["touches.csv", "facets.csv", "machine.yaml"] {
        files.insert(name, from(&format!("{data}/{name}")));
    }
    let stages = first.split("  fit:").next().expect("stages before the fit").to_owned();
    files.insert("update.yaml", stages + UPDATE.trim_start_matches('\n'));
    files.insert("combine.yaml", COMBINE.to_owned());
    files.insert("stated.csv", "parameter,value,unit,standard_uncertainty\nEA0B,-9,urad,4\n".to_owned());
    files.insert("truth.json", from("../tests/truth/tango-hu40t-realistic.json"));
    files.insert(
        "points.csv",
        "X_mm,Y_mm,Z_mm,B_deg,C_deg,S_deg\n10,20,330,0,0,0\n-50,100,400,10,45,0\n0,0,500,-20,90,0\n".to_owned(),
    );
    // A machine that follows two temperatures, without what makes the recipe slow.
    let warm = from("tango-warming.yaml").replace("data/tango-warming/", "");
    let warm = warm.split("  # The same without temperatures").next().expect("the first fit").to_owned();
    let warm = warm.replace(
        "\"@geometry\", \"@warming\", \"table.*\"",
        "\"@set-up\", \"@scales\", \"E??[1*T_scale]\", \"table.*\"",
    );
    files.insert(
        "warming.yaml",
        warm.replace("touches.csv,", "warm-touches.csv,")
            .replace("facets.csv", "warm-facets.csv")
            .replace("machine.yaml", "warm.yaml")
            .replace("temperatures.csv", "log.csv"),
    );
    for (name, own) in [
        ("warm-touches.csv", "touches.csv"),
        ("warm-facets.csv", "facets.csv"),
        ("warm.yaml", "machine.yaml"),
        ("log.csv", "temperatures.csv"),
        ("lengths.csv", "lengths.csv"),
    ] {
        files.insert(name, from(&format!("data/tango-warming/{own}")));
    }
    files.iter().for_each(|(name, text)| fs::write(folder.join(name), text).expect("a file"));
    Source::read("design-2d").write(folder);
}

/// Results that other commands read.
fn prepare(program: &Path, folder: &Path) {
    let copy = |from: &str, to: &str| {
        fs::copy(folder.join(from), folder.join(to)).expect(from);
    };
    run(program, folder, &["run", "first.yaml", "--out", "kept"]);
    copy("kept/first/fit.calibration.json", "first.calibration.json");
    run(program, folder, &["run", "second.yaml", "--out", "other"]);
    copy("other/second/fit.calibration.json", "second.calibration.json");
    // Its model lacks what the truth has: it may fail, and is written all the same.
    let _ = ended(program, folder, &["run", "warming.yaml", "--out", "other"], Bounds::default());
    copy("other/warming/fit.calibration.json", "warm.calibration.json");
    let _ = ended(program, folder, &["test", "first.yaml", "--accept"], Bounds::default());
    remove(&folder.join("other"));
    ["second.yaml", "warming.yaml", "warm-touches.csv", "warm-facets.csv", "lengths.csv"].iter().for_each(|name| {
        let path: PathBuf = folder.join(name);
        remove(&path);
    });
}
