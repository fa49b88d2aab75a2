//! Pins of the five-axis kinematics of LinuxCNC.
//!
//! Emulator: forward and inverse kinematics of `xyzac-trt-kins` and `xyzbc-trt-kins` term by term as their source has them
//! (`trtfuncs.c`, up to LinuxCNC 2.9 and with the pin `conventional-directions` of 2.10), with present pins and new ones.

use std::collections::BTreeMap;

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::five_axes::{Errors, FiveAxes, Layout, machine};
use super::law::{ByAxis, Control, Left, Machine, exporter, holds, predicted, refused, seeds, uniform};

type Pins = BTreeMap<String, f64>;
type Place = [f64; 3];

/// The pin that not all versions have.
const DIRECTIONS: &str = "conventional-directions";

/// One of the modules, with the values of its pins.
#[derive(Clone)]
pub(crate) struct Kinematics {
    pub(crate) module: &'static str,
    pub(crate) pins: Pins,
}

impl Kinematics {
    fn pin(&self, name: &str) -> f64 {
        self.pins.get(name).copied().unwrap_or_default()
    }

    /// Rotation point, offsets with the tool length in z, and the sense of turning.
    fn table(&self) -> (Place, Place, f64) {
        let point = ["x-rot-point", "y-rot-point", "z-rot-point"].map(|name| self.pin(name));
        let [x, y, z] = ["x-offset", "y-offset", "z-offset"].map(|name| self.pin(name));
        let sense = if self.pin(DIRECTIONS) == 0.0 { -1.0 } else { 1.0 };
        (point, [x, y, z + self.pin("tool-offset")], sense)
    }

    fn forward(&self, [jx, jy, jz]: Place, angle: &dyn Fn(&str) -> f64) -> Place {
        let (sc, cc) = angle("C").to_radians().sin_cos();
        let ([px, py, pz], [dx, dy, dz], con) = self.table();
        match self.module {
            "xyzac-trt-kins" => {
                let (sa, ca) = angle("A").to_radians().sin_cos();
                let (x, y, z) = (jx - px, jy - dy - py, jz - dz - pz);
                [
                    cc * x - con * sc * ca * y + sc * sa * z - con * sc * dy + px,
                    con * sc * x + cc * ca * y - con * cc * sa * z + cc * dy + py,
                    con * sa * y + ca * z + dz + pz,
                ]
            }
            _ => {
                let (sb, cb) = angle("B").to_radians().sin_cos();
                let (x, y, z) = (jx - dx - px, jy - py, jz - dz - pz);
                [
                    cc * cb * x - con * sc * y + con * cc * sb * z + cc * dx + px,
                    con * sc * cb * x + cc * y + sc * sb * z + con * sc * dx + py,
                    -con * sb * x + cb * z + dz + pz,
                ]
            }
        }
    }

    /// Joints for what a program commands, mm and degrees.
    pub(crate) fn joints(&self, commands: &ByAxis) -> ByAxis {
        let angle = |name: &str| commands.get(name).copied().unwrap_or_default();
        let places = self.inverse(["X", "Y", "Z"].map(angle), &angle);
        let mut joints = commands.clone();
        joints.extend(["X", "Y", "Z"].map(str::to_owned).into_iter().zip(places));
        joints
    }

