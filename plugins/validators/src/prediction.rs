//! Which rows an estimate can predict: those that do not change along a direction that its own data left open.

use std::collections::BTreeSet;

use abbe_core::{EquationIndex, Fit, Owner, Problem, Result, SetIndex, Unknown};

use crate::folds::own_unknown;

/// Size of a term, relative to the largest of its direction in any equation, below which it is rounding.
const ROUNDING: f64 = 1e-9;

/// Change of an equation along a direction, relative to the largest of its terms, below which these cancel. At recorded positions
/// they do so to first order in the errors of the machine only.
const CANCELS: f64 = 1e-2;

/// The terms of an equation along a direction, with the number of the direction and their columns.
type Terms = (EquationIndex, usize, Vec<(usize, f64)>);

/// The problem of a fit that predicts `observations`, on the rows that the fit can predict; a remark on the others.
pub fn predictable(fit: &Fit) -> Result<(Problem, Option<String>)> {
    let problem = fit.problem.as_ref();
    let lost = &fit.calibration.fit.null_space;
    if lost.is_empty() || !problem.unknowns.is_empty() {
        return Ok((problem.clone(), None));
    }
    let judged = Problem { unknowns: estimated(fit), ..problem.clone() };
    let names: Vec<&str> = judged.unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
    let directions: Vec<Vec<(usize, f64)>> = (lost.iter())
        .map(|direction| {
            let parts = direction.combination.iter();
            let column = |name: &str| names.iter().position(|other| *other == name);
            parts.filter_map(|part| Some((column(&part.name)?, part.coefficient))).collect()
        })
        .collect();
    let rows = judged.equation_rows();
    let mut terms: Vec<Terms> = Vec::new();
    judged.linearise(&judged.start(), |block| {
        for (equation, _, line) in block.lines() {
            for (number, direction) in directions.iter().enumerate() {
                let of_line = direction.iter().map(|&(column, change)| (column, line[column] * change));
                terms.push((equation, number, of_line.collect()));
            }
        }
    })?;
    let size = |terms: &[(usize, f64)]| terms.iter().fold(0.0_f64, |size, (_, term)| size.max(term.abs()));
    let mut largest = vec![0.0_f64; directions.len()];
    terms.iter().for_each(|(_, number, terms)| largest[*number] = largest[*number].max(size(terms)));
    let (mut open, mut along) = (BTreeSet::new(), BTreeSet::new());
    for (equation, number, mut terms) in terms {
        terms.retain(|(_, term)| term.abs() > ROUNDING * largest[number]);
        let total: f64 = terms.iter().map(|(_, term)| term).sum();
        if total.abs() > CANCELS * size(&terms) {
            open.insert(rows[equation]);
            along.extend(terms.iter().map(|(column, _)| *column));
        }
    }
    if open.is_empty() {
        return Ok((problem.clone(), None));
    }
    let mut predicted = problem.clone();
    for (index, set) in SetIndex::enumerate(&mut predicted.sets) {
        set.rows.retain(|&row| !open.contains(&(index, row)));
    }
    let along: Vec<&str> = along.into_iter().map(|column| names[column]).collect();
    let remark = format!(
        "{}: {} rows were not predicted, because its data do not determine what they depend on: {}",
        fit.name,
        open.len(),
        along.join(", ")
    );
    Ok((predicted, Some(remark)))
}

/// The unknowns of the predicted rows that the fit has estimated, or has left open.
fn estimated(fit: &Fit) -> Vec<Unknown> {
    let problem = fit.problem.as_ref();
    let parameters = problem.model.info().parameters.iter().enumerate();
    let machine = parameters.map(|(index, parameter)| Unknown {
        name: parameter.name.clone(),
        unit: parameter.unit,
        owner: Owner::Machine,
        index,
    });
    let own = SetIndex::enumerate(&problem.sets).flat_map(|(set, observed)| {
        (0..observed.info().unknowns.len()).map(move |index| own_unknown(problem, set, index))
    });
    let lost = fit.calibration.fit.null_space.iter().flat_map(|direction| &direction.combination);
    let lost: BTreeSet<&str> = lost.map(|part| part.name.as_str()).collect();
    let is_estimated = |unknown: &Unknown| {
        lost.contains(unknown.name.as_str()) || fit.calibration.covariance.order.contains(&unknown.name)
    };
    machine.chain(own).filter(is_estimated).collect()
}
