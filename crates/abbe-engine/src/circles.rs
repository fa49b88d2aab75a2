//! Circles whose column `angle` is not that of their positions: the test began elsewhere, or a file was put together wrongly.

use std::f64::consts::{PI, TAU};

use abbe_core::{DataRow, Dataset, Quantity};
use nalgebra::Vector2;

/// Fewest rows of a circle.
const ROWS: usize = 12;

/// Most rows that the circle is fitted to.
const FITTED: usize = 400;

/// Positions are a circle if their distances from its centre differ by less than this part of its radius.
const ROUND: f64 = 0.02;

/// Fewest degrees that they cover.
const COVERED: f64 = 90.0;

/// Degrees by which angles of the same row may differ: offsets of the centre and errors of a machine are less.
const SAME: f64 = 3.0;

/// Linear axes in the order in which angles turn: from X to Y, from Y to Z, from Z to X.
const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Sentences on circles whose column `angle` stays beside the angle of their positions.
pub(crate) fn contradicted_angles(data: &Dataset) -> Option<String> {
    let angle = data.column("angle").filter(|column| column.header.quantity == Quantity::Angle)?;
    let angles = data.numbers(&angle.header.name)?;
    // Where a rotary axis turns, the angle is its own.
    let turns = data.columns.iter().filter(|column| {
        column.header.quantity == Quantity::Angle && column.header.name.len() == 1 && column.header.name != "S"
    });
    if turns.filter_map(|column| data.numbers(&column.header.name)).any(varies) {
        return None;
    }
    let axes = AXES.map(|axis| {
        let column = data.column(axis).filter(|column| column.header.quantity == Quantity::Length);
        column.and_then(|_| data.numbers(axis)).filter(|positions| varies(positions))
    });
    let (plane, one, other) = match axes {
        [Some(x), Some(y), None] => (["X", "Y"], x, y),
        [None, Some(y), Some(z)] => (["Y", "Z"], y, z),
        [Some(x), None, Some(z)] => (["Z", "X"], z, x),
        _ => return None,
    };
    let labels = data.labels("run");
    let run = |row: &DataRow| (data.origins[*row].file, labels.map(|labels| labels[*row].as_str()));
    let rows: Vec<DataRow> = data.row_indices().collect();
    rows.chunk_by(|one, next| run(one) == run(next)).find_map(|rows| {
        let points: Vec<[f64; 3]> = rows.iter().map(|&row| [angles[row.0], one[row.0], other[row.0]]).collect();
        let off = offset(&points)?;
        let origin = data.origins[*rows.first()?];
        let place = format!("{}:{}", data.files[origin.file].display(), origin.line);
        Some(format!(
            "{place}: the column `angle` is {:.1} degrees beside the angle of the positions of {} and {} from here on: did the circle begin \
             elsewhere, or are angles counted from another axis?",
            off.to_degrees(),
            plane[0],
            plane[1]
        ))
    })
}

fn varies(values: &[f64]) -> bool {
    values.iter().any(|value| (value - values[0]).abs() > 1e-6)
}

/// By how much angles are beside those of the positions of their rows (angle, position, position), rad; none where these are no circle, where
/// angles fit or run the other way round.
fn offset(points: &[[f64; 3]]) -> Option<f64> {
    let (centre, radius) = circle(points)?;
    let places: Vec<[f64; 2]> = points.iter().map(|[_, one, other]| [one - centre[0], other - centre[1]]).collect();
    if places.iter().any(|[one, other]| (one.hypot(*other) - radius).abs() > ROUND * radius) {
        return None;
    }
    let beside: Vec<f64> =
        points.iter().zip(&places).map(|([angle, ..], [one, other])| wrapped(angle - other.atan2(*one))).collect();
    let sum = beside.iter().fold([0.0; 2], |sum, angle| [sum[0] + angle.cos(), sum[1] + angle.sin()]);
    let mean = sum[1].atan2(sum[0]);
    let is_one = beside.iter().all(|angle| wrapped(angle - mean).abs() < SAME.to_radians());
    let (mut covered, mut turned) = (0.0, 0.0);
    for pair in places.windows(2) {
        let [from, to] = [pair[0], pair[1]].map(|[one, other]: [f64; 2]| other.atan2(one));
        covered += wrapped(to - from);
        turned = f64::max(turned, covered.abs());
    }
    (is_one && turned > COVERED.to_radians() && mean.abs() > SAME.to_radians()).then_some(mean)
}

/// Centre and radius of the circle of least squares, by some of many points.
fn circle(points: &[[f64; 3]]) -> Option<([f64; 2], f64)> {
    if points.len() < ROWS {
        return None;
    }
    let step = points.len().div_ceil(FITTED);
    let places: Vec<Vector2<f64>> =
        points.iter().step_by(step).map(|[_, one, other]| Vector2::new(*one, *other)).collect();
    let found = abbe_geometry::circle(&places).ok()?.shape;
    Some((found.centre.into(), found.radius))
}

/// The same angle from -pi to pi.
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Random circles and arcs with offsets of their centre, errors and noise of a bad machine: their own angles fit, others do not.
    #[test]
    fn angles_that_are_not_those_of_the_positions_are_found() {
        let mut state = 1_u64;
        let mut part = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        for case in 0..500 {
            let (radius, centre) = (50.0 + 250.0 * part(), [200.0 * part(), 200.0 * part()]);
            let (from, sweep) = (TAU * part(), (100.0 + 350.0 * part()).to_radians());
            let sense = if part() < 0.5 { -1.0 } else { 1.0 };
            let error = [0.3 * part(), 0.3 * part(), 0.3 * part()];
            let points: Vec<[f64; 3]> = (0..200)
                .map(|row| {
                    let angle = from + sense * sweep * f64::from(row) / 199.0;
                    let round = radius + error[0] * (2.0 * angle).cos() + error[1] * (3.0 * angle).sin();
                    let noise = 0.02 * (part() - 0.5);
                    [
                        angle,
                        centre[0] + round * angle.cos() + noise,
                        centre[1] + round * (angle + 1e-3 * error[2]).sin(),
                    ]
                })
                .collect();
            assert_eq!(offset(&points), None, "{case}");
            let turned = |by: f64| points.iter().map(|[angle, x, y]| [angle + by, *x, *y]).collect::<Vec<_>>();
            let by = (5.0 + 170.0 * part()).to_radians() * sense;
            let found = offset(&turned(by)).unwrap_or_else(|| panic!("{case}: {by}"));
            assert!((found - by).abs() < 0.02, "{case}: {found} and {by}");
            // What runs the other way round has a sentence of its own.
            let against: Vec<[f64; 3]> = points.iter().map(|[angle, x, y]| [-angle, *x, *y]).collect();
            assert_eq!(offset(&against), None, "{case}");
        }
    }

    #[test]
    fn what_is_no_circle_says_nothing() {
        let line: Vec<[f64; 3]> = (0..50).map(|row| [f64::from(row), f64::from(row), 2.0 * f64::from(row)]).collect();
        assert_eq!(offset(&line), None);
        let square: Vec<[f64; 3]> =
            (0..100).map(|row| [f64::from(row) * 0.06, f64::from(row % 10), f64::from(row / 10)]).collect();
        assert_eq!(offset(&square), None);
        assert_eq!(offset(&[]), None);
    }
}
