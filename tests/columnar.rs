//! Tables in Parquet: a recipe finds the same as with CSV, and results have all digits.
#![cfg(feature = "parquet")]

use std::fs;
use std::path::Path;

use abbe_columnar::{OfRows, OfTable, Table};
use abbe_core::{Build, ColumnHeader, Context, Dataset, Kind, Quantity};
use abbe_estimation::residual_rows;
use serde_json::{Value, json};

use crate::packed::{found, negated, touches, with_touches};
use crate::support::{Variant, abbe, fit, read, recipes, registry, temporary};

/// A table in CSV (without quotation marks) as Parquet, its units beside the names.
pub fn parquet(text: &str) -> Vec<u8> {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let column = |(index, name): (usize, &&str)| {
        let header = ColumnHeader::parse(name);
        let cells = rows.iter().map(|row| row[index]);
        let unit = name.strip_prefix(&header.name).map(|unit| unit.trim_start_matches('_').replace("_per_", "/"));
        let values = match header.quantity {
            Quantity::Label => OfRows::Labels(cells.map(str::to_owned).collect()),
            _ => OfRows::Numbers(cells.map(|cell| cell.parse().expect("a number")).collect()),
        };
        OfTable { name: header.name.clone(), unit: unit.filter(|unit| !unit.is_empty()), values }
    };
    let columns = names.iter().enumerate().map(column).collect();
    abbe_columnar::parquet(&Table { name: "touches".to_owned(), columns }).expect("a table")
}

/// What a stage reads.
fn ingested(plugin: &str, settings: Value, base: &Path) -> abbe_core::Result<Dataset> {
    let registry = registry();
    let plugin = registry.find(Kind::Ingest, plugin).expect("the plugin");
    let Build::Ingest(constructor) = &plugin.build else { panic!("an ingest plugin") };
    let stage = constructor.build(&settings, &Context { base: base.to_owned() }).expect("a stage");
    assert_eq!(stage.headers().is_ok(), stage.read().is_ok());
    stage.read()
}

#[test]
fn parquet_gives_the_same_calibration() {
    let folder = temporary();
    let text = read(&touches());
    let expected = found(&with_touches("csv", &touches()), folder.path());
    let file = folder.path().join("touches.parquet");
    fs::write(&file, parquet(&text)).expect("a file");
    assert_eq!(found(&with_touches("parquet", &file), folder.path()), expected);
    fs::write(&file, parquet(&negated(&text, "dir_X"))).expect("a file");
    assert_ne!(found(&with_touches("parquet", &file), folder.path()), expected);
}

#[test]
fn all_that_csv_offers_is_there() {
    let folder = temporary();
    let circle = |run: usize| {
        let row = |step: usize| {
            let angle = f64::from(step as u32) * 3f64.to_radians();
            let (x, y) = (100.0 * angle.cos(), 100.0 * angle.sin());
            format!("{x},{y},{},{},{}\n", step as f64 * 0.5, run + 1, step % 5)
        };
        "X_mm,Y_mm,time_s,run,point\n".to_owned() + &(0..60).map(row).collect::<String>()
    };
    for run in 0..3 {
        let text = circle(run);
        fs::write(folder.path().join(format!("circle-{run}.csv")), &text).expect("a file");
        fs::write(folder.path().join(format!("circle-{run}.parquet")), parquet(&text)).expect("a file");
    }
    fs::write(folder.path().join("days.csv"), "file,day\ncircle-0,1\ncircle-1,1\ncircle-2,2\n").expect("a file");
    for settings in [
        json!({ "constants": { "T_degC": 21.5, "bar": "b" } }),
        json!({ "join": { "table": "days.csv", "on": "file" }, "keep": { "day": [1] } }),
        json!({ "ignore": { "point": [3] }, "within": { "X_mm": [-50, 60] } }),
        json!({ "motion": { "axes": ["X", "Y"], "after_reversal_mm": 2 } }),
        json!({ "columns": { "u_mm": { "column": "X_mm", "unit": "mm" }, "point": "point" } }),
        json!({ "average": { "over": "file", "by": ["point"] } }),
    ] {
        let read = |plugin: &str, path: &str, is_parquet: bool| {
            let mut settings = settings.clone();
            settings["path"] = json!([path]);
            if is_parquet && let Some(columns) = settings.get_mut("columns") {
                // The names in the files have no units there.
                columns["u_mm"] = json!("X");
            }
            ingested(plugin, settings, folder.path()).unwrap_or_else(|error| panic!("{error}"))
        };
        let (csv, other) = (read("csv", "circle-*.csv", false), read("parquet", "circle-*.parquet", true));
        assert_eq!(csv.columns, other.columns, "{settings}");
        let rows = |data: &Dataset| data.origins.iter().map(|origin| (origin.file, origin.row)).collect::<Vec<_>>();
        assert_eq!(rows(&csv), rows(&other), "{settings}");
        assert!(other.rows() > 0 && other.origins.iter().all(|origin| origin.line == 0));
    }
}

