//! Recipes and data with random mistakes in them, given to the program as a user starts it.
//!
//! Laws: the program ends by itself, in 20 s of processor time and bounded memory, with a status that it documents; it never panics; what fails says
//! why, in a message that a terminal can have, and what is refused names its file; nothing half-written stays; what it calls estimated is a number with an uncertainty.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use abbe_core::{harmless, in_parallel};
use serde_json::Value;

use crate::Random;
use crate::machines::Report;
use crate::process::{Bounds, Ended, ended};
use crate::source::Source;

/// Recipes that run within a fraction of a second, of every sort.
const RECIPES: [&str; 28] = [
    "before-the-cut",
    "cmm-checking-gauge",
    "cmm-fifty-lengths",
    "cylinder-kx8-exact",
    "ballbar-c600u-exact",
    "design-2d",
    "first-steps",
    "history-exact",
    "linuxcnc-balls",
    "linuxcnc-table",
    "mfb-ucp710-exact",
    "mill-warming",
    "positioner",
    "probe-lobing",
    "rapid-verify-three-axis",
    "robot-ur5",
    "spindle-motion",
    "sphere-hu40t",
    "standards-ball-bar",
    "standards-circular",
    "standards-cmm",
    "standards-diagonals",
    "standards-positioning",
    "standards-rotary-interpolation",
    "standards-rtest",
    "tango-warming-retrain",
    "thermal-spindle-exact",
    "tool-check",
];

/// Processor time of a case, s.
const PROCESSOR_S: u64 = 20;

/// Bytes of the longest message.
const LONGEST: usize = 1 << 16;

/// Numbers that nobody means.
pub(crate) const NUMBERS: [&str; 28] = [
    "0",
    "-1",
    "1e12",
    "1e308",
    "-1e308",
    "nan",
    ".nan",
    "inf",
    "-.inf",
    "1e-320",
    "99999999999999999999",
    "0x10",
    "1_000",
    "1,5",
    "--1",
    "1e",
    "'1'",
    "true",
    "null",
    "[1]",
    "{a: 1}",
    "4294967296",
    "-0.0",
    "25.4",
    "1e400",
    "0.1.2",
    "",
    "½",
];

/// Texts that editors, spreadsheets and attackers leave in files.
pub(crate) const TEXTS: [&[u8]; 30] = [
    b"\0",
    b"\x1b[2J",
    b"\xc2\x9b31m",
    b"\xe2\x80\xae",
    b"\xef\xbb\xbf",
    b"\t",
    b"&a ",
    b"*a",
    b"<<: *x",
    b"!!int ",
    b"%",
    b"@",
    b"`",
    b"|",
    b"\"",
    b"'",
    b"# ",
    b"---\n",
    b"...\n",
    b"\xc3\xa9",
    b"\xff",
    b"{",
    b"}",
    b"[",
    b"]",
    b": ",
    b"- ",
    b"\r",
    b"\xe2\x80\xa8",
    b",,,,",
];

