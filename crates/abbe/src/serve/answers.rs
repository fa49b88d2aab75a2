//! The pages themselves: first page, machine, entry, calibration.

use std::path::PathBuf;

use abbe_core::{Class, Error, Registry, Result};
use abbe_history::{Entry, Filter, History, Stored};
use abbe_report::{
    KeptCalibration, ListedEntry, ListedMachine, MachinePage, Run, calibration_page, entry_page, machine_page,
    machines_page, refusal_page,
};
use hyper::StatusCode;
use serde_json::Value;

use super::request::Asked;
use crate::history::{Question, estimate_of, read};

/// Calibrations of all machines together up to which the first page judges every machine.
const JUDGED: i64 = 1000;

/// Entries of one list.
const LISTED: i64 = 100;

/// What a client gets.
#[derive(Debug)]
pub struct Answer {
    /// The status.
    pub status: StatusCode,
    /// The kind of the content.
    pub kind: &'static str,
    /// The content.
    pub content: String,
    /// Whether the connection ends with it.
    pub ends: bool,
    /// What is said to whoever started the server.
    pub for_operator: Option<String>,
}

impl Answer {
    fn html(content: String) -> Self {
        let kind = "text/html; charset=utf-8";
        Self { status: StatusCode::OK, kind, content, ends: false, for_operator: None }
    }

    /// A page that says why there is none.
    pub fn refusal(status: StatusCode, text: &str) -> Self {
        let title = status.canonical_reason().unwrap_or("No page");
        Self { status, ..Self::html(refusal_page(title, text)) }
    }

    fn absent(text: &str) -> Self {
        Self::refusal(StatusCode::NOT_FOUND, text)
    }
}

/// What pages are made of.
pub struct Pages {
    /// The history.
    pub history: PathBuf,
    /// The plugins that know the machines.
    pub registry: Registry,
}

impl Pages {
    /// The page that is asked for. What is wrong with the history is told to whoever started the server.
    pub fn answer(&self, asked: &Asked) -> Answer {
        self.made(asked).unwrap_or_else(|error| {
            let text = "The history cannot be read now.";
            let refusal = Answer::refusal(StatusCode::INTERNAL_SERVER_ERROR, text);
            Answer { for_operator: Some(error.to_string()), ..refusal }
        })
    }

    fn made(&self, asked: &Asked) -> Result<Answer> {
        let parts: Vec<&str> = asked.path.iter().map(String::as_str).collect();
        let number = |text: &str| text.parse().ok().filter(|number: &i64| *number > 0);
        match parts.as_slice() {
            [] => self.first(asked.value("before").and_then(number)),
            ["machine"] => self.machine(asked),
            // Browsers ask for a picture of their own accord.
            ["favicon.ico"] => Ok(Answer { status: StatusCode::NO_CONTENT, ..Answer::html(String::new()) }),
            ["entry", entry] => match number(entry) {
                Some(number) => self.of_entry(number, |entry| self.entry(number, entry)),
                None => Ok(Answer::absent("Entries have numbers.")),
            },
            ["entry", entry, name] => match number(entry) {
                Some(number) => self.of_entry(number, |entry| self.calibration(number, name, entry)),
                None => Ok(Answer::absent("Entries have numbers.")),
            },
            _ => Ok(Answer::absent("There is no such page.")),
        }
    }

    fn first(&self, before: Option<i64>) -> Result<Answer> {
        let history = read(&self.history)?;
        let known = history.machines()?;
        let few = known.iter().map(|(_, count)| count).sum::<i64>() <= JUDGED;
        let machine = |(name, calibrations): (String, i64)| {
            let last = history.last(&name)?.map_or_else(String::new, |(label, unit)| when(&label, &unit));
            let state = if few { Some(state(&history, &name)?) } else { None };
            Ok(ListedMachine { name, calibrations, last, state })
        };
        let machines: Vec<ListedMachine> = known.into_iter().map(machine).collect::<Result<_>>()?;
        let listed = history.entries_before(before.unwrap_or(i64::MAX), LISTED)?;
        let entry = |(number, sha256, recipe)| ListedEntry { number, recipe, sha256 };
        let entries: Vec<ListedEntry> = listed.into_iter().map(entry).collect();
        let older = entries.last().map(|last| last.number - 1).filter(|older| *older > 0);
        Ok(Answer::html(machines_page(&machines, &entries, older)))
    }

