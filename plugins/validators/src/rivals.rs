//! Whether advice on residuals holds: what else explains them, and whether a drift does so in all blocks of time alike.

use std::collections::BTreeSet;

use abbe_core::{Fit, Owner, ParameterRole, Problem, Result, RowIndex, SetIndex, Status, Unknown};
use abbe_estimation::rank_point;
use abbe_numerics::{Accumulator, f_test};
use nalgebra::{DMatrix, DVector};

use crate::drift::{Explained, basis, beyond, explained, legendre, orthogonal, scaled_times};

/// Columns of further parameters that are tried; models with more of them are judged by those of the first errors.
const MOST: usize = 300;

/// Blocks of successive rows, each of which counts as one.
const BLOCKS: usize = 24;

/// Most numbers of a table of rows that is tested at once.
const LARGEST: usize = 4_000_000;

/// Fewest rows of a block.
const LEAST_ROWS: usize = 4;

/// An error of the model that is not estimated, and what it would explain.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// The error (`EYY`), or the parameter.
    pub name: String,
    /// Its parameters that are not estimated and that the fit cannot imitate.
    pub terms: usize,
    /// Part of the residuals' sum of squares that they would explain.
    pub share: f64,
    /// Probability of such a part by chance, for one error among all that were tried.
    pub p: f64,
}

/// What errors that the model has and the fit does not estimate would explain, the most first.
pub fn rivals(fit: &Fit, left_out: &BTreeSet<(SetIndex, RowIndex)>) -> Result<Vec<Rival>> {
    let problem = fit.problem.as_ref();
    let mut extended = Problem::clone(problem);
    let settled = |name: &str| fit.calibration.get(name).is_some_and(|found| found.status != Status::Fixed);
    for (index, parameter) in problem.model.info().parameters.iter().enumerate() {
        let is_error = matches!(parameter.role, ParameterRole::Motion { .. } | ParameterRole::Location { .. });
        if is_error && !settled(&parameter.name) && extended.unknowns.len() < problem.unknowns.len() + MOST {
            let (name, unit) = (parameter.name.clone(), parameter.unit);
            extended.unknowns.push(Unknown { name, unit, owner: Owner::Machine, index });
        }
    }
    let (own, all) = (problem.unknowns.len(), extended.unknowns.len());
    if all == own {
        return Ok(Vec::new());
    }
    let (rows, uncertainties) = (problem.equation_rows(), problem.standard_uncertainties());
    let residuals = problem.residuals(&problem.values_of(&fit.calibration))?;
    let mut accumulator = Accumulator::new(all + 1, rows.len());
    let contact = in_contact(&extended, fit)?;
    contact.linearise(&contact.start(), |block| {
        for (equation, _, line) in block.lines() {
            if !left_out.contains(&rows[equation]) {
                accumulator.push(&[line, &[residuals[equation]]].concat(), 0.0, 1.0 / uncertainties[equation]);
            }
        }
    })?;
    let factor = accumulator.finish();
    let columns: Vec<DVector<f64>> = (0..=all).map(|column| DVector::from_vec(factor.column(column))).collect();
    if columns.iter().flatten().any(|entry| !entry.is_finite()) {
        return Ok(Vec::new());
    }
    let jacobian = basis(columns[..own].iter().map(DVector::as_view), 1e-10);
    let rest = orthogonal(columns[all].as_view(), &jacobian);
    let freedom = factor.rows().saturating_sub(jacobian.ncols());
    let error = |index: usize| {
        let name = extended.unknowns[index].name.as_str();
        name.split_once('[').map_or(name, |(error, _)| error)
    };
    let mut names: Vec<&str> = (own..all).map(error).collect();
    names.dedup();
    let mut found = Vec::new();
    for name in &names {
        let new = (own..all).filter(|&index| error(index) == *name).map(|index| columns[index].as_view());
        let Some(Explained { terms, share, p, .. }) = explained(&beyond(new, &jacobian), &rest, freedom) else {
            continue;
        };
        found.push(Rival { name: (*name).to_owned(), terms, share, p: (p * names.len() as f64).min(1.0) });
    }
    found.sort_by(|one, other| other.share.total_cmp(&one.share));
    Ok(found)
}

/// A problem at the values of a fit, its rows in nominal contact: where they were recorded, the derivatives have a part of the residuals in
/// them, which a direction that is lost would explain by themselves.
fn in_contact(problem: &Problem, fit: &Fit) -> Result<Problem> {
    let at = problem.with_values(&problem.values_of(&fit.calibration));
    rank_point(&at, &at.start())
}

