//! Principal components of a covariance and the region that holds a position with some probability.

use abbe_core::{Error, Result};
use abbe_numerics::hotelling_quantile;
use nalgebra::{Matrix3, Vector3};

/// Eigenvalues below this part of the largest are zero.
const ZERO: f64 = 1e-12;

/// The ellipsoid that holds a position of normal distribution with some probability (Soons 1993, equations A.5 to A.15;
/// the right side of A.14 and A.15 is the quantile of chi-squared, or that of Hotelling's T² where the covariance was found with
/// finite degrees of freedom).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipsoid {
    /// Principal directions, that of the largest uncertainty first; unit vectors whose largest component is positive.
    pub directions: [[f64; 3]; 3],
    /// Standard uncertainty along each, in the unit of the position.
    pub standard_uncertainties: [f64; 3],
    /// Number of directions with an uncertainty: the quantities that are covered together. The position is exact in the others.
    pub nonzero: usize,
    /// Half lengths of the axes of the ellipsoid; along one or two directions it is an interval or an ellipse. None where the
    /// covariance has fewer degrees of freedom than directions.
    pub semi_axes: Option<[f64; 3]>,
}

impl Ellipsoid {
    /// The ellipsoid of a covariance (square of the position's unit), known with some degrees of freedom (infinite if it was
    /// stated), for a probability between 0 and 1.
    ///
    /// Fails for a covariance with an entry that is not finite and for a probability that is not between 0 and 1.
    pub fn of(covariance: &[[f64; 3]; 3], probability: f64, degrees_of_freedom: f64) -> Result<Self> {
        if covariance.iter().flatten().any(|entry| !entry.is_finite()) {
            return Err(Error::data("the covariance of a position has an entry that is no finite number"));
        }
        if !(probability > 0.0 && probability < 1.0) {
            return Err(Error::usage(format!("{probability} is no probability between 0 and 1")));
        }
        let eigen = Matrix3::from_fn(|row, column| covariance[row][column]).symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let largest = eigen.eigenvalues[order[0]];
        let variances = order.map(|index| eigen.eigenvalues[index]);
        let variances = variances.map(|variance| if variance > ZERO * largest { variance } else { 0.0 });
        let nonzero = variances.iter().filter(|variance| **variance > 0.0).count();
        let quantile = if nonzero == 0 { 0.0 } else { hotelling_quantile(probability, nonzero, degrees_of_freedom) };
        Ok(Self {
            directions: order.map(|index| with_sign(eigen.eigenvectors.column(index).into_owned()).into()),
            standard_uncertainties: variances.map(f64::sqrt),
            nonzero,
            semi_axes: quantile.is_finite().then(|| variances.map(|variance| (quantile * variance).sqrt())),
        })
    }
}

/// The direction with its largest component positive; of equal ones the first counts.
fn with_sign(direction: Vector3<f64>) -> Vector3<f64> {
    let largest = direction.amax() * (1.0 - 1e-9);
    let first = direction.iter().find(|component| component.abs() >= largest);
    let signed = if first.is_some_and(|component| *component < 0.0) { -direction } else { direction };
    // No minus before zero.
    signed.map(|component| component + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotated(variances: [f64; 3], axis: Vector3<f64>, angle: f64) -> [[f64; 3]; 3] {
        let turn = nalgebra::Rotation3::new(axis.normalize() * angle).into_inner();
        let covariance = turn * Matrix3::from_diagonal(&Vector3::from(variances)) * turn.transpose();
        [0, 1, 2].map(|row| [0, 1, 2].map(|column| covariance[(row, column)]))
    }

    fn close(found: [f64; 3], expected: [f64; 3]) {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12 * expected.abs().max(1e-3), "{found}, expected {expected}");
        }
    }

    /// Quantiles of chi-squared at 0.95 for 1, 2, 3 degrees of freedom: 1.959964², -2 ln 0.05, 7.814728.
    #[test]
    fn zero_eigenvalues_take_degrees_of_freedom() {
        let (one, two, three) = (1.959963984540054_f64, (-2.0 * 0.05_f64.ln()).sqrt(), 7.814727903251179_f64.sqrt());
        let cases = [
            ([4e-6, 9e-6, 1e-6], 3, three, [3e-3, 2e-3, 1e-3]),
            ([4e-6, 9e-6, 0.0], 2, two, [3e-3, 2e-3, 0.0]),
            ([4e-6, 9e-6, 1e-18], 2, two, [3e-3, 2e-3, 0.0]),
            ([0.0, 9e-6, 0.0], 1, one, [3e-3, 0.0, 0.0]),
            ([0.0, 0.0, 0.0], 0, 0.0, [0.0, 0.0, 0.0]),
        ];
        for (variances, nonzero, factor, expected) in cases {
            for angle in [0.0, 0.7, 2.0] {
                let covariance = rotated(variances, Vector3::new(1.0, 2.0, -0.5), angle);
                let found = Ellipsoid::of(&covariance, 0.95, f64::INFINITY).unwrap();
                assert_eq!(found.nonzero, nonzero, "{variances:?} at {angle}");
                close(found.standard_uncertainties, expected);
                let scaled = expected.map(|uncertainty| uncertainty * factor);
                for (found, expected) in found.semi_axes.unwrap().iter().zip(scaled) {
                    assert!((found - expected).abs() < 1e-9 * expected.max(1e-3), "{found}, expected {expected}");
                }
            }
        }
    }

    /// T² of three quantities with 15 degrees of freedom is 45/13 of F(0.95; 3, 13) = 3.4105: a factor of 3.44 and not 2.80.
    #[test]
    fn few_degrees_of_freedom_make_the_ellipsoid_larger() {
        let semi_axes = |variances: [f64; 3], freedom: f64| {
            let covariance = rotated(variances, Vector3::new(1.0, 2.0, -0.5), 0.7);
            Ellipsoid::of(&covariance, 0.95, freedom).unwrap().semi_axes
        };
        let largest = semi_axes([9.0, 4.0, 1.0], 15.0).unwrap()[0];
        assert!((largest - 3.0 * (45.0 / 13.0 * 3.4105_f64).sqrt()).abs() < 1e-3, "{largest}");
        assert_eq!(semi_axes([9.0, 4.0, 1.0], 2.0), None);
        // One direction: Student's t with two degrees of freedom.
        let interval = semi_axes([9.0, 0.0, 0.0], 2.0).unwrap()[0];
        assert!((interval - 3.0 * 4.302_653).abs() < 1e-4, "{interval}");
    }

    #[test]
    fn directions_are_unit_vectors_with_a_sign() {
        let found = Ellipsoid::of(&[[2.0, -1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 0.0, 0.5]], 0.95, f64::INFINITY).unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        close(found.directions[0], [half, -half, 0.0]);
        close(found.directions[1], [half, half, 0.0]);
        close(found.directions[2], [0.0, 0.0, 1.0]);
        close(found.standard_uncertainties, [3.0_f64.sqrt(), 1.0, half]);
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let message =
            |covariance, probability| Ellipsoid::of(&covariance, probability, f64::INFINITY).unwrap_err().message;
        assert_eq!(
            message([[f64::NAN; 3]; 3], 0.95),
            "the covariance of a position has an entry that is no finite number"
        );
        assert_eq!(message([[0.0; 3]; 3], 1.0), "1 is no probability between 0 and 1");
    }
}