/// Makes a random mistake in a text; says which.
pub(crate) fn mistake(random: &mut Random, text: &mut Vec<u8>) -> String {
    let kind = random.count(0, 14);
    let lines = |text: &[u8]| text.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect::<Vec<_>>();
    let place = |random: &mut Random, text: &[u8]| random.count(0, text.len() + 1);
    match kind {
        0..=2 => {
            let mut all = lines(text);
            if all.is_empty() {
                return "nothing".to_owned();
            }
            let (one, other) = (random.count(0, all.len()), random.count(0, all.len()));
            match kind {
                0 => drop(all.remove(one)),
                1 => all.insert(other, all[one].clone()),
                _ => all.swap(one, other),
            }
            *text = all.concat();
            format!("line {} {}", one + 1, ["removed", "doubled", "swapped"][kind])
        }
        3 => {
            text.truncate(place(random, text));
            format!("cut off after {} bytes", text.len())
        }
        4 | 5 => {
            let (at, what) = (place(random, text), random.of(&TEXTS));
            text.splice(at..at, what.iter().copied());
            format!("{what:?} inserted at {at}")
        }
        6..=8 => {
            let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"-+._".contains(byte);
            let is_number = |word: &[u8]| std::str::from_utf8(word).is_ok_and(|word| word.parse::<f64>().is_ok());
            let words = words(text, is_word);
            let numbers: Vec<(usize, usize)> =
                words.iter().copied().filter(|&(from, to)| is_number(&text[from..to])).collect();
            let from_these = if kind == 6 { &numbers } else { &words };
            if from_these.is_empty() {
                return "nothing".to_owned();
            }
            let (from, to) = random.of(from_these);
            let new = match kind {
                6 => random.of(&NUMBERS).as_bytes().to_vec(),
                7 => {
                    let (from, to) = random.of(&words);
                    text[from..to].to_vec()
                }
                _ => misspelt(random, &text[from..to]),
            };
            let told = format!(
                "{:?} for {:?} at {from}",
                String::from_utf8_lossy(&new),
                String::from_utf8_lossy(&text[from..to])
            );
            text.splice(from..to, new);
            told
        }
        9 => {
            let (from, to) =
                random.of(&[(b',', b';'), (b',', b'\t'), (b'.', b','), (b':', b'='), (b' ', b'\t'), (b'-', b' ')]);
            text.iter_mut().filter(|byte| **byte == from).for_each(|byte| *byte = to);
            format!("every {:?} is {:?}", char::from(from), char::from(to))
        }
        10 => {
            let end = random.of(&[&b"\r"[..], b"\r\n", b"", b"\n\n", b"\r\r\n", b" \n"]);
            *text = text.split(|byte| *byte == b'\n').collect::<Vec<_>>().join(end);
            format!("lines end in {end:?}")
        }
        11 => {
            let (one, other) = (place(random, text), place(random, text));
            text[one.min(other)..one.max(other)].fill(random.of(&[0, b' ', b'a', b'9', b'[', 0xff]));
            "a part is one byte again and again".to_owned()
        }
        12 => {
            let (at, what) = (place(random, text), random.of(b"x9[,{\"\n "));
            text.splice(at..at, std::iter::repeat_n(what, random.of(&[100, 10_000, 100_000])));
            format!("{:?} very often at {at}", char::from(what))
        }
        _ => {
            let at = place(random, text);
            let to = (at + random.count(1, 40)).min(text.len());
            text.drain(at..to);
            format!("{at} to {to} removed")
        }
    }
}

/// Where the words of a text begin and end.
fn words(text: &[u8], is_word: impl Fn(&u8) -> bool) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut start = None;
    for (at, byte) in text.iter().chain([&b'\n']).enumerate() {
        match (is_word(byte), start) {
            (true, None) => start = Some(at),
            (false, Some(from)) => {
                found.push((from, at));
                start = None;
            }
            _ => {}
        }
    }
    found
}

fn misspelt(random: &mut Random, word: &[u8]) -> Vec<u8> {
    let mut word = word.to_vec();
    let at = random.count(0, word.len());
    match random.count(0, 4) {
        0 => drop(word.remove(at)),
        1 => word.insert(at, word[at]),
        2 => word[at] = b'q',
        _ => word.reverse(),
    }
    word
}

/// What may stand where a file was.
const OBJECTS: [&str; 11] = [
    "nothing",
    "a folder",
    "a pipe",
    "a device",
    "a link to itself",
    "a link to nothing",
    "a link to a pipe",
    "a socket",
    "zeros",
    "an endless line",
    "random bytes",
];

