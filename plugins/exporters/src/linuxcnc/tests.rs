//! Tests of the component.

use super::*;
use crate::testing::{built, calibration, chain, key_error};
use abbe_core::Poses;

/// The trims that LinuxCNC makes of a file: (nominal, forward, reverse).
fn load(text: &str, kind: u64) -> Vec<[f64; 3]> {
    let mut table: Vec<[f64; 3]> = Vec::new();
    for line in text.lines() {
        let cells: Vec<f64> = line.split_whitespace().map_while(|cell| cell.parse().ok()).collect();
        let &[nominal, forward, reverse] = cells.as_slice() else { break };
        assert!(table.last().is_none_or(|last| last[0] < nominal), "{nominal} does not increase");
        let trims = if kind == 0 { [nominal - forward, nominal - reverse] } else { [forward, reverse] };
        table.push([nominal, trims[0], trims[1]]);
    }
    assert_eq!(table.len(), text.lines().count());
    assert!(table.len() <= 256);
    table
}

fn trim(table: &[[f64; 3]], position: f64, direction: f64) -> f64 {
    let column = if direction > 0.0 { 1 } else { 2 };
    let (first, last) = (table.first().unwrap(), table.last().unwrap());
    if position <= first[0] {
        return first[column];
    }
    if position >= last[0] {
        return last[column];
    }
    let after = table.iter().position(|row| row[0] > position).unwrap();
    let (a, b) = (table[after - 1], table[after]);
    a[column] + (position - a[0]) / (b[0] - a[0]) * (b[column] - a[column])
}

fn tip(model: &dyn KinematicModel, status: &[f64], values: &[f64]) -> [f64; 3] {
    let mut poses = Poses::default();
    model.poses(status, values, &[], false, &mut poses).unwrap();
    poses.positions[0]
}