    fn inverse(&self, [x, y, z]: Place, angle: &dyn Fn(&str) -> f64) -> Place {
        let (sc, cc) = angle("C").to_radians().sin_cos();
        let ([px, py, pz], [dx, dy, dz], con) = self.table();
        let (vx, vy, vz) = (x - px, y - py, z - pz);
        match self.module {
            "xyzac-trt-kins" => {
                let (sa, ca) = angle("A").to_radians().sin_cos();
                [
                    cc * vx + con * sc * vy + px,
                    -con * sc * ca * vx + cc * ca * vy + con * sa * vz - ca * dy - con * sa * dz + dy + py,
                    sc * sa * vx - con * cc * sa * vy + ca * vz + con * sa * dy - ca * dz + dz + pz,
                ]
            }
            _ => {
                let (sb, cb) = angle("B").to_radians().sin_cos();
                // `trtfuncs.c`, dpx and dpz: in 2.10 they have one sense of turning only.
                let sb_of_offsets = if self.pins.contains_key(DIRECTIONS) { sb } else { -sb };
                let (ox, oz) = (-cb * dx + sb_of_offsets * dz + dx, -sb_of_offsets * dx - cb * dz + dz);
                [
                    cc * cb * vx + con * sc * cb * vy - con * sb * vz + ox + px,
                    -con * sc * vx + cc * vy + py,
                    con * cc * sb * vx + sc * sb * vy + cb * vz + oz + pz,
                ]
            }
        }
    }
}

/// A control that had present pins when the program's places were those of the nominal machine.
pub(crate) struct Linuxcnc {
    present: Kinematics,
    pub(crate) new: Kinematics,
    pub(crate) offset: Place,
}

impl Linuxcnc {
    pub(crate) fn load(present: &Kinematics, files: &[ExportedFile]) -> Self {
        let text = |name: &str| {
            let file = files.iter().find(|file| file.name == name).expect("a file");
            std::str::from_utf8(&file.content).expect("text").to_owned()
        };
        let mut new = present.clone();
        for line in text("five-axis.hal").lines().filter(|line| !line.starts_with('#')) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let ["setp", pin, value] = words[..] else { panic!("{line}") };
            let (module, pin) = pin.split_once('.').expect("a pin");
            assert_eq!(module, present.module);
            let value = value.parse().expect("a number");
            let known = new.pins.insert(pin.to_owned(), value);
            // A pin that is not there ends LinuxCNC.
            assert!(known.is_some(), "{pin}");
            assert!(pin != DIRECTIONS || known == Some(value), "{pin}: {known:?}, {value}");
        }
        let program = text("work-offsets.ngc");
        let line = program.lines().find(|line| line.starts_with("G10 L2 P0 ")).expect("an offset");
        let word = |(letter, parameter): (&str, u32)| {
            let (_, rest) = line.split_once(&format!(" {letter}[#[{parameter}+20*#5220]")).expect("a word");
            rest.split_once(']').expect("an end").0.parse::<f64>().expect("a number")
        };
        let offset = [("X", 5201), ("Y", 5202), ("Z", 5203)].map(word);
        Self { present: present.clone(), new, offset }
    }
}

impl Control for Linuxcnc {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let angle = |name: &str| commands.get(name).copied().unwrap_or_default();
        let mut place = self.present.forward(["X", "Y", "Z"].map(angle), &angle);
        place.iter_mut().zip(self.offset).for_each(|(place, by)| *place += by);
        let mut program = commands.clone();
        program.extend(["X", "Y", "Z"].map(str::to_owned).into_iter().zip(place));
        self.new.joints(&program)
    }
}

/// A random machine for a module, and the control with its nominal numbers.
fn random(seed: u64, errors: Errors) -> (FiveAxes, Kinematics) {
    // With the pin, `xyzbc-trt-kins` is right in conventional directions only.
    let (module, table, conventional) = match seed % 5 {
        0 => ("xyzac-trt-kins", ["A", "C"], Some(true)),
        1 => ("xyzac-trt-kins", ["A", "C"], Some(false)),
        2 => ("xyzbc-trt-kins", ["B", "C"], Some(true)),
        3 => ("xyzac-trt-kins", ["A", "C"], None),
        _ => ("xyzbc-trt-kins", ["B", "C"], None),
    };
    let reversed = if conventional == Some(true) { &[][..] } else { &table };
    let made = machine(seed, &Layout { table: &table, head: &[], reversed }, errors);
    let pins = pins(&made.table, made.tool, conventional, seed);
    (made, Kinematics { module, pins })
}