/// Probability that a drift of a parameter explains as much by chance, where successive rows need not be independent: the Wald test
/// with a covariance of sums over blocks of time (Liang & Zeger 1986), each of which counts as one.
///
/// Errors that a model lacks change from indexation to indexation, and so with time; within a block they make all residuals alike, which a
/// test that takes rows for independent mistakes for a drift. None where there are too few blocks to tell.
pub fn by_blocks(fit: &Fit, left_out: &BTreeSet<(SetIndex, RowIndex)>, parameter: &str) -> Result<Option<f64>> {
    let problem = fit.problem.as_ref();
    let rows = problem.equation_rows();
    let (Some(times), Some(index)) = (scaled_times(problem, &rows), problem.model.info().parameter(parameter)) else {
        return Ok(None);
    };
    let mut extended = Problem::clone(problem);
    let known = extended.unknowns.iter().position(|unknown| unknown.name == parameter);
    let column = known.unwrap_or(extended.unknowns.len());
    if known.is_none() {
        let (name, unit) = (parameter.to_owned(), problem.model.info().parameters[index].unit);
        extended.unknowns.push(Unknown { name, unit, owner: Owner::Machine, index });
    }
    let (own, width) = (problem.unknowns.len(), extended.unknowns.len());
    let uncertainties = problem.standard_uncertainties();
    if rows.len() * width > LARGEST {
        return Ok(None);
    }
    // Rows of [J | time terms | r] with their times.
    let residuals = problem.residuals(&problem.values_of(&fit.calibration))?;
    let mut lines: Vec<(f64, Vec<f64>)> = Vec::new();
    let contact = in_contact(&extended, fit)?;
    contact.linearise(&contact.start(), |block| {
        for (equation, _, line) in block.lines() {
            if left_out.contains(&rows[equation]) || times[equation].is_nan() {
                continue;
            }
            let terms = legendre(times[equation]).map(|value| value * line[column]);
            let all = line[..own].iter().chain(&terms).chain([&residuals[equation]]);
            lines.push((times[equation], all.map(|value| value / uncertainties[equation]).collect()));
        }
    })?;
    lines.sort_by(|one, other| one.0.total_cmp(&other.0));
    Ok(wald(&lines, own))
}

/// The test on rows `[J | terms | r]` in the order of time.
fn wald(lines: &[(f64, Vec<f64>)], own: usize) -> Option<f64> {
    let width = lines.first()?.1.len();
    let matrix = DMatrix::from_fn(lines.len(), width, |row, column| lines[row].1[column]);
    if matrix.iter().any(|entry| !entry.is_finite()) {
        return None;
    }
    let jacobian = basis(matrix.columns(0, own).column_iter(), 1e-10);
    let terms = beyond((own..width - 1).map(|column| matrix.column(column)), &jacobian);
    let rest = orthogonal(matrix.column(width - 1), &jacobian);
    let (count, blocks) = (terms.ncols(), BLOCKS.min(lines.len() / LEAST_ROWS));
    if count == 0 || blocks <= 2 * count {
        return None;
    }
    // The terms are orthonormal: their coefficients are projections, and the middle of the sandwich is all of it.
    let size = terms.transpose() * &rest;
    let left = &rest - &terms * &size;
    let mut scatter = DMatrix::zeros(count, count);
    for block in 0..blocks {
        let (from, to) = (block * lines.len() / blocks, (block + 1) * lines.len() / blocks);
        let own = terms.rows(from, to - from);
        // As the regression without this block would leave it (the jackknife of Bell & McCaffrey 2002).
        let without = DMatrix::identity(count, count) - own.transpose() * own;
        let sum = without.lu().solve(&(own.transpose() * left.rows(from, to - from)))?;
        scatter += &sum * sum.transpose();
    }
    let statistic = size.dot(&scatter.lu().solve(&size)?) / count as f64;
    f_test(statistic * (blocks - count) as f64 / blocks as f64, count, blocks - count)
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Rows over time: a constant, four terms, and residuals of a drift, of steps that last a while, and of noise.
    fn rows(seed: u64, drift: f64, steps: f64) -> Vec<(f64, Vec<f64>)> {
        let mut random = Generator::new(seed, 0);
        let mut step = 0.0;
        (0..480)
            .map(|row| {
                let t = f64::from(row) / 240.0 - 1.0;
                if row % 12 == 0 {
                    step = steps * random.normal();
                }
                let terms = legendre(t);
                let residual = drift * (terms[0] + 0.5 * terms[1]) + step + random.normal();
                (t, [&[1.0][..], &terms, &[residual]].concat())
            })
            .collect()
    }

    #[test]
    fn steps_of_a_model_that_lacks_errors_are_no_drift() {
        let below = |drift: f64, steps: f64| {
            (0..400).filter(|&seed| wald(&rows(seed, drift, steps), 1).expect("blocks") < 1e-2).count()
        };
        // By chance one in a hundred, with steps ten times the noise as well; a drift as large as the noise is always seen.
        let (noise, steps, drift) = (below(0.0, 0.0), below(0.0, 10.0), below(1.0, 0.0));
        println!("below 0.01: {noise} with noise, {steps} with steps, {drift} with a drift, of 400");
        assert!(noise <= 16 && steps <= 24 && drift == 400, "{noise} {steps} {drift}");
    }
}
