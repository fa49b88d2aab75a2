//! Volumetric compensation of ISG and Beckhoff controls.

use std::collections::BTreeMap;

use abbe_core::{Build, Context, ExportedFile, Kind};
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, exporter, holds, seeds};
use super::random;
use crate::support::registry;

/// A rigid motion as 3 x 4 numbers.
type Motion = [[f64; 4]; 3];

const STILL: Motion = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

fn after(a: &Motion, b: &Motion) -> Motion {
    let mut found = [[0.0; 4]; 3];
    for (row, line) in found.iter_mut().enumerate() {
        for (column, cell) in line.iter_mut().enumerate() {
            *cell = (0..3).map(|k| a[row][k] * b[k][column]).sum::<f64>() + if column == 3 { a[row][3] } else { 0.0 };
        }
    }
    found
}

fn inverse(a: &Motion) -> Motion {
    let mut found = [[0.0; 4]; 3];
    for row in 0..3 {
        for column in 0..3 {
            found[row][column] = a[column][row];
            found[row][3] -= a[column][row] * a[column][3];
        }
    }
    found
}

fn shift(by: [f64; 3]) -> Motion {
    let mut found = STILL;
    (0..3).for_each(|row| found[row][3] = by[row]);
    found
}

/// A turn about the axis x, y or z.
fn turn(about: usize, angle: f64) -> Motion {
    let mut found = STILL;
    let (i, j) = ((about + 1) % 3, (about + 2) % 3);
    let (sine, cosine) = angle.sin_cos();
    (found[i][i], found[i][j], found[j][i], found[j][j]) = (cosine, -sine, sine, cosine);
    found
}

fn times(a: &Motion, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|row| (0..3).map(|k| a[row][k] * p[k]).sum::<f64>() + a[row][3])
}

/// A control that has read its configuration and the tables that it names.
pub struct Isg {
    chain: Vec<char>,
    carrying: usize,
    constants: BTreeMap<String, f64>,
    /// Position (mm, deg) and value (mm, rad) by the name of the error.
    curves: BTreeMap<String, Vec<[f64; 2]>>,
    sign: f64,
}

impl Isg {
    pub fn load(files: &[ExportedFile], configuration: &str) -> Self {
        let read = |name: &str| {
            let file = files.iter().find(|file| file.name == name).unwrap_or_else(|| panic!("no file {name}"));
            String::from_utf8(file.content.clone()).expect("text")
        };
        let list = read(configuration);
        let mut words = BTreeMap::new();
        for line in list.lines().filter(|line| !line.starts_with('#')) {
            let (key, value) = line.split_once(char::is_whitespace).expect("a key and a value");
            assert!(words.insert(key.to_owned(), value.trim().to_owned()).is_none(), "{key} twice");
        }
        assert_eq!(words["Interpolation"], "GRID");
        let chain: Vec<char> = words["chain"].chars().collect();
        assert!(chain.iter().all(|axis| words.contains_key(&axis.to_string())), "an axis without a number");
        let mut control = Self {
            chain,
            carrying: words["workpiece_axes"].parse().expect("a number"),
            constants: BTreeMap::new(),
            curves: BTreeMap::new(),
            sign: if words.contains_key("negate") { -1.0 } else { 1.0 },
        };
        for index in 0.. {
            let Some(name) = words.get(&format!("file[{index}]")) else { break };
            match words[&format!("file_format[{index}]")].as_str() {
                "ISG_CSV" => control.isg_csv(&read(name)),
                "ETALON_EXCHANGE" => control.etalon(&read(name)),
                other => panic!("{other}"),
            }
        }
        control
    }

    fn isg_csv(&mut self, text: &str) {
        let mut header: Vec<String> = Vec::new();
        for line in text.lines().map(|line| line.split("//").next().unwrap_or_default().trim()) {
            let cells: Vec<&str> = line.split_whitespace().collect();
            if line.starts_with('#') {
                header.clear();
            } else if header.is_empty() {
                header = cells.iter().map(|cell| (*cell).to_owned()).collect();
            } else {
                let values: Vec<f64> = cells.iter().map(|cell| cell.parse().expect("a number")).collect();
                assert_eq!(values.len(), header.len());
                let argument = header.iter().position(|name| name.len() == 1);
                for (name, value) in header.iter().zip(&values).filter(|(name, _)| name.len() > 1) {
                    match argument {
                        Some(place) => self.curves.entry(name.clone()).or_default().push([values[place], *value]),
                        None => assert!(self.constants.insert(name.clone(), *value).is_none(), "{name} twice"),
                    }
                }
            }
        }
    }

