//! What reads bytes of others, given bytes that nobody meant: seeds of the repository with random changes, in this process.
//!
//! Laws: no panic, no number that overflows, no access outside of a list (this is built with the checks of debug builds by `cargo build`),
//! no reading that takes long, and what is refused is refused with words.
//!
//! The targets are functions, so that cargo-fuzz can run them too (`tests/fuzz`). Here changes are made without looking at what the
//! program does with them.

mod mutator;
mod plugins;
mod programs;
mod readers;
mod seeds;
mod texts;

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

use abbe_core::harmless;

use crate::Random;
use crate::machines::Report;

/// Bytes of the longest input.
pub const LONGEST: usize = 1 << 14;

/// How long one input may take.
const SLOW: Duration = Duration::from_secs(10);

/// Of how many inputs the kinds of refusal are counted: few of them mean that inputs end at the first check.
const DEPTH_SHOWN: u64 = 20_000;

/// Whether an input was taken, or why it was refused.
pub type Answer = Result<(), String>;

/// Reads an input.
type Read = Box<dyn Fn(&[u8]) -> Answer>;

/// Something that reads bytes.
pub struct Target {
    /// Its name.
    pub name: String,
    /// Inputs to begin with.
    pub seeds: Vec<Vec<u8>>,
    read: Read,
}

impl Target {
    fn new(name: &str, seeds: Vec<Vec<u8>>, read: impl Fn(&[u8]) -> Answer + 'static) -> Self {
        Self { name: name.to_owned(), seeds, read: Box::new(read) }
    }

    /// Gives it one input. Panics where the code under test does, and for a refusal without a word.
    pub fn read(&self, input: &[u8]) -> Answer {
        let answer = (self.read)(&input[..input.len().min(LONGEST)]);
        assert!(answer.as_ref().err().is_none_or(|why| !why.trim().is_empty()), "it is refused without a word");
        answer
    }
}

/// A refusal without what it quotes, and without numbers.
fn kind_of(refusal: &str) -> String {
    let outside = refusal.split(['`', '"', '\'']).step_by(2);
    let words =
        outside.flat_map(str::split_whitespace).filter(|word| word.bytes().all(|byte| byte.is_ascii_alphabetic()));
    words.take(12).collect::<Vec<_>>().join(" ")
}

/// All targets.
pub fn targets() -> Vec<Target> {
    [texts::targets(), readers::targets(), programs::targets(), plugins::targets()].into_iter().flatten().collect()
}

/// The target of a name.
pub fn target(name: &str) -> Target {
    let found = targets().into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("there is no target `{name}`"))
}

/// Writes the seeds of all targets, a folder for each.
pub fn write_seeds(folder: &Path) {
    for target in targets() {
        let own = folder.join(&target.name);
        std::fs::create_dir_all(&own).expect("a folder");
        for (number, seed) in target.seeds.iter().enumerate() {
            std::fs::write(own.join(number.to_string()), seed).expect("a seed can be written");
        }
    }
}

/// How long it takes to read an input, once more.
fn time_of(target: &Target, input: &[u8]) -> Duration {
    let clock = Instant::now();
    let _ = target.read(input);
    clock.elapsed()
}

/// Runs `count` inputs on each target, or on that of a name. What breaks a law is kept in `kept`, a folder.
pub fn run(seed: u64, count: u64, name: Option<&str>, kept: &Path) -> Report {
    let (mut text, mut broken, mut all) = (String::new(), Vec::new(), 0);
    let targets: Vec<Target> =
        targets().into_iter().filter(|target| name.is_none_or(|name| name == target.name)).collect();
    if targets.is_empty() {
        return Report { text: "there is no such target\n".to_owned(), broken: vec!["no target".to_owned()] };
    }
    for (number, target) in targets.iter().enumerate() {
        let start = Instant::now();
        let (mut taken, mut slowest, mut refusals) = (0_u64, Duration::ZERO, BTreeSet::new());
        for case in 0..count {
            let mut random = Random::new(seed ^ (number as u64 + 1) << 40, case);
            let input = mutator::input(&mut random, &target.seeds);
            let clock = Instant::now();
            let answer = catch_unwind(AssertUnwindSafe(|| target.read(&input)));
            slowest = slowest.max(clock.elapsed());
            let wrong = match answer {
                Ok(answer) => {
                    taken += u64::from(answer.is_ok());
                    if let (Err(why), 0..DEPTH_SHOWN) = (&answer, case) {
                        refusals.insert(kind_of(why));
                    }
                    // On a machine that does other work anything may take long once.
                    (clock.elapsed() > SLOW && time_of(target, &input) > SLOW).then_some("it takes long")
                }
                Err(_) => Some("it panics"),
            };
            if let Some(wrong) = wrong {
                let file = kept.join(format!("{}-{seed}-{case}", target.name));
                let written = std::fs::create_dir_all(kept).and_then(|()| std::fs::write(&file, &input));
                let place = written.map_or_else(|error| error.to_string(), |()| file.display().to_string());
                broken.push(format!("{} {case}: {wrong} ({place})", target.name));
            }
        }
        all += count;
        text.push_str(&format!(
            "{:<20} {count} executions, {taken} taken, {} kinds of refusal, {:.1} s, the slowest {:.3} s\n",
            target.name,
            refusals.len(),
            start.elapsed().as_secs_f64(),
            slowest.as_secs_f64()
        ));
    }
    text.push_str(&format!("{all} executions, seed {seed}: {} broken\n", broken.len()));
    broken.iter().for_each(|line| text.push_str(&format!("  {}\n", harmless(line))));
    Report { text, broken }
}
