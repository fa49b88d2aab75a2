//! Gauss-Newton iteration on orthogonal distances, and the covariance at the minimum.

use std::convert::Infallible;

use abbe_numerics::{Accumulator, End, LeastSquares, Options, Sink, solve};

use crate::error::FitError;

/// Smallest singular value, relative to the largest, with which all parameters count as determined. The columns of the
/// derivatives have norm 1. An arc of 0.01 degrees is above this value.
const RANK: f64 = 1e-9;

/// Distances of points from a shape with some parameters.
pub trait Distances {
    /// Number of points.
    fn points(&self) -> usize;

    /// Number of parameters.
    fn parameters(&self) -> usize;

    /// The distance of a point and, into `derivatives`, its derivatives to the parameters.
    fn distance(&self, point: usize, parameters: &[f64], derivatives: &mut [f64]) -> f64;

    /// All distances.
    fn distances(&self, parameters: &[f64]) -> Vec<f64> {
        let mut derivatives = vec![0.0; self.parameters()];
        (0..self.points()).map(|point| self.distance(point, parameters, &mut derivatives)).collect()
    }
}

struct Weighted<'a, T>(&'a T);

impl<T: Distances> LeastSquares for Weighted<'_, T> {
    type Error = Infallible;

    fn unknowns(&self) -> usize {
        self.0.parameters()
    }

    fn rows(&self) -> usize {
        self.0.points()
    }

    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), Infallible> {
        let mut derivatives = vec![0.0; self.0.parameters()];
        for point in 0..self.0.points() {
            let residual = self.0.distance(point, x, &mut derivatives);
            sink(point, &[residual], &derivatives);
        }
        Ok(())
    }
}

/// The parameters with the smallest sum of squared distances, for points that spread by about 1.
pub fn minimise<T: Distances>(shape: &'static str, distances: &T, start: &[f64]) -> Result<Vec<f64>, FitError> {
    // Points spread by about 1, and no error of theirs is known: the iteration goes on until rounding is all that is left.
    let options = Options { tolerance: 1e-15, rounding: 1e-9, ..Options::USUAL };
    let Ok(solution) = solve(&Weighted(distances), start, &options);
    match solution.end {
        End::Converged => Ok(solution.x),
        _ => Err(FitError::Undetermined { shape, because: "none fits them best" }),
    }
}

/// Covariance of the parameters for distances with independent errors of standard deviation 1.
pub fn covariance<T: Distances>(
    shape: &'static str,
    distances: &T,
    parameters: &[f64],
) -> Result<Vec<Vec<f64>>, FitError> {
    let count = distances.parameters();
    let mut accumulator = Accumulator::new(count, distances.points());
    let mut derivatives = vec![0.0; count];
    for point in 0..distances.points() {
        let residual = distances.distance(point, parameters, &mut derivatives);
        accumulator.push(&derivatives, residual, 1.0);
    }
    let factor = accumulator.finish();
    if factor.singular_values().rank(RANK) < count {
        return Err(FitError::Undetermined { shape, because: "many fit them equally well" });
    }
    Ok(factor.covariance_root(count).covariance())
}
