//! Skew of printers.
//!
//! Emulators: the formulas of Klipper (`skew_correction.py`) and Marlin (`Planner::skew`), and of RepRapFirmware
//! (`Move::AxisTransform`), as their sources have them, and back again for factors that are active while the machine is measured.

use abbe_core::ExportedFile;
use serde_json::{Value, json};

use super::law::{ByAxis, Control, Machine, Turned, exporter, left, refused, seeds, uniform};
use super::three_axes::{largest, slopes, squareness};

/// What a firmware does to x, y and z.
enum Firmware {
    /// Klipper and Marlin: xy, xz, yz.
    Skew([f64; 3]),
    /// RepRapFirmware: tangents XY, YZ, XZ.
    Tangents([f64; 3]),
}

impl Firmware {
    fn load(files: &[ExportedFile]) -> Self {
        let text = std::str::from_utf8(&files[0].content).expect("text");
        let word = |letter: char| {
            let line = text.lines().find(|line| line.starts_with('M')).expect("a command");
            let word = line.split(' ').skip(1).find_map(|word| word.strip_prefix(letter)).expect("a word");
            word.parse::<f64>().expect("a number")
        };
        match files[0].name.as_str() {
            "skew.cfg" => {
                let (_, profile) = text.split_once("[skew_correction abbe]").expect("a profile");
                let value = |key: &str| {
                    let lines = profile.lines().filter_map(|line| line.split_once('='));
                    let found = lines.clone().find(|(name, _)| name.trim() == key).expect("a value");
                    found.1.trim().parse::<f64>().expect("a number")
                };
                Self::Skew(["xy_skew", "xz_skew", "yz_skew"].map(value))
            }
            "skew.gcode" => Self::Skew(['I', 'J', 'K'].map(word)),
            _ => Self::Tangents(['X', 'Y', 'Z'].map(|letter| word(letter) / word('S'))),
        }
    }

    fn moved(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match *self {
            Self::Skew([xy, xz, yz]) => [x - y * xy - z * (xz - xy * yz), y - z * yz, z],
            Self::Tangents([xy, yz, xz]) => [x + xy * y + xz * z, y + yz * z, z],
        }
    }
}

struct Printer {
    firmware: Firmware,
    /// Factors xy, xz, yz that are in the calibrated machine.
    existing: [f64; 3],
}

impl Control for Printer {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let [x, y, z] = self.firmware.moved(["X", "Y", "Z"].map(|axis| commands[axis]));
        let [xy, xz, yz] = self.existing;
        let machine = [x + y * xy + z * xz, y + z * yz, z];
        ["X", "Y", "Z"].iter().zip(machine).map(|(axis, value)| ((*axis).to_owned(), value)).collect()
    }
}

const FIRMWARES: [&str; 3] = ["klipper", "marlin", "reprapfirmware"];

fn settings(firmware: &str, [xy, xz, yz]: [f64; 3]) -> Value {
    json!({ "firmware": firmware, "existing": { "xy": xy, "xz": xz, "yz": yz } })
}

/// What Klipper itself did with this profile: the motors' steps for `G1 X100 Y200` summed to 99.8 and 200 mm.
#[test]
fn the_emulator_moves_as_klipper() {
    let moved = Firmware::Skew([0.001, 0.0, 0.0]).moved([100.0, 200.0, 0.0]);
    assert!((moved[0] - 99.8).abs() < 1e-12 && moved[1] == 200.0, "{moved:?}");
}

#[test]
fn axes_are_square_after_the_skew_of_printers() {
    for seed in seeds(60) {
        let machine = Machine::random("three-axis", seed + 1);
        let mut uniform = uniform(seed);
        let existing = [0, 1, 2].map(|_| if seed % 2 == 0 { 4e-3 * (uniform() - 0.5) } else { 0.0 });
        let export = exporter("printer-skew", &settings(FIRMWARES[seed as usize % 3], existing));
        let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let control = Printer { firmware: Firmware::load(&files), existing };
        let found = left(&machine, export.as_ref(), &control, &machine.anywhere(50, &[], seed));
        assert!(found.from_predicted < 1e-8, "{seed}: {found:?}");
        let before = largest(squareness(slopes(&machine, None)));
        let after = largest(squareness(slopes(&machine, Some(&control))));
        let turned = largest(squareness(slopes(&machine, Some(&Turned(&control)))));
        assert!(before > 1e-6 && after < 2e-8 + 1e-3 * before, "{seed}: {before} {after}");
        assert!(turned > 1.9 * before, "{seed}: {before} {turned}");
    }
}

#[test]
fn skew_that_no_printer_has_is_refused() {
    let large = settings("klipper", [0.02, 0.0, 0.0]);
    assert!(refused("printer-skew", &large).contains("existing.xy"), "{}", refused("printer-skew", &large));
    assert!(refused("printer-skew", &json!({ "firmware": "smoothie" })).contains("firmware"));
    let machine = Machine::public("three-axis");
    let mut narrow = settings("marlin", [0.0; 3]);
    narrow["largest_skew_mrad"] = json!(0.001);
    let export = exporter("printer-skew", &narrow);
    let error = export.export(&machine.calibration, machine.model.as_ref()).expect_err("too much");
    assert!(error.to_string().contains("mrad are allowed"), "{error}");
}
