//! Exporter `siemens-tables`: encoder error and sag compensation of SINUMERIK (EEC, CEC).

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

use crate::siemens_file::{self, Tables as InFile};
use crate::tables::{Limits, Made, Pairs, Tables, axis_of, rounded};

abbe_core::register!(
    Export,
    "siemens-tables",
    "encoder error and sag compensation of SINUMERIK (EEC, CEC)",
    Settings,
    example,
    build,
    "../reference/export-siemens-tables.md",
);

/// Settings of the tables.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Which tables, and their points.
    #[serde(default)]
    tables: Tables,
    /// Machine axes by the names of the machine description: `{ X: AX1 }`.
    machine_axes: BTreeMap<String, String>,
    /// Which tables correct an axis along itself.
    #[serde(default)]
    positioning_by: PositioningBy,
    /// Index of the encoder in `$AA_ENC_COMP`: 0 or 1.
    #[serde(default)]
    encoder: u8,
    /// Which way a positive value of `$AN_CEC` moves the corrected axis.
    #[serde(default)]
    positive_value_moves: Sense,
    /// Index of the first table of `$AN_CEC`.
    #[serde(default)]
    first_table: usize,
    /// Most tables of `$AN_CEC`; 8 in an 828D.
    #[serde(default = "eight")]
    most_tables: usize,
    /// Most points of a table; 200 in an 828D, else MD18342 and MD38000.
    #[serde(default = "two_hundred")]
    most_points: usize,
    /// Files with tables that were active when the machine was measured: the new ones are added to them.
    #[serde(default)]
    existing: Vec<String>,
}

/// Which tables correct an axis along itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum PositioningBy {
    /// `$AN_CEC`, one table for each direction of travel where they differ.
    #[default]
    Cec,
    /// `$AA_ENC_COMP`, the same in both directions.
    Eec,
}

/// A sense of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Sense {
    /// Positive.
    #[default]
    Positive,
    /// Negative.
    Negative,
}

fn eight() -> usize {
    8
}

fn two_hundred() -> usize {
    200
}

/// No control has more tables.
const MOST_INDEX: usize = 10_000;

/// Decimals of values, mm and degrees.
const DECIMALS: i32 = 6;

