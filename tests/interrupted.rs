//! A run that is killed leaves nothing that looks like a result: the folder of results is absent, or whole.

use std::fs;
use std::hint::black_box;
use std::process::Stdio;

use crate::support::{Small, program, tree};

/// How often a run is killed, each time a little later.
const KILLS: u32 = 40;

#[test]
fn an_interrupted_run_leaves_whole_results_or_none() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "whole"]).status, 0);
    let whole = tree(&small.path("whole/recipe"));
    assert!(whole.len() >= 5, "{whole:?}");

    let found = kill_many(&small, |_| {});
    for (kill, files) in found.iter().enumerate() {
        assert!(files.is_empty() || *files == whole, "kill {kill}: {files:?}");
    }
    // The first one is killed before it can do anything: otherwise this test would only watch runs that went through.
    assert!(found.iter().any(Vec::is_empty), "no run was interrupted");
}

#[test]
fn an_interrupted_run_leaves_older_results_whole() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "whole"]).status, 0);
    let whole = tree(&small.path("whole/recipe"));
    let found = kill_many(&small, |out| {
        assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", out]).status, 0);
    });
    for (kill, files) in found.iter().enumerate() {
        assert_eq!(*files, whole, "kill {kill}");
    }
}

#[test]
fn what_an_interrupted_run_left_is_cleared_away_by_a_later_one() {
    let small = Small::new();
    let [dead, alive] =
        [".abbe-partial-dead00000000", ".abbe-partial-alive0000000"].map(|name| small.path("out").join(name));
    for folder in [&dead, &alive] {
        fs::create_dir_all(folder).expect("a folder");
        fs::write(folder.join("verdicts.json"), "[").expect("a file");
    }
    // As a run does that is writing now.
    let owner = fs::File::open(&alive).expect("a folder can be opened");
    owner.lock().expect("a folder can be locked");
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "out"]).status, 0);
    assert_eq!((dead.exists(), alive.exists()), (false, true));
    drop(owner);
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "out"]).status, 0);
    assert!(!alive.exists());
}

/// Prepares a folder of results, starts a run that writes into it, kills it, and lists what is in the folder then; many
/// times, after more and more looks at the folder.
fn kill_many(small: &Small, prepare: impl Fn(&str)) -> Vec<Vec<std::path::PathBuf>> {
    (0..KILLS)
        .map(|kill| {
            let out = format!("out-{kill}");
            prepare(&out);
            let mut run = program(small.folder.path(), &["run", "recipe.yaml", "--out", &out])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .expect("the program starts");
            // Half of the runs are killed after some looks; the others when they have written some of their files.
            let mut looks = 0;
            while run.try_wait().expect("a run can be asked").is_none() {
                looks += 1;
                let partial = partial_files(&small.path(&out));
                let now = if kill % 2 == 0 { looks > kill * 40 } else { partial > (kill as usize / 2) % 8 };
                if now {
                    break;
                }
            }
            // It may have ended by itself in the meantime.
            let _ = run.kill();
            run.wait().expect("a killed run ends");
            let results = small.path(&out).join("recipe");
            if results.exists() { tree(&results) } else { Vec::new() }
        })
        .collect()
}

/// How many files are being written.
fn partial_files(out: &std::path::Path) -> usize {
    let entries = fs::read_dir(out).into_iter().flatten().flatten();
    let partial = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with('.'));
    partial.map(|entry| black_box(fs::read_dir(entry.path()).into_iter().flatten().count())).sum()
}

/// What was started in the background or by `nohup` ignores signals, and hands this on; `env` undoes it.
const DEFAULT_SIGNALS: &str = "--default-signal=INT,TERM,HUP";

/// Whether signals can be made heard again; told as skipped where they cannot.
#[cfg(unix)]
fn signals_are_heard() -> bool {
    let env = std::process::Command::new("env").args([DEFAULT_SIGNALS, "true"]).stderr(Stdio::null()).status();
    let are_heard = env.is_ok_and(|status| status.success());
    if !are_heard {
        crate::support::skipped("interrupted", "`env --default-signal` of GNU coreutils is not there");
    }
    are_heard
}

