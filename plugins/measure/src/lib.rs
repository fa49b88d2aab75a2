//! Exporter `measure`: the program that measures a plan, written again from the table of its touches.

use std::path::PathBuf;

use abbe_core::{
    Calibration, Context, Export, ExportedFile, InputFile, KinematicModel, PathItem, Result, SettingsError,
};
use abbe_measuring::{Measuring, Touches};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

abbe_core::register!(
    Export,
    "measure",
    "the program that measures a plan with a touch probe, for five controls, checked against collisions",
    Settings,
    example,
    build,
    "../reference/export-measure.md",
);

/// Settings of the program.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// CSV file of the planned touches, as `abbe plan` writes it: touch, feature, positions of all axes, nx, ny, nz.
    touches: String,
    /// Control, probe, clearance and feeds: the same as `plan: program:` of a recipe.
    program: Measuring,
}

fn example() -> Value {
    json!({
        "touches": "plan.csv",
        "program": {
            "control": "linuxcnc",
            "probe": [{ "diameter_mm": 4, "length_mm": 50 }, { "diameter_mm": 60, "length_mm": 100 }],
            "clearance": { "plane": { "axis": "Z", "at_mm": 200 } },
        },
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.program.check().map_err(|error| error.under([PathItem::Key("program".to_owned())]))?;
    Ok(Box::new(Measure { touches: context.path(&settings.touches), program: settings.program }))
}

struct Measure {
    touches: PathBuf,
    program: Measuring,
}

impl Export for Measure {
    fn inputs(&self) -> Vec<InputFile> {
        vec![InputFile { setting: "touches", path: self.touches.clone() }]
    }

    fn export(&self, _: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let touches = Touches::of_table(&abbe_table::read(&self.touches)?, model)?;
        let written = self.program.files(&touches, &[], model).map_err(|mut error| {
            error.setting.insert(0, PathItem::Key("program".to_owned()));
            error
        })?;
        Ok(written.files)
    }
}
