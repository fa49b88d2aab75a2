//! The other way round: measured positions, corrected for the errors of the machine that measured them.

use std::path::Path;

use abbe_core::{Calibration, Error, KinematicModel, Poses, Result, StatusRole, machine_values};
use abbe_volumetric::predict;

use crate::calibrated::{check_confounded, extrapolated};
use crate::compensator::beyond;
use crate::figures::{Spread, largest_reversal, largest_uncertainty};
use crate::set_points::SetPoints;

/// Where a tip was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Where the nominal machine would have had it: the indicated position, table frame, mm.
    pub indicated: [f64; 3],
    /// Where the calibrated machine had it, table frame, mm.
    pub corrected: [f64; 3],
    /// Covariance of the corrected position, mm²: what the calibration says of its parameters.
    pub covariance: [[f64; 3]; 3],
}

/// The positions of a file, corrected (Soons 1993, 2.3.5, first half; Rahman 2004, chapter 6).
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredPoints {
    /// Positions of the axes as they were read.
    pub points: SetPoints,
    /// Where the tip was at each of them.
    pub tips: Vec<Measured>,
}

impl MeasuredPoints {
    /// Corrects the positions of a file by `largest` mm at most; `model` is the calibration's own. A position is that of the tip: of a
    /// probe the centre of its ball.
    ///
    /// Fails as [`CompensatedPath::new`](crate::CompensatedPath::new) does, and for positions beyond the travel. Errors of a point name its
    /// line.
    pub fn new(model: &dyn KinematicModel, calibration: &Calibration, file: &Path, largest: f64) -> Result<Self> {
        Self::of(model, calibration, SetPoints::read(file, model)?, largest)
    }

    /// The same for positions that are read.
    pub fn of(model: &dyn KinematicModel, calibration: &Calibration, points: SetPoints, largest: f64) -> Result<Self> {
        let corrected = || {
            for (point, status) in points.statuses().chunks(model.info().status.len().max(1)).enumerate() {
                if let Some(beyond) = model.info().axes.iter().find_map(|axis| beyond(axis, status)) {
                    return Err(Error::data(format!("{beyond}: the machine was not calibrated there")).at_pose(point));
                }
            }
            check_confounded(model, calibration, points.statuses())?;
            points.tell(&extrapolated(model, calibration, points.statuses())?);
            let errors = predict(model, calibration, points.statuses())?;
            let mut nominal = Poses::default();
            model.poses(points.statuses(), &model.info().without_errors(), &[], false, &mut nominal)?;
            let tips = nominal.positions.iter().zip(errors).map(|(&indicated, error)| Measured {
                indicated,
                corrected: [0, 1, 2].map(|axis| indicated[axis] + error.mean[axis]),
                covariance: error.covariance,
            });
            let tips: Vec<Measured> = tips.collect();
            let size = |tip: &Measured| distance(&tip.corrected, &tip.indicated);
            match tips.iter().position(|tip| size(tip) > largest || size(tip).is_nan()) {
                None => Ok(tips),
                Some(point) => {
                    let size = size(&tips[point]);
                    let message =
                        format!("this position would be corrected by {size:.3} mm; at most {largest} mm are allowed");
                    let help = "is the calibration that of this machine and this tool? else allow more";
                    Err(Error::data(message).help(help).at_pose(point))
                }
            }
        };
        let tips = corrected().map_err(|error| points.locate(error))?;
        Ok(Self { points, tips })
    }

    /// The axes that are taken to have come to each position from where the row before is, because the file has no directions of
    /// approach, each with the largest distance of the tip to where it is if they came from the other side, mm. Axes without reversal
    /// error are left out.
    ///
    /// Fails where the model has no pose.
    pub fn guessed_directions(
        &self,
        model: &dyn KinematicModel,
        calibration: &Calibration,
    ) -> Result<Vec<(usize, f64)>> {
        let values = machine_values(model, calibration);
        let mut guessed = Vec::new();
        for &axis in self.points.directions_of_path() {
            let Some(place) = model.info().status_index(&StatusRole::Direction(axis)) else { continue };
            let reversal = largest_reversal(model, &values, self.points.statuses(), place)?;
            if reversal > 0.0 {
                guessed.push((axis, reversal));
            }
        }
        Ok(guessed)
    }

    /// Distances between corrected and indicated positions, mm.
    pub fn corrections(&self) -> Spread {
        Spread::of(self.tips.iter().map(|tip| distance(&tip.corrected, &tip.indicated)))
    }

    /// Largest standard uncertainty of a corrected position, in any direction, mm.
    pub fn largest_uncertainty(&self) -> f64 {
        self.tips.iter().map(|tip| largest_uncertainty(&tip.covariance)).fold(0.0, f64::max)
    }

    /// The text of the file with columns more: the corrected position (`corrected_x_mm`, ..), the correction (`correction_x_um`, ..)
    /// and the covariance (`xx_um2`, .., `yz_um2`).
    ///
    /// Fails if the file has one of these columns.
    pub fn text(&self) -> Result<String> {
        const UPPER: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        let headers = [
            "corrected_x_mm",
            "corrected_y_mm",
            "corrected_z_mm",
            "correction_x_um",
            "correction_y_um",
            "correction_z_um",
            "xx_um2",
            "yy_um2",
            "zz_um2",
            "xy_um2",
            "xz_um2",
            "yz_um2",
        ];
        self.points.with_more_columns(&headers, |point| {
            let Measured { indicated, corrected, covariance } = &self.tips[point];
            let positions = corrected.iter().map(|value| format!("{:.9}", value + 0.0));
            let changes = (0..3).map(|axis| format!("{:.6}", (corrected[axis] - indicated[axis]) * 1e3 + 0.0));
            let covariances = UPPER.iter().map(|&(row, column)| format!("{:e}", covariance[row][column] * 1e6));
            positions.chain(changes).chain(covariances).collect()
        })
    }
}

/// What leaving terms out costs at the same positions: distances between the points that two sets of values give, mm (Soons 1993,
/// 5.1.1). Parameters that `is_left_out` names have their nominal values in the second set.
///
/// Fails where the model has no pose.
pub fn cost_of_leaving_out(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    statuses: &[f64],
    is_left_out: impl Fn(&str) -> bool,
) -> Result<Spread> {
    let all = machine_values(model, calibration);
    let parameters = model.info().parameters.iter().zip(&model.info().nominal);
    let reduced: Vec<f64> = (parameters.zip(&all))
        .map(|((parameter, nominal), value)| if is_left_out(&parameter.name) { *nominal } else { *value })
        .collect();
    let tips = |values: &[f64]| {
        let mut poses = Poses::default();
        model.poses(statuses, values, &[], false, &mut poses).map(|()| poses.positions)
    };
    let (full, reduced) = (tips(&all)?, tips(&reduced)?);
    Ok(Spread::of(full.iter().zip(&reduced).map(|(one, other)| distance(one, other))))
}

fn distance(one: &[f64; 3], other: &[f64; 3]) -> f64 {
    one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt()
}
