//! Worn artefact or worn machine: whether one shared input, such as the length of a bar, explains what has changed.
//!
//! A wrong input shifts all parameters in the ratio of their sensitivities to it. If such a shift explains the differences
//! of all parameters within their uncertainties, the artefact has changed, unless the machine happens to do just the same.
//!
//! The recipe states the same value before and after. An artefact that has grown is then stated too small, so that parameters
//! move against their sensitivities.

use abbe_numerics::chi_squared_upper_tail;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::change::Uncertain;

/// An input that all tests share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SharedInput {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Sensitivity of every series to it; zero where there is none.
    pub sensitivities: Vec<f64>,
}

/// Differences of parameters between two times, with their covariance (what both times share left out).
#[derive(Debug, Clone, PartialEq)]
pub struct Differences {
    /// Indices of the series.
    pub series: Vec<usize>,
    /// The differences.
    pub values: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
}

/// An input that explains a change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Explained {
    /// Name of the input.
    pub input: String,
    /// Its unit.
    pub unit: String,
    /// The change of the artefact itself that would do it, while what is stated of it stays.
    pub change: Uncertain,
    /// Probability that what it leaves is chance.
    pub probability: f64,
}

/// Parameters that have to differ clearly, so that their ratio says something.
const CLEAR: usize = 2;

/// The input that explains differences best, if what it leaves is chance with a probability of at least `accepted`. None where
/// fewer than two parameters differ by more than three standard uncertainties.
pub fn explained_by(differences: &Differences, inputs: &[SharedInput], accepted: f64) -> Option<Explained> {
    let values = &differences.values;
    let clear = |index: &usize| values[*index].abs() > 3.0 * differences.covariance[(*index, *index)].max(0.0).sqrt();
    if (0..values.len()).filter(clear).count() < CLEAR {
        return None;
    }
    let factor = differences.covariance.clone().cholesky()?;
    let all = values.dot(&factor.solve(values));
    let explain = |input: &SharedInput| {
        let sensitivity = DVector::from_iterator(
            values.len(),
            differences.series.iter().map(|series| input.sensitivities.get(*series).copied().unwrap_or(0.0)),
        );
        let weighted = factor.solve(&sensitivity);
        let (weight, product) = (sensitivity.dot(&weighted), values.dot(&weighted));
        if weight <= 0.0 || weight.is_nan() {
            return None;
        }
        let left = (all - product * product / weight).max(0.0);
        Some(Explained {
            input: input.name.clone(),
            unit: input.unit.clone(),
            change: (-product / weight, 1.0 / weight.sqrt()).into(),
            probability: chi_squared_upper_tail(left, values.len() as f64 - 1.0),
        })
    };
    let best = inputs.iter().filter_map(explain).max_by(|one, other| one.probability.total_cmp(&other.probability))?;
    (best.probability >= accepted).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn differences(values: [f64; 3]) -> Differences {
        Differences {
            series: vec![0, 1, 2],
            values: DVector::from_row_slice(&values),
            covariance: DMatrix::from_diagonal_element(3, 3, 0.01),
        }
    }

    #[test]
    fn a_bar_shifts_all_scales_alike_and_an_axis_does_not() {
        let bar = SharedInput { name: "bar".into(), unit: "mm".into(), sensitivities: vec![2.0, 2.0, 2.0] };
        let found = explained_by(&differences([2.05, 1.96, 2.01]), std::slice::from_ref(&bar), 0.01).unwrap();
        // Scales that have grown: the bar has become shorter.
        assert!((found.change.value + 1.0033).abs() < 1e-3 && found.probability > 0.5);
        assert!((found.change.standard_uncertainty - 0.1 / 12f64.sqrt()).abs() < 1e-12);
        // One scale alone, or scales against each other, are the machine.
        assert_eq!(explained_by(&differences([2.0, 0.0, 0.0]), std::slice::from_ref(&bar), 0.01), None);
        assert_eq!(explained_by(&differences([2.0, -2.0, 2.0]), &[bar], 0.01), None);
    }
}
