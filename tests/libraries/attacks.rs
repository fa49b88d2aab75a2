//! What hostile plugins do, in the program and isolated: the table in `docs/vendor-plugins.md` names these tests.
//!
//! Each run has bounds of its own on time, memory and size of files, whatever the program does.

#![cfg(target_os = "linux")]

use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::Command;

use abbe_core::{Build, Context, Poses, Variable};
use serde_json::{Value, json};

use super::{bad, c_library, lengths, limits, three_axes};
use crate::support::{Variant, program, read, root, skipped, temporary, write};

/// How the program ended.
struct Ended {
    /// Its exit status; none after a signal.
    status: Option<i32>,
    signal: Option<i32>,
    stdout: String,
    stderr: String,
    /// Its messages in one line.
    said: String,
}

/// Bounds on what any process of a test may have: 60 s of processor, 24 GB of addresses, files of 100 MB; and 100 s of time.
const BOUNDS: &str = "ulimit -t 60; ulimit -v 24000000; ulimit -f 200000; ulimit -c 0; ulimit -n 512; \
                      (sleep 100; kill -KILL $$ 2>/dev/null) >/dev/null 2>&1 & exec \"$0\" \"$@\"";

fn ended(folder: &Path, arguments: &[&str]) -> Ended {
    let run = program(folder, arguments);
    let mut bounded = Command::new("bash");
    bounded.args(["-c", BOUNDS]).arg(run.get_program()).args(run.get_args()).current_dir(folder).env("NO_COLOR", "1");
    let output = bounded.output().expect("a shell starts");
    let [stdout, stderr] = [output.stdout, output.stderr].map(|said| String::from_utf8_lossy(&said).into_owned());
    let said = stderr.replace(['│', '╰', '─', '▶', '×'], " ");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    Ended { status: output.status.code(), signal: output.status.signal(), stdout, stderr, said }
}

/// Runs the recipe of three axes on the model that misbehaves in this way; `library` has keys beside the path.
fn run(folder: &Path, mode: &str, library: Value, more: &[&str]) -> Ended {
    lengths(folder);
    let mut recipe = three_axes(json!({ "model": "bad-model", "mode": mode }));
    recipe["stages"]["fit"]["parameters"] = json!(["E*[1]"]);
    let mut named = json!({ "path": bad(folder, "bad", &[]) });
    named.as_object_mut().expect("a map").extend(library.as_object().expect("a map").clone());
    recipe["plugins"] = json!([named]);
    Variant(recipe).write(folder);
    ended(folder, &[&["run", "recipe.yaml", "--out", "out"], more].concat())
}

fn in_the_program(mode: &str) -> Ended {
    run(temporary().path(), mode, json!({ "isolate": false }), &[])
}

fn isolated(mode: &str) -> Ended {
    run(temporary().path(), mode, json!({ "isolate": true, "time_limit_s": 2.0 }), &[])
}

/// What a run finds with a model of this mode, without the name of the mode.
fn calibration(mode: &str, isolate: bool) -> String {
    let folder = temporary();
    let ended = run(folder.path(), mode, json!({ "isolate": isolate }), &[]);
    assert_eq!(ended.status, Some(0), "{mode}: {}", ended.said);
    read(&folder.path().join("out/recipe/fit.calibration.json")).replace(&format!("\"{mode}\""), "\"good\"")
}

const SIGABRT: i32 = 6;
const SIGSEGV: i32 = 11;

#[test]
fn a_crash_ends_the_program_or_an_isolated_stage() {
    for (mode, signals, expected) in [
        ("abort", &[SIGABRT][..], "its process was ended by signal 6 (SIGABRT)"),
        ("crash", &[SIGSEGV], "its process was ended by signal 11 (SIGSEGV)"),
        // Where Rust finds out that it was the stack, it says so and aborts.
        ("stack", &[SIGABRT, SIGSEGV], "crashed: its process was ended by signal"),
    ] {
        let bare = in_the_program(mode);
        assert!(bare.signal.is_some_and(|signal| signals.contains(&signal)), "{mode}: {:?} {}", bare.status, bare.said);
        let kept = isolated(mode);
        assert!(kept.status == Some(1) && kept.said.contains(expected), "{mode}: {}", kept.said);
    }
}

