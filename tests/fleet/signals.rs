//! Signals while a fleet is planned or merged.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use super::contents;
use super::plant::{Plant, ok, quiet};
use crate::support::{skipped, temporary, tree};

/// Undoes that signals are ignored, as they are for what was started in the background.
const DEFAULT_SIGNALS: &str = "--default-signal=INT,TERM,HUP";

/// How long a command may take to end, in a machine that does much else.
const MOST: Duration = Duration::from_secs(600);

/// Times within a command at which a signal comes.
const TIMES: u32 = 9;

/// A signal at any time ends a plan or a merge with its status, or comes too late; nothing temporary stays, and what is written is whole.
#[test]
fn a_signal_leaves_nothing_temporary_and_nothing_half() {
    let env = Command::new("env").args([DEFAULT_SIGNALS, "true"]).stderr(Stdio::null()).status();
    if !env.is_ok_and(|status| status.success()) {
        return skipped("fleet_signals", "`env --default-signal` of GNU coreutils is not there");
    }
    let folder = temporary();
    let at = folder.path();
    Plant::of(40).write(at);
    let began = Instant::now();
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    let whole = std::fs::read(at.join("fleet.manifest.jsonl")).expect("a manifest");
    let remove = || std::fs::remove_file(at.join("fleet.manifest.jsonl")).unwrap_or_default();
    let ended = ends(at, &["fleet", "plan", "fleet.yaml"], began.elapsed(), || {
        let found = std::fs::read(at.join("fleet.manifest.jsonl"));
        assert!(found.is_err() || found.is_ok_and(|found| found == whole), "half of a manifest");
        remove();
    });
    assert!(ended > 0, "no signal came in time");

    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
    let began = Instant::now();
    ok(&quiet(at, &["fleet", "merge", "fleet.manifest.jsonl", "--calibrations"]));
    let (took, whole) = (began.elapsed(), contents(at));
    let ended = ends(at, &["fleet", "merge", "fleet.manifest.jsonl", "--calibrations"], took, || {
        for (name, content) in contents(at).into_iter().filter(|(name, _)| !name.ends_with("plant.sqlite")) {
            assert!(whole[&name] == content, "{} is half-written", name.display());
        }
        let merged = at.join("fleet.merged");
        let is_empty = std::fs::read_dir(&merged).is_ok_and(|mut entries| entries.next().is_none());
        assert!(!is_empty, "a folder without tables stays");
        let _ = std::fs::remove_dir_all(merged);
    });
    assert!(ended > 0, "no signal came in time");
    ok(&quiet(at, &["fleet", "merge", "fleet.manifest.jsonl", "--calibrations"]));
    assert_eq!(contents(at).keys().collect::<Vec<_>>(), whole.keys().collect::<Vec<_>>());
}

/// Does something again and again, with a signal at several times within the time that it takes; gives how many it ended.
fn ends(at: &Path, arguments: &[&str], takes: Duration, after: impl Fn()) -> usize {
    let mut ended = 0;
    after();
    for number in 0..TIMES {
        let (signal, status) = [("-INT", 130), ("-TERM", 143), ("-HUP", 129)][number as usize % 3];
        let mut process = Command::new("env")
            .args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test")])
            .args(arguments)
            .current_dir(at)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        std::thread::sleep(takes * (number + 1) / (TIMES + 1));
        let _ = Command::new("kill").args([signal, &process.id().to_string()]).stderr(Stdio::null()).status();
        let asked = Instant::now();
        while process.try_wait().expect("it can be asked").is_none() {
            if asked.elapsed() > MOST {
                let _ = process.kill();
                panic!("{arguments:?} {signal}: it does not end");
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let code = process.wait().expect("it has ended").code();
        // Before the program has begun to listen, the signal itself ends it.
        assert!([Some(0), Some(status), None].contains(&code), "{arguments:?} {signal}: {code:?}");
        ended += usize::from(code == Some(status));
        let left: Vec<_> =
            tree(at).into_iter().filter(|file| file.to_string_lossy().contains(".abbe-partial")).collect();
        assert!(left.is_empty(), "{arguments:?} {signal}, {number}: {left:?}");
        after();
    }
    ended
}
