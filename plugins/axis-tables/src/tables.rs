//! What the exporters of tables share: which tables, at which points, what the control has already, and its limits.

use std::collections::BTreeMap;

use abbe_compensation::active::Believed;
use abbe_compensation::{AxisTable, AxisTables, TableSource};
use abbe_core::{
    Axis, AxisKind, Calibration, CommandCorrection, Error, KinematicModel, PathItem, Result, SettingsError, positive,
};
use abbe_volumetric::{
    Ranges, Steps, check_axes, check_ranges, places, position_unit, range_of, rounded_position, within,
};
use schemars::JsonSchema;
use serde::Deserialize;

/// Which tables are made, and at which points.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tables {
    /// Distance of points along linear axes.
    #[serde(default = "default_step_mm")]
    pub step_mm: f64,
    /// Distance of points along rotary axes.
    #[serde(default = "default_step_deg")]
    pub step_deg: f64,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    pub ranges: Ranges,
    /// Axes whose own positioning error is corrected. Default: all but spindles, rotary ones if the model has such an error of them.
    #[serde(default)]
    pub positioning: Option<Vec<String>>,
    /// Corrections of one axis along another. Default: every linear axis along every other, as far as the control has such tables.
    #[serde(default)]
    pub cross: Option<Vec<Cross>>,
    /// Where the other axes stand: `{ Z_mm: 100 }`. Default: zero, or the middle of the range if zero is outside.
    #[serde(default)]
    pub at: BTreeMap<String, f64>,
    /// Largest correction of the tip, and largest value of a linear axis in tables, that is believed.
    #[serde(default = "one")]
    pub largest_mm: f64,
    /// Largest value of a rotary axis in tables that is believed.
    #[serde(default = "one")]
    pub largest_deg: f64,
    /// Largest change of a correction along its axis, in µm/mm; for rotary axes along themselves mdeg/deg, along others µm/deg.
    #[serde(default = "one")]
    pub largest_slope_um_per_mm: f64,
}

/// A table that corrects one axis along another.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cross {
    /// The linear axis that is corrected.
    pub correct: String,
    /// The axis along which it is corrected.
    pub along: String,
}

impl Default for Tables {
    fn default() -> Self {
        Self {
            step_mm: default_step_mm(),
            step_deg: default_step_deg(),
            ranges: Ranges::new(),
            positioning: None,
            cross: None,
            at: BTreeMap::new(),
            largest_mm: one(),
            largest_deg: one(),
            largest_slope_um_per_mm: one(),
        }
    }
}

fn default_step_mm() -> f64 {
    25.0
}

fn default_step_deg() -> f64 {
    10.0
}

fn one() -> f64 {
    1.0
}

/// What a control takes.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Most points of a table.
    pub points: usize,
    /// Decimals of values in the file, in mm and degrees.
    pub decimals: i32,
    /// Which axes are corrected along others if the settings do not say it.
    pub cross: Pairs,
    /// All tables along an axis stand in one file: they have the same points.
    pub same_points: bool,
}

/// Pairs of linear axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pairs {
    /// Every axis along every other.
    All,
    /// Only pairs that are asked for, with the same values in both directions of travel.
    Asked,
}

/// What a control does with a value, where manuals do not say it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Values {
    /// A positive value moves the axis in positive direction.
    Added,
    /// A positive value is a positive error: it moves the axis in negative direction.
    Subtracted,
}

impl Values {
    /// Values of files as corrections, and corrections as values of files.
    pub fn turned(self, table: AxisTable) -> AxisTable {
        match self {
            Self::Added => table,
            Self::Subtracted => table.map(|value| -value),
        }
    }

    /// The sign of a value that moves an axis in positive direction.
    pub fn sign(self) -> f64 {
        match self {
            Self::Added => 1.0,
            Self::Subtracted => -1.0,
        }
    }

    /// A sentence for those who load the files.
    pub fn warning(self) -> String {
        let (does, way) = match self {
            Self::Added => ("adds", "positive"),
            Self::Subtracted => ("subtracts", "negative"),
        };
        format!(
            "The manuals do not say which way a value moves the axis. These files are right if the control {does} values: \
             a positive value moves the axis in {way} direction.\nTry that with one known value before machining, else turn \
             `values`.\n"
        )
    }
}

/// The tables of a control.
pub struct Made {
    /// As they stand in the file: those of the control already, and the new ones added.
    pub tables: Vec<AxisTable>,
    /// What is new, as it stands in the file.
    new: Vec<AxisTable>,
    /// Lines for a comment: what the tables are and how far they go.
    pub notes: Vec<String>,
}

