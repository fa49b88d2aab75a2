//! Which errors make the volumetric error: what it would be without each of them.

use abbe_core::{Calibration, KinematicModel, ParameterRole, Poses, Result, Variable, machine_values};
use nalgebra::{DMatrix, DVector};

use crate::predict::machine_covariance;

/// Poses whose uncertainties are computed together.
const CHUNK: usize = 64;

/// A figure with its standard uncertainty, in the unit of the figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// The figure.
    pub value: f64,
    /// Its standard uncertainty, of first order (JCGM 100:2008, 5.1.2).
    pub uncertainty: f64,
}

/// The volumetric error of a workspace and its causes.
///
/// Only errors of the machine count: motion and location errors of axes and the shapes of their functions. What depends
/// on a set-up, as the offset of a tool, has its nominal value.
#[derive(Debug, Clone, PartialEq)]
pub struct Causes {
    /// Root mean square of the size of the error over all poses, mm.
    pub rms: Known,
    /// The largest size, mm.
    pub largest: Known,
    /// Number of the pose that has it.
    pub at: usize,
    /// Root mean square of the standard uncertainty of the error, mm: the part of the error that a correction by this
    /// calibration leaves at least.
    pub unknown: f64,
    /// One for each group of parameters that was asked for.
    pub causes: Vec<Cause>,
    /// For every pose the nominal tip in the table frame and the error, mm.
    pub field: Vec<([f64; 3], [f64; 3])>,
}

/// The part of a group of parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// By how much the root mean square falls if these parameters alone were nominal, mm. Negative for an error that
    /// compensates others. Such losses need not add up.
    pub loss: Known,
    /// Root mean square of the error if these parameters alone were nominal, mm.
    pub without: f64,
    /// Root mean square of the error if all others were nominal, mm.
    pub alone: f64,
}

/// Whether a parameter is an error of the machine.
pub fn is_machine_error(role: ParameterRole) -> bool {
    matches!(role, ParameterRole::Motion { .. } | ParameterRole::Location { .. } | ParameterRole::Shape)
}

/// The volumetric error at some poses and what groups of parameters contribute to it. `statuses` is rows x
/// [`status`](abbe_core::ModelInfo::status), row by row; a group lists indices of parameters of the model.
///
/// Fails where the model fails.
pub fn causes(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    statuses: &[f64],
    groups: &[Vec<usize>],
) -> Result<Causes> {
    let info = model.info();
    let counts = |index: usize| is_machine_error(info.parameters[index].role);
    let values = machine_errors(model, calibration);
    let (mut wanted, mut covariance) = machine_covariance(model, calibration);
    let parameter = |variable: &Variable| match variable {
        Variable::Parameter(index) => *index,
        Variable::Command(_) => usize::MAX,
    };
    // What does not count is nominal here, and known.
    for place in (0..wanted.len()).rev().filter(|place| !counts(parameter(&wanted[*place]))).collect::<Vec<_>>() {
        wanted.remove(place);
        covariance = covariance.remove_row(place).remove_column(place);
    }
    let (mut actual, mut nominal) = (Poses::default(), Poses::default());
    model.poses(statuses, &info.nominal, &[], false, &mut nominal)?;
    model.poses(statuses, &values, &wanted, false, &mut actual)?;
    let errors = differences(&actual, &nominal);
    let derivatives = || actual.position_derivatives.chunks_exact(wanted.len().max(1));
    let slopes = |errors: &[[f64; 3]], fixed: &[usize]| {
        let size = (rms(errors) * errors.len() as f64).max(f64::MIN_POSITIVE);
        let mut sums = vec![0.0; wanted.len()];
        for (error, by) in errors.iter().zip(derivatives()) {
            sums.iter_mut().zip(by).for_each(|(sum, by)| *sum += dot(error, by));
        }
        let is_fixed = |column: usize| fixed.contains(&parameter(&wanted[column]));
        DVector::from_fn(wanted.len(), |column, _| if is_fixed(column) { 0.0 } else { sums[column] / size })
    };
    let uncertainty = |slopes: &DVector<f64>| (&covariance * slopes).dot(slopes).max(0.0).sqrt();
    let total = rms(&errors);
    let all = slopes(&errors, &[]);
    let mut found = Vec::with_capacity(groups.len());
    let mut changed = Poses::default();
    for group in groups {
        let without: Vec<f64> = swapped(&values, &info.nominal, |index| group.contains(&index));
        model.poses(statuses, &without, &[], false, &mut changed)?;
        let left = differences(&changed, &nominal);
        let alone: Vec<f64> = swapped(&values, &info.nominal, |index| !group.contains(&index));
        model.poses(statuses, &alone, &[], false, &mut changed)?;
        let alone = rms(&differences(&changed, &nominal));
        let loss = Known { value: total - rms(&left), uncertainty: uncertainty(&(&all - slopes(&left, group))) };
        found.push(Cause { loss, without: rms(&left), alone });
    }
    let sizes = errors.iter().map(|error| dot(error, error).sqrt());
    let (at, largest) = sizes.enumerate().fold((0, 0.0), |most, one| if one.1 > most.1 { one } else { most });
    let variances = |poses: &[[f64; 3]]| -> f64 {
        let of_coordinates = 3 * poses.len() / wanted.len().max(1);
        let by = |column: usize, coordinate: usize| poses[coordinate / 3 * wanted.len() + column][coordinate % 3];
        let by = DMatrix::from_fn(wanted.len(), of_coordinates, by);
        let both = &covariance * &by;
        both.column_iter().zip(by.column_iter()).map(|(one, other)| one.dot(&other).max(0.0)).sum()
    };
    let variances: f64 = actual.position_derivatives.chunks((CHUNK * wanted.len()).max(1)).map(variances).sum();
    let at_largest = errors.get(at).map_or(0.0, |error| {
        let slopes = DVector::from_fn(wanted.len(), |column, _| {
            dot(error, &actual.position_derivatives[at * wanted.len() + column]) / largest.max(f64::MIN_POSITIVE)
        });
        uncertainty(&slopes)
    });
    Ok(Causes {
        rms: Known { value: total, uncertainty: uncertainty(&all) },
        largest: Known { value: largest, uncertainty: at_largest },
        at,
        unknown: (variances / errors.len().max(1) as f64).sqrt(),
        causes: found,
        field: nominal.positions.into_iter().zip(errors).collect(),
    })
}

