//! From the solution of a problem to a calibration: every parameter with its value, unit, uncertainty and status.

use abbe_core::{
    CALIBRATION_FORMAT, Calibration, ConsideredInput, Estimated, FitReport, NamedCovariance, Outlier, Owner, Problem,
    SetIndex, Status, Unit, Unknown,
};

/// Makes the calibration from a solution: `x` in the order of the unknowns, and the covariance of the unknowns followed by
/// the considered quantities.
pub fn calibration(
    problem: &Problem,
    x: &[f64],
    covariance: Vec<Vec<f64>>,
    outliers: Vec<Outlier>,
    fit: FitReport,
) -> Calibration {
    let considered = &problem.considered.unknowns;
    let lost = |name: &str| fit.null_space.iter().any(|vector| vector.combination.iter().any(|part| part.name == name));
    let estimated = |owner: Owner, index: usize, name: String, unit: Unit, fixed: f64| {
        let place = |unknowns: &[Unknown]| match owner {
            Owner::Machine => problem.place_among(index, unknowns).map(|(place, _)| place),
            _ => unknowns.iter().position(|unknown| unknown.owner == owner && unknown.index == index),
        };
        let uncertainty = |column: usize| covariance[column][column].max(0.0).sqrt();
        let (chosen, known) = (place(&problem.unknowns), place(considered));
        let (value, standard_uncertainty, status) = match (chosen, known) {
            (Some(column), _) => {
                let status = if lost(&problem.unknowns[column].name) { Status::Confounded } else { Status::Estimated };
                (x[column], uncertainty(column), status)
            }
            (None, Some(known)) => (fixed, uncertainty(problem.unknowns.len() + known), Status::Considered),
            (None, None) => (fixed, 0.0, Status::Fixed),
        };
        Estimated { name, value, unit: unit.to_string(), standard_uncertainty, status }
    };
    let parameters = problem.model.info().parameters.iter().enumerate();
    let parameters = parameters.map(|(index, parameter)| {
        estimated(Owner::Machine, index, parameter.name.clone(), parameter.unit, problem.machine_values[index])
    });
    let mut artefacts = Vec::new();
    for (set, observations) in SetIndex::enumerate(&problem.sets) {
        for (index, own) in observations.observations.info().unknowns.iter().enumerate() {
            let name = format!("{}.{}", observations.name, own.name);
            artefacts.push(estimated(Owner::Set(set), index, name, own.unit, observations.own[index]));
        }
    }
    // A tied unknown that has the name of a member stands among the parameters.
    let is_own = |unknown: &&Unknown| match unknown.owner {
        Owner::Tie => problem.model.info().parameter(&unknown.name).is_none(),
        owner => owner == Owner::Input,
    };
    let of_ties = problem.unknowns.iter().filter(|unknown| unknown.owner == Owner::Tie);
    for unknown in of_ties.chain(considered).filter(is_own) {
        let value = problem.value_of(unknown);
        artefacts.push(estimated(unknown.owner, unknown.index, unknown.name.clone(), unknown.unit, value));
    }
    let mut calibration = Calibration {
        abbe_calibration: CALIBRATION_FORMAT,
        estimate: problem.name.clone(),
        model: problem.model_record(),
        parameters: parameters.collect(),
        artefacts,
        covariance: NamedCovariance {
            order: problem
                .unknowns
                .iter()
                .chain(&problem.considered.unknowns)
                .map(|unknown| unknown.name.clone())
                .collect(),
            rows: covariance,
        },
        inputs: None,
        data: Vec::new(),
        outliers,
        fit,
        uncertainty: None,
        monte_carlo: None,
        group: None,
    };
    problem.untie(&mut calibration);
    calibration.inputs = Some(considered_inputs(problem, &calibration.covariance.rows));
    calibration
}

/// The inputs that are considered. Since they are independent of each other, the covariance of a value with an input is
/// its sensitivity times the variance of the input.
fn considered_inputs(problem: &Problem, covariance: &[Vec<f64>]) -> Vec<ConsideredInput> {
    let considered = &problem.considered;
    let all = considered.unknowns.iter().zip(&considered.identities).enumerate();
    let input = |(index, (unknown, identity)): (usize, (&Unknown, &Option<String>))| {
        let (column, variance) = (problem.unknowns.len() + index, considered.covariance[index][index]);
        Some(ConsideredInput {
            name: unknown.name.clone(),
            identity: identity.clone()?,
            value: problem.value_of(unknown),
            unit: unknown.unit.to_string(),
            standard_uncertainty: variance.sqrt(),
            sensitivities: covariance.iter().map(|row| row[column] / variance).collect(),
        })
    };
    all.filter_map(input).collect()
}
