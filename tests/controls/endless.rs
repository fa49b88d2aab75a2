//! Tables of rotary axes that turn without an end: every turn is corrected like the first, in both directions of travel, and at the wrap
//! there is no step.

use abbe_core::{AxisKind, ExportedFile, StatusRole};
use serde_json::{Value, json};

use super::fanuc::{self, Fanuc};
use super::heidenhain::Heidenhain;
use super::isg::Isg;
use super::law::{ByAxis, Control, Machine, exporter, predicted, seeds, uniform};
use super::random;
use super::siemens::{self, Sinumerik};

/// An exporter, its settings for a machine, the emulator of its control, and half of the last digit of its values in degrees.
struct Case {
    name: &'static str,
    settings: Value,
    load: fn(&[ExportedFile]) -> Box<dyn Control>,
    digit: f64,
    /// The direction of travel can be corrected.
    has_directions: bool,
    /// The control gives a correction at points only.
    is_of_points: bool,
}

fn cases() -> Vec<Case> {
    let numbers = json!({ "X": 1, "Y": 2, "Z": 3, "A": 4, "B": 5 });
    vec![
        Case {
            name: "siemens-tables",
            settings: json!({ "machine_axes": { "A": "AX4", "B": "AX5" }, "most_points": 400 }),
            load: |files| Box::new(Sinumerik::load(files, &siemens::AXES)),
            digit: 0.5e-6,
            has_directions: true,
            is_of_points: false,
        },
        Case {
            name: "isg-tables",
            settings: json!({ "axis_numbers": numbers }),
            load: |files| Box::new(Isg::load(files, 1.0)),
            digit: 0.5e-4,
            has_directions: true,
            is_of_points: false,
        },
        Case {
            name: "heidenhain-tables",
            settings: json!({ "values": "subtracted", "form": "datum-and-distance" }),
            load: |files| Box::new(Heidenhain::load(files, -1.0)),
            digit: 0.5e-4,
            has_directions: false,
            is_of_points: false,
        },
        Case {
            name: "fanuc-pitch",
            settings: json!({
                "values": "added", "axis_numbers": numbers, "detection_unit_mdeg": 0.1, "largest_value": 127
            }),
            load: |files| Box::new(Fanuc::load(files, 1.0, &|_| fanuc::Axis { unit: 1e-4, ..fanuc::PLAIN })),
            digit: 0.5e-4,
            has_directions: true,
            is_of_points: true,
        },
    ]
}

/// The machine of a seed, and its settings; axes that the machine does not have are left out.
fn machine_and_settings(case: &Case, seed: u64) -> (Machine, Value) {
    let machine = random::machine(seed, random::Errors::Endless);
    let machine = if case.has_directions { machine } else { random::without_reversal(&machine) };
    let mut settings = case.settings.clone();
    for list in ["machine_axes", "axis_numbers"] {
        if let Some(names) = settings.get_mut(list).and_then(Value::as_object_mut) {
            names.retain(|name, _| machine.model.info().axes.iter().any(|axis| axis.name == *name));
        }
    }
    settings["tables"] = json!({ "step_deg": 10, "positioning": [rotary(&machine)], "cross": [] });
    (machine, settings)
}

fn rotary(machine: &Machine) -> &str {
    let axes = &machine.model.info().axes;
    &axes.iter().find(|axis| axis.kind == AxisKind::Rotary).expect("a rotary axis").name
}

/// Statuses in any of seven turns, many of them near a wrap or at it.
fn in_any_turn(machine: &Machine, count: usize, is_of_points: bool, seed: u64) -> Vec<f64> {
    let info = machine.model.info();
    let column = info.axes.iter().find(|axis| axis.kind == AxisKind::Rotary).expect("a rotary axis").status;
    let mut statuses = machine.anywhere(count, &[], seed);
    let mut uniform = uniform(seed ^ 77);
    for status in statuses.chunks_mut(info.status.len()) {
        let place = status[column].to_degrees();
        let place = match (is_of_points, (4.0 * uniform()) as usize) {
            (true, _) => (place / 10.0).round() * 10.0,
            (false, 0) => 0.0,
            (false, 1) => uniform() - 0.5,
            _ => place,
        };
        status[column] = (place + 360.0 * ((7.0 * uniform()).floor() - 3.0)).to_radians();
    }
    statuses
}

#[test]
fn the_law_holds_in_every_turn() {
    for case in cases() {
        for seed in seeds(20) {
            let (machine, settings) = machine_and_settings(&case, seed);
            let export = exporter(case.name, &settings);
            let statuses = in_any_turn(&machine, 100, case.is_of_points, seed + 1);
            // Digits of the file are in the prediction, too.
            let [left, _] = predicted(&machine, export.as_ref(), &case.load, &statuses, 1e-8);
            assert!(left.before > 1e-4, "{} {seed}: {left:?}", case.name);
        }
    }
}