#[test]
fn messages_name_the_row() {
    let folder = temporary();
    let file = folder.path().join("touches.parquet");
    // A row with a feature that nobody has.
    let mut rows = read(&touches()).lines().map(str::to_owned).collect::<Vec<String>>();
    let first = rows.iter().position(|line| line.starts_with("1,")).expect("the first row");
    let cells: Vec<&str> = rows[first + 16].split(',').collect();
    rows[first + 16] = [&cells[..1], &["99"], &cells[2..]].concat().join(",");
    fs::write(&file, parquet(&rows.join("\n"))).expect("a file");
    let run = || {
        let recipe = with_touches("parquet", &file).write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), recipe.as_os_str()]);
        (printed.status, printed.stderr)
    };
    let (status, said) = run();
    assert!(status != 0 && said.contains("touches.parquet: ") && said.contains("row 17: "), "{said}");
    let whole = fs::read(&file).expect("the file");
    fs::write(&file, &whole[..whole.len() / 2]).expect("a file");
    let (status, said) = run();
    assert!(status != 0 && said.contains("cannot be read as Parquet") && !said.contains("panicked"), "{said}");
    // Each reader names the other one.
    fs::write(&file, &whole).expect("a file");
    let error = ingested("csv", json!({ "path": "touches.parquet" }), folder.path()).unwrap_err().to_string();
    assert!(error.contains("`ingest: parquet` reads it"), "{error}");
    let error = ingested("arrow-ipc", json!({ "path": "touches.parquet" }), folder.path()).unwrap_err().to_string();
    assert!(error.contains("cannot be read as Arrow IPC"), "{error}");
}

/// Trials whose samples are written.
const TRIALS: usize = 200;

/// The recipe with results in Parquet, and where its tables are once it has run.
pub fn exported(folder: &Path) -> (Variant, abbe_engine::Outcome) {
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    let settings = json!({ "trials": TRIALS, "coverage_probability": 0.5, "keep_samples": true });
    let mut trials = json!({ "estimate": "monte-carlo", "of": "fit" });
    trials.as_object_mut().expect("a map").extend(settings.as_object().expect("a map").clone());
    stages.insert("trials".to_owned(), trials);
    let axes = json!({ "X": { "from_mm": -100, "to_mm": 100 }, "B": { "from_deg": -30, "to_deg": 30 } });
    stages.insert(
        "tables".to_owned(),
        json!({ "export": "parquet", "of": ["fit"], "grid": { "points": { "X": 3, "B": 3 }, "axes": axes } }),
    );
    stages.insert("draws".to_owned(), json!({ "export": "parquet", "of": ["trials"], "tables": ["samples"] }));
    let outcome = recipe.run();
    assert!(outcome.failures.is_empty(), "{:?}", outcome.failures.iter().map(|it| &it.error).collect::<Vec<_>>());
    for file in outcome.exports.iter().flat_map(|(_, files)| files) {
        fs::write(folder.join(&file.name), &file.content).expect("a file");
    }
    (recipe, outcome)
}

