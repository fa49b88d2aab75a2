//! An interpreter of encoder error and sag compensation of SINUMERIK, from the Function Manual Extended Functions (K3, 4.4).

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, exporter, holds, seeds};
use super::random;

/// Variables by their name with indices, as in the file; and the axes of the machine by the names of machine axes.
pub(super) struct Sinumerik {
    variables: BTreeMap<String, String>,
    axes: BTreeMap<String, String>,
}

impl Sinumerik {
    pub(super) fn load(files: &[ExportedFile], axes: &[(&str, &str)]) -> Self {
        let mut variables = BTreeMap::new();
        for file in files {
            let text = std::str::from_utf8(&file.content).expect("text");
            assert!(text.starts_with("%_N_") && text.trim_end().ends_with("M17"), "{text}");
            for line in text.lines() {
                let code = line.split(';').next().unwrap().trim();
                if let Some((name, value)) = code.split_once('=') {
                    assert!(name.starts_with('$'), "{line}");
                    let before = variables.insert(name.to_owned(), value.to_owned());
                    assert_eq!(before, None, "{name} stands twice");
                }
            }
        }
        Self { variables, axes: axes.iter().map(|(axis, machine)| (machine.to_string(), axis.to_string())).collect() }
    }

    fn number(&self, name: String) -> f64 {
        self.variables.get(&name).unwrap_or_else(|| panic!("no {name}")).parse().expect("a number")
    }

    /// Interpolation between points; beyond the ends their values, or the next turn.
    fn value(&self, list: &str, table: &str, at: f64) -> f64 {
        let of = |name: &str| self.number(format!("{list}_{name}[{table}]"));
        let (from, to, step) = (of("MIN"), of("MAX"), of("STEP"));
        let mut at = at;
        if of("IS_MODULO") == 1.0 {
            while at < from {
                at += to - from;
            }
            while at > to {
                at -= to - from;
            }
        }
        let point = |index: i64| {
            let name = match table.split_once(',') {
                Some((encoder, axis)) => format!("{list}[{encoder},{index},{axis}]"),
                None => format!("{list}[{table},{index}]"),
            };
            self.number(name)
        };
        let last = ((to - from) / step).round() as i64;
        let place = (at - from) / step;
        if place <= 0.0 {
            return point(0);
        }
        if place >= last as f64 {
            return point(last);
        }
        let before = place.floor();
        point(before as i64) + (place - before) * (point(before as i64 + 1) - point(before as i64))
    }

    fn axis(&self, variable: &str, table: usize) -> &str {
        let name = self.variables[&format!("$AN_CEC_{variable}[{table}]")].trim_matches(['(', ')']);
        &self.axes[name]
    }
}

impl Control for Sinumerik {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut motors = commands.clone();
        for (machine, axis) in &self.axes {
            let table = format!("0,{machine}");
            if self.variables.contains_key(&format!("$AA_ENC_COMP_STEP[{table}]")) {
                // "A positive compensation value causes the corresponding machine axis to move in the negative direction."
                *motors.get_mut(axis).unwrap() -= self.value("$AA_ENC_COMP", &table, commands[axis]);
            }
        }
        for table in (0..).take_while(|table| self.variables.contains_key(&format!("$AN_CEC_STEP[{table}]"))) {
            assert_eq!(self.number(format!("$AN_CEC_MULT_BY_TABLE[{table}]")), 0.0);
            let (input, output) = (self.axis("INPUT_AXIS", table), self.axis("OUTPUT_AXIS", table));
            let direction = self.number(format!("$AN_CEC_DIRECTION[{table}]"));
            if direction == 0.0 || direction == directions[input] {
                *motors.get_mut(output).unwrap() += self.value("$AN_CEC", &table.to_string(), commands[input]);
            }
        }
        motors
    }
}

pub(super) const AXES: [(&str, &str); 6] =
    [("X", "AX1"), ("Y", "AX2"), ("Z", "AX3"), ("A", "AX4"), ("B", "AX5"), ("C", "AX6")];

fn settings(machine: &Machine, tables: Value) -> Value {
    let own = AXES.iter().filter(|(axis, _)| machine.model.info().axes.iter().any(|other| other.name == *axis));
    let axes: BTreeMap<&str, &str> = own.copied().collect();
    json!({ "tables": tables, "machine_axes": axes, "most_tables": 60, "most_points": 1000 })
}

