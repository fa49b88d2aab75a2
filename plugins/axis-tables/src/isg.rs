//! Exporter `isg-tables`: compensation lists of ISG and Beckhoff (`kw.ssfk`, `kw.crosscomp`).

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_compensation::AxisTable;
use abbe_core::{
    Calibration, CommandCorrection, Context, Error, Export, ExportedFile, InputFile, KinematicModel, PathItem, Result,
    SettingsError,
};
use abbe_volumetric::{position_unit, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::isg_file;
use crate::tables::{Limits, Made, Pairs, Tables, axis_of};

abbe_core::register!(
    Export,
    "isg-tables",
    "leadscrew and cross compensation lists of ISG and Beckhoff",
    Settings,
    example,
    build,
    "../reference/export-isg-tables.md",
);

/// Settings of the lists.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Which tables, and their points. Cross compensation is written for the pairs under `cross` only, one for each corrected axis.
    #[serde(default)]
    tables: Tables,
    /// Logical axis numbers by the names of the machine description: `{ X: 1 }`.
    axis_numbers: BTreeMap<String, u16>,
    /// Which way a positive value of `kw.crosscomp` moves the corrected axis: needed for cross compensation.
    #[serde(default)]
    positive_crosscomp_moves: Option<Sense>,
    /// Lists by axis that were active when the machine was measured: the new values are added at their points.
    #[serde(default)]
    existing: BTreeMap<String, String>,
}

/// A sense of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Sense {
    /// Positive.
    Positive,
    /// Negative.
    Negative,
}

/// Values are in 0.1 µm and 0.0001 degrees.
const DECIMALS: i32 = 4;

/// Values in files for one mm or degree.
pub const SCALE: f64 = 1e4;

/// Most points of `kw.crosscomp`; `kw.ssfk` has 1500.
const MOST: usize = 1000;

