//! A fitted shape with its residuals.

/// A least squares shape and how far the points are off it.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted<S> {
    /// The shape.
    pub shape: S,
    /// Distance of every point from the shape, in the order of the points: radial (positive outside) for round shapes, along
    /// the normal for a plane; not negative for a line.
    pub residuals: Vec<f64>,
    /// Covariance of the parameters of the shape if every coordinate has an independent error of standard deviation 1;
    /// multiply by the variance of the noise. The fit says which parameters in which order.
    pub covariance: Vec<Vec<f64>>,
    /// Number of independent distances (two per point for a line, else one) minus the number of parameters.
    pub degrees_of_freedom: usize,
}

impl<S> Fitted<S> {
    /// Largest residual.
    pub fn max(&self) -> f64 {
        self.residuals.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Smallest residual.
    pub fn min(&self) -> f64 {
        self.residuals.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Largest less smallest residual: the form deviation (out of roundness, sphericity, flatness).
    pub fn range(&self) -> f64 {
        self.max() - self.min()
    }

    /// Root mean square of the residuals.
    pub fn rms(&self) -> f64 {
        (self.sum_of_squares() / self.residuals.len() as f64).sqrt()
    }

    /// Standard deviation of the residuals, divided by the degrees of freedom; NaN if there are none.
    pub fn standard_deviation(&self) -> f64 {
        match self.degrees_of_freedom {
            0 => f64::NAN,
            free => (self.sum_of_squares() / free as f64).sqrt(),
        }
    }

    fn sum_of_squares(&self) -> f64 {
        self.residuals.iter().map(|residual| residual * residual).sum()
    }
}
