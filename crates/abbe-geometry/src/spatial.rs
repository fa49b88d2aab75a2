//! Circle in space.

use nalgebra::{Vector2, Vector3};

use crate::error::FitError;
use crate::fitted::Fitted;
use crate::flat::{Plane, across, plane};
use crate::round::circle;

/// A circle in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialCircle {
    /// Centre.
    pub centre: Vector3<f64>,
    /// Unit normal of its plane; its largest component is positive.
    pub normal: Vector3<f64>,
    /// Radius.
    pub radius: f64,
}

/// A circle in space with the plane that it was fitted in.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialFit {
    /// The circle. Residuals are radial within the plane. Covariance: centre along the two directions of [`across`] the
    /// normal, radius.
    pub circle: Fitted<SpatialCircle>,
    /// The plane; its residuals are the distances across it.
    pub plane: Fitted<Plane>,
}

/// The least squares circle in the least squares plane of three points or more.
///
/// Fails for points that coincide or lie on a line.
pub fn spatial_circle(points: &[Vector3<f64>]) -> Result<SpatialFit, FitError> {
    let plane = plane(points).map_err(|error| error.of("circle"))?;
    let Plane { point, normal } = plane.shape;
    let [u, v] = across(&normal);
    let projected: Vec<Vector2<f64>> =
        points.iter().map(|other| other - point).map(|from| Vector2::new(u.dot(&from), v.dot(&from))).collect();
    let Fitted { shape, residuals, covariance, degrees_of_freedom } = circle(&projected)?;
    let centre = point + shape.centre.x * u + shape.centre.y * v;
    let shape = SpatialCircle { centre, normal, radius: shape.radius };
    Ok(SpatialFit { circle: Fitted { shape, residuals, covariance, degrees_of_freedom }, plane })
}
