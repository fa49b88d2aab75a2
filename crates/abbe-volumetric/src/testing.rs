//! Machines and calibrations for tests.

use std::sync::Arc;

use abbe_core::{Build, Calibration, Context, Error, Kind, KinematicModel, Registry, path_text};
use abbe_serial_chain as _;
use serde_json::{Value, json};

/// A serial chain with a tool of 100 mm.
pub fn chain(structure: &str, axes: Value, errors: Value) -> Arc<dyn KinematicModel> {
    let settings =
        json!({ "chain": structure, "tool_length_mm": 100, "stylus_radius_mm": 0, "axes": axes, "errors": errors });
    let registry = Registry::built_in().unwrap();
    let Build::Model(plugin) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { unreachable!() };
    plugin.build(&settings, &Context { base: "".into() }).unwrap().build(&[]).unwrap()
}

/// A calibration with some values, without covariance.
pub fn calibration(values: &[(&str, f64)]) -> Calibration {
    let parameters: Vec<Value> = values
        .iter()
        .map(|(name, value)| {
            json!({ "name": name, "value": value, "unit": "mm", "standard_uncertainty": 0, "status": "fixed" })
        })
        .collect();
    let text = json!({
        "abbe_calibration": 1,
        "estimate": "fit",
        "model": { "plugin": "serial-chain", "settings": {} },
        "parameters": parameters,
        "artefacts": [],
        "covariance": { "order": [], "rows": [] },
        "outliers": [],
        "fit": {
            "observations": 0, "unknowns": 0, "rank": 0, "condition": 1, "degrees_of_freedom": 0, "sigma": 1,
            "iterations": 0, "termination": "converged", "residual_max_um": 0, "residual_mean_abs_um": 0,
            "residual_rms_um": 0, "null_space": []
        }
    });
    Calibration::from_json(&text.to_string()).unwrap()
}

/// The text of an error after the setting that it points at.
pub fn key_error<T>(result: Result<T, Error>) -> String {
    let error = result.err().unwrap();
    format!("{}: {error}", path_text(&error.setting))
}
