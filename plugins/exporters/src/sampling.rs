//! What exporters share: points along an axis, motion errors at them, numbers as text.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, Axis, Calibration, ErrorFunction, KinematicModel, MotionError, Result, SettingsError, StatusRole,
};
use abbe_numerics::joint_coverage_factor;
use abbe_volumetric::{Ranges, Steps, check_ranges, points_every, range_of};

/// The setting with the ranges of axes, the same in all exporters of single axes.
pub const RANGES: &str = "ranges";

/// Refuses ranges and steps that are wrong for every axis.
pub fn check(ranges: &Ranges, steps: Steps) -> Result<(), SettingsError> {
    steps.check()?;
    check_ranges(ranges, RANGES)
}

/// Points along an axis, mm or deg: the start of its range, one every step, and the end of its range.
pub fn points(axis: &Axis, ranges: &Ranges, steps: Steps, most: usize) -> Result<Vec<f64>> {
    points_every(axis, range_of(axis, ranges, RANGES)?, steps, most)
}

/// The status of an axis at a position (in memory's unit), approached in a direction. Other axes are at zero; all other
/// statuses are those for data without a column for them.
pub fn status(model: &dyn KinematicModel, axis: &Axis, position: f64, direction: f64) -> Vec<f64> {
    let of_axis =
        |role: &StatusRole| matches!(role, StatusRole::Direction(of) if model.info().axes[*of].status == axis.status);
    let columns = model.info().status.iter().enumerate();
    columns
        .map(|(index, column)| match column.absent {
            _ if index == axis.status => position,
            _ if of_axis(&column.role) => direction,
            _ if model.info().axes.iter().any(|other| other.status == index) => 0.0,
            Absent::Default(value) => value,
            Absent::Required => 0.0,
        })
        .collect()
}

/// The values of a calibration in the order of the model's parameters, with the row of each in the covariance.
pub struct Values<'a> {
    values: Vec<f64>,
    calibration: &'a Calibration,
    rows: Vec<Option<usize>>,
}

impl<'a> Values<'a> {
    /// The values for a model.
    pub fn new(calibration: &'a Calibration, model: &dyn KinematicModel) -> Self {
        let known: BTreeMap<&str, f64> =
            calibration.parameters.iter().map(|parameter| (parameter.name.as_str(), parameter.value)).collect();
        let order: BTreeMap<&str, usize> =
            calibration.covariance.order.iter().enumerate().map(|(row, name)| (name.as_str(), row)).collect();
        let parameters = model.info().parameters.iter().map(|parameter| parameter.name.as_str());
        Self {
            values: parameters
                .clone()
                .zip(&model.info().nominal)
                .map(|(name, nominal)| known.get(name).copied().unwrap_or(*nominal))
                .collect(),
            calibration,
            rows: parameters.map(|name| order.get(name).copied()).collect(),
        }
    }

    /// A motion error at a status, with its standard uncertainty; parameters that were not estimated have none.
    pub fn motion_error(
        &self,
        model: &dyn KinematicModel,
        function: &ErrorFunction,
        status: &[f64],
    ) -> Result<(f64, f64)> {
        let error = model.motion_error(function, &self.values, status)?;
        let terms = self.estimated(&error);
        let mut variance = 0.0;
        for (row, a) in &terms {
            for (column, b) in &terms {
                variance += a * b * self.calibration.covariance.rows[*row][*column];
            }
        }
        Ok((error.value, variance.max(0.0).sqrt()))
    }

    /// The factor on the standard uncertainty of a motion error that makes a band in which its whole curve lies with a
    /// probability (Scheffé 1959, for as many parameters as the error has); none if none of them was estimated, or too few
    /// degrees of freedom are left.
    pub fn band_factor(
        &self,
        model: &dyn KinematicModel,
        function: &ErrorFunction,
        status: &[f64],
        probability: f64,
    ) -> Result<Option<f64>> {
        let terms = self.estimated(&model.motion_error(function, &self.values, status)?);
        let names: Vec<&String> = terms.iter().map(|(row, _)| &self.calibration.covariance.order[*row]).collect();
        let freedom = self.calibration.degrees_of_freedom(|name| names.iter().any(|own| *own == name));
        Ok(Some(joint_coverage_factor(names.len(), probability, freedom)).filter(|factor| factor.is_finite()))
    }

    /// The estimated parameters of an error, as rows of the covariance, with their factors.
    fn estimated(&self, error: &MotionError) -> Vec<(usize, f64)> {
        let terms = error.derivatives.iter();
        terms.filter_map(|&(parameter, factor)| Some((self.rows[parameter]?, factor))).collect()
    }
}

/// A number with six decimals, without a minus sign before zero.
pub fn fixed(value: f64) -> String {
    let text = format!("{value:.6}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| matches!(byte, b'0' | b'.')) => digits.to_owned(),
        _ => text,
    }
}

/// A number with all its digits.
pub fn exact(value: f64) -> String {
    format!("{:e}", value + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign() {
        assert_eq!([fixed(-1e-9), fixed(-1.5), fixed(0.0)], ["0.000000", "-1.500000", "0.000000"]);
        assert_eq!([exact(-0.0), exact(-0.1), exact(1e-15)], ["0e0", "-1e-1", "1e-15"]);
    }
}