impl Made {
    /// The new tables with values as a file can hold them.
    pub fn changed(mut self, change: impl Fn(&AxisTable) -> Result<AxisTable>) -> Result<Self> {
        for part in &mut self.new {
            let Some(table) = self.tables.iter_mut().find(|table| table.is_for_same_axes(part)) else { continue };
            let old = table.plus(&part.clone().map(|value| -value))?;
            *table = change(table)?;
            *part = table.plus(&old.map(|value| -value))?;
        }
        Ok(self)
    }

    /// What the control does beyond what it did when the calibration was measured.
    pub fn correction(self, model: &dyn KinematicModel) -> Result<Option<Box<dyn CommandCorrection>>> {
        Ok(Some(Box::new(AxisTables::new(model.info(), self.new)?)))
    }
}

impl Tables {
    /// Refuses settings that are wrong for every machine.
    pub fn check(&self) -> Result<(), SettingsError> {
        let steps = Steps { mm: self.step_mm, deg: self.step_deg };
        let sizes = [
            ("largest_mm", self.largest_mm),
            ("largest_deg", self.largest_deg),
            ("largest_slope_um_per_mm", self.largest_slope_um_per_mm),
        ];
        let places = || match self.at.iter().find(|(_, place)| !place.is_finite()) {
            Some((name, _)) => Err(SettingsError::new(name, "a finite number was expected").under([key("at")])),
            None => Ok(()),
        };
        steps
            .check()
            .and_then(|()| check_ranges(&self.ranges, "ranges"))
            .and_then(|()| sizes.iter().try_for_each(|(name, value)| positive(name, *value).map(|_| ())))
            .and_then(|()| places())
            .map_err(|error| error.under([key("tables")]))
    }

