//! Tool carriers of SINUMERIK controls.
//!
//! Emulator: the vector chains of the manuals. Head: from the tool adapter to the second axis (I3), from it to the first one (I2), and
//! closed by I1. Table: from the origin of the machine to the first axis (I2), to the second (I3), closed by I4. The tool and these
//! vectors turn by the angle of an axis about its vector, by the right-hand rule. It reproduces two examples of the manuals first.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::five_axes::{Errors, FiveAxes, Layout, machine};
use super::law::{ByAxis, Control, Left, Machine, exporter, holds, predicted, refused, seeds};

type Vector = [f64; 3];

fn plus(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn times(a: Vector, factor: f64) -> Vector {
    a.map(|part| part * factor)
}

/// Rodrigues' formula; the length of `about` does not count.
fn turned(vector: Vector, about: Vector, degrees: f64) -> Vector {
    let length = about.iter().map(|part| part * part).sum::<f64>().sqrt();
    let [x, y, z] = times(about, 1.0 / length);
    let (sin, cos) = degrees.to_radians().sin_cos();
    let along = (x * vector[0] + y * vector[1] + z * vector[2]) * (1.0 - cos);
    let cross = [y * vector[2] - z * vector[1], z * vector[0] - x * vector[2], x * vector[1] - y * vector[0]];
    plus(plus(times(vector, cos), times(cross, sin)), times([x, y, z], along))
}

#[derive(Clone, Debug)]
struct Carrier {
    kind: char,
    /// `$TC_CARR` by number.
    numbers: BTreeMap<u32, f64>,
    /// The names of the first and the second axis.
    axes: [String; 2],
    /// From the tip to the tool adapter.
    tool: Vector,
}

impl Carrier {
    fn vector(&self, from: u32) -> Vector {
        [0, 1, 2].map(|place| self.numbers.get(&(from + place)).copied().unwrap_or_default())
    }

    fn turn(&self, vector: Vector, axis: usize, angles: &ByAxis) -> Vector {
        turned(vector, self.vector([7, 10][axis]), angles[&self.axes[axis]])
    }

    fn back(&self, vector: Vector, axis: usize, angles: &ByAxis) -> Vector {
        turned(vector, self.vector([7, 10][axis]), -angles[&self.axes[axis]])
    }

    /// From the tip to the origin of the machine's linear axes.
    fn length(&self, angles: &ByAxis) -> Vector {
        let [i1, i2, i3] = [1, 4, 15].map(|from| self.vector(from));
        match self.kind {
            'T' => plus(i1, self.turn(plus(i2, self.turn(plus(i3, self.tool), 1, angles)), 0, angles)),
            'M' => plus(i1, self.turn(plus(i2, self.tool), 0, angles)),
            _ => self.tool,
        }
    }

    /// Where a place of the workpiece goes.
    fn table(&self, place: Vector, angles: &ByAxis) -> Vector {
        let [i2, i3, i4] = [4, 15, 18].map(|from| self.vector(from));
        match self.kind {
            'P' => plus(i2, self.turn(plus(i3, self.turn(plus(i4, place), 1, angles)), 0, angles)),
            'M' => plus(i3, self.turn(plus(i4, place), 1, angles)),
            _ => place,
        }
    }

    fn seen_from_table(&self, place: Vector, angles: &ByAxis) -> Vector {
        let [i2, i3, i4] = [4, 15, 18].map(|from| times(self.vector(from), -1.0));
        match self.kind {
            'P' => plus(i4, self.back(plus(i3, self.back(plus(i2, place), 0, angles)), 1, angles)),
            'M' => plus(i4, self.back(plus(i3, place), 1, angles)),
            _ => place,
        }
    }

    fn place(&self, linear: Vector, angles: &ByAxis) -> Vector {
        self.seen_from_table(plus(linear, times(self.length(angles), -1.0)), angles)
    }

    fn linear(&self, place: Vector, angles: &ByAxis) -> Vector {
        plus(self.table(place, angles), self.length(angles))
    }
}

/// A control that had a present carrier when the program's places were those of the nominal machine.
struct Sinumerik {
    present: Carrier,
    new: Carrier,
    shift: Vector,
    angles: Vector,
}

impl Sinumerik {
    fn load(present: &Carrier, files: &[ExportedFile]) -> Self {
        let text = std::str::from_utf8(&files[0].content).expect("text");
        let mut new = present.clone();
        let (mut shift, mut angles) = ([0.0; 3], [0.0; 3]);
        for line in text.lines().filter(|line| line.starts_with('$')) {
            let (name, value) = line.split_once('=').expect("a value");
            if let Some(number) = name.strip_prefix("$TC_CARR") {
                let number = number.strip_suffix("[3]").expect("carrier 3").parse().expect("a number");
                new.numbers.insert(number, value.parse().expect("a number"));
                continue;
            }
            assert_eq!(name, "$P_CHBFR[0]");
            let words = |function: &str| {
                let (_, rest) = value.split_once(&format!("{function}(X,")).expect("a function");
                let (inside, _) = rest.split_once(')').expect("an end");
                let inside = inside.replace("Y,", "").replace("Z,", "");
                let numbers: Vec<f64> = inside.split(',').map(|word| word.parse().expect("a number")).collect();
                Vector::try_from(numbers).expect("three numbers")
            };
            (shift, angles) = (words("CTRANS"), words("CROT"));
        }
        Self { present: present.clone(), new, shift, angles }
    }

    /// The basic frame: turned about Z, then about the new Y, then about the new X, and moved.
    fn frame(&self, place: Vector) -> Vector {
        let about_x = turned(place, [1.0, 0.0, 0.0], self.angles[0]);
        let about_y = turned(about_x, [0.0, 1.0, 0.0], self.angles[1]);
        plus(turned(about_y, [0.0, 0.0, 1.0], self.angles[2]), self.shift)
    }
}

impl Control for Sinumerik {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let place = self.present.place(["X", "Y", "Z"].map(|axis| commands[axis]), commands);
        let linear = self.new.linear(self.frame(place), commands);
        let mut motors = commands.clone();
        motors.extend(["X", "Y", "Z"].map(str::to_owned).into_iter().zip(linear));
        motors
    }
}