/// What is left is the same before and after the wrap: the correction makes no step there, and repeats itself with every turn.
#[test]
fn there_is_no_step_at_the_wrap() {
    for case in cases() {
        for seed in seeds(10) {
            let (machine, settings) = machine_and_settings(&case, seed);
            let name = rotary(&machine);
            let files =
                exporter(case.name, &settings).export(&machine.calibration, machine.model.as_ref()).expect("files");
            let control = (case.load)(&files);
            let correction = |place: f64, direction: f64| {
                let all = |value: f64| -> ByAxis {
                    machine.model.info().axes.iter().map(|axis| (axis.name.clone(), value)).collect()
                };
                let mut commands = all(0.0);
                commands.insert(name.to_owned(), place);
                control.motors(&commands, &all(direction))[name] - place
            };
            for direction in [1.0, -1.0] {
                for turns in [-3.0, -1.0, 0.0, 1.0, 2.0] {
                    let place = 360.0 * turns;
                    let step = correction(place + 1e-6, direction) - correction(place - 1e-6, direction);
                    assert!(step.abs() < 2.1 * case.digit, "{} {seed}: {step}", case.name);
                    for within in [0.0, 10.0, 170.0, 350.0] {
                        let apart = correction(place + within, direction) - correction(within, direction);
                        assert!(apart.abs() < 1e-9, "{} {seed}: {apart} at {place} and {within}", case.name);
                    }
                }
            }
        }
    }
}

/// With its own correction the axis comes to the same angle from both sides.
#[test]
fn the_reversal_is_gone_in_every_turn() {
    for case in cases().into_iter().filter(|case| case.has_directions) {
        for seed in seeds(10) {
            let (machine, settings) = machine_and_settings(&case, seed);
            let files =
                exporter(case.name, &settings).export(&machine.calibration, machine.model.as_ref()).expect("files");
            let control = (case.load)(&files);
            let info = machine.model.info();
            let statuses = in_any_turn(&machine, 60, case.is_of_points, seed + 3);
            let other: Vec<f64> = (statuses.iter().enumerate())
                .map(|(place, value)| match info.status[place % info.status.len()].role {
                    StatusRole::Direction(_) => -value,
                    _ => *value,
                })
                .collect();
            let [one, other] =
                [&statuses, &other].map(|statuses| machine.tips(&machine.driven(control.as_ref(), statuses), true));
            let apart = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
            let largest = one.iter().zip(&other).map(apart).fold(0.0, f64::max);
            // Digits of both directions, at the largest radius.
            assert!(largest < 650.0 * (2.0 * case.digit).to_radians() + 1e-6, "{} {seed}: {largest}", case.name);
        }
    }
}

/// Files of the control that the new values are added to, under `existing` as each exporter wants it.
fn existing(case: &Case, axis: &str, files: &[ExportedFile], folder: &std::path::Path) -> Value {
    let file = &files[0];
    let path = folder.join(&file.name);
    std::fs::write(&path, &file.content).expect("a file");
    match case.name {
        "siemens-tables" => json!([path]),
        "fanuc-pitch" => json!(path),
        _ => json!({ axis: path }),
    }
}

#[test]
fn tables_that_are_active_are_added_in_every_turn() {
    for case in cases() {
        for seed in seeds(10) {
            let (machine, mut settings) = machine_and_settings(&case, seed);
            let (other, _) = machine_and_settings(&case, seed);
            // Half of the errors were corrected before.
            let mut half: Value = serde_json::from_str(&other.calibration.to_json().expect("JSON")).expect("JSON");
            for parameter in half["parameters"].as_array_mut().expect("parameters") {
                parameter["value"] = json!(0.5 * parameter["value"].as_f64().expect("a number"));
            }
            let half = Machine::of(&half);
            let before = exporter(case.name, &settings).export(&half.calibration, half.model.as_ref()).expect("files");
            let folder = crate::support::temporary();
            settings["existing"] = existing(&case, rotary(&machine), &before, folder.path());
            let export = exporter(case.name, &settings);
            let after = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
            let correction = export.correction(&machine.calibration, machine.model.as_ref());
            let correction = correction.expect("a prediction").expect("tables");
            let statuses = in_any_turn(&machine, 60, case.is_of_points, seed + 9);
            let predicted = correction.commands(&statuses).expect("commands");
            let [old, new] = [before, after].map(|files| machine.driven((case.load)(&files).as_ref(), &statuses));
            for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
                assert!((new - old - (predicted - status)).abs() < 1e-9, "{} {seed}", case.name);
            }
        }
    }
}

#[test]
fn what_is_no_turn_is_refused() {
    let refusal = |case: &str, change: Value, tables: Value| {
        let cases = cases();
        let case = cases.iter().find(|own| own.name == case).expect("a case");
        let (machine, mut settings) = machine_and_settings(case, 3);
        change.as_object().unwrap().iter().for_each(|(name, value)| settings[name] = value.clone());
        let name = rotary(&machine).to_owned();
        if !tables.is_null() {
            settings["tables"]["ranges"] = json!({ name: tables });
        }
        let export = exporter(case.name, &settings);
        export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error").to_string()
    };
    for case in cases() {
        let said = refusal(case.name, json!({}), json!({ "from_deg": 0, "to_deg": 350 }));
        assert!(said.contains("a range of one turn was expected"), "{}: {said}", case.name);
    }
    let said = refusal("heidenhain-tables", json!({ "form": "axis-positions" }), Value::Null);
    assert!(said.contains("whether such a table repeats itself is not documented"), "{said}");
    let said = refusal("heidenhain-tables", json!({}), json!({ "from_deg": -180, "to_deg": 180 }));
    assert!(said.contains("from 0 to 360 deg were expected"), "{said}");
    let said = refusal("fanuc-pitch", json!({}), json!({ "from_deg": -180, "to_deg": 180 }));
    assert!(said.contains("has to begin at its reference point"), "{said}");
}
