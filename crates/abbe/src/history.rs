//! `abbe history`: keeps the results of runs, and tells what they say about a machine over time.

mod check;
mod place;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use abbe_core::{Calibration, Error, Result, Verdict};
use abbe_engine::{CALIBRATION, Outcome, RunRecord, VERDICTS, can_write_folder, write_folder};
use abbe_files::{LARGEST_RESULT, read_text};
use abbe_history::{Added, Entry, History, Stored};
use abbe_recipe::HistoryPlace;
use clap::{Args, Subcommand};
use serde_json::{Value, json};

pub use check::Check;
#[cfg(feature = "serve")]
pub use check::{Question, estimate_of};
use place::{add_all, named};
pub use place::{can_add, read};

use crate::interrupt;
use crate::libraries::Libraries;

/// What is done with a history.
#[derive(Subcommand)]
pub enum Asked {
    /// Add the results of runs. What is there already is not added again.
    Add(Add),
    /// List the entries and the machines.
    List {
        /// The history.
        history: PathBuf,
    },
    /// Show an entry.
    Show {
        /// The history.
        history: PathBuf,
        /// Number of the entry.
        entry: i64,
    },
    /// Say what has changed on a machine, since when, and when to measure again. Exit status 3 on an alarm.
    Check(Check),
    /// Write the calibrations of an entry as files.
    Export {
        /// The history.
        history: PathBuf,
        /// Number of the entry.
        entry: i64,
        /// Folder to write. It must be empty, or not exist.
        #[arg(long)]
        out: PathBuf,
    },
}

/// Results to add.
#[derive(Args)]
pub struct Add {
    /// The history: an SQLite file, which is made if it is not there, or `postgres://USER@HOST/DATABASE`.
    history: PathBuf,
    /// Folders that `abbe run` wrote.
    #[arg(required = true)]
    results: Vec<PathBuf>,
    /// Name of the machine. Default: the name in its description, or else that of the recipe.
    #[arg(long)]
    machine: Option<String>,
    /// Date of the measurement, as 2026-03-02, or the number of its day. Default: the day of the run. Groups (`per`) have their own
    /// times.
    #[arg(long)]
    date: Option<String>,
}

impl Asked {
    /// Does it; gives what to print and the exit status.
    pub fn run(self, libraries: &Libraries) -> Result<(String, u8)> {
        match self {
            Self::Add(add) => add.run().map(|text| (text, 0)),
            Self::List { history } => list(&read(&history)?).map(|text| (text, 0)),
            Self::Show { history, entry } => show(&found(&history, entry)?, entry).map(|text| (text, 0)),
            Self::Check(check) => check.run(libraries),
            Self::Export { history, entry, out } => export(&found(&history, entry)?, &out).map(|text| (text, 0)),
        }
    }

    /// Whether the output is for programs.
    pub fn is_json(&self) -> bool {
        matches!(self, Self::Check(Check { json: true, .. }))
    }
}

/// Adds what a run found, as the key `history` of a recipe asks for.
pub fn add_outcome(place: &HistoryPlace, outcome: &Outcome) -> Result<Added> {
    let record = outcome.record();
    let calibrations: Vec<(String, Calibration)> =
        outcome.fits.iter().map(|fit| (fit.name.clone(), fit.calibration.clone())).collect();
    let entry = entry(&record, calibrations, outcome.verdicts.clone(), None, None)?;
    Ok(add_all(place, &[entry])?.swap_remove(0))
}

impl Add {
    fn run(self) -> Result<String> {
        if self.machine.as_ref().is_some_and(|machine| machine.trim().is_empty()) {
            return Err(
                Error::usage("--machine: a name was expected").help("without `--machine` its description names it")
            );
        }
        let place = named(&self.history)?;
        can_add(&place)?;
        // Everything is read before the first entry is added.
        let read = |folder: &PathBuf| self.read(folder);
        let entries: Vec<Entry> = self.results.iter().map(read).collect::<Result<_>>()?;
        let mut text = String::new();
        for ((folder, entry), added) in self.results.iter().zip(&entries).zip(add_all(&place, &entries)?) {
            let folder = folder.display();
            let _ = match added {
                Added::New(number) => {
                    writeln!(text, "{folder}: entry {number}, {} calibrations", entry.calibrations.len())
                }
                Added::Known(number) => writeln!(text, "{folder}: is entry {number} already"),
            };
        }
        Ok(text)
    }

    fn read(&self, folder: &Path) -> Result<Entry> {
        let path = folder.join("run.json");
        let text = read_text(&path, LARGEST_RESULT).map_err(|error| {
            Error::usage(format!("{} holds no results of a run: run.json: {error}", folder.display()))
                .help("name a folder that `abbe run` wrote")
        })?;
        let record = RunRecord::from_json(&text).map_err(|error| error.in_file(&path))?;
        let verdicts = Verdict::list_from_json(&record.written_text(folder, VERDICTS)?)?;
        if record.outputs.is_empty() {
            let error = Error::data("`outputs` names no file: the run left nothing to keep").in_file(&path);
            return Err(error.help("name a folder as `abbe run` wrote it"));
        }
        let names = record.outputs.iter().filter_map(|output| output.file.strip_suffix(CALIBRATION));
        let calibration = |name: &str| {
            let file = format!("{name}{CALIBRATION}");
            let text = record.written_text(folder, &file)?;
            let read = Calibration::from_json(&text).map_err(|error| error.in_file(&folder.join(&file)));
            Ok((name.to_owned(), read?))
        };
        let calibrations = names.map(calibration).collect::<Result<Vec<_>>>()?;
        entry(&record, calibrations, verdicts, self.machine.as_deref(), self.date.as_deref())
    }
}