    /// What is believed of tables that the control has already.
    pub fn believed(&self) -> Believed<'_> {
        let settings = ["tables.largest_mm", "tables.largest_deg", "tables.ranges"];
        Believed { settings, ..Believed::new(self.largest_mm, self.largest_deg, &self.ranges) }
    }

    /// The tables of a calibration, added to those that the control has already.
    pub fn made(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
        limits: &Limits,
        existing: Vec<AxisTable>,
    ) -> Result<Made> {
        self.unnested(calibration, model, limits, existing).map_err(|mut error| match error.setting.as_mut_slice() {
            [] => error,
            // A setting of corrections that has another name here.
            [PathItem::Key(name)] if name == "largest_tip_correction_mm" => {
                "largest_mm".clone_into(name);
                within(error, &["tables"])
            }
            _ => within(error, &["tables"]),
        })
    }

    fn unnested(
        &self,
        calibration: &Calibration,
        model: &dyn KinematicModel,
        limits: &Limits,
        existing: Vec<AxisTable>,
    ) -> Result<Made> {
        check_axes(&self.ranges, "ranges", model)?;
        let linear = model.info().axes.iter().filter(|axis| axis.kind == AxisKind::Linear && !axis.indexed).count();
        if linear > 3 {
            let message = format!("the machine has {linear} linear axes; tables are written for machines with three");
            return Err(Error::usage(message).help("which of the parallel axes a table corrects cannot be said yet"));
        }
        if let Some(long) = existing.iter().find(|table| table.positions.len() > limits.points) {
            let message =
                format!("a table that is active has {} points; at most {} fit", long.positions.len(), limits.points);
            return Err(Error::usage(message));
        }
        AxisTables::new(model.info(), existing.clone())?;
        let source = TableSource::new(model, calibration, &places(&self.at, "at", model)?, self.largest_mm);
        let axes = &model.info().axes;
        let own = self.own(model)?;
        let turned: Vec<usize> = own.iter().copied().filter(|&axis| axes[axis].kind == AxisKind::Rotary).collect();
        let cross = self.pairs(model, limits)?;
        let mut made = Made { tables: existing, new: Vec::new(), notes: Vec::new() };
        let count = own.len();
        for (place, (output, input)) in own.into_iter().map(|axis| (axis, axis)).chain(cross).enumerate() {
            let empty = AxisTable { input, output, ..AxisTable::default() };
            let before = made.tables.iter().position(|table| table.is_for_same_axes(&empty));
            let in_same_file = || limits.same_points.then(|| made.tables.iter().position(|table| table.input == input));
            let positions = match before.or_else(|| in_same_file().flatten()) {
                Some(index) => made.tables[index].positions.clone(),
                None => self.points(&axes[input], limits.points)?,
            };
            let exact = source.table(output, input, &positions, &turned)?;
            let interpolation = source.interpolation(&exact, &turned)?;
            let repeats = before.map_or(axes[input].endless, |index| made.tables[index].repeats);
            let exact = AxisTable { repeats, ..exact };
            let exact = match limits.cross == Pairs::Asked && output != input {
                true => both_ways(exact, model, limits.decimals)
                    .map_err(|error| in_list(error, "cross", place.saturating_sub(count), None))?,
                false => exact,
            };
            let zero = || exact.clone().map(|_| 0.0);
            let old = before.map_or_else(zero, |index| made.tables[index].clone());
            let factor = position_unit(&axes[output]).1;
            let sum = old.plus(&exact)?.map(|value| rounded(value * factor, limits.decimals) / factor);
            self.check_table(&sum, model, limits)?;
            if before.is_none() && sum.forward.iter().chain(&sum.reverse).all(|value| *value == 0.0) {
                continue;
            }
            made.new.push(sum.plus(&old.map(|value| -value))?);
            made.notes.push(note(&sum, interpolation, model, source.constant(output, &turned)?));
            match before {
                Some(index) => made.tables[index] = sum,
                None => made.tables.push(sum),
            }
        }
        if made.new.is_empty() {
            let error = Error::data("there is nothing to correct: all values are zero to the digits of the file");
            return Err(error.setting("positioning"));
        }
        Ok(made)
    }

    /// The axes that are corrected along themselves.
    fn own(&self, model: &dyn KinematicModel) -> Result<Vec<usize>> {
        let info = model.info();
        let positions = |index: usize| {
            let axis = &info.axes[index];
            let is_along = |component: usize| component >= 3 && axis.direction[component - 3].abs() > 1e-9;
            axis.kind == AxisKind::Linear
                || info.error_functions.iter().any(|function| function.axis == index && is_along(function.component))
        };
        let Some(names) = &self.positioning else {
            let all = 0..info.axes.len();
            return Ok(all.filter(|&index| !info.axes[index].indexed && positions(index)).collect());
        };
        let mut own = Vec::new();
        for (place, name) in names.iter().enumerate() {
            let at = |error: Error| in_list(error, "positioning", place, None);
            let axis = axis_of(model, name).map_err(at)?;
            if own.contains(&axis) {
                return Err(at(Error::usage(format!("axis {name} is listed twice"))));
            }
            if !positions(axis) {
                return Err(at(Error::usage(format!("axis {name} has no positioning error in the model"))));
            }
            own.push(axis);
        }
        Ok(own)
    }

    /// The (corrected, moving) axes of the other tables.
    fn pairs(&self, model: &dyn KinematicModel, limits: &Limits) -> Result<Vec<(usize, usize)>> {
        let axes = &model.info().axes;
        let linear = |index: &usize| axes[*index].kind == AxisKind::Linear;
        let Some(cross) = &self.cross else {
            let of = |output: usize| (0..axes.len()).filter(linear).map(move |input| (output, input));
            let all = (0..axes.len()).filter(linear).flat_map(of).filter(|(output, input)| output != input);
            return Ok(all.filter(|_| limits.cross == Pairs::All).collect());
        };
        let mut pairs = Vec::new();
        for (place, Cross { correct, along }) in cross.iter().enumerate() {
            let at = |error: Error, name: &'static str| in_list(error, "cross", place, Some(name));
            let output = axis_of(model, correct).map_err(|error| at(error, "correct"))?;
            let input = axis_of(model, along).map_err(|error| at(error, "along"))?;
            if !linear(&output) {
                return Err(at(
                    Error::usage(format!("{correct} is a rotary axis; a linear one was expected")),
                    "correct",
                ));
            }
            if output == input {
                let error = Error::usage(format!("{along} along itself stands under `positioning`"));
                return Err(at(error, "along"));
            }
            if pairs.contains(&(output, input)) {
                return Err(at(Error::usage(format!("{correct} along {along} is listed twice")), "along"));
            }
            pairs.push((output, input));
        }
        Ok(pairs)
    }

    /// Points with the same distance over the whole range, mm or rad.
    fn points(&self, axis: &Axis, most: usize) -> Result<Vec<f64>> {
        let (unit, factor) = position_unit(axis);
        let (from, to) = range_of(axis, &self.ranges, "ranges")?;
        let (setting, step) = match axis.kind {
            AxisKind::Linear => ("step_mm", self.step_mm),
            AxisKind::Rotary => ("step_deg", self.step_deg),
        };
        if axis.endless && ((to - from) - 360.0).abs() > 1e-9 {
            let message = format!("{} turns without an end: a range of one turn was expected", axis.name);
            return Err(Error::usage(message).setting("ranges"));
        }
        let intervals = (to - from) / step;
        let whole = intervals.round().max(1.0);
        let refused = |message: String, help: String| Err(Error::usage(message).help(help).setting(setting));
        let range = format!("axis {} from {from} to {to} {unit}", axis.name);
        if (intervals - whole).abs() > 1e-6 {
            let fits = rounded_position((to - from) / intervals.ceil());
            return refused(
                format!(
                    "{range} is no whole number of steps of {step} {unit}; the points of this control have equal distances"
                ),
                format!("{fits} {unit} fits, or other `ranges`"),
            );
        }
        if whole >= most as f64 {
            let smallest = (to - from) / (most - 1) as f64;
            return refused(
                format!("{range} every {step} {unit} has {} points; at most {most} fit", whole + 1.0),
                format!("a step of at least {smallest:.3} {unit} fits"),
            );
        }
        Ok((0..=whole as usize).map(|index| rounded_position(from + index as f64 * step) / factor).collect())
    }

    fn check_table(&self, table: &AxisTable, model: &dyn KinematicModel, limits: &Limits) -> Result<()> {
        let (output, input) = (&model.info().axes[table.output], &model.info().axes[table.input]);
        let name = format!("{} along {}", output.name, input.name);
        let (unit, factor) = position_unit(output);
        let (setting, most) = Believed::new(self.largest_mm, self.largest_deg, &self.ranges).largest(output.kind);
        let largest = table.forward.iter().chain(&table.reverse).fold(0.0_f64, |most, value| most.max(value.abs()));
        if largest * factor > most {
            let message = format!("a correction of {name} of {:.6} {unit}, more than {most} {unit}", largest * factor);
            return Err(Error::data(message).help("is the calibration right? else allow more").setting(setting));
        }
        let slope = table.steepest() * position_unit(output).1 / position_unit(input).1 * 1e3;
        if slope > self.largest_slope_um_per_mm {
            let most = self.largest_slope_um_per_mm;
            let message = format!("the correction of {name} changes by {slope:.3} µm/mm; at most {most} are allowed");
            return Err(Error::data(message)
                .help("is the calibration right? else allow more")
                .setting("largest_slope_um_per_mm"));
        }
        let ends = |values: &[f64]| values.first().zip(values.last()).map_or(0.0, |(first, last)| (first - last).abs());
        let open = ends(&table.forward).max(ends(&table.reverse)) * position_unit(output).1;
        if table.repeats && open > 1.5 * 0.1_f64.powi(limits.decimals) {
            let message = format!("the correction of {name} differs by {open:.6} between the ends of a turn");
            return Err(Error::data(message).help("an error that repeats with the turn is needed (`fourier`)"));
        }
        Ok(())
    }
}