    fn etalon(&mut self, text: &str) {
        let mut name = String::new();
        for line in text.lines() {
            if let Some(section) = line.strip_prefix('[') {
                name = section.trim_end_matches(']').to_owned();
            } else if let Some(value) = line.strip_prefix("VALUE = ") {
                self.constants.insert(name.clone(), value.parse().expect("a number"));
            } else if !line.starts_with("Gridpoints") && line != "}" {
                let cells: Vec<f64> = line.split_whitespace().map(|cell| cell.parse().expect("a number")).collect();
                self.curves.entry(name.clone()).or_default().push([cells[0], cells[1]]);
            }
        }
    }

    fn value(&self, name: &str, position: f64) -> f64 {
        let Some(table) = self.curves.get(name) else { return 0.0 };
        if position <= table[0][0] {
            return table[0][1];
        }
        let pair = table.windows(2).find(|pair| position < pair[1][0]);
        let Some([[a, from], [b, to]]) = pair else { return table[table.len() - 1][1] };
        from + (to - from) * (position - a) / (b - a)
    }

    fn body(&self, axes: impl Iterator<Item = char>, side: f64, at: &ByAxis, with_errors: bool) -> Motion {
        let constant = |name: String| self.constants.get(&name).copied().unwrap_or(0.0);
        let mut found = STILL;
        for axis in axes {
            let letter = "XYZABC".find(axis).expect("an axis");
            let command = at[&axis.to_string()];
            let center = ["X", "Y", "Z"].map(|letter| constant(format!("P{letter}{axis}")));
            let mut own = shift(center);
            if with_errors {
                let six = |name: &dyn Fn(char) -> f64| "XYZABC".chars().map(name).collect::<Vec<f64>>();
                let located = six(&|letter| constant(format!("{letter}0{axis}")));
                let moved = six(&|letter| self.value(&format!("E{letter}{axis}"), command));
                for error in [located, moved] {
                    own = after(&own, &shift([error[0], error[1], error[2]]));
                    for about in [2, 1, 0] {
                        own = after(&own, &turn(about, error[3 + about]));
                    }
                }
            }
            let motion = match letter {
                0..3 => shift(std::array::from_fn(|row| if row == letter { side * command } else { 0.0 })),
                _ => turn(letter - 3, side * command.to_radians()),
            };
            own = after(&after(&own, &motion), &shift(center.map(|value| -value)));
            found = after(&found, &own);
        }
        found
    }

    fn tip(&self, at: &ByAxis, with_errors: bool) -> [f64; 3] {
        let carrying = self.chain[..self.carrying].iter().rev().copied();
        let workpiece = self.body(carrying, -1.0, at, with_errors);
        let tool = self.body(self.chain[self.carrying..].iter().copied(), 1.0, at, with_errors);
        times(&inverse(&workpiece), times(&tool, ["P0X", "P0Y", "P0Z"].map(|name| self.constants[name])))
    }

    /// The solution of three equations by Cramer's rule.
    fn solved(columns: [[f64; 3]; 3], right: [f64; 3]) -> [f64; 3] {
        let cross = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3])
        };
        let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let of = |c: [[f64; 3]; 3]| dot(c[0], cross(c[1], c[2]));
        std::array::from_fn(|k| {
            let mut with = columns;
            with[k] = right;
            of(with) / of(columns)
        })
    }
}

impl Control for Isg {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let goal = self.tip(commands, false);
        let minus = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| a[k] - b[k]) };
        let columns = ["X", "Y", "Z"].map(|axis| {
            let mut moved = commands.clone();
            *moved.get_mut(axis).expect("an axis") += 1.0;
            minus(self.tip(&moved, false), goal)
        });
        let mut found = commands.clone();
        for _ in 0..20 {
            let step = Self::solved(columns, minus(self.tip(&found, true), goal));
            for (axis, step) in ["X", "Y", "Z"].into_iter().zip(step) {
                *found.get_mut(axis).expect("an axis") -= step;
            }
        }
        let turned =
            |(axis, command): (&String, &f64)| (axis.clone(), commands[axis] + self.sign * (command - commands[axis]));
        found.iter().map(turned).collect()
    }
}