/// A plugin in the program may end it with a status of its own choice; an isolated one may not.
#[test]
fn an_end_is_a_failure_where_it_can_be_seen() {
    let folder = temporary();
    for (mode, status) in [("exit", 1), ("quick-exit", 0), ("exec", 0)] {
        let bare = run(folder.path(), mode, json!({ "isolate": false }), &[]);
        assert_eq!(bare.status, Some(status), "{mode}: {}", bare.said);
        assert!(!folder.path().join("out").exists(), "{mode}");
    }
    for mode in ["exit", "quick-exit"] {
        let kept = isolated(mode);
        assert!(kept.status == Some(1) && kept.said.contains("ended its process"), "{mode}: {}", kept.said);
    }
    // Another program cannot be started in the place of this one: the model goes on.
    let kept = isolated("exec");
    assert_eq!(kept.status, Some(0), "{}", kept.said);
}

#[test]
fn what_never_ends_is_ended() {
    for mode in ["hang", "hang-in-create"] {
        let kept = isolated(mode);
        assert!(kept.status == Some(1) && kept.said.contains("gave no answer within 2 s"), "{mode}: {}", kept.said);
        let bare = run(temporary().path(), mode, json!({ "isolate": false }), &["--time-limit", "1"]);
        assert!(bare.status != Some(0), "{mode}: {}", bare.said);
    }
    let folder = temporary();
    let loops = bad(folder.path(), "loops", &["-DLIBRARY_LOOPS"]);
    let error = abbe_plugin::isolated(&loops, None, &limits(2.0)).err().expect("its constructor never ends");
    assert!(error.message.contains("gave no answer within 2 s"), "{error}");
    // In the program nothing ends it but somebody else: `timeout` has the status 124 then.
    let bare = program(folder.path(), &["plugins", "--trust-plugins", "--plugin", &loops.to_string_lossy()]);
    let waited = Command::new("timeout").arg("2").arg(bare.get_program()).args(bare.get_args()).output();
    assert_eq!(waited.expect("`timeout` starts").status.code(), Some(124));
}

/// Every answer of 0.4 s is in time; all together take too long.
#[test]
fn slow_answers_have_a_limit_altogether() {
    let folder = temporary();
    let library = json!({ "isolate": true, "time_limit_s": 20.0, "total_time_limit_s": 1.0 });
    let kept = run(folder.path(), "slow", library, &[]);
    assert!(kept.status == Some(1) && kept.said.contains("took more than 1 s altogether"), "{}", kept.said);
    let bare = run(folder.path(), "slow", json!({ "isolate": false }), &["--time-limit", "1"]);
    assert!(bare.status != Some(0) && bare.said.contains("1 s"), "{:?} {}", bare.status, bare.said);
}

/// Files that the setting names may be read, and no more than that.
#[test]
fn memory_processes_signals_files_and_network_are_closed() {
    const TEST: &str = "memory_processes_signals_files_and_network_are_closed";
    if let Some(missing) = abbe_plugin::missing() {
        return skipped(TEST, missing);
    }
    for (mode, could) in [
        ("memory", "have 3 GiB of memory"),
        ("shared-memory", "have 3 GiB of shared memory"),
        ("fork", "start a process"),
        ("signal", "signal to another process"),
        ("signal-group", "signal to a group of processes"),
        ("signal-later", "have signals sent to another process"),
        ("read", "read a file of the system"),
        ("list", "list a folder"),
        ("write", "write a file"),
        ("change", "change a file"),
        ("truncate", "empty a file"),
        ("open-to-write", "open a file to write"),
        ("remove", "remove a file"),
        ("rename", "rename a file"),
        ("network", "open a socket"),
        ("environment", "read the environment"),
    ] {
        let folder = temporary();
        let file = folder.path().join(mode);
        write(&file, "what was there");
        let kept = run(folder.path(), mode, json!({ "isolate": true }), &[]);
        assert_eq!(kept.status, Some(0), "{mode}: {}", kept.said);
        assert_eq!(read(&file), "what was there", "{mode}");
        let bare = run(folder.path(), mode, json!({ "isolate": false }), &[]);
        assert!(bare.status == Some(1) && bare.said.contains(could), "{mode}: {}", bare.said);
    }
}

