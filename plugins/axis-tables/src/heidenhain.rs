//! Exporter `heidenhain-tables`: nonlinear axis-error compensation of Heidenhain (`.COM`, `.CMA`).

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_compensation::AxisTable;
use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, InputFile, KinematicModel, Result,
    SettingsError,
};
use abbe_volumetric::{position_unit, rounded_position, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::heidenhain_file;
use crate::tables::{Limits, Made, Pairs, Tables, Values, axis_of, rounded};

abbe_core::register!(
    Export,
    "heidenhain-tables",
    "nonlinear axis-error compensation of Heidenhain (.COM, .CMA)",
    Settings,
    example,
    build,
    "../reference/export-heidenhain-tables.md",
);

/// Settings of the tables.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Which tables, and their points. Cross compensation is written for the pairs under `cross` only.
    #[serde(default)]
    tables: Tables,
    /// How points are written.
    #[serde(default)]
    form: Form,
    /// What the control does with a value. Manuals do not say it: try one known value on the control first.
    values: Values,
    /// Most points of a file.
    #[serde(default = "most")]
    most_points: usize,
    /// `.COM` files by the axis that moves, active when the machine was measured: the new values are added at their points.
    #[serde(default)]
    existing: BTreeMap<String, String>,
}

/// How points are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Form {
    /// Columns `AXISPOS` and `BACKLASH`: TNC 640, TNC 620, MANUALplus 620.
    #[default]
    AxisPositions,
    /// First point and distance in the first line, the same in both directions of travel: iTNC 530.
    DatumAndDistance,
    /// The same, with distances of a power of two of 0.1 µm: TNC 407, TNC 415, TNC 425.
    PowerOfTwo,
}

pub fn most() -> usize {
    256
}

/// Decimals of positions and values, mm and degrees.
pub const DECIMALS: i32 = 4;

fn example() -> Value {
    json!({ "tables": { "step_mm": 25, "cross": [{ "correct": "Z", "along": "Y" }] }, "values": "subtracted" })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.tables.check()?;
    if settings.most_points < 2 {
        return Err(SettingsError::new("most_points", "at least 2 was expected"));
    }
    let existing = settings.existing.iter().map(|(axis, path)| (axis.clone(), context.path(path))).collect();
    Ok(Box::new(Heidenhain { settings, existing }))
}

struct Heidenhain {
    settings: Settings,
    existing: BTreeMap<String, PathBuf>,
}

impl Export for Heidenhain {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.values().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let made = self.made(calibration, model)?;
        let name = |axis: usize| model.info().axes[axis].name.as_str();
        // In the order of names, moving axes and columns.
        let mut by_input: BTreeMap<&str, Vec<&AxisTable>> = BTreeMap::new();
        made.tables.iter().for_each(|table| by_input.entry(name(table.input)).or_default().push(table));
        let mut files = Vec::new();
        for (input, tables) in &mut by_input {
            tables.sort_by_key(|table| name(table.output));
            files.push(file(&self.name(input), self.table(input, tables, model)?));
        }
        files.push(file("CONFIG.CMA", self.assignment(by_input.into_keys())));
        files.push(file(
            "heidenhain-tables.txt",
            format!("{}{NOTES}{}\n", self.settings.values.warning(), made.notes.join("\n")),
        ));
        Ok(files)
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        // What cannot be written corrects nothing.
        self.export(calibration, model)?;
        self.made(calibration, model)?.correction(model)
    }
}

pub fn file(name: &str, text: String) -> ExportedFile {
    ExportedFile { name: name.to_owned(), content: text.into_bytes() }
}

