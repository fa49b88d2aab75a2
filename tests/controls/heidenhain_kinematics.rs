//! KinematicsComp of Heidenhain.
//!
//! Emulator: reads the kinematics table entry by entry, from the tool to the table (Technical Manual iTNC 530 HSCI, p. 722), takes
//! errors from the columns of the `.COM` files that `CONFIG.CMA` names, and looks for positions of X, Y and Z with which the place of
//! the tool on the table is that of the same table without errors. Then columns of axes themselves act, as in `heidenhain-tables`.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::five_axes::{Errors as Displaced, Layout, machine as five_axes};
use super::isg_volumetric::remains;
use super::law::{ByAxis, Control, Left, Machine, exporter, predicted, refused, seeds};
use super::random;

type Place = [f64; 3];

/// A line of the kinematics table.
#[derive(Debug, Clone)]
struct Entry {
    name: String,
    key: String,
    axis: String,
    coordinate: f64,
    /// Axis and column of an error.
    source: Option<(String, String)>,
}

/// A `.COM` file.
#[derive(Debug, Clone, Default)]
struct Com {
    datum: f64,
    distance: f64,
    columns: BTreeMap<String, Vec<f64>>,
}

impl Com {
    fn read(text: &str) -> Self {
        let mut lines = text.lines();
        let begin = lines.next().expect("a first line");
        let number = |word: &str| {
            let rest = begin.split(word).nth(1).unwrap_or_else(|| panic!("{word} in {begin}"));
            rest.split_whitespace().next().expect("a number").parse().expect("a number")
        };
        let names: Vec<&str> = lines.next().expect("a head").split_whitespace().collect();
        assert_eq!(names[0], "NR");
        let mut com = Self { datum: number("DATUM:"), distance: number("DISTANCE:"), columns: BTreeMap::new() };
        for (count, line) in lines.take_while(|line| *line != "[END]").enumerate() {
            let cells: Vec<f64> = line.split_whitespace().map(|cell| cell.parse().expect("a number")).collect();
            assert!(cells.len() == names.len() && cells[0] == count as f64 && count < 256, "{line}");
            for (name, cell) in names.iter().zip(&cells).skip(1) {
                com.columns.entry((*name).to_owned()).or_default().push(*cell);
            }
        }
        com
    }

    fn at(&self, column: &str, position: f64) -> f64 {
        let Some(values) = self.columns.get(column) else { return 0.0 };
        let steps = (position - self.datum) / self.distance;
        let steps = steps.max(0.0).min((values.len() - 1) as f64);
        let before = (steps as usize).min(values.len() - 2);
        values[before] + (steps - before as f64) * (values[before + 1] - values[before])
    }
}

/// A control with its kinematics table and compensation files.
#[derive(Clone)]
struct Tnc {
    entries: Vec<Entry>,
    tables: BTreeMap<String, Com>,
    /// Length of the tool in the spindle, mm, in the direction of Z.
    tool: f64,
    adds: bool,
}

impl Tnc {
    fn load(files: &[ExportedFile], tool: f64, adds: bool) -> Self {
        let text = |name: &str| {
            let file = files.iter().find(|file| file.name == name).unwrap_or_else(|| panic!("no file {name}"));
            std::str::from_utf8(&file.content).expect("text").to_owned()
        };
        let assigned = text("CONFIG.CMA");
        let rows: Vec<Vec<&str>> = assigned.lines().map(|line| line.split_whitespace().collect()).collect();
        assert!(rows[1][1] == "ACTIVE" && rows[2][1] == "*", "{assigned}");
        let tables =
            rows[1].iter().zip(&rows[2]).skip(2).map(|(axis, name)| ((*axis).to_owned(), Com::read(&text(name))));
        Self { entries: Self::entries(&text("KINEMATICS.TAB")), tables: tables.collect(), tool, adds }
    }

