//! Circle in two dimensions, sphere in three: the same in the number of coordinates.

use nalgebra::{SVector, Vector2, Vector3};

use crate::cloud::{Cloud, right_singular};
use crate::error::FitError;
use crate::fitted::Fitted;
use crate::iteration::{Distances, covariance, minimise};

/// All points at one distance from a centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hypersphere<const D: usize> {
    /// Centre.
    pub centre: SVector<f64, D>,
    /// Radius.
    pub radius: f64,
}

/// A circle in the plane.
pub type Circle = Hypersphere<2>;

/// A sphere.
pub type Sphere = Hypersphere<3>;

/// The least squares circle of three points or more in a plane.
///
/// Residuals are radial, positive outside. Covariance: centre x, y, radius.
///
/// Fails for points that coincide or lie on a line.
pub fn circle(points: &[Vector2<f64>]) -> Result<Fitted<Circle>, FitError> {
    round("circle", points, "they lie on a line")
}

/// The least squares sphere of four points or more.
///
/// Residuals are radial, positive outside. Covariance: centre x, y, z, radius.
///
/// Fails for points that coincide or lie in a plane.
pub fn sphere(points: &[Vector3<f64>]) -> Result<Fitted<Sphere>, FitError> {
    round("sphere", points, "they lie in a plane")
}

fn round<const D: usize>(
    shape: &'static str,
    points: &[SVector<f64, D>],
    flat: &'static str,
) -> Result<Fitted<Hypersphere<D>>, FitError> {
    let cloud = Cloud::of(shape, D + 1, points)?;
    let undetermined = FitError::Undetermined { shape, because: flat };
    if cloud.is_flat(D - 1) {
        return Err(undetermined);
    }
    let start = taubin(&cloud.points).ok_or(undetermined)?;
    let scaled = minimise(shape, &Radial(&cloud.points), &parameters(&start))?;
    // Distances and derivatives do not change with the unit of length.
    let covariance = covariance(shape, &Radial(&cloud.points), &scaled)?;
    Ok(Fitted {
        shape: Hypersphere {
            centre: cloud.place(SVector::from_column_slice(&scaled[..D])),
            radius: scaled[D] * cloud.scale,
        },
        residuals: Radial(&cloud.points).distances(&scaled).iter().map(|distance| distance * cloud.scale).collect(),
        covariance,
        degrees_of_freedom: points.len() - (D + 1),
    })
}

fn parameters<const D: usize>(round: &Hypersphere<D>) -> Vec<f64> {
    [round.centre.as_slice(), &[round.radius]].concat()
}

/// The algebraic circle or sphere of G. Taubin (IEEE Trans. PAMI 13 (1991) 1115-1138) in the form of N. Chernov, *Circular
/// and linear regression*, 2010: unlike simpler ones it does not shrink on short arcs. None where it is a line or a plane.
///
/// The points have to be centred.
pub(crate) fn taubin<const D: usize>(points: &[SVector<f64, D>]) -> Option<Hypersphere<D>> {
    let mean = points.iter().map(SVector::norm_squared).sum::<f64>() / points.len() as f64;
    let (_, vectors) = right_singular(points.len(), D + 1, |row, column| match column {
        0 => (points[row].norm_squared() - mean) / (2.0 * mean.sqrt()),
        _ => points[row][column - 1],
    });
    let weights = vectors.last()?;
    let factor = -mean.sqrt() / weights[0];
    let centre = SVector::<f64, D>::from_iterator((0..D).map(|axis| weights[1 + axis] * factor));
    let radius = (centre.norm_squared() + mean).sqrt();
    radius.is_finite().then_some(Hypersphere { centre, radius })
}

/// Radial distances of points; parameters: centre, radius.
pub(crate) struct Radial<'a, const D: usize>(pub &'a [SVector<f64, D>]);

impl<const D: usize> Distances for Radial<'_, D> {
    fn points(&self) -> usize {
        self.0.len()
    }

    fn parameters(&self) -> usize {
        D + 1
    }

    fn distance(&self, point: usize, parameters: &[f64], derivatives: &mut [f64]) -> f64 {
        let from_centre = self.0[point] - SVector::<f64, D>::from_column_slice(&parameters[..D]);
        let distance = from_centre.norm();
        for (axis, derivative) in derivatives[..D].iter_mut().enumerate() {
            // At the centre every direction is as good as any other.
            *derivative = if distance > 0.0 { -from_centre[axis] / distance } else { 0.0 };
        }
        derivatives[D] = -1.0;
        distance - parameters[D]
    }
}