/// Ctrl-C, an order to end, or a closed terminal while a long Monte Carlo calculation runs: an end within a second, a status that
/// says which, and no trace of results.
#[cfg(unix)]
#[test]
fn an_interrupted_run_ends_at_once_and_says_so() {
    if !signals_are_heard() {
        return;
    }
    for (signal, status) in [("-INT", 130), ("-TERM", 143), ("-HUP", 129)] {
        interrupted_by(signal, status);
    }
}

#[cfg(unix)]
fn interrupted_by(signal: &str, expected: i32) {
    use std::io::{BufRead, BufReader};
    use std::time::{Duration, Instant};

    let small = Small::new();
    let mut recipe = crate::support::Variant::of(&small.path("recipe.yaml"));
    recipe.0["stages"]["trials"] =
        serde_json::json!({ "estimate": "monte-carlo", "of": "fine", "trials": 10_000_000, "seed": 1 });
    let file = recipe.write(small.folder.path());
    let arguments = ["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()];
    let arguments = [&arguments[..], &["--progress".as_ref(), "json".as_ref()]].concat();
    let mut command = std::process::Command::new("env");
    command.args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test")]).args(arguments);
    let mut run = command
        .current_dir(small.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut lines = BufReader::new(run.stderr.take().expect("standard error")).lines();
    let mut events = Vec::new();
    // Trials are under way.
    for line in lines.by_ref().map_while(Result::ok).filter(|line| line.starts_with('{')) {
        let event: serde_json::Value = serde_json::from_str(&line).expect("an event is JSON");
        let trials = event["event"] == "part" && event["done"].as_u64() > Some(0);
        events.push(event);
        if trials {
            break;
        }
    }
    let pid = run.id().to_string();
    let asked = Instant::now();
    let sent = std::process::Command::new("kill").args([signal, &pid]).status().expect("kill is there");
    assert!(sent.success());
    let rest: Vec<String> = lines.map_while(Result::ok).collect();
    let status = run.wait().expect("an interrupted run ends");
    assert_eq!(status.code(), Some(expected), "{signal}: {rest:?}");
    // Generous on a machine that does other things, too; without an end it would go on for hours.
    assert!(asked.elapsed() < Duration::from_secs(60));
    assert!(rest.iter().any(|line| line == "interrupted"), "{rest:?}");
    assert!(!small.path("out").exists(), "something half-written stays");
    let told = |event: &str, stage: &str| events.iter().any(|it| it["event"] == event && it["stage"] == stage);
    assert!(told("started", "fine") && told("iteration", "fine") && told("part", "trials"), "{events:?}");
}

/// Waits until there is something in a folder; gives whether the program still runs then.
#[cfg(unix)]
fn has_begun(run: &mut std::process::Child, folder: &std::path::Path) -> bool {
    let started = std::time::Instant::now();
    loop {
        if run.try_wait().expect("it can be asked").is_some() {
            return false;
        }
        if fs::read_dir(folder).expect("a folder").next().is_some() {
            return true;
        }
        assert!(started.elapsed() < std::time::Duration::from_secs(600), "there is no temporary folder");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
}

/// A pipe that is full: who writes into it waits.
#[cfg(target_os = "linux")]
fn full_pipe() -> (std::io::PipeReader, std::io::PipeWriter) {
    use std::io::Write;

    let (reader, writer) = std::io::pipe().expect("a pipe");
    let mut filler = writer.try_clone().expect("a second end");
    let (told, heard) = std::sync::mpsc::channel();
    // It ends with an error when nobody reads any more.
    std::thread::spawn(move || while filler.write_all(&[b' '; 512]).is_ok() && told.send(()).is_ok() {});
    while heard.recv_timeout(std::time::Duration::from_millis(200)).is_ok() {}
    (reader, writer)
}

/// Commands that only show something: a signal ends them with the same word and status as a run. Their output waits for a reader that
/// never comes, so that they are under way when it is sent.
#[cfg(target_os = "linux")]
#[test]
fn commands_that_show_something_say_that_they_are_interrupted() {
    use std::io::Read;
    use std::time::{Duration, Instant};

    if !signals_are_heard() {
        return;
    }
    let small = Small::new();
    for (arguments, signal, expected) in [
        (&["data", "data/touches.csv"][..], "-INT", 130),
        (&["model", "data/machine.yaml"], "-TERM", 143),
        (&["explain", "EXX", "--machine", "data/machine.yaml"], "-HUP", 129),
    ] {
        let (reader, writer) = full_pipe();
        let mut run = std::process::Command::new("env")
            .args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test")])
            .args(arguments)
            .current_dir(small.folder.path())
            .stdout(writer)
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        // It handles SIGHUP, SIGINT and SIGTERM: the numbers 1, 2 and 15.
        const ALL: u64 = 1 | 1 << 1 | 1 << 14;
        let status = format!("/proc/{}/status", run.id());
        let handles = || {
            let status = fs::read_to_string(&status).unwrap_or_default();
            let bits = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
            bits.and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok()).is_some_and(|bits| bits & ALL == ALL)
        };
        let started = Instant::now();
        while !handles() && started.elapsed() < Duration::from_secs(300) {
            std::thread::sleep(Duration::from_millis(1));
        }
        let sent = std::process::Command::new("kill").args([signal, &run.id().to_string()]).status();
        assert!(sent.expect("kill is there").success());
        while run.try_wait().expect("it can be asked").is_none() {
            if started.elapsed() > Duration::from_secs(600) {
                run.kill().expect("it can be ended");
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        drop(reader);
        let mut said = String::new();
        run.stderr.take().expect("standard error").read_to_string(&mut said).expect("text");
        let status = run.wait().expect("an interrupted command ends");
        assert_eq!((status.code(), said.as_str()), (Some(expected), "interrupted\n"), "{arguments:?} {signal}");
    }
}

/// Temporary folders of `abbe new`, and of a report that a browser prints, go with a signal.
#[cfg(unix)]
#[test]
fn temporary_folders_go_with_a_signal() {
    use std::os::unix::fs::PermissionsExt;

    if !signals_are_heard() {
        return;
    }
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "known"]).status, 0);
    // A browser that never comes to an end.
    let browser = small.path("browser");
    small.write("browser", "#!/bin/sh\nexec sleep 600\n");
    fs::set_permissions(&browser, fs::Permissions::from_mode(0o755)).expect("permissions");
    let new = ["new", "beginning", "--chain", "w C' A' b X Y Z t", "--method", "table"];
    let report = ["report", "known/recipe", "--out", "page.pdf"];
    for (arguments, made) in [(&new[..], "beginning"), (&report[..], "page.pdf")] {
        for (signal, expected) in [("-INT", 130), ("-TERM", 143), ("-HUP", 129)] {
            let folder = small.path("temporary");
            fs::create_dir(&folder).expect("a folder");
            let mut run = std::process::Command::new("env")
                .args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test")])
                .args(arguments)
                .current_dir(small.folder.path())
                .env("TMPDIR", &folder)
                .env("ABBE_BROWSER", &browser)
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .expect("the program starts");
            assert!(has_begun(&mut run, &folder), "{arguments:?} ended before the signal");
            let sent = std::process::Command::new("kill").args([signal, &run.id().to_string()]).status();
            assert!(sent.expect("kill is there").success());
            let status = run.wait().expect("an interrupted command ends");
            assert_eq!(status.code(), Some(expected), "{arguments:?} {signal}");
            let left: Vec<_> = fs::read_dir(&folder).expect("a folder").flatten().map(|entry| entry.path()).collect();
            assert!(left.is_empty(), "{arguments:?} {signal}: {left:?}");
            assert!(!small.path(made).exists(), "{arguments:?} {signal}");
            fs::remove_dir(&folder).expect("it is empty");
        }
    }
}

/// What a command that was killed has left among temporary files goes with the next one.
#[cfg(unix)]
#[test]
fn temporary_folders_of_killed_commands_go() {
    use std::os::unix::fs::PermissionsExt;

    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "known"]).status, 0);
    small.write("browser", "#!/bin/sh\nexec sleep 20\n");
    let browser = small.path("browser");
    fs::set_permissions(&browser, fs::Permissions::from_mode(0o755)).expect("permissions");
    let folder = small.path("temporary");
    fs::create_dir(&folder).expect("a folder");
    let report = |browser: &std::path::Path| {
        std::process::Command::new(env!("CARGO_BIN_EXE_abbe-under-test"))
            .args(["report", "known/recipe", "--out", "page.pdf"])
            .current_dir(small.folder.path())
            .env("TMPDIR", &folder)
            .env("ABBE_BROWSER", browser)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts")
    };
    let mut killed = report(&browser);
    assert!(has_begun(&mut killed, &folder), "it ended before it was killed");
    killed.kill().and_then(|()| killed.wait()).expect("it is killed");
    assert_eq!(fs::read_dir(&folder).expect("a folder").count(), 1);
    assert!(!report("true".as_ref()).wait().expect("it ends").success());
    assert_eq!(fs::read_dir(&folder).expect("a folder").count(), 0);
}

