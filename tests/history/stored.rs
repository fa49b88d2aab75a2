//! What a history promises, wherever it is: a file, or a server (`tests/outside/server.rs`).

use std::collections::BTreeSet;

use abbe_core::{CALIBRATION_FORMAT, Calibration, Estimated, FitReport, ModelRecord, NamedCovariance, Status, Verdict};
use abbe_history::{Added, Entry, Filter, History, Stored};
use serde_json::json;

use crate::support::temporary;

/// One history, opened to add to it, or to read it.
pub struct Site<'a> {
    pub open: &'a (dyn Fn() -> History + Sync),
    pub read: &'a (dyn Fn() -> History + Sync),
}

/// What a run finds in a week. Texts have letters of many languages, quotation marks, and what statements are made of.
pub fn entry(week: usize) -> Entry {
    let known = Estimated {
        name: "EC0Y".into(),
        value: 1e-6 * week as f64 + f64::from_bits(0x3EB0_C6F7_A0B5_ED8D + week as u64),
        unit: "rad".into(),
        standard_uncertainty: 1e-6,
        status: Status::Estimated,
    };
    let calibration = |estimate: &str| Calibration {
        abbe_calibration: CALIBRATION_FORMAT,
        estimate: estimate.into(),
        model: ModelRecord { plugin: "serial-chain".into(), settings: json!({ "name": "mill" }) },
        parameters: vec![known.clone()],
        artefacts: Vec::new(),
        covariance: NamedCovariance { order: vec!["EC0Y".into()], rows: vec![vec![1e-12]] },
        inputs: None,
        data: Vec::new(),
        outliers: Vec::new(),
        fit: FitReport::without_rows(1),
        uncertainty: None,
        monte_carlo: None,
        group: None,
    };
    let stored = |estimate: &str| Stored {
        machine: format!("Fräse '{}'; DROP TABLE entry; -- 机床 \"$1\" \\", week % 2),
        label: week.to_string(),
        at: 0.1 + week as f64,
        unit: "week".into(),
        calibration: calibration(estimate),
    };
    // The second name stands before the first in the order of letters: the order is that of the entry.
    Entry {
        recipe: "weekly".into(),
        calibrations: vec![stored("weekly"), stored("again")],
        verdicts: Vec::<Verdict>::new(),
        evidence: json!({ "inputs": [{ "file": "wöchentlich.csv", "sha256": "00" }] }),
    }
}

/// What is added comes back as it was, once, in the order in which it was added.
pub fn comes_back_once(site: &Site<'_>) {
    let mut history = (site.open)();
    for week in [3, 1, 2] {
        assert!(matches!(history.add(&entry(week)).expect("it is added"), Added::New(_)));
    }
    assert_eq!(history.add(&entry(1)).expect("it is known"), Added::Known(2));
    assert_eq!((site.open)().add(&entry(3)).expect("it is known"), Added::Known(1));
    let history = (site.read)();
    let numbers: Vec<i64> = history.entries().expect("entries").into_iter().map(|(number, ..)| number).collect();
    assert_eq!(numbers, [1, 2, 3]);
    assert_eq!(history.entry(2).expect("an entry"), Some(entry(1)));
    assert_eq!(history.entry(9).expect("none"), None);
    let before: Vec<i64> = history.entries_before(3, 1).expect("entries").into_iter().map(|(one, ..)| one).collect();
    assert_eq!(before, [2]);
    let machines = history.machines().expect("machines");
    assert_eq!(machines.iter().map(|(_, count)| *count).collect::<Vec<_>>(), [2, 4]);
    let of_one = Filter { machine: Some(machines[1].0.clone()), entry: None };
    let labels: Vec<String> =
        history.calibrations(&of_one).expect("calibrations").into_iter().map(|(_, stored)| stored.label).collect();
    assert_eq!(labels, ["1", "1", "3", "3"]);
    assert_eq!(history.last(&machines[1].0).expect("the last"), Some(("3".to_owned(), "week".to_owned())));
    assert_eq!(history.last("no machine").expect("none"), None);
    let of_entry = Filter { machine: None, entry: Some(3) };
    assert_eq!(history.calibrations(&of_entry).expect("calibrations").len(), 2);
    assert_eq!(history.calibrations(&Filter::default()).expect("calibrations").len(), 6);
}

/// What was opened to be read cannot be written.
pub fn readers_change_nothing(site: &Site<'_>) {
    (site.open)().add(&entry(1)).expect("it is added");
    assert!((site.read)().add(&entry(77)).is_err());
    assert_eq!((site.read)().entries().expect("entries").len(), 1);
}

/// Two writers, each with entries of its own and some that both have: all are there, each once. Both may make the tables.
pub fn two_writers(site: &Site<'_>) {
    std::thread::scope(|scope| {
        for writer in 0..2 {
            scope.spawn(move || {
                let mut history = (site.open)();
                for week in (0..40).filter(|week| week % 4 != 1 + 2 * writer) {
                    history.add(&entry(week)).expect("it is added");
                }
            });
        }
    });
    let history = (site.read)();
    let all = history.calibrations(&Filter::default()).expect("calibrations");
    let labels: BTreeSet<&str> = all.iter().map(|(_, stored)| stored.label.as_str()).collect();
    assert_eq!((all.len(), labels.len(), history.entries().expect("entries").len()), (80, 40, 40));
    let numbers: Vec<i64> = history.entries().expect("entries").into_iter().map(|(number, ..)| number).collect();
    assert_eq!(numbers, (1..=40).collect::<Vec<_>>());
}

/// Runs a law on a history in a new file.
fn in_a_file(law: fn(&Site<'_>)) {
    let folder = temporary();
    let path = folder.path().join("plant.sqlite");
    let open = || History::open(&path).expect("it opens");
    let read = || History::read(&path).expect("it opens");
    law(&Site { open: &open, read: &read });
}

#[test]
fn what_is_added_comes_back_once() {
    in_a_file(comes_back_once);
}

#[test]
fn what_is_read_cannot_be_written() {
    in_a_file(readers_change_nothing);
}

#[test]
fn two_writers_lose_and_double_nothing() {
    in_a_file(two_writers);
}
