//! An emulator of stored pitch error compensation of Fanuc, from the parameter manual of the Series 0i-PB (B-63980EN, p. 100) and A-77810E
//! (both directions). It counts the pulses of the sections between the reference point and a position.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, exporter, holds, left, predicted, seeds};
use super::random;

/// What no file says of an axis: its reference point in machine coordinates, whether its return ends in positive direction, and its
/// detection unit, mm or degrees.
#[derive(Clone, Copy)]
pub(super) struct Axis {
    pub(super) reference: f64,
    pub(super) returns_positive: bool,
    pub(super) unit: f64,
}

pub(super) const PLAIN: Axis = Axis { reference: 0.0, returns_positive: true, unit: 1e-3 };

pub(super) struct Fanuc {
    /// Parameters of axes, by number and axis.
    parameters: BTreeMap<(u32, u32), String>,
    points: BTreeMap<i64, i64>,
    axes: BTreeMap<String, (u32, Axis)>,
    sense: f64,
}

const NAMES: [&str; 6] = ["X", "Y", "Z", "A", "B", "C"];

impl Fanuc {
    pub(super) fn load(files: &[ExportedFile], sense: f64, axis: &dyn Fn(&str) -> Axis) -> Self {
        let file = files.iter().find(|file| file.name == "fanuc-pitch.txt").expect("parameters");
        let text = std::str::from_utf8(&file.content).expect("text");
        assert!(text.starts_with("%\n") && text.ends_with("\n%\n"), "{text}");
        let (mut parameters, mut points) = (BTreeMap::new(), BTreeMap::new());
        for line in text.lines().filter(|line| *line != "%") {
            let number: u32 = line[1..6].parse().expect("five digits");
            if number >= 10_000 {
                let value: i64 = line[7..].parse().expect("a value");
                assert!((-127..=127).contains(&value) && &line[6..7] == "P", "{line}");
                assert_eq!(points.insert(i64::from(number) - 10_000, value), None, "{line}");
                continue;
            }
            for part in line[6..].split('A').skip(1) {
                let (axis, value) = part.split_once('P').expect("a value");
                assert_eq!(parameters.insert((number, axis.parse().unwrap()), value.to_owned()), None, "{line}");
            }
        }
        let axes = NAMES.iter().zip(1..).map(|(name, number)| (name.to_string(), (number, axis(name)))).collect();
        Self { parameters, points, axes, sense }
    }

    fn whole(&self, parameter: u32, axis: u32) -> i64 {
        self.parameters[&(parameter, axis)].parse().expect("a whole number")
    }

    /// Pulses of an axis at a position, after a move in positive or negative direction.
    fn pulses(&self, number: u32, axis: Axis, position: f64, is_positive: bool) -> i64 {
        let of = |parameter| self.whole(parameter, number);
        let both = self.parameters[&(3605, number)].ends_with('1');
        let (interval, turn) = (of(3624) as f64 / 1000.0, of(3625) as f64 / 1000.0);
        let mut travel = position - axis.reference;
        if turn > 0.0 {
            travel = travel.rem_euclid(turn);
            // The point of the reference position is the last one of the turn before.
            assert_eq!(self.points[&of(3620)], self.points[&of(3622)]);
        }
        let shift = if both && !is_positive { of(3626) - of(3621) } else { 0 };
        let against = both && is_positive != axis.returns_positive;
        let mut pulses = if against { of(3627) } else { 0 };
        // A section gives its pulses in its middle.
        let passed = (travel / interval).abs();
        for section in (1..).take_while(|section| f64::from(*section) - 0.5 < passed) {
            let point = of(3620) + if travel > 0.0 { i64::from(section) } else { 1 - i64::from(section) };
            assert!(point >= of(3621) && point <= of(3622), "there is no point {point} at {position}");
            let value = self.points[&(point + shift)] * of(3623);
            pulses += if travel > 0.0 { value } else { -value };
        }
        pulses
    }
}

impl Control for Fanuc {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut motors = commands.clone();
        for (name, motor) in &mut motors {
            let (number, axis) = self.axes[name];
            if self.parameters.contains_key(&(3624, number)) {
                let pulses = self.pulses(number, axis, commands[name], directions[name] > 0.0);
                *motor += self.sense * pulses as f64 * axis.unit;
            }
        }
        motors
    }
}

fn file(text: &str) -> ExportedFile {
    ExportedFile { name: "fanuc-pitch.txt".to_owned(), content: text.into() }
}