fn settings(machine: &Machine, format: &str) -> Value {
    let axes = machine.model.info().axes.iter().filter(|axis| !axis.indexed).enumerate();
    let numbers: BTreeMap<&str, usize> = axes.map(|(index, axis)| (axis.name.as_str(), index + 1)).collect();
    json!({ "axis_numbers": numbers, "format": format })
}

/// The example of the section "ISG CSV format" of the manual: names, units, interpolation.
#[test]
fn the_emulator_reads_the_example_of_the_manual() {
    let table = "// The header only contains position errors.\nY0A Z0A X0B\n0.1 0.2 0.11\n#\nX EXX EYX EZX EAX EBX ECX\n\
                 0.0 0.02 0.01 0.07 0.00 0.0042 0.003\n10.0 0.00 -0.1 0.01 0.00 0.0011 0.002\n";
    let list = "X 1\nchain X\nworkpiece_axes 0\nInterpolation GRID\nfile[0] t\nfile_format[0] ISG_CSV\n";
    let file = |name: &str, text: &str| ExportedFile { name: name.to_owned(), content: text.as_bytes().to_vec() };
    let control = Isg::load(&[file("l", list), file("t", table)], "l");
    assert_eq!(control.constants["X0B"], 0.11);
    assert!((control.value("EYX", 5.0) + 0.045).abs() < 1e-15);
    assert_eq!(control.value("EBX", 20.0), 0.0011);
}

fn law(machine: &Machine, seed: u64) -> super::law::Left {
    let mut found = None;
    for format in ["isg-csv", "etalon-exchange"] {
        let export = exporter("isg-volumetric", &settings(machine, format));
        let load = |files: &[ExportedFile]| -> Box<dyn Control> { Box::new(Isg::load(files, "isg-volumetric.lis")) };
        let statuses = machine.anywhere(200, &[], seed);
        found = Some(holds(machine, export.as_ref(), &load, &statuses, 1e-7));
    }
    found.expect("two formats")
}

/// What the tables cannot correct: the set-up errors of the tool, and reversal, of rotary axes at most this far from the tip, mm.
pub fn remains(machine: &Machine) -> f64 {
    const FAR: f64 = 700.0;
    let parameters = machine.model.info().parameters.iter().zip(&machine.values);
    let of = |wanted: &dyn Fn(&str) -> bool, factor: f64| -> f64 {
        parameters.clone().filter(|(own, _)| wanted(&own.name)).map(|(_, value)| factor * value.abs()).sum()
    };
    let reversal =
        |axes: &'static str| move |name: &str| name.ends_with("[b]") && name[2..3].contains(|axis| axes.contains(axis));
    of(&|name| ["dxt", "dyt", "dzt"].contains(&name), 1.0) + of(&reversal("XYZ"), 1.0) + of(&reversal("ABC"), FAR)
}

#[test]
fn tables_correct_the_public_machines() {
    for name in ["table-table", "head-table", "three-axis"] {
        let machine = Machine::public(name);
        let found = law(&machine, 3);
        assert!(found.after < found.before && found.after < remains(&machine) + 1e-3, "{name}: {found:?}");
    }
}

/// Without reversal and set-up errors all of the tip's error goes, up to the interpolation of parabolas: step squared times curvature
/// over eight, for points every 20 mm or 5 degrees.
#[test]
fn tables_correct_random_machines() {
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Smooth);
        let found = law(&machine, seed + 1);
        assert!(found.after < 5e-4 && found.before > 0.01, "machine {seed}: {found:?}");
    }
}

