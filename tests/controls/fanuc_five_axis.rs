//! Tool centre point control of Fanuc.
//!
//! Emulator: places of the axes from the vectors as the manual draws them (A-79348E, A-78712E), each turned about its letter in its
//! direction of rotation (19684, 19689: a table by the left-hand rule). No example with numbers was found.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::five_axes::{Errors, FiveAxes, Layout, machine};
use super::law::{ByAxis, Control, Left, exporter, predicted, refused, seeds};

type Place = [f64; 3];

fn sum(a: Place, b: Place, sign: f64) -> Place {
    [0, 1, 2].map(|part| a[part] + sign * b[part])
}

/// Turns a place about an axis through a point, parallel to that of its letter.
fn turned(place: Place, (letter, sense, point): &(String, f64, Place), degrees: f64) -> Place {
    let (sin, cos) = (sense * degrees).to_radians().sin_cos();
    let [x, y, z] = sum(place, *point, -1.0);
    let turned = match letter.as_str() {
        "A" => [x, y * cos - z * sin, y * sin + z * cos],
        "B" => [x * cos + z * sin, y, z * cos - x * sin],
        _ => [x * cos - y * sin, x * sin + y * cos, z],
    };
    sum(turned, *point, 1.0)
}

#[derive(Clone)]
struct Parameters {
    /// Lengths, mm.
    numbers: BTreeMap<u32, f64>,
    /// Name and sense of the axes, those next to the bed first.
    table: Vec<(String, f64)>,
    head: Vec<(String, f64)>,
    tool: f64,
}

impl Parameters {
    fn vector(&self, from: u32) -> Place {
        [0, 1, 2].map(|part| self.numbers.get(&(from + part)).copied().unwrap_or_default())
    }

    fn lines(&self, axes: &[(String, f64)], points: [Place; 2]) -> Vec<(String, f64, Place)> {
        axes.iter().zip(points).map(|((name, sense), point)| (name.clone(), *sense, point)).collect()
    }

    fn table(&self) -> Vec<(String, f64, Place)> {
        let first = self.vector(19700);
        self.lines(&self.table, [first, sum(first, self.vector(19703), 1.0)])
    }

    /// The tip, where the controlled point stands at zero.
    fn tip(&self, angles: &ByAxis) -> Place {
        let next = self.vector(19709);
        let points = if self.head.len() == 2 { [sum(next, self.vector(19712), 1.0), next] } else { [next; 2] };
        let lines = self.lines(&self.head, points);
        lines.iter().rev().fold([0.0, 0.0, -self.tool], |tip, line| turned(tip, line, angles[&line.0]))
    }

    fn place(&self, linear: Place, angles: &ByAxis) -> Place {
        let tip = sum(linear, self.tip(angles), 1.0);
        self.table().iter().fold(tip, |place, line| turned(place, line, -angles[&line.0]))
    }

    fn linear(&self, place: Place, angles: &ByAxis) -> Place {
        let at = self.table().iter().rev().fold(place, |place, line| turned(place, line, angles[&line.0]));
        sum(at, self.tip(angles), -1.0)
    }
}

struct Fanuc {
    present: Parameters,
    new: Parameters,
    shift: Place,
}

impl Fanuc {
    fn load(present: &Parameters, unit: f64, files: &[ExportedFile]) -> Self {
        let text = |index: usize| std::str::from_utf8(&files[index].content).expect("text");
        let mut new = present.clone();
        for line in text(0).lines().filter(|line| *line != "%") {
            let (number, count) = line.strip_prefix('N').and_then(|line| line.split_once('P')).expect("N..P..");
            let count: i64 = count.strip_suffix(';').expect("an end").parse().expect("a whole number");
            new.numbers.insert(number.parse().expect("a number"), count as f64 * unit);
        }
        let line = text(1).lines().find(|line| line.starts_with("G91 G10 L2 P0 ")).expect("an offset");
        let shift = ['X', 'Y', 'Z'].map(|letter| {
            let word = line.split(' ').find_map(|word| word.strip_prefix(letter)).expect("a word");
            word.parse().expect("a number")
        });
        Self { present: present.clone(), new, shift }
    }
}

impl Control for Fanuc {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let place = self.present.place(["X", "Y", "Z"].map(|axis| commands[axis]), commands);
        let linear = self.new.linear(sum(place, self.shift, 1.0), commands);
        let mut motors = commands.clone();
        motors.extend(["X", "Y", "Z"].map(str::to_owned).into_iter().zip(linear));
        motors
    }
}

