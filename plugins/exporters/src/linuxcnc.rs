//! Exporter `linuxcnc`: screw compensation files, one an axis, and the lines of the INI file that name them.
//!
//! A file is read by `sscanf("%lf %lf %lf")` line by line up to the first that does not match, so it has neither header nor
//! comment; at most 256 points, positions increasing. LinuxCNC interpolates the trim linearly, adds it to the motor's
//! command and keeps it beyond both ends.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_compensation::active::Believed;
use abbe_compensation::{AxisTable, AxisTables, check_confounded};
use abbe_core::{
    Axis, AxisKind, Calibration, CommandCorrection, Context, Error, ErrorFunction, Export, ExportedFile, InputFile,
    KinematicModel, PathItem, Result, SettingsError,
};
use abbe_volumetric::{Ranges, Steps, check_axes, position_unit, within};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer};
use serde_json::{Value, json};

use crate::sampling::{RANGES, Values, check, fixed, points, status};
use crate::screw_file;

abbe_core::register!(
    Export,
    "linuxcnc",
    "screw compensation files of LinuxCNC from the positioning errors",
    Settings,
    example,
    build,
    "../reference/export-linuxcnc.md",
);

/// Settings of the compensation files.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Distance of points along linear axes.
    #[serde(default = "default_step_mm")]
    step_mm: f64,
    /// Distance of points along rotary axes.
    #[serde(default = "default_step_deg")]
    step_deg: f64,
    /// `COMP_FILE_TYPE`: 0 writes the positions that are really reached, 1 the trims that correct them.
    #[serde(default, rename = "type")]
    kind: FileType,
    /// The axes to compensate. Default: all that have a positioning error, except spindles.
    #[serde(default)]
    axes: Option<Vec<String>>,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    ranges: Ranges,
    /// Files by axis, of the same `type`, that were active when the machine was measured: the new trims are added at their points.
    #[serde(default)]
    existing: BTreeMap<String, String>,
    /// Largest trim of a linear axis that is believed.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_mm: f64,
    /// Largest trim of a rotary axis that is believed.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_deg: f64,
}

fn one() -> f64 {
    1.0
}

/// What the columns of the file are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum FileType {
    /// Actual positions.
    #[default]
    Positions,
    /// Trims.
    Trims,
}

impl<'de> Deserialize<'de> for FileType {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Value::deserialize(deserializer)?.as_u64() {
            Some(0) => Ok(Self::Positions),
            Some(1) => Ok(Self::Trims),
            _ => Err(serde::de::Error::custom("0 (actual positions) or 1 (trims) was expected")),
        }
    }
}

impl JsonSchema for FileType {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "FileType".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "enum": [0, 1] })
    }
}

fn default_step_mm() -> f64 {
    20.0
}

fn default_step_deg() -> f64 {
    10.0
}

/// Most points of a file, `EMCMOT_COMP_SIZE`.
const MOST: usize = 256;

fn example() -> Value {
    json!({ "step_mm": 20, "step_deg": 10, "type": 0, "axes": ["X", "Y"] })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    check(&settings.ranges, settings.steps())?;
    if settings.axes.as_ref().is_some_and(Vec::is_empty) {
        return Err(SettingsError::new("axes", "at least one axis was expected"));
    }
    let existing = settings.existing.iter().map(|(axis, path)| (axis.clone(), context.path(path))).collect();
    Ok(Box::new(LinuxCnc { settings, existing }))
}

impl Settings {
    fn steps(&self) -> Steps {
        Steps { mm: self.step_mm, deg: self.step_deg }
    }
}

struct LinuxCnc {
    settings: Settings,
    existing: BTreeMap<String, PathBuf>,
}

/// The trims of an axis, mm or degrees.
struct Trims {
    axis: usize,
    positions: Vec<f64>,
    /// What the control has already: forward and reverse.
    before: [Vec<f64>; 2],
    /// What it gets.
    after: [Vec<f64>; 2],
}

/// The errors of an axis that move it along (or about) its own direction, each with its component in this direction.
fn along<'a>(index: usize, axis: &Axis, functions: &'a [ErrorFunction]) -> Vec<(f64, &'a ErrorFunction)> {
    let first = match axis.kind {
        AxisKind::Linear => 0,
        AxisKind::Rotary => 3,
    };
    let own = functions.iter().filter(|function| function.axis == index);
    own.filter_map(|function| {
        let part = axis.direction.get(function.component.checked_sub(first)?)?;
        (part.abs() > 1e-12).then_some((*part, function))
    })
    .collect()
}

