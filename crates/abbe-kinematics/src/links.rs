//! Denavit and Hartenberg's parameters of a chain whose axes all follow one another from the base to the tool.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use abbe_core::{AxisKind, Branch};

use crate::ChainAxis;

/// Standard parameters of a link: Rz(theta + q) Tz(d) Tx(a) Rx(alpha), mm and rad.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Link {
    /// Length.
    pub a: f64,
    /// Twist.
    pub alpha: f64,
    /// Offset.
    pub d: f64,
    /// Angle of the joint at zero.
    pub theta: f64,
}

/// Lines that are closer, mm, or more parallel, are the same.
const SAME: f64 = 1e-9;

/// Parameters of all links, and the frame of the last one; its twist and length are zero, so that the tip is all that follows it.
///
/// None if the first joint does not turn about (or move along) z of the base through its origin, or if an axis is on the other
/// side of the bed. Modified parameters (Craig) are the same numbers: alpha and a of each link belong to the next one.
pub fn denavit_hartenberg(axes: &[ChainAxis]) -> Option<(Vec<Link>, Isometry3<f64>)> {
    if axes.is_empty() || axes.iter().any(|axis| axis.branch != Branch::Tool) {
        return None;
    }
    let direction = |axis: &ChainAxis| axis.direction * axis.sense();
    let first = direction(&axes[0]);
    let on_z = axes[0].kind == AxisKind::Linear || axes[0].point.xy().norm() < SAME;
    if (first - Vector3::z()).norm() > SAME || !on_z {
        return None;
    }
    let mut frame = Isometry3::identity();
    let mut links = Vec::new();
    for next in axes.iter().skip(1) {
        let (link, reached) = link(&frame, direction(next), line_point(next, &frame));
        links.push(link);
        frame = reached;
    }
    links.push(Link::default());
    Some((links, frame))
}

/// A point on the line of an axis; a linear axis has none of its own.
fn line_point(axis: &ChainAxis, frame: &Isometry3<f64>) -> Point3<f64> {
    if axis.kind == AxisKind::Linear { frame.translation.vector.into() } else { axis.point.into() }
}

/// The link from a frame to the line of the next axis along the common normal, and the frame there.
fn link(frame: &Isometry3<f64>, next: Vector3<f64>, point: Point3<f64>) -> (Link, Isometry3<f64>) {
    let (x, z) = (frame * Vector3::x(), frame * Vector3::z());
    let origin = Point3::from(frame.translation.vector);
    let cross = z.cross(&next);
    let (foot, normal) = if cross.norm() < SAME {
        // Parallel: the normal through the origin.
        let across = (point - origin) - z * (point - origin).dot(&z);
        (origin, across)
    } else {
        // The point of this line that is nearest to the next one.
        let along = (point - origin).cross(&next).dot(&cross) / cross.norm_squared();
        let foot = origin + z * along;
        let across = point - foot;
        (foot, across - next * across.dot(&next))
    };
    let new_x = if normal.norm() > SAME {
        normal.normalize()
    } else if cross.norm() >= SAME {
        cross.normalize()
    } else {
        x
    };
    let angle =
        |from: Vector3<f64>, to: Vector3<f64>, about: Vector3<f64>| from.cross(&to).dot(&about).atan2(from.dot(&to));
    let link = Link {
        a: normal.dot(&new_x),
        alpha: angle(z, next, new_x),
        d: (foot - origin).dot(&z),
        theta: angle(x, new_x, z),
    };
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[new_x, next.cross(&new_x), next]));
    let reached = foot + new_x * link.a;
    (link, Isometry3::from_parts(Translation3::from(reached.coords), UnitQuaternion::from_rotation_matrix(&rotation)))
}