#[test]
fn results_have_all_digits() {
    let folder = temporary();
    let (recipe, outcome) = exported(folder.path());
    let fit_of = |name: &str| fit(&outcome, name);
    let read = |name: &str| {
        ingested("parquet", json!({ "path": name, "no_data": [] , "columns": columns(name) }), folder.path())
            .unwrap_or_else(|error| panic!("{name}: {error}"))
    };
    let bits = |numbers: &[f64]| numbers.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
    let residuals = read("fit.residuals.parquet");
    let expected = residual_rows(fit_of("fit")).expect("residuals");
    let of = |value: fn(&abbe_estimation::RowResidual) -> f64| bits(&expected.iter().map(value).collect::<Vec<_>>());
    let column = |name: &str| bits(residuals.numbers(name).unwrap_or_else(|| panic!("{name}")));
    assert_eq!(column("residual"), of(|row| row.value));
    assert_eq!(column("uncertainty"), of(|row| row.uncertainty));
    assert_eq!(column("tip_y"), of(|row| row.tip.expect("a tip")[1]));
    assert_eq!(column("B"), {
        let axes = &fit_of("fit").problem.model.info().axes;
        let place = axes.iter().position(|axis| axis.name == "B").expect("B");
        bits(&expected.iter().map(|row| row.commands[place]).collect::<Vec<_>>())
    });
    assert_ne!(column("residual"), of(|row| -row.value));

    let samples = fit_of("trials").calibration.monte_carlo.as_ref().and_then(|found| found.samples.clone());
    let samples = samples.expect("samples");
    assert_eq!(samples.values.len(), samples.quantities.len() * TRIALS);
    let data = read("trials.samples.parquet");
    let place = samples.quantities.iter().position(|(name, _)| name == "dxt").expect("dxt");
    let first: Vec<f64> = samples.values.iter().skip(place).step_by(samples.quantities.len()).copied().collect();
    assert_eq!(bits(data.numbers("first").expect("a column")), bits(&first));
    // The samples are those whose mean and standard deviation the calibration has.
    let found = fit_of("trials").calibration.monte_carlo.as_ref().expect("trials");
    let found = found.parameters.iter().find(|found| found.name == "dxt").expect("dxt");
    let count = TRIALS as f64;
    let mean = first.iter().sum::<f64>() / count;
    let variance = first.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    assert!((mean - found.mean).abs() < 1e-9 * found.standard_uncertainty, "{mean} {}", found.mean);
    assert!((variance.sqrt() / found.standard_uncertainty - 1.0).abs() < 1e-9);

    let grid = read("fit.volumetric.parquet");
    assert_eq!(grid.rows(), 9);
    // The same bytes again.
    let again = recipe.run();
    assert!(again.exports == outcome.exports);
}

/// The columns that are looked at of a table.
fn columns(name: &str) -> Value {
    match name {
        "fit.residuals.parquet" => {
            json!({ "residual_mm": "residual_mm", "uncertainty_mm": "uncertainty_mm", "tip_y_mm": "tip_y_mm",
            "B_rad": "B_rad", "file": "file" })
        }
        "trials.samples.parquet" => json!({ "first_mm": "dxt" }),
        _ => json!({ "x_mm": "x_mm", "X_mm": "X_mm", "B_rad": "B_rad" }),
    }
}

#[test]
fn samples_that_are_not_kept_are_asked_for() {
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    stages.insert("draws".to_owned(), json!({ "export": "parquet", "of": ["fit"], "tables": ["samples"] }));
    let outcome = recipe.run();
    assert_eq!(outcome.failures.len(), 1);
    let error = outcome.failures[0].error.to_string();
    assert!(error.contains("`fit` has no samples") && error.contains("keep_samples: true"), "{error}");
}
