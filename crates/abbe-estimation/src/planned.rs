//! Rows of a plan that nobody has measured, among those that were.

use std::collections::BTreeMap;

use abbe_core::{Contact, Problem};
use abbe_numerics::LeastSquares;

use crate::weighted::Weighted;

/// How near to nominal contact, mm, a row is that was computed and not measured, as files have it.
const COMPUTED: f64 = 1e-4;

/// Least number of such rows, and least part of all, that is told.
const FEW: usize = 5;
const PART: f64 = 0.05;

/// How many times as many miss by zero as by any other distance, where some were computed. Without them they are as many, in coarse
/// readings, too.
const TIMES: usize = 3;

/// Residuals in standard uncertainties that data without noise leave at most, products of errors included.
const EXACT: f64 = 0.2;

/// Rows where the nominal machine would touch: they say that the machine has no errors, and others say that it has.
///
/// A plan as a whole is looked at before it is measured, and data without noise may have rows on which no error acts: both agree with
/// themselves and get no word.
pub(crate) fn planned(problem: &Problem) -> Vec<String> {
    let Ok(residuals) = problem.residuals(&problem.start()) else { return Vec::new() };
    let mut told = Vec::new();
    for (set, range) in problem.sets.iter().zip(problem.equation_ranges()) {
        let own = &residuals[range];
        let near = own.iter().filter(|residual| residual.abs() <= COMPUTED).count();
        let is_part = (FEW..own.len()).contains(&near) && near as f64 >= PART * own.len() as f64;
        if set.info().contact == Contact::LinearAxes && is_part && near > TIMES * most_alike(own) {
            told.push(format!(
                "{}: {near} of {} rows touch where a machine without errors would, to 0.1 µm, and the others do not: were these \
                 measured, or are they positions of a plan?",
                set.name,
                own.len()
            ));
        }
    }
    if told.is_empty() || agrees(problem) { Vec::new() } else { told }
}

/// Most residuals that are alike within the width of those that count as computed, these left out.
fn most_alike(residuals: &[f64]) -> usize {
    let mut alike = BTreeMap::new();
    for residual in residuals.iter().filter(|residual| residual.abs() > COMPUTED && residual.is_finite()) {
        *alike.entry((residual / (2.0 * COMPUTED)).round() as i64).or_insert(0) += 1;
    }
    alike.into_values().max().unwrap_or(0)
}

/// Whether all rows agree with errors that the machine may have, to far less than their uncertainties.
fn agrees(problem: &Problem) -> bool {
    let rest = || {
        let weighted = Weighted::new(problem).ok()?;
        let free = weighted.rows().saturating_sub(weighted.unknowns());
        let factor = weighted.factor(&problem.start(), None).ok()?;
        Some((factor.remaining_cost() / free.max(1) as f64).sqrt())
    };
    rest().is_none_or(|rest| rest < EXACT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarse_readings_are_alike_everywhere() {
        let coarse: Vec<f64> = (0..100).map(|row| f64::from(row % 10 - 5) * 1e-3).collect();
        assert_eq!(most_alike(&coarse), 10);
        assert_eq!(most_alike(&[0.0, 5e-5, f64::NAN]), 0);
    }
}
