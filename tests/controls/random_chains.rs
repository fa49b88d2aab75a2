//! Random machines of three linear and up to two rotary axes, with location errors and error motions.

use abbe_core::Calibration;
use abbe_engine::model_of;
use serde_json::{Value, json};

use super::law::Machine;
use crate::support::registry;

struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, size: f64) -> f64 {
        size * (2.0 * self.unit() - 1.0)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize % count
    }
}

/// Machines with their numbers. Rotary axes stand at the outer end of their side, so that linear axes are never parallel.
pub fn machines(count: u64) -> impl Iterator<Item = (u64, Machine)> {
    (1..=count).map(|number| (number, machine(&mut Random(number.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1))))
}

fn machine(random: &mut Random) -> Machine {
    let mut linear = vec!["X", "Y", "Z"];
    (0..3).for_each(|place| linear.swap(place, random.below(3)));
    let mut rotary = vec!["A", "B", "C"];
    (0..3).for_each(|place| rotary.swap(place, random.below(3)));
    rotary.truncate(random.below(3));
    let table = random.below(rotary.len() + 1);
    let carrying = random.below(4);
    let primed = |axes: &[&str]| axes.iter().map(|axis| format!(" {axis}'")).collect::<String>();
    let plain = |axes: &[&str]| axes.iter().map(|axis| format!(" {axis}")).collect::<String>();
    let chain = format!(
        "w{}{} b{}{} t",
        primed(&rotary[..table]),
        primed(&linear[..carrying]),
        plain(&linear[carrying..]),
        plain(&rotary[table..])
    );
    let mut axes = serde_json::Map::new();
    let mut errors = vec![json!({ "location": ["E?0?"] })];
    for axis in &linear {
        axes.insert((*axis).to_owned(), json!({ "range_mm": [-300, 300] }));
        errors.push(json!({ "polynomial": [format!("E?{axis}")], "degrees": [1, 2] }));
    }
    for axis in &rotary {
        let point = [(); 3].map(|()| random.within(150.0).round());
        axes.insert((*axis).to_owned(), json!({ "range_deg": [-100, 100], "point_mm": point }));
        errors.push(json!({ "fourier": [format!("E?{axis}")], "orders": [1] }));
    }
    let frame = if random.unit() < 0.5 { "moving" } else { "fixed" };
    let settings = json!({
        "chain": chain, "tool_length_mm": 150, "stylus_radius_mm": 0, "axes": axes, "errors": errors,
        "error_frame": frame,
    });
    Machine::of(&with_values(&settings, random, 0.0))
}

/// A machine of these settings with random values of a seed; rotary axes are displaced by up to `displaced` mm in each direction.
pub fn of_settings(settings: &Value, seed: u64, displaced: f64) -> Machine {
    Machine::of(&with_values(settings, &mut Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1), displaced))
}

fn with_values(settings: &Value, random: &mut Random, displaced: f64) -> Value {
    let mut calibration = json!({
        "abbe_calibration": 1, "estimate": "truth", "parameters": [], "artefacts": [], "outliers": [],
        "model": { "plugin": "serial-chain", "settings": settings },
        "covariance": { "order": [], "rows": [] },
        "fit": {
            "observations": 0, "unknowns": 0, "rank": 0, "condition": 1.0, "degrees_of_freedom": 0, "sigma": 1.0,
            "iterations": 0, "termination": "converged", "residual_max_um": 0.0, "residual_mean_abs_um": 0.0,
            "residual_rms_um": 0.0, "null_space": [],
        },
    });
    let empty = Calibration::from_json(&calibration.to_string()).expect("a calibration");
    let model = model_of(&empty, &registry()).unwrap_or_else(|error| panic!("{settings}: {error}"));
    let parameters: Vec<Value> = (model.info().parameters.iter())
        .map(|parameter| {
            let name = &parameter.name;
            let (is_angle, is_rotary) =
                (matches!(&name[1..2], "A" | "B" | "C"), matches!(&name[2..3], "A" | "B" | "C"));
            let size = match name.get(3..) {
                _ if !name.starts_with('E') => 0.0,
                Some("[1]") if is_angle => 1e-7,
                Some("[2]") if is_angle => 2e-10,
                Some("[1]") => 3e-5,
                Some("[2]") => 5e-8,
                Some(_) if is_angle => 5e-5,
                Some("A" | "B" | "C") => displaced,
                Some(_) if is_rotary => 5e-3,
                _ => 0.0,
            };
            json!({
                "name": name, "value": random.within(size), "unit": parameter.unit.to_string(),
                "standard_uncertainty": 0, "status": "fixed",
            })
        })
        .collect();
    calibration["parameters"] = json!(parameters);
    calibration
}
