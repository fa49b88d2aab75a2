//! Some directions of the unknowns of a least squares problem, and the problem within them.

use faer::{Mat, MatRef};

use crate::accumulate::Accumulator;
use crate::factor::{CovarianceRoot, Factor};
use crate::gauss_newton::{LeastSquares, Sink};

/// Linearly independent directions of n unknowns, in the units of the unknowns: the columns of B in `x = x0 + B y`.
#[derive(Debug, Clone)]
pub struct Directions(Mat<f64>);

impl Directions {
    pub(crate) fn new(columns: Mat<f64>) -> Self {
        Self(columns)
    }

    /// Number of directions.
    pub fn count(&self) -> usize {
        self.0.ncols()
    }

    /// `B y`, in the units of the unknowns.
    pub fn combined(&self, y: &[f64]) -> Vec<f64> {
        (0..self.0.nrows()).map(|row| y.iter().enumerate().map(|(k, y)| self.0[(row, k)] * y).sum()).collect()
    }

    /// The factor of `[J B | r]`, given that of `[J | r]`.
    pub fn factor(&self, factor: &Factor) -> Factor {
        let products = factor.triangle() * &self.0;
        let count = self.count();
        let mut accumulator = Accumulator::new(count, factor.unknowns() + 1);
        for row in 0..factor.unknowns() {
            let line: Vec<f64> = (0..count).map(|column| products[(row, column)]).collect();
            accumulator.push(&line, factor.right()[row], 1.0);
        }
        accumulator.push(&vec![0.0; count], factor.remaining_cost().sqrt(), 1.0);
        accumulator.finish().of_rows(factor.rows())
    }

    /// The root of the covariance of the unknowns where nothing but these directions is estimated: `B (B^T J^T J B)^-1 B^T`
    /// with the factor of J.
    pub fn covariance_root(&self, factor: &Factor) -> CovarianceRoot {
        let within = self.factor(factor);
        within.covariance_root(within.unknowns()).seen_through(&self.0)
    }
}

/// A problem within some directions from an origin: `y` in `x = x0 + B y` are its unknowns.
///
/// What moves along other directions stays where it is, however far the iteration goes.
pub struct RestrictedProblem<'a, P: ?Sized> {
    /// The problem in x.
    pub problem: &'a P,
    /// `x0`.
    pub origin: &'a [f64],
    /// B.
    pub directions: &'a Directions,
}

impl<P: LeastSquares + ?Sized> RestrictedProblem<'_, P> {
    /// x at y.
    pub fn place(&self, y: &[f64]) -> Vec<f64> {
        self.origin.iter().zip(self.directions.combined(y)).map(|(origin, step)| origin + step).collect()
    }
}

impl<P: LeastSquares + ?Sized> LeastSquares for RestrictedProblem<'_, P> {
    type Error = P::Error;

    fn is_final(&self, error: &P::Error) -> bool {
        self.problem.is_final(error)
    }

    fn is_out_of_time(&self, error: &P::Error) -> bool {
        self.problem.is_out_of_time(error)
    }

    fn keeps_weight(&self, row: usize) -> bool {
        self.problem.keeps_weight(row)
    }

    fn has_stepped(&self, iteration: usize, size: f64) {
        self.problem.has_stepped(iteration, size);
    }

    fn unknowns(&self) -> usize {
        self.directions.count()
    }

    fn rows(&self) -> usize {
        self.problem.rows()
    }

    fn linearise(&self, y: &[f64], sink: Sink<'_>) -> Result<(), P::Error> {
        let (all, count) = (self.problem.unknowns(), self.directions.count());
        let mut within = Vec::new();
        self.problem.linearise(&self.place(y), &mut |first, residuals, derivatives| {
            let products = MatRef::from_row_major_slice(derivatives, residuals.len(), all) * &self.directions.0;
            within.clear();
            within.extend(
                (0..residuals.len())
                    .flat_map(|row| (0..count).map(move |column| (row, column)))
                    .map(|place| products[place]),
            );
            sink(first, residuals, &within);
        })
    }
}
