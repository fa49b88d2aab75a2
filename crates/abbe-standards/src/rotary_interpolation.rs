//! Interpolation of a rotary axis with linear axes that follow a ball, in the manner of ISO 10791-6 (R-test, ball and sensors).
//!
//! The text of the standard was not at hand: which of its tests AK, BK and CK this is, and their limits, are not public. Only ranges
//! are given, of readings as set up, not centred; that they are its figures is a choice of this project.
//!
//! Readings in one unit, angles in rad.

use nalgebra::{Unit, UnitQuaternion, Vector3};

/// The edition that the figures follow.
pub const EDITION: &str = "ISO 10791-6:2014, in its manner";

/// Ranges of one quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ranges {
    /// Of the way up: angles increase.
    pub up: Option<f64>,
    /// Of the way down.
    pub down: Option<f64>,
    /// Of both together, where there are both.
    pub both: Option<f64>,
}

/// `max - min` of the values of each way and of both; `ways` is true for those on the way up.
pub fn ranges(values: &[f64], ways: &[bool]) -> Ranges {
    let of = |way: Option<bool>| {
        let own = || values.iter().zip(ways).filter(move |(_, own)| way.is_none_or(|way| **own == way));
        let values = || own().map(|(value, _)| *value);
        values().reduce(f64::max).zip(values().reduce(f64::min)).map(|(most, least)| most - least)
    };
    let (up, down) = (of(Some(true)), of(Some(false)));
    Ranges { up, down, both: up.and(down).and(of(None)) }
}

/// Where the ball is: the axis and the ball at angle 0 from a point of the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    axis: Unit<Vector3<f64>>,
    radial: Unit<Vector3<f64>>,
    sense: f64,
}

impl Path {
    /// A ball that turns about an axis by the angle times the sense (1 or -1); none for a ball on the axis, whose radial direction
    /// has no meaning.
    pub fn new(axis: [f64; 3], ball: [f64; 3], sense: f64) -> Option<Self> {
        let (axis, ball) = (Unit::try_new(Vector3::from(axis), 1e-9)?, Vector3::from(ball));
        let across = ball - axis.dot(&ball) * axis.into_inner();
        Some(Self { axis, radial: Unit::try_new(across, 1e-6 * (1.0 + ball.norm()))?, sense })
    }

    /// The radial direction at an angle.
    pub fn radial(&self, angle: f64) -> [f64; 3] {
        (UnitQuaternion::from_axis_angle(&self.axis, self.sense * angle) * self.radial).into_inner().into()
    }

    /// A reading along the radial direction (outwards), the tangential one (with the right hand about the axis) and the axis.
    pub fn split(&self, angle: f64, reading: [f64; 3]) -> [f64; 3] {
        let (radial, reading) = (Vector3::from(self.radial(angle)), Vector3::from(reading));
        [radial.dot(&reading), self.axis.cross(&radial).dot(&reading), self.axis.dot(&reading)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worked_example_of_a_ball_that_is_off_outwards() {
        // A ball on a table that turns by -angle, 3 further out, 2 along the turn, 1 up at half a turn.
        let path = Path::new([0.0, 0.0, 1.0], [110.0, 0.0, 60.0], -1.0).expect("a path");
        let angle = 30.0_f64.to_radians();
        let (sin, cos) = (-angle).sin_cos();
        let [radial, tangential, axial] = path.split(angle, [3.0 * cos - 2.0 * sin, 3.0 * sin + 2.0 * cos, 1.0]);
        assert!((radial - 3.0).abs() < 1e-14 && (tangential - 2.0).abs() < 1e-14 && (axial - 1.0).abs() < 1e-15);
        assert_eq!(Path::new([0.0, 0.0, 1.0], [0.0, 0.0, 60.0], 1.0), None);
        let about_x = Path::new([1.0, 0.0, 0.0], [0.0, 0.0, 140.0], -1.0).expect("a path");
        let at = about_x.radial(-90.0_f64.to_radians());
        assert!((at[1] + 1.0).abs() < 1e-15, "{at:?}");
    }

    #[test]
    fn ranges_of_each_way_and_of_both() {
        let found = ranges(&[0.0, 2.0, -1.0, 5.0, 4.0], &[true, true, true, false, false]);
        assert_eq!(found, Ranges { up: Some(3.0), down: Some(1.0), both: Some(6.0) });
        assert_eq!(ranges(&[1.0, 2.0], &[true, true]), Ranges { up: Some(1.0), down: None, both: None });
        assert_eq!(ranges(&[], &[]), Ranges { up: None, down: None, both: None });
    }
}
