//! What a calibration tells of a machine, and whether a correction may use it.

use std::collections::BTreeMap;

use abbe_core::{
    AxisKind, Calibration, Error, KinematicModel, Poses, Result, Status, StatusRole, Termination, Variable,
    machine_values,
};
use abbe_volumetric::{Grid, Ranges, position_unit, range_of};

/// Points that are evaluated together.
const CHUNK: usize = 200;

/// A direction moves the tool if its parts do not cancel to this part of their sum.
const CANCELLED: f64 = 1e-6;

/// Refuses a calibration with confounded parameters (marked `?`) whose shared direction moves the tool at some of the set-points, and
/// one with errors that no machine has: a correction would be one of many that the measurements allow, or nonsense.
pub fn check_confounded(model: &dyn KinematicModel, calibration: &Calibration, statuses: &[f64]) -> Result<()> {
    if let Some(worst) = calibration.fit.implausible.first() {
        return Err(Error::data(format!("no machine has errors like `{}` of this calibration", worst.name)));
    }
    if calibration.fit.termination != Termination::Converged {
        return Err(Error::data("the estimate of this calibration did not converge"));
    }
    let confounded = |name: &str| {
        model.info().parameter(name).is_some()
            && calibration.get(name).is_some_and(|known| known.status == Status::Confounded)
    };
    let names: Vec<&str> =
        calibration.parameters.iter().map(|known| known.name.as_str()).filter(|name| confounded(name)).collect();
    let Some(first) = names.first() else { return Ok(()) };
    let help = "measure what separates them, or estimate fewer parameters";
    if calibration.fit.null_space.is_empty() {
        return Err(
            Error::data(format!("the measurements do not determine `{first}`, which would be corrected")).help(help)
        );
    }
    let width = model.info().status.len().max(1);
    let values = machine_values(model, calibration);
    for direction in &calibration.fit.null_space {
        let parts: Vec<(usize, f64)> = (direction.combination.iter())
            .filter_map(|part| Some((model.info().parameter(&part.name)?, part.coefficient)))
            .collect();
        let wanted: Vec<Variable> = parts.iter().map(|(index, _)| Variable::Parameter(*index)).collect();
        let mut poses = Poses::default();
        for (index, chunk) in statuses.chunks(width * CHUNK).enumerate() {
            model.poses(chunk, &values, &wanted, true, &mut poses).map_err(|mut error| {
                error.pose = error.pose.map(|pose| pose + index * CHUNK);
                error
            })?;
            let moves = |list: &[[f64; 3]]| list.chunks(wanted.len().max(1)).any(|of_pose| is_moved(of_pose, &parts));
            if moves(&poses.position_derivatives) || moves(&poses.rotation_derivatives) {
                let message = format!(
                    "the correction would depend on what the measurements do not determine: {}",
                    direction.describe()
                );
                return Err(Error::data(message).help(help));
            }
        }
    }
    Ok(())
}

/// Set-points all over the workspace: no knot, no symmetry and no ripple of an error meets them all.
const ANYWHERE: usize = 600;

/// Half of the range of an axis whose range is not known, mm and rad.
const UNKNOWN_RANGE: [f64; 2] = [500.0, std::f64::consts::PI];

/// The same for set-points all over the workspace and in both directions of travel, axes in these ranges where they are given.
pub fn check_confounded_anywhere(model: &dyn KinematicModel, calibration: &Calibration, ranges: &Ranges) -> Result<()> {
    check_confounded(model, calibration, &anywhere(model, ranges)?)
}

/// Statuses anywhere between the ends of all axes (sequence of Halton 1960), directions of approach in turn; all else as it is for data
/// without a column.
pub(crate) fn anywhere(model: &dyn KinematicModel, ranges: &Ranges) -> Result<Vec<f64>> {
    let info = model.info();
    let mut standing = Grid { poses: Some(vec![BTreeMap::new()]), ..Grid::default() }.statuses(model)?;
    standing.truncate(info.status.len());
    let ends = info.axes.iter().map(|axis| match (ranges.contains_key(&axis.name), axis.range) {
        (false, None) => {
            let half = UNKNOWN_RANGE[usize::from(axis.kind == AxisKind::Rotary)];
            Ok([-half, half])
        }
        _ => range_of(axis, ranges, "ranges").map(|(from, to)| [from, to].map(|end| end / position_unit(axis).1)),
    });
    let ends = ends.collect::<Result<Vec<[f64; 2]>>>()?;
    let mut statuses = Vec::with_capacity(ANYWHERE * standing.len());
    for point in 0..ANYWHERE {
        let mut status = standing.clone();
        for ((axis, [from, to]), base) in info.axes.iter().zip(&ends).zip(BASES.iter().cycle()) {
            // The first points are the ends themselves.
            let part = if point < 2 { point as f64 } else { van_der_corput(point, *base) };
            status[axis.status] = from + part * (to - from);
        }
        for (place, column) in info.status.iter().enumerate() {
            if let StatusRole::Direction(axis) = column.role {
                status[place] = if (point >> (axis % 8)) & 1 == 0 { 1.0 } else { -1.0 };
            }
        }
        statuses.extend(status);
    }
    Ok(statuses)
}

/// The first prime numbers.
const BASES: [usize; 10] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29];

/// The digits of a number behind the point, in reverse order (van der Corput 1935).
fn van_der_corput(mut number: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while number > 0 {
        digit /= base as f64;
        value += digit * (number % base) as f64;
        number /= base;
    }
    value
}

/// Whether the parts of a direction do not cancel in the motion of a pose.
fn is_moved(derivatives: &[[f64; 3]], parts: &[(usize, f64)]) -> bool {
    let (mut sum, mut sizes) = ([0.0; 3], 0_f64);
    for (derivative, (_, coefficient)) in derivatives.iter().zip(parts) {
        let part = derivative.map(|value| value * coefficient);
        sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        sizes += size(&part);
    }
    size(&sum) > CANCELLED * sizes
}

fn size(vector: &[f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}
