//! Corrections that follow temperatures as controls take them: a straight line along each axis, whose offset and slope follow states.

use std::collections::BTreeMap;

use abbe_core::{
    AxisKind, Calibration, CommandCorrection, Error, KinematicModel, PathItem, Result, SettingsError, positive,
};
use abbe_volumetric::{Ranges, check_axes, check_ranges, places, range_of, standing, within};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::calibrated::{anywhere, check_confounded};
use crate::{ThermalResponses, ThermalState};

/// Which axes follow temperatures, and where their lines are taken.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LineSettings {
    /// Linear axes that are corrected. Default: all that have something to correct.
    #[serde(default)]
    pub axes: Option<Vec<String>>,
    /// Where the other axes stand: `{ Z_mm: 100 }`; the others stand at zero.
    #[serde(default)]
    pub at: BTreeMap<String, f64>,
    /// Ranges by axis, where they are not those of the machine.
    #[serde(default)]
    pub ranges: Ranges,
    /// Reference positions by axis (`{ X_mm: 320 }`), from which slopes count. Default: zero.
    #[serde(default)]
    pub reference: BTreeMap<String, f64>,
    /// Largest correction of the tip that is believed.
    #[serde(default = "one")]
    pub largest_mm: f64,
}

fn one() -> f64 {
    1.0
}

impl Default for LineSettings {
    fn default() -> Self {
        Self { axes: None, at: BTreeMap::new(), ranges: Ranges::new(), reference: BTreeMap::new(), largest_mm: one() }
    }
}

impl LineSettings {
    /// Refuses settings that are wrong for every machine.
    pub fn check(&self) -> Result<(), SettingsError> {
        check_ranges(&self.ranges, "ranges")?;
        positive("largest_mm", self.largest_mm)?;
        for (setting, list) in [("at", &self.at), ("reference", &self.reference)] {
            if let Some((name, _)) = list.iter().find(|(_, place)| !place.is_finite()) {
                return Err(
                    SettingsError::new(name, "a finite number was expected").under([PathItem::Key(setting.to_owned())])
                );
            }
        }
        Ok(())
    }
}

/// The correction of one axis: for each state an offset and a slope.
#[derive(Debug, Clone, PartialEq)]
pub struct ThermalLine {
    /// Index into [`ModelInfo::axes`](abbe_core::ModelInfo::axes).
    pub axis: usize,
    /// The position from which slopes count, mm.
    pub reference: f64,
    /// Travel, mm.
    pub range: (f64, f64),
    /// For each state what is added to the command, for one unit of the state: mm at the reference, mm/mm.
    pub parts: Vec<[f64; 2]>,
    /// Largest distance of the exact corrections from the line along the axis, mm, at the states of the calibration.
    pub bent: f64,
    /// The same anywhere in the workspace: what a line cannot know of the other axes.
    pub elsewhere: f64,
}

impl ThermalLine {
    /// Offset (mm) and slope (mm/mm) at these states.
    pub fn at(&self, states: &[f64]) -> [f64; 2] {
        self.parts
            .iter()
            .zip(states)
            .fold([0.0; 2], |sum, ([offset, slope], state)| [sum[0] + offset * state, sum[1] + slope * state])
    }

    /// What is added to a command, mm.
    pub fn correction(&self, states: &[f64], position: f64) -> f64 {
        let [offset, slope] = self.at(states);
        offset + slope * (position - self.reference)
    }
}

/// All axes that follow temperatures.
#[derive(Debug, Clone, PartialEq)]
pub struct ThermalLines {
    /// The states.
    pub states: Vec<ThermalState>,
    /// Their largest values in the log of the calibration, in the unit of their readings.
    pub largest: Vec<f64>,
    /// The axes.
    pub lines: Vec<ThermalLine>,
    commands: Vec<usize>,
    width: usize,
}

/// Points of the fit of a line.
const POINTS: usize = 33;

/// A correction below this, mm, is none.
const SMALLEST: f64 = 1e-8;

impl ThermalLines {
    /// Fits lines to the exact corrections.
    ///
    /// Fails for a calibration whose errors follow no temperature, for axes that the machine does not have or that are not linear, for
    /// corrections that the calibration does not determine, and where there is nothing to correct.
    pub fn new(calibration: &Calibration, model: &dyn KinematicModel, settings: &LineSettings) -> Result<Self> {
        let responses = ThermalResponses::new(model, calibration, settings.largest_mm)?;
        check_axes(&settings.ranges, "ranges", model)?;
        let references = places(&settings.reference, "reference", model)?;
        let mut status = standing(model);
        for (axis, place) in places(&settings.at, "at", model)? {
            status[model.info().axes[axis].status] = place;
        }
        let largest = responses.states.iter().map(|state| state.largest().map(f64::abs));
        let mut found = Self {
            largest: largest.collect::<Result<Vec<_>>>()?,
            states: responses.states.clone(),
            lines: Vec::new(),
            commands: model.info().axes.iter().map(|axis| axis.status).collect(),
            width: model.info().status.len(),
        };
        let axes = corrected(settings, model)?;
        let all = anywhere(model, &settings.ranges)?;
        let exact = found.exact(&responses, &all)?;
        for &axis in &axes {
            let range = range_of(&model.info().axes[axis], &settings.ranges, "ranges")?;
            let (from, to) = range;
            let reference = references.get(&axis).copied().unwrap_or(0.0);
            let of_axis = &model.info().axes[axis];
            if of_axis.reach().is_some_and(|[low, high]| !(low..=high).contains(&reference)) {
                let message = format!("{reference} mm is beyond the travel of {}", of_axis.name);
                return Err(Error::usage(message).setting("reference"));
            }
            let along = found.along(&status, axis, (from, to));
            check_confounded(model, calibration, &along)?;
            let responses = found.exact(&responses, &along)?;
            let mut line = found.line((axis, range), reference, &along, &responses);
            line.bent = found.off(&line, &along, &responses);
            line.elsewhere = found.off(&line, &all, &exact);
            let size = |place: f64| {
                let part =
                    |([offset, slope], most): (&[f64; 2], &f64)| (offset + slope * (place - reference)).abs() * most;
                line.parts.iter().zip(&found.largest).map(part).sum::<f64>()
            };
            if settings.axes.is_some() || size(from).max(size(to)) > SMALLEST {
                found.lines.push(line);
            }
        }
        if found.lines.is_empty() {
            return Err(Error::data("there is nothing to correct: no linear axis follows a temperature"));
        }
        Ok(found)
    }

