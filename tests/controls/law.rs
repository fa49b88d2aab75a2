//! The law that every table has to fulfil.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{
    AxisKind, Build, Calibration, Context, Export, ExportedFile, Kind, KinematicModel, Poses, StatusRole,
    machine_values,
};
use abbe_engine::model_of;
use serde_json::Value;

use crate::compensation::calibration;
use crate::support::registry;

/// Values by the name of an axis: positions in mm and degrees, directions +1 or -1.
pub type ByAxis = BTreeMap<String, f64>;

/// A control that has loaded files.
pub trait Control {
    /// The commands of its motors, mm and degrees, at these commands of its axes and directions of their last moves.
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis;
}

/// A public machine of `pipelines/data/compensation` with its errors.
pub struct Machine {
    pub calibration: Calibration,
    pub model: std::sync::Arc<dyn KinematicModel>,
    pub values: Vec<f64>,
}

impl Machine {
    pub fn public(name: &str) -> Self {
        Self::of(&calibration(name))
    }

    /// A public machine with other errors: each is a random part of the public one, up to one and a half times as large, of either sign.
    pub fn random(name: &str, seed: u64) -> Self {
        let mut found = calibration(name);
        let mut uniform = uniform(seed);
        for parameter in found["parameters"].as_array_mut().expect("parameters") {
            let value = parameter["value"].as_f64().expect("a number");
            parameter["value"] = Value::from(value * (3.0 * uniform() - 1.5));
        }
        Self::of(&found)
    }

    /// The machine of a calibration, as JSON.
    pub fn of(calibration: &Value) -> Self {
        let calibration = Calibration::from_json(&calibration.to_string()).expect("a calibration");
        let model = model_of(&calibration, &registry()).expect("a model");
        let values = machine_values(model.as_ref(), &calibration);
        Self { calibration, model, values }
    }

    /// Tips in the table frame, mm, of statuses, with the errors of the machine or without.
    pub fn tips(&self, statuses: &[f64], with_errors: bool) -> Vec<[f64; 3]> {
        self.poses(statuses, with_errors).positions
    }

    fn poses(&self, statuses: &[f64], with_errors: bool) -> Poses {
        let values = if with_errors { &self.values } else { &self.model.info().nominal };
        let mut poses = Poses::default();
        self.model.poses(statuses, values, &[], true, &mut poses).expect("poses");
        poses
    }

    /// `count` statuses anywhere in the travel of the axes, approached from both sides. `still` axes stand at zero.
    pub fn anywhere(&self, count: usize, still: &[&str], seed: u64) -> Vec<f64> {
        let info = self.model.info();
        let mut uniform = uniform(seed);
        let mut statuses = Vec::new();
        for _ in 0..count {
            let mut status = vec![0.0; info.status.len()];
            for axis in info.axes.iter().filter(|axis| !still.contains(&axis.name.as_str())) {
                let [from, to] = axis.range.expect("a range");
                status[axis.status] = from + uniform() * (to - from);
            }
            for (place, column) in info.status.iter().enumerate() {
                if matches!(column.role, StatusRole::Direction(_)) {
                    status[place] = if uniform() < 0.5 { -1.0 } else { 1.0 };
                }
            }
            statuses.extend(status);
        }
        statuses
    }

    /// The statuses with the commands that a control gives its motors.
    pub fn driven(&self, control: &dyn Control, statuses: &[f64]) -> Vec<f64> {
        let info = self.model.info();
        let mut found = statuses.to_vec();
        for status in found.chunks_mut(info.status.len()) {
            let factor = |kind| if kind == AxisKind::Rotary { 1_f64.to_degrees() } else { 1.0 };
            let commands: ByAxis =
                (info.axes.iter()).map(|axis| (axis.name.clone(), status[axis.status] * factor(axis.kind))).collect();
            let directions: ByAxis = (info.axes.iter().enumerate())
                .map(|(index, axis)| {
                    let place = info.status_index(&StatusRole::Direction(index));
                    (axis.name.clone(), place.map_or(1.0, |place| status[place]))
                })
                .collect();
            let motors = control.motors(&commands, &directions);
            for axis in &info.axes {
                if let Some(motor) = motors.get(&axis.name) {
                    status[axis.status] = motor / factor(axis.kind);
                }
            }
        }
        found
    }
}

