//! Everything around the program that may go wrong, on commands and recipes taken at random: files that are none, files of others
//! beside results, full disks, signals, calibrations that no machine has, numbers and texts beyond measure.
//!
//! Laws: the program ends by itself, in bounded time and memory, with a status that it documents, and without a panic; what fails says
//! why, and names the file; nothing of others is lost, nothing half-written stays; an absurd calibration fails or is told.

mod absurd;
mod bounds;
mod files;
mod snapshot;
mod stock;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use abbe_core::{harmless, in_parallel};

use crate::Random;
use crate::machines::Report;
use crate::process::Ended;
use stock::Stock;

/// What is tried.
type Kind = fn(&Path, &Stock, &mut Random) -> Case;

/// The kinds of cases, by name; how often each is tried.
const KINDS: [(&str, Kind, usize); 8] = [
    ("a file that is none", files::input, 5),
    ("an output that is taken", files::output, 3),
    ("files of others beside results", files::beside, 2),
    ("a full disk", files::full, 3),
    ("a signal", files::signal, 3),
    ("an absurd calibration", absurd::case, 4),
    ("a number beyond measure", bounds::number, 4),
    ("a text beyond measure", bounds::text, 4),
];

/// One case.
pub(crate) struct Case {
    /// What was done.
    what: String,
    /// Status of the program; none if it was ended.
    status: Option<i32>,
    /// The laws that it breaks.
    wrong: Vec<String>,
}

impl Case {
    fn new(what: String, ended: Option<&Ended>) -> Self {
        let status = ended.and_then(|ended| ended.status.code());
        let mut case = Self { what, status, wrong: Vec::new() };
        match ended {
            None => case.wrong.push("it does not end".to_owned()),
            Some(ended) => case.usual(ended),
        }
        case
    }

    fn law(&mut self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.wrong.push(what());
        }
    }

    /// Laws of every end.
    fn usual(&mut self, ended: &Ended) {
        let Ended { status, stdout, stderr } = ended;
        self.law(status.code().is_some_and(|status| (0..=3).contains(&status)), || {
            format!("{status}: {}", cut(stderr))
        });
        self.law(!stderr.contains("panicked"), || format!("it panics: {}", cut(stderr)));
        let is_harmless = *stderr == harmless(stderr) && *stdout == harmless(stdout);
        self.law(is_harmless, || "a terminal would obey what it says".to_owned());
        self.law(stderr.len() < 1 << 16, || format!("it says {} bytes", stderr.len()));
        let failed = matches!(status.code(), Some(1 | 2));
        self.law(!failed || !stderr.is_empty() || !stdout.is_empty(), || "it fails without a word".to_owned());
    }

    /// A word has to stand in what is said.
    fn names(&mut self, ended: Option<&Ended>, word: &str) {
        let Some(Ended { stdout, stderr, .. }) = ended else { return };
        let said = [stdout, stderr].map(|said| said.split_whitespace().collect::<String>());
        let word: String = word.split_whitespace().collect();
        self.law(said.iter().any(|said| said.contains(&word)), || format!("`{word}` is not named: {}", cut(stderr)));
    }
}

/// The beginning of a message, in one line.
fn cut(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(400).collect()
}

/// Runs `count` cases; `program` is a program whose `main` is that of Abbe if `ABBE_CAMPAIGN_PROGRAM` is set.
pub fn run(program: &Path, seed: u64, count: u64) -> Report {
    let stock = Stock::new(program);
    let kinds: Vec<(&str, Kind)> =
        KINDS.iter().flat_map(|(name, kind, often)| std::iter::repeat_n((*name, *kind), *often)).collect();
    let numbers: Vec<u64> = (0..count).collect();
    let cases = in_parallel(&numbers, None, |&number| {
        let mut random = Random::new(seed, number);
        // Every kind comes in its turn.
        let (name, kind) = kinds[number as usize % kinds.len()];
        let start = Instant::now();
        (name, kind(program, &stock, &mut random), start.elapsed().as_secs_f64())
    });
    let mut by_kind: BTreeMap<&str, BTreeMap<String, usize>> = BTreeMap::new();
    for (name, case, _) in &cases {
        let status = case.status.map_or("none".to_owned(), |status| status.to_string());
        *by_kind.entry(name).or_default().entry(status).or_default() += 1;
    }
    let mut text = String::new();
    for (name, statuses) in by_kind {
        let ends: Vec<String> = statuses.iter().map(|(status, count)| format!("status {status}: {count}")).collect();
        text.push_str(&format!("{name}: {} cases; {}\n", statuses.values().sum::<usize>(), ends.join(", ")));
    }
    if let Some((name, case, seconds)) = cases.iter().max_by(|one, other| one.2.total_cmp(&other.2)) {
        text.push_str(&format!("slowest: {seconds:.1} s, {name}: {}\n", case.what));
    }
    let broken: Vec<String> = (cases.iter().enumerate().filter(|(_, (_, case, _))| !case.wrong.is_empty()))
        .map(|(number, (name, case, _))| format!("{number}: {name}: {}: {}", case.what, case.wrong.join("; ")))
        .collect();
    text.push_str(&format!("{count} hostile cases, seed {seed}: {} broken\n", broken.len()));
    broken.iter().for_each(|line| text.push_str(&format!("  {}\n", harmless(line))));
    Report { text, broken }
}
