//! An error along its axis.

use super::{Canvas, Scale, range};

/// An error sampled along its axis.
pub struct Curve {
    /// Positions.
    pub positions: Vec<f64>,
    /// Values when the axis came in positive direction.
    pub forward: Vec<f64>,
    /// Half-widths of the intervals around them.
    pub half: Vec<f64>,
    /// Values when it came in negative direction; empty if the direction makes no difference.
    pub backward: Vec<f64>,
}

/// A small chart of a curve with its band. The second direction is dashed.
pub fn curve(title: &str, [position, value]: [&str; 2], curve: &Curve) -> String {
    let (left, right, top, bottom) = (44.0, 232.0, 20.0, 112.0);
    let mut canvas = Canvas::new(240.0, 146.0, title);
    let pairs = || curve.forward.iter().zip(&curve.half);
    let ends = pairs().flat_map(|(value, half)| [value - half, value + half]);
    let y = Scale::new(range(ends.chain(curve.backward.iter().copied()).chain([0.0])), [bottom, top]);
    let x = Scale::new(range_of(&curve.positions), [left, right]);
    canvas.text("n", [left, 12.0], title);
    canvas.text("e t", [right, 12.0], value);
    canvas.bottom(x, [bottom, top], 4, position);
    canvas.left(y, [left, right], 4);
    let at = |index: usize, value: f64| [x.at(curve.positions[index]), y.at(value)];
    let upper = pairs().enumerate().map(|(index, (value, half))| at(index, value + half));
    let lower = pairs().enumerate().map(|(index, (value, half))| at(index, value - half)).rev();
    canvas.path("band", &upper.chain(lower).collect::<Vec<_>>());
    let line = |values: &[f64]| values.iter().enumerate().map(|(index, value)| at(index, *value)).collect::<Vec<_>>();
    canvas.path("s0 c", &line(&curve.forward));
    if !curve.backward.is_empty() {
        canvas.path("s1 c d", &line(&curve.backward));
    }
    canvas.svg()
}

/// From the first to the last position.
fn range_of(positions: &[f64]) -> [f64; 2] {
    [positions.first().copied().unwrap_or(0.0), positions.last().copied().unwrap_or(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_directions_and_a_band() {
        let told = Curve {
            positions: vec![0.0, 50.0, 100.0],
            forward: vec![0.0, 1.0, 4.0],
            half: vec![0.5, 0.5, 1.0],
            backward: vec![-1.0, 0.0, 3.0],
        };
        insta::assert_snapshot!(curve("EXX", ["X mm", "µm"], &told));
    }
}