/// Root mean square of the error at some poses, mm, if the parameters of a group alone were nominal: [`Cause::without`]. `statuses`
/// is rows x [`status`](abbe_core::ModelInfo::status), row by row; the group lists indices of parameters of the model.
///
/// Fails where the model fails.
pub fn rms_without(
    model: &dyn KinematicModel,
    calibration: &Calibration,
    statuses: &[f64],
    group: &[usize],
) -> Result<f64> {
    let (values, info) = (machine_errors(model, calibration), model.info());
    let (mut changed, mut nominal) = (Poses::default(), Poses::default());
    model.poses(statuses, &info.nominal, &[], false, &mut nominal)?;
    model.poses(
        statuses,
        &swapped(&values, &info.nominal, |index| group.contains(&index)),
        &[],
        false,
        &mut changed,
    )?;
    Ok(rms(&differences(&changed, &nominal)))
}

/// The values of the errors of the machine; all others are nominal.
fn machine_errors(model: &dyn KinematicModel, calibration: &Calibration) -> Vec<f64> {
    let (values, info) = (machine_values(model, calibration), model.info());
    swapped(&values, &info.nominal, |index| !is_machine_error(info.parameters[index].role))
}

/// The values, with nominal ones where `is_nominal`.
fn swapped(values: &[f64], nominal: &[f64], is_nominal: impl Fn(usize) -> bool) -> Vec<f64> {
    let both = values.iter().zip(nominal).enumerate();
    both.map(|(index, (value, nominal))| if is_nominal(index) { *nominal } else { *value }).collect()
}

fn differences(actual: &Poses, nominal: &Poses) -> Vec<[f64; 3]> {
    let both = actual.positions.iter().zip(&nominal.positions);
    both.map(|(actual, nominal)| [0, 1, 2].map(|part| actual[part] - nominal[part])).collect()
}

