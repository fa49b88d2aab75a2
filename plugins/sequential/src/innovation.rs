//! Whether new rows agree with what was known: the test of the innovation, and what disagrees.

use abbe_core::{CombinedAgreement, Result};
use abbe_numerics::{Accumulator, CovarianceRoot, chi_squared_upper_tail};
use nalgebra::DMatrix;

use crate::stack::{Stack, row_name};

/// A row at the solution: residual, derivatives to all states and inputs.
struct Row {
    residual: f64,
    line: Vec<f64>,
}

/// The test of new rows against what was known.
pub struct Innovation {
    /// Chi-squared, degrees of freedom, probability.
    pub agreement: CombinedAgreement,
    /// What, if it alone were wrong or had changed, would make chi-squared smallest, and how small; none if nothing is off.
    pub suspect: Option<Suspect>,
}

/// What may be wrong.
pub struct Suspect {
    /// In words.
    pub name: String,
    /// Whether it is a known parameter, and no new row.
    pub is_known: bool,
    /// Chi-squared without it.
    pub without: f64,
}

impl Innovation {
    /// The test at a solution `z`.
    ///
    /// The innovation is what new rows read beside what was expected, `v = r(m)`; its covariance is that of the rows, of what is
    /// known and of the inputs that both share. `v^T V^-1 v` is the least sum of squares over states and errors of inputs, each
    /// input known by its uncertainty: it is computed so, since V may be large. States of which nothing was known take their
    /// part of it, and of the degrees of freedom.
    pub fn new(stack: &Stack<'_>, z: &[f64]) -> Result<Self> {
        let (states, inputs) = (z.len(), &stack.states.inputs);
        let mut rows = Vec::new();
        stack.each_row(z, |residual, line, scatters| {
            let mut line = line.to_vec();
            if !scatters {
                // The uncertainty of a certificate is the weight of its row already.
                line[states..].fill(0.0);
            }
            rows.push(Row { residual, line });
        })?;
        let measured = rows.len() - stack.known();
        for (input, (_, uncertainty)) in inputs.iter().enumerate() {
            let mut line = vec![0.0; states + inputs.len()];
            line[states + input] = 1.0 / uncertainty;
            rows.push(Row { residual: 0.0, line });
        }
        let count = states + inputs.len();
        let mut accumulator = Accumulator::new(count, rows.len());
        rows.iter().for_each(|row| accumulator.push(&row.line, row.residual, 1.0));
        let factor = accumulator.finish();
        let chi_squared = factor.remaining_cost();
        let degrees_of_freedom = (measured + stack.known()).saturating_sub(states);
        let probability = match degrees_of_freedom {
            0 => 1.0,
            freedom => chi_squared_upper_tail(chi_squared, freedom as f64),
        };
        let agreement = CombinedAgreement { chi_squared, degrees_of_freedom, probability };
        // With one degree of freedom all are as suspect.
        let suspect = match factor.step().filter(|_| degrees_of_freedom > 1) {
            Some(step) => suspect(stack, &rows, measured, &step, &factor.covariance_root(count), chi_squared),
            None => None,
        };
        Ok(Self { agreement, suspect })
    }
}

/// Least part of itself that a row has to be checked by others, so that it can be told that it is wrong.
const CHECKED: f64 = 1e-6;

/// What makes chi-squared smallest if it alone is let free: a row that is wrong, or a known value that has changed (Baarda 1968).
fn suspect(
    stack: &Stack<'_>,
    rows: &[Row],
    measured: usize,
    step: &[f64],
    root: &CovarianceRoot,
    chi_squared: f64,
) -> Option<Suspect> {
    let count = step.len();
    let left = |row: &Row| row.residual + row.line.iter().zip(step).map(|(by, step)| by * step).sum::<f64>();
    let left: Vec<f64> = rows.iter().map(left).collect();
    let mut all = Vec::new();
    // Combinations of correlated rows are no rows that one could look at.
    let problem = &stack.states.problem;
    if problem.covariance_blocks().is_empty() {
        for (equation, row) in rows[..measured].iter().enumerate() {
            let leverage: f64 = root.leverages(&row.line).iter().sum();
            if 1.0 - leverage > CHECKED {
                all.push((left[equation].powi(2) / (1.0 - leverage), (equation, false)));
            }
        }
    }
    if let Some(known) = stack.knowledge {
        let size = known.places.len();
        let own = &rows[measured..measured + size];
        let derivatives = DMatrix::from_fn(size, count, |row, column| own[row].line[column]);
        for state in 0..size {
            // A change of the state moves the rows of what is known by minus its column.
            let column = known.root.column(state);
            let along: f64 = column.iter().zip(&left[measured..]).map(|(by, left)| by * left).sum();
            let projected = derivatives.tr_mul(&column);
            let leverage: f64 = root.leverages(projected.as_slice()).iter().sum();
            let whole = column.norm_squared();
            if whole - leverage > CHECKED * whole {
                all.push((along.powi(2) / (whole - leverage), (state, true)));
            }
        }
    }
    let (less, (index, is_known)) = all.into_iter().max_by(|one, other| one.0.total_cmp(&other.0))?;
    let name = match is_known {
        true => stack.knowledge.map(|known| format!("`{}`", known.names[index])),
        false => row_name(problem, index),
    };
    Some(Suspect { name: name?, is_known, without: (chi_squared - less).max(0.0) })
}