fn example() -> Value {
    json!({
        "tables": { "step_mm": 25, "cross": [{ "correct": "Z", "along": "Y" }] },
        "axis_numbers": { "X": 1, "Y": 2, "Z": 3 },
        "positive_crosscomp_moves": "positive",
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.tables.check()?;
    let numbers: Vec<u16> = settings.axis_numbers.values().copied().collect();
    if (1..numbers.len()).any(|index| numbers[..index].contains(&numbers[index])) {
        return Err(SettingsError::new("axis_numbers", "different axis numbers were expected"));
    }
    let existing = settings.existing.iter().map(|(axis, path)| (axis.clone(), context.path(path))).collect();
    Ok(Box::new(Isg { settings, existing }))
}

struct Isg {
    settings: Settings,
    existing: BTreeMap<String, PathBuf>,
}

impl Export for Isg {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.values().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let made = self.made(calibration, model)?;
        let mut lists: BTreeMap<usize, String> = BTreeMap::new();
        for table in &made.tables {
            let name = &model.info().axes[table.output].name;
            let head =
                || Ok(format!("kopf.log_achs_nr {}\nkopf.log_achs_name {name}\n", self.number(table.output, model)?));
            let before = lists.remove(&table.output).map_or_else(head, Ok::<String, Error>)?;
            let body = if table.input == table.output { screw(table, model) } else { self.cross(table, model)? };
            lists.insert(table.output, before + &body);
        }
        let name = |axis: usize| format!("{}.lis", model.info().axes[axis].name.to_lowercase());
        let text = |(axis, text): (usize, String)| ExportedFile { name: name(axis), content: text.into_bytes() };
        let mut files: Vec<ExportedFile> = lists.into_iter().map(text).collect();
        let notes = format!("{NOTES}{}\n", made.notes.join("\n"));
        files.push(ExportedFile { name: "isg-tables.txt".to_owned(), content: notes.into_bytes() });
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

const NOTES: &str = "\
Set lr_param.ssfk 1 (own axis) and lr_param.crosscomp 1 (cross compensation) in the list of each corrected axis.
Values of kw.ssfk are actual minus setpoint, as in the example of the manual; the sense of kw.crosscomp has no source.
";

impl Isg {
    fn made(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Made> {
        for name in self.settings.axis_numbers.keys() {
            axis_of(model, name).map_err(|error| within(error, &["axis_numbers", name]))?;
        }
        let numbered = |number: u16| {
            let found = self.settings.axis_numbers.iter().find(|(_, own)| **own == number);
            found.and_then(|(name, _)| axis_of(model, name).ok())
        };
        let mut existing = Vec::new();
        for (name, path) in &self.existing {
            let output = axis_of(model, name).map_err(|error| within(error, &["existing", name]))?;
            for table in isg_file::read(path, output, &numbered, model, &self.settings.tables.believed())? {
                existing.push(if table.input == output { table.map(|value| -value) } else { self.turned(table)? });
            }
        }
        let limits = Limits { points: MOST, decimals: DECIMALS, cross: Pairs::Asked, same_points: false };
        let made = self.settings.tables.made(calibration, model, &limits, existing)?;
        let cross: Vec<&AxisTable> = made.tables.iter().filter(|table| table.input != table.output).collect();
        for (index, table) in cross.iter().enumerate() {
            let name = &model.info().axes[table.output].name;
            if cross[..index].iter().any(|other| other.output == table.output) {
                let mut error = Error::usage(format!("a list has one table of `kw.crosscomp`; {name} needs more"));
                let asked = self.settings.tables.cross.as_deref().unwrap_or_default();
                let last = asked.iter().rposition(|pair| pair.correct == *name);
                error.setting = last.map(PathItem::Index).into_iter().collect();
                return Err(within(error, &["tables", "cross"]));
            }
        }
        Ok(made)
    }

    /// Values of `kw.crosscomp` as corrections, and corrections as such values.
    fn turned(&self, table: AxisTable) -> Result<AxisTable> {
        match self.settings.positive_crosscomp_moves {
            Some(Sense::Positive) => Ok(table),
            Some(Sense::Negative) => Ok(table.map(|value| -value)),
            None => Err(Error::usage(
                "the sense of `kw.crosscomp` is not documented: `positive` or `negative` was expected",
            )
            .help("enter one value and watch the axis")
            .setting("positive_crosscomp_moves")),
        }
    }

    fn number(&self, axis: usize, model: &dyn KinematicModel) -> Result<u16> {
        let name = &model.info().axes[axis].name;
        self.settings.axis_numbers.get(name).copied().ok_or_else(|| {
            let error = Error::usage(format!("the axis number of {name} is missing"));
            error.help(format!("write `axis_numbers: {{ {name}: 1 }}`")).setting("axis_numbers")
        })
    }

    fn cross(&self, table: &AxisTable, model: &dyn KinematicModel) -> Result<String> {
        let machine = self.turned(table.clone())?;
        let mut text = format!(
            "kw.crosscomp.unit 1\nkw.crosscomp.last_index {}\nkw.crosscomp.master_ax_nr {}\n",
            table.positions.len() - 1,
            self.number(table.input, model)?
        );
        let (along, of) = factors(table, model);
        for (index, (place, value)) in machine.positions.iter().zip(&machine.forward).enumerate() {
            let [place, value] = [place * along, value * of].map(whole);
            text.push_str(&format!(
                "kw.crosscomp.table[{index}].setpoint {place}\nkw.crosscomp.table[{index}].correction {value}\n"
            ));
        }
        Ok(text)
    }
}

/// Leadscrew compensation: values are actual minus setpoint, so the control subtracts them.
fn screw(table: &AxisTable, model: &dyn KinematicModel) -> String {
    let (along, of) = factors(table, model);
    let first = whole(table.positions.first().copied().unwrap_or_default() * along);
    let mut text = format!(
        "kw.ssfk.interval 0\nkw.ssfk.kw_startpos {first}\nkw.ssfk.kw_nr_max {}\nkw.ssfk.unit 1\nkw.ssfk.bilateral 1\n\
         kw.ssfk.modulo {}\n",
        table.positions.len(),
        u8::from(table.repeats)
    );
    for (index, place) in table.positions.iter().enumerate() {
        let [place, pos, neg] = [place * along, -table.forward[index] * of, -table.reverse[index] * of].map(whole);
        let name = format!("kw.ssfk.table[{index}]");
        text.push_str(&format!("{name}.setpoint {place}\n{name}.pos {pos}\n{name}.neg {neg}\n"));
    }
    text
}

/// What positions and values are multiplied by to become those of files.
fn factors(table: &AxisTable, model: &dyn KinematicModel) -> (f64, f64) {
    let axes = &model.info().axes;
    (position_unit(&axes[table.input]).1 * SCALE, position_unit(&axes[table.output]).1 * SCALE)
}

fn whole(value: f64) -> i64 {
    value.round() as i64
}
