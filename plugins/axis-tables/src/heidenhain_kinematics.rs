//! Exporter `heidenhain-kinematics`: kinematics table with errors of all axes for KinematicsComp of Heidenhain.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use abbe_compensation::active::Believed;
use abbe_compensation::check_confounded_anywhere;
use abbe_compensation::rigid::{Joint, LETTERS};
use abbe_core::{
    AxisKind, Branch, Calibration, CommandCorrection, Context, Error, Export, ExportedFile, InputFile, KinematicModel,
    Result, SettingsError, positive,
};
use abbe_volumetric::{Ranges, Steps, check_axes, check_ranges, range_of, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::heidenhain::{DECIMALS, NOTES, assignment, file, line, most};
use crate::heidenhain_file::{Columns, Located};
use crate::heidenhain_sequence::{Element, Sequence};
use crate::tables::{Values, axis_of, rounded};

abbe_core::register!(
    Export,
    "heidenhain-kinematics",
    "errors of all axes for KinematicsComp of Heidenhain (kinematics table, .COM)",
    Settings,
    example,
    build,
    "../reference/export-heidenhain-kinematics.md",
);

/// Settings of the kinematics table.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Length of the tool or probe of the machine description, as the tool table of the control has it.
    tool_length_mm: f64,
    /// What the control does with a value in the column of an axis itself. Manuals do not say it: try one known value first.
    values: Values,
    /// Largest distance of points along linear axes.
    #[serde(default = "default_step_mm")]
    step_mm: f64,
    /// Largest distance of points along rotary axes.
    #[serde(default = "default_step_deg")]
    step_deg: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    ranges: Ranges,
    /// Most points of a file.
    #[serde(default = "most")]
    most_points: usize,
    /// `.COM` files by the axis that moves, written by this exporter and active when the machine was measured: the new values are added
    /// at their points.
    #[serde(default)]
    existing: BTreeMap<String, String>,
    /// The kinematics table written by this exporter, where it was active then: its location errors are added.
    existing_kinematics: Option<String>,
    /// Largest length in these files that is believed.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_mm: f64,
    /// Largest angle in these files that is believed.
    #[serde(default = "one")]
    #[schemars(range(min = 0))]
    largest_deg: f64,
}

fn one() -> f64 {
    1.0
}

fn default_step_mm() -> f64 {
    25.0
}

fn default_step_deg() -> f64 {
    5.0
}

fn example() -> Value {
    json!({ "tool_length_mm": 120.0, "values": "subtracted", "step_mm": 25 })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.steps().check()?;
    check_ranges(&settings.ranges, "ranges")?;
    positive("tool_length_mm", settings.tool_length_mm)?;
    if settings.most_points < 2 {
        return Err(SettingsError::new("most_points", "at least 2 was expected"));
    }
    let existing = settings.existing.iter().map(|(axis, path)| (axis.clone(), context.path(path))).collect();
    let located = settings.existing_kinematics.as_ref().map(|path| context.path(path));
    Ok(Box::new(HeidenhainKinematics { settings, existing, located }))
}

impl Settings {
    fn steps(&self) -> Steps {
        Steps { mm: self.step_mm, deg: self.step_deg }
    }

    /// Points of equal distances along an axis, mm or degrees.
    fn points(&self, joint: &Joint, model: &dyn KinematicModel) -> Result<Vec<f64>> {
        let (from, to) = range_of(&model.info().axes[joint.axis], &self.ranges, "ranges")?;
        let (setting, step) =
            if joint.kind == AxisKind::Linear { ("step_mm", self.step_mm) } else { ("step_deg", self.step_deg) };
        let intervals = ((to - from) / step - 1e-9).ceil().max(1.0);
        if intervals.is_nan() || intervals >= self.most_points as f64 {
            let message =
                format!("axis {} has {} points; a table has at most {}", joint.name, intervals + 1.0, self.most_points);
            return Err(Error::usage(message).setting(setting));
        }
        // Up to the end of the range at least.
        let unit = 10_f64.powi(DECIMALS);
        let distance = ((to - from) / intervals * unit - 1e-6).ceil() / unit;
        let start = rounded(from, DECIMALS);
        Ok((0..=intervals as usize).map(|point| rounded(start + point as f64 * distance, DECIMALS)).collect())
    }
}

