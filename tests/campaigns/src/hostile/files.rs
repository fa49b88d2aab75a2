//! Files: what is none, what is taken, what belongs to others; disks that are full; signals.

use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use super::snapshot::{Entry, Snapshot, half_written, lost, new, snapshot};
use super::stock::{COMMANDS, Command, Stock, put};
use super::{Case, cut};
use crate::Random;
use crate::bad_inputs::replaced;
use crate::process::{self, Bounds, Ended, LIMIT, ended, waited};

fn command(random: &mut Random) -> (usize, &'static Command) {
    let place = random.count(0, COMMANDS.len());
    (place, &COMMANDS[place])
}

/// Laws of files after a command: nothing of others is lost, nothing is half-written.
fn keeps(case: &mut Case, before: &Snapshot, after: &Snapshot) {
    let (lost, partial) = (lost(before, after), half_written(after));
    case.law(lost.is_empty(), || format!("lost or changed: {lost:?}"));
    case.law(partial.is_empty(), || format!("half-written: {partial:?}"));
}

/// Instead of a file that a command reads there is something else.
pub fn input(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    let (_, command) = command(random);
    let folder = stock.copy();
    let file = random.of(command.reads);
    let what = replaced(random, &folder.path().join(file));
    let before = snapshot(folder.path());
    let end = ended(program, folder.path(), command.arguments, Bounds::default());
    let mut case = Case::new(format!("{}, {file} is {what}", command.arguments.join(" ")), end.as_ref());
    let after = snapshot(folder.path());
    keeps(&mut case, &before, &after);
    // A recipe of which nothing is expected yet is tested all the same.
    let may_be_absent = file == "first.expected" && matches!(what.as_str(), "nothing" | "a link to nothing");
    if !may_be_absent {
        case.law(matches!(case.status, None | Some(1 | 2)), || "it is taken".to_owned());
        case.names(end.as_ref(), file.rsplit('/').next().unwrap_or(file));
        let new = new(&before, &after);
        let is_of_test = command.arguments[0] == "test";
        case.law(new.is_empty() || is_of_test, || format!("it writes {new:?}"));
    }
    case
}

/// Something is already where a command writes.
pub fn output(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    let (_, command) = loop {
        let (place, command) = command(random);
        if !command.writes.is_empty() {
            break (place, command);
        }
    };
    let folder = stock.copy();
    let name = random.of(command.writes);
    let path = folder.path().join(name);
    let is_folder = matches!(name, "out" | "tested" | "simulated" | "planned");
    let kind = random.count(0, 7);
    let mut arguments: Vec<&str> = command.arguments.to_vec();
    let what = match kind {
        0 => {
            fs::write(&path, "mine").expect("a file");
            "a file"
        }
        1 => {
            fs::create_dir_all(path.join("first")).expect("a folder");
            fs::write(path.join("first/notes.txt"), "mine").expect("a file");
            "a folder with a note"
        }
        #[cfg(unix)]
        2 => {
            std::os::unix::fs::symlink("touches.csv", &path).expect("a link");
            "a link to data"
        }
        #[cfg(unix)]
        3 => {
            std::os::unix::fs::symlink("/dev/full", &path).expect("a link");
            "a device that is full"
        }
        #[cfg(unix)]
        4 => {
            std::os::unix::fs::symlink("nowhere", &path).expect("a link");
            "a link to nothing"
        }
        5 => {
            let place = arguments.iter().position(|argument| *argument == name).expect("the argument");
            arguments[place] = "touches.csv/below";
            "below a file"
        }
        _ => {
            let place = arguments.iter().position(|argument| *argument == name).expect("the argument");
            arguments[place] = "touches.csv";
            "the data"
        }
    };
    let before = snapshot(folder.path());
    let end = ended(program, folder.path(), &arguments, Bounds::default());
    let mut case = Case::new(format!("{}, {name} is {what}", arguments.join(" ")), end.as_ref());
    keeps(&mut case, &before, &snapshot(folder.path()));
    // A link to nothing may become a new file or folder, and results of a run stand beside what is in their folder.
    let may_be_taken = kind == 4 || (kind == 1 && is_folder);
    case.law(may_be_taken || matches!(case.status, None | Some(1 | 2)), || "it is taken".to_owned());
    case
}

