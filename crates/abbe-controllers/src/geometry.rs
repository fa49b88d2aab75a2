//! Positions of axes and the paths between them.

use std::f64::consts::TAU;

/// Letters of axes in programs, in the order of [`Coordinates`].
pub const LETTERS: &[u8; 9] = b"XYZABCUVW";

/// Positions by letter: mm, and degrees of A, B and C.
pub type Coordinates = [f64; 9];

/// The place of a letter in [`Coordinates`].
pub fn place(letter: u8) -> Option<usize> {
    LETTERS.iter().position(|known| *known == letter)
}

/// Whether an axis of this place turns.
pub fn is_rotary(place: usize) -> bool {
    (3..6).contains(&place)
}

/// An arc in a plane of two coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Places of the coordinates; a positive turn runs from the first to the second.
    pub plane: [usize; 2],
    /// The centre.
    pub centre: [f64; 2],
    /// The angle that is turned, rad; negative clockwise.
    pub sweep: f64,
}

/// A path between two positions: straight in all coordinates, or an arc in two of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path {
    /// Its start.
    pub from: Coordinates,
    /// Its end.
    pub to: Coordinates,
    /// The arc, if it is one.
    pub arc: Option<Arc>,
}

impl Path {
    /// The position at a part of the path, from 0 to 1.
    pub fn at(&self, part: f64) -> Coordinates {
        let mut found = [0.0; 9];
        for (place, value) in found.iter_mut().enumerate() {
            *value = self.from[place] + part * (self.to[place] - self.from[place]);
        }
        if part >= 1.0 {
            return self.to;
        }
        if let Some(Arc { plane: [i, j], centre, sweep }) = self.arc {
            let radius = |end: &Coordinates| (end[i] - centre[0]).hypot(end[j] - centre[1]);
            let (first, last) = (radius(&self.from), radius(&self.to));
            let start = (self.from[j] - centre[1]).atan2(self.from[i] - centre[0]);
            let (angle, radius) = (start + part * sweep, first + part * (last - first));
            found[i] = centre[0] + radius * angle.cos();
            found[j] = centre[1] + radius * angle.sin();
        }
        found
    }

    /// Length of the linear coordinates, mm, and of the rotary ones, degrees; both at most.
    pub fn size(&self) -> (f64, f64) {
        let squares = |rotary: bool| {
            let of = (0..9).filter(|place| is_rotary(*place) == rotary).map(|place| self.to[place] - self.from[place]);
            of.map(|by| by * by).sum::<f64>().sqrt()
        };
        let mut linear = squares(false);
        if let Some(arc) = self.arc {
            linear = linear.max(self.radius(&arc) * arc.sweep.abs());
        }
        (linear, squares(true))
    }

    fn radius(&self, arc: &Arc) -> f64 {
        (self.from[arc.plane[0]] - arc.centre[0]).hypot(self.from[arc.plane[1]] - arc.centre[1])
    }

    /// Parts of an arc at which one of its coordinates turns around. Where its radius changes, that is not at a quarter of the circle:
    /// the path is inclined to the circle, by an angle whose tangent is the change of the radius by the arc length.
    pub fn turns(&self) -> Vec<f64> {
        let Some(arc) = self.arc else { return Vec::new() };
        let [i, j] = arc.plane;
        let radius = |end: &Coordinates| (end[i] - arc.centre[0]).hypot(end[j] - arc.centre[1]);
        let (first, last) = (radius(&self.from), radius(&self.to));
        let inclined = ((last - first) / (0.5 * (first + last) * arc.sweep)).atan();
        let start = (self.from[j] - arc.centre[1]).atan2(self.from[i] - arc.centre[0]) - inclined;
        let quarter = TAU / 4.0;
        let mut found: Vec<f64> = (-12..=12)
            .map(|count| (f64::from(count) * quarter - start) / arc.sweep)
            .filter(|part| *part > 1e-9 && *part < 1.0 - 1e-9)
            .collect();
        found.sort_by(f64::total_cmp);
        found
    }
}