    fn entries(table: &str) -> Vec<Entry> {
        let mut lines = table.lines().skip(1);
        let head = lines.next().expect("a head");
        let places = ["DOC", "KEY", "AXIS", "COORD", "COMPTAB"].map(|name| head.find(name).expect("a column"));
        let entry = |(count, line): (usize, &str)| {
            let cell = |column: usize| {
                let end = places.get(column + 1).copied().unwrap_or(usize::MAX).min(line.len());
                line.get(places[column].min(end)..end).unwrap_or_default().trim().to_owned()
            };
            assert_eq!(line.split_whitespace().next(), Some(count.to_string().as_str()));
            let source = cell(4);
            Entry {
                name: cell(0),
                key: cell(1),
                axis: cell(2),
                coordinate: if cell(3).is_empty() { 0.0 } else { cell(3).parse().expect("a number") },
                source: source.split_once("..").map(|(axis, column)| (axis.to_owned(), column.to_owned())),
            }
        };
        lines.take_while(|line| *line != "[END]").enumerate().map(entry).collect()
    }

    /// The limits of pp. 670 and 686: entries with COMPTAB and axes at most 100, others 50, 10 an axis.
    fn check(&self) {
        let count = |is: &dyn Fn(&&Entry) -> bool| self.entries.iter().filter(is).count();
        let axes = count(&|entry| entry.key == "MachAxis");
        assert!(axes + count(&|entry| entry.source.is_some()) <= 100);
        assert!(axes + count(&|entry| entry.key == "Trans" && entry.source.is_none()) <= 50);
        for axis in self.tables.keys() {
            assert!(count(&|entry| entry.source.as_ref().is_some_and(|(own, _)| own == axis)) <= 10);
        }
    }

    /// Where the tip is on the table.
    fn place(&self, at: &ByAxis, with_errors: bool) -> Place {
        let mut place = [0.0, 0.0, -self.tool];
        let mut is_base = false;
        for entry in &self.entries {
            let by = match (entry.key.as_str(), &entry.source) {
                ("Trans", Some((axis, column))) if with_errors => self.tables[axis].at(column, at[axis]),
                ("Trans", Some(_)) => 0.0,
                // A constant with a name of a location error.
                ("Trans", None) => entry.coordinate,
                ("MachAxis", None) => at[&entry.axis],
                ("MachBase", None) => {
                    assert!(!std::mem::replace(&mut is_base, true), "two bases");
                    continue;
                }
                other => panic!("{other:?}"),
            };
            place = moved(place, &entry.axis, by);
        }
        place
    }

    /// Location errors by axis and letter, by the names of their lines.
    fn located(&self) -> BTreeMap<String, BTreeMap<String, f64>> {
        let mut found: BTreeMap<String, BTreeMap<String, f64>> = BTreeMap::new();
        for entry in &self.entries {
            if let Some((letter, axis)) = entry.name.split_once('0') {
                assert_eq!(letter, entry.axis);
                found.entry(axis.to_owned()).or_default().insert(letter.to_owned(), entry.coordinate);
            }
        }
        found
    }

    /// The same control without location errors and files: what it knew before.
    fn before(&self) -> Self {
        let mut before = self.clone();
        before.entries.retain(|entry| entry.source.is_none());
        before
    }
}

/// A translation along, or a turn about, an axis by mm or degrees.
fn moved(place: Place, axis: &str, by: f64) -> Place {
    let letter = "XYZABC".find(axis).expect("an axis");
    let mut found = place;
    if letter < 3 {
        found[letter] += by;
        return found;
    }
    let (i, j) = ((letter + 1) % 3, (letter + 2) % 3);
    let (sine, cosine) = by.to_radians().sin_cos();
    (found[i], found[j]) = (cosine * place[i] - sine * place[j], sine * place[i] + cosine * place[j]);
    found
}

/// Controls before and after: the goal is that of the table before.
struct Compensated {
    before: Tnc,
    after: Tnc,
}

