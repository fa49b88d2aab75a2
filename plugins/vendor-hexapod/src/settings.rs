//! What a recipe says of a hexapod.

use abbe_plugin::sdk::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Settings of a hexapod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(crate = "abbe_plugin::sdk::serde", deny_unknown_fields)]
#[schemars(crate = "abbe_plugin::sdk::schemars")]
pub struct Settings {
    /// Name of the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The six joints on the base, machine frame.
    pub base_joints_mm: [[f64; 3]; 6],
    /// The six joints on the platform, platform frame.
    pub platform_joints_mm: [[f64; 3]; 6],
    /// Position of the platform's frame when all struts are in the middle of their range: the start of the iteration.
    pub home_mm: [f64; 3],
    /// Range of the strut lengths.
    pub strut_range_mm: [f64; 2],
    /// Nominal tip in the platform frame.
    #[serde(default)]
    pub tip_mm: [f64; 3],
    /// Effective stylus radius.
    #[serde(default)]
    pub stylus_radius_mm: f64,
}

/// A Stewart platform on a circle of 500 mm.
pub fn example() -> Value {
    let circle = |radius: f64, angles: [f64; 6]| -> Vec<[f64; 3]> {
        let on = |angle: f64| {
            let (sin, cos) = angle.to_radians().sin_cos();
            [(radius * cos * 1e3).round() / 1e3, (radius * sin * 1e3).round() / 1e3, 0.0]
        };
        angles.map(on).to_vec()
    };
    json!({
        "base_joints_mm": circle(500.0, [-10.0, 10.0, 110.0, 130.0, 230.0, 250.0]),
        "platform_joints_mm": circle(250.0, [-50.0, 50.0, 70.0, 170.0, 190.0, 290.0]),
        "home_mm": [0.0, 0.0, 700.0],
        "strut_range_mm": [600.0, 1000.0],
        "tip_mm": [0.0, 0.0, 120.0],
    })
}