/// Files of others, in the folder of earlier results and beside them.
pub fn beside(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    let folder = stock.copy();
    let results: Snapshot = (stock.files.iter())
        .filter_map(|(path, entry)| Some((path.strip_prefix("kept").ok()?.to_owned(), entry.clone())))
        .filter(|(path, _)| !path.as_os_str().is_empty())
        .collect();
    let out = folder.path().join("out");
    put(&results, &out);
    let names = [
        "notes.txt",
        "touches.csv",
        "first/mine.csv",
        "first/fit.residuals.old",
        "first/sub/deep/note",
        "run.json",
        "first/.hidden",
    ];
    for _ in 0..random.count(1, 5) {
        let path = out.join(random.of(&names));
        let _ = fs::create_dir_all(path.parent().expect("a folder"));
        match random.count(0, 4) {
            0 => drop(fs::create_dir_all(&path)),
            #[cfg(unix)]
            1 => drop(std::os::unix::fs::symlink("../touches.csv", &path)),
            _ => drop(fs::write(&path, format!("mine {}", random.count(0, 1000)))),
        }
    }
    // A result that somebody has changed is his.
    let mut changed = None;
    if random.chance(0.3) {
        let files: Vec<_> =
            results.iter().filter(|(_, entry)| matches!(entry, Entry::File(_))).map(|(path, _)| path).collect();
        let path = out.join(random.of(&files));
        fs::write(&path, "changed by hand").expect("a file");
        changed = Some(path.strip_prefix(folder.path()).expect("a path").to_owned());
    }
    let before = snapshot(folder.path());
    let end = ended(program, folder.path(), &["run", "first.yaml", "--out", "out"], Bounds::default());
    let what = changed.as_ref().map_or("files of others".to_owned(), |path| format!("{} is changed", path.display()));
    let mut case = Case::new(what, end.as_ref());
    let after = snapshot(folder.path());
    let is_ours = |path: &Path| {
        let own = path.strip_prefix("out").ok();
        own.is_some_and(|own| results.contains_key(own)) && changed.as_deref() != Some(path)
    };
    let others: Snapshot = before.into_iter().filter(|(path, _)| !is_ours(path)).collect();
    keeps(&mut case, &others, &after);
    case
}

/// Laws of a command that could not finish: older results and others' files are as before, what it writes is whole or absent.
fn whole(case: &mut Case, stock: &Stock, place: usize, before: &Snapshot, after: &Snapshot, is_killed: bool) {
    let (lost, undisturbed) = (lost(before, after), &stock.undisturbed[place].0);
    case.law(lost.is_empty(), || format!("lost or changed: {lost:?}"));
    for name in COMMANDS[place].writes {
        let of = |files: &Snapshot| -> Vec<String> {
            files.keys().filter(|path| path.starts_with(name)).map(|path| path.display().to_string()).collect()
        };
        let (mut found, expected) = (of(after), of(undisturbed));
        // What is killed may have made the folder alone.
        found.retain(|path| !is_killed || path != name);
        let expected: Vec<String> = expected.into_iter().filter(|path| !is_killed || path != name).collect();
        case.law(found.is_empty() || found == expected, || format!("{name} has {found:?} of {expected:?}"));
        if let (Some(Entry::File(found)), Some(Entry::File(expected))) =
            (after.get(Path::new(name)), undisturbed.get(Path::new(name)))
        {
            // Pages and reports say how long it took, and how it ended.
            let is_whole = match name.rsplit('.').next() {
                Some("html" | "xml") => found.trim_ascii_end().last() == Some(&b'>'),
                Some("csv") => found == expected,
                _ => !found.is_empty(),
            };
            case.law(is_whole, || format!("{name} is half-written"));
        }
    }
}