/// The example of the manual: Z1 is corrected along Y1, and X1 by its encoder.
#[test]
fn the_control_does_what_the_manual_says() {
    let text = "%_N_NC_CEC_INI\n$AN_CEC[0,0]=0\n$AN_CEC[0,1]=0.01\n$AN_CEC[0,2]=0.012\n$AN_CEC_INPUT_AXIS[0]=(AX2)\n\
                $AN_CEC_OUTPUT_AXIS[0]=(AX3)\n$AN_CEC_STEP[0]=6.73\n$AN_CEC_MIN[0]=-400.0\n$AN_CEC_MAX[0]=-386.54\n\
                $AN_CEC_DIRECTION[0]=0\n$AN_CEC_MULT_BY_TABLE[0]=0\n$AN_CEC_IS_MODULO[0]=0\n$AA_ENC_COMP[0,0,AX1]=0.0\n\
                $AA_ENC_COMP[0,1,AX1]=0.01\n$AA_ENC_COMP[0,2,AX1]=0.012\n$AA_ENC_COMP_STEP[0,AX1]=1.0\n\
                $AA_ENC_COMP_MIN[0,AX1]=-200.0\n$AA_ENC_COMP_MAX[0,AX1]=-198.0\n$AA_ENC_COMP_IS_MODULO[0,AX1]=0\nM17\n";
    let file = ExportedFile { name: "example.ini".to_owned(), content: text.into() };
    let control = Sinumerik::load(&[file], &AXES[..3]);
    let at = |x: f64, y: f64| {
        let of = |values: [f64; 3]| ["X", "Y", "Z"].map(str::to_owned).into_iter().zip(values).collect::<ByAxis>();
        let found = control.motors(&of([x, y, 0.0]), &of([1.0; 3]));
        [found["X"] - x, found["Y"] - y, found["Z"]].map(|value| (value * 1e9).round() / 1e9)
    };
    assert_eq!(at(-199.0, -393.27), [-0.01, 0.0, 0.01]);
    assert_eq!(at(-198.5, -386.54), [-0.011, 0.0, 0.012]);
    assert_eq!(at(0.0, 0.0), [-0.012, 0.0, 0.012]);
    assert_eq!(at(-500.0, -500.0), [0.0, 0.0, 0.0]);
}

/// Half a unit of the last digit for each of up to twelve tables that correct a command, and what it moves the tip.
const ROUNDING: f64 = 1e-6;

#[test]
fn the_law_holds_on_public_machines() {
    for name in ["table-table", "head-table", "three-axis"] {
        let machine = Machine::public(name);
        let export = exporter("siemens-tables", &settings(&machine, json!({ "step_mm": 50, "step_deg": 10 })));
        let statuses = machine.anywhere(300, &["A", "B", "C"], 7);
        holds(&machine, export.as_ref(), &|files| Box::new(Sinumerik::load(files, &AXES)), &statuses, ROUNDING);
    }
}

#[test]
fn the_law_holds_on_random_machines() {
    for seed in seeds(50) {
        let machine = random::machine(seed, random::Errors::Any);
        let export = exporter("siemens-tables", &settings(&machine, json!({ "step_mm": 50 })));
        let statuses = machine.anywhere(60, &[], seed + 1);
        holds(&machine, export.as_ref(), &|files| Box::new(Sinumerik::load(files, &AXES)), &statuses, ROUNDING);
    }
}

/// Where every error depends on one axis only, nothing is left but interpolation, and finer steps leave less of it.
#[test]
fn what_depends_on_one_axis_is_corrected() {
    for seed in seeds(20) {
        let machine = random::machine(seed, random::Errors::OfOneAxis);
        let statuses = machine.anywhere(100, &[], seed + 1);
        let left = [100.0, 20.0].map(|step| {
            let export = exporter("siemens-tables", &settings(&machine, json!({ "step_mm": step })));
            let load = |files: &[ExportedFile]| Box::new(Sinumerik::load(files, &AXES)) as Box<dyn Control>;
            holds(&machine, export.as_ref(), &load, &statuses, ROUNDING)
        });
        let [coarse, fine] = left.map(|left| left.after);
        // Errors are of degree two: the interpolation error goes with the square of the step.
        assert!(fine < 1e-5 + coarse / 20.0 && coarse < random::bow(100.0), "seed {seed}: {left:?}");
        assert!(left[0].before > 20.0 * fine, "{left:?}");
    }
}