fn control(files: &[ExportedFile], sense: f64) -> Box<dyn Control> {
    Box::new(Fanuc::load(files, sense, &|_| PLAIN))
}

/// The examples of the manual: points 33 to 49 (around a reference point 40, every 50 mm, as follows from the curve from -400 mm that is
/// drawn for them); and a turn of eight points from 60.
#[test]
fn the_control_does_what_the_manual_says() {
    let values = [2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1, 2];
    let points: String = (10_033..).zip(values).map(|(number, value)| format!("N{number}P{value}\n")).collect();
    let text = format!(
        "%\nN03605A1P00000000\nN03620A1P40\nN03621A1P33\nN03622A1P56\nN03623A1P1\nN03624A1P50000\nN03625A1P0\n{points}%\n"
    );
    let control = Fanuc::load(&[file(&text)], 1.0, &|_| PLAIN);
    let curve = [0, 2, 3, 4, 2, 2, 1, 1, 0, 2, 3, 3, 2, 1, -1, -1, 0, 2];
    for (place, expected) in (-8..).zip(curve) {
        for is_positive in [true, false] {
            assert_eq!(control.pulses(1, PLAIN, 50.0 * f64::from(place), is_positive), expected, "{place}");
        }
    }
    let values = [1, 2, -1, 0, 1, -2, 0, -1, 1];
    let points: String = (10_060..).zip(values).map(|(number, value)| format!("N{number}P{value}\n")).collect();
    let text = format!(
        "%\nN03605A1P00000000\nN03620A1P60\nN03621A1P60\nN03622A1P68\nN03623A1P1\nN03624A1P45000\nN03625A1P360000\n{points}%\n"
    );
    let control = Fanuc::load(&[file(&text)], 1.0, &|_| PLAIN);
    for (place, expected) in (0..).zip([0, 2, 1, 1, 2, 0, 0, -1]) {
        for turns in [-2.0, 0.0, 1.0] {
            assert_eq!(control.pulses(1, PLAIN, 45.0 * f64::from(place) + 360.0 * turns, true), expected, "{place}");
        }
    }
}

fn settings(machine: &Machine, tables: Value, values: &str) -> Value {
    let numbers =
        NAMES.iter().zip(1..).filter(|(name, _)| machine.model.info().axes.iter().any(|axis| axis.name == **name));
    let numbers: BTreeMap<&str, i32> = numbers.map(|(name, number)| (*name, number)).collect();
    json!({ "tables": tables, "axis_numbers": numbers, "values": values, "largest_value": 127, "most_points": 300 })
}

/// Statuses at points of tables: linear axes at multiples of a step, rotary ones of 10 degrees.
fn at_points(machine: &Machine, mut statuses: Vec<f64>, step: f64) -> Vec<f64> {
    let info = machine.model.info();
    for status in statuses.chunks_mut(info.status.len()) {
        for axis in &info.axes {
            let [from, to] = axis.range.expect("a range");
            let step = if axis.kind == abbe_core::AxisKind::Linear { step } else { 10_f64.to_radians() };
            let place = &mut status[axis.status];
            *place = ((*place / step).round() * step).clamp((from / step).ceil() * step, (to / step).floor() * step);
        }
    }
    statuses
}

/// Sums of binary fractions.
const ROUNDING: f64 = 1e-9;

#[test]
fn the_law_holds_at_points() {
    let public = ["table-table", "head-table", "three-axis"].map(Machine::public).into_iter();
    let random = seeds(50).map(|seed| random::machine(seed, random::Errors::Any));
    for (seed, machine) in public.chain(random).enumerate() {
        for (values, sense) in [("added", 1.0), ("subtracted", -1.0)] {
            let export = exporter("fanuc-pitch", &settings(&machine, json!({ "step_mm": 50 }), values));
            let statuses = at_points(&machine, machine.anywhere(60, &[], seed as u64 + 5), 50.0);
            predicted(&machine, export.as_ref(), &|files| control(files, sense), &statuses, ROUNDING);
            // A control that takes values the other way round is told apart.
            let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
            let turned = left(&machine, export.as_ref(), control(&files, -sense).as_ref(), &statuses);
            assert!(turned.from_predicted > 1e-3, "seed {seed}: {turned:?}");
        }
    }
}

