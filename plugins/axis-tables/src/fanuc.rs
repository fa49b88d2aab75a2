//! Exporter `fanuc-pitch`: stored pitch error compensation of Fanuc, as parameter text.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_compensation::AxisTable;
use abbe_core::{
    AxisKind, Calibration, CommandCorrection, Context, Error, Export, ExportedFile, InputFile, KinematicModel, Result,
    SettingsError, positive,
};
use abbe_volumetric::{places, position_unit, rounded_position, within};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::fanuc_file::{self, InFile, Places};
use crate::fanuc_points::Points;
use crate::tables::{Limits, Made, Pairs, Tables, Values, axis_of, key};

abbe_core::register!(
    Export,
    "fanuc-pitch",
    "stored pitch error compensation of Fanuc, in both directions of travel",
    Settings,
    example,
    build,
    "../reference/export-fanuc-pitch.md",
);

/// Settings of the compensation.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// Which axes, and their points. There is no cross compensation.
    #[serde(default)]
    tables: Tables,
    /// Numbers of controlled axes by the names of the machine description: `{ X: 1 }`.
    axis_numbers: BTreeMap<String, u16>,
    /// What the control does with a value. Manuals do not say it: try one known value on the control first.
    values: Values,
    /// Where the reference points are: `{ X_mm: 0 }`. Default: zero. Each has to be a point of its table.
    #[serde(default)]
    reference_points: BTreeMap<String, f64>,
    /// Axes whose reference return ends with a move in negative direction.
    #[serde(default)]
    negative_return: Vec<String>,
    /// Detection unit of linear axes.
    #[serde(default = "one")]
    detection_unit_um: f64,
    /// Detection unit of rotary axes, in 0.001 degrees.
    #[serde(default = "one")]
    detection_unit_mdeg: f64,
    /// Magnification of values (parameter 3623).
    #[serde(default = "once")]
    magnification: u8,
    /// Largest value of a point: 7; 127 in some controls. Compare the manual of the control.
    #[serde(default = "seven")]
    largest_value: u8,
    /// Number of the first point that is used.
    #[serde(default)]
    first_point: u16,
    /// Number of the last point of the control.
    #[serde(default = "last_point")]
    last_point: u16,
    /// Most points of an axis.
    #[serde(default = "most_points")]
    most_points: usize,
    /// Parameter text that was active when the machine was measured: the new values are added at its points.
    #[serde(default)]
    existing: Option<String>,
}

fn one() -> f64 {
    1.0
}

fn once() -> u8 {
    1
}

fn seven() -> u8 {
    7
}

fn last_point() -> u16 {
    1023
}

fn most_points() -> usize {
    128
}

/// Decimals of corrections before they become whole numbers of units, mm and degrees.
const DECIMALS: i32 = 6;

/// No control has more points.
const LAST_POINT: u16 = 9999;

/// The largest value of a word (parameter 3627).
const LARGEST_AT_REFERENCE: i64 = 32_767;