/// A signal while a run reads batches: an end in good time, a status that says which, and nothing that stays, neither results nor
/// what is kept of batches.
#[cfg(unix)]
#[test]
fn a_run_in_batches_ends_between_batches() {
    if !signals_are_heard() {
        return;
    }
    let small = Small::new();
    let touches = small.read("data/touches.csv");
    let head = 1 + touches.lines().position(|line| line.contains("_mm")).expect("a header");
    let rows: Vec<&str> = touches.lines().skip(head).filter(|line| !line.starts_with('#')).collect();
    let head: Vec<&str> = touches.lines().take(head).collect();
    let many: Vec<&str> = head.into_iter().chain(rows.iter().copied().cycle().take(200_000)).collect();
    small.write("data/touches.csv", &(many.join("\n") + "\n"));
    let recipe = small.read("recipe.yaml").replace("data/touches.csv }", "data/touches.csv, batch_rows: 500 }");
    assert!(recipe.contains("batch_rows"));
    let recipe: serde_json::Value = serde_yaml::from_str(&recipe).expect("the recipe is YAML");
    crate::support::Variant(recipe).only(&["rough"]).write(small.folder.path());
    // In the first pass, which reads the file, and in a later one.
    for (signal, expected, stage) in [("-INT", 130, "touches"), ("-TERM", 143, "rough"), ("-TERM", 143, "touches")] {
        in_batches_by(&small, signal, expected, stage);
    }
}