/// No room: files cannot grow beyond a size, or no more can be opened.
pub fn full(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    let (place, command) = command(random);
    let folder = stock.copy();
    let bounds = match random.chance(0.7) {
        true => Bounds { file_size: Some(random.of(&[0, 1, 2, 4, 8, 16, 40, 100, 300])), ..Bounds::default() },
        false => Bounds { open_files: Some(random.count(4, 16) as u64), ..Bounds::default() },
    };
    let before = snapshot(folder.path());
    let end = ended(program, folder.path(), command.arguments, bounds);
    // With hardly a file that may be open the system may not even load the program.
    let is_loaded = |end: &Ended| !(end.status.code() == Some(127) && end.stderr.contains("error while loading"));
    let end = end.filter(is_loaded);
    let mut case = Case::new(format!("{}, {bounds:?}", command.arguments.join(" ")), end.as_ref());
    if bounds.open_files.is_some_and(|files| files < 8) && end.is_none() {
        case.wrong.clear();
    }
    let after = snapshot(folder.path());
    let partial = half_written(&after);
    case.law(partial.is_empty(), || format!("half-written: {partial:?}"));
    whole(&mut case, stock, place, &before, &after, false);
    case
}

const SIGNALS: [(&str, i32); 4] = [("-INT", 2), ("-TERM", 15), ("-HUP", 1), ("-KILL", 9)];

/// A signal at a random moment of any command.
pub fn signal(program: &Path, stock: &Stock, random: &mut Random) -> Case {
    let (place, command) = command(random);
    let folder = stock.copy();
    let before = snapshot(folder.path());
    let (signal, number) = random.of(&SIGNALS);
    let mut child = process::command(program, folder.path(), command.arguments, Bounds::default());
    let mut child = child.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts");
    std::thread::sleep(Duration::from_secs_f64(random.between(0.0, 1.2 * stock.undisturbed[place].1)));
    let _ = std::process::Command::new("kill").args([signal, &child.id().to_string()]).stderr(Stdio::null()).status();
    let status = waited(&mut child, LIMIT);
    #[cfg(unix)]
    let by_signal = status.and_then(|status| std::os::unix::process::ExitStatusExt::signal(&status)) == Some(number);
    #[cfg(not(unix))]
    let by_signal = false;
    let mut case = Case {
        what: format!("{signal} to {}", command.arguments.join(" ")),
        status: status.and_then(|status| status.code()),
        wrong: Vec::new(),
    };
    case.law(status.is_some(), || "it does not end".to_owned());
    // Before the program listens the system ends it.
    let ends =
        by_signal || matches!(case.status, Some(0 | 3)) || (case.status == Some(128 + number) && signal != "-KILL");
    case.law(ends, || format!("it ends with {status:?}"));
    let after = snapshot(folder.path());
    let partial = half_written(&after);
    case.law(by_signal || partial.is_empty(), || format!("half-written: {partial:?}"));
    let after: Snapshot = after.into_iter().filter(|(path, _)| !partial.contains(path)).collect();
    whole(&mut case, stock, place, &before, &after, by_signal);
    // The same command works afterwards, and clears up.
    let is_taken = COMMANDS[place].writes.iter().any(|name| after.contains_key(Path::new(name)));
    if !is_taken {
        let later = ended(program, folder.path(), command.arguments, Bounds::default());
        let status = later.as_ref().and_then(|later| later.status.code());
        let said = later.map(|later| cut(&later.stderr)).unwrap_or_default();
        case.law(matches!(status, Some(0 | 3)), || format!("a later one ends with {status:?}: {said}"));
        let partial = half_written(&snapshot(folder.path()));
        case.law(partial.is_empty(), || format!("a later one leaves {partial:?}"));
    }
    case
}
