//! Jacobians of rotations against differences.

use abbe_core::rotation::{inverse_left_jacobian, inverse_right_jacobian, left_jacobian};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

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
fn series_of_small_angles_join_the_closed_forms_at_a_milliradian() {
    for function in [left_jacobian, inverse_left_jacobian, inverse_right_jacobian] {
        let direction = Vector3::new(1.0, -2.0, 2.0) / 3.0;
        let jump = function(&(direction * 0.999_999e-3)) - function(&(direction * 1.000_001e-3));
        assert!(jump.norm() < 3e-9, "{jump}");
    }
}