/// The carrier of a nominal machine, from points in the machine frame. The tip is below the last axis of the head, or below the origin;
/// its lower half is the tool that the control knows.
fn carrier(table: &[(String, Vector)], head: &[(String, Vector)], length: f64, reversed: &[&str]) -> Carrier {
    let tool = 0.5 * length;
    let last = head.last().map(|(_, point)| *point).unwrap_or_default();
    let from_adapter = |(name, point): &(String, Vector)| {
        (name.clone(), plus(plus(*point, times(last, -1.0)), [0.0, 0.0, length - tool]))
    };
    let [table, head] = [table, head].map(|lines| lines.iter().map(from_adapter).collect::<Vec<_>>());
    let about = |name: &str, sense: f64| {
        let sense = if reversed.contains(&name) { -sense } else { sense };
        ["A", "B", "C"].map(|letter| if letter == name { sense } else { 0.0 })
    };
    let minus = |a: Vector, b: Vector| plus(a, times(b, -1.0));
    let (kind, vectors, axes) = match (&table[..], &head[..]) {
        ([], [(first, p1), (second, p2)]) => {
            let vectors = [times(*p1, -1.0), minus(*p1, *p2), *p2, [0.0; 3], about(first, 1.0), about(second, 1.0)];
            ('T', vectors, [first, second])
        }
        ([(first, p1), (second, p2)], []) => {
            let closed = times(*p2, -1.0);
            let vectors = [[0.0; 3], *p1, minus(*p2, *p1), closed, about(first, -1.0), about(second, -1.0)];
            ('P', vectors, [first, second])
        }
        ([(second, p2)], [(first, p1)]) => {
            let vectors = [times(*p1, -1.0), *p1, *p2, times(*p2, -1.0), about(first, 1.0), about(second, -1.0)];
            ('M', vectors, [first, second])
        }
        _ => panic!("two axes"),
    };
    let numbers = [1, 4, 15, 18, 7, 10].into_iter().zip(vectors);
    let numbers = numbers.flat_map(|(from, vector)| (from..).zip(vector)).collect();
    Carrier { kind, numbers, axes: axes.map(String::clone), tool: [0.0, 0.0, tool] }
}

fn settings(carrier: &Carrier) -> Value {
    let [i1, i2, i3, i4, v1, v2] = [1, 4, 15, 18, 7, 10].map(|from| carrier.vector(from));
    json!({ "carrier": 3, "tool_length_mm": carrier.tool[2],
        "existing": { "I1": i1, "I2": i2, "I3": i3, "I4": i4, "V1": v1, "V2": v2 } })
}

/// A table of type P whose I4 of 15 mm turns by B45 moves its zero by X10.607 Z-4.393 (W1, 2005, 4-3), and a head about Y with a tool
/// of 12 mm in X and 1 mm in Z stands at X10.892 Z-5.134 after 30 degrees (Work preparation, example of CUTMOD).
#[test]
fn the_carrier_does_what_the_manuals_say() {
    let about = |from: u32, vector: Vector| (from..).zip(vector);
    let numbers = about(18, [0.0, 0.0, 15.0]).chain(about(7, [1.0, 0.0, 0.0])).chain(about(10, [0.0, 1.0, 0.0]));
    let axes = ["A", "B"].map(str::to_owned);
    let mut carrier = Carrier { kind: 'P', numbers: numbers.collect(), axes, tool: [0.0, 0.0, 13.0] };
    let angles = |a: f64, b: f64| ByAxis::from([("A".to_owned(), a), ("B".to_owned(), b)]);
    let close = |a: Vector, b: Vector| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 5e-4);
    let moved = plus(carrier.table([0.0; 3], &angles(0.0, 45.0)), [0.0, 0.0, -15.0]);
    assert!(close(moved, [10.607, 0.0, -4.393]), "{moved:?}");
    let stands = plus(moved, carrier.length(&angles(0.0, 45.0)));
    assert!(close(stands, [10.607, 0.0, 8.607]), "{stands:?}");
    carrier.kind = 'T';
    carrier.tool = [12.0, 0.0, 1.0];
    let length = carrier.length(&angles(0.0, 30.0));
    assert!(close(length, [10.892, 0.0, -5.134]), "{length:?}");
}