fn dot(one: &[f64; 3], other: &[f64; 3]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

/// Root mean square of the sizes.
fn rms(errors: &[[f64; 3]]) -> f64 {
    (errors.iter().map(|error| dot(error, error)).sum::<f64>() / errors.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{calibration, chain};
    use serde_json::json;

    fn machine() -> std::sync::Arc<dyn KinematicModel> {
        let errors = json!([{ "location": ["EC0Y"] }, { "polynomial": ["EXX", "EYY"], "degrees": [1] }]);
        chain("w b X Y Z t", json!({}), errors)
    }

    /// Points at X, Y = -100, 0, 100 with Z = 0: the closed form of one gain is its size times the RMS of the travel.
    fn grid() -> Vec<f64> {
        [-100.0, 0.0, 100.0].iter().flat_map(|x| [-100.0, 0.0, 100.0].map(|y| [*x, y, 0.0])).flatten().collect()
    }

    #[test]
    fn closed_form_of_two_independent_gains() {
        let (model, mut known) = (machine(), calibration(&[("EXX[1]", 3e-5), ("EYY[1]", -4e-5), ("dzt", 5.0)]));
        known.covariance.order = ["EXX[1]", "EYY[1]"].map(str::to_owned).to_vec();
        known.covariance.rows = vec![vec![1e-12, 0.0], vec![0.0, 4e-12]];
        let index = |name: &str| model.info().parameter(name).unwrap();
        let groups = [vec![index("EXX[1]")], vec![index("EYY[1]")], vec![index("EC0Y")]];
        let found = causes(model.as_ref(), &known, &grid(), &groups).unwrap();
        let travel = 100.0 * (2.0_f64 / 3.0).sqrt();
        let close = |one: f64, other: f64| assert!((one - other).abs() < 1e-9, "{one}, {other}");
        close(found.rms.value, 5e-5 * travel);
        // d(rms) = (3 dx + 4 dy) / 5 for gains of 3 and 4.
        close(found.rms.uncertainty, travel * (0.36 * 1e-12_f64 + 0.64 * 4e-12).sqrt());
        close(found.largest.value, 5e-3);
        close(found.unknown, travel * 5e-12_f64.sqrt());
        close(found.causes[0].loss.value, 1e-5 * travel);
        close(found.causes[1].loss.value, 2e-5 * travel);
        close(found.causes[0].alone, 3e-5 * travel);
        close(found.causes[1].without, 3e-5 * travel);
        // Without the first: d(loss) = 3/5 dx + (4/5 - 1) dy.
        close(found.causes[0].loss.uncertainty, travel * (0.36 * 1e-12_f64 + 0.04 * 4e-12).sqrt());
        assert_eq!(found.causes[2].loss, Known { value: 0.0, uncertainty: 0.0 });
        for (group, cause) in groups.iter().zip(&found.causes) {
            assert_eq!(rms_without(model.as_ref(), &known, &grid(), group).unwrap(), cause.without);
        }
    }

    /// The uncertainties are those of differences, on errors that interact.
    #[test]
    fn uncertainty_agrees_with_differences() {
        let values = [("EXX[1]", 3e-5), ("EYY[1]", -4e-5), ("EC0Y", 5e-5)];
        let (model, mut known) = (machine(), calibration(&values));
        let index = |name: &str| model.info().parameter(name).unwrap();
        let group = [vec![index("EC0Y")]];
        let factor = [2e-6, -1e-6, 3e-6];
        known.covariance.order = values.iter().map(|(name, _)| (*name).to_owned()).collect();
        known.covariance.rows = factor.iter().map(|a| factor.iter().map(|b| a * b).collect()).collect();
        let found = causes(model.as_ref(), &known, &grid(), &group).unwrap();
        let moved = |by: f64| {
            let values: Vec<(&str, f64)> =
                values.iter().zip(factor).map(|((name, value), factor)| (*name, value + by * factor)).collect();
            causes(model.as_ref(), &calibration(&values), &grid(), &group).unwrap()
        };
        let (up, down) = (moved(1e-3), moved(-1e-3));
        let slope = |of: fn(&Causes) -> f64| (of(&up) - of(&down)).abs() / 2e-3;
        for (known, difference) in [
            (found.rms.uncertainty, slope(|causes| causes.rms.value)),
            (found.largest.uncertainty, slope(|causes| causes.largest.value)),
            (found.causes[0].loss.uncertainty, slope(|causes| causes.causes[0].loss.value)),
        ] {
            assert!((known - difference).abs() < 2e-3 * difference, "{known}, {difference}");
        }
    }

    #[test]
    fn a_perfect_machine_has_no_causes() {
        let model = machine();
        let found = causes(model.as_ref(), &calibration(&[]), &grid(), &[vec![0]]).unwrap();
        assert_eq!((found.rms.value, found.largest.value, found.causes[0].loss.value), (0.0, 0.0, 0.0));
        assert!(found.rms.uncertainty.is_finite());
    }
}
