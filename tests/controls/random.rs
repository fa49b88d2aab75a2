//! Random machines of three to five axes with random errors, for the tables of controls.

use abbe_core::{Build, Context, Kind};
use serde_json::{Value, json};

use super::law::Machine;
use crate::support::registry;

/// Which errors a machine has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Errors {
    /// Position and orientation errors of axes, motion errors of all components, reversal.
    Any,
    /// As any, with error motions of rotary axes, error frames of either kind and axes of rotation anywhere, but without reversal.
    Smooth,
    /// Errors that shift the tip by a function of one axis: translations, of machines with three axes.
    OfOneAxis,
    /// Positioning errors and reversal, of machines with three axes.
    Positioning,
    /// Positioning errors of degree one and reversal of one rotary axis, and no others.
    Rotary,
    /// The same for a rotary axis that turns without an end: its errors repeat with every turn.
    Endless,
}

/// Largest coefficient of degree two of the machines, 1/mm.
const CURVATURE: f64 = 1e-7;

/// Largest distance of the tip, mm, that linear interpolation leaves: the bows of three curves in each of three directions.
pub fn bow(step: f64) -> f64 {
    3.0 * 3.0_f64.sqrt() * CURVATURE * step * step / 4.0 + 1e-5
}

/// Largest displacement of a rotary axis in each direction, mm.
const DISPLACED: f64 = 5e-3;

struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, size: f64) -> f64 {
        size * (2.0 * self.uniform() - 1.0)
    }

    fn shuffled<'a>(&mut self, list: &[&'a str]) -> Vec<&'a str> {
        let mut left = list.to_vec();
        let pick = |left: &mut Vec<&'a str>, part: f64| left.remove((part * left.len() as f64) as usize);
        (0..list.len()).map(|_| pick(&mut left, self.uniform())).collect()
    }
}

/// A machine of a seed.
pub fn machine(seed: u64, errors: Errors) -> Machine {
    of_settings(&settings(seed, errors), seed, DISPLACED)
}

/// The machine of a seed with the values of another one.
pub fn machine_like(seed: u64, values: u64) -> Machine {
    machine_of(seed, Errors::Any, values)
}

/// The same of other errors.
pub fn machine_of(seed: u64, errors: Errors, values: u64) -> Machine {
    of_settings(&settings(seed, errors), values, DISPLACED)
}

fn settings(seed: u64, errors: Errors) -> Value {
    let mut random = Random(seed);
    let rotary = match errors {
        Errors::Any | Errors::Smooth => random.shuffled(&["A", "B", "C"])[..(random.uniform() * 3.0) as usize].to_vec(),
        // C between spindle and tool turns the tool about itself.
        Errors::Rotary | Errors::Endless => random.shuffled(&["A", "B"])[..1].to_vec(),
        Errors::OfOneAxis | Errors::Positioning => Vec::new(),
    };
    // Rotary axes outside the linear ones: these are never parallel.
    let linear = random.shuffled(&["X", "Y", "Z"]);
    let split = (random.uniform() * 4.0) as usize;
    let (of_table, of_tool) = rotary.split_at((random.uniform() * (rotary.len() + 1) as f64) as usize);
    let chain = [&["w"][..], of_table, &linear[..split], &["b"], &linear[split..], of_tool, &["t"]].concat().join(" ");
    let mut range = |axis: &str| match axis {
        "X" | "Y" | "Z" => json!({ "range_mm": [-300, 300] }),
        _ if errors == Errors::Endless => {
            json!({ "range_deg": [0, 360], "endless": true, "point_mm": [10, -20, 30] })
        }
        _ if errors == Errors::Smooth => {
            let point = [(); 3].map(|()| random.within(150.0).round());
            json!({ "range_deg": [-100, 100], "point_mm": point })
        }
        _ => json!({ "range_deg": [-120, 120], "point_mm": [10, -20, 30] }),
    };
    let axes: serde_json::Map<String, Value> =
        linear.iter().chain(&rotary).map(|axis| (axis.to_string(), range(axis))).collect();
    let frame = if errors == Errors::Smooth && random.uniform() < 0.5 { "fixed" } else { "moving" };
    let own = |letters: &[&str], axes: &[&str]| {
        axes.iter().flat_map(|axis| letters.iter().map(move |letter| format!("E{letter}{axis}"))).collect::<Vec<_>>()
    };
    let (shifts, turns) = (["X", "Y", "Z"], ["A", "B", "C"]);
    let positions: Vec<String> = linear.iter().chain(&rotary).map(|axis| format!("E{axis}{axis}")).collect();
    let errors = match errors {
        Errors::OfOneAxis => json!([
            { "polynomial": own(&shifts, &linear), "degrees": [1, 2] },
            { "backlash": own(&shifts, &linear) },
        ]),
        Errors::Positioning => json!([
            { "polynomial": positions, "degrees": [1, 2] },
            { "backlash": positions },
        ]),
        Errors::Rotary => json!([
            { "polynomial": positions[3..], "degrees": [1] },
            { "backlash": positions[3..] },
        ]),
        Errors::Endless => json!([
            { "fourier": positions[3..], "orders": [1, 2] },
            { "backlash": positions[3..] },
        ]),
        Errors::Any => json!([
            { "location": ["E?0?"] },
            { "polynomial": own(&[shifts, turns].concat(), &linear), "degrees": [1, 2] },
            { "polynomial": own(&turns, &rotary), "degrees": [1] },
            { "backlash": positions },
        ]),
        Errors::Smooth => json!([
            { "location": ["E?0?"] },
            { "polynomial": own(&[shifts, turns].concat(), &linear), "degrees": [1, 2] },
            { "fourier": own(&[shifts, turns].concat(), &rotary), "orders": [1] },
        ]),
    };
    let errors: Vec<&Value> = errors
        .as_array()
        .unwrap()
        .iter()
        .filter(|line| ["polynomial", "fourier"].iter().all(|family| line[family] != json!([])))
        .collect();
    json!({
        "chain": chain, "tool_length_mm": 100, "stylus_radius_mm": 0, "axes": axes, "errors": errors, "error_frame": frame,
    })
}

