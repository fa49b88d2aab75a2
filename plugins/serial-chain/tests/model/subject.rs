//! Proves nothing by itself: models built through the registry, and statuses for them.

use std::sync::Arc;

use abbe_core::{AxisKind, Build, Context, Dataset, Kind, KinematicModel, Poses, Quantity, Registry, Variable};
use abbe_serial_chain as _;
use serde_json::{Value, json};

use crate::oracle::{Machine, Random};

pub fn model(settings: &Value, data: &[&Dataset]) -> Arc<dyn KinematicModel> {
    stage(settings).expect("valid settings").build(data).expect("a model")
}

/// The message for settings that are refused.
pub fn refused(settings: &Value) -> String {
    stage(settings).err().expect("an error").to_string()
}

fn stage(settings: &Value) -> Result<Box<dyn abbe_core::Model>, abbe_core::SettingsError> {
    let registry = Registry::built_in().expect("plugins of different names");
    let plugin = registry.find(Kind::Model, "serial-chain").expect("the plugin");
    let Build::Model(constructor) = &plugin.build else { panic!("a model plugin builds models") };
    constructor.build(settings, &Context { base: ".".into() })
}

/// All letters that an axis of its kind may have, in an order that takes part in making machines random.
const LINEAR: [&str; 6] = ["X", "Y", "Z", "U", "V", "W"];
const ROTARY: [&str; 6] = ["A", "B", "C", "A2", "B2", "C2"];

/// A random machine: the oracle's, and settings of the plugin that describe the same with every family of errors.
pub fn random(random: &mut Random, evaluation: &str) -> (Machine, Vec<&'static str>, Value) {
    let mut machine = Machine::random(random);
    let (mut linear, mut rotary) = (LINEAR.iter(), ROTARY.iter());
    let (mut names, mut axes) = (Vec::new(), serde_json::Map::new());
    for axis in &mut machine.axes {
        let pool = if axis.rotary { &mut rotary } else { &mut linear };
        let Some(name) = pool.next().copied() else { break };
        let settings = json!({
            "direction": <[f64; 3]>::from(axis.direction), "point_mm": <[f64; 3]>::from(axis.point),
            "reverse": axis.reverse, "error_frame": if axis.fixed { "fixed" } else { "moving" },
        });
        axes.insert(name.to_owned(), settings);
        names.push(name);
    }
    machine.axes.truncate(names.len());
    machine.bed = machine.bed.min(names.len());
    let length = machine.tip.x.abs();
    let offset: [f64; 3] = (machine.tip + nalgebra::Vector3::new(0.0, 0.0, length)).into();
    let settings = json!({
        "chain": format!("w {} b {} t", names[..machine.bed].join(" "), names[machine.bed..].join(" ")),
        "tool_length_mm": length,
        "stylus_radius_mm": 1.5,
        "probe_offset_mm": offset,
        "axes": axes,
        "styli": { "2": { "tip_mm": <[f64; 3]>::from(random.vector(200.0)) }, "5": { "tip_mm": [3.0, -80.0, -150.0] } },
        "errors": [
            { "location": ["E?0*"] },
            { "polynomial": ["E??", "E??2"], "degrees": [0, 1, 2, 3] },
            { "backlash": ["E??", "E??2"] },
            { "drift": ["dxt", "dyt", "dzt", "daw"], "degrees": [1, 2], "time_s": { "": [0.0, 3600.0] } },
            { "drift": ["d??"], "degrees": [1, 3], "per": "day", "time_s": { "1": [0.0, 1800.0], "2": [1800.0, 3600.0] } },
        ],
        "evaluation": evaluation,
    });
    // A machine of two rotary axes has no symbol of three letters for others, and a pattern that matches nothing is refused.
    let plain = names.iter().any(|name| name.len() == 1);
    let numbered = names.iter().any(|name| name.len() == 2);
    let mut settings = settings;
    let patterns: Vec<&str> = [("E??", plain), ("E??2", numbered)].into_iter().filter(|p| p.1).map(|p| p.0).collect();
    settings["errors"][1]["polynomial"] = json!(patterns);
    settings["errors"][2]["backlash"] = json!(patterns);
    (machine, names, settings)
}

/// Statuses of `count` poses.
pub fn statuses(model: &dyn KinematicModel, random: &mut Random, count: usize) -> Vec<f64> {
    let mut all = Vec::new();
    for _ in 0..count {
        for (index, status) in model.info().status.iter().enumerate() {
            all.push(match model.info().axes.get(index).map(|axis| axis.kind) {
                Some(AxisKind::Linear) => 400.0 * random.signed(),
                Some(AxisKind::Rotary) => 2.0 * random.signed(),
                None if status.name.starts_with("dir_") => [1.0, -1.0, 0.0][random.below(3)],
                None if status.name.starts_with("velocity_") => 50.0 * random.signed(),
                None if status.quantity == Quantity::Label => random.below(status.levels.len()) as f64,
                None if status.quantity == Quantity::Force => 5000.0 * random.signed().abs(),
                None if status.quantity == Quantity::Length => 300.0 * random.signed(),
                None => 1800.0 + 1800.0 * random.signed(),
            });
        }
    }
    all
}

pub fn poses(model: &dyn KinematicModel, statuses: &[f64], values: &[f64], wanted: &[Variable]) -> Poses {
    let mut out = Poses::default();
    model.poses(statuses, values, wanted, true, &mut out).expect("poses");
    out
}

/// Values of all parameters, each with an effect of about `mm` or `rad` somewhere in the range of its axis.
pub fn parameter_values(model: &dyn KinematicModel, random: &mut Random, mm: f64, rad: f64) -> Vec<f64> {
    let size = |parameter: &abbe_core::Parameter| {
        let effect = if parameter.unit.of == Quantity::Length { mm } else { rad };
        match parameter.unit.per {
            Some((Quantity::Length, power)) => effect / 400.0_f64.powi(i32::from(power)),
            Some((_, power)) => effect / 2.0_f64.powi(i32::from(power)),
            None if parameter.unit.of == Quantity::Time => mm / 50.0,
            None => effect,
        }
    };
    let parameters = model.info().parameters.iter().zip(&model.info().nominal);
    parameters
        .map(|(parameter, nominal)| match *nominal == 0.0 {
            true => size(parameter) * random.signed(),
            // A shape, such as a wavelength.
            false => nominal * (1.0 + 1e-3 * random.signed()),
        })
        .collect()
}