/// Something else stands where a file was; says what.
pub(crate) fn replaced(random: &mut Random, file: &Path) -> String {
    fs::remove_file(file).expect("the file was there");
    let what = random.of(&OBJECTS);
    match what {
        "a folder" => fs::create_dir(file).expect("a folder"),
        #[cfg(unix)]
        "a pipe" => assert!(Command::new("mkfifo").arg(file).status().expect("mkfifo").success()),
        #[cfg(unix)]
        "a device" => std::os::unix::fs::symlink("/dev/zero", file).expect("a link"),
        #[cfg(unix)]
        "a link to itself" => std::os::unix::fs::symlink(file, file).expect("a link"),
        #[cfg(unix)]
        "a link to nothing" => std::os::unix::fs::symlink("nowhere", file).expect("a link"),
        #[cfg(unix)]
        "a link to a pipe" => {
            let pipe = file.with_extension("pipe");
            assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
            std::os::unix::fs::symlink(pipe.file_name().expect("a name"), file).expect("a link");
        }
        #[cfg(unix)]
        "a socket" => drop(std::os::unix::net::UnixListener::bind(file).expect("a socket")),
        "random bytes" => {
            let bytes: Vec<u8> = (0..random.count(1, 5000)).map(|_| random.count(0, 256) as u8).collect();
            fs::write(file, bytes).expect("a file");
        }
        // Most of a disk, in a file with a hole.
        "zeros" => File::create(file).and_then(|file| file.set_len(40 << 30)).expect("a file with a hole"),
        "an endless line" => fs::write(file, vec![b'a'; 20 << 20]).expect("a long line"),
        _ => {}
    }
    what.to_owned()
}

/// What is wrong with how the program ended, and with what it has left in the folder `out`.
pub(crate) fn wrong(ended: Option<&Ended>, folder: &Path) -> Vec<String> {
    let Some(Ended { status, stdout, stderr }) = ended else { return vec!["it does not end".to_owned()] };
    let mut wrong = Vec::new();
    let mut law = |holds: bool, what: String| {
        if !holds {
            wrong.push(what)
        }
    };
    law(status.code().is_some_and(|status| (0..=3).contains(&status)), format!("{status}"));
    law(!stderr.contains("panicked"), "it panics".to_owned());
    law(*stderr == harmless(stderr) && *stdout == harmless(stdout), "a terminal would obey what it says".to_owned());
    law(stderr.len() <= LONGEST, format!("it says {} bytes", stderr.len()));
    let failed = matches!(status.code(), Some(1 | 2));
    law(!failed || !stderr.is_empty() || !stdout.is_empty(), "it fails without a word".to_owned());
    let left = |folder: &Path| -> Vec<PathBuf> {
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
    };
    let out = left(&folder.join("out"));
    law(
        out.iter().all(|path| !path.to_string_lossy().contains("abbe-partial")),
        "something half-written stays".to_owned(),
    );
    law(status.code() != Some(2) || out.is_empty(), "there are results of a refused recipe".to_owned());
    for calibration in
        out.iter().flat_map(|folder| left(folder)).filter(|file| file.to_string_lossy().ends_with(".calibration.json"))
    {
        let text = fs::read_to_string(&calibration).unwrap_or_default();
        let Ok(calibration) = serde_json::from_str::<Value>(&text) else {
            law(false, "a calibration is no JSON".to_owned());
            continue;
        };
        for parameter in ["parameters", "artefacts"].into_iter().filter_map(|key| calibration[key].as_array()).flatten()
        {
            let is_number = parameter["value"].as_f64().is_some_and(f64::is_finite);
            let uncertainty = parameter["standard_uncertainty"].as_f64();
            let is_known = parameter["status"] != "estimated" || uncertainty.is_some_and(|u| u > 0.0 && u.is_finite());
            law(is_number && is_known, format!("{parameter} is called estimated"));
        }
    }
    wrong
}

/// What a refusal names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Nowhere,
    File,
    Line,
}

/// What the message of a refusal names: a file of the case, and a line in it.
fn place(ended: &Ended, source: &Source) -> Place {
    let said = format!("{}{}", ended.stdout, ended.stderr);
    let names = source.files.keys().filter_map(|file| file.file_name()).map(|name| name.to_string_lossy());
    let mut found = Place::Nowhere;
    for name in names {
        for (at, _) in said.match_indices(&*name) {
            let is_line = said[at + name.len()..]
                .strip_prefix(':')
                .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()));
            if is_line {
                return Place::Line;
            }
            found = Place::File;
        }
    }
    found
}

