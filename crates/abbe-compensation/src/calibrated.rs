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

/// Part of the range of a load, or a temperature, by which it may be beyond those of the calibration without a word.
const BEYOND: f64 = 0.1;

/// Loads that are beyond those of the calibration by more than this many times their range are refused: another unit.
const FAR: f64 = 2.0;

/// Derivatives that differ by less than this part of themselves are the same.
const SAME: f64 = 1e-6;

/// Loads, temperatures and the like of set-points that are beyond those of the calibration
/// ([`FitReport::statuses`](abbe_core::FitReport::statuses)): for each of them the first point, and a sentence. What the tip does not
/// depend on by an estimated parameter is left out.
///
/// Fails for loads that are far beyond; the error names the point.
pub fn extrapolated(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    statuses: &[f64],
) -> Result<Vec<(usize, String)>> {
    let info = model.info();
    let width = info.status.len().max(1);
    let mut told = Vec::new();
    for (place, column) in info.status.iter().enumerate() {
        let Some(&[low, high]) = calibration.fit.statuses.get(&column.name) else { continue };
        let is_load = column.role == StatusRole::Load;
        // A load of zero bends nothing.
        let low = if is_load { low.min(0.0) } else { low };
        let range = high - low;
        let above = |value: f64| (value - high).max(low - value);
        let all = || statuses.chunks(width).map(|status| status[place]).enumerate();
        let worst = all().max_by(|one, other| above(one.1).total_cmp(&above(other.1)));
        let Some((worst, value)) = worst.filter(|(_, value)| range > 0.0 && above(*value) > BEYOND * range) else {
            continue;
        };
        let status = &statuses[worst * width..(worst + 1) * width];
        if !depends(model, calibration, status, place, value.clamp(low, high))? {
            continue;
        }
        let header = format!("{}{}", column.name, column.quantity.usual_suffix());
        let sentence = format!("`{header}` is {value}; the machine was measured from {low} to {high}");
        if is_load && above(value) > FAR * range {
            let help = "is the unit that of the column? else measure the machine with such a load";
            return Err(Error::data(sentence).help(help).at_pose(worst));
        }
        let first = all().find(|(_, value)| above(*value) > BEYOND * range).map_or(worst, |(point, _)| point);
        told.push((first, format!("{sentence}: corrections are extrapolated")));
    }
    Ok(told)
}

/// Whether a value of a status acts on the tip by an estimated parameter.
fn depends(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    status: &[f64],
    place: usize,
    other: f64,
) -> Result<bool> {
    let is_estimated = |name: &str| calibration.get(name).is_some_and(|known| known.status == Status::Estimated);
    let parameters = model.info().parameters.iter().enumerate();
    let wanted: Vec<Variable> = parameters
        .filter(|(_, parameter)| is_estimated(&parameter.name))
        .map(|(index, _)| Variable::Parameter(index))
        .collect();
    let mut both = [status, status].concat();
    both[status.len() + place] = other;
    let mut poses = Poses::default();
    model.poses(&both, &machine_values(model, calibration), &wanted, true, &mut poses)?;
    let differ = |list: &[[f64; 3]]| {
        let (one, other) = list.split_at(list.len() / 2);
        let apart = |(one, other): (&[f64; 3], &[f64; 3])| {
            let difference = [0, 1, 2].map(|axis| one[axis] - other[axis]);
            size(&difference) > SAME * size(one).max(size(other))
        };
        one.iter().zip(other).any(apart)
    };
    Ok(differ(&poses.position_derivatives) || differ(&poses.rotation_derivatives))
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