/// The table with the mean of both directions of travel, if they differ by no more than the last digit.
fn both_ways(table: AxisTable, model: &dyn KinematicModel, decimals: i32) -> Result<AxisTable> {
    let (output, input) = (&model.info().axes[table.output], &model.info().axes[table.input]);
    let pairs = || table.forward.iter().zip(&table.reverse);
    let apart = pairs().map(|(forward, reverse)| (forward - reverse).abs()).fold(0.0, f64::max);
    if apart * position_unit(output).1 > 0.1_f64.powi(decimals) {
        let (name, along) = (&output.name, &input.name);
        let message =
            format!("the correction of {name} along {along} depends on the direction of travel; such tables do not");
        return Err(Error::data(message));
    }
    let mean: Vec<f64> = pairs().map(|(forward, reverse)| f64::midpoint(*forward, *reverse)).collect();
    Ok(AxisTable { forward: mean.clone(), reverse: mean, ..table })
}

/// One line that says what a table is, how far it goes, and what it leaves.
fn note(table: &AxisTable, interpolation: f64, model: &dyn KinematicModel, constant: f64) -> String {
    let (output, input) = (&model.info().axes[table.output], &model.info().axes[table.input]);
    let ((of, factor), (unit, along)) = (position_unit(output), position_unit(input));
    let end = |place: Option<&f64>| rounded_position(place.copied().unwrap_or_default() * along);
    format!(
        "{} along {}: {} points from {} to {} {unit}; interpolation {:.6} {of}; not in the table: {:.6} {of} at the reference place",
        output.name,
        input.name,
        table.positions.len(),
        end(table.positions.first()),
        end(table.positions.last()),
        interpolation * factor,
        constant * factor + 0.0,
    )
}

/// A value with some decimals, never minus zero.
pub fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    (value * scale).round() / scale + 0.0
}

/// The index of the axis of that name.
pub fn axis_of(model: &dyn KinematicModel, name: &str) -> Result<usize> {
    let axes = &model.info().axes;
    let unknown = || {
        let names = axes.iter().map(|axis| axis.name.as_str());
        Error::usage(format!("the machine has no axis {name}")).suggest(name, names)
    };
    axes.iter().position(|axis| axis.name == name).ok_or_else(unknown)
}

pub fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

fn in_list(mut error: Error, list: &str, place: usize, name: Option<&str>) -> Error {
    let path = [key(list), PathItem::Index(place)].into_iter().chain(name.map(key));
    error.setting.splice(0..0, path);
    error
}