    /// Statuses along an axis while the others stand.
    fn along(&self, status: &[f64], axis: usize, (from, to): (f64, f64)) -> Vec<f64> {
        let place = |point: usize| from + (to - from) * point as f64 / (POINTS - 1) as f64;
        let at = |point| {
            let mut status = status.to_vec();
            status[self.commands[axis]] = place(point);
            status
        };
        (0..POINTS).flat_map(at).collect()
    }

    /// Corrections for one unit of each state: states x statuses.
    fn exact(&self, responses: &ThermalResponses<'_>, statuses: &[f64]) -> Result<Vec<Vec<f64>>> {
        (0..self.states.len()).map(|state| responses.of(state, statuses)).collect()
    }

    /// Straight lines by least squares.
    fn line(
        &self,
        (axis, range): (usize, (f64, f64)),
        reference: f64,
        statuses: &[f64],
        exact: &[Vec<f64>],
    ) -> ThermalLine {
        let column = self.commands[axis];
        let places: Vec<f64> = statuses.chunks(self.width).map(|status| status[column] - reference).collect();
        let mean = places.iter().sum::<f64>() / places.len() as f64;
        let moment: f64 = places.iter().map(|place| (place - mean).powi(2)).sum();
        let of_state = |exact: &Vec<f64>| {
            let values: Vec<f64> = exact.chunks(self.width).map(|status| status[column]).collect();
            let middle = values.iter().sum::<f64>() / values.len() as f64;
            let slope = places.iter().zip(&values).map(|(place, value)| (place - mean) * value).sum::<f64>() / moment;
            [middle - slope * mean, slope]
        };
        ThermalLine { axis, reference, range, parts: exact.iter().map(of_state).collect(), bent: 0.0, elsewhere: 0.0 }
    }

    /// The largest distance of exact corrections from a line, at the largest values of the states.
    fn off(&self, line: &ThermalLine, statuses: &[f64], exact: &[Vec<f64>]) -> f64 {
        let column = self.commands[line.axis];
        let at = |(point, status): (usize, &[f64])| {
            let of_state = |(state, most): (usize, &f64)| {
                let [offset, slope] = line.parts[state];
                let found = offset + slope * (status[column] - line.reference);
                (exact[state][point * self.width + column] - found).abs() * most
            };
            self.largest.iter().enumerate().map(of_state).sum::<f64>()
        };
        statuses.chunks(self.width).enumerate().map(at).fold(0.0, f64::max)
    }

    /// All states at a status on the clock of the calibration's own log; zero where the time is not known.
    ///
    /// Fails for a time outside the log.
    pub fn states_at(&self, status: &[f64]) -> Result<Vec<f64>> {
        self.states.iter().map(|state| state.at(status)).collect()
    }

    /// A bound of how fast the correction of an axis changes while the logs of the calibration run, mm/s, at either end of its travel:
    /// all states at their fastest together.
    pub fn fastest(&self, line: &ThermalLine) -> Result<f64> {
        let mut fastest = 0.0;
        for (state, [offset, slope]) in self.states.iter().zip(&line.parts) {
            let at = |place: f64| (offset + slope * (place - line.reference)).abs();
            fastest += at(line.range.0).max(at(line.range.1)) * state.fastest()?;
        }
        Ok(fastest)
    }
}

/// The axes of the settings, or all linear ones.
fn corrected(settings: &LineSettings, model: &dyn KinematicModel) -> Result<Vec<usize>> {
    let axes = &model.info().axes;
    let is_linear = |axis: &usize| axes[*axis].kind == AxisKind::Linear && !axes[*axis].indexed;
    let Some(names) = &settings.axes else { return Ok((0..axes.len()).filter(is_linear).collect()) };
    let mut found = Vec::new();
    for name in names {
        let known = axes.iter().position(|axis| axis.name == *name).filter(is_linear);
        let linear = || (0..axes.len()).filter(is_linear).map(|axis| axes[axis].name.as_str());
        let Some(axis) = known else {
            let error = Error::usage(format!("the machine has no linear axis {name}")).suggest(name, linear());
            return Err(within(error, &["axes"]));
        };
        if found.contains(&axis) {
            return Err(within(Error::usage(format!("axis {name} is listed twice")), &["axes"]));
        }
        found.push(axis);
    }
    Ok(found)
}

impl CommandCorrection for ThermalLines {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        if !programmed.len().is_multiple_of(self.width) {
            let (values, width) = (programmed.len(), self.width);
            return Err(Error::usage(format!("{values} numbers are no statuses of {width} values each")));
        }
        let mut found = programmed.to_vec();
        for (status, programmed) in found.chunks_mut(self.width).zip(programmed.chunks(self.width)) {
            let states = self.states_at(programmed)?;
            for line in &self.lines {
                let column = self.commands[line.axis];
                status[column] += line.correction(&states, programmed[column]);
            }
        }
        Ok(found)
    }
}
