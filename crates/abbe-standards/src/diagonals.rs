//! Diagonal displacement tests in the manner of ISO 230-6: what body and face diagonals tell together, and what they hide.
//!
//! The text was not at hand. The figures of one diagonal are those of [`crate::positioning`]; that E_d and B_d are the largest of
//! all diagonals is a choice of this project (\[M\] in the documentation).

/// The edition that the symbols follow.
pub const EDITION: &str = "ISO 230-6:2002, in its manner";

/// Travel along an axis that is none, as a part of the length of the diagonal.
const NONE: f64 = 1e-3;

/// A diagonal: its way from the first to the last target by axis, X, Y and Z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Diagonal {
    /// Travel of each axis with its sign, mm.
    pub way: [f64; 3],
}

/// Which axes move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// All three.
    Body,
    /// Two of them: their places among X, Y, Z.
    Face([usize; 2]),
}

impl Diagonal {
    /// Its length, mm.
    pub fn length(&self) -> f64 {
        self.way.iter().map(|part| part * part).sum::<f64>().sqrt()
    }

    /// Body or face; none for the way of one axis.
    pub fn kind(&self) -> Option<Kind> {
        let moving: Vec<usize> = (0..3).filter(|axis| self.way[*axis].abs() > NONE * self.length()).collect();
        match moving[..] {
            [_, _, _] => Some(Kind::Body),
            [one, other] => Some(Kind::Face([one, other])),
            _ => None,
        }
    }
}

/// Squareness from the slopes of both diagonals of a face, and their travels a and b:
/// (e_pp - e_np) (a² + b²) / (2 a b), in the unit of the slopes (µm/m is µrad). Positive: the angle of the positive axes is below 90°.
///
/// ```
/// use abbe_standards::diagonals::squareness;
///
/// // A square of 1 m: the one diagonal is 10 um/m longer, the other 10 um/m shorter.
/// assert_eq!(squareness(10.0, -10.0, [1000.0, 1000.0]), 20.0);
/// ```
pub fn squareness(same: f64, opposite: f64, [one, other]: [f64; 2]) -> f64 {
    (same - opposite) * (one * one + other * other) / (2.0 * one.abs() * other.abs())
}

/// Scale errors of two axes that cancel along a diagonal, and along its mirror images: with `first` for the first axis, that of
/// the second is -first a²/b². A diagonal is longer by (a² e_x + b² e_y + c² e_z) / (a² + b² + c²).
///
/// ```
/// use abbe_standards::diagonals::cancelling;
///
/// assert_eq!(cancelling(10.0, [400.0, 200.0]), -40.0);
/// ```
pub fn cancelling(first: f64, [one, other]: [f64; 2]) -> f64 {
    -first * one * one / (other * other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_of_diagonals() {
        let of = |way| Diagonal { way }.kind();
        assert_eq!(of([400.0, -300.0, 250.0]), Some(Kind::Body));
        assert_eq!(of([0.0, -300.0, 250.0]), Some(Kind::Face([1, 2])));
        assert_eq!(of([0.0, 0.0, 250.0]), None);
        assert_eq!(of([0.0; 3]), None);
        assert_eq!(Diagonal { way: [400.0, -300.0, 0.0] }.length(), 500.0);
    }

    /// Lengths of a box that is sheared and scaled, by plain geometry.
    #[test]
    fn squareness_and_cancelling_scales_of_a_box_that_is_measured() {
        let (a, b) = (400.0, 300.0);
        let (shear, scale) = (3e-6, 10e-6);
        let other = cancelling(scale, [a, b]);
        // A positive squareness error turns Y towards X.
        let slope = |sign: f64, shear: f64, scales: [f64; 2]| {
            let (x, y) = (sign * a * (1.0 + scales[0]) + shear * b, b * (1.0 + scales[1]));
            x.hypot(y) / a.hypot(b) - 1.0
        };
        let found = squareness(slope(1.0, shear, [5e-6, -2e-6]), slope(-1.0, shear, [5e-6, -2e-6]), [a, b]);
        assert!((found - shear).abs() < 1e-10, "{found}");
        for sign in [1.0, -1.0] {
            assert!(slope(sign, 0.0, [scale, other]).abs() < 5e-10);
        }
    }
}
