//! Regression diagnostics and the selection of terms by their significance (Soons 1993, section 3.2.2; Montgomery & Peck 1982).

use crate::linear::{DesignMatrix, LinearFit, fit_linear};
use crate::significance::f_test;

/// What each row does to a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Influence {
    /// Residuals over their own standard deviations.
    pub studentised: Vec<f64>,
    /// The same, with the standard deviation from the other rows only; infinite if these fit exactly.
    pub deleted: Vec<f64>,
    /// Cook's distance: how far the fitted values move together when the row is left out, squared, per coefficient and variance.
    pub cook: Vec<f64>,
}

impl Influence {
    /// The influence of the rows of a fit. A row that the fit goes through by itself (leverage 1) has none to tell: NaN.
    pub fn new(fit: &LinearFit) -> Self {
        let (variance, freedom, count) = (fit.variance(), fit.degrees_of_freedom() as f64, fit.values.len() as f64);
        let rows = || fit.residuals.iter().zip(&fit.leverages);
        let studentised: Vec<f64> =
            rows().map(|(residual, leverage)| residual / (variance * (1.0 - leverage)).sqrt()).collect();
        let deleted = |size: &f64| size * ((freedom - 1.0) / (freedom - size * size).max(0.0)).sqrt();
        Self {
            deleted: studentised.iter().map(deleted).collect(),
            cook: rows()
                .zip(&studentised)
                .map(|((_, leverage), size)| size * size * leverage / (count * (1.0 - leverage)))
                .collect(),
            studentised,
        }
    }
}

/// Centres a column on its mean and scales it to length 1; None if it is constant. Sums of products of such columns are
/// correlations.
pub fn unit_length(column: &[f64]) -> Option<Vec<f64>> {
    let mean = column.iter().sum::<f64>() / column.len() as f64;
    let length = column.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>().sqrt();
    let varies = length > f64::EPSILON * mean.abs() * (column.len() as f64).sqrt();
    (varies && length.is_finite()).then(|| column.iter().map(|value| (value - mean) / length).collect())
}

/// In which direction terms are selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// Starting from none, terms come in.
    Forward,
    /// Starting from all, terms go out.
    Backward,
    /// Starting from none, terms come in and may go out again.
    Both,
}

/// A step of a selection.
#[derive(Debug, Clone, PartialEq)]
pub struct SelectionStep {
    /// Index of the term.
    pub term: usize,
    /// Whether it came in or went out.
    pub entered: bool,
    /// Probability that chance alone makes it look as significant.
    pub probability: f64,
}

/// Terms chosen by their significance.
#[derive(Debug, Clone, PartialEq)]
pub struct StepwiseSelection {
    /// Indices of the kept terms, ascending.
    pub kept: Vec<usize>,
    /// How it went.
    pub steps: Vec<SelectionStep>,
}

/// Stepwise regression of `right` on `terms` (columns): a term comes in while chance explains it with a probability below
/// `level`, and goes out while with one above it (partial F test). `always` stay in whatever their significance.
///
/// None if the terms that are there at the start cannot be separated.
pub fn stepwise(
    terms: &[Vec<f64>],
    right: &[f64],
    always: &[usize],
    level: f64,
    direction: Direction,
) -> Option<StepwiseSelection> {
    let mut kept: Vec<usize> = match direction {
        Direction::Backward => (0..terms.len()).collect(),
        _ => always.to_vec(),
    };
    kept.sort_unstable();
    let cost = |kept: &[usize]| -> Option<f64> {
        let rows: Vec<Vec<f64>> =
            (0..right.len()).map(|row| kept.iter().map(|&term| terms[term][row]).collect()).collect();
        Some(fit_linear(&DesignMatrix::new(&rows), right)?.cost())
    };
    // The probability of a term: `with` and `without` it, `count` terms with it.
    let probability = |with: f64, without: f64, count: usize| -> Option<f64> {
        let freedom = right.len().checked_sub(count).filter(|freedom| *freedom > 0)?;
        let f = (without - with) / (with / freedom as f64);
        if f.is_finite() { f_test(f, 1, freedom) } else { Some(if without > with { 0.0 } else { 1.0 }) }
    };
    let mut own = cost(&kept)?;
    let mut steps: Vec<SelectionStep> = Vec::new();
    let mut seen = vec![kept.clone()];
    loop {
        let mut next: Option<(SelectionStep, Vec<usize>, f64)> = None;
        if direction != Direction::Forward {
            for &term in kept.iter().filter(|term| !always.contains(term)) {
                let others: Vec<usize> = kept.iter().copied().filter(|other| *other != term).collect();
                let Some(without) = cost(&others) else { continue };
                let Some(probability) = probability(own, without, kept.len()) else { continue };
                let least = next.as_ref().is_none_or(|(step, ..)| probability > step.probability);
                if probability > level && least {
                    next = Some((SelectionStep { term, entered: false, probability }, others, without));
                }
            }
        }
        if direction != Direction::Backward && next.is_none() {
            for term in (0..terms.len()).filter(|term| !kept.contains(term)) {
                let mut all = [&kept[..], &[term]].concat();
                all.sort_unstable();
                let Some(with) = cost(&all) else { continue };
                let Some(probability) = probability(with, own, all.len()) else { continue };
                // Of several that are beyond doubt the one that explains most.
                let most = next.as_ref().is_none_or(|(_, _, cost)| with < *cost);
                if probability < level && most {
                    next = Some((SelectionStep { term, entered: true, probability }, all, with));
                }
            }
        }
        let Some((step, terms, cost)) = next.filter(|(_, terms, _)| !seen.contains(terms)) else { break };
        steps.push(step);
        seen.push(terms.clone());
        (kept, own) = (terms, cost);
    }
    Some(StepwiseSelection { kept, steps })
}