/// The pins of nominal axes. The frame of the control has its origin where the spindle nose stands with all axes at zero.
fn pins(table: &[(String, Place)], tool: f64, conventional: Option<bool>, seed: u64) -> Pins {
    let [(tilt, [tx, ty, tz]), (_, [x, y, _])] = table else { panic!("two axes of a table") };
    let height = (100.0 * uniform(seed ^ 77)()).round();
    let across = if tilt == "A" { ("y-offset", ty - y) } else { ("x-offset", tx - x) };
    let found = [
        ("x-rot-point", *x),
        ("y-rot-point", *y),
        ("z-rot-point", height),
        across,
        ("z-offset", tz - height),
        ("tool-offset", tool),
    ];
    let directions = conventional.map(|is| (DIRECTIONS, if is { 1.0 } else { 0.0 }));
    found.into_iter().chain(directions).map(|(name, value)| (name.to_owned(), value)).collect()
}

fn settings(kinematics: &Kinematics) -> Value {
    let kept = ["z-rot-point", "tool-offset", DIRECTIONS];
    let existing: Pins =
        kinematics.pins.clone().into_iter().filter(|(name, _)| !kept.contains(&name.as_str())).collect();
    let has_directions = kinematics.pins.contains_key(DIRECTIONS);
    json!({ "module": kinematics.module, "has_conventional_directions": has_directions, "existing": existing })
}

/// Forward and inverse kinematics belong to each other, and turn about the lines that the pins name.
#[test]
fn the_emulated_kinematics_of_linuxcnc_turn_about_their_pins() {
    for seed in seeds(30) {
        let (_, kinematics) = random(seed, Errors::Places);
        let mut uniform = uniform(seed);
        let joints = [(); 3].map(|()| 600.0 * uniform() - 300.0);
        let turn = 200.0 * uniform() - 100.0;
        let angle = |name: &str| if name == "C" { turn } else { -0.7 * turn };
        let back = kinematics.inverse(kinematics.forward(joints, &angle), &angle);
        assert!(joints.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-9), "{seed}: {joints:?} {back:?}");
        let zero = kinematics.forward(joints, &|_| 0.0);
        assert!(joints.iter().zip(zero).all(|(a, b)| (a - b).abs() < 1e-9), "{seed}: {joints:?} {zero:?}");
        let ([x, y, z], [dx, dy, dz], _) = kinematics.table();
        let on_c = kinematics.forward([x, y, 5.0], &|name| if name == "C" { turn } else { 0.0 });
        assert!((on_c[0] - x).abs() < 1e-9 && (on_c[1] - y).abs() < 1e-9, "{seed}: {on_c:?}");
        let on_tilt = [x + dx, y + dy, z + dz];
        let stays = kinematics.forward(on_tilt, &|name| if name == "C" { 0.0 } else { turn });
        assert!(on_tilt.iter().zip(stays).all(|(a, b)| (a - b).abs() < 1e-9), "{seed}: {stays:?}");
    }
}

fn law(seed: u64, errors: Errors) -> [Left; 2] {
    let (FiveAxes { machine, .. }, kinematics) = random(seed, errors);
    let export = exporter("linuxcnc-five-axis", &settings(&kinematics));
    let load = |files: &[ExportedFile]| Box::new(Linuxcnc::load(&kinematics, files)) as Box<dyn Control>;
    predicted(&machine, export.as_ref(), &load, &machine.anywhere(60, &[], seed), 1e-8)
}

#[test]
fn places_of_rotary_axes_are_corrected_to_the_digits_of_the_pins() {
    for seed in seeds(45) {
        let [found, turned] = law(seed, Errors::Places);
        assert!(found.before > 5e-3 && found.after < 5e-6, "{seed}: {found:?}");
        assert!(turned.after > 1.5 * found.before, "{seed}: {turned:?}");
    }
}

#[test]
fn what_the_pins_cannot_hold_is_left_as_predicted() {
    for seed in seeds(30) {
        law(seed, Errors::Axes);
        law(seed, Errors::All);
    }
}

