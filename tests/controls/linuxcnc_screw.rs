//! Screw compensation of LinuxCNC, from its documentation and what `usrmotLoadComp` and `compute_screw_comp` do.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::json;

use super::law::{ByAxis, Control, Machine, exporter, holds, predicted, seeds};
use super::random;

/// Lines of a file by axis: nominal position, trims forward and reverse.
struct LinuxCnc(BTreeMap<String, Vec<[f64; 3]>>);

impl LinuxCnc {
    fn load(files: &[ExportedFile], kind: u8) -> Self {
        let mut joints = BTreeMap::new();
        for file in files {
            let Some(axis) = file.name.strip_suffix(".comp") else { continue };
            let mut table: Vec<[f64; 3]> = Vec::new();
            for line in std::str::from_utf8(&file.content).expect("text").lines() {
                let cells: Vec<f64> = line.split_whitespace().map_while(|cell| cell.parse().ok()).collect();
                let &[nominal, forward, reverse] = cells.as_slice() else { break };
                assert!(table.last().is_none_or(|last| last[0] < nominal), "{nominal} does not increase");
                let trims = if kind == 0 { [nominal - forward, nominal - reverse] } else { [forward, reverse] };
                table.push([nominal, trims[0], trims[1]]);
            }
            assert!((1..=256).contains(&table.len()));
            joints.insert(axis.to_uppercase(), table);
        }
        Self(joints)
    }
}

impl Control for LinuxCnc {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut motors = commands.clone();
        for (axis, table) in &self.0 {
            let (at, column) = (commands[axis], if directions[axis] > 0.0 { 1 } else { 2 });
            let trim = match table.iter().position(|row| row[0] >= at) {
                None => table[table.len() - 1][column],
                Some(0) => table[0][column],
                Some(next) => {
                    let (low, high) = (table[next - 1], table[next]);
                    low[column] + (at - low[0]) * (high[column] - low[column]) / (high[0] - low[0])
                }
            };
            *motors.get_mut(axis).unwrap() += trim;
        }
        motors
    }
}

/// Measured on the real control: half way between trims 0.014 at -100 and 0.009 at -50 it adds 0.0115.
#[test]
fn the_control_does_what_was_measured() {
    let file = ExportedFile { name: "x.comp".to_owned(), content: "-100 0.014 0\n-50 0.009 0.002\n".into() };
    let control = LinuxCnc::load(&[file], 1);
    let at = |x: f64, direction: f64| {
        let of = |value: f64| ByAxis::from([("X".to_owned(), value)]);
        ((control.motors(&of(x), &of(direction))["X"] - x) * 1e9).round() / 1e9
    };
    assert_eq!([at(-75.0, 1.0), at(-200.0, 1.0), at(0.0, 1.0)], [0.0115, 0.014, 0.009]);
    assert_eq!([at(-75.0, -1.0), at(0.0, -1.0)], [0.001, 0.002]);
}

#[test]
fn the_law_holds() {
    let public = ["table-table", "head-table", "three-axis"].map(Machine::public).into_iter();
    let random = seeds(50).map(|seed| random::machine(seed, random::Errors::Any));
    for (seed, machine) in public.chain(random).enumerate() {
        for kind in [0, 1] {
            let settings = json!({ "type": kind, "axes": ["X", "Y", "Z"] });
            let export = exporter("linuxcnc", &settings);
            let statuses = machine.anywhere(60, &[], seed as u64 + 5);
            predicted(&machine, export.as_ref(), &|files| Box::new(LinuxCnc::load(files, kind)), &statuses, 1e-8);
        }
    }
}

/// Where axes have no other errors, nothing is left but interpolation.
#[test]
fn positioning_errors_are_corrected() {
    for seed in seeds(50) {
        let machine = random::machine(seed, random::Errors::Positioning);
        let statuses = machine.anywhere(100, &[], seed + 1);
        for step in [75.0, 10.0] {
            let export = exporter("linuxcnc", &json!({ "step_mm": step }));
            let left = holds(&machine, export.as_ref(), &|files| Box::new(LinuxCnc::load(files, 0)), &statuses, 1e-8);
            assert!(left.before > 1e-3 && left.after < random::bow(step), "seed {seed}, step {step}: {left:?}");
        }
    }
}

#[test]
fn files_that_are_active_are_added() {
    let machine = random::machine(3, random::Errors::Any);
    let folder = crate::support::temporary();
    let path = folder.path().join("old.comp");
    let old = "-300 0.001 -0.002\n-10 0.003 0.001\n290 -0.004 0.002\n";
    std::fs::write(&path, old).expect("a file");
    let export = exporter("linuxcnc", &json!({ "type": 1, "axes": ["X"], "existing": { "X": path } }));
    let new = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
    let old = ExportedFile { name: "x.comp".to_owned(), content: old.into() };
    let statuses = machine.anywhere(100, &[], 4);
    let [old, new] = [vec![old], new].map(|files| machine.driven(&LinuxCnc::load(&files, 1), &statuses));
    let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("tables");
    let predicted = correction.commands(&statuses).expect("commands");
    assert!(statuses.iter().zip(&predicted).any(|(status, predicted)| (status - predicted).abs() > 1e-3));
    for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
        assert!((new - old - (predicted - status)).abs() < 1e-9);
    }
}

/// A file of the other type, in inches, or with a misread digit would move an axis by hundreds of millimetres.
#[test]
fn files_of_another_kind_are_refused() {
    let machine = random::machine(3, random::Errors::Any);
    let folder = crate::support::temporary();
    let path = folder.path().join("old.comp");
    for (kind, old, line, says) in [
        (0, "-300 -300.001 -299.998\n0 0.003 0.001\n300 299.996 300.002\n", None, ""),
        (1, "-300 -300.001 -299.998\n0 0.003 0.001\n300 299.996 300.002\n", Some(1), "type"),
        (0, "-300 0.001 -0.002\n300 -0.004 0.002\n", Some(1), "type"),
        (0, "-300 -300.001 -299.998\n0 100.003 0.001\n300 299.996 300.002\n", Some(2), "largest_mm"),
        (0, "-11.8 -11.8001 -11.8\n11.8 11.8001 11.8\n", None, "it covers 23.6 mm of"),
    ] {
        std::fs::write(&path, old).expect("a file");
        let export = exporter("linuxcnc", &json!({ "type": kind, "axes": ["X"], "existing": { "X": path } }));
        match export.export(&machine.calibration, machine.model.as_ref()) {
            Ok(_) => assert!(says.is_empty(), "{old}"),
            Err(error) => {
                let told = format!("{error} {:?}", error.help);
                assert!(!says.is_empty() && told.contains(says), "{old}: {told}");
                let place = error.place.expect("a place");
                assert_eq!((place.line, place.file), (line, path.clone()));
            }
        }
    }
    let export = exporter("linuxcnc", &json!({ "axes": ["X"], "largest_mm": 1e-9 }));
    assert!(export.export(&machine.calibration, machine.model.as_ref()).is_err());
}
