//! Exporter `set-points`: the commands with which the calibrated machine follows a path as the nominal one would.

use std::path::PathBuf;

use abbe_compensation::{CompensatedPath, Settings as Correction};
use abbe_core::{
    Calibration, Context, Export, ExportedFile, InputFile, KinematicModel, PathItem, Result, SettingsError,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

abbe_core::register!(
    Export,
    "set-points",
    "corrected set-points of a path, and the errors that are left",
    Settings,
    example,
    build,
    "../reference/export-set-points.md",
);

/// Settings of the path.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file with the set-points, one a row: a column for every axis (`X_mm`, `B_deg`) and for all that its errors depend on.
    path: String,
    /// What is corrected, how, and how far.
    #[serde(default)]
    correction: Option<Correction>,
}

fn example() -> Value {
    json!({ "path": "data/set-points.csv", "correction": { "correct": "five-axes", "largest_rotary_correction_mrad": 20 } })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    let correction = settings.correction.unwrap_or_default();
    correction.check().map_err(|error| error.under([PathItem::Key("correction".to_owned())]))?;
    Ok(Box::new(SetPoints { path: context.path(&settings.path), correction }))
}

struct SetPoints {
    path: PathBuf,
    correction: Correction,
}

impl Export for SetPoints {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "path", path: self.path.clone() }]
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let found = CompensatedPath::new(model, calibration, &self.path, &self.correction);
        let path = found.map_err(|mut error| {
            if !error.setting.is_empty() {
                error.setting.insert(0, PathItem::Key("correction".to_owned()));
            }
            error
        })?;
        let files = [("set-points.csv", path.set_points_text(model)?), ("errors.csv", path.errors_text(model))];
        Ok(files.map(|(name, text)| ExportedFile { name: name.to_owned(), content: text.into_bytes() }).into())
    }
}
