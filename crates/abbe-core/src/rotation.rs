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

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    fn vectors() -> impl Iterator<Item = Vector3<f64>> {
        let direction = |k: f64| Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k).sin()).normalize();
        [1e-9, 1e-4, 0.999e-3, 1.001e-3, 0.1, 1.0, 2.5, 3.1]
            .into_iter()
            .zip(1..)
            .map(move |(angle, k)| direction(f64::from(k)) * angle)
    }

    #[test]
    fn jacobians_are_those_of_differences() {
        for vector in vectors() {
            let turn = UnitQuaternion::from_scaled_axis(vector);
            let (left, inverse, right) =
                (left_jacobian(&vector), inverse_left_jacobian(&vector), inverse_right_jacobian(&vector));
            for axis in 0..3 {
                let step = Vector3::ith(axis, 1e-6);
                let by_vector = UnitQuaternion::from_scaled_axis(vector + step)
                    * UnitQuaternion::from_scaled_axis(vector - step).inverse();
                assert!((by_vector.scaled_axis() / 2e-6 - left.column(axis)).norm() < 1e-8, "{vector}");
                let small = UnitQuaternion::from_scaled_axis(step);
                let after = ((small * turn).scaled_axis() - (small.inverse() * turn).scaled_axis()) / 2e-6;
                assert!((after - inverse.column(axis)).norm() < 1e-7, "{vector}");
                let before = ((turn * small).scaled_axis() - (turn * small.inverse()).scaled_axis()) / 2e-6;
                assert!((before - right.column(axis)).norm() < 1e-7, "{vector}");
            }
            assert!((left * inverse - Matrix3::identity()).norm() < 1e-10);
        }
    }

    #[test]
    fn series_of_small_angles_join_the_closed_forms() {
        for function in [left_jacobian, inverse_left_jacobian, inverse_right_jacobian] {
            let direction = Vector3::new(1.0, -2.0, 2.0) / 3.0;
            let jump = function(&(direction * SMALL * 0.999_999)) - function(&(direction * SMALL * 1.000_001));
            assert!(jump.norm() < 3e-9, "{jump}");
        }
    }
}