/// A random machine with all errors for LinuxCNC 2.9, the control with its nominal numbers, and settings of the exporter.
pub(crate) fn random_of_2_9(seed: u64) -> (Machine, Kinematics, Value) {
    let (made, kinematics) = random(5 * seed + 3 + seed % 2, Errors::All);
    let settings = settings(&kinematics);
    (made.machine, kinematics, settings)
}

#[test]
fn the_public_table_is_corrected_by_its_pins() {
    let machine = Machine::public("table-table");
    let table = [("A".to_owned(), [0.0, 0.0, -50.0]), ("C".to_owned(), [0.0, 0.0, -50.0])];
    let kinematics = Kinematics { module: "xyzac-trt-kins", pins: pins(&table, 120.0, Some(true), 1) };
    let export = exporter("linuxcnc-five-axis", &settings(&kinematics));
    let load = |files: &[ExportedFile]| Box::new(Linuxcnc::load(&kinematics, files)) as Box<dyn Control>;
    for seed in 1..=5 {
        let found = holds(&machine, export.as_ref(), &load, &machine.anywhere(200, &[], seed), 1e-8);
        // Directions, squareness and error motions stay.
        assert!(found.after < found.before, "{found:?}");
    }
}

/// `xyzbc-trt-kins` has another sense of turning in its inverse kinematics than in its forward ones, unless that is conventional.
#[test]
fn a_module_whose_kinematics_do_not_fit_each_other_is_refused() {
    let layout = Layout { table: &["B", "C"], head: &[], reversed: &["B", "C"] };
    let made = machine(1, &layout, Errors::Places);
    let pins = pins(&made.table, made.tool, Some(false), 1);
    let kinematics = Kinematics { module: "xyzbc-trt-kins", pins };
    let angle = |name: &str| if name == "B" { 30.0 } else { 0.0 };
    let back = kinematics.inverse(kinematics.forward([1.0, 2.0, 3.0], &angle), &angle);
    assert!((back[0] - 1.0).abs() > 1.0, "{back:?}");
    let export = exporter("linuxcnc-five-axis", &settings(&kinematics));
    let error = export.export(&made.machine.calibration, made.machine.model.as_ref()).expect_err("no such kinematics");
    assert!(error.to_string().contains("conventional"), "{error}");
}

#[test]
fn pins_of_other_machines_are_refused() {
    let pins = json!({ "x-rot-point": 0, "y-rot-point": 0, "y-offset": 0, "z-offset": 0 });
    let mut missing = json!({ "module": "xyzac-trt-kins", "existing": pins });
    missing["existing"].as_object_mut().expect("pins").remove("y-offset");
    assert!(refused("linuxcnc-five-axis", &missing).contains("existing.y-offset"));
    let unknown = json!({ "module": "xyzbc-trt-kins", "existing": pins });
    let message = refused("linuxcnc-five-axis", &unknown);
    assert!(message.contains("existing.y-offset") && message.contains("x-offset"), "{message}");
    for (name, expected) in [("head-table", "knows a tilting table A"), ("three-axis", "knows a tilting table A")] {
        let machine = Machine::public(name);
        let export = exporter("linuxcnc-five-axis", &json!({ "module": "xyzac-trt-kins", "existing": pins }));
        let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("another machine");
        assert!(error.to_string().contains(expected), "{error}");
    }
    let machine = Machine::public("table-table");
    let old = exporter("linuxcnc-five-axis", &json!({ "module": "xyzac-trt-kins", "existing": pins }));
    let error = old.export(&machine.calibration, machine.model.as_ref()).expect_err("it turns the other way");
    assert!(error.to_string().contains("LinuxCNC 2.9 turns both axes against convention"), "{error}");
    let narrow = json!({ "module": "xyzac-trt-kins", "has_conventional_directions": true, "existing": pins,
        "largest_change_mm": 0.01 });
    let error = exporter("linuxcnc-five-axis", &narrow).export(&machine.calibration, machine.model.as_ref());
    assert!(error.expect_err("too much").to_string().contains("at most 0.01 mm"));
}
