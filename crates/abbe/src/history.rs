//! `abbe history`: keeps the results of runs, and tells what they say about a machine over time.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Calibration, Error, Limit, Result, Verdict};
use abbe_engine::{CALIBRATION, Outcome, RunRecord, VERDICTS, can_write_folder, temporary_file, write_folder};
use abbe_files::{LARGEST_RESULT, read_text};
use abbe_history::{Added, Entry, Filter, History, Stored};
use abbe_trend::{AgainRule, Forecast, Settings, Tested, analyse, findings, history, unit_factor};
use clap::{Args, Subcommand};
use serde_json::{Value, json};

use crate::interrupt;
use crate::outputs::cannot_be_written;

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
    /// The history: an SQLite file, which is made if it is not there.
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

/// A machine to check.
#[derive(Args)]
pub struct Check {
    /// The history.
    history: PathBuf,
    /// The machine, if the history has several.
    #[arg(long)]
    machine: Option<String>,
    /// The estimate that was repeated, if the entries have several.
    #[arg(long)]
    estimate: Option<String>,
    /// The estimate that is the target of all charts. Default: the mean of all tests, or of the first five of what has changed.
    #[arg(long)]
    baseline: Option<String>,
    /// A limit that has to be kept until the next test, with its unit: `EXX[b]=4.5um`.
    #[arg(long, value_name = "PARAMETER=LIMIT")]
    limit: Vec<String>,
    /// Accepted probability that a limit is exceeded.
    #[arg(long, default_value_t = 0.05)]
    risk: f64,
    /// Print the findings as JSON.
    #[arg(long)]
    json: bool,
}

impl Asked {
    /// Does it; gives what to print and the exit status.
    pub fn run(self) -> Result<(String, u8)> {
        match self {
            Self::Add(add) => add.run().map(|text| (text, 0)),
            Self::List { history } => list(&History::read(&history)?).map(|text| (text, 0)),
            Self::Show { history, entry } => show(&found(&history, entry)?, entry).map(|text| (text, 0)),
            Self::Check(check) => check.run(),
            Self::Export { history, entry, out } => export(&found(&history, entry)?, &out).map(|text| (text, 0)),
        }
    }

    /// Whether the output is for programs.
    pub fn is_json(&self) -> bool {
        matches!(self, Self::Check(Check { json: true, .. }))
    }
}

/// Adds what a run found, as the key `history` of a recipe asks for.
pub fn add_outcome(path: &Path, outcome: &Outcome) -> Result<Added> {
    let record = outcome.record();
    let calibrations: Vec<(String, Calibration)> =
        outcome.fits.iter().map(|fit| (fit.name.clone(), fit.calibration.clone())).collect();
    let entry = entry(&record, calibrations, outcome.verdicts.clone(), None, None)?;
    Ok(add_all(path, &[entry])?.swap_remove(0))
}

/// Adds entries. A history that is not there is made whole with them, or not at all.
fn add_all(path: &Path, entries: &[Entry]) -> Result<Vec<Added>> {
    let added = |history: &mut History| entries.iter().map(|entry| history.add(entry)).collect::<Result<Vec<_>>>();
    if path.symlink_metadata().is_err() {
        let mut history = History::new(path)?;
        let numbers = added(&mut history)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let cannot = |error: &io::Error| cannot_be_written(path, error);
        let file = temporary_file(folder).map_err(|error| cannot(&error))?;
        history.save(file.path())?;
        file.as_file().sync_all().map_err(|error| cannot(&error))?;
        match file.persist_noclobber(path) {
            Ok(_) => return Ok(numbers),
            // Another program made it in the meantime.
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(cannot(&error.error)),
        }
    }
    added(&mut History::open(path)?)
}

