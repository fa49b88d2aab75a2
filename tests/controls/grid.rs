//! Corrections over the workspace, read again from CSV and from VTK.
//!
//! The readers know the files only: values at nodes, linear between them one axis after the other.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, exporter, holds, refused, seeds};

/// A set of values of one corrected axis: by the places of its node.
type Values = BTreeMap<Vec<usize>, f64>;

/// A grid as it was read.
struct Table {
    /// Axes with their nodes.
    axes: Vec<(String, Vec<f64>)>,
    /// By the name of the set and of the corrected axis.
    values: BTreeMap<(String, String), Values>,
}

/// `X` of `X_mm`.
fn axis_of(label: &str) -> String {
    label.split_once('_').expect("a unit").0.to_owned()
}

impl Table {
    fn from_csv(text: &str) -> Self {
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let header: Vec<&str> = lines.next().expect("a header").split(',').skip(1).collect();
        let count = header.iter().filter(|label| !label.starts_with('d')).count();
        let rows: Vec<(&str, Vec<f64>)> = lines
            .map(|line| {
                let (set, cells) = line.split_once(',').expect("cells");
                (set, cells.split(',').map(|cell| cell.parse().expect("a number")).collect())
            })
            .collect();
        let nodes = |place: usize| {
            let mut nodes: Vec<f64> = rows.iter().map(|(_, row)| row[place]).collect();
            nodes.sort_by(f64::total_cmp);
            nodes.dedup();
            nodes
        };
        let axes: Vec<(String, Vec<f64>)> = (0..count).map(|place| (axis_of(header[place]), nodes(place))).collect();
        let mut values: BTreeMap<(String, String), Values> = BTreeMap::new();
        for (set, row) in &rows {
            let find = |place: usize| axes[place].1.iter().position(|node| *node == row[place]).expect("a node");
            let node: Vec<usize> = (0..count).map(find).collect();
            for place in count..row.len() {
                let key = ((*set).to_owned(), axis_of(&header[place][1..]));
                let before = values.entry(key).or_default().insert(node.clone(), row[place]);
                assert!(before.is_none(), "a node twice");
            }
        }
        let nodes: usize = axes.iter().map(|(_, nodes)| nodes.len()).product();
        assert!(values.values().all(|values| values.len() == nodes), "nodes are missing");
        Self { axes, values }
    }

    /// A legacy file: a rectilinear grid in ASCII whose points have scalars; the first coordinate changes fastest.
    fn from_vtk(text: &str) -> Self {
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("# vtk DataFile Version 3.0"));
        let title = lines.next().expect("a title");
        assert!(title.len() <= 256);
        let names: Vec<String> = title.split_once(" are ").expect("axes").1.split(' ').map(axis_of).collect();
        let rest: Vec<&str> = lines.flat_map(str::split_whitespace).collect();
        let mut words = rest.into_iter().peekable();
        let expect = |wanted: &[&str], words: &mut std::iter::Peekable<std::vec::IntoIter<&str>>| {
            wanted.iter().for_each(|word| assert_eq!(words.next(), Some(*word)));
        };
        expect(&["ASCII", "DATASET", "RECTILINEAR_GRID", "DIMENSIONS"], &mut words);
        let whole = |words: &mut std::iter::Peekable<std::vec::IntoIter<&str>>| -> usize {
            words.next().and_then(|word| word.parse().ok()).expect("a whole number")
        };
        let numbers = |count: usize, words: &mut std::iter::Peekable<std::vec::IntoIter<&str>>| -> Vec<f64> {
            (0..count).map(|_| words.next().and_then(|word| word.parse().ok()).expect("a number")).collect()
        };
        let sizes = [0, 1, 2].map(|_| whole(&mut words));
        let mut axes = Vec::new();
        for (place, key) in ["X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES"].into_iter().enumerate() {
            expect(&[key], &mut words);
            assert_eq!(whole(&mut words), sizes[place]);
            expect(&["double"], &mut words);
            let nodes = numbers(sizes[place], &mut words);
            if let Some(name) = names.get(place) {
                axes.push((name.clone(), nodes));
            }
        }
        expect(&["POINT_DATA"], &mut words);
        let points = whole(&mut words);
        assert_eq!(points, sizes.iter().product::<usize>());
        let mut values = BTreeMap::new();
        while words.peek().is_some() {
            expect(&["SCALARS"], &mut words);
            let (set, label) = words.next().and_then(|name| name.split_once("_d")).expect("a name");
            expect(&["double", "1", "LOOKUP_TABLE", "default"], &mut words);
            let of_point = |(point, value): (usize, f64)| {
                let place = [point % sizes[0], point / sizes[0] % sizes[1], point / sizes[0] / sizes[1]];
                (place[..axes.len()].to_vec(), value)
            };
            let found: Values = numbers(points, &mut words).into_iter().enumerate().map(of_point).collect();
            values.insert((set.to_owned(), axis_of(label)), found);
        }
        Self { axes, values }
    }

    fn load(files: &[ExportedFile]) -> Box<dyn Control> {
        let text = std::str::from_utf8(&files[0].content).expect("text");
        match files[0].name.as_str() {
            "corrections.csv" => Box::new(Self::from_csv(text)),
            "corrections.vtk" => Box::new(Self::from_vtk(text)),
            name => panic!("{name}"),
        }
    }

    /// The value at commands, by halving the number of axes.
    fn value(&self, values: &Values, commands: &ByAxis, node: &mut Vec<usize>) -> f64 {
        let Some((name, nodes)) = self.axes.get(node.len()) else { return values[node] };
        let command = commands[name].clamp(nodes[0], nodes[nodes.len() - 1]);
        let after = nodes.iter().position(|node| *node >= command).expect("an end").max(1);
        let mut at = |place: usize| {
            node.push(place);
            let value = self.value(values, commands, node);
            node.pop();
            value
        };
        let [low, high] = [at(after - 1), at(after)];
        low + (high - low) * (command - nodes[after - 1]) / (nodes[after] - nodes[after - 1])
    }
}

