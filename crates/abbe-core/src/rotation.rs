//! Derivatives of rotation vectors (axis times angle, rad): the Jacobians of SO(3) (Barfoot, State Estimation for Robotics,
//! 2017, chapter 7).

use nalgebra::{Matrix3, Vector3};

/// Below this angle, rad, power series replace the closed forms, which would lose digits.
const SMALL: f64 = 1e-3;

/// Left Jacobian of a rotation vector: the small rotation (axes of the fixed frame) per change of the rotation vector.
///
/// `exp(v + dv) = exp(J dv) exp(v)` to first order in `dv`.
pub fn left_jacobian(vector: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (vector.norm(), vector.cross_matrix());
    let (half, rest) = match angle < SMALL {
        true => (0.5 - angle.powi(2) / 24.0, 1.0 / 6.0 - angle.powi(2) / 120.0),
        false => ((1.0 - angle.cos()) / angle.powi(2), (angle - angle.sin()) / angle.powi(3)),
    };
    Matrix3::identity() + cross * half + cross * cross * rest
}

/// Inverse of [`left_jacobian`]: the change of a rotation vector per small rotation (axes of the fixed frame).
pub fn inverse_left_jacobian(vector: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (vector.norm(), vector.cross_matrix());
    let rest = match angle < SMALL {
        true => 1.0 / 12.0 + angle.powi(2) / 720.0,
        false => (1.0 - angle / 2.0 / (angle / 2.0).tan()) / angle.powi(2),
    };
    Matrix3::identity() - cross * 0.5 + cross * cross * rest
}

/// Inverse of the right Jacobian: the change of a rotation vector per small rotation that acts before it.
pub fn inverse_right_jacobian(vector: &Vector3<f64>) -> Matrix3<f64> {
    inverse_left_jacobian(&-vector)
}
