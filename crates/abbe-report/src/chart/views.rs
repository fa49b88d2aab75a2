//! Points in space in three plane views.

use super::{Canvas, Scale, range};
use crate::subset::subset;

/// Points that are drawn at most.
const POINTS: usize = 4000;

/// Part of the width that the largest error takes.
const PART: f64 = 0.12;

/// Points with a value, and a field of errors: seen from above (X Y), from the front (X Z) and from the side (Y Z).
pub fn views(title: &str, points: &[([f64; 3], f64)], field: &[([f64; 3], [f64; 3])]) -> String {
    let mut canvas = Canvas::new(744.0, 268.0, title);
    let size = |error: &[f64; 3]| error.iter().map(|part| part * part).sum::<f64>().sqrt();
    let largest = field.iter().map(|(_, error)| size(error)).fold(0.0, f64::max);
    let places = || points.iter().map(|(place, _)| place).chain(field.iter().map(|(place, _)| place));
    let ranges = [0, 1, 2].map(|part| range(places().map(|place| place[part])));
    let width = ranges.iter().map(|[from, to]| to - from).fold(1e-9, f64::max);
    let factor = if largest > 0.0 { PART * width / largest } else { 0.0 };
    let shown = subset(points.len(), POINTS, |_| false);
    for (view, (across, up)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
        let left = 44.0 + 248.0 * view as f64;
        let (right, top, bottom) = (left + 196.0, 10.0, 232.0);
        // One scale for both directions.
        let half = (ranges[across][1] - ranges[across][0]).max((ranges[up][1] - ranges[up][0]) * 196.0 / 222.0) / 2.0;
        let around = |[from, to]: [f64; 2], half: f64| [from.midpoint(to) - half, from.midpoint(to) + half];
        let x = Scale::new(around(ranges[across], half), [left, right]);
        let y = Scale::new(around(ranges[up], half * 222.0 / 196.0), [bottom, top]);
        let letters = ["X", "Y", "Z"];
        canvas.bottom(x, [bottom, top], 4, &format!("{} mm (upwards {})", letters[across], letters[up]));
        canvas.left(y, [left, right], 4);
        for (place, error) in field {
            let end = [0, 1, 2].map(|part| place[part] + factor * error[part]);
            canvas.line("g e2", [x.at(place[across]), y.at(place[up]), x.at(end[across]), y.at(end[up])]);
        }
        for (class, sign) in [("s0 p", -1.0), ("s1 p", 1.0)] {
            let of = shown.iter().map(|index| &points[*index]).filter(|(_, value)| (*value < 0.0) == (sign < 0.0));
            canvas.dots(class, of.map(|(place, _)| [x.at(place[across]), y.at(place[up])]));
        }
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_views() {
        let points = [([0.0, 0.0, 0.0], -1.0), ([100.0, 50.0, 20.0], 2.0)];
        insta::assert_snapshot!(views("Places", &points, &[([0.0, 50.0, 0.0], [0.01, 0.0, 0.0])]));
    }
}
