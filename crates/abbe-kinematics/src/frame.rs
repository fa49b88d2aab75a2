//! The frame that walks along a branch of a chain, for several poses side by side.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use pulp::{Scalar, Simd};

use crate::number::{Directions, Number, Vector};

/// Most poses that a processor takes at once.
pub(crate) const MOST: usize = 8;

/// A turn about a direction of a frame.
#[derive(Debug, Clone)]
pub(crate) struct Turn {
    /// Direction times angle.
    vector: Vector3<f64>,
    /// Where it turns the directions of the frame, column by column.
    turned: Matrix3<f64>,
}

impl Default for Turn {
    fn default() -> Self {
        Self { vector: Vector3::zeros(), turned: Matrix3::identity() }
    }
}

impl Turn {
    /// Makes it the turn about a unit direction.
    fn become_of(&mut self, direction: &Vector3<f64>, angle: f64) {
        let vector = direction * angle;
        if vector != self.vector {
            let turn = Rotation3::from_axis_angle(&Unit::new_unchecked(*direction), angle);
            *self = Self { vector, turned: turn.into_inner() };
        }
    }
}

/// The current frame on the way from the bed outwards, bed coordinates.
pub(crate) struct Frame<S: Simd> {
    pub simd: S,
    pub directions: Directions<S>,
    pub origin: Vector<S>,
    /// Nominal position of the frame with all axes at zero.
    nominal: Vector3<f64>,
    /// Whether errors move it. Else they are noted beside the nominal way.
    pub is_moved_by_errors: bool,
}

/// Whether one of these numbers is not zero; NaN is none.
#[inline(always)]
pub(crate) fn any(numbers: &[f64]) -> bool {
    numbers.iter().fold(false, |any, number| any | (*number != 0.0))
}

impl<S: Simd> Frame<S> {
    #[inline(always)]
    pub fn bed(simd: S) -> Self {
        let origin = Vector::all(simd, &Vector3::zeros());
        Self { simd, directions: Directions::same(simd), origin, nominal: Vector3::zeros(), is_moved_by_errors: true }
    }

    /// The same, for the nominal way.
    #[inline(always)]
    pub fn nominal_bed(simd: S) -> Self {
        Self { is_moved_by_errors: false, ..Self::bed(simd) }
    }

    /// Goes to a point of a rotary axis.
    #[inline(always)]
    pub fn go_to(&mut self, point: &Vector3<f64>) {
        let way = Vector::all(self.simd, &(point - self.nominal));
        self.origin = self.origin + self.directions.outwards(way);
        self.nominal = *point;
    }

    /// Turns the frame by the errors ec, eb and ea; returns the axes of ea and eb.
    #[inline(always)]
    pub fn turn_by(&mut self, errors: &[f64]) -> [Vector<S>; 2] {
        let width = errors.len() / 3;
        let (sin_a, cos_a) = sin_cos(self.simd, &errors[..width]);
        let (sin_b, cos_b) = sin_cos(self.simd, &errors[width..2 * width]);
        let (sin_c, cos_c) = sin_cos(self.simd, &errors[2 * width..]);
        let [x, y, z] = self.directions.0;
        // The frame after Rz, then after Ry, then after Rx; each step turns two of its axes.
        let (about_z_x, about_z_y) = (x * cos_c + y * sin_c, y * cos_c - x * sin_c);
        let (about_y_x, about_y_z) = (about_z_x * cos_b - z * sin_b, z * cos_b + about_z_x * sin_b);
        let (about_x_y, about_x_z) = (about_z_y * cos_a + about_y_z * sin_a, about_y_z * cos_a - about_z_y * sin_a);
        self.directions = Directions([about_y_x, about_x_y, about_x_z]);
        [about_y_x, about_z_y]
    }

    /// Turns the frame about one of its directions by these angles. `turn` is the last one of this axis.
    #[inline(always)]
    pub fn rotate(&mut self, direction: &Vector3<f64>, sense: f64, angles: &[f64], turn: &mut Turn) {
        // A spindle stands still as a rule.
        if !any(angles) {
            return;
        }
        let (poses, mut turned) = (angles.len(), [0.0; 9 * MOST]);
        for (pose, angle) in angles.iter().enumerate() {
            turn.become_of(direction, sense * angle);
            turn.turned.iter().enumerate().for_each(|(entry, value)| turned[poses * entry + pose] = *value);
        }
        let Directions([x, y, z]) = Directions::at(self.simd, S::as_simd_f64s(&turned[..9 * poses]).0, 0);
        let frame = self.directions;
        self.directions = Directions([frame.outwards(x), frame.outwards(y), frame.outwards(z)]);
    }
}

/// Sines and cosines of angles that are usually small. Up to 0.01 rad, power series are used, which are exact in double
/// precision.
#[inline(always)]
fn sin_cos<S: Simd>(simd: S, angles: &[f64]) -> (Number<S>, Number<S>) {
    if angles.iter().fold(false, |any, angle| any | (angle.abs() > SMALL)) {
        return sin_cos_of_large(simd, angles);
    }
    series(Number::at(simd, S::as_simd_f64s(angles).0, 0))
}

/// Largest angle, rad, of which power series are used.
const SMALL: f64 = 0.01;

/// Power series of sine and cosine.
#[inline(always)]
fn series<S: Simd>(angle: Number<S>) -> (Number<S>, Number<S>) {
    let (one, square) = (angle.like(1.0), angle * angle);
    let sine = one - square * angle.like(1.0 / 20.0) * (one - square * angle.like(1.0 / 42.0));
    let sine = angle - angle * square * angle.like(1.0 / 6.0) * sine;
    let cosine = one - square * angle.like(1.0 / 12.0) * (one - square * angle.like(1.0 / 30.0));
    let cosine = one - square * angle.like(0.5) * cosine;
    (sine, cosine)
}

/// The same where one of the angles is large.
fn sin_cos_of_large<S: Simd>(simd: S, angles: &[f64]) -> (Number<S>, Number<S>) {
    let (mut sines, mut cosines) = ([0.0; MOST], [0.0; MOST]);
    for ((sine, cosine), angle) in sines.iter_mut().zip(&mut cosines).zip(angles) {
        (*sine, *cosine) = match angle.abs() > SMALL {
            true => angle.sin_cos(),
            false => {
                let (sine, cosine) = series(Number::all(Scalar, *angle));
                (sine.0, cosine.0)
            }
        };
    }
    let [sine, cosine] = [&sines, &cosines].map(|all| Number::at(simd, S::as_simd_f64s(&all[..angles.len()]).0, 0));
    (sine, cosine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_of_small_angles_are_sine_and_cosine() {
        for step in -1200..=1200 {
            let angle = f64::from(step) * 1e-5 + 1e-9;
            let (sin, cos) = sin_cos(Scalar, &[angle]);
            assert!((sin.0 - angle.sin()).abs() <= 2.0 * f64::EPSILON * angle.abs(), "{angle}");
            assert!((cos.0 - angle.cos()).abs() <= f64::EPSILON, "{angle}");
        }
    }
}