    fn machine(&self, asked: &Asked) -> Result<Answer> {
        let Some(machine) = asked.value("name") else { return Ok(Answer::absent("This address names no machine.")) };
        let history = read(&self.history)?;
        let all = history.calibrations(&Filter { machine: Some(machine.to_owned()), entry: None })?;
        if all.is_empty() {
            return Ok(Answer::absent("The history has no machine of this name."));
        }
        let question = Question {
            machine: Some(machine.to_owned()),
            estimate: asked.value("estimate").map(str::to_owned),
            baseline: asked.value("baseline").map(str::to_owned),
            ..Question::default()
        };
        let checked = question.judge(machine, &all, &Registry::built_in);
        let told = checked.as_ref();
        let mut estimates: Vec<String> = all.iter().map(|(_, stored)| estimate_of(stored).to_owned()).collect();
        estimates.sort();
        estimates.dedup();
        let tests: Vec<KeptCalibration> = all.iter().rev().map(|(entry, stored)| kept(*entry, stored)).collect();
        Ok(Answer::html(machine_page(&MachinePage {
            machine,
            estimate: told.map_or("", |checked| &checked.estimate),
            estimates: &estimates,
            baseline: question.baseline.as_deref().filter(|_| told.is_ok()),
            state: told.map_or("not judged", |checked| checked.state().0),
            told: told
                .map(|checked| (&checked.analysis, checked.quality.as_slice(), checked.remarks.as_slice()))
                .map_err(why),
            tests: &tests,
        })))
    }

    fn of_entry(&self, number: i64, page: impl Fn(&Entry) -> Result<Answer>) -> Result<Answer> {
        match read(&self.history).and_then(|history: History| history.entry(number))? {
            Some(entry) => page(&entry),
            None => Ok(Answer::absent("The history has no such entry.")),
        }
    }

    fn entry(&self, number: i64, entry: &Entry) -> Result<Answer> {
        let calibrations = entry.calibrations.iter().map(|stored| stored.calibration.clone()).collect();
        let kept: Vec<KeptCalibration> = entry.calibrations.iter().map(|stored| kept(number, stored)).collect();
        Ok(match Run::kept(&entry.recipe, calibrations, entry.verdicts.clone(), &self.registry) {
            Ok(run) => Answer::html(entry_page(number, &entry.sha256()?, &kept, &files(entry), &run)),
            Err(error) => unshown(&error),
        })
    }

    /// The report about one calibration, or its file.
    fn calibration(&self, number: i64, name: &str, entry: &Entry) -> Result<Answer> {
        let estimate = name.strip_suffix(".calibration.json");
        let wanted = estimate.unwrap_or(name);
        let Some(stored) = entry.calibrations.iter().find(|stored| stored.calibration.estimate == wanted) else {
            return Ok(Answer::absent("The entry has no such calibration."));
        };
        if estimate.is_some() {
            let json = Answer::html(stored.calibration.to_json()?);
            return Ok(Answer { kind: "application/json", ..json });
        }
        let title = format!("{}, {wanted}, {}", stored.machine, when(&stored.label, &stored.unit));
        Ok(match Run::kept(&title, vec![stored.calibration.clone()], Vec::new(), &self.registry) {
            Ok(run) => Answer::html(calibration_page(number, &run)),
            Err(error) => unshown(&error),
        })
    }
}

/// What the tests of a machine tell, in a word.
fn state(history: &History, machine: &str) -> Result<&'static str> {
    let all = history.calibrations(&Filter { machine: Some(machine.to_owned()), entry: None })?;
    let checked = Question::default().judge(machine, &all, &Registry::built_in);
    Ok(checked.map_or("not judged", |checked| checked.state().0))
}

/// The files that were read for an entry, with their hashes.
fn files(entry: &Entry) -> Vec<(String, String)> {
    let text = |input: &Value, key: &str| input[key].as_str().unwrap_or_default().to_owned();
    let inputs = entry.evidence["inputs"].as_array().into_iter().flatten();
    inputs.map(|input| (text(input, "file"), text(input, "sha256"))).collect()
}

/// A report that needs what this program does not have, such as the plugin of a vendor.
fn unshown(error: &Error) -> Answer {
    let text = format!("The report cannot be made: {}. The numbers are in the file of the calibration.", why(error));
    Answer::refusal(StatusCode::NOT_IMPLEMENTED, &text)
}

/// What is wrong, in words that belong to the page; errors of this computer do not.
fn why(error: &Error) -> String {
    match error.class {
        Class::Use => error.message.clone(),
        _ if error.place.is_none() => error.message.clone(),
        _ => "something is wrong with what was kept".to_owned(),
    }
}

fn kept(entry: i64, stored: &Stored) -> KeptCalibration {
    KeptCalibration {
        entry,
        estimate: stored.calibration.estimate.clone(),
        machine: stored.machine.clone(),
        when: when(&stored.label, &stored.unit),
    }
}

/// `week 40`; a day is its date.
fn when(label: &str, unit: &str) -> String {
    if unit == "day" { label.to_owned() } else { format!("{unit} {label}") }
}