/// The entry of a run.
fn entry(
    record: &RunRecord,
    calibrations: Vec<(String, Calibration)>,
    verdicts: Vec<Verdict>,
    machine: Option<&str>,
    date: Option<&str>,
) -> Result<Entry> {
    if calibrations.is_empty() {
        return Err(Error::data(format!("the run of `{}` gave no calibration to keep", record.recipe)));
    }
    let at = match date {
        Some(date) => day(date)?,
        None => (record.started_unix_s / 86_400) as f64,
    };
    let stored = |(_, calibration): (String, Calibration)| {
        let own = calibration.model.settings.get("name").and_then(Value::as_str);
        let own = own.filter(|name| !name.trim().is_empty());
        let machine = machine.or(own).unwrap_or(&record.recipe).to_owned();
        match calibration.group.clone() {
            Some(group) => Stored { machine, label: group.label, at: group.at, unit: group.unit, calibration },
            None => Stored { machine, label: date_of(at), at, unit: "day".to_owned(), calibration },
        }
    };
    let inputs = serde_json::to_value(&record.inputs).unwrap_or(Value::Null);
    let plugins = serde_json::to_value(&record.plugins).unwrap_or(Value::Null);
    Ok(Entry {
        recipe: record.recipe.clone(),
        calibrations: calibrations.into_iter().map(stored).collect(),
        verdicts,
        evidence: json!({ "inputs": inputs, "plugins": plugins, "version": record.version }),
    })
}

/// Most days from 1970-01-01 that a number means: the year 2243. `20260302` is no day, but a date without its lines.
const FARTHEST_DAY: f64 = 1e5;

/// A day from 1970-01-01: a number, or a date.
fn day(text: &str) -> Result<f64> {
    let number = text.parse().ok().filter(|day: &f64| day.abs() <= FARTHEST_DAY);
    number.or_else(|| abbe_engine::day_of(text)).ok_or_else(|| {
        Error::usage(format!("`{text}` is no date: one as 2026-03-02 was expected, or the number of a day"))
    })
}

/// The date of a day from 1970-01-01 (Hinnant, chrono-compatible low-level date algorithms, 2021); a part of a day stays.
fn date_of(day: f64) -> String {
    if day.fract() != 0.0 || day.abs() > 1e6 {
        return day.to_string();
    }
    let shifted = day as i64 + 719_468;
    let era = shifted.div_euclid(146_097);
    let of_era = shifted.rem_euclid(146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let date = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    format!("{:04}-{month:02}-{date:02}", year + era * 400 + i64::from(month <= 2))
}

fn found(place: &Path, entry: i64) -> Result<Entry> {
    let history = read(place)?;
    let last = history.entries()?.last().map_or(0, |(number, _, _)| *number);
    let missing = || Error::usage(format!("the history {} has no entry {entry}; the last is {last}", history.name()));
    history.entry(entry)?.ok_or_else(|| missing().help("`abbe history list` shows its entries"))
}

fn list(history: &History) -> Result<String> {
    let mut text = String::new();
    for (number, sha256, recipe) in history.entries()? {
        let _ = writeln!(text, "{number:6}  {}  {recipe}", &sha256[..sha256.len().min(12)]);
    }
    for (machine, count) in history.machines()? {
        let _ = writeln!(text, "{machine}: {count} calibrations");
    }
    Ok(text)
}

fn show(entry: &Entry, number: i64) -> Result<String> {
    let mut text = format!("entry {number}: {}, {}\n", entry.recipe, entry.sha256()?);
    for stored in &entry.calibrations {
        let Stored { machine, label, unit, calibration, .. } = stored;
        let _ = writeln!(
            text,
            "  {machine}, {unit} {label}: {} with {} parameters",
            calibration.estimate,
            calibration.parameters.len()
        );
    }
    for verdict in &entry.verdicts {
        let _ = writeln!(text, "  {}: {}", verdict.stage, verdict.decision);
    }
    for input in entry.evidence["inputs"].as_array().into_iter().flatten() {
        let _ = writeln!(text, "  {} {}", input["sha256"].as_str().unwrap_or(""), input["file"].as_str().unwrap_or(""));
    }
    Ok(text)
}

fn export(entry: &Entry, out: &Path) -> Result<String> {
    let mut files: BTreeMap<PathBuf, Vec<u8>> = BTreeMap::new();
    for stored in &entry.calibrations {
        let name = &stored.calibration.estimate;
        files.insert(PathBuf::from(format!("{name}{CALIBRATION}")), stored.calibration.to_json()?.into_bytes());
    }
    let count = files.len();
    can_write_folder(out)?;
    interrupt::while_writing(|| write_folder(out, &files))?;
    Ok(format!("{count} calibrations in {}\n", out.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_dates() {
        for (text, number) in [("1970-01-01", 0.0), ("2000-02-29", 11_016.0), ("2026-11-25", 20_782.0)] {
            assert_eq!(day(text).ok(), Some(number));
            assert_eq!(date_of(number), text);
        }
        for wrong in ["yesterday", "2026-13-01", "2026-02-30", "20260302", "1e9"] {
            assert!(day(wrong).is_err(), "{wrong}");
        }
    }
}