impl Control for Compensated {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let goal = self.before.place(commands, false);
        let mut found = commands.clone();
        let letters = ["X", "Y", "Z"];
        let columns = letters.map(|letter| {
            let mut further = commands.clone();
            *further.get_mut(letter).expect("an axis") += 1.0;
            let place = self.before.place(&further, false);
            std::array::from_fn::<f64, 3, _>(|k| place[k] - goal[k])
        });
        for _ in 0..25 {
            let place = self.after.place(&found, true);
            let left: Place = std::array::from_fn(|k| place[k] - goal[k]);
            // Axes of a machine with rotary axes outside its linear ones are square to each other.
            for (letter, column) in letters.iter().zip(&columns) {
                let step: f64 = column.iter().zip(&left).map(|(a, b)| a * b).sum();
                *found.get_mut(*letter).expect("an axis") -= step;
            }
        }
        let sign = if self.after.adds { 1.0 } else { -1.0 };
        for (axis, table) in &self.after.tables {
            let at = found[axis];
            *found.get_mut(axis).expect("an axis") = at + sign * table.at(axis, at);
        }
        found
    }
}

fn settings(tool: f64, adds: bool) -> Value {
    json!({ "tool_length_mm": tool, "values": if adds { "added" } else { "subtracted" }, "step_mm": 20, "step_deg": 6 })
}

/// The nominal table: that of the machine without errors.
fn nominal(machine: &Machine, tool: f64) -> Tnc {
    let mut calibration = serde_json::to_value(&machine.calibration).expect("JSON");
    for parameter in calibration["parameters"].as_array_mut().expect("parameters") {
        parameter["value"] = json!(0.0);
    }
    let without = Machine::of(&calibration);
    let export = exporter("heidenhain-kinematics", &settings(tool, true));
    let files = export.export(&without.calibration, without.model.as_ref()).expect("files");
    Tnc::load(&files, tool, true).before()
}

fn law(machine: &Machine, tool: f64, seed: u64, rounding: f64) -> [Left; 2] {
    let adds = seed.is_multiple_of(2);
    let export = exporter("heidenhain-kinematics", &settings(tool, adds));
    let before = nominal(machine, tool);
    let load = |files: &[ExportedFile]| -> Box<dyn Control> {
        let after = Tnc::load(files, tool, adds);
        after.check();
        Box::new(Compensated { before: before.clone(), after })
    };
    predicted(machine, export.as_ref(), &load, &machine.anywhere(100, &[], seed), rounding)
}

/// The part of a table that p. 670 prints: its moves, in its order, place the tool by hand as the text of p. 722 says.
#[test]
fn the_emulated_table_places_the_tool_as_the_manual_says() {
    let table = "BEGIN K.TAB MM\nNR      DOC             KEY        AXIS  COORD           COMPTAB\n\
        0                       Trans      X     0.016\n1                       Trans      Z     250.051\n\
        2                       MachAxis   B\n3                       MachAxis   Y\n4                       MachAxis   X\n\
        5                       MachBase\n6                       MachAxis   Z\n7                       Trans      X     -298.923\n\
        8                       Trans      Y     200.172\n9                       MachAxis   C\n[END]\n";
    let control = Tnc { entries: Tnc::entries(table), tables: BTreeMap::new(), tool: 100.0, adds: true };
    let at = |b: f64, c: f64| -> ByAxis {
        [("X", 10.0), ("Y", 20.0), ("Z", 30.0), ("B", b), ("C", c)].map(|(name, at)| (name.to_owned(), at)).into()
    };
    let near = |place: Place, expected: Place| place.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9);
    let zero = control.place(&at(0.0, 0.0), true);
    assert!(near(zero, [0.016 + 10.0 - 298.923, 20.0 + 200.172, -100.0 + 250.051 + 30.0]), "{zero:?}");
    // B turns what is nearer to the tool, before X, Y and Z move it: Z goes to X, X to -Z.
    let turned = control.place(&at(90.0, 0.0), true);
    assert!(near(turned, [150.051 + 10.0 - 298.923, 220.172, -0.016 + 30.0]), "{turned:?}");
    // C turns all of it.
    let turned = control.place(&at(0.0, 90.0), true);
    assert!(near(turned, [-zero[1], zero[0], zero[2]]), "{turned:?}");
}