impl Export for LinuxCnc {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.values().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let mut files = Vec::new();
        let mut ini = INI_HEADER.to_owned();
        for trims in self.trims(calibration, model)? {
            let axis = &model.info().axes[trims.axis];
            let [forward, reverse] = &trims.after;
            let mut text = String::new();
            for ((point, forward), reverse) in trims.positions.iter().zip(forward).zip(reverse) {
                let [forward, reverse] =
                    [forward, reverse].map(|trim| fixed(self.settings.kind.written(*point, *trim)));
                text.push_str(&format!("{point} {forward} {reverse}\n"));
            }
            let name = format!("{}.comp", axis.name.to_lowercase());
            ini.push_str(&format!(
                "\n# Axis {}: {} points from {} to {} {}; n is the number of its joint.\n[JOINT_n]\nCOMP_FILE = \
                 {name}\nCOMP_FILE_TYPE = {}\n",
                axis.name,
                trims.positions.len(),
                trims.positions.first().copied().unwrap_or_default(),
                trims.positions.last().copied().unwrap_or_default(),
                position_unit(axis).0,
                self.settings.kind as u8
            ));
            files.push(ExportedFile { name, content: text.into_bytes() });
        }
        files.push(ExportedFile { name: "linuxcnc.ini".to_owned(), content: ini.into_bytes() });
        Ok(files)
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        let table = |trims: Trims| {
            let factor = position_unit(&model.info().axes[trims.axis]).1;
            let new = |side: usize| {
                let both = trims.after[side].iter().zip(&trims.before[side]);
                both.map(|(after, before)| (after - before) / factor).collect()
            };
            let positions = trims.positions.iter().map(|position| position / factor).collect();
            let (input, output) = (trims.axis, trims.axis);
            AxisTable { input, output, positions, forward: new(0), reverse: new(1), repeats: false }
        };
        let tables = self.trims(calibration, model)?.into_iter().map(table).collect();
        Ok(Some(Box::new(AxisTables::new(model.info(), tables)?)))
    }
}

impl FileType {
    /// What stands in a file for a trim, with its six decimals; and the trim for what stands there.
    fn written(self, nominal: f64, trim: f64) -> f64 {
        let value = match self {
            Self::Positions => nominal - trim,
            Self::Trims => trim,
        };
        (value * 1e6).round() / 1e6
    }

    fn trim(self, nominal: f64, written: f64) -> f64 {
        match self {
            Self::Positions => nominal - written,
            Self::Trims => written,
        }
    }
}

const INI_HEADER: &str = "\
# Lines for the INI file of LinuxCNC: copy each pair into the section of the joint that drives the axis.
# Positions in the files are in mm and degrees: LINEAR_UNITS = mm, ANGULAR_UNITS = degree.
# BACKLASH of a joint is ignored when COMP_FILE is present; the files contain the reversal.
# Beyond the ends of a file its last correction stays; a rotary axis does not wrap around.
";

impl LinuxCnc {
    /// The trims of all axes, as they stand in the files.
    fn trims(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<Trims>> {
        check_axes(&self.settings.ranges, RANGES, model)?;
        let functions = &model.info().error_functions;
        let values = Values::new(calibration, model);
        let axes = self.axes(model, functions)?;
        self.check_confounded(calibration, model, &axes)?;
        let is_written = |name: &String| axes.iter().any(|&axis| model.info().axes[axis].name == *name);
        if let Some(name) = self.existing.keys().find(|name| !is_written(name)) {
            let error = Error::usage(format!("no file is written for {name}"));
            return Err(within(error, &["existing", name]));
        }
        let of_axis = |index: usize| {
            let axis = &model.info().axes[index];
            let factor = position_unit(axis).1;
            let (positions, before) = match self.existing.get(&axis.name) {
                Some(path) => self.existing(path, axis).map_err(|error| within(error, &["existing", &axis.name]))?,
                None => {
                    let points = points(axis, &self.settings.ranges, self.settings.steps(), MOST)?;
                    let zero = vec![0.0; points.len()];
                    (points, [zero.clone(), zero])
                }
            };
            let after = |direction: f64, before: &[f64]| -> Result<Vec<f64>> {
                let trim = |(point, before): (&f64, &f64)| {
                    let status = status(model, axis, point / factor, direction);
                    let mut error = 0.0;
                    for (part, function) in along(index, axis, functions) {
                        error += part * values.motion_error(model, function, &status)?.0;
                    }
                    // A positive command moves the body by the sense of the axis; the error is that of the body.
                    let trim = before - axis.sense * error * factor;
                    Ok(self.settings.kind.trim(*point, self.settings.kind.written(*point, trim)))
                };
                positions.iter().zip(before).map(trim).collect()
            };
            let after = [after(1.0, &before[0])?, after(-1.0, &before[1])?];
            let (setting, most) = self.believed().largest(axis.kind);
            if let Some(trim) = after.iter().flatten().find(|trim| trim.abs() > most) {
                let unit = position_unit(axis).0;
                let message = format!("a trim of {trim} {unit} of {}, more than {most} {unit}", axis.name);
                return Err(Error::data(message).help("are the errors right? or allow more").setting(setting));
            }
            Ok(Trims { axis: index, positions, before, after })
        };
        axes.iter().map(|&index| of_axis(index)).collect()
    }

    /// What is believed of trims.
    fn believed(&self) -> Believed<'_> {
        Believed::new(self.settings.largest_mm, self.settings.largest_deg, &self.settings.ranges)
    }