/// Between points the control gives all pulses of a section at once: at most half of them early or late.
#[test]
fn between_points_it_is_off_by_half_a_step() {
    for seed in seeds(25) {
        let machine = random::machine(seed, random::Errors::Positioning);
        let mut settings = settings(&machine, json!({ "step_mm": 10 }), "added");
        settings["detection_unit_um"] = json!(0.1);
        let export = exporter("fanuc-pitch", &settings);
        let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let fine = Axis { unit: 1e-4, ..PLAIN };
        let control = Fanuc::load(&files, 1.0, &|_| fine);
        let largest = control.points.values().map(|value| value.abs()).max().expect("points") as f64 * fine.unit;
        let found = left(&machine, export.as_ref(), &control, &machine.anywhere(100, &[], seed + 1));
        assert!(found.from_predicted <= 3_f64.sqrt() * largest / 2.0 + 1e-6, "seed {seed}: {found:?}");
        assert!(largest < 2e-3, "{largest}");
    }
}

/// How much the error of the tip changes over statuses, mm.
fn change(machine: &Machine, driven: &[f64], statuses: &[f64]) -> f64 {
    let (tips, goals) = (machine.tips(driven, true), machine.tips(statuses, false));
    let errors: Vec<[f64; 3]> = tips.iter().zip(goals).map(|(tip, goal)| [0, 1, 2].map(|i| tip[i] - goal[i])).collect();
    let spread = |i: usize| {
        let of = || errors.iter().map(|error| error[i]);
        of().fold(f64::MIN, f64::max) - of().fold(f64::MAX, f64::min)
    };
    [0, 1, 2].map(spread).into_iter().fold(0.0, f64::max)
}

/// Where axes have no other errors, what is left is the same everywhere and in both directions of travel: the error at the reference
/// point, where the machine's zero is set. Magnified values are coarser.
#[test]
fn positioning_errors_and_reversal_are_corrected() {
    for seed in seeds(30) {
        let machine = random::machine(seed, random::Errors::Positioning);
        let statuses = at_points(&machine, machine.anywhere(100, &[], seed + 1), 50.0);
        for (axis, negative) in
            [(PLAIN, vec![]), (Axis { reference: -100.0, returns_positive: false, unit: 1e-4 }, vec!["X", "Y", "Z"])]
        {
            let mut settings = settings(&machine, json!({ "step_mm": 50 }), "subtracted");
            settings["reference_points"] =
                json!({ "X_mm": axis.reference, "Y_mm": axis.reference, "Z_mm": axis.reference });
            settings["negative_return"] = json!(negative);
            settings["detection_unit_um"] = json!(axis.unit * 1e3);
            let export = exporter("fanuc-pitch", &settings);
            let load = |files: &[ExportedFile]| Box::new(Fanuc::load(files, -1.0, &|_| axis)) as Box<dyn Control>;
            predicted(&machine, export.as_ref(), &load, &statuses, ROUNDING);
            let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
            let after = change(&machine, &machine.driven(load(&files).as_ref(), &statuses), &statuses);
            let before = change(&machine, &statuses, &statuses);
            assert!(before > 4e-3 && after < 1.01 * axis.unit + 1e-6, "seed {seed}: {before} {after}");
        }
    }
}

#[test]
fn magnified_values_are_coarser() {
    for seed in seeds(10) {
        let machine = random::without_reversal(&random::machine(seed, random::Errors::Positioning));
        let statuses = at_points(&machine, machine.anywhere(100, &[], seed + 1), 50.0);
        let mut settings = settings(&machine, json!({ "step_mm": 50 }), "added");
        settings["magnification"] = json!(3);
        settings["largest_value"] = json!(7);
        settings["first_point"] = json!(100);
        let export = exporter("fanuc-pitch", &settings);
        let left = holds(&machine, export.as_ref(), &|files| control(files, 1.0), &statuses, ROUNDING);
        assert!(left.after < 1.5e-3 * 3_f64.sqrt() + 1e-6 && left.before > left.after, "seed {seed}: {left:?}");
    }
}

/// Statuses reached from the other side.
fn from_other_side(machine: &Machine, statuses: &[f64]) -> Vec<f64> {
    let columns = &machine.model.info().status;
    let turned = |(place, value): (usize, &f64)| match columns[place % columns.len()].role {
        abbe_core::StatusRole::Direction(_) => -value,
        _ => *value,
    };
    statuses.iter().enumerate().map(turned).collect()
}