/// Tables that were active stay, and what was found with them is added, to first order.
#[test]
fn tables_that_are_active_are_added() {
    let folder = crate::support::temporary();
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Smooth);
        let other = random::machine_of(seed, random::Errors::Smooth, seed + 1000);
        let [old_format, new_format] =
            if seed % 2 == 0 { ["isg-csv", "etalon-exchange"] } else { ["etalon-exchange", "isg-csv"] };
        let mut old = settings(&machine, old_format);
        (old["step_mm"], old["step_deg"]) = (json!(75), json!(40));
        let before =
            exporter("isg-volumetric", &old).export(&other.calibration, machine.model.as_ref()).expect("tables");
        let mut paths = Vec::new();
        for file in before.iter().filter(|file| !file.name.ends_with(".lis")) {
            paths.push(folder.path().join(&file.name));
            std::fs::write(paths.last().expect("a path"), &file.content).expect("a file");
        }
        let mut new = settings(&machine, new_format);
        new["existing"] = json!(paths);
        let export = exporter("isg-volumetric", &new);
        let after = export.export(&machine.calibration, machine.model.as_ref()).expect("tables");
        let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("one").expect("tables");
        let statuses = machine.anywhere(60, &[], seed + 3);
        let predicted = correction.commands(&statuses).expect("commands");
        let [old, new] =
            [before, after].map(|files| machine.driven(&Isg::load(&files, "isg-volumetric.lis"), &statuses));
        let mut largest = 0.0_f64;
        for (((status, old), new), predicted) in statuses.iter().zip(old).zip(new).zip(predicted) {
            largest = largest.max((old - status).abs());
            assert!(
                (new - old - (predicted - status)).abs() < 3e-5,
                "seed {seed}: {}",
                new - old - (predicted - status)
            );
        }
        assert!(largest > 5e-3, "seed {seed}: the old tables correct nothing");
    }
}

#[test]
fn tables_that_cannot_be_added_are_refused() {
    let machine = Machine::public("three-axis");
    let folder = crate::support::temporary();
    let path = folder.path().join("old.csv");
    for (text, expected) in [
        ("X EXX\n0 1 2\n", "old.csv:2: 2 numbers were expected, here are 3"),
        ("X EXX\n0 a\n", "old.csv:2: a number was expected"),
        ("X EXX\n0 NaN\n", "old.csv:2: a number was expected"),
        ("X EXX\n0 1\n0 2\n", "old.csv:1: positions of EXX have to increase"),
        ("X EYY\n0 1\n", "old.csv:1: EYY over X is not added"),
        ("X Y EXX\n0 0 1\n", "old.csv:1: errors over several axes"),
        ("X EXX\n0 1\n#\nX EXX\n0 1\n", "old.csv:4: EXX stands there twice"),
        ("P0X\n1\n2\n", "old.csv:1: one line of numbers"),
        ("P0X\n1000\n", "P0X is 1000 in the active tables"),
        ("// comment\nX0C\n0.1\n", "the active tables have X0C"),
        ("[EXX]\nGridpoints = {\n0 1\n", "old.csv:1: [EXX] has no end"),
        ("[EXX]\nGridpoints = {\n0 1 2\n}\n", "old.csv:3: a position and a value"),
        ("[EXX\nVALUE = 1\n", "old.csv:1: a section `[NAME]`"),
        ("[C0Y]\n1\n", "old.csv:1: `VALUE = ..`"),
    ] {
        std::fs::write(&path, text).expect("a file");
        let mut settings = settings(&machine, "isg-csv");
        settings["existing"] = json!([path]);
        let export = exporter("isg-volumetric", &settings);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("a bad table");
        assert!(error.to_string().contains(expected), "{text}: {error}");
    }
}

#[test]
fn bad_settings_are_named() {
    let registry = registry();
    let Build::Export(constructor) = &registry.find(Kind::Export, "isg-volumetric").expect("an exporter").build else {
        unreachable!("it is an exporter")
    };
    let context = Context { base: ".".into() };
    for (settings, expected) in [
        (json!({}), "the setting `axis_numbers` is missing"),
        (json!({ "axis_numbers": { "X": 0 } }), "axis_numbers.X: a number from 1 was expected"),
        (json!({ "axis_numbers": { "X": 2, "Y": 2 } }), "axis_numbers.X: two axes have the number 2"),
        (
            json!({ "axis_numbers": { "X": 1 }, "step_mm": 0 }),
            "step_mm: a positive number, at most 1000000, was expected",
        ),
    ] {
        let error = constructor.build(&settings, &context).err().expect("bad settings");
        assert_eq!(error.to_string(), expected);
    }
    let machine = Machine::public("three-axis");
    for (numbers, expected) in [
        (json!({ "X": 1, "Y": 2 }), "the number of axis Z in the control is missing"),
        (json!({ "X": 1, "Y": 2, "Z": 3, "C": 4 }), "the machine has no axis C"),
    ] {
        let export = exporter("isg-volumetric", &json!({ "axis_numbers": numbers }));
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("a wrong machine");
        assert_eq!(error.message, expected);
    }
}
