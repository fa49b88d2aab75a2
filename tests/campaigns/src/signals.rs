//! Signals at random moments of a run whose results take the place of older ones.
//!
//! Laws: the program ends within seconds with the status of the signal, or by itself before; the folder has all old results or all
//! new ones; what a killed run leaves is gone after the next one.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use abbe_core::in_parallel;
use sha2::{Digest, Sha256};

use crate::Random;
use crate::machines::Report;
use crate::process::waited;
use crate::source::pipelines;

/// The signals with their names for `kill`.
const SIGNALS: [(&str, i32); 4] = [("-INT", 2), ("-TERM", 15), ("-HUP", 1), ("-KILL", 9)];

/// How long the program may take to end. A machine that does other things, too, is slow.
const LIMIT: Duration = Duration::from_secs(60);

/// A recipe that runs within a fraction of a second.
const RECIPE: &str = "first-steps";

/// All files under a folder with their contents.
type Files = BTreeMap<PathBuf, Vec<u8>>;

fn files(folder: &Path) -> Files {
    let mut found = Files::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => found.extend(files(&path)),
            false => drop(found.insert(path.clone(), fs::read(&path).unwrap_or_default())),
        }
    }
    found
}

fn sha256(content: &[u8]) -> String {
    Sha256::digest(content).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The recipe with other uncertainties: no result file has the content that it has of the recipe itself.
fn older_recipe(folder: &Path) -> PathBuf {
    let text = fs::read_to_string(pipelines().join(format!("{RECIPE}.yaml"))).expect("a recipe");
    let data = format!("{}/data/", pipelines().display());
    let changed = text.replace("data/", &data).replace("standard_uncertainty_um: 1.6", "standard_uncertainty_um: 3.2");
    assert!(changed.contains("3.2"), "the recipe states an uncertainty");
    let file = folder.join(format!("{RECIPE}.yaml"));
    fs::write(&file, changed).expect("a recipe");
    file
}

fn start(program: &Path, out: &Path) -> Child {
    start_recipe(program, &pipelines().join(format!("{RECIPE}.yaml")), out)
}

fn start_recipe(program: &Path, recipe: &Path, out: &Path) -> Child {
    let mut command = Command::new(program);
    command.arg("run").arg(recipe).arg("--out").arg(out).env("ABBE_CAMPAIGN_PROGRAM", "1");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

/// What is wrong after a signal at a random moment of a run, and how the run ended.
fn case(program: &Path, seconds: f64, seed: u64, number: u64) -> (String, Vec<String>) {
    let mut random = Random::new(seed, number);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("out");
    let mut wrong = Vec::new();
    let mut law = |holds: bool, what: String| {
        if !holds {
            wrong.push(what)
        }
    };
    let has_older = random.chance(0.7);
    if has_older {
        let older = waited(&mut start_recipe(program, &older_recipe(folder.path()), &out), LIMIT);
        law(older.is_some_and(|status| status.success()), format!("an undisturbed run ends with {older:?}"));
        fs::write(out.join(RECIPE).join("notes.txt"), "mine").expect("a note");
    }
    let before = files(&out);
    let (signal, signal_number) = random.of(&SIGNALS);
    let mut child = start(program, &out);
    std::thread::sleep(Duration::from_secs_f64(random.between(0.0, 1.2 * seconds)));
    let _ = Command::new("kill").args([signal, &child.id().to_string()]).stderr(Stdio::null()).status();
    let Some(status) = waited(&mut child, LIMIT) else {
        return (signal.to_owned(), vec!["it does not end".to_owned()]);
    };
    // Before the program listens, the system ends it.
    #[cfg(unix)]
    let by_signal = std::os::unix::process::ExitStatusExt::signal(&status) == Some(signal_number);
    #[cfg(not(unix))]
    let by_signal = false;
    let ends = by_signal || status.success() || status.code() == Some(128 + signal_number) && signal != "-KILL";
    law(ends, format!("{signal}: {status}"));
    let is_partial = |path: &&PathBuf| path.to_string_lossy().contains("abbe-partial");
    let after = files(&out);
    law(
        signal == "-KILL" || by_signal || !after.keys().any(|path| is_partial(&path)),
        format!("{signal}: half-written files stay"),
    );
    // A note may have two names while the folders change places; it is never gone.
    let of_run: Files = after.into_iter().filter(|(path, _)| path.starts_with(out.join(RECIPE))).collect();
    let has_note =
        |files: &Files| files.iter().any(|(path, content)| path.ends_with("notes.txt") && content == b"mine");
    law(!has_older || has_note(&of_run), format!("{signal}: a note is gone"));
    let is_old = of_run == before;
    let record =
        of_run.get(&out.join(RECIPE).join("run.json")).map(|text| serde_json::from_slice::<serde_json::Value>(text));
    // What is listed has the content that is listed.
    let is_whole = match record {
        Some(Ok(record)) => record["outputs"].as_array().is_some_and(|outputs| {
            let has_content = |output: &serde_json::Value| {
                let found = output["file"].as_str().and_then(|file| of_run.get(&out.join(RECIPE).join(file)));
                found.is_some_and(|content| output["sha256"].as_str() == Some(&sha256(content)))
            };
            !outputs.is_empty() && outputs.iter().all(has_content)
        }),
        _ => false,
    };
    law(is_old || is_whole, format!("{signal}: neither old nor new results: {:?}", of_run.keys()));
    // A later run clears up.
    let later = waited(&mut start(program, &out), LIMIT);
    law(later.is_some_and(|status| status.success()), format!("a later run ends with {later:?}"));
    let left: Vec<PathBuf> = files(&out).into_keys().filter(|path| is_partial(&path)).collect();
    law(left.is_empty(), format!("{signal}: a later run leaves {left:?}"));
    let end = if status.success() { "by itself" } else { "by the signal" };
    (format!("{signal} {end}"), wrong)
}

/// Runs `count` cases; `program` is a program whose `main` is that of Abbe if `ABBE_CAMPAIGN_PROGRAM` is set.
pub fn run(program: &Path, seed: u64, count: u64) -> Report {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let clock = Instant::now();
    let undisturbed = waited(&mut start(program, folder.path()), LIMIT);
    let seconds = clock.elapsed().as_secs_f64();
    assert!(undisturbed.is_some_and(|status| status.success()), "the recipe runs");
    let numbers: Vec<u64> = (0..count).collect();
    let cases = in_parallel(&numbers, None, |&number| case(program, seconds, seed, number));
    let mut ends: BTreeMap<&str, usize> = BTreeMap::new();
    cases.iter().for_each(|(end, _)| *ends.entry(end).or_default() += 1);
    let mut text: String = ends.iter().map(|(end, count)| format!("{end}: {count}\n")).collect();
    let mut broken: Vec<String> = (cases.iter().enumerate().filter(|(_, (_, wrong))| !wrong.is_empty()))
        .map(|(number, (_, wrong))| format!("{number}: {}", wrong.join("; ")))
        .collect();
    if !ends.keys().any(|end| end.ends_with("by the signal")) {
        broken.push("no run was ended by its signal".to_owned());
    }
    text.push_str(&format!("{count} signals, seed {seed}: {} broken\n", broken.len()));
    broken.iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    Report { text, broken }
}
