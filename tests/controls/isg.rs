//! An interpreter of the compensation lists of ISG and Beckhoff, from the kernel documentation.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, exporter, holds, predicted, seeds};
use super::random;

/// Entries of lists by axis, and which way positive values of cross compensation move.
pub(super) struct Isg {
    lists: BTreeMap<String, BTreeMap<String, String>>,
    numbers: BTreeMap<String, String>,
    cross: f64,
}

impl Isg {
    pub(super) fn load(files: &[ExportedFile], cross: f64) -> Self {
        let (mut lists, mut numbers) = (BTreeMap::new(), BTreeMap::new());
        for file in files.iter().filter(|file| file.name.ends_with(".lis")) {
            let mut entries = BTreeMap::new();
            for line in std::str::from_utf8(&file.content).expect("text").lines() {
                let (name, value) = line.split_once(char::is_whitespace).expect("a name and a value");
                assert_eq!(entries.insert(name.to_owned(), value.trim().to_owned()), None, "{line}");
            }
            let axis = entries["kopf.log_achs_name"].clone();
            numbers.insert(entries["kopf.log_achs_nr"].clone(), axis.clone());
            lists.insert(axis, entries);
        }
        Self { lists, numbers, cross }
    }

    /// The value of a column at a position, in 0.1 µm.
    fn value(entries: &BTreeMap<String, String>, list: &str, column: &str, count: usize, at: f64) -> f64 {
        let of = |index: usize, column: &str| -> f64 {
            entries[&format!("{list}.table[{index}].{column}")].parse().unwrap()
        };
        let mut at = at;
        if entries.get(&format!("{list}.modulo")).is_some_and(|modulo| modulo == "1") {
            let (first, last) = (of(0, "setpoint"), of(count - 1, "setpoint"));
            at = first + (at - first).rem_euclid(last - first);
        }
        let mut index = 0;
        while index < count && of(index, "setpoint") < at {
            index += 1;
        }
        match index {
            0 => of(0, column),
            index if index == count => of(count - 1, column),
            index => {
                let (low, high) = (of(index - 1, "setpoint"), of(index, "setpoint"));
                let (from, to) = (of(index - 1, column), of(index, column));
                from + (to - from) * (at - low) / (high - low)
            }
        }
    }
}

impl Control for Isg {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut motors = commands.clone();
        for (axis, entries) in &self.lists {
            let mut add = |value: f64| *motors.get_mut(axis).unwrap() += value * 1e-4;
            if let Some(count) = entries.get("kw.ssfk.kw_nr_max") {
                assert_eq!([&entries["kw.ssfk.interval"], &entries["kw.ssfk.unit"]], ["0", "1"]);
                let column = if directions[axis] < 0.0 && entries["kw.ssfk.bilateral"] == "1" { "neg" } else { "pos" };
                // The values are actual minus setpoint: the control takes them off.
                add(-Self::value(entries, "kw.ssfk", column, count.parse().unwrap(), commands[axis] * 1e4));
            }
            if let Some(last) = entries.get("kw.crosscomp.last_index") {
                let count = 1 + last.parse::<usize>().unwrap();
                let master = &self.numbers[&entries["kw.crosscomp.master_ax_nr"]];
                add(self.cross * Self::value(entries, "kw.crosscomp", "correction", count, commands[master] * 1e4));
            }
        }
        motors
    }
}

/// The example of the documentation: programmed 19866.7 µm, measured 19856.5 and 19874.7 µm, values -102 and 80. With the values in
/// use the axis is where it was told to be.
#[test]
fn the_control_does_what_the_documentation_says() {
    let text = "kopf.log_achs_nr 2\nkopf.log_achs_name Y\nkw.ssfk.interval 0\nkw.ssfk.kw_startpos 198001\n\
                kw.ssfk.kw_nr_max 2\nkw.ssfk.unit 1\nkw.ssfk.bilateral 1\nkw.ssfk.table[0].setpoint 198001\n\
                kw.ssfk.table[0].pos 0\nkw.ssfk.table[0].neg 0\nkw.ssfk.table[1].setpoint 198667\n\
                kw.ssfk.table[1].pos -102\nkw.ssfk.table[1].neg 80\n";
    let control = Isg::load(&[ExportedFile { name: "y.lis".to_owned(), content: text.into() }], 1.0);
    let of = |value: f64| ByAxis::from([("Y".to_owned(), value)]);
    for (direction, measured) in [(1.0, 19.8565), (-1.0, 19.8747)] {
        let error = measured - 19.8667;
        let motor = control.motors(&of(19.8667), &of(direction))["Y"];
        assert!((motor + error - 19.8667).abs() < 1e-9, "{direction}: {motor}");
    }
}

/// Half a unit of the last digit of own and cross compensation, for three axes.
const ROUNDING: f64 = 1e-6;

fn settings(machine: &Machine, tables: Value, sense: &str) -> Value {
    let axes = machine.model.info().axes.iter().enumerate();
    let numbers: BTreeMap<String, usize> = axes.map(|(index, axis)| (axis.name.clone(), index + 1)).collect();
    json!({ "tables": tables, "axis_numbers": numbers, "positive_crosscomp_moves": sense })
}

