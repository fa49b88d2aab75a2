//! Derivatives of a problem times what its residuals count for, summed over all rows: no row of derivatives is made.

use super::evaluation::Evaluation;
use super::in_parts::Chunk;
use super::linearise::Columns;
use super::{ObservationSet, Problem};
use crate::index::{EquationIndex, RowIndex};
use abbe_settings::Result;

/// What a residual counts for, mm or rad.
type Counts<'a> = dyn Fn(EquationIndex, f64) -> f64 + Sync + 'a;

/// Sums of some rows, and their residuals.
struct Sums {
    gradient: Vec<f64>,
    residuals: Vec<f64>,
}

impl Problem {
    /// The sum of the derivatives of each equation to the unknowns at `x`, times what its residual (mm or rad) counts for; and the
    /// residuals, in the order of the equations.
    ///
    /// Of residuals that count for `residual / uncertainty^2` it is half of the gradient of the weighted sum of squares, in the inverse units
    /// of the unknowns: what [`linearise`](Self::linearise) tells, without its rows. Fails as that does.
    pub fn gradient(&self, x: &[f64], counts: &Counts<'_>) -> Result<(Vec<f64>, Vec<f64>)> {
        let (at, columns) = (self.with_values(x), Columns::of(self));
        let sums = at.in_parts(self.unknowns.len(), |part| at.sums_of(part, &columns, counts));
        let (mut gradient, mut residuals) = (vec![0.0; self.unknowns.len()], Vec::with_capacity(self.equations()));
        for part in sums {
            let part = part?;
            gradient.iter_mut().zip(part.gradient).for_each(|(sum, own)| *sum += own);
            residuals.extend(part.residuals);
        }
        Ok((gradient, residuals))
    }

    fn sums_of(&self, chunks: &[Chunk<'_>], columns: &Columns, counts: &Counts<'_>) -> Result<Sums> {
        let mut sums = Sums { gradient: vec![0.0; self.unknowns.len()], residuals: Vec::new() };
        let (mut work, mut of_rows, mut of_terms) = (Evaluation::default(), Vec::new(), Vec::new());
        for &(index, rows, first) in chunks {
            self.evaluate_rows(index, rows, columns, &mut work)?;
            let residuals = work.equations.residuals();
            of_rows.clear();
            of_rows.extend(residuals.iter().enumerate().map(|(place, residual)| counts(first + place, *residual)));
            sums.residuals.extend_from_slice(residuals);
            work.sum_factored(&self.sets[index], rows, &of_rows, &mut of_terms);
            for (&(variable, _), sum) in work.factored.terms.iter().zip(&of_terms) {
                let (column, factor) = columns.machine[variable];
                sums.gradient[column] += factor * sum;
            }
            columns.each_own(index, &work.equations, |equation, (column, factor), derivative| {
                sums.gradient[column] += of_rows[equation] * factor * derivative;
            });
        }
        Ok(sums)
    }
}

impl Evaluation {
    /// The sum over all equations of the derivatives by each term of the poses, times a number of the equation.
    fn sum_factored(&self, set: &ObservationSet, rows: &[RowIndex], of_rows: &[f64], of_terms: &mut Vec<f64>) {
        of_terms.clear();
        of_terms.resize(self.factored.terms.len(), 0.0);
        self.each_effect(set, rows, |equation, factors, run, along| {
            let along = along * of_rows[equation];
            of_terms[run.clone()].iter_mut().zip(&factors[run]).for_each(|(sum, factor)| *sum += factor * along);
        });
    }
}
