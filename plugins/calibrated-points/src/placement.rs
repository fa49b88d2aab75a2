//! Placement of the artefact: a nominal frame and its six errors.

use nalgebra::{Matrix3, Matrix3x6, Rotation3, Vector3};

/// Largest cosine of the angle between u and v. A larger one is taken as a mistake in the file.
const SKEW: f64 = 1e-3;

/// A nominal placement: the artefact's frame in the table frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    origin: Vector3<f64>,
    /// Columns: the artefact's directions in the table frame.
    directions: Matrix3<f64>,
}

/// A point of the table frame as seen from the placed artefact.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Its coordinates in the artefact's frame, mm.
    pub point: Vector3<f64>,
    /// Their derivatives to the point.
    pub by_point: Matrix3<f64>,
    /// Their derivatives to the errors of the placement, x y z a b c.
    pub by_error: Matrix3x6<f64>,
}

impl Placement {
    /// The placement with its origin and its x and y directions in the table frame; none if these are not at right angles.
    pub fn new(origin: Vector3<f64>, u: Vector3<f64>, v: Vector3<f64>) -> Option<Self> {
        let (u, v) = (u.try_normalize(1e-6)?, v.try_normalize(1e-6)?);
        if u.dot(&v).abs() > SKEW {
            return None;
        }
        let w = u.cross(&v).try_normalize(0.0)?;
        Some(Self { origin, directions: Matrix3::from_columns(&[u, w.cross(&u), w]) })
    }

    /// A point of the artefact in the table frame.
    pub fn place(&self, point: &Vector3<f64>, errors: &[f64]) -> Vector3<f64> {
        let shift = Vector3::new(errors[0], errors[1], errors[2]);
        self.origin + self.directions * (shift + turn(errors) * point)
    }

    /// A point of the table frame in that of the artefact.
    pub fn seen(&self, point: &Vector3<f64>, errors: &[f64]) -> Seen {
        let turned = turn(errors);
        let back = turned.inverse();
        let from_origin =
            self.directions.transpose() * (point - self.origin) - Vector3::new(errors[0], errors[1], errors[2]);
        // The axes about which a, b and c turn: R = Rz(c) Ry(b) Rx(a).
        let about_z = Rotation3::from_axis_angle(&Vector3::z_axis(), errors[5]);
        let about_y = about_z * Rotation3::from_axis_angle(&Vector3::y_axis(), errors[4]);
        let axes = [about_y * Vector3::x(), about_z * Vector3::y(), Vector3::z()];
        let mut by_error = Matrix3x6::zeros();
        by_error.fixed_columns_mut::<3>(0).copy_from(&-back.matrix());
        for (column, axis) in axes.iter().enumerate() {
            by_error.set_column(3 + column, &(back * from_origin.cross(axis)));
        }
        Seen { point: back * from_origin, by_point: back.matrix() * self.directions.transpose(), by_error }
    }
}

/// `Rz(c) Ry(b) Rx(a)` of the errors x y z a b c.
fn turn(errors: &[f64]) -> Rotation3<f64> {
    Rotation3::from_euler_angles(errors[3], errors[4], errors[5])
}