struct HeidenhainKinematics {
    settings: Settings,
    existing: BTreeMap<String, PathBuf>,
    located: Option<PathBuf>,
}

/// The file with the errors of an axis.
fn table_name(axis: &str) -> String {
    format!("AXIS-{axis}.COM")
}

/// What a column C1 to C6 holds: lengths, then angles.
fn kind_of_column(name: &str) -> AxisKind {
    match (0..3).any(|six| name == column_name(six)) {
        true => AxisKind::Linear,
        false => AxisKind::Rotary,
    }
}

/// Name of the column with an error before the axis.
fn column_name(six: usize) -> String {
    format!("C{}", six + 1)
}

impl HeidenhainKinematics {
    /// The sequence with the new errors, and the active files by joint.
    fn sequence(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<(Sequence, BTreeMap<usize, Columns>)> {
        check_axes(&self.settings.ranges, "ranges", model)?;
        let mut active = BTreeMap::new();
        for (name, path) in &self.existing {
            let axis = axis_of(model, name).map_err(|error| within(error, &["existing", name]))?;
            active.insert(axis, self.active(axis, path, model)?);
        }
        if let Some(axis) = model.info().axes.iter().find(|axis| axis.endless) {
            let message = format!("axis {} turns without an end, and a table of this control has ends", axis.name);
            return Err(Error::usage(message).help("give the axis a range without `endless`, if it does not go beyond"));
        }
        let points = |joint: &Joint| match active.get(&joint.axis) {
            Some(columns) => Ok(columns.positions.clone()),
            None => self.settings.points(joint, model),
        };
        let sequence = Sequence::new(calibration, model, self.settings.tool_length_mm, points)?;
        let joints = &sequence.machine.joints;
        if joints.iter().filter(|joint| joint.kind == AxisKind::Linear).count() != 3 {
            return Err(Error::usage("the control corrects machines with exactly three linear axes X, Y and Z"));
        }
        check_confounded_anywhere(model, calibration, &self.settings.ranges)?;
        let mut by_joint = BTreeMap::new();
        for (axis, columns) in active {
            let joint = joints.iter().position(|joint| joint.axis == axis).ok_or_else(|| {
                let name = &model.info().axes[axis].name;
                let message = format!("axis {name} is not in the kinematics table: it does not move while it measures");
                within(Error::usage(message).setting(name.as_str()), &["existing"])
            })?;
            by_joint.insert(joint, columns);
        }
        Ok((self.located(sequence)?, by_joint))
    }

    /// What is believed of active files.
    fn believed(&self) -> Believed<'_> {
        Believed::new(self.settings.largest_mm, self.settings.largest_deg, &self.settings.ranges)
    }

    /// An active file along an axis, if it is one of those that this exporter writes.
    fn active(&self, index: usize, path: &Path, model: &dyn KinematicModel) -> Result<Columns> {
        let axes = &model.info().axes;
        let (kind, axis) = (axes[index].kind, axes[index].name.as_str());
        let columns = Columns::read(path, &axes[index], axes)?;
        let fails = |message: String| Err(Error::data(message).in_file(path).setting("existing"));
        let unit = 10_f64.powi(DECIMALS);
        let steps: Vec<f64> = columns.positions.windows(2).map(|pair| ((pair[1] - pair[0]) * unit).round()).collect();
        if columns.positions.iter().any(|position| (position - rounded(*position, DECIMALS)).abs() > 1e-9) {
            return fails("positions have more than four decimals".to_owned());
        }
        if steps.iter().any(|step| *step <= 0.0 || *step != steps[0]) {
            return fails("positions have to increase by equal distances".to_owned());
        }
        let known = |name: &str| name == axis || (0..6).any(|six| name == column_name(six));
        if let Some((name, _)) = columns.values.iter().find(|(name, _)| !known(name)) {
            return fails(format!("columns {axis} and C1 to C6 were expected, not `{name}`"));
        }
        let believed = self.believed();
        let is_believed = || {
            for (name, values) in &columns.values {
                let of = if name == axis { kind } else { kind_of_column(name) };
                for (value, line) in values.iter().zip(&columns.lines) {
                    believed.value(of, *value, path, line + 1, "is it a file of this exporter, in mm and degrees?")?;
                }
            }
            believed.coverage(&axes[index], &columns.positions, path, columns.lines.first().map(|line| line + 1))
        };
        is_believed().map_err(|error: Error| error.setting("existing"))?;
        Ok(columns)
    }