fn example() -> Value {
    json!({
        "tables": { "step_mm": 25, "cross": [{ "correct": "X", "along": "Y" }] },
        "machine_axes": { "X": "AX1", "Y": "AX2", "Z": "AX3" },
        "most_tables": 24,
        "existing": ["data/cec.ini"],
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.tables.check()?;
    let wrong = |setting: &str, message: &str| Err(SettingsError::new(setting, message));
    if settings.encoder > 1 {
        return wrong("encoder", "0 or 1 was expected");
    }
    if settings.first_table > MOST_INDEX {
        return wrong("first_table", &format!("at most {MOST_INDEX} was expected"));
    }
    if settings.most_points < 2 {
        return wrong("most_points", "at least 2 was expected");
    }
    let is_name = |name: &String| {
        name.starts_with(|first: char| first.is_ascii_alphabetic())
            && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    let names: Vec<&String> = settings.machine_axes.values().collect();
    if !names.iter().all(|name| is_name(name)) {
        return wrong("machine_axes", "names of machine axes (letters, digits) were expected: `AX1`");
    }
    if (1..names.len()).any(|index| names[..index].contains(&names[index])) {
        return wrong("machine_axes", "different machine axes were expected");
    }
    let existing = settings.existing.iter().map(|path| context.path(path)).collect();
    Ok(Box::new(Siemens { settings, existing }))
}

struct Siemens {
    settings: Settings,
    existing: Vec<PathBuf>,
}

impl Export for Siemens {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.iter().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let (made, kept) = self.made(calibration, model)?;
        let by_encoder =
            |table: &&AxisTable| self.settings.positioning_by == PositioningBy::Eec && table.input == table.output;
        let (eec, cec): (Vec<&AxisTable>, Vec<&AxisTable>) = made.tables.iter().partition(by_encoder);
        let eec: Vec<&AxisTable> = kept.encoder.iter().chain(eec).collect();
        let cec: Vec<&AxisTable> = kept.sag.iter().chain(cec).collect();
        let notes: String = made.notes.iter().map(|note| format!("; {note}\n")).collect();
        let mut files = Vec::new();
        if !eec.is_empty() {
            files.push(file("eec.ini", self.eec(&eec, model, &notes)?));
        }
        if !cec.is_empty() {
            files.push(file("cec.ini", self.cec(&cec, model, &notes)?));
        }
        Ok(files)
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        // What cannot be written corrects nothing.
        self.export(calibration, model)?;
        self.made(calibration, model)?.0.correction(model)
    }
}

fn file(name: &str, text: String) -> ExportedFile {
    ExportedFile { name: name.to_owned(), content: text.into_bytes() }
}

impl Siemens {
    /// The tables, and those of the control that stay as they are.
    fn made(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<(Made, InFile)> {
        for name in self.settings.machine_axes.keys() {
            axis_of(model, name).map_err(|error| within(error, &["machine_axes", name]))?;
        }
        let mut known = InFile::default();
        let machine_axis = |name: &str| {
            let found = self.settings.machine_axes.iter().find(|(_, machine)| *machine == name);
            found.and_then(|(axis, _)| axis_of(model, axis).ok())
        };
        for path in &self.existing {
            let believed = self.settings.tables.believed();
            siemens_file::read(path, self.settings.encoder, &machine_axis, model, &believed, &mut known)?;
        }
        known.sag = known.sag.into_iter().map(|table| self.turned(table)).collect();
        known.encoder = known.encoder.into_iter().map(|table| table.map(|value| -value)).collect();
        let (own, cross): (Vec<AxisTable>, Vec<AxisTable>) =
            known.sag.into_iter().partition(|table| table.input == table.output);
        let (existing, kept) = match self.settings.positioning_by {
            PositioningBy::Cec => ([own, cross].concat(), InFile { encoder: known.encoder, ..InFile::default() }),
            PositioningBy::Eec => ([known.encoder, cross].concat(), InFile { sag: own, ..InFile::default() }),
        };
        let limits =
            Limits { points: self.settings.most_points, decimals: DECIMALS, cross: Pairs::All, same_points: false };
        Ok((self.settings.tables.made(calibration, model, &limits, existing)?, kept))
    }

    /// Values of `$AN_CEC` as corrections, and corrections as such values.
    fn turned(&self, table: AxisTable) -> AxisTable {
        match self.settings.positive_value_moves {
            Sense::Positive => table,
            Sense::Negative => table.map(|value| -value),
        }
    }

    fn machine_axis(&self, axis: usize, model: &dyn KinematicModel) -> Result<&str> {
        let name = &model.info().axes[axis].name;
        self.settings.machine_axes.get(name).map(String::as_str).ok_or_else(|| {
            let error = Error::usage(format!("the machine axis of {name} is missing"));
            error.help(format!("write `machine_axes: {{ {name}: AX1 }}`")).setting("machine_axes")
        })
    }

    fn eec(&self, tables: &[&AxisTable], model: &dyn KinematicModel, notes: &str) -> Result<String> {
        let encoder = self.settings.encoder;
        let mut text = format!(
            "%_N_AX_EEC_INI\nCHANDATA(1)\n; Set MD38000 MM_ENC_COMP_MAX_POINTS (it formats the memory) before, and MD32700 \
             ENC_COMP_ENABLE[{encoder}] = 1 after loading.\n; A positive value moves the axis in negative direction.\n{notes}"
        );
        for table in tables {
            let name = self.machine_axis(table.output, model)?;
            if !table.is_same_both_ways() {
                let axis = &model.info().axes[table.output].name;
                let error = Error::data(format!("the correction of {axis} depends on the direction of travel"));
                return Err(error.help("`cec` can do that").setting("positioning_by"));
            }
            let factor = position_unit(&model.info().axes[table.output]).1;
            for (index, value) in table.forward.iter().enumerate() {
                text.push_str(&format!("$AA_ENC_COMP[{encoder},{index},{name}]={}\n", written(-value * factor)));
            }
            for (variable, value) in grid(table, model) {
                text.push_str(&format!("$AA_ENC_COMP_{variable}[{encoder},{name}]={value}\n"));
            }
        }
        Ok(text + "M17\n")
    }

    fn cec(&self, tables: &[&AxisTable], model: &dyn KinematicModel, notes: &str) -> Result<String> {
        let first = self.settings.first_table;
        let mut index = first;
        let mut body = String::new();
        for table in tables {
            let machine = self.turned((*table).clone());
            let both: &[(&[f64], i32)] = match machine.is_same_both_ways() {
                true => &[(&machine.forward, 0)],
                false => &[(&machine.forward, 1), (&machine.reverse, -1)],
            };
            let (input, output) = (self.machine_axis(table.input, model)?, self.machine_axis(table.output, model)?);
            let factor = position_unit(&model.info().axes[table.output]).1;
            for (values, direction) in both {
                for (point, value) in values.iter().enumerate() {
                    body.push_str(&format!("$AN_CEC[{index},{point}]={}\n", written(value * factor)));
                }
                body.push_str(&format!(
                    "$AN_CEC_INPUT_AXIS[{index}]=({input})\n$AN_CEC_OUTPUT_AXIS[{index}]=({output})\n"
                ));
                for (variable, value) in grid(table, model) {
                    body.push_str(&format!("$AN_CEC_{variable}[{index}]={value}\n"));
                }
                body.push_str(&format!("$AN_CEC_DIRECTION[{index}]={direction}\n$AN_CEC_MULT_BY_TABLE[{index}]=0\n"));
                index += 1;
            }
        }
        let most = self.settings.most_tables;
        if index - first > most {
            let error = Error::usage(format!("{} tables are needed; at most {most} fit", index - first));
            return Err(error
                .help("choose some under `tables`, or say how many the control has")
                .setting("most_tables"));
        }
        let (last, points) = (index - 1, tables.iter().map(|table| table.positions.len()).max().unwrap_or_default());
        Ok(format!(
            "%_N_NC_CEC_INI\nCHANDATA(1)\n; Set MD18342 MM_CEC_MAX_POINTS[{first}..{last}] >= {points} (it formats the memory; not in \
             an 828D) before,\n; MD32710 CEC_ENABLE = 1 of the corrected axes and SD41300 CEC_TABLE_ENABLE[{first}..{last}] = 1 after \
             loading.\n; MD32711 CEC_SCALING_SYSTEM_METRIC = 1.\n; The sense of the values has no source but an example: watch an axis \
             before machining.\n{notes}{body}M17\n"
        ))
    }
}

/// The variables that say where the points of a table are.
fn grid(table: &AxisTable, model: &dyn KinematicModel) -> [(&'static str, String); 4] {
    let factor = position_unit(&model.info().axes[table.input]).1;
    let [first, second, last] = [table.positions.first(), table.positions.get(1), table.positions.last()]
        .map(|place| rounded_position(place.copied().unwrap_or_default() * factor));
    [
        ("STEP", rounded_position(second - first).to_string()),
        ("MIN", first.to_string()),
        ("MAX", last.to_string()),
        ("IS_MODULO", u8::from(table.repeats).to_string()),
    ]
}

fn written(value: f64) -> String {
    format!("{:.6}", rounded(value, DECIMALS))
}