/// A random machine and the control with its nominal numbers. Half of the tool belongs to the head.
fn random(seed: u64, errors: Errors) -> (FiveAxes, Parameters) {
    let layouts: [(&[&str], &[&str]); 6] = [
        (&["A", "C"], &[]),
        (&["B", "C"], &[]),
        (&["C"], &["B"]),
        (&["B"], &["A"]),
        (&[], &["C", "A"]),
        (&[], &["C", "B"]),
    ];
    let (table, head) = layouts[seed as usize % 6];
    let reversed: &[&str] = if seed.is_multiple_of(4) { &table[..table.len().min(1)] } else { &[] };
    let made = machine(seed, &Layout { table, head, reversed }, errors);
    let tool = (0.5 * made.tool).round();
    let last = made.head.last().map(|(_, point)| *point).unwrap_or_default();
    let adapter = [last[0], last[1], last[2] - made.tool + tool];
    let from = |point: Place| sum(point, adapter, -1.0);
    let mut numbers = BTreeMap::new();
    let mut vector = |number: u32, vector: Place| numbers.extend((number..).zip(vector));
    match (&made.table[..], &made.head[..]) {
        ([first, second], []) => {
            vector(19700, from(first.1));
            vector(19703, sum(second.1, first.1, -1.0));
        }
        ([], [first, second]) => {
            vector(19709, from(second.1));
            vector(19712, sum(first.1, second.1, -1.0));
        }
        (table, head) => {
            vector(19700, from(table[0].1));
            vector(19709, from(head[0].1));
        }
    }
    let senses = |lines: &[(String, Place)], sense: f64| {
        let sense_of = |name: &str| if reversed.contains(&name) { -sense } else { sense };
        lines.iter().map(|(name, _)| (name.clone(), sense_of(name))).collect()
    };
    let parameters = Parameters { numbers, table: senses(&made.table, -1.0), head: senses(&made.head, 1.0), tool };
    (made, parameters)
}

fn settings(parameters: &Parameters, increment: &str) -> Value {
    let existing: serde_json::Map<String, Value> = [19700, 19703, 19709, 19712]
        .into_iter()
        .filter(|number| parameters.numbers.contains_key(number))
        .map(|number| (number.to_string(), json!(parameters.vector(number))))
        .collect();
    json!({ "increment": increment, "existing": existing, "tool_length_mm": parameters.tool })
}

fn law(seed: u64, errors: Errors, increment: &str, unit: f64) -> [Left; 2] {
    let (FiveAxes { machine, .. }, parameters) = random(seed, errors);
    let export = exporter("fanuc-five-axis", &settings(&parameters, increment));
    let load = |files: &[ExportedFile]| Box::new(Fanuc::load(&parameters, unit, files)) as Box<dyn Control>;
    predicted(&machine, export.as_ref(), &load, &machine.anywhere(60, &[], seed), 1e-8)
}

#[test]
fn places_of_rotary_axes_are_corrected_to_the_increment() {
    for seed in seeds(60) {
        for (increment, unit) in [("IS-B", 1e-3), ("IS-C", 1e-4)] {
            let [found, turned] = law(seed, Errors::Places, increment, unit);
            assert!(found.before > 5e-3 && found.after < 6.0 * unit, "{seed}: {found:?}");
            assert!(turned.after > 1.5 * found.before, "{seed}: {turned:?}");
        }
    }
}

#[test]
fn what_the_parameters_cannot_hold_is_left_as_predicted() {
    for seed in seeds(30) {
        law(seed, Errors::Axes, "IS-C", 1e-4);
        law(seed, Errors::All, "IS-C", 1e-4);
    }
}

#[test]
fn vectors_of_other_machines_are_refused() {
    let (FiveAxes { machine, .. }, parameters) = random(6, Errors::Places);
    let good = settings(&parameters, "IS-C");
    let message = |change: &dyn Fn(&mut Value)| {
        let mut changed = good.clone();
        change(&mut changed);
        let export = exporter("fanuc-five-axis", &changed);
        export.export(&machine.calibration, machine.model.as_ref()).expect_err("another machine").to_string()
    };
    let back = sum([0.0; 3], parameters.vector(19703), -1.0);
    assert!(message(&|settings| settings["existing"]["19703"] = json!(back)).contains("19703 is"));
    assert!(message(&|settings| settings["existing"]["19712"] = json!([0, 0, 0])).contains("no vector 19712"));
    let without = |settings: &mut Value| {
        settings["existing"].as_object_mut().expect("vectors").remove("19700");
    };
    assert!(message(&without).contains("present vector 19700"));
    assert!(message(&|settings| settings["largest_change_mm"] = json!(1e-4)).contains("mm"));
    let mut unknown = good.clone();
    unknown["existing"]["19701"] = json!([0, 0, 0]);
    assert!(refused("fanuc-five-axis", &unknown).contains("existing.19701"));
    let mut inch = good.clone();
    inch["increment"] = json!("IS-A");
    assert!(refused("fanuc-five-axis", &inch).contains("increment"));
}