/// The machine with the same errors in both directions of travel.
pub fn without_reversal(machine: &Machine) -> Machine {
    let mut calibration: Value = serde_json::from_str(&machine.calibration.to_json().expect("JSON")).expect("JSON");
    for parameter in calibration["parameters"].as_array_mut().expect("parameters") {
        if parameter["name"].as_str().is_some_and(|name| name.ends_with("[b]")) {
            parameter["value"] = json!(0.0);
        }
    }
    Machine::of(&calibration)
}

/// A machine of these settings with random values of a seed; rotary axes are displaced by up to `displaced` mm in each direction.
pub fn of_settings(settings: &Value, seed: u64, displaced: f64) -> Machine {
    let registry = registry();
    let Build::Model(plugin) = &registry.find(Kind::Model, "serial-chain").expect("built in").build else { panic!() };
    let built =
        plugin.build(settings, &Context { base: ".".into() }).unwrap_or_else(|error| panic!("{settings}: {error}"));
    let model = built.build(&[]).unwrap_or_else(|error| panic!("{settings}: {error}"));
    let mut random = Random(seed ^ 0x5555);
    let parameters = model.info().parameters.iter().map(|parameter| {
        let unit = parameter.unit.to_string();
        let rotary_axis_stands =
            parameter.name.get(2..).and_then(|end| end.strip_prefix('0')).is_some_and(|axis| "ABC".contains(axis));
        let size = match unit.as_str() {
            "mm" if rotary_axis_stands => displaced,
            "mm" => 5e-3,
            "rad" => 3e-5,
            "mm/mm" | "rad/rad" => 3e-5,
            "mm/mm^2" => CURVATURE,
            "rad/mm" => 3e-8,
            "rad/mm^2" => 1e-10,
            other => panic!("{other}"),
        };
        let value = random.within(size);
        json!({ "name": parameter.name, "value": value, "unit": unit, "standard_uncertainty": 0, "status": "fixed" })
    });
    let parameters: Vec<Value> = parameters.filter(|parameter| !set_up(parameter)).collect();
    let mut calibration = crate::compensation::calibration("three-axis");
    calibration["parameters"] = json!(parameters);
    calibration["model"]["settings"] = settings.clone();
    Machine::of(&calibration)
}

/// Tool and workpiece are set up again; no table corrects that.
fn set_up(parameter: &Value) -> bool {
    !parameter["name"].as_str().unwrap().starts_with('E')
}