struct Case {
    what: String,
    status: Option<i32>,
    wrong: Vec<String>,
    /// Of what is refused.
    place: Option<Place>,
    seconds: f64,
}

fn case(program: &Path, sources: &[Source], seed: u64, number: u64) -> Case {
    let mut random = Random::new(seed, number);
    let source = &sources[random.count(0, sources.len())];
    let folder = tempfile::tempdir().expect("a temporary folder");
    source.write(folder.path());
    let files: Vec<&PathBuf> = source.files.keys().collect();
    let file = if random.chance(0.4) { source.recipe() } else { random.of(&files).clone() };
    let path = folder.path().join(&file);
    let what = if random.chance(0.05) {
        replaced(&mut random, &path)
    } else {
        let mut text = source.files[&file].clone();
        let count = if random.chance(0.8) { 1 } else { 3 };
        let told: Vec<String> = (0..count).map(|_| mistake(&mut random, &mut text)).collect();
        fs::write(&path, text).expect("the file can be written");
        told.join("; ")
    };
    let recipe = format!("{}.yaml", source.name);
    let arguments: &[&str] = match random.count(0, 10) {
        0 | 1 => &["check", &recipe],
        2 => &["run", &recipe, "--out", "out", "--json"],
        _ => &["run", &recipe, "--out", "out"],
    };
    let start = Instant::now();
    let bounds = Bounds { processor_s: Some(PROCESSOR_S), ..Bounds::default() };
    let ended = ended(program, folder.path(), arguments, bounds);
    let mut wrong = wrong(ended.as_ref(), folder.path());
    let place = ended.as_ref().filter(|ended| ended.status.code() == Some(2)).map(|ended| place(ended, source));
    if place == Some(Place::Nowhere) {
        wrong.push("it names no file".to_owned());
    }
    Case {
        what: format!("{number}: {} {recipe}, {}: {what}", arguments[0], file.display()),
        status: ended.as_ref().and_then(|ended| ended.status.code()),
        wrong,
        place,
        seconds: start.elapsed().as_secs_f64(),
    }
}

/// Runs `count` cases; `program` is a program whose `main` is that of Abbe if `ABBE_CAMPAIGN_PROGRAM` is set.
pub fn run(program: &Path, seed: u64, count: u64) -> Report {
    let sources: Vec<Source> = RECIPES.into_iter().map(Source::read).collect();
    let numbers: Vec<u64> = (0..count).collect();
    let cases = in_parallel(&numbers, None, |&number| case(program, &sources, seed, number));
    let statuses: BTreeSet<Option<i32>> = cases.iter().map(|case| case.status).collect();
    let mut text = String::new();
    for status in statuses {
        let of_status = cases.iter().filter(|case| case.status == status).count();
        let name = status.map_or("none".to_owned(), |status| status.to_string());
        text.push_str(&format!("status {name}: {of_status}\n"));
    }
    let refused = |place| cases.iter().filter(|case| case.place == Some(place)).count();
    text.push_str(&format!("refused with a line {}, with a file {}\n", refused(Place::Line), refused(Place::File)));
    let slowest = cases.iter().max_by(|a, b| a.seconds.total_cmp(&b.seconds));
    if let Some(slowest) = slowest {
        text.push_str(&format!("slowest: {:.1} s, {}\n", slowest.seconds, slowest.what));
    }
    let broken: Vec<String> = (cases.iter().filter(|case| !case.wrong.is_empty()))
        .map(|case| format!("{}: {}", case.what, case.wrong.join("; ")))
        .collect();
    text.push_str(&format!("{count} bad inputs, seed {seed}: {} broken\n", broken.len()));
    broken.iter().for_each(|line| text.push_str(&format!("  {}\n", harmless(line))));
    Report { text, broken }
}