/// No limit of the system counts the threads of one process: who started it does.
#[test]
fn threads_without_end_end_the_stage() {
    let kept = run(temporary().path(), "threads", json!({ "isolate": true }), &[]);
    assert!(kept.status == Some(1) && kept.said.contains("started more than"), "{}", kept.said);
    assert!(kept.said.contains("threads; its process was ended"), "{}", kept.said);
    let bare = in_the_program("threads");
    assert!(bare.status == Some(1) && bare.said.contains("start 2000 threads"), "{}", bare.said);
    // A pool of threads is nothing bad.
    assert_eq!(calibration("some-threads", true), calibration("good", true));
}

#[test]
fn what_a_plugin_prints_is_not_what_the_program_prints() {
    let (bare, kept) = (in_the_program("stdout"), isolated("stdout"));
    assert!(bare.status == Some(0) && bare.stdout.contains("garbage"), "{}", bare.stdout);
    assert!(kept.status == Some(0) && !kept.stdout.contains("garbage"), "{}", kept.stdout);
    assert_eq!(calibration("stdout", true), calibration("good", true));
    // 3 MB at a time on standard error: 1 MiB is passed on, the rest is read and left out.
    let kept = run(temporary().path(), "flood", json!({ "isolate": true }), &[]);
    assert_eq!(kept.status, Some(0), "{} bytes", kept.stderr.len());
    assert!(kept.stderr.contains("the rest is left out") && kept.stderr.len() < 3 << 20, "{}", kept.stderr.len());
}

#[test]
fn closed_descriptors_end_the_stage() {
    let kept = isolated("close");
    let expected = ["ended its process", "crashed", "broke the connection"];
    assert!(kept.status == Some(1) && expected.iter().any(|end| kept.said.contains(end)), "{}", kept.said);
    // In the program nothing holds, but that it ends.
    let bare = in_the_program("close");
    assert!(bare.status.is_some() || bare.signal == Some(SIGABRT), "{:?}", bare.signal);
}

#[test]
fn another_working_directory_or_rounding_changes_no_result() {
    for isolate in [false, true] {
        let good = calibration("good", isolate);
        for mode in ["directory", "rounding"] {
            assert_eq!(calibration(mode, isolate), good, "{mode}, isolated: {isolate}");
        }
    }
}

#[test]
fn wrong_counts_are_refused() {
    for (mode, expected) in [
        ("beyond", "wrote beyond the end of the room that it was given"),
        ("wrong-axis", "whose axis Z has status 9, which is not there"),
        ("no-json", "gave an answer that cannot be read"),
        ("no-object", "gave no object"),
        ("nan", "gave positions that are not finite numbers"),
    ] {
        for ended in [in_the_program(mode), isolated(mode)] {
            assert!(ended.status == Some(1) && ended.said.contains(expected), "{mode}: {}", ended.said);
        }
    }
    // Messages that a plugin writes on its connection: one that is 10^19 bytes long, and one that comes byte by byte.
    for (mode, expected) in [("forged", "longer than any is"), ("drip", "gave no answer within 2 s")] {
        let kept = isolated(mode);
        assert!(kept.status == Some(1) && kept.said.contains(expected), "{mode}: {}", kept.said);
    }
}

/// An isolated estimator that writes questions of its own on its connection is told what is wrong with them; nothing of it reaches the
/// code of machines and observations.
#[test]
fn forged_questions_are_refused() {
    for (mode, expected) in [
        ("good", "\"Numbers\":{\"lengths\":[3,0,3,0]}"),
        ("statuses", "gave statuses or values of another machine"),
        ("values", "gave statuses or values of another machine"),
        ("wanted", "wants a derivative to Parameter(1000000000), which is not there"),
        ("room", "asks for more derivatives than a message has room for"),
        ("rows", "asked for rows that are not there, or with other poses"),
        ("positions", "asked for rows that are not there, or with other poses"),
        ("contact", "asked for the contact of a row that is not there"),
        ("nobody", "names the object 77, which is not there"),
        ("answer", "broke the connection"),
    ] {
        let folder = temporary();
        lengths(folder.path());
        let asks = c_library(folder.path(), "tests/bad-plugins/asks.c", "asks", &[]);
        let mut recipe = three_axes(json!({ "model": "bad-model", "mode": "good" }));
        recipe["stages"]["fit"] = json!({ "estimate": "asks", "mode": mode, "machine": "machine", "observations": ["bar"],
            "parameters": ["E*[1]"] });
        recipe["plugins"] = json!([
            { "path": bad(folder.path(), "bad", &[]), "isolate": false },
            { "path": asks, "isolate": true, "time_limit_s": 10.0 },
        ]);
        Variant(recipe).write(folder.path());
        let ended = ended(folder.path(), &["run", "recipe.yaml", "--out", "out", "--json"]);
        let said = ended.stdout.replace("\\\"", "\"").replace("\\\"", "\"").replace('\\', "") + &ended.said;
        assert_eq!(ended.status, Some(1), "{mode}: {said}");
        assert!(said.contains(expected) && !said.contains("panicked"), "{mode}: {said}");
    }
}