#[cfg(unix)]
fn in_batches_by(small: &Small, signal: &str, expected: i32, stage: &str) {
    use std::io::{BufRead, BufReader};
    use std::time::{Duration, Instant};

    let temporary = small.path("temporary");
    fs::create_dir(&temporary).expect("a folder");
    let mut run = std::process::Command::new("env")
        .args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test")])
        .args(["run", "recipe.yaml", "--out", "out", "--progress", "json"])
        .current_dir(small.folder.path())
        .env("TMPDIR", &temporary)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut lines = BufReader::new(run.stderr.take().expect("standard error")).lines();
    let is_under_way = |line: &String| {
        let event: serde_json::Value = serde_json::from_str(line).unwrap_or_default();
        event["event"] == "part" && event["stage"] == stage && event["done"].as_u64() > Some(0)
    };
    assert!(lines.by_ref().map_while(Result::ok).any(|line| is_under_way(&line)), "{stage}: no batch was told");
    let asked = Instant::now();
    let sent = std::process::Command::new("kill").args([signal, &run.id().to_string()]).status();
    assert!(sent.expect("kill is there").success());
    let rest: Vec<String> = lines.map_while(Result::ok).collect();
    let status = run.wait().expect("an interrupted run ends");
    assert_eq!(status.code(), Some(expected), "{stage} {signal}: {rest:?}");
    assert!(rest.iter().any(|line| line == "interrupted"), "{rest:?}");
    // Generous on a machine that does other things, too.
    assert!(asked.elapsed() < Duration::from_secs(60));
    assert!(!small.path("out").exists(), "something half-written stays");
    let left: Vec<_> = fs::read_dir(&temporary).expect("a folder").flatten().map(|entry| entry.path()).collect();
    assert!(left.is_empty(), "{stage} {signal}: {left:?}");
    fs::remove_dir(&temporary).expect("it is empty");
}