/// Loads the exported file as LinuxCNC does and checks that the machine then is where it was told to be.
#[test]
fn compensated_positions_are_right() {
    let root = std::f64::consts::FRAC_1_SQRT_2;
    let linear = |name: &str| {
        json!([{ "polynomial": [format!("E{name}{name}")], "degrees": [1, 2, 3] },
            { "backlash": [format!("E{name}{name}")] }])
    };
    let tilted = json!([{ "polynomial": ["EBB", "ECB"], "degrees": [1, 2] }, { "backlash": ["EBB", "ECB"] }]);
    let range = json!({ "range_mm": [-300, 300] });
    let cases = [
        ("w b X Y Z t", "X", json!({ "X": range }), linear("X")),
        ("w X' b Y Z t", "X", json!({ "X": range }), linear("X")),
        ("w X' b Y Z t", "X", json!({ "X": { "range_mm": [-300, 300], "reverse": true } }), linear("X")),
        ("w b X Y Z t", "Y", json!({ "Y": { "range_mm": [-300, 300], "reverse": true } }), linear("Y")),
        (
            "w B' b X Y Z t",
            "B",
            json!({ "B": { "range_deg": [-120, 120], "direction": [0, root, root],
            "point_mm": [10, 20, 30] } }),
            tilted.clone(),
        ),
        ("w b X Y Z B t", "B", json!({ "B": { "range_deg": [-120, 120], "direction": [0, root, root] } }), tilted),
    ];
    for (loop_, name, axes, errors) in cases {
        let model = chain(loop_, axes, errors);
        let axis = model.info().axes.iter().find(|axis| axis.name == name).unwrap();
        let (_, factor) = position_unit(axis);
        let mut values = Vec::new();
        for parameter in &model.info().parameters {
            let size = match parameter.name.get(3..) {
                Some("[1]") if parameter.name.starts_with('E') => 3e-5,
                Some("[2]") if axis.kind == AxisKind::Linear => 2e-8,
                Some("[2]") => 2e-5,
                Some("[3]") => 5e-11,
                Some("[b]") => 4e-5,
                _ => 0.0,
            };
            // Equal about Y and Z: the tilted axis has errors along it only, as others are not for this file.
            values.push((parameter.name.clone(), size));
        }
        let named: Vec<(&str, f64)> = values.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let calibration = calibration(model.as_ref(), &named);
        let values: Vec<f64> = values.iter().map(|(_, value)| *value).collect();
        let zero = vec![0.0; values.len()];
        for kind in [0, 1] {
            let stage = built(&json!({ "type": kind, "step_mm": 75, "step_deg": 40 }), build);
            let files = stage.unwrap().export(&calibration, model.as_ref()).unwrap();
            assert_eq!(files.len(), 2);
            assert_eq!(files[0].name, format!("{}.comp", name.to_lowercase()));
            let table = load(std::str::from_utf8(&files[0].content).unwrap(), kind);
            assert!(table.iter().any(|row| row[1].abs() > 1e-3));
            for row in &table {
                for direction in [1.0, -1.0] {
                    let command = (row[0] + trim(&table, row[0], direction)) / factor;
                    let wanted = tip(model.as_ref(), &status(model.as_ref(), axis, row[0] / factor, direction), &zero);
                    let raw = status(model.as_ref(), axis, row[0] / factor, direction);
                    let off = distance(tip(model.as_ref(), &raw, &values), wanted);
                    let found = tip(model.as_ref(), &status(model.as_ref(), axis, command, direction), &values);
                    let left = distance(found, wanted);
                    // Second order: the error at the corrected command instead of at the point.
                    assert!(left < 1e-5, "{loop_} {name} type {kind} at {}: {left} of {off}", row[0]);
                }
            }
        }
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn the_files_of_a_backlash() {
    let axes = json!({ "X": { "range_mm": [-10, 10] }, "B": { "range_deg": [0, 30] } });
    let errors = json!([{ "backlash": ["EXX", "EBB"] }, { "polynomial": ["EXX"], "degrees": [1] }]);
    let model = chain("w B' b X Y Z (S) t", axes, errors);
    let values = [("EXX[b]", 0.002), ("EXX[1]", 1e-4), ("EBB[b]", (0.001_f64).to_radians())];
    let calibration = calibration(model.as_ref(), &values);
    let stage = built(&json!({ "step_mm": 10, "step_deg": 20 }), build).unwrap();
    let files = stage.export(&calibration, model.as_ref()).unwrap();
    let found: Vec<(&str, &str)> =
        files.iter().map(|file| (file.name.as_str(), std::str::from_utf8(&file.content).unwrap())).collect();
    // B carries the workpiece: its body moves the other way, so its reversal shows with the other sign.
    let expected_ini = format!(
        "{INI_HEADER}\n# Axis B: 3 points from 0 to 30 deg; n is the number of its joint.\n[JOINT_n]\nCOMP_FILE = \
         b.comp\nCOMP_FILE_TYPE = 0\n\n# Axis X: 3 points from -10 to 10 mm; n is the number of its joint.\n\
         [JOINT_n]\nCOMP_FILE = x.comp\nCOMP_FILE_TYPE = 0\n"
    );
    assert_eq!(
        found,
        [
            ("b.comp", "0 -0.001000 0.001000\n20 19.999000 20.001000\n30 29.999000 30.001000\n"),
            ("x.comp", "-10 -9.999000 -10.003000\n0 0.002000 -0.002000\n10 10.003000 9.999000\n"),
            ("linuxcnc.ini", expected_ini.as_str()),
        ]
    );
}

#[test]
fn errors_point_at_the_setting() {
    let errors = json!([{ "polynomial": ["EXX", "EYX"], "degrees": [1] }]);
    let cases = [
        (json!({ "axes": ["Y"] }), "axes[0]: axis Y has no positioning error in the model"),
        (json!({ "axes": ["X", "X"] }), "axes[1]: axis X is listed twice"),
        (json!({ "axes": ["x"] }), "axes[0]: the machine has no axis x (did you mean `X`?)"),
        (
            json!({ "step_mm": 1 }),
            "step_mm: axis X from -300 to 300 mm every 1 mm has 601 points; at most 256 fit (2.36 mm is the smallest \
             step that fits)",
        ),
    ];
    let model = chain("w b X Y Z t", json!({ "X": { "range_mm": [-300, 300] } }), errors);
    for (settings, expected) in cases {
        let stage = built(&settings, build).unwrap();
        assert_eq!(key_error(stage.export(&calibration(model.as_ref(), &[]), model.as_ref())), expected);
    }
    let bare = chain("w b X Y Z t", json!({}), json!([{ "polynomial": ["EYX"], "degrees": [1] }]));
    let stage = built(&json!({}), build).unwrap();
    assert_eq!(
        key_error(stage.export(&calibration(bare.as_ref(), &[]), bare.as_ref())),
        ": no axis of the model has a positioning error to compensate (list some under `errors` of the model, e.g. \
         `{ polynomial: [EXX], degrees: [1, 2, 3] }`)"
    );
    let refused = [
        (json!({ "type": 2 }), "type: 0 (actual positions) or 1 (trims) was expected"),
        (json!({ "axes": [] }), "axes: at least one axis was expected"),
        (
            json!({ "step": 2 }),
            "step: unknown setting `step` (possible are: step_mm, step_deg, type, axes, ranges, existing, largest_mm, largest_deg)",
        ),
    ];
    for (settings, expected) in refused {
        let found = built(&settings, build).err().unwrap().to_string();
        assert_eq!(found, expected);
    }
    assert!(built(&example(), build).is_ok());
}
