//! Steps per mm of grbl.
//!
//! Emulator: grbl makes `command * steps_per_mm` steps of a motor (settings `$100` to `$102`, numbers of 32 bits). The axis moves by
//! the true length of a step, which is that of the present settings. No example with numbers is published.

use abbe_core::ExportedFile;
use serde_json::json;

use super::law::{ByAxis, Control, Machine, Turned, exporter, left, seeds, uniform};
use super::three_axes::{largest, scales, slopes};

struct Grbl {
    /// `$100`, `$101`, `$102`.
    steps: [f32; 3],
    /// Steps that move an axis by what the calibration calls 1 mm.
    present: [f64; 3],
}

impl Grbl {
    fn load(files: &[ExportedFile], present: [f64; 3]) -> Self {
        let text = std::str::from_utf8(&files[0].content).expect("text");
        let mut steps = [0.0; 3];
        for line in text.lines() {
            let (name, value) = line.strip_prefix('$').and_then(|line| line.split_once('=')).expect("a setting");
            steps[name.parse::<usize>().expect("a number") - 100] = value.parse().expect("a number");
        }
        Self { steps, present }
    }
}

impl Control for Grbl {
    fn motors(&self, commands: &ByAxis, _: &ByAxis) -> ByAxis {
        let axes = ["X", "Y", "Z"].iter().zip(self.steps.iter().zip(self.present));
        axes.map(|(axis, (steps, present))| ((*axis).to_owned(), commands[*axis] * f64::from(*steps) / present))
            .collect()
    }
}

#[test]
fn scales_are_right_after_the_steps_of_grbl() {
    for seed in seeds(50) {
        let machine = Machine::random("three-axis", seed + 1);
        let mut uniform = uniform(seed);
        let present = [0, 1, 2].map(|_| (20.0 + 800.0 * uniform()).round() / 4.0);
        let settings = json!({ "existing": { "steps_per_mm": { "X": present[0], "Y": present[1], "Z": present[2] } } });
        let export = exporter("grbl", &settings);
        let files = export.export(&machine.calibration, machine.model.as_ref()).expect("files");
        let control = Grbl::load(&files, present);
        let statuses = machine.anywhere(50, &[], seed);
        // Numbers of 32 bits: 6e-8 of 400 mm.
        let found = left(&machine, export.as_ref(), &control, &statuses);
        assert!(found.from_predicted < 5e-5, "{seed}: {found:?}");
        let before = largest(scales(slopes(&machine, None)));
        let after = largest(scales(slopes(&machine, Some(&control))));
        let turned = largest(scales(slopes(&machine, Some(&Turned(&control)))));
        assert!(before > 1e-7 && after < 1.5e-7 + 1e-3 * before, "{seed}: {before} {after}");
        assert!(turned > 1.9 * before, "{seed}: {before} {turned}");
    }
}

#[test]
fn settings_that_grbl_cannot_have_are_refused() {
    let settings = |steps: f64| json!({ "existing": { "steps_per_mm": { "X": steps, "Y": 80, "Z": 400 } } });
    let machine = Machine::public("three-axis");
    let mut narrow = settings(80.0);
    narrow["largest_change_percent"] = json!(1e-4);
    let error = exporter("grbl", &narrow).export(&machine.calibration, machine.model.as_ref()).expect_err("too much");
    assert!(error.to_string().contains("at most 0.0001 % are allowed"), "{error}");
    let five = Machine::public("table-table");
    let error =
        exporter("grbl", &settings(80.0)).export(&five.calibration, five.model.as_ref()).expect_err("five axes");
    assert!(error.to_string().contains("the machine has 5 axes"), "{error}");
    let wrong = |settings: &serde_json::Value| super::law::refused("grbl", settings);
    assert!(wrong(&settings(-1.0)).contains("existing.steps_per_mm.X"), "{}", wrong(&settings(-1.0)));
    assert!(wrong(&json!({})).contains("existing"));
}