    /// The sequence with the location errors of the active table.
    fn located(&self, mut sequence: Sequence) -> Result<Sequence> {
        let Some(path) = &self.located else { return Ok(sequence) };
        let active = Located::read(path, &self.believed())?;
        let name = |element: &Element| sequence.machine.joints[element.place].name.as_str();
        let axes: Vec<&str> = sequence.elements.iter().map(name).collect();
        if active.axes != axes {
            let message = format!("axes in the order {} were expected, not {}", axes.join(" "), active.axes.join(" "));
            return Err(Error::data(message).in_file(path).setting("existing_kinematics"));
        }
        if let Some(other) = active.errors.keys().find(|axis| !axes.contains(&axis.as_str())) {
            let message = format!("location errors of `{other}`, which is no axis");
            return Err(Error::data(message).in_file(path).setting("existing_kinematics"));
        }
        for element in &mut sequence.elements {
            let Some(errors) = active.errors.get(&sequence.machine.joints[element.place].name) else { continue };
            element.present = *errors;
        }
        Ok(sequence)
    }

    /// Columns of the file of an axis: those that are active, with the new values added.
    fn columns(&self, element: &Element, active: Option<&Columns>) -> Vec<(String, Vec<f64>)> {
        let letter = LETTERS[element.letter];
        let sign = if self.settings.values == Values::Added { -1.0 } else { 1.0 };
        let own: Vec<f64> = element.own.iter().map(|error| sign * error).collect();
        let mut new = vec![(letter.to_owned(), own.clone())];
        new.extend((0..6).map(|six| (column_name(six), element.errors.iter().map(|all| all[six]).collect())));
        new.retain(|(_, values): &(String, Vec<f64>)| values.iter().any(|value| *value != 0.0));
        let mut columns = active.map(|active| active.values.clone()).unwrap_or_default();
        for (name, values) in new {
            match columns.iter_mut().find(|(own, _)| *own == name) {
                Some((_, into)) => {
                    into.iter_mut().zip(&values).for_each(|(into, value)| *into = rounded(*into + value, DECIMALS));
                }
                None => columns.push((name, values)),
            }
        }
        columns
    }

    /// The kinematics table. `columns`: those of each element.
    fn description(sequence: &Sequence, columns: &[Vec<(String, Vec<f64>)>]) -> String {
        let mut rows = Rows::default();
        let mut is_base = false;
        for (element, columns) in sequence.elements.iter().zip(columns) {
            let joint = &sequence.machine.joints[element.place];
            if joint.branch == Branch::Workpiece && !std::mem::replace(&mut is_base, true) {
                rows.push("", "MachBase", "", None, "");
            }
            rows.shifts(&element.shift.into());
            let located = |rows: &mut Rows| {
                let all = element.location.iter().zip(&element.present).map(|(new, old)| rounded(new + old, DECIMALS));
                for (six, value) in all.enumerate().filter(|(_, value)| *value != 0.0) {
                    rows.push(&format!("{}0{}", LETTERS[six], joint.name), "Trans", LETTERS[six], Some(value), "");
                }
            };
            if joint.branch == Branch::Workpiece {
                located(&mut rows);
            }
            for six in (0..6).filter(|six| columns.iter().any(|(name, _)| *name == column_name(*six))) {
                let source = format!("{}..{}", joint.name, column_name(six));
                rows.push(&format!("E{}{}", LETTERS[six], joint.name), "Trans", LETTERS[six], None, &source);
            }
            rows.push("", "MachAxis", &joint.name, None, "");
            if joint.branch == Branch::Tool {
                located(&mut rows);
            }
        }
        if !is_base {
            rows.push("", "MachBase", "", None, "");
        }
        rows.shifts(&sequence.to_table.into());
        rows.text()
    }