fn example() -> Value {
    json!({
        "tables": { "step_mm": 50 },
        "axis_numbers": { "X": 1, "Y": 2, "Z": 3 },
        "values": "added",
        "largest_value": 127,
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Export>, SettingsError> {
    settings.tables.check()?;
    let wrong = |setting: &str, message: &str| Err(SettingsError::new(setting, message));
    if settings.tables.cross.as_ref().is_some_and(|cross| !cross.is_empty()) {
        return Err(
            SettingsError::new("cross", "this compensation corrects axes along themselves only").under([key("tables")])
        );
    }
    positive("detection_unit_um", settings.detection_unit_um)?;
    positive("detection_unit_mdeg", settings.detection_unit_mdeg)?;
    if !(1..=100).contains(&settings.magnification) {
        return wrong("magnification", "1 to 100 was expected");
    }
    if !(1..=127).contains(&settings.largest_value) {
        return wrong("largest_value", "1 to 127 was expected");
    }
    if settings.most_points < 2 {
        return wrong("most_points", "at least 2 was expected");
    }
    if settings.last_point <= settings.first_point || settings.last_point > LAST_POINT {
        return wrong("last_point", &format!("more than `first_point`, and at most {LAST_POINT}, was expected"));
    }
    if let Some((name, _)) = settings.reference_points.iter().find(|(_, place)| !place.is_finite()) {
        return Err(SettingsError::new(name, "a finite number was expected").under([key("reference_points")]));
    }
    let numbers: Vec<u16> = settings.axis_numbers.values().copied().collect();
    if numbers.contains(&0) || (1..numbers.len()).any(|index| numbers[..index].contains(&numbers[index])) {
        return wrong("axis_numbers", "different axis numbers from 1 were expected");
    }
    let existing = settings.existing.as_ref().map(|path| context.path(path));
    Ok(Box::new(Fanuc { settings, existing }))
}

struct Fanuc {
    settings: Settings,
    existing: Option<PathBuf>,
}

impl Export for Fanuc {
    fn inputs(&self) -> Vec<InputFile> {
        self.existing.iter().map(|path| InputFile { setting: "existing", path: path.clone() }).collect()
    }

    fn export(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<Vec<ExportedFile>> {
        let (made, found) = self.made(calibration, model)?;
        let axes = self.axes(&made, &found, model)?;
        if axes.iter().all(|axis| axis.points.is_zero()) {
            return Err(Error::data("there is nothing to correct: all values are zero in detection units"));
        }
        let numbers: String = axes.iter().map(|axis| format!("{}: {}\n", axis.name, axis.points.note())).collect();
        let notes = format!("{}{NOTES}{}\n{numbers}", self.settings.values.warning(), made.notes.join("\n"));
        let file = |name: &str, text: String| ExportedFile { name: name.to_owned(), content: text.into_bytes() };
        Ok(vec![file("fanuc-pitch.txt", self.text(&axes, &found)), file("fanuc-pitch-notes.txt", notes)])
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

const NOTES: &str = "\
Save all parameters first. Numbers of pitch data (N10000 and following) come from secondary sources: compare them with a \
file that the control wrote.
Points of axes that stand neither here nor in `existing` have to have other numbers.
That 3627 holds against the direction of the reference return, and limits of points and values: compare the manual.
Bits 1 to 7 of parameter 3605 are those of `existing`, else zero: compare them, too.
The values are zero at the reference point, approached as in the reference return. Switch the control off and on, and \
return to the reference points, after loading.
Between two points the control moves by the whole value at once, or little by little; the prediction is linear.
";

/// What is written of one axis.
struct Axis<'a> {
    name: &'a str,
    number: u16,
    /// Interval of points in 0.001 mm or degrees.
    interval: i64,
    points: Points,
}

impl Fanuc {
    /// The axes in the order of their numbers, with numbered points.
    fn axes<'a>(&self, made: &Made, found: &InFile, model: &'a dyn KinematicModel) -> Result<Vec<Axis<'a>>> {
        let places = self.places(model)?;
        let mut tables = Vec::new();
        for table in &made.tables {
            tables.push((self.number(table.output, model)?, table));
        }
        tables.sort_by_key(|(number, _)| *number);
        let mut next = self.settings.first_point;
        let mut axes = Vec::new();
        for (number, table) in tables {
            let name = model.info().axes[table.output].name.as_str();
            let machine = self.settings.values.turned(table.clone());
            let counts = |values: &[f64]| self.counts(values, table.output, model);
            let points = Points::new(
                places.index(table, model)?,
                &[counts(&machine.forward)?, counts(&machine.reverse)?],
                table.repeats,
                places.returns_negative(table.output),
                next,
            );
            self.check(&points, name)?;
            if let Some(owner) = found.owner(points.first.min(points.reference), i64::from(points.end()) - 1) {
                let message = format!("points of {name} would overwrite those of axis {owner}");
                let help = "use numbers after them, or name that axis under `axis_numbers`";
                return Err(Error::usage(message).help(help).setting("first_point"));
            }
            next = points.end();
            axes.push(Axis { name, number, interval: self.interval(table, model)?, points });
        }
        Ok(axes)
    }

    /// The tables as whole numbers of units, and what the control has already.
    fn made(&self, calibration: &Calibration, model: &dyn KinematicModel) -> Result<(Made, InFile)> {
        let mut numbered = BTreeMap::new();
        for (name, number) in &self.settings.axis_numbers {
            numbered.insert(*number, axis_of(model, name).map_err(|error| within(error, &["axis_numbers", name]))?);
        }
        let places = self.places(model)?;
        let units = |axis: usize| self.detection_unit(axis, model);
        let mut found = match &self.existing {
            Some(path) => {
                let believed = self.settings.tables.believed();
                fanuc_file::read(path, &numbered, &places, &units, model, &believed)?
            }
            None => InFile::default(),
        };
        let existing = std::mem::take(&mut found.tables).into_iter().map(|table| self.settings.values.turned(table));
        let limits =
            Limits { points: self.settings.most_points, decimals: DECIMALS, cross: Pairs::Asked, same_points: false };
        let made = self.settings.tables.made(calibration, model, &limits, existing.collect())?;
        Ok((made.changed(|table| self.whole(table, &places, model))?, found))
    }

    fn places(&self, model: &dyn KinematicModel) -> Result<Places> {
        let mut negative_return = Vec::new();
        for name in &self.settings.negative_return {
            negative_return.push(axis_of(model, name).map_err(|error| within(error, &["negative_return"]))?);
        }
        let reference = places(&self.settings.reference_points, "reference_points", model)?;
        Ok(Places { reference, negative_return })
    }

    /// Detection unit of an axis, mm or rad.
    fn detection_unit(&self, axis: usize, model: &dyn KinematicModel) -> f64 {
        match model.info().axes[axis].kind {
            AxisKind::Linear => self.settings.detection_unit_um * 1e-3,
            AxisKind::Rotary => (self.settings.detection_unit_mdeg * 1e-3).to_radians(),
        }
    }

    /// What one count of a value is, mm or rad.
    fn unit(&self, axis: usize, model: &dyn KinematicModel) -> f64 {
        self.detection_unit(axis, model) * f64::from(self.settings.magnification)
    }

    /// The table in whole units, zero at the reference point where the reference return ends.
    fn whole(&self, table: &AxisTable, places: &Places, model: &dyn KinematicModel) -> Result<AxisTable> {
        let unit = self.unit(table.output, model);
        let reference = places.index(table, model)?;
        let returning = if places.returns_negative(table.output) { &table.reverse } else { &table.forward };
        let zero = returning.get(reference).copied().unwrap_or_default();
        let mut whole = table.clone().map(|value| ((value - zero) / unit).round() * unit + 0.0);
        for values in [&mut whole.forward, &mut whole.reverse] {
            if let ([first, .., last], true) = (values.as_mut_slice(), table.repeats) {
                *last = *first;
            }
        }
        Ok(whole)
    }

    /// Values as counts of the unit.
    fn counts(&self, values: &[f64], axis: usize, model: &dyn KinematicModel) -> Result<Vec<i64>> {
        let unit = self.unit(axis, model);
        if values.iter().any(|value| (value / unit - (value / unit).round()).abs() > 1e-3) {
            let name = &model.info().axes[axis].name;
            let message =
                format!("active values of {name} are no multiples of the detection unit times `magnification`");
            return Err(Error::data(message).setting("magnification"));
        }
        Ok(values.iter().map(|value| (value / unit).round() as i64).collect())
    }

    fn check(&self, points: &Points, name: &str) -> Result<()> {
        let (largest, most) = (points.largest(), i64::from(self.settings.largest_value));
        if largest > most {
            let fits = (largest * i64::from(self.settings.magnification) + most - 1) / most;
            let message = format!("a value of {name} is {largest} between two points; at most {most} are allowed");
            let help = match points.has_directions() {
                true => "a smaller step fits".to_owned(),
                false => format!("a magnification of {fits} or a smaller step fits"),
            };
            return Err(Error::usage(message).help(help).setting("largest_value"));
        }
        if points.has_directions() && self.settings.magnification != 1 {
            let message = format!(
                "the correction of {name} depends on the direction of travel; whether parameter 3627 is magnified is not documented"
            );
            return Err(Error::usage(message).help("1 fits, with a smaller step").setting("magnification"));
        }
        if points.at_reference.abs() > LARGEST_AT_REFERENCE {
            let message = format!("the reversal of {name} is {} detection units", points.at_reference);
            let help = format!("parameter 3627 takes at most {LARGEST_AT_REFERENCE}: is the calibration right?");
            return Err(Error::data(message).help(help));
        }
        let last = points.end().saturating_sub(1);
        if last > self.settings.last_point {
            let message =
                format!("points up to {last} are needed for {name}; the last one is {}", self.settings.last_point);
            return Err(Error::usage(message).help("a larger step fits").setting("last_point"));
        }
        Ok(())
    }

    fn number(&self, axis: usize, model: &dyn KinematicModel) -> Result<u16> {
        let name = &model.info().axes[axis].name;
        self.settings.axis_numbers.get(name).copied().ok_or_else(|| {
            let error = Error::usage(format!("the axis number of {name} is missing"));
            error.help(format!("write `axis_numbers: {{ {name}: 1 }}`")).setting("axis_numbers")
        })
    }

    /// The interval of points in 0.001 mm or degrees.
    fn interval(&self, table: &AxisTable, model: &dyn KinematicModel) -> Result<i64> {
        let axis = &model.info().axes[table.input];
        let (unit, factor) = position_unit(axis);
        let [first, second] = [0, 1].map(|index| table.positions.get(index).copied().unwrap_or_default() * factor);
        let interval = rounded_position(second - first) * 1e3;
        if (interval - interval.round()).abs() > 1e-5 {
            let message = format!("points of {} need a distance of whole 0.001 {unit}", axis.name);
            let setting = if unit == "mm" { "step_mm" } else { "step_deg" };
            return Err(within(Error::usage(message).setting(setting), &["tables"]));
        }
        Ok(interval.round() as i64)
    }

    fn text(&self, axes: &[Axis<'_>], found: &InFile) -> String {
        let parameter = |number: u16, value: &dyn Fn(&Axis<'_>) -> i64| {
            let values: String = axes.iter().map(|axis| format!("A{}P{}", axis.number, value(axis))).collect();
            format!("N{number:05}{values}\n")
        };
        let bits = |axis: &Axis<'_>| found.bits(axis.number, axis.points.has_directions());
        let bits: String = axes.iter().map(|axis| format!("A{}P{}", axis.number, bits(axis))).collect();
        let mut text = format!("%\nN03605{bits}\n");
        text += &parameter(3620, &|axis| axis.points.reference);
        text += &parameter(3621, &|axis| axis.points.first);
        text += &parameter(3622, &|axis| axis.points.last());
        text += &parameter(3623, &|_| i64::from(self.settings.magnification));
        text += &parameter(3624, &|axis| axis.interval);
        text += &parameter(3625, &|axis| if axis.points.is_turn { 360_000 } else { 0 });
        text += &parameter(3626, &|axis| axis.points.first_negative);
        text += &parameter(3627, &|axis| axis.points.at_reference);
        for (number, value) in axes.iter().flat_map(|axis| axis.points.values()) {
            text += &format!("N{:05}P{value}\n", 10_000 + number);
        }
        text + "%\n"
    }
}
