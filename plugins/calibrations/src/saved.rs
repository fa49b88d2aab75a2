//! Estimator plugin `calibration`: the calibration of another run, with its covariance, its inputs and its model.

use std::path::PathBuf;

use abbe_core::{
    Calibration, Context, Error, Estimate, EstimateSource, Identifiability, InputFile, Problem, Result, SettingsError,
};
use abbe_files::{LARGEST_RESULT, read_text};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

abbe_core::register!(
    Estimate,
    "calibration",
    "recalls the calibration of another run: values, covariance, inputs and machine",
    Settings,
    example,
    build,
    "../reference/estimate-calibration.md",
    EstimateSource::Calibration,
);

/// Settings of a saved calibration.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The file `<estimate>.calibration.json` that a run wrote.
    path: String,
}

fn example() -> Value {
    json!({ "path": "../monday/fit.calibration.json" })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    Ok(Box::new(SavedCalibration { path: context.path(&settings.path) }))
}

struct SavedCalibration {
    path: PathBuf,
}

/// The error for an attempt to solve it again.
fn made_elsewhere() -> Error {
    Error::usage("this calibration was made elsewhere: its measurements are not here, so that it cannot be made again")
}

impl Estimate for SavedCalibration {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "path", path: self.path.clone() }]
    }

    fn read_calibration(&self) -> Result<Calibration> {
        let unreadable = |error: std::io::Error| Error::data(format!("the file cannot be read: {error}"));
        let text = read_text(&self.path, LARGEST_RESULT).map_err(unreadable);
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