#[test]
fn the_public_machines_are_corrected() {
    for (name, tool) in [("table-table", 120.0), ("head-table", 150.0), ("three-axis", 100.0)] {
        let machine = Machine::public(name);
        let [found, turned] = law(&machine, tool, 3, 1e-7);
        assert!(found.after < found.before && found.after < remains(&machine) + 2e-3, "{name}: {found:?}");
        assert!(turned.after > found.before, "{name}: {turned:?}");
    }
}

/// Errors of all kinds but reversal: what stays is the interpolation between points and the last of four decimals (degrees: 0.9 µrad).
#[test]
fn random_machines_are_corrected() {
    for seed in seeds(30) {
        let machine = random::machine(seed, random::Errors::Smooth);
        let [found, turned] = law(&machine, 100.0, seed, 1e-7);
        assert!(found.after < 2e-3 + 0.02 * found.before && found.before > 0.01, "machine {seed}: {found:?}");
        assert!(turned.after > found.before, "machine {seed}: {turned:?}");
    }
}

/// With reversal, the mean of both directions is written: less is left, and what is left is predicted.
#[test]
fn reversal_stays() {
    for seed in seeds(20) {
        for errors in [random::Errors::Any, random::Errors::OfOneAxis] {
            let machine = random::machine(seed, errors);
            let [found, turned] = law(&machine, 100.0, seed, 1e-7);
            assert!(found.after < found.before, "machine {seed}: {found:?}");
            assert!(turned.after > found.after, "machine {seed}: {turned:?}");
        }
    }
}

/// Displaced rotary axes alone: four decimals of mm and nothing else.
#[test]
fn places_of_rotary_axes_are_corrected_to_the_digits_of_the_table() {
    for seed in seeds(30) {
        let (table, head): (&[&str], &[&str]) = match seed % 3 {
            0 => (&["A", "C"], &[]),
            1 => (&["C"], &["B"]),
            _ => (&[], &["C", "A"]),
        };
        let made = five_axes(seed, &Layout { table, head, reversed: &[] }, Displaced::Places);
        let [found, _] = law(&made.machine, made.tool, seed, 1e-7);
        assert!(found.after < 5e-4 && found.before > 5e-3, "machine {seed}: {found:?}");
    }
}

/// Files that are active stay, and what was found with them is added.
#[test]
fn files_that_are_active_are_added() {
    let folder = crate::support::temporary();
    let mut added = 0;
    for seed in seeds(10) {
        let machine = random::machine(seed, random::Errors::Smooth);
        let other = random::machine_of(seed, random::Errors::Smooth, seed + 1000);
        let export = exporter("heidenhain-kinematics", &settings(100.0, true));
        let old = export.export(&other.calibration, machine.model.as_ref()).expect("files");
        let mut with = settings(100.0, true);
        let mut existing = serde_json::Map::new();
        for file in old.iter().filter(|file| file.name.ends_with(".COM")) {
            let path = folder.path().join(&file.name);
            std::fs::write(&path, &file.content).expect("a file");
            let axis = file.name.trim_start_matches("AXIS-").trim_end_matches(".COM");
            existing.insert(axis.to_owned(), json!(path));
        }
        with["existing"] = Value::Object(existing);
        let located = old.iter().find(|file| file.name == "KINEMATICS.TAB").expect("a table");
        std::fs::write(folder.path().join("KINEMATICS.TAB"), &located.content).expect("a file");
        with["existing_kinematics"] = json!(folder.path().join("KINEMATICS.TAB"));
        let alone = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let both = exporter("heidenhain-kinematics", &with);
        let both = both.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let [old, alone, both] = [old, alone, both].map(|files| Tnc::load(&files, 100.0, true));
        for (axis, names) in both.located() {
            for (letter, sum) in names {
                let part = |control: &Tnc| control.located().get(&axis).and_then(|all| all.get(&letter).copied());
                let parts = part(&old).unwrap_or_default() + part(&alone).unwrap_or_default();
                assert!((sum - parts).abs() < 1e-9, "seed {seed}: {axis} {letter}: {sum}, not {parts}");
                added += usize::from(part(&old).is_some() && part(&alone).is_some());
            }
        }
        let [old, alone, both] = [old, alone, both].map(|control| control.tables);
        let mut largest = 0.0_f64;
        for (axis, both) in &both {
            for column in both.columns.keys() {
                for position in [-80.0, -13.0, 0.0, 27.5, 90.0] {
                    let part = |tables: &BTreeMap<String, Com>| {
                        tables.get(axis).map_or(0.0, |table| table.at(column, position))
                    };
                    let sum = part(&old) + part(&alone);
                    largest = largest.max(part(&old).abs().min(part(&alone).abs()));
                    assert!(
                        (both.at(column, position) - sum).abs() < 2.1e-4,
                        "seed {seed}: {axis} {column} {position}"
                    );
                }
            }
        }
        assert!(largest > 1e-3, "seed {seed}: nothing was added");
    }
    assert!(added > 20, "{added} location errors were added");
}