    /// Positions of a file, with its trims.
    ///
    /// Fails for trims that are not believed, and for positions on less than half of the axis: another `type`, or another unit.
    fn existing(&self, path: &Path, axis: &Axis) -> Result<(Vec<f64>, [Vec<f64>; 2])> {
        let kind = self.settings.kind;
        let rows = screw_file::read(path, MOST)?;
        let believed = self.believed();
        for (index, row) in rows.iter().enumerate() {
            for written in &row[1..] {
                let help = format!("is `type: {}` that of the file?", kind as u8);
                believed.value(axis.kind, kind.trim(row[0], *written), path, index + 1, &help)?;
            }
        }
        let positions: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        believed.coverage(axis, &positions, path, None)?;
        let trims = |column: usize| rows.iter().map(|row| kind.trim(row[0], row[column])).collect();
        Ok((positions, [trims(1), trims(2)]))
    }

    /// Refuses what no measurement determines, along the axes that are written and in both directions of travel.
    fn check_confounded(&self, calibration: &Calibration, model: &dyn KinematicModel, axes: &[usize]) -> Result<()> {
        let mut statuses = Vec::new();
        for &index in axes {
            let axis = &model.info().axes[index];
            let factor = position_unit(axis).1;
            let points = points(axis, &self.settings.ranges, self.settings.steps(), MOST)?;
            let between = points.windows(2).map(|pair| 0.37 * pair[0] + 0.63 * pair[1]);
            for point in points.iter().copied().chain(between) {
                statuses.extend(status(model, axis, point / factor, 1.0));
                statuses.extend(status(model, axis, point / factor, -1.0));
            }
        }
        check_confounded(model, calibration, &statuses)
    }

    /// The axes to compensate.
    fn axes(&self, model: &dyn KinematicModel, functions: &[ErrorFunction]) -> Result<Vec<usize>> {
        let positions = |index: usize| !along(index, &model.info().axes[index], functions).is_empty();
        let Some(names) = &self.settings.axes else {
            let all = 0..model.info().axes.len();
            let axes: Vec<usize> = all.filter(|&index| !model.info().axes[index].indexed && positions(index)).collect();
            if axes.is_empty() {
                return Err(Error::usage("no axis of the model has a positioning error to compensate")
                    .help("list some under `errors` of the model, e.g. `{ polynomial: [EXX], degrees: [1, 2, 3] }`"));
            }
            return Ok(axes);
        };
        let mut axes = Vec::new();
        for (place, name) in names.iter().enumerate() {
            let found = model.info().axes.iter().position(|axis| axis.name == *name);
            let mut error = match found {
                None => Error::usage(format!("the machine has no axis {name}"))
                    .suggest(name, model.info().axes.iter().map(|axis| axis.name.as_str())),
                Some(index) if axes.contains(&index) => Error::usage(format!("axis {name} is listed twice")),
                Some(index) if positions(index) => {
                    axes.push(index);
                    continue;
                }
                Some(_) => Error::usage(format!("axis {name} has no positioning error in the model")),
            };
            error.setting = vec![PathItem::Key("axes".to_owned()), PathItem::Index(place)];
            return Err(error);
        }
        Ok(axes)
    }
}

#[cfg(test)]
mod tests;
