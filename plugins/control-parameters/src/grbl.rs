//! Exporter `grbl`: steps per mm from the linear part of the positioning errors.

use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, PathItem, Result,
    SettingsError, positive,
};
use abbe_volumetric::{Ranges, check_ranges};
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::files::{file, rounded};
use crate::linear::{AXES, Multiplied, commands, motion};

abbe_core::register!(
    Export,
    "grbl",
    "steps per mm of grbl from the linear part of the positioning errors",
    Settings,
    example,
    build,
    "../reference/export-grbl.md",
);

/// Digits of a number that are kept; a number of 32 bits has little more than seven.
const DIGITS: i32 = 8;

/// Settings of the steps.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// What the control has at present.
    existing: Existing,
    /// Largest change of the steps per mm.
    #[serde(default = "one")]
    largest_change_percent: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    axes: Ranges,
}

/// Settings of the control while the machine was measured.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Existing {
    /// `$100`, `$101` and `$102`: steps per mm of X, Y and Z.
    steps_per_mm: StepsPerMm,
}

/// Steps per mm by axis.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct StepsPerMm {
    /// `$100`.
    #[serde(rename = "X")]
    x: f64,
    /// `$101`.
    #[serde(rename = "Y")]
    y: f64,
    /// `$102`.
    #[serde(rename = "Z")]
    z: f64,
}

fn one() -> f64 {
    1.0
}

fn example() -> Value {
    json!({ "existing": { "steps_per_mm": { "X": 80, "Y": 80, "Z": 400 } } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    let path = ["existing", "steps_per_mm"].map(|key| PathItem::Key(key.to_owned()));
    for (name, steps) in AXES.iter().zip(settings.present()) {
        positive(name, steps).map_err(|error| error.under(path.clone()))?;
    }
    positive("largest_change_percent", settings.largest_change_percent)?;
    check_ranges(&settings.axes, "axes")?;
    Ok(Box::new(Grbl { settings }))
}

impl Settings {
    fn present(&self) -> [f64; 3] {
        let StepsPerMm { x, y, z } = self.existing.steps_per_mm;
        [x, y, z]
    }
}

struct Grbl {
    settings: Settings,
}

impl Grbl {
    /// New steps per mm, as they are written.
    fn steps(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<[f64; 3]> {
        let motion = motion(calibration, model, &self.settings.axes)?;
        let mut steps = self.settings.present();
        for (index, steps) in steps.iter_mut().enumerate() {
            let factor = 1.0 / motion[(index, index)];
            let most = self.settings.largest_change_percent;
            let change = (factor - 1.0).abs() * 100.0;
            if change > most {
                let message = format!(
                    "the steps per mm of {} would change by {change:.6} %; at most {most} % are allowed",
                    AXES[index]
                );
                return Err(Error::data(message)
                    .help("is the calibration that of this machine? else allow more")
                    .setting("largest_change_percent"));
            }
            let new = *steps * factor;
            *steps = rounded(new, DIGITS - 1 - new.log10().floor() as i32);
        }
        Ok(steps)
    }
}

impl Export for Grbl {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let steps = self.steps(calibration, model)?;
        let lines = steps.iter().zip(100..).map(|(steps, number)| format!("${number}={steps}\n"));
        Ok(vec![file("grbl-settings.txt", lines.collect())])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let new = Vector3::from(self.steps(calibration, model)?);
        let by = Matrix3::from_diagonal(&new.component_div(&Vector3::from(self.settings.present())));
        Ok(Some(Box::new(Multiplied { columns: commands(model)?, width: model.info().status.len(), by })))
    }
}