impl Control for Table {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let mut motors = commands.clone();
        for ((set, axis), values) in &self.values {
            let is_active = match set.strip_prefix("reverse_") {
                Some(reversed) => directions[reversed] < 0.0,
                None => set == "forward",
            };
            if is_active {
                *motors.get_mut(axis).expect("an axis") += self.value(values, commands, &mut Vec::new());
            }
        }
        motors
    }
}

/// Rotary axes of the public machines.
const MACHINES: [(&str, &[&str]); 3] = [("table-table", &["A", "C"]), ("head-table", &["B", "C"]), ("three-axis", &[])];

/// Digits of the file, and what they make in three axes.
const ROUNDING: f64 = 3e-6;

fn steps(step: f64, format: &str) -> Value {
    json!({ "grid": { "step_mm": step }, "format": format })
}

#[test]
fn grids_correct_what_they_predict() {
    for (name, still) in MACHINES {
        for seed in seeds(15) {
            let machine = if seed == 0 { Machine::public(name) } else { Machine::random(name, seed) };
            let statuses = machine.anywhere(60, still, seed + 7);
            let format = if seed % 2 == 0 { "csv" } else { "vtk" };
            let left = |step: f64| {
                let export = exporter("grid", &steps(step, format));
                holds(&machine, export.as_ref(), &Table::load, &statuses, ROUNDING)
            };
            let coarse = left(200.0);
            // Linear between nodes: the error falls with the square of the step, but for what reversal leaves.
            if seed < 2 {
                let fine = left(50.0);
                assert!(fine.after < 0.1 * fine.before, "{name} {seed}: {fine:?}");
                assert!(fine.after < coarse.after / 5.0 + ROUNDING, "{name} {seed}: {coarse:?} {fine:?}");
            }
        }
    }
}

#[test]
fn grids_over_a_rotary_axis_correct_the_tip() {
    for (name, still, rotary) in [("table-table", ["Y", "C"], "A"), ("head-table", ["Y", "C"], "B")] {
        for seed in seeds(3).map(|seed| seed + 1) {
            let machine = Machine::random(name, seed);
            let settings = json!({
                "grid": { "points": { "X": 5, "Z": 5, rotary: 25 } },
                "format": if seed % 2 == 0 { "csv" } else { "vtk" },
            });
            let export = exporter("grid", &settings);
            let statuses = machine.anywhere(80, &still, seed);
            let found = holds(&machine, export.as_ref(), &Table::load, &statuses, ROUNDING);
            assert!(found.after < 0.25 * found.before, "{name} {seed}: {found:?}");
        }
    }
}