impl Add {
    fn run(self) -> Result<String> {
        if self.machine.as_ref().is_some_and(|machine| machine.trim().is_empty()) {
            return Err(
                Error::usage("--machine: a name was expected").help("without `--machine` its description names it")
            );
        }
        // Everything is read before the first entry is added.
        let read = |folder: &PathBuf| self.read(folder);
        let entries: Vec<Entry> = self.results.iter().map(read).collect::<Result<_>>()?;
        let mut text = String::new();
        for ((folder, entry), added) in self.results.iter().zip(&entries).zip(add_all(&self.history, &entries)?) {
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

/// Refuses tests of machines that cannot be the same: their chains, or the plugins that describe them, differ.
fn same_machine(tests: &[&Stored], estimate: &str) -> Result<()> {
    let chain = |stored: &Stored| {
        let model = &stored.calibration.model;
        (model.plugin.clone(), model.settings.get("chain").cloned())
    };
    let Some((first, other)) = tests
        .iter()
        .find_map(|other| Some((tests.first()?, other)).filter(|(first, other)| chain(first) != chain(other)))
    else {
        return Ok(());
    };
    let words = |stored: &Stored| {
        let (plugin, chain) = chain(stored);
        let chain = chain.as_ref().and_then(Value::as_str).map_or_else(|| plugin, |chain| format!("`{chain}`"));
        format!("{chain} in {} {}", stored.unit, stored.label)
    };
    let message = format!(
        "the tests of `{estimate}` under the name `{}` are of different machines: {}, {}",
        first.machine,
        words(first),
        words(other)
    );
    Err(Error::data(message).help("keep each machine under a name of its own: `abbe history add --machine NAME`"))
}

/// A day from 1970-01-01: a number, or a date.
fn day(text: &str) -> Result<f64> {
    let number = text.parse().ok().filter(|day: &f64| day.is_finite());
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

fn found(path: &Path, entry: i64) -> Result<Entry> {
    let history = History::read(path)?;
    let last = history.entries()?.last().map_or(0, |(number, _, _)| *number);
    history.entry(entry)?.ok_or_else(|| Error::usage(format!("there is no entry {entry}; the last is {last}")))
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

impl Check {
    fn run(self) -> Result<(String, u8)> {
        let history_file = History::read(&self.history)?;
        let machine = self.machine(&history_file)?;
        let all = history_file.calibrations(&Filter { machine: Some(machine.clone()), entry: None })?;
        let tests = self.tests(&all)?;
        let tested: Vec<Tested<'_>> = tests
            .iter()
            .map(|stored| Tested { label: &stored.label, at: stored.at, calibration: &stored.calibration })
            .collect();
        let baseline = self.baseline(&all)?;
        let mut known = history(&tested, baseline, &[], 1e-4);
        for limit in &self.limit {
            let (name, rule) = self.rule(limit, &known.series)?;
            known.series.iter_mut().filter(|series| series.name == name).for_each(|series| series.again = Some(rule));
        }
        let unit = tests.first().map_or("test", |stored| stored.unit.as_str());
        let analysis =
            analyse(unit, &known.tests, &known.series, &known.covariances, &known.inputs, &Settings::default());
        let said = findings(&machine, &known, &analysis, Limit::from(0.0))?;
        let (status, state) = match (analysis.is_judged(), analysis.alarm()) {
            (false, _) => (3, "not judged"),
            (true, true) => (3, "alarm"),
            (true, false) => (0, "in control"),
        };
        if self.json {
            let text = serde_json::to_string_pretty(
                &json!({ "machine": machine, "alarm": analysis.alarm(), "judged": analysis.is_judged(), "analysis": analysis }),
            );
            let text = text.map_err(|error| Error::data(format!("the output cannot be written: {error}")))?;
            return Ok((text + "\n", status));
        }
        let mut text = format!("{machine}: {} tests, {state}\n", tests.len());
        said.remarks.iter().for_each(|remark| text.extend(["  ", remark, "\n"]));
        Ok((text, status))
    }

    fn machine(&self, history: &History) -> Result<String> {
        if let Some(machine) = &self.machine {
            return Ok(machine.clone());
        }
        let machines = history.machines()?;
        match machines.as_slice() {
            [(only, _)] => Ok(only.clone()),
            _ => {
                let names: Vec<&str> = machines.iter().map(|(name, _)| name.as_str()).collect();
                Err(Error::usage(format!("the history has {} machines: {}", names.len(), names.join(", ")))
                    .help("name one by `--machine`"))
            }
        }
    }

    /// The tests in the order of time; of one time the entry that was added last counts.
    fn tests<'a>(&self, all: &'a [(i64, Stored)]) -> Result<Vec<&'a Stored>> {
        let mut names: Vec<&str> = Vec::new();
        let is_baseline = |name: &str| self.baseline.as_deref() == Some(name);
        let grouped = all.iter().any(|(_, stored)| stored.calibration.group.is_some());
        for (_, stored) in all {
            let name = group_estimate(stored);
            let counts = !grouped || stored.calibration.group.is_some();
            if counts && !is_baseline(name) && !names.contains(&name) {
                names.push(name);
            }
        }
        let estimate = match (&self.estimate, names.as_slice()) {
            (Some(estimate), _) => estimate.as_str(),
            (None, [only]) => only,
            (None, []) => return Err(Error::usage("the history has no calibration of this machine")),
            (None, several) => {
                return Err(Error::usage(format!("the entries have several estimates: {}", several.join(", ")))
                    .help("name the one that was repeated by `--estimate`"));
            }
        };
        let mut tests: Vec<&Stored> = Vec::new();
        for (_, stored) in all.iter().filter(|(_, stored)| group_estimate(stored) == estimate) {
            match tests.iter_mut().find(|known| known.at == stored.at && known.unit == stored.unit) {
                Some(known) => *known = stored,
                None => tests.push(stored),
            }
        }
        match tests.as_slice() {
            [] => Err(Error::usage(format!("the history has no `{estimate}` of this machine"))),
            [first, others @ ..] if others.iter().any(|other| other.unit != first.unit) => {
                Err(Error::data(format!("the tests of `{estimate}` have times of different kinds"))
                    .help("keep tests by week and tests by date in histories of their own"))
            }
            all => same_machine(all, estimate).map(|()| tests),
        }
    }

    fn baseline<'a>(&self, all: &'a [(i64, Stored)]) -> Result<Option<&'a Calibration>> {
        let Some(name) = &self.baseline else { return Ok(None) };
        let last =
            all.iter().filter(|(_, stored)| stored.calibration.estimate == *name).max_by_key(|(entry, _)| *entry);
        match last {
            Some((_, stored)) => Ok(Some(&stored.calibration)),
            None => Err(Error::usage(format!("the history has no `{name}` of this machine"))),
        }
    }

    fn rule(&self, text: &str, series: &[abbe_trend::Series]) -> Result<(String, AgainRule)> {
        let wrong = || Error::usage(format!("`{text}` is no limit: one as `EXX[b]=4.5um` was expected"));
        let (name, limit) = text.rsplit_once('=').ok_or_else(wrong)?;
        let digits = limit.find(|letter: char| !(letter.is_ascii_digit() || letter == '.')).ok_or_else(wrong)?;
        let (number, unit) = limit.split_at(digits);
        let series = series.iter().find(|series| series.name == name);
        let series = series.ok_or_else(|| Error::usage(format!("`{name}` is not among what the tests estimate")))?;
        let factor = unit_factor(unit.trim(), &series.unit)
            .ok_or_else(|| Error::usage(format!("`{}` is no unit of `{name}`", unit.trim())))?;
        if !(self.risk > 0.0 && self.risk < 0.5) {
            return Err(Error::usage("a risk between 0 and 0.5 was expected"));
        }
        let limit: f64 = number.parse().map_err(|_| wrong())?;
        let rule = AgainRule { limit: limit * factor, risk: self.risk, tests: 12, forecast: Forecast::Line };
        Ok((name.to_owned(), rule))
    }
}

/// The name of the estimate without its group.
fn group_estimate(stored: &Stored) -> &str {
    let name = stored.calibration.estimate.as_str();
    if stored.calibration.group.is_some() { name.split('.').next().unwrap_or(name) } else { name }
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
        assert!(day("yesterday").is_err() && day("2026-13-01").is_err());
    }
}