    fn table(element: &Element, axis: &str, columns: &[(String, Vec<f64>)]) -> String {
        let distance = element.points[1] - element.points[0];
        let names: Vec<String> = columns.iter().map(|(name, _)| name.clone()).collect();
        let row = |point: usize| {
            let cells: Vec<String> = columns.iter().map(|(_, values)| format!("{:+.4}", values[point] + 0.0)).collect();
            line(&point.to_string(), &cells)
        };
        let rows: String = (0..element.points.len()).map(row).collect();
        let begin = format!("BEGIN {} DATUM:{:+.4} DISTANCE:{distance:+.4}\n", table_name(axis), element.points[0]);
        format!("{begin}{}{rows}[END]\n", line("NR", &names))
    }
}

/// Rows of a kinematics table.
#[derive(Default)]
struct Rows(Vec<[String; 5]>);

impl Rows {
    fn push(&mut self, doc: &str, key: &str, axis: &str, coordinate: Option<f64>, source: &str) {
        let coordinate = coordinate.map(|value| format!("{value:+.4}")).unwrap_or_default();
        self.0.push([doc.to_owned(), key.to_owned(), axis.to_owned(), coordinate, source.to_owned()]);
    }

    /// Moves of the origin, mm.
    fn shifts(&mut self, by: &[f64; 3]) {
        for (letter, value) in LETTERS.iter().zip(by).filter(|(_, value)| **value != 0.0) {
            self.push("", "Trans", letter, Some(*value), "");
        }
    }

    /// Columns of fixed width, so that empty cells have their place.
    fn text(&self) -> String {
        let row = |number: &str, cells: &[String; 5]| {
            let [doc, key, axis, coordinate, source] = cells;
            let text = format!("{number:<7} {doc:<15} {key:<10} {axis:<5} {coordinate:<15} {source:<15}");
            format!("{}\n", text.trim_end())
        };
        let mut text = "BEGIN KINEMATICS.TAB MM\n".to_owned();
        text.push_str(&row("NR", &["DOC", "KEY", "AXIS", "COORD", "COMPTAB"].map(str::to_owned)));
        for (number, cells) in self.0.iter().enumerate() {
            text.push_str(&row(&number.to_string(), cells));
        }
        text + "[END]\n"
    }
}

/// What has no source in kinematics tables.
const UNSOURCED: &str = "\
KINEMATICS.TAB describes the machine with its errors, from the reference point of the tool to the table. Take over ToolAxis, CMO,
TOOLFILE and the other lines of the present description. Not said in the manual, and assumed here: a rotation by Trans turns
counterclockwise seen from the positive end of its axis; values of C4 to C6 are in degrees; `X..C2` is column C2 of the file that
CONFIG.CMA names for X. Try one known value of each kind before machining.
";

impl Export for HeidenhainKinematics {
    fn inputs(&self) -> Vec<InputFile> {
        let files = self.existing.values().map(|path| InputFile { setting: "existing", path: path.clone() });
        let located = self.located.iter().map(|path| InputFile { setting: "existing_kinematics", path: path.clone() });
        files.chain(located).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let (sequence, active) = self.sequence(calibration, model)?;
        let columns: Vec<_> =
            (sequence.elements.iter()).map(|element| self.columns(element, active.get(&element.place))).collect();
        let mut files = vec![file("KINEMATICS.TAB", Self::description(&sequence, &columns))];
        let mut assigned = (Vec::new(), Vec::new());
        for (element, columns) in sequence.elements.iter().zip(&columns).filter(|(_, columns)| !columns.is_empty()) {
            let axis = sequence.machine.joints[element.place].name.clone();
            files.push(file(&table_name(&axis), Self::table(element, &axis, columns)));
            assigned.1.push(table_name(&axis));
            assigned.0.push(axis);
        }
        files.push(file("CONFIG.CMA", assignment(&assigned.0, &assigned.1)));
        let mut notes = format!("{}{UNSOURCED}{NOTES}", self.settings.values.warning());
        for element in &sequence.elements {
            let [first, .., last] = element.points[..] else { continue };
            writeln!(notes, "{}: {} points from {first} to {last}", LETTERS[element.letter], element.points.len()).ok();
        }
        files.push(file("heidenhain-kinematics.txt", notes));
        Ok(files)
    }

    fn correction(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
    ) -> Result<Option<Box<dyn CommandCorrection>>> {
        Ok(Some(Box::new(self.sequence(calibration, model)?.0)))
    }
}