impl Heidenhain {
    fn made(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Made> {
        let mut existing = Vec::new();
        for (name, path) in &self.existing {
            let input = axis_of(model, name).map_err(|error| within(error, &["existing", name]))?;
            let found = heidenhain_file::read(path, input, model, &self.settings.tables.believed())?;
            existing.extend(found.into_iter().map(|table| self.settings.values.turned(table)));
        }
        let limits =
            Limits { points: self.settings.most_points, decimals: DECIMALS, cross: Pairs::Asked, same_points: true };
        self.settings.tables.made(calibration, model, &limits, existing)
    }

    fn name(&self, input: &str) -> String {
        let between = if self.settings.form == Form::AxisPositions { '_' } else { '-' };
        format!("AXIS{between}{input}.COM")
    }

    /// The file of all axes that are corrected along one.
    fn table(&self, input: &str, tables: &[&AxisTable], model: &dyn KinematicModel) -> Result<String> {
        let axes = &model.info().axes;
        let tables: Vec<AxisTable> = tables.iter().map(|table| self.settings.values.turned((*table).clone())).collect();
        let Some(first) = tables.first() else { return Ok(String::new()) };
        let places = self.places(first, model)?;
        let column = |table: &AxisTable, values: &[f64]| -> Vec<f64> {
            let factor = position_unit(&axes[table.output]).1;
            values.iter().map(|value| rounded(value * factor, DECIMALS)).collect()
        };
        let mut columns = Vec::new();
        if self.settings.form == Form::AxisPositions {
            columns.push(("AXISPOS", places.clone()));
        }
        if let Some(own) = tables.iter().find(|table| table.output == table.input && !table.is_same_both_ways()) {
            if self.settings.form != Form::AxisPositions {
                let message = format!("the correction of {input} depends on the direction of travel");
                return Err(Error::data(message).help("`axis-positions` can do that").setting("form"));
            }
            columns.push(("BACKLASH", column(own, &own.reverse)));
        }
        columns.extend(tables.iter().map(|table| (axes[table.output].name.as_str(), column(table, &table.forward))));
        let names: Vec<String> = columns.iter().map(|(name, _)| (*name).to_owned()).collect();
        let row = |point: usize| {
            let cells: Vec<String> = columns.iter().map(|(_, values)| format!("{:+.4}", values[point])).collect();
            line(&point.to_string(), &cells)
        };
        let rows: String = (0..places.len()).map(row).collect();
        Ok(format!("{}{}{rows}[END]\n", self.begin(input, &places), line("NR", &names)))
    }

    /// The first line of a file.
    fn begin(&self, input: &str, places: &[f64]) -> String {
        let name = self.name(input);
        match (self.settings.form, places) {
            (Form::DatumAndDistance | Form::PowerOfTwo, [first, second, ..]) => {
                format!("BEGIN {name} DATUM:{first:+.4} DISTANCE:{:+.4}\n", second - first)
            }
            _ => format!("BEGIN {name} MM\n"),
        }
    }

    /// The points of a file in mm or degrees, where they can be written.
    fn places(&self, table: &AxisTable, model: &dyn KinematicModel) -> Result<Vec<f64>> {
        let axis = &model.info().axes[table.input];
        let (unit, factor) = position_unit(axis);
        let name = &axis.name;
        let places: Vec<f64> = table.positions.iter().map(|place| rounded_position(place * factor)).collect();
        let refused = |message: String, setting: &str| Err(within(Error::usage(message).setting(setting), &["tables"]));
        let step = if unit == "mm" { "step_mm" } else { "step_deg" };
        if places.iter().any(|place| (place - rounded(*place, DECIMALS)).abs() > 1e-9) {
            return refused(format!("points of {name} need more than four decimals"), step);
        }
        let steps: Vec<i64> =
            places.windows(2).map(|pair| ((pair[1] - pair[0]) * 10_f64.powi(DECIMALS)).round() as i64).collect();
        let first = steps.first().copied().unwrap_or_default();
        if self.settings.form != Form::AxisPositions && steps.iter().any(|step| *step != first) {
            return refused(format!("points of {name} need equal distances"), step);
        }
        if self.settings.form == Form::PowerOfTwo && !u64::try_from(first).is_ok_and(u64::is_power_of_two) {
            let message = format!("a distance of a power of two of 0.0001 {unit} was expected for {name}: 26.2144");
            return refused(message, step);
        }
        let is_turn = unit == "deg" && self.settings.form != Form::AxisPositions;
        if is_turn && places.iter().any(|place| !(0.0..=360.0).contains(place)) {
            return refused(format!("points of {name} from 0 to 360 deg were expected"), "ranges");
        }
        if table.repeats && !is_turn {
            let message = format!("{name} turns without an end; whether such a table repeats itself is not documented");
            return refused(message, "positioning");
        }
        Ok(places)
    }

    /// One active line that names the file of each axis.
    fn assignment<'a>(&self, inputs: impl Iterator<Item = &'a str>) -> String {
        let (names, files): (Vec<String>, Vec<String>) = inputs.map(|axis| (axis.to_owned(), self.name(axis))).unzip();
        assignment(&names, &files)
    }
}

/// `CONFIG.CMA`: one active line that names the file of each axis.
pub fn assignment(axes: &[String], files: &[String]) -> String {
    let row = |first: &str, active: &str, cells: &[String]| line(first, &[&[active.to_owned()], cells].concat());
    format!("BEGIN CONFIG.CMA\n{}{}[END]\n", row("NR", "ACTIVE", axes), row("0", "*", files))
}

/// What has no source in the layout of files.
pub const NOTES: &str = "\
CONFIG.CMA names the files of these axes only: add those of axes that the control had and that stand nowhere here.
Beyond the first and the last point nothing is documented: stay between them.
The layout of CONFIG.CMA is not documented in full: compare it with one that the control wrote.
";

/// A line of columns of equal width.
pub fn line(first: &str, cells: &[String]) -> String {
    let cells: String = cells.iter().map(|cell| format!(" {cell:<15}")).collect();
    format!("{first:<7}{}\n", cells.trim_end())
}
