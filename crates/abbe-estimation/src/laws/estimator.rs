//! Laws of estimators.

use abbe_core::{Calibration, Class, Estimate, Problem, Result, Status};

use super::virtual_machine::{Measurement, measured};

/// Largest admissible effect of a deviation of an estimated value on any equation, mm or rad: a thousandth of a micrometre.
const ALLOWED: f64 = 1e-6;

/// By how much, relative to itself, a standard uncertainty may differ from the root of its variance.
const ROUNDING: f64 = 1e-9;

/// The laws that an estimator of measurements breaks, on problems of a virtual machine whose solutions are known; empty if it
/// keeps them:
///
/// - from exact data the errors of the machine are found to the nanometre, for any order of the rows, any zero of the axes,
///   and any unknown position of the artefact;
/// - a second run gives the same bytes;
/// - every unknown has a value, with the uncertainty of the covariance.
///
/// Fails if the estimator refuses such problems because it is not made for them.
pub fn check_estimator(estimator: &dyn Estimate) -> Result<Vec<String>> {
    let usual = Measurement::default();
    let measurements = [
        ("a virtual machine", usual),
        ("rows in the opposite order", Measurement { reversed: true, ..usual }),
        ("axes with their zero elsewhere", Measurement { origin: [700.0, -300.0, 450.0], ..usual }),
        (
            "an artefact that lies anywhere",
            Measurement { placement: Some([3.0, -2.0, 5.0, 0.02, -0.03, 0.25]), ..usual },
        ),
    ];
    let (mut broken, mut solved) = (Vec::new(), 0);
    for (what, measurement) in measurements {
        match measured(&measurement).and_then(|(problem, solution)| check_estimate(estimator, &problem, &solution)) {
            Err(error) if error.class == Class::Use && solved == 0 => return Err(error),
            Ok(found) => broken.extend(found.into_iter().map(|law| format!("{what}: {law}"))),
            Err(error) => broken.push(format!("{what}: it fails: {error}")),
        }
        solved += 1;
    }
    Ok(broken)
}

/// The laws that an estimator breaks on one problem with exact data that determine all unknowns. `solution` is the known
/// solution, in the order of the unknowns.
///
/// Fails as the estimator does.
pub fn check_estimate(estimator: &dyn Estimate, problem: &Problem, solution: &[f64]) -> Result<Vec<String>> {
    let found = estimator.estimate(problem)?;
    let mut broken = Vec::new();
    if found.to_json()? != estimator.estimate(problem)?.to_json()? {
        broken.push("a second run gives another calibration".to_owned());
    }
    // The start is almost right, as it is when Monte Carlo asks for values.
    let values = estimator.values(&problem.with_values(&problem.values_of(&found)))?;
    if values.len() != solution.len() {
        broken.push(format!("it gives {} values for {} unknowns", values.len(), solution.len()));
        return Ok(broken);
    }
    let sizes = largest_derivatives(problem, solution)?;
    for ((unknown, &expected), (size, value)) in problem.unknowns.iter().zip(solution).zip(sizes.iter().zip(values)) {
        let name = &unknown.name;
        let Some(estimated) = found.get(name).filter(|estimated| estimated.status == Status::Estimated) else {
            broken.push(format!("`{name}` is not estimated"));
            continue;
        };
        for value in [estimated.value, value] {
            let off = (value - expected) * size;
            if off.is_nan() || off.abs() > ALLOWED {
                broken.push(format!("`{name}` is {value:e}, and {expected:e} was put in"));
                break;
            }
        }
        broken.extend(uncertainty(&found, name, estimated.standard_uncertainty));
    }
    let identified = estimator.identify(problem)?;
    if (identified.rank, identified.unknowns) != (solution.len(), solution.len()) {
        let (rank, unknowns) = (identified.rank, identified.unknowns);
        broken.push(format!(
            "it finds a rank of {rank} for {unknowns} unknowns; {0} of {0} are determined",
            solution.len()
        ));
    }
    Ok(broken)
}

/// Whether an uncertainty is that of the covariance.
fn uncertainty(calibration: &Calibration, name: &str, stated: f64) -> Option<String> {
    let found = calibration.covariance.variance(name).map(f64::sqrt);
    match found {
        Some(found) if (found - stated).abs() <= ROUNDING * stated => None,
        Some(found) => Some(format!("`{name}` has the uncertainty {stated:e}, and {found:e} by the covariance")),
        None => Some(format!("`{name}` has no covariance")),
    }
}

/// The largest absolute derivative of an equation to each unknown at `x`, mm or rad per unit of the unknown: the largest
/// effect of the unknown on an equation.
///
/// Fails where the machine has no pose in a row.
pub fn largest_derivatives(problem: &Problem, x: &[f64]) -> Result<Vec<f64>> {
    let mut sizes = vec![0.0_f64; x.len()];
    problem.linearise(x, |block| {
        for line in block.jacobian.chunks_exact(sizes.len().max(1)) {
            sizes.iter_mut().zip(line).for_each(|(size, by)| *size = size.max(by.abs()));
        }
    })?;
    Ok(sizes)
}

#[cfg(test)]
mod tests {
    use abbe_core::SetIndex;

    use super::*;
    use crate::laws::check_observations;

    #[test]
    fn the_virtual_measurements_keep_the_laws_and_hold_at_their_solutions() {
        let placed = Some([3.0, -2.0, 5.0, 0.02, -0.03, 0.25]);
        for placement in [None, placed] {
            for origin in [[0.0; 3], [700.0, -300.0, 450.0]] {
                let (problem, solution) = measured(&Measurement { placement, origin, reversed: false }).unwrap();
                assert_eq!(
                    check_observations(&problem.with_values(&solution), SetIndex(0)).unwrap(),
                    Vec::<String>::new()
                );
                let residuals = problem.residuals(&solution).unwrap();
                assert!(residuals.iter().all(|residual| residual.abs() < 1e-11), "{residuals:?}");
            }
        }
    }
}
