//! What the iteration of Gauss and Newton needs of a problem and of the factor of its rows, whatever the form of that.

use crate::arrow::ArrowFactor;
use crate::factor::Factor;
use crate::gauss_newton::{LeastSquares, Options, Solution, minimise};

/// A factor of rows `[J | r]`, as far as steps need it.
pub trait Steps {
    /// Norm of every column of J.
    fn norms(&self) -> &[f64];
    /// Sum of squares of r.
    fn cost(&self) -> f64;
    /// The Gauss-Newton step; None if there is none.
    fn step(&self) -> Option<Vec<f64>>;
    /// Norm of `J x`.
    fn row_norm(&self, x: &[f64]) -> f64;
    /// Largest cosine of the angle between r and a column of J.
    fn gradient_cosine(&self) -> f64;
}

/// Both forms have methods of these names.
macro_rules! steps {
    ($form:ty) => {
        impl Steps for $form {
            fn norms(&self) -> &[f64] {
                self.norms()
            }

            fn cost(&self) -> f64 {
                self.cost()
            }

            fn step(&self) -> Option<Vec<f64>> {
                self.step()
            }

            fn row_norm(&self, x: &[f64]) -> f64 {
                self.row_norm(x)
            }

            fn gradient_cosine(&self) -> f64 {
                self.gradient_cosine()
            }
        }
    };
}

steps!(Factor);
steps!(ArrowFactor);

/// A problem that gives the factor of its rows, of any form. Every [`LeastSquares`] problem is one.
pub trait Descent {
    /// Error of an evaluation.
    type Error;
    /// The form of its factors.
    type Factor: Steps;

    /// Whether no evaluation is possible after this error ([`LeastSquares::is_final`]).
    fn has_no_more(&self, error: &Self::Error) -> bool;

    /// Whether this error says that the time is over ([`LeastSquares::is_out_of_time`]).
    fn is_late(&self, error: &Self::Error) -> bool;

    /// Called when the iteration has taken a step ([`LeastSquares::has_stepped`]).
    fn stepped(&self, iteration: usize, size: f64);

    /// The factor of all rows at x with these statistical weights, all 1 if there are none.
    fn factor_at(&self, x: &[f64], weights: Option<&[f64]>) -> Result<Self::Factor, Self::Error>;

    /// The factor at x, with the triangle of one that is known nearby ([`LeastSquares::factor_near`]); None where it is not faster.
    fn near(&self, _x: &[f64], _known: &Self::Factor) -> Result<Option<Self::Factor>, Self::Error> {
        Ok(None)
    }
}

impl<P: LeastSquares + ?Sized> Descent for P {
    type Error = P::Error;
    type Factor = Factor;

    fn has_no_more(&self, error: &Self::Error) -> bool {
        self.is_final(error)
    }

    fn is_late(&self, error: &Self::Error) -> bool {
        self.is_out_of_time(error)
    }

    fn stepped(&self, iteration: usize, size: f64) {
        self.has_stepped(iteration, size);
    }

    fn factor_at(&self, x: &[f64], weights: Option<&[f64]>) -> Result<Factor, Self::Error> {
        self.factor(x, weights)
    }

    fn near(&self, x: &[f64], known: &Factor) -> Result<Option<Factor>, Self::Error> {
        self.factor_near(x, known)
    }
}

/// Minimises the sum of squares from `start` without robust weights, as [`solve`](crate::solve) does.
///
/// Fails as that does.
pub fn solve_plain<P: Descent + ?Sized>(
    problem: &P,
    start: &[f64],
    options: &Options,
) -> Result<Solution<P::Factor>, P::Error> {
    let factor = problem.factor_at(start, None)?;
    Ok(minimise(problem, start.to_vec(), factor, None, options)?.solution(None))
}
