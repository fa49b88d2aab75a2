//! The linear part of the motion of a machine with three axes.

use abbe_compensation::check_confounded;
use abbe_core::{AxisKind, Calibration, CommandCorrection, Error, KinematicModel, Poses, Result, machine_values};
use abbe_volumetric::{Grid, Points, Ranges};
use nalgebra::{Matrix3, Vector3};

/// Names of the axes that such a machine has.
pub const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Points along every axis.
const POINTS: usize = 5;

/// The nominal axes are those of the table frame, to this much.
const SQUARE: f64 = 1e-9;

/// The columns of the status with the commands of X, Y and Z; refuses other machines.
pub fn commands(model: &dyn KinematicModel) -> Result<[usize; 3]> {
    let axes: Vec<_> = model.info().axes.iter().filter(|axis| !axis.indexed).collect();
    let column = |name: &str| {
        let found = axes.iter().find(|axis| axis.name == name && axis.kind == AxisKind::Linear);
        found.map(|axis| axis.status).ok_or_else(|| {
            Error::usage(format!("the machine has no linear axis {name}"))
                .help("this control corrects machines with the axes X, Y and Z")
        })
    };
    let columns = [column(AXES[0])?, column(AXES[1])?, column(AXES[2])?];
    match axes.len() {
        3 => Ok(columns),
        count => Err(Error::usage(format!("the machine has {count} axes; X, Y and Z alone were expected"))),
    }
}

/// How the tip moves, mm per mm of the commands of X, Y and Z (columns): the plane through the tips over the ranges of the axes
/// that leaves the least squares, mean of both directions of travel.
pub fn motion(calibration: &Calibration, model: &dyn KinematicModel, ranges: &Ranges) -> Result<Matrix3<f64>> {
    let columns = commands(model)?;
    let points = Some(Points::Every(POINTS));
    let grid = Grid { points, axes: ranges.clone(), both_directions: true, ..Grid::default() };
    let statuses = grid.statuses(model)?;
    check_confounded(model, calibration, &statuses)?;
    let nominal = slopes(model, &model.info().nominal, &statuses, columns)?;
    if (nominal - Matrix3::identity()).amax() > SQUARE {
        return Err(Error::usage("the axes of the machine do not move the tool along x, y and z of the table frame")
            .help("directions of the axes and `reverse` of the machine description tell where they move"));
    }
    slopes(model, &machine_values(model, calibration), &statuses, columns)
}

/// On a grid the slopes along one axis do not depend on those along the others.
fn slopes(model: &dyn KinematicModel, values: &[f64], statuses: &[f64], columns: [usize; 3]) -> Result<Matrix3<f64>> {
    let mut poses = Poses::default();
    model.poses(statuses, values, &[], false, &mut poses)?;
    let rows: Vec<&[f64]> = statuses.chunks(model.info().status.len()).collect();
    let slope = |column: usize| {
        let mean = rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64;
        let (mut sum, mut squares) = (Vector3::zeros(), 0.0);
        for (row, tip) in rows.iter().zip(&poses.positions) {
            let away = row[column] - mean;
            sum += Vector3::from(*tip) * away;
            squares += away * away;
        }
        sum / squares
    };
    let found = Matrix3::from_columns(&columns.map(slope));
    match found.iter().all(|value| value.is_finite()) {
        true => Ok(found),
        false => Err(Error::data("the machine has no finite poses")),
    }
}

/// Commands of X, Y and Z that are multiplied by a matrix.
pub struct Multiplied {
    pub columns: [usize; 3],
    /// Columns of the status.
    pub width: usize,
    pub by: Matrix3<f64>,
}

impl CommandCorrection for Multiplied {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        let mut found = programmed.to_vec();
        for status in found.chunks_mut(self.width.max(1)) {
            let moved = self.by * Vector3::from(self.columns.map(|column| status[column]));
            self.columns.iter().zip(moved.iter()).for_each(|(&column, value)| status[column] = *value);
        }
        Ok(found)
    }
}