/// What runs is what was hashed, whatever becomes of the file.
#[test]
fn a_library_that_is_overwritten_runs_as_it_was_hashed() {
    let folder = temporary();
    let file = bad(folder.path(), "bad", &[]);
    let (whole, other) =
        (fs::read(&file).expect("a library"), fs::read(bad(folder.path(), "other", &["-DMODE=\"nan\""])));
    let other = other.expect("a library");
    assert_ne!(whole, other);
    let pin = abbe_plugin::isolated(&file, None, &limits(10.0)).expect("it is listed").sha256;
    for content in [Vec::new(), vec![0; whole.len()], other] {
        fs::write(&file, &whole).expect("the same file");
        let loaded = abbe_plugin::load(&file, Some(&pin)).expect("it loads");
        let listed = abbe_plugin::isolated(&file, Some(&pin), &limits(10.0)).expect("it is listed");
        let built = |library: &abbe_plugin::Library| {
            let Build::Model(model) = &library.plugins[0].build else { panic!("it has a model") };
            model.build(&json!({ "mode": "good" }), &Context { base: folder.path().to_owned() })
        };
        let running = built(&listed).expect("its file is the same yet").build(&[]).expect("a machine");
        // In place: what maps the file sees other bytes, or none.
        fs::write(&file, &content).expect("the same file");
        let here = built(&loaded).expect("it was loaded").build(&[]).expect("a machine");
        for machine in [here, running] {
            let mut out = Poses::default();
            machine.poses(&[1.0, 2.0, 3.0], &[0.5; 3], &[Variable::Parameter(0)], false, &mut out).expect("positions");
            assert_eq!(out.positions, [[1.5, 3.0, 4.5]]);
        }
        let error = built(&listed).err().expect("the file of a new process is another one");
        assert!(error.message.contains("another SHA-256") || error.message.contains("cannot be"), "{error}");
        let error = abbe_plugin::load(&file, Some(&pin)).err().expect("it is another one");
        // Zeros are no library of any name.
        let is_told =
            ["another SHA-256", "does not begin as a library"].iter().any(|words| error.message.contains(words));
        assert!(is_told, "{error}");
    }
}

/// The table of attacks names a test for each of its rows, and each of them is there.
#[test]
fn every_attack_of_the_page_has_a_test() {
    let page = read(&root().join("docs/vendor-plugins.md"));
    let table = page.split("| what it tries |").nth(1).expect("the table").split("\n\n").next().expect("its rows");
    let rows: Vec<&str> = table.lines().skip(2).collect();
    let code: String = ["attacks", "conformance", "misbehaving"]
        .map(|file| read(&root().join(format!("tests/libraries/{file}.rs"))))
        .concat();
    for row in &rows {
        let named = row.split('|').rev().nth(1).expect("the last column").trim().trim_matches('`');
        assert!(code.contains(&format!("#[test]\nfn {named}() {{")), "{row}: there is no test `{named}`");
    }
    let attacks = [
        "wrong address",
        "abort",
        "stack",
        "constructor",
        "create",
        "call",
        "slow",
        "memory",
        "processes",
        "threads",
        "signals",
        "read files",
        "write",
        "network",
        "standard output",
        "descriptors",
        "directory",
        "exit",
        "round",
        "counts",
        "replaced",
        "forges",
    ];
    for attack in attacks {
        let is_there = |row: &&str| row.split('|').nth(1).is_some_and(|what| what.contains(attack));
        assert!(rows.iter().any(is_there), "no row about {attack}");
    }
}