/// A grid that was active stays, and what was found with it is added.
#[test]
fn grids_that_are_active_are_added() {
    let folder = crate::support::temporary();
    let path = folder.path().join("corrections.csv");
    for seed in seeds(10) {
        let (machine, other) = (Machine::random("three-axis", seed + 1), Machine::random("three-axis", seed + 1000));
        let old_points = json!({ "X": 3, "Y": 2, "Z": 2 });
        let before = exporter("grid", &json!({ "grid": { "points": old_points } }));
        let before = before.export(&other.calibration, machine.model.as_ref()).expect("a grid");
        std::fs::write(&path, &before[0].content).expect("a file");
        let format = if seed % 2 == 0 { "csv" } else { "vtk" };
        let new = json!({ "grid": { "points": { "X": 5, "Y": 4, "Z": 3 } }, "format": format, "existing": path });
        let export = exporter("grid", &new);
        let after = export.export(&machine.calibration, machine.model.as_ref()).expect("a grid");
        let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("a grid");
        let statuses = machine.anywhere(60, &[], seed + 3);
        let predicted = correction.commands(&statuses).expect("commands");
        let [old, new] = [before, after].map(|files| machine.driven(Table::load(&files).as_ref(), &statuses));
        let mut largest = 0.0_f64;
        for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
            largest = largest.max((old - status).abs());
            assert!((new - old - (predicted - status)).abs() < ROUNDING, "seed {seed}");
        }
        assert!(largest > 1e-3, "the old grid corrects nothing");
    }
    let machine = Machine::public("three-axis");
    let fails = |text: &str, points: Value| {
        std::fs::write(&path, text).expect("a file");
        let settings = json!({ "grid": { "points": points }, "correct": ["X", "Y"], "existing": path });
        let error =
            exporter("grid", &settings).export(&machine.calibration, machine.model.as_ref()).expect_err("wrong");
        error.to_string()
    };
    let (two, head) = (json!({ "X": 2, "Y": 2 }), "set,X_mm,dX_mm\n");
    for (text, expected) in [
        ("", "corrections.csv:1: a line `set,X_mm,..,dX_mm,..` was expected"),
        ("X_mm,dX_mm\n", "corrections.csv:1: the first column"),
        ("set,V_mm,dX_mm\n", "corrections.csv:1: the machine has no axis for the column V_mm"),
        ("set,X_mm\nforward,1\nforward,2\n", "corrections.csv:1: columns of nodes and of corrections"),
        (&format!("{head}forward,0,a\n"), "corrections.csv:2: a number was expected"),
        (&format!("{head}forward,0,NaN\n"), "corrections.csv:2: a number was expected"),
        (&format!("{head}forward,0\n"), "corrections.csv:2: 2 numbers were expected"),
        (&format!("{head}forward,0,1\n"), "corrections.csv:1: X_mm has fewer than two nodes"),
        (&format!("{head}forward,0,1\nforward,1,1\nforward,1,2\n"), "corrections.csv:4: this node stands in two lines"),
        (
            &format!("{head}forward,0,1\nforward,1,1\nreverse_X,1,2\n"),
            "corrections.csv:4: the set reverse_X has 1 nodes; 2",
        ),
        (&format!("{head}forward,0,1\nforward,1,1\nreverse_V,1,2\n"), "corrections.csv:4: `reverse_V` is no set"),
        (&format!("{head}forward,0,1\nforward,1,1\n"), "corrections.csv: it has a node at X_mm 0"),
        ("set,X_mm,dZ_mm\nforward,0,1\nforward,1,1\n", "corrections.csv: it corrects Z_mm"),
    ] {
        let found = fails(text, two.clone());
        assert!(found.contains(expected), "{text}: {found}");
    }
}

#[test]
fn grids_that_cannot_be_written_are_refused() {
    let machine = Machine::public("table-table");
    let fails = |settings: &Value| {
        let error = exporter("grid", settings).export(&machine.calibration, machine.model.as_ref()).expect_err("wrong");
        format!("{:?}: {error}", error.setting)
    };
    let four = fails(&json!({ "grid": { "points": { "X": 2, "Y": 2, "Z": 2, "C": 2 } }, "format": "vtk" }));
    assert!(four.contains("format") && four.contains("4 axes vary"), "{four}");
    assert!(fails(&json!({ "grid": { "points": { "X": 1 } } })).contains("at least one axis has to vary"));
    assert!(fails(&json!({ "grid": { "points": { "V": 3 } } })).contains("the machine has no axis V"));
    let small = fails(&json!({ "grid": { "points": { "X": 3 } }, "largest_tip_correction_mm": 1e-3 }));
    assert!(small.contains("at most 0.001 mm are allowed"), "{small}");
    let both = json!({ "grid": { "points": 2, "both_directions": true } });
    assert!(refused("grid", &both).contains("grid.both_directions"), "{}", refused("grid", &both));
    let listed = json!({ "grid": { "poses": [{ "X_mm": 1 }] } });
    assert!(refused("grid", &listed).contains("grid.poses"), "{}", refused("grid", &listed));
}