#[test]
fn the_law_holds() {
    let public = ["table-table", "head-table", "three-axis"].map(Machine::public).into_iter();
    let random = seeds(50).map(|seed| random::machine(seed, random::Errors::Any));
    for (seed, machine) in public.chain(random).enumerate() {
        for (sense, sign) in [("positive", 1.0), ("negative", -1.0)] {
            let tables = json!({ "step_mm": 50, "cross": cross(&machine) });
            let export = exporter("isg-tables", &settings(&machine, tables, sense));
            let statuses = machine.anywhere(60, &[], seed as u64 + 5);
            predicted(&machine, export.as_ref(), &|files| Box::new(Isg::load(files, sign)), &statuses, ROUNDING);
        }
    }
}

/// One pair for each corrected axis.
fn cross(machine: &Machine) -> Vec<Value> {
    let pairs = [("X", "Y"), ("Y", "Z"), ("Z", "X")];
    let travels = |axis: &str| machine.model.info().axes.iter().any(|other| other.name == axis);
    let fits = |(correct, along): &(&str, &str)| travels(correct) && travels(along);
    pairs.into_iter().filter(fits).map(|(correct, along)| json!({ "correct": correct, "along": along })).collect()
}

/// Where axes have no other errors, nothing is left but interpolation and the digits of the file.
#[test]
fn positioning_errors_are_corrected() {
    for seed in seeds(50) {
        let machine = random::machine(seed, random::Errors::Positioning);
        let statuses = machine.anywhere(100, &[], seed + 1);
        for step in [75.0, 10.0] {
            let export = exporter("isg-tables", &settings(&machine, json!({ "step_mm": step }), "positive"));
            let load = |files: &[ExportedFile]| Box::new(Isg::load(files, 1.0)) as Box<dyn Control>;
            let left = holds(&machine, export.as_ref(), &load, &statuses, ROUNDING);
            assert!(left.before > 1e-3 && left.after < random::bow(step) + 1e-4, "seed {seed}, step {step}: {left:?}");
        }
    }
}

#[test]
fn lists_that_are_active_are_added() {
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Any);
        let other = random::machine_like(seed, seed + 1000);
        let folder = crate::support::temporary();
        let tables = json!({ "step_mm": 100, "cross": cross(&machine) });
        let before = exporter("isg-tables", &settings(&machine, tables, "negative"))
            .export(&other.calibration, machine.model.as_ref())
            .expect("files");
        let mut added = settings(&machine, json!({ "step_mm": 50, "cross": cross(&machine) }), "negative");
        added["existing"] = json!({});
        for file in before.iter().filter(|file| file.name.ends_with(".lis")) {
            let path = folder.path().join(&file.name);
            std::fs::write(&path, &file.content).expect("a file");
            added["existing"][file.name[..1].to_uppercase()] = json!(path);
        }
        let export = exporter("isg-tables", &added);
        let after = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("tables");
        let statuses = machine.anywhere(50, &[], seed);
        let predicted = correction.commands(&statuses).expect("commands");
        let [old, new] = [before, after].map(|files| machine.driven(&Isg::load(&files, -1.0), &statuses));
        for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
            assert!((new - old - (predicted - status)).abs() < ROUNDING, "seed {seed}");
        }
    }
}

#[test]
fn wrong_settings_are_refused() {
    let machine = Machine::public("three-axis");
    for (change, expected) in [
        (json!({ "axis_numbers": { "X": 1 } }), "axis_numbers: the axis number of Y is missing"),
        (json!({ "positive_crosscomp_moves": null }), "positive_crosscomp_moves: the sense of `kw.crosscomp`"),
        (
            json!({ "tables": { "cross": [{ "correct": "X", "along": "Y" }, { "correct": "X", "along": "Z" }] } }),
            "tables.cross[1]: a list has one table",
        ),
        (json!({ "existing": { "X": "nowhere.lis" } }), "existing: ./nowhere.lis: it cannot be read"),
    ] {
        let mut settings = settings(&machine, json!({ "cross": [{ "correct": "X", "along": "Y" }] }), "positive");
        change.as_object().unwrap().iter().for_each(|(name, value)| settings[name] = value.clone());
        let export = exporter("isg-tables", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error");
        let found = format!("{}: {error}", abbe_core::path_text(&error.setting));
        assert!(found.starts_with(expected), "{change}: {found}");
    }
}

/// Which of several pairs a control cannot correct is told at its entry.
#[test]
fn a_pair_that_depends_on_the_direction_is_named() {
    let range = json!({ "range_mm": [-300, 300] });
    let machine = random::of_settings(
        &json!({
            "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 0,
            "axes": { "X": range, "Y": range, "Z": range },
            "errors": [{ "polynomial": ["EXX", "EXY"], "degrees": [1] }, { "backlash": ["EZY"] }],
        }),
        1,
        0.0,
    );
    let pairs = json!([{ "correct": "X", "along": "Y" }, { "correct": "Z", "along": "Y" }]);
    let export = exporter("isg-tables", &settings(&machine, json!({ "step_mm": 50, "cross": pairs }), "positive"));
    let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error");
    let found = format!("{}: {error}", abbe_core::path_text(&error.setting));
    assert!(found.starts_with("tables.cross[1]: the correction of Z along Y depends on the direction of"), "{found}");
}