/// A random machine with two rotary axes, and the control with its nominal numbers.
fn random(seed: u64, errors: Errors) -> (FiveAxes, Carrier) {
    let layouts: [(&[&str], &[&str]); 6] = [
        (&["A", "C"], &[]),
        (&["B", "C"], &[]),
        (&["C"], &["B"]),
        (&["B"], &["A"]),
        (&[], &["C", "A"]),
        (&[], &["C", "B"]),
    ];
    let (table, head) = layouts[seed as usize % 6];
    let reversed: &[&str] = [&[][..], &["C"], &["B"], &["A", "C"]][seed as usize / 6 % 4];
    let reversed: Vec<&str> =
        reversed.iter().copied().filter(|axis| table.contains(axis) || head.contains(axis)).collect();
    let made = machine(seed, &Layout { table, head, reversed: &reversed }, errors);
    let carrier = carrier(&made.table, &made.head, made.tool, &reversed);
    (made, carrier)
}

fn law(seed: u64, errors: Errors) -> [Left; 2] {
    let (FiveAxes { machine, .. }, carrier) = random(seed, errors);
    let export = exporter("siemens-kinematics", &settings(&carrier));
    let load = |files: &[ExportedFile]| Box::new(Sinumerik::load(&carrier, files)) as Box<dyn Control>;
    predicted(&machine, export.as_ref(), &load, &machine.anywhere(60, &[], seed), 3e-6)
}

#[test]
fn places_and_directions_of_rotary_axes_are_corrected_to_the_digits_of_the_vectors() {
    for seed in seeds(60) {
        for errors in [Errors::Places, Errors::Axes] {
            let [found, turned] = law(seed, errors);
            assert!(found.before > 5e-3 && found.after < 5e-6, "{seed}: {found:?}");
            assert!(turned.after > 1.5 * found.before, "{seed}: {turned:?}");
        }
    }
}

#[test]
fn what_the_vectors_cannot_hold_is_left_as_predicted() {
    for seed in seeds(30) {
        law(seed, Errors::All);
    }
}

#[test]
fn the_public_machines_are_corrected_by_their_vectors() {
    let at = |name: &str, z: f64| (name.to_owned(), [0.0, 0.0, z]);
    for (name, carrier) in [
        ("table-table", carrier(&[at("A", -50.0), at("C", -50.0)], &[], 120.0, &[])),
        ("head-table", carrier(&[at("C", 0.0)], &[at("B", 60.0)], 150.0, &[])),
    ] {
        let machine = Machine::public(name);
        let export = exporter("siemens-kinematics", &settings(&carrier));
        let load = |files: &[ExportedFile]| Box::new(Sinumerik::load(&carrier, files)) as Box<dyn Control>;
        for seed in 1..=5 {
            let found = holds(&machine, export.as_ref(), &load, &machine.anywhere(200, &[], seed), 3e-6);
            // Zeros of rotary axes, squareness and error motions stay.
            assert!(found.after < found.before, "{name}: {found:?}");
        }
    }
}

#[test]
fn vectors_of_other_machines_are_refused() {
    let (FiveAxes { machine, .. }, carrier) = random(6, Errors::Axes);
    let good = settings(&carrier);
    let message = |path: &[&str], value: Value| {
        let mut changed = good.clone();
        *path.iter().fold(&mut changed, |inside, key| &mut inside[*key]) = value;
        let export = exporter("siemens-kinematics", &changed);
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("another machine");
        error.to_string()
    };
    let back = times(carrier.vector(15), -1.0);
    assert!(
        message(&["existing", "I3"], json!(back)).contains("I3 is"),
        "{}",
        message(&["existing", "I3"], json!(back))
    );
    assert!(message(&["existing", "V1"], json!([0, 0, 1])).contains("V1 is not the direction of A"));
    assert!(message(&["largest_change_mm"], json!(1e-4)).contains("mm"));
    for (setting, value) in [("carrier", json!(0)), ("tool_length_mm", json!("long")), ("fine", json!(true))] {
        let mut changed = good.clone();
        changed[setting] = value;
        assert!(refused("siemens-kinematics", &changed).contains(setting));
    }
    let mut changed = good.clone();
    changed["existing"]["V2"] = json!([0, 0, 0]);
    assert!(refused("siemens-kinematics", &changed).contains("existing.V2"));
    let three = Machine::public("three-axis");
    let error = exporter("siemens-kinematics", &good).export(&three.calibration, three.model.as_ref());
    assert!(error.expect_err("no rotary axes").to_string().contains("0 rotary axes of the tool"));
}
