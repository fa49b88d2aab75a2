//! Exporter `isg-temperature`: temperature compensation of ISG and Beckhoff.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use abbe_compensation::{LineSettings, ThermalLine};
use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, KinematicModel, Result, SettingsError,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::siemens_temperature::eleven;
use crate::tables::{Values, key};
use crate::temperature_table::{TemperatureTables, Units, check_points};

abbe_core::register!(
    Export,
    "isg-temperature",
    "temperature compensation of ISG and Beckhoff: offset and coefficient over temperature",
    Settings,
    example,
    build,
    "../reference/export-isg-temperature.md",
);

/// Settings of the temperature compensation.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Which axes, and where their lines are taken.
    #[serde(default)]
    lines: LineSettings,
    /// Axis numbers by the names of the machine description: `{ X: 1 }`.
    axis_numbers: BTreeMap<String, u16>,
    /// Which way a positive compensation value moves the axis.
    values: Values,
    /// Rows of a table over the readings of the calibration.
    #[serde(default = "eleven")]
    points: usize,
    /// Cycles over which the control spreads a change (`temp_comp_n_cycles`).
    #[serde(default)]
    cycles: Option<u32>,
}

fn example() -> Value {
    json!({ "axis_numbers": { "X": 1, "Y": 2, "Z": 3 }, "values": "added", "points": 11, "cycles": 20,
        "lines": { "axes": ["X", "Z"], "at": { "Y_mm": 100 }, "reference": { "X_mm": 320 } } })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.lines.check().map_err(|error| error.under([key("lines")]))?;
    check_points(settings.points)?;
    let numbers: Vec<u16> = settings.axis_numbers.values().copied().collect();
    if (1..numbers.len()).any(|index| numbers[..index].contains(&numbers[index])) {
        return Err(SettingsError::new("axis_numbers", "different axis numbers were expected"));
    }
    if settings.cycles.is_some_and(|cycles| !(1..=1_000_000).contains(&cycles)) {
        return Err(SettingsError::new("cycles", "a whole number from 1 to 1000000 was expected"));
    }
    if numbers.contains(&0) {
        return Err(SettingsError::new("axis_numbers", "axis numbers from 1 were expected"));
    }
    Ok(Box::new(Isg { settings }))
}

struct Isg {
    settings: Settings,
}

/// The table for the PLC.
const TABLE: &str = "isg-temperature.csv";

/// Slopes above this are no temperature compensation, mm/mm.
const STEEPEST: f64 = 0.01;

impl Isg {
    fn tables(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<TemperatureTables> {
        let units = Units {
            headers: ["temp_comp_offset_0", "temp_comp_coefficient"],
            factors: [1e4, 1e6],
            decimals: [0, 3],
            steepest: STEEPEST,
        };
        let settings = (&self.settings.lines, self.settings.points);
        TemperatureTables::new(calibration, model, settings, (units, self.settings.values))
    }

    /// The list of an axis before the first temperature is known.
    fn list(&self, line: &ThermalLine, model: &dyn KinematicModel) -> Result<ExportedFile> {
        let name = &model.info().axes[line.axis].name;
        let missing = || Error::usage(format!("the number of axis {name} is missing")).setting("axis_numbers");
        let number = self.settings.axis_numbers.get(name).ok_or_else(missing)?;
        let mut text = format!("kopf.achs_nr {number}\nlr_param.temp_comp 1\n");
        let _ = writeln!(text, "lr_param.temp_comp_position_0 {}", (line.reference * 1e4).round() + 0.0);
        text += "lr_param.temp_comp_offset_0 0\nlr_param.temp_comp_coefficient 0\n";
        if let Some(cycles) = self.settings.cycles {
            let _ = writeln!(text, "lr_param.temp_comp_n_cycles {cycles}");
        }
        Ok(ExportedFile { name: format!("{}-temperature.lis", name.to_lowercase()), content: text.into_bytes() })
    }
}

impl Export for Isg {
    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let tables = self.tables(calibration, model)?;
        let mut files = tables.lines().iter().map(|line| self.list(line, model)).collect::<Result<Vec<_>>>()?;
        let notes = "Temperature compensation of ISG and Beckhoff: offset_0 + coefficient (position - position_0).\n\
                     The lists switch it on with zeroes; the PLC writes TEMPC::offset_0 (0.1 um) and TEMPC::coefficient (um/m).\n"
            .to_owned()
            + &tables.notes(TABLE, model)?;
        files.push(tables.csv(TABLE, model));
        files.push(ExportedFile { name: "isg-temperature.txt".to_owned(), content: notes.into_bytes() });
        Ok(files)
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let tables = self.tables(calibration, model)?;
        tables.lines().iter().try_for_each(|line| self.list(line, model).map(drop))?;
        Ok(Some(Box::new(tables)))
    }
}