/// A rotary axis stands where it should: what is left are digits of the file at the radius of the tool.
#[test]
fn rotary_axes_are_corrected() {
    for seed in seeds(25) {
        let machine = random::machine(seed, random::Errors::Rotary);
        let statuses = machine.anywhere(100, &[], seed + 1);
        let tables =
            json!({ "positioning": machine.model.info().axes.iter().map(|axis| &axis.name).collect::<Vec<_>>() });
        let export = exporter("siemens-tables", &settings(&machine, tables));
        let load = |files: &[ExportedFile]| Box::new(Sinumerik::load(files, &AXES)) as Box<dyn Control>;
        let left = holds(&machine, export.as_ref(), &load, &statuses, ROUNDING);
        assert!(left.before > left.after && left.after < 3e-5, "seed {seed}: {left:?}");
    }
}

/// What the control has already stays, and what is new is added to it.
#[test]
fn tables_that_are_active_are_added() {
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Any);
        let folder = crate::support::temporary();
        let of_other = random::machine_like(seed, seed + 1000);
        let plain = settings(&machine, json!({ "step_mm": 100, "positioning": ["X", "Y"] }));
        let write = |calibration| {
            let files = exporter("siemens-tables", &plain).export(calibration, machine.model.as_ref()).expect("files");
            assert_eq!(files.len(), 1);
            files
        };
        let before = write(&of_other.calibration);
        let path = folder.path().join("before.ini");
        std::fs::write(&path, &before[0].content).expect("a file");
        let mut added = settings(&machine, json!({ "step_mm": 50 }));
        added["existing"] = json!([path]);
        let export = exporter("siemens-tables", &added);
        let after = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let [old, new] = [before, after].map(|files| Sinumerik::load(&files, &AXES));
        let predicted = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("tables");
        let statuses = machine.anywhere(50, &[], seed);
        let predicted = predicted.commands(&statuses).expect("commands");
        let [old, new] = [old, new].map(|control| machine.driven(&control, &statuses));
        for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
            assert!((new - old - (predicted - status)).abs() < ROUNDING, "seed {seed}");
        }
    }
}

#[test]
fn wrong_settings_are_refused() {
    let machine = Machine::public("three-axis");
    let message = |change: Value| {
        let mut settings = settings(&machine, json!({}));
        change.as_object().unwrap().iter().for_each(|(name, value)| settings[name] = value.clone());
        let export = exporter("siemens-tables", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("an error");
        format!("{}: {error}", abbe_core::path_text(&error.setting))
    };
    for (change, expected) in [
        (json!({ "most_tables": 8 }), "most_tables: "),
        (json!({ "most_points": 20 }), "tables.step_mm: axis "),
        (json!({ "machine_axes": { "X": "AX1" } }), "machine_axes: the machine axis of Y is missing"),
        (json!({ "machine_axes": { "V": "AX1" } }), "machine_axes.V: the machine has no axis V"),
        (json!({ "positioning_by": "eec" }), "positioning_by: the correction of "),
        (json!({ "tables": { "step_mm": 33 } }), "tables.step_mm: axis "),
        (json!({ "tables": { "positioning": ["X", "X"] } }), "tables.positioning[1]: axis X is listed twice"),
        (json!({ "tables": { "cross": [{ "correct": "X", "along": "X" }] } }), "tables.cross[0].along: X along itself"),
        (json!({ "tables": { "at": { "X_deg": 1 } } }), "tables.at.X_deg: `X_mm` was expected"),
        (
            json!({ "tables": { "largest_slope_um_per_mm": 1e-6 } }),
            "tables.largest_slope_um_per_mm: the correction of ",
        ),
        (json!({ "tables": { "largest_mm": 1e-4 } }), "tables.largest_mm: "),
        (json!({ "existing": ["nowhere.ini"] }), "existing: "),
    ] {
        let found = message(change.clone());
        assert!(found.starts_with(expected), "{change}: {found}");
    }
    let said = super::law::refused("siemens-tables", &json!({ "machine_axes": { "X": "AX1" }, "first_table": 20_000 }));
    assert!(said.contains("first_table") && said.contains("at most 10000"), "{said}");
}