/// A signal at any time while pages are written leaves all pages or none, and nothing temporary.
#[cfg(unix)]
#[test]
fn pages_are_all_there_or_none_is_after_a_signal() {
    use std::time::{Duration, Instant};

    if !signals_are_heard() {
        return;
    }
    let folder = crate::support::temporary();
    let pages = |name: &str| {
        let entries = fs::read_dir(folder.path().join(name)).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name()).collect::<std::collections::BTreeSet<_>>()
    };
    assert_eq!(crate::support::abbe(folder.path(), &["plugins", "--pages", "whole"]).status, 0);
    let whole = pages("whole");
    let (mut began, mut ended) = (0, 0);
    for number in 0..24 {
        let name = format!("pages-{number}");
        let mut run = std::process::Command::new("env")
            .args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test"), "plugins", "--pages", &name])
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let started = Instant::now();
        // Before it begins, or with some pages there.
        while pages(&name).len() < (number % 8) * 10 && run.try_wait().expect("it can be asked").is_none() {
            assert!(started.elapsed() < Duration::from_secs(600), "no page is written");
        }
        let signal = ["-INT", "-TERM", "-HUP"][number % 3];
        let sent =
            std::process::Command::new("kill").args([signal, &run.id().to_string()]).stderr(Stdio::null()).status();
        began += usize::from(sent.is_ok_and(|sent| sent.success()));
        while run.try_wait().expect("it can be asked").is_none() {
            assert!(started.elapsed() < Duration::from_secs(600), "it does not end");
            std::thread::sleep(Duration::from_millis(1));
        }
        let found = pages(&name);
        assert!(found.is_empty() || found == whole, "{number}: {} of {} pages", found.len(), whole.len());
        ended += usize::from(!found.is_empty());
    }
    assert!(began > 0 && ended > 0, "{began} signals, {ended} with pages");
}

/// A long program that is being corrected: a signal leaves neither it nor a temporary file.
#[test]
#[cfg(unix)]
fn a_program_that_is_interrupted_leaves_nothing() {
    if !signals_are_heard() {
        return;
    }
    let folder = crate::support::temporary();
    let calibration = crate::support::root().join("benches/calibrations/table-table.calibration.json");
    let mut text = "G21 G90 G17 G94 G54\nG0 X-90 Y-90 Z10 A-20 C-30\nG1 F1000\n".to_owned();
    (0..1_000_000).for_each(|block| text.push_str(&format!("X{} Y{}\n", block % 90, block % 80)));
    crate::support::write(&folder.path().join("long.ngc"), &(text + "M2\n"));
    for (signal, expected) in [("-INT", 130), ("-TERM", 143), ("-HUP", 129)] {
        let out = folder.path().join("out");
        fs::create_dir(&out).expect("a folder");
        let arguments = ["long.ngc", "--dialect", "linuxcnc", "--correct", "five-axes", "--out", "out/corrected.ngc"];
        let calibration = calibration.to_string_lossy();
        let mut run = std::process::Command::new("env")
            .args([DEFAULT_SIGNALS, env!("CARGO_BIN_EXE_abbe-under-test"), "compensate", &*calibration])
            .args(arguments)
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        assert!(has_begun(&mut run, &out), "{signal}: it has ended before");
        let sent = std::process::Command::new("kill").args([signal, &run.id().to_string()]).status();
        assert!(sent.expect("kill is there").success());
        assert_eq!(run.wait().expect("it ends").code(), Some(expected), "{signal}");
        assert_eq!(tree(&out), Vec::<std::path::PathBuf>::new(), "{signal}");
        fs::remove_dir(&out).expect("it is empty");
    }
}
