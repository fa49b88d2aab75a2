//! How long it takes to check one machine of a plant whose history has a hundred thousand calibrations: the file is opened, the
//! tests of the machine are read and judged, as `abbe history check` does.

use std::hint::black_box;
use std::path::{Path, PathBuf};

use abbe_bundle as _;
use abbe_core::{Calibration, Error, Limit, Monitor, Registry};
use abbe_engine::prepare;
use abbe_history::{Entry, Filter, History, Stored};
use abbe_trend::{Settings, Tested, analyse, findings, history};
use criterion::{Criterion, criterion_group, criterion_main};
use serde_json::json;

/// Machines of the plant.
const MACHINES: usize = 1_000;

/// Calibrations of each.
const TESTS: usize = 100;

/// The machine that is checked.
const CHECKED: usize = 617;

/// Calibrations of one week each, as a run finds them.
fn weeks() -> Result<Vec<Calibration>, Error> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../pipelines/history.yaml");
    let fits = prepare(&path, &Registry::built_in()?)?.run(&Monitor::default())?.fits;
    Ok(fits.into_iter().map(|fit| fit.calibration).filter(|calibration| calibration.group.is_some()).collect())
}

/// A hundred tests of one machine; other machines are tested for their set-up alone, or the file would have a gigabyte.
fn entry(machine: usize, weeks: &[Calibration]) -> Entry {
    let stored = |test: usize| {
        let mut calibration = weeks[test % weeks.len()].clone();
        calibration.estimate = format!("weekly.week-{test}");
        if let Some(group) = &mut calibration.group {
            (group.label, group.at) = (test.to_string(), test as f64);
        }
        if machine != CHECKED {
            calibration.parameters.truncate(3);
            calibration.artefacts.clear();
            calibration.inputs = None;
            calibration.covariance.order.truncate(3);
            calibration.covariance.rows.truncate(3);
            calibration.covariance.rows.iter_mut().for_each(|row| row.truncate(3));
        }
        Stored {
            machine: format!("machine {machine}"),
            label: test.to_string(),
            at: test as f64,
            unit: "week".to_owned(),
            calibration,
        }
    };
    let calibrations = (0..TESTS).map(stored).collect();
    Entry { recipe: "weekly".to_owned(), calibrations, verdicts: Vec::new(), evidence: json!({ "machine": machine }) }
}

fn plant(path: &Path) -> Result<(), Error> {
    let weeks = weeks()?;
    let mut history = History::open(path)?;
    (0..MACHINES).try_for_each(|machine| history.add(&entry(machine, &weeks)).map(drop))
}

/// What the tests of one machine tell.
fn checked(path: &Path, machine: &str) -> Result<usize, Error> {
    let filter = Filter { machine: Some(machine.to_owned()), entry: None };
    let all = History::read(path)?.calibrations(&filter)?;
    let test = |(_, stored): &'_ (i64, Stored)| (stored.label.clone(), stored.at, stored.calibration.clone());
    let owned: Vec<(String, f64, Calibration)> = all.iter().map(test).collect();
    let tested: Vec<Tested<'_>> =
        owned.iter().map(|(label, at, calibration)| Tested { label, at: *at, calibration }).collect();
    let known = history(&tested, None, &[], 1e-4)?;
    let settings = Settings::default();
    let analysis = analyse("week", &known.tests, &known.series, &known.covariances, &known.inputs, &settings);
    Ok(findings(machine, &known, &analysis, Limit::from(0.0))?.remarks.len())
}

fn check(criterion: &mut Criterion) {
    let folder: PathBuf = Path::new(env!("CARGO_TARGET_TMPDIR")).join("history-bench");
    let made = std::fs::create_dir_all(&folder);
    made.unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let path = folder.join("plant.sqlite");
    let _ = std::fs::remove_file(&path);
    plant(&path).unwrap_or_else(|error| panic!("{error}"));
    let machine = format!("machine {CHECKED}");
    criterion.bench_function("history_check_100000", |bencher| {
        bencher.iter(|| checked(black_box(&path), &machine).unwrap_or_else(|error| panic!("{error}")))
    });
    let _ = std::fs::remove_file(&path);
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = check
}
criterion_main!(benches);
