//! Machines and calibrations for tests.

use std::sync::Arc;

use abbe_core::{
    Build, CALIBRATION_FORMAT, Calibration, Context, Error, Export, Kind, KinematicModel, Registry, SettingsError,
    path_text,
};
use abbe_serial_chain as _;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// A serial chain with a tool of 100 mm.
pub fn chain(structure: &str, axes: Value, errors: Value) -> Arc<dyn KinematicModel> {
    let settings =
        json!({ "chain": structure, "tool_length_mm": 100, "stylus_radius_mm": 0, "axes": axes, "errors": errors });
    let registry = Registry::built_in().unwrap();
    let Build::Model(plugin) = &registry.find(Kind::Model, "serial-chain").unwrap().build else { unreachable!() };
    plugin.build(&settings, &Context { base: "".into() }).unwrap().build(&[]).unwrap()
}

/// A calibration with some values, the others zero, without covariance.
pub fn calibration(model: &dyn KinematicModel, values: &[(&str, f64)]) -> Calibration {
    for (name, _) in values {
        assert!(model.info().parameters.iter().any(|parameter| parameter.name == *name), "{name}");
    }
    let value = |name: &str| values.iter().find(|(other, _)| *other == name).map_or(0.0, |(_, value)| *value);
    let parameters = model.info().parameters.iter().map(|parameter| {
        let (value, unit) = (value(&parameter.name), parameter.unit.to_string());
        json!({ "name": parameter.name, "value": value, "unit": unit, "standard_uncertainty": 0, "status": "fixed" })
    });
    let text = json!({
        "abbe_calibration": CALIBRATION_FORMAT,
        "estimate": "fit",
        "model": { "plugin": "serial-chain", "settings": model.info().settings },
        "parameters": parameters.collect::<Vec<_>>(),
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

/// What becomes of the settings of an exporter.
type Built = Result<Box<dyn Export>, SettingsError>;

/// An exporter as a recipe with these settings would have it.
pub fn built<S: DeserializeOwned>(settings: &Value, build: fn(S, &Context) -> Built) -> Built {
    abbe_core::from_settings(settings).and_then(|settings| build(settings, &Context { base: "".into() }))
}
