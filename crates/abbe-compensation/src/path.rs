//! A file of set-points, corrected.

use std::path::Path;

use abbe_core::{Calibration, Error, KinematicModel, Result, machine_values};
use abbe_volumetric::predict;

use crate::calibrated::{check_confounded, extrapolated};
use crate::compensator::{Compensator, Correction};
use crate::figures::{ReversedMoves, largest_uncertainty, reversed_moves};
use crate::set_points::SetPoints;
use crate::settings::Settings;

/// Words in a remark of what was corrected, set-points or a program: to correct it again would put the tool off.
pub const MARK: &str = "abbe compensated";

/// The set-points of a file with corrected commands.
#[derive(Debug, Clone, PartialEq)]
pub struct CompensatedPath {
    /// As they are programmed.
    pub points: SetPoints,
    /// Their statuses with corrected commands.
    pub statuses: Vec<f64>,
    /// What was done at each of them.
    pub corrections: Vec<Correction>,
    /// Moves that the correction reverses.
    pub reversed: Vec<ReversedMoves>,
    /// Largest standard uncertainty of the tip at each of them, in any direction, mm: what the calibration says of its parameters.
    pub uncertainties: Vec<f64>,
    /// The estimate of the calibration.
    estimate: String,
}

impl CompensatedPath {
    /// Corrects a file for the errors of a calibration; `model` is the calibration's own.
    ///
    /// Fails for a calibration that may not be used ([`check_confounded`]), and as [`SetPoints::read`] and
    /// [`Compensator::correct`] do. Errors of a point name its line.
    pub fn new(
        model: &dyn KinematicModel,
        calibration: &Calibration,
        file: &Path,
        settings: &Settings,
    ) -> Result<Self> {
        Self::of(model, calibration, SetPoints::read(file, model)?, settings)
    }

    /// The same for set-points that are read.
    ///
    /// Fails for set-points that have the mark of a correction.
    pub fn of(
        model: &dyn KinematicModel,
        calibration: &Calibration,
        points: SetPoints,
        settings: &Settings,
    ) -> Result<Self> {
        if let Some(line) = points.marked() {
            let error = Error::data("these set-points are compensated already").at(points.path(), line, None);
            return Err(error.help("correct the set-points as they were before"));
        }
        let values = machine_values(model, calibration);
        let corrected = || {
            check_confounded(model, calibration, points.statuses())?;
            points.tell(&extrapolated(model, calibration, points.statuses())?);
            let (statuses, corrections) = Compensator::new(model, &values, settings)?.correct(points.statuses())?;
            let reversed = reversed_moves(model, &values, points.statuses(), &statuses)?;
            let known = predict(model, calibration, &statuses)?;
            let uncertainties = known.iter().map(|error| largest_uncertainty(&error.covariance)).collect();
            Ok((statuses, corrections, reversed, uncertainties))
        };
        let (statuses, corrections, reversed, uncertainties) = corrected().map_err(|error| points.locate(error))?;
        let estimate = calibration.estimate.clone();
        Ok(Self { points, statuses, corrections, reversed, uncertainties, estimate })
    }

    /// Largest correction of the command of an axis, mm or rad.
    pub fn largest_correction(&self, model: &dyn KinematicModel, axis: usize) -> f64 {
        let (width, place) = (model.info().status.len(), model.info().axes[axis].status);
        let pairs = self.statuses.chunks(width).zip(self.points.statuses().chunks(width));
        pairs.map(|(now, before)| (now[place] - before[place]).abs()).fold(0.0, f64::max)
    }

    /// Largest standard uncertainty of the tip at any of the set-points, mm.
    pub fn largest_uncertainty(&self) -> f64 {
        self.uncertainties.iter().copied().fold(0.0, f64::max)
    }

    /// The text of the file with corrected commands of nine decimals, after a remark that marks them as corrected ([`MARK`]); all else
    /// is as it was.
    pub fn set_points_text(&self, model: &dyn KinematicModel) -> Result<String> {
        let text = self.points.with_commands(model, &self.statuses)?;
        let end = if text.split('\n').next().is_some_and(|line| line.ends_with('\r')) { "\r\n" } else { "\n" };
        let estimate: String = self.estimate.chars().filter(|letter| !letter.is_control()).collect();
        Ok(format!("# {MARK}: calibration {estimate}{end}{text}"))
    }

    /// A CSV table with a row for every set-point: its errors in the table frame before and after the correction.
    pub fn errors_text(&self, model: &dyn KinematicModel) -> String {
        let mut text = String::from(
            "line,before_x_um,before_y_um,before_z_um,before_axis_urad,after_x_um,after_y_um,after_z_um,after_axis_urad,\
             standard_uncertainty_um,bounded,held\n",
        );
        let um = |tip: [f64; 3]| tip.map(|value| format!("{:.6}", value * 1e3 + 0.0)).join(",");
        let urad = |angle: f64| format!("{:.6}", angle * 1e6);
        for (point, correction) in self.corrections.iter().enumerate() {
            let Correction { before, after, is_bounded, held, .. } = correction;
            let held: Vec<&str> = held.iter().map(|&axis| model.info().axes[axis].name.as_str()).collect();
            let cells = [
                self.points.line(point).to_string(),
                um(before.tip),
                urad(before.angle()),
                um(after.tip),
                urad(after.angle()),
                format!("{:.6}", self.uncertainties[point] * 1e3),
                u8::from(*is_bounded).to_string(),
                held.join(" "),
            ];
            text.push_str(&cells.join(","));
            text.push('\n');
        }
        text
    }
}
