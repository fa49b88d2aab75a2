//! Estimator plugin `calibration`: the calibration of another run, with its covariance, its inputs and its model.

use std::path::PathBuf;

use abbe_core::{
    Basis, Build, Calibration, Constructor, Context, Error, Estimate, Identifiability, InputFile, Plugin, Problem,
    Result, SettingsError, inventory,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

inventory::submit! {
    Plugin::built_in(
        "calibration",
        "recalls the calibration of another run: values, covariance, inputs and machine",
        abbe_core::schema_of::<Settings>,
        example,
        Build::Estimate(Constructor::Static(build)),
    )
    .with_reference(include_str!("../reference/estimate-calibration.md"))
    .made_of(Basis::Calibration)
}

/// Settings of a recalled calibration.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The file `<estimate>.calibration.json` that a run left.
    path: String,
}

fn example() -> Value {
    json!({ "path": "../monday/fit.calibration.json" })
}

fn build(settings: &Value, context: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    let settings: Settings = abbe_core::from_settings(settings)?;
    Ok(Box::new(Recalled { path: context.path(&settings.path) }))
}

struct Recalled {
    path: PathBuf,
}

/// The error for whoever wants it solved again.
fn made_elsewhere() -> Error {
    Error::usage("this calibration was made elsewhere: its measurements are not here, so that it cannot be made again")
}

impl Estimate for Recalled {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "path", path: self.path.clone() }]
    }

    fn recall(&self) -> Result<Calibration> {
        let unreadable = |error: std::io::Error| Error::data(format!("the file cannot be read: {error}"));
        let text = std::fs::read_to_string(&self.path).map_err(unreadable);
        let calibration = text.and_then(|text| Calibration::from_json(&text));
        calibration.map_err(|error| error.in_file(&self.path))
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(made_elsewhere())
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(made_elsewhere())
    }
}
