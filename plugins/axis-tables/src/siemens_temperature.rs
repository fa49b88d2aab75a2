//! Exporter `siemens-temperature`: temperature compensation of SINUMERIK.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_compensation::LineSettings;
use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, PathItem, Result,
    SettingsError, positive,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::tables::{Values, key};
use crate::temperature_table::{TemperatureTables, Units, check_points};

abbe_core::register!(
    Export,
    "siemens-temperature",
    "temperature compensation of SINUMERIK: K0 and tan(beta) over temperature",
    Settings,
    example,
    build,
    "../reference/export-siemens-temperature.md",
);

/// Settings of the temperature compensation.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Which axes, and where their lines are taken.
    #[serde(default)]
    lines: LineSettings,
    /// Machine axes by the names of the machine description: `{ X: AX1 }`.
    machine_axes: BTreeMap<String, String>,
    /// Which way a positive compensation value moves the axis.
    values: Values,
    /// Rows of a table over the readings of the calibration.
    #[serde(default = "eleven")]
    points: usize,
    /// MD32760 of the axes: the part of their speed that compensation may add, and the largest tan(beta).
    #[serde(default = "hundredth")]
    velocity_factor: f64,
}

pub fn eleven() -> usize {
    11
}

fn hundredth() -> f64 {
    0.01
}

fn example() -> Value {
    json!({ "machine_axes": { "X": "AX1", "Y": "AX2", "Z": "AX3" }, "values": "subtracted", "points": 11,
        "lines": { "axes": ["X", "Z"], "at": { "Y_mm": 100 }, "reference": { "X_mm": 320 } } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.lines.check().map_err(|error| error.under([key("lines")]))?;
    check_points(settings.points)?;
    positive("velocity_factor", settings.velocity_factor)?;
    let is_name = |name: &str| !name.is_empty() && name.chars().all(|letter| letter.is_ascii_alphanumeric());
    if let Some((axis, name)) = settings.machine_axes.iter().find(|(_, name)| !is_name(name)) {
        let message = format!("`{name}` is no machine axis; one like AX1 was expected");
        return Err(SettingsError::new(axis, message).under([PathItem::Key("machine_axes".to_owned())]));
    }
    Ok(Box::new(Siemens { settings }))
}

struct Siemens {
    settings: Settings,
}

/// The table for the PLC.
const TABLE: &str = "siemens-temperature.csv";

impl Siemens {
    fn tables(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<TemperatureTables> {
        let units = Units {
            headers: ["K0_mm", "tan_beta"],
            factors: [1.0, 1.0],
            decimals: [6, 9],
            steepest: self.settings.velocity_factor,
        };
        let settings = (&self.settings.lines, self.settings.points);
        TemperatureTables::new(calibration, model, settings, (units, self.settings.values))
    }

    fn machine_axis(&self, name: &str) -> Result<&str> {
        let missing = || Error::usage(format!("the machine axis of {name} is missing")).setting("machine_axes");
        self.settings.machine_axes.get(name).map(String::as_str).ok_or_else(missing)
    }

    /// Machine and setting data before the first temperature is known.
    fn data(&self, tables: &TemperatureTables, model: &dyn KinematicModel) -> Result<String> {
        let mut text = String::new();
        for line in tables.lines() {
            let name = self.machine_axis(&model.info().axes[line.axis].name)?;
            let _ = writeln!(text, "$MA_TEMP_COMP_TYPE[{name}]=3");
            let _ = writeln!(text, "$MA_COMP_ADD_VELO_FACTOR[{name}]={}", self.settings.velocity_factor);
            let _ = writeln!(text, "$SA_TEMP_COMP_REF_POSITION[{name}]={}", line.reference);
            let _ = writeln!(text, "$SA_TEMP_COMP_ABS_VALUE[{name}]=0");
            let _ = writeln!(text, "$SA_TEMP_COMP_SLOPE[{name}]=0");
        }
        Ok(text + "M17\n")
    }
}

impl Export for Siemens {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let tables = self.tables(calibration, model)?;
        let notes = "SINUMERIK temperature compensation: the control adds K0 + tan(beta) (P - P0) at the position P.\n\
                     siemens-temperature.ini sets MD32750 (type 3), MD32760, SD43920 (P0), and zeroes SD43900 (K0) and SD43910\n\
                     (tan(beta)), which the PLC then writes. MD32760 limits how fast the axis follows.\n"
            .to_owned()
            + &tables.notes(TABLE, model)?;
        let text = |name: &str, text: String| ExportedFile { name: name.to_owned(), content: text.into_bytes() };
        Ok(vec![
            text("siemens-temperature.ini", self.data(&tables, model)?),
            tables.csv(TABLE, model),
            text("siemens-temperature.txt", notes),
        ])
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let tables = self.tables(calibration, model)?;
        self.data(&tables, model)?;
        Ok(Some(Box::new(tables)))
    }
}