/// Files of another kind, or of another machine, are refused before anything is lost.
#[test]
fn active_files_that_this_exporter_did_not_write_are_refused() {
    let folder = crate::support::temporary();
    let machine = Machine::public("three-axis");
    let refused = |key: &str, text: &str| {
        let path = folder.path().join("active");
        std::fs::write(&path, text).expect("a file");
        let mut with = settings(100.0, true);
        with[key] = if key == "existing" { json!({ "X": path }) } else { json!(path) };
        let export = exporter("heidenhain-kinematics", &with);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("it is refused");
        error.to_string()
    };
    let com = |head: &str, rows: &str| format!("BEGIN A.COM DATUM:+0 DISTANCE:+10\n{head}\n{rows}[END]\n");
    let fine = "0 0 1\n1 10 1\n2 20 1\n";
    assert!(refused("existing", &com("NR AXISPOS X", "0 0 1\n1 10 1\n2 25 1\n")).contains("equal distances"));
    assert!(refused("existing", &com("NR AXISPOS X", "0 0 1\n1 10.00004 1\n")).contains("four decimals"));
    assert!(refused("existing", &com("NR BACKLASH X", fine)).contains("not `BACKLASH`"));
    assert!(refused("existing", &com("NR X C7", fine)).contains("not `C7`"));
    let table = |rows: &str| {
        let head = "NR      DOC             KEY        AXIS  COORD           COMPTAB";
        format!("BEGIN K.TAB MM\n{head}\n{rows}[END]\n")
    };
    let axes: Vec<&str> = vec!["Z", "Y", "X"];
    let rows: String = axes.iter().map(|axis| format!("0                       MachAxis   {axis}\n")).collect();
    assert!(refused("existing_kinematics", &table(&rows)).contains("axes in the order"));
    assert!(refused("existing_kinematics", "hello").contains("a kinematics table in mm was expected"));
    let wrong = "0       X0C             Trans      Y     1.0\n";
    assert!(refused("existing_kinematics", &table(wrong)).contains("X in AXIS, were expected of `X0C`"));
}

#[test]
fn wrong_settings_and_machines_are_refused() {
    assert!(
        refused("heidenhain-kinematics", &json!({ "tool_length_mm": 0, "values": "added" })).contains("tool_length_mm")
    );
    assert!(refused("heidenhain-kinematics", &json!({ "tool_length_mm": 100 })).contains("values"));
    let fine = json!({ "tool_length_mm": 100, "values": "added", "most_points": 10 });
    let machine = Machine::public("three-axis");
    let error = exporter("heidenhain-kinematics", &fine).export(&machine.calibration, machine.model.as_ref());
    assert!(error.expect_err("too many points").to_string().contains("a table has at most 10"));
    let turned = five_axes(1, &Layout { table: &["A", "C"], head: &[], reversed: &["A"] }, Displaced::Places).machine;
    let export = exporter("heidenhain-kinematics", &settings(100.0, true));
    let error = export.export(&turned.calibration, turned.model.as_ref()).expect_err("another sense");
    assert!(error.to_string().contains("axis A does not move along or about its own letter"), "{error}");
    let endless = random::machine(1, random::Errors::Endless);
    let error = export.export(&endless.calibration, endless.model.as_ref()).expect_err("no end");
    assert!(error.to_string().contains("without an end"), "{error}");
}