/// A rotary axis comes to the same angle from both sides, up to one unit at the radius of the tool.
#[test]
fn rotary_axes_are_corrected() {
    for seed in seeds(25) {
        let machine = random::machine(seed, random::Errors::Rotary);
        let statuses = at_points(&machine, machine.anywhere(100, &[], seed + 1), 50.0);
        let mut settings = settings(&machine, json!({}), "added");
        settings["detection_unit_mdeg"] = json!(0.01);
        let export = exporter("fanuc-pitch", &settings);
        let load = |files: &[ExportedFile]| {
            Box::new(Fanuc::load(files, 1.0, &|_| Axis { unit: 1e-5, ..PLAIN })) as Box<dyn Control>
        };
        predicted(&machine, export.as_ref(), &load, &statuses, ROUNDING);
        let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let other = from_other_side(&machine, &statuses);
        let apart = |one: &[f64], other: &[f64]| {
            let pairs = machine.tips(one, true).into_iter().zip(machine.tips(other, true));
            pairs.map(|(a, b)| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()).fold(0.0, f64::max)
        };
        let before = apart(&statuses, &other);
        let [one, other] = [&statuses, &other].map(|statuses| machine.driven(load(&files).as_ref(), statuses));
        let after = apart(&one, &other);
        assert!(after < 650.0 * 1e-5_f64.to_radians() && before > after, "seed {seed}: {before} {after}");
    }
}

#[test]
fn compensation_that_is_active_is_added() {
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Any);
        let other = random::machine_like(seed, seed + 1000);
        let folder = crate::support::temporary();
        let negative = if seed % 2 == 0 { json!([]) } else { json!(["X", "Y"]) };
        let returns = |name: &str| Axis { returns_positive: seed % 2 == 0 || !["X", "Y"].contains(&name), ..PLAIN };
        let of = |tables: Value| {
            let mut settings = settings(&machine, tables, "subtracted");
            settings["negative_return"] = negative.clone();
            settings
        };
        let before = exporter("fanuc-pitch", &of(json!({ "step_mm": 100, "positioning": ["X", "Y"] })))
            .export(&other.calibration, machine.model.as_ref())
            .expect("files");
        let path = folder.path().join("before.txt");
        // A control writes all its parameters, and an end of block.
        let text = String::from_utf8(before[0].content.clone()).expect("text").replace("A1P0000000", "A1P0010000");
        let text = text.replacen("%\n", "%;\nN00000P00001100;\n", 1).replace("\nN1", ";\nN1");
        std::fs::write(&path, text).expect("a file");
        let mut added = of(json!({ "step_mm": 50 }));
        added["existing"] = json!(path);
        added["first_point"] = json!(20);
        let export = exporter("fanuc-pitch", &added);
        let after = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("tables");
        let statuses = at_points(&machine, machine.anywhere(50, &[], seed), 100.0);
        let predicted = correction.commands(&statuses).expect("commands");
        let [old, new] = [before, after].map(|files| Fanuc::load(&files, -1.0, &returns));
        assert!(new.parameters[&(3605, 1)].starts_with("0010000"));
        let [old, new] = [old, new].map(|control| machine.driven(&control, &statuses));
        for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
            assert!((new - old - (predicted - status)).abs() < ROUNDING, "seed {seed}");
        }
    }
}

/// Points of an axis that the calibration does not know stay.
#[test]
fn points_of_other_axes_are_not_overwritten() {
    let machine = Machine::public("three-axis");
    let folder = crate::support::temporary();
    let path = folder.path().join("parameters.txt");
    let points: String = (10_000..10_008).chain(10_040..10_043).map(|number| format!("N{number}P0\n")).collect();
    let text = "N03605A1P00000000A8P00000001\nN03620A1P0A8P40\nN03621A1P1A8P40\nN03622A1P7A8P42\nN03623A1P1A8P1\n\
                N03624A1P50000A8P90000\nN03625A1P0A8P360000\nN03626A1P0A8P60\nN03627A1P0A8P3\n";
    std::fs::write(&path, format!("{text}{points}")).expect("a file");
    let of = |first: u16| {
        let mut settings = settings(&machine, json!({ "step_mm": 50, "positioning": ["X"] }), "added");
        settings["existing"] = json!(path);
        settings["first_point"] = json!(first);
        exporter("fanuc-pitch", &settings).export(&machine.calibration, machine.model.as_ref())
    };
    for (first, is_free) in [(0, true), (20, true), (38, false), (42, false), (43, true), (59, false), (63, true)] {
        match of(first) {
            Ok(_) => assert!(is_free, "{first}"),
            Err(error) => {
                assert!(!is_free && error.to_string().contains("those of axis 8"), "{first}: {error}");
            }
        }
    }
}

