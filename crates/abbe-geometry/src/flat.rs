//! Plane and line.

use nalgebra::{Matrix3, Vector3};

use crate::cloud::Cloud;
use crate::error::FitError;
use crate::fitted::Fitted;

/// A plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// The point of the plane nearest to the centroid of the fitted points: the centroid itself.
    pub point: Vector3<f64>,
    /// Unit normal; its largest component is positive.
    pub normal: Vector3<f64>,
}

/// A straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// The point of the line nearest to the centroid of the fitted points: the centroid itself.
    pub point: Vector3<f64>,
    /// Unit direction; its largest component is positive.
    pub direction: Vector3<f64>,
}

/// Two unit vectors that make a right-handed orthonormal frame with a unit vector: `[u, v]` with `u x v = direction`.
pub fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let u = Vector3::ith(direction.iamin(), 1.0).cross(direction).normalize();
    [u, direction.cross(&u)]
}

/// The direction or its opposite, whichever has a positive largest component.
pub(crate) fn upright(direction: Vector3<f64>) -> Vector3<f64> {
    if direction[direction.iamax()] < 0.0 { -direction } else { direction }
}

/// The least squares plane of three points or more.
///
/// Residuals are signed, along the normal. Covariance: offset along the normal, then the changes of the normal along the two
/// directions of [`across`] it, rad.
///
/// Fails for points that coincide or lie on a line.
pub fn plane(points: &[Vector3<f64>]) -> Result<Fitted<Plane>, FitError> {
    let shape = "plane";
    let cloud = Cloud::of(shape, 3, points)?;
    if cloud.is_flat(1) {
        return Err(FitError::Undetermined { shape, because: "they lie on a line" });
    }
    let normal = upright(cloud.directions[2]);
    let [u, v] = across(&normal);
    let mut information = Matrix3::zeros();
    for point in points.iter().map(|point| point - cloud.centroid) {
        // A change of the normal by t along u moves the plane by -t (u . p) under the point.
        let row = Vector3::new(1.0, -u.dot(&point), -v.dot(&point));
        information += row * row.transpose();
    }
    Ok(Fitted {
        shape: Plane { point: cloud.centroid, normal },
        residuals: cloud.points.iter().map(|point| normal.dot(point) * cloud.scale).collect(),
        covariance: inverse(shape, &information)?,
        degrees_of_freedom: points.len() - 3,
    })
}

/// The least squares line of two points or more.
///
/// Residuals are distances, so not negative; their standard deviation is that of one of the two coordinates across the line,
/// with 2 n - 4 degrees of freedom. Covariance: shift of the point along the two directions of [`across`] the line, then the
/// changes of the direction along them, rad.
///
/// Fails for points that coincide and for points that spread in all directions of a plane or of space alike.
pub fn line(points: &[Vector3<f64>]) -> Result<Fitted<Line>, FitError> {
    let shape = "line";
    let cloud = Cloud::of(shape, 2, points)?;
    if cloud.is_round() {
        return Err(FitError::Undetermined { shape, because: "they spread in several directions alike" });
    }
    let direction = upright(cloud.directions[0]);
    // Squares of distances along the line; their sum is that of the information on the direction.
    let along: f64 = cloud.points.iter().map(|point| (direction.dot(point) * cloud.scale).powi(2)).sum();
    let variances = [1.0 / points.len() as f64, 1.0 / points.len() as f64, 1.0 / along, 1.0 / along];
    let entry = |row: usize, column: usize| if row == column { variances[row] } else { 0.0 };
    Ok(Fitted {
        shape: Line { point: cloud.centroid, direction },
        residuals: cloud.points.iter().map(|point| direction.cross(point).norm() * cloud.scale).collect(),
        covariance: (0..4).map(|row| (0..4).map(|column| entry(row, column)).collect()).collect(),
        degrees_of_freedom: 2 * points.len() - 4,
    })
}

fn inverse(shape: &'static str, information: &Matrix3<f64>) -> Result<Vec<Vec<f64>>, FitError> {
    let because = "they lie on a line";
    let covariance = information.cholesky().ok_or(FitError::Undetermined { shape, because })?.inverse();
    Ok((0..3).map(|row| (0..3).map(|column| covariance[(row, column)]).collect()).collect())
}