/// An exporter of this name, built from settings.
pub fn exporter(name: &str, settings: &Value) -> Box<dyn Export> {
    let registry = registry();
    let plugin = registry.find(Kind::Export, name).unwrap_or_else(|error| panic!("{error}"));
    let Build::Export(constructor) = &plugin.build else { panic!("{name} is no exporter") };
    let context = Context { base: PathBuf::from(".") };
    constructor.build(settings, &context).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// What is said of settings that an exporter refuses.
pub fn refused(name: &str, settings: &Value) -> String {
    let registry = registry();
    let plugin = registry.find(Kind::Export, name).unwrap_or_else(|error| panic!("{error}"));
    let Build::Export(constructor) = &plugin.build else { panic!("{name} is no exporter") };
    match constructor.build(settings, &Context { base: PathBuf::from(".") }) {
        Ok(_) => panic!("{name} takes {settings}"),
        Err(error) => error.to_string(),
    }
}

/// Random numbers from 0 to 1.
pub fn uniform(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// A control with all of its corrections turned round.
pub struct Turned<'a>(pub &'a dyn Control);

impl Control for Turned<'_> {
    fn motors(&self, commands: &ByAxis, directions: &ByAxis) -> ByAxis {
        let motors = self.0.motors(commands, directions);
        motors.into_iter().map(|(axis, motor)| (axis.clone(), 2.0 * commands[&axis] - motor)).collect()
    }
}

/// Largest distances of the tip, mm, and the largest angle of the tool, rad.
#[derive(Debug, Clone, Copy)]
pub struct Left {
    /// From the goal, without a correction.
    pub before: f64,
    /// From the goal, with the control's correction.
    pub after: f64,
    /// Between the emulated control and the exporter's prediction.
    pub from_predicted: f64,
    /// Angle between the tool of the emulated control and that of the exporter's prediction.
    pub turned_from_predicted: f64,
}

/// Largest distances over some statuses.
pub fn left(machine: &Machine, export: &dyn Export, control: &dyn Control, statuses: &[f64]) -> Left {
    let correction = export.correction(&machine.calibration, machine.model.as_ref()).expect("a prediction");
    let predicted = correction.expect("the files correct something").commands(statuses).expect("commands");
    let goal = machine.tips(statuses, false);
    let driven = machine.poses(&machine.driven(control, statuses), true);
    let predicted = machine.poses(&predicted, true);
    Left {
        before: largest(&machine.tips(statuses, true), &goal),
        after: largest(&driven.positions, &goal),
        from_predicted: largest(&driven.positions, &predicted.positions),
        turned_from_predicted: turned(&driven.orientations, &predicted.orientations),
    }
}

/// Largest angle between unit quaternions, rad.
fn turned(one: &[[f64; 4]], other: &[[f64; 4]]) -> f64 {
    let angle = |(a, b): (&[f64; 4], &[f64; 4])| {
        let apart = |sign: f64| a.iter().zip(b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f64>().sqrt();
        2.0 * apart(1.0).min(apart(-1.0))
    };
    one.iter().zip(other).map(angle).fold(0.0, f64::max)
}

fn largest(one: &[[f64; 3]], other: &[[f64; 3]]) -> f64 {
    let apart = |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    one.iter().zip(other).map(apart).fold(0.0, f64::max)
}

/// Radius at which an angle of the tool weighs as much as a distance of the tip, mm.
const RADIUS: f64 = 10.0;

/// The seeds of random machines: `usual` ones in the tests, those of `ABBE_SEEDS` (number and first seed) in a campaign.
pub fn seeds(usual: u64) -> std::ops::Range<u64> {
    let Ok(text) = std::env::var("ABBE_SEEDS") else { return 0..usual };
    let numbers: Vec<u64> = text.split(' ').map(|number| number.parse().expect("ABBE_SEEDS: two numbers")).collect();
    let [count, first] = numbers[..] else { panic!("ABBE_SEEDS: two numbers were expected, not `{text}`") };
    first..first + count
}

/// The law: what the emulated control does is what the exporter predicts, within `rounding` mm (digits of the file, interpolation that
/// differs), and turned round it is not, but leaves more.
pub fn holds(
    machine: &Machine,
    export: &dyn Export,
    load: &dyn Fn(&[ExportedFile]) -> Box<dyn Control>,
    statuses: &[f64],
    rounding: f64,
) -> Left {
    let [found, turned] = predicted(machine, export, load, statuses, rounding);
    assert!(turned.after > found.after, "turned round: {turned:?}");
    found
}

/// The law without its last part, for tables that correct a small part of the errors. Also tells what is left with all turned round.
pub fn predicted(
    machine: &Machine,
    export: &dyn Export,
    load: &dyn Fn(&[ExportedFile]) -> Box<dyn Control>,
    statuses: &[f64],
    rounding: f64,
) -> [Left; 2] {
    let files = export.export(&machine.calibration, machine.model.as_ref()).unwrap_or_else(|error| panic!("{error}"));
    let control = load(&files);
    let found = left(machine, export, control.as_ref(), statuses);
    assert!(found.from_predicted <= rounding && found.turned_from_predicted <= rounding / RADIUS, "{found:?}");
    let turned = left(machine, export, &Turned(control.as_ref()), statuses);
    assert!(turned.from_predicted > 10.0 * rounding, "turned round: {turned:?}");
    [found, turned]
}
