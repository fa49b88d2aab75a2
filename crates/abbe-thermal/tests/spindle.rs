//! The drift of a spindle and 20 temperatures, from three temperatures (Soons 1993, 3.4 and 5.1.3; data made with other code).

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_thermal::{Fitted, Hold, Output, Reference, SensorLog, Structure, fit};
use serde_json::Value;

/// Columns of a file by their names.
struct Table {
    times: Vec<f64>,
    columns: Vec<(String, Vec<f64>)>,
}

fn table(kind: &str, name: &str) -> Table {
    let path =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../pipelines/data/thermal-spindle").join(kind).join(name);
    let text = std::fs::read_to_string(path).expect("a file");
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().expect("a head").split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect()).collect();
    let column = |place: usize| rows.iter().map(|row| row[place]).collect::<Vec<f64>>();
    let name = |text: &str| text.trim_end_matches("_degC").trim_end_matches("_um").to_owned();
    Table {
        times: column(0),
        columns: names.iter().enumerate().skip(1).map(|(place, text)| (name(text), column(place))).collect(),
    }
}

const INPUTS: [&str; 3] = ["T34", "T52", "T01"];

/// Inputs as a log, counted from their reference, and the outputs in the same way.
fn read(kind: &str, name: &str, reference: Reference) -> (SensorLog, Vec<Output>) {
    let Table { times, columns } = table(kind, name);
    let log = SensorLog::new(times.clone(), columns, Hold::FirstOrder, Some(61.0)).expect("a log");
    let log = log.elevations(reference).expect("elevations");
    let is_output = |name: &&String| !INPUTS.contains(&name.as_str()) && *name != "speed_rpm";
    let outputs = log
        .names()
        .iter()
        .filter(is_output)
        .map(|name| Output::of_run(name, times.clone(), log.values(log.sensor(name).expect("a sensor")).to_vec()));
    let outputs = outputs.collect();
    (log, outputs)
}

fn structure(log: &SensorLog) -> Structure {
    Structure {
        inputs: INPUTS.iter().map(|name| log.sensor(name).expect("a sensor")).collect(),
        at_once: Vec::new(),
        time_constants: 3,
        starts_warm: false,
        guess: None,
    }
}

fn truth(kind: &str) -> BTreeMap<String, f64> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("../../tests/truth/thermal-spindle-{kind}.json"));
    let text = std::fs::read_to_string(path).expect("a file");
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let parameters = value["parameters"].as_object().expect("parameters");
    parameters.iter().map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect()
}

fn residuals(fitted: &Fitted, log: &SensorLog, outputs: &[Output]) -> Vec<(String, f64, f64)> {
    (outputs.iter().enumerate())
        .map(|(index, output)| {
            let found = fitted.predict(log, index, &output.runs[0].times).expect("a prediction");
            let off: Vec<f64> = found.iter().zip(&output.runs[0].values).map(|(a, b)| (a - b).abs()).collect();
            let rms = (off.iter().map(|off| off * off).sum::<f64>() / off.len() as f64).sqrt();
            (output.name.clone(), off.iter().copied().fold(0.0, f64::max), rms)
        })
        .collect()
}

#[test]
fn exact_readings_give_the_system_back() {
    let (log, outputs) = read("exact", "thermal-const.csv", Reference::FirstRow);
    let structure = structure(&log);
    assert_eq!(outputs.iter().map(|output| output.count()).sum::<usize>(), 19_573);
    let fitted = fit(std::slice::from_ref(&log), &outputs, &structure).expect("a fit");
    let truth = truth("exact");
    for (index, found) in fitted.time_constants.iter().enumerate() {
        let expected = truth[&format!("time_constant[{}]_s", index + 1)];
        assert!((found / expected - 1.0).abs() < 2e-9, "{found} {expected}");
    }
    let mut largest = 0.0_f64;
    for (output, gains) in outputs.iter().zip(&fitted.gains) {
        // Gains of the drift in mm/K in the truth, in µm/K here.
        let factor = if output.name.starts_with("drift") { 1e3 } else { 1.0 };
        for (input, name) in INPUTS.iter().enumerate() {
            for index in 0..3 {
                let expected = factor * truth[&format!("{}[{name}:{}]", output.name, index + 1)];
                largest = largest.max((gains[structure.gain(input, index)] - expected).abs());
            }
        }
    }
    assert!(largest < 5e-8, "{largest:e}");
    for name in ["thermal-din8602.csv", "thermal-mixed.csv"] {
        let (log, outputs) = read("exact", name, Reference::FirstRow);
        for (name, largest, _) in residuals(&fitted, &log, &outputs) {
            assert!(largest < 5e-9, "{name}: {largest:e}");
        }
    }
}

/// With the other hold the readings are not explained.
#[test]
fn a_zero_order_hold_does_not_explain_them() {
    let Table { times, columns } = table("exact", "thermal-const.csv");
    let (log, outputs) = read("exact", "thermal-const.csv", Reference::FirstRow);
    let other = SensorLog::new(times, columns, Hold::ZeroOrder, None).expect("a log");
    let other = other.elevations(Reference::FirstRow).expect("elevations");
    let scatter = |log: &SensorLog| {
        let fitted = fit(std::slice::from_ref(log), &outputs, &structure(log)).expect("a fit");
        fitted.scatter.iter().copied().fold(0.0, f64::max)
    };
    assert!(scatter(&log) < 2e-9 && scatter(&other) > 1e-4, "{:e} {:e}", scatter(&log), scatter(&other));
}

#[test]
fn realistic_readings_predict_runs_that_were_not_seen() {
    let reference = Reference::MeanUntil(600.0);
    let (log, outputs) = read("realistic", "thermal-const.csv", reference);
    let fitted = fit(std::slice::from_ref(&log), &outputs, &structure(&log)).expect("a fit");
    let truth = truth("realistic");
    for (index, (found, relative)) in fitted.time_constants.iter().zip(&fitted.relative_uncertainties).enumerate() {
        let expected = truth[&format!("time_constant[{}]_s", index + 1)];
        assert!((found / expected).ln().abs() < 3.0 * relative, "{found} {expected} {relative}");
    }
    for file in ["thermal-din8602.csv", "thermal-mixed.csv"] {
        let (log, outputs) = read("realistic", file, reference);
        let mut squares = Vec::new();
        for (name, largest, rms) in residuals(&fitted, &log, &outputs) {
            let most = if name.starts_with("drift") { 5.0 } else { 0.7 };
            assert!(largest < most, "{file} {name}: {largest} {rms}");
            match name.starts_with("drift") {
                true => assert!(rms < 1.25, "{file} {name}: {rms} µm"),
                false => squares.push(rms * rms),
            }
        }
        let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        assert!(rms < 0.15, "{file}: {rms} K");
    }
}