#[test]
fn wrong_settings_are_refused() {
    let machine = Machine::public("three-axis");
    let random = random::machine(1, random::Errors::Positioning);
    for (machine, change, expected) in [
        (&machine, json!({ "axis_numbers": { "X": 1 } }), "axis_numbers: the axis number of Y is missing"),
        (&machine, json!({ "axis_numbers": { "V": 1 } }), "axis_numbers.V: the machine has no axis V"),
        (&machine, json!({ "most_points": 5 }), "tables.step_mm: axis "),
        (&machine, json!({ "last_point": 5 }), "last_point: points up to "),
        (
            &machine,
            json!({ "reference_points": { "X_mm": 3.3 } }),
            "reference_points: the reference point of X at 3.3 mm",
        ),
        (&machine, json!({ "reference_points": { "X_deg": 0 } }), "reference_points.X_deg: `X_mm` was expected"),
        (&machine, json!({ "negative_return": ["Q"] }), "negative_return: the machine has no axis Q"),
        (&machine, json!({ "existing": "nowhere.txt" }), "existing: ./nowhere.txt: it cannot be read"),
        (&random, json!({ "largest_value": 1 }), "largest_value: a value of "),
        (&random, json!({ "magnification": 2 }), "magnification: the correction of "),
        (&machine, json!({ "detection_unit_um": 1000 }), ": there is nothing to correct"),
    ] {
        let mut settings = settings(machine, json!({ "step_mm": 50 }), "added");
        change.as_object().unwrap().iter().for_each(|(name, value)| settings[name] = value.clone());
        let export = exporter("fanuc-pitch", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error");
        let found = format!("{}: {error}", abbe_core::path_text(&error.setting));
        assert!(found.starts_with(expected), "{change}: {found}");
    }
    for (change, expected) in [
        (json!({ "values": null }), "values"),
        (json!({ "axis_numbers": { "X": 1, "Y": 1 } }), "axis_numbers"),
        (json!({ "axis_numbers": { "X": 0 } }), "axis_numbers"),
        (json!({ "tables": { "cross": [{ "correct": "X", "along": "Y" }] } }), "tables.cross"),
        (json!({ "magnification": 0 }), "magnification"),
        (json!({ "largest_value": 128 }), "largest_value"),
        (json!({ "detection_unit_um": 0 }), "detection_unit_um"),
        (json!({ "first_point": 9, "last_point": 9 }), "last_point"),
        (json!({ "last_point": 10_000 }), "last_point"),
    ] {
        let mut settings = settings(&machine, json!({}), "added");
        change.as_object().unwrap().iter().for_each(|(name, value)| settings[name] = value.clone());
        let said = super::law::refused("fanuc-pitch", &settings);
        assert!(said.contains(expected), "{change}: {said}");
    }
}

/// A file that is no compensation, one at a time.
#[test]
fn files_that_are_no_compensation_are_refused() {
    let machine = Machine::public("three-axis");
    let folder = crate::support::temporary();
    let path = folder.path().join("parameters.txt");
    let right = "N03605A1P00000000\nN03620A1P2\nN03621A1P1\nN03622A1P2\nN03623A1P1\nN03624A1P100000\nN03625A1P0\nN10001P1\nN10002P-1\n";
    for (from, to, expected) in [
        (right, "", "no points of axes"),
        ("A1P00000000", "A1P2", "no line of parameters"),
        ("A1P100000", "A1Pmany", "no line of parameters"),
        ("A1P100000", "A1P-5", "no points around the reference point"),
        ("N03620A1P2", "N03620A1P9", "no points around the reference point"),
        ("N03622A1P2\n", "", "N03622 is missing"),
        ("N10002P-1\n", "", "N10002 is missing"),
        ("A1P00000000", "A1P00000001", "N03627 is missing"),
    ] {
        std::fs::write(&path, right.replace(from, to)).expect("a file");
        let mut settings = settings(&machine, json!({ "positioning": ["X"] }), "added");
        settings["existing"] = json!(path);
        let export = exporter("fanuc-pitch", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error").to_string();
        assert!(error.contains(expected), "{to}: {error}");
    }
}