/// The angle of an arc from its start to its end around a centre: above 0 against the clock, a full turn if they are one point.
pub fn sweep(from: [f64; 2], to: [f64; 2], centre: [f64; 2], clockwise: bool) -> f64 {
    let angle = |point: [f64; 2]| (point[1] - centre[1]).atan2(point[0] - centre[0]);
    let mut turn = angle(to) - angle(from);
    if (from[0] - to[0]).hypot(from[1] - to[1]) < 1e-9 {
        turn = 0.0;
    }
    if clockwise {
        while turn >= -1e-12 {
            turn -= TAU;
        }
    } else {
        while turn <= 1e-12 {
            turn += TAU;
        }
    }
    turn
}

/// The centre of an arc of a radius; a negative one makes the longer arc. None if the radius is shorter than half the chord.
pub fn centre_of_radius(from: [f64; 2], to: [f64; 2], radius: f64, clockwise: bool) -> Option<[f64; 2]> {
    let chord = [to[0] - from[0], to[1] - from[1]];
    let length = chord[0].hypot(chord[1]);
    let half = length / 2.0;
    if length < 1e-9 || radius.abs() < half * (1.0 - 1e-6) - 1e-6 {
        return None;
    }
    let height = (radius * radius - half * half).max(0.0).sqrt();
    // The centre of a short arc against the clock is to the left of its chord.
    let side = if clockwise == (radius > 0.0) { -1.0 } else { 1.0 };
    let left = [-chord[1] / length, chord[0] / length];
    Some([0, 1].map(|axis| (from[axis] + to[axis]) / 2.0 + side * height * left[axis]))
}

/// The centre of the circle through three points; none if they are on a line.
pub fn centre_of_three(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Option<[f64; 2]> {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let twice = 2.0 * (u[0] * v[1] - u[1] * v[0]);
    let (uu, vv) = (u[0] * u[0] + u[1] * u[1], v[0] * v[0] + v[1] * v[1]);
    let centre = [a[0] + (v[1] * uu - u[1] * vv) / twice, a[1] + (u[0] * vv - v[0] * uu) / twice];
    centre.iter().all(|value| value.is_finite()).then_some(centre)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arcs_turn_as_they_are_programmed() {
        let quarter = sweep([40.0, 0.0], [60.0, 20.0], [40.0, 20.0], false);
        assert!((quarter - TAU / 4.0).abs() < 1e-12);
        assert!((sweep([1.0, 0.0], [1.0, 0.0], [0.0, 0.0], true) + TAU).abs() < 1e-12);
        let centre = centre_of_radius([60.0, 20.0], [80.0, 40.0], 20.0, false).expect("an arc");
        assert!((centre[0] - 60.0).abs() < 1e-9 && (centre[1] - 40.0).abs() < 1e-9, "{centre:?}");
        assert_eq!(centre_of_radius([0.0, 0.0], [10.0, 0.0], 0.1, true), None);
        let arc = Arc { plane: [0, 1], centre: [0.0, 0.0], sweep: TAU / 2.0 };
        let mut path = Path { from: [0.0; 9], to: [0.0; 9], arc: Some(arc) };
        (path.from[0], path.to[0]) = (5.0, -5.0);
        let middle = path.at(0.5);
        assert!(middle[0].abs() < 1e-12 && (middle[1] - 5.0).abs() < 1e-12);
        assert_eq!(path.turns().len(), 1);
    }

    /// Next to a turn the coordinate that turns is on one side.
    #[test]
    fn coordinates_turn_where_they_are_said_to() {
        for (from, to, turn) in
            [([3.0, 4.0], [-3.0, 4.01], 1.0), ([-4.0, -3.0], [5.008, 0.3], 5.0), ([0.85, 4.0], [0.5, -4.08], -3.0)]
        {
            let mut path =
                Path { from: [0.0; 9], to: [0.0; 9], arc: Some(Arc { plane: [0, 1], centre: [0.0; 2], sweep: 0.0 }) };
            path.from[..2].copy_from_slice(&from);
            path.to[..2].copy_from_slice(&to);
            let sweep = sweep(from, to, [0.0; 2], turn < 0.0);
            path.arc = Some(Arc { plane: [0, 1], centre: [0.0; 2], sweep });
            let turns = path.turns();
            assert!(!turns.is_empty(), "{path:?}");
            for part in turns {
                let near = [-1.0, 0.0, 1.0].map(|side| path.at(part + side * 1e-5));
                let turned = (0..2).any(|axis| (near[1][axis] - near[0][axis]) * (near[2][axis] - near[1][axis]) < 0.0);
                assert!(turned, "{part} of {path:?}");
            }
        }
    }
}
