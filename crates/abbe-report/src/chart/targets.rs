//! Deviations at the targets of an axis, as reports of positioning show them.

use super::{Canvas, Scale, range};

/// A target: its position, and for the two directions of approach the mean deviation and twice the standard deviation; NaN where
/// there is none.
pub struct Target {
    /// Position.
    pub position: f64,
    /// Means, up and down.
    pub means: [f64; 2],
    /// Twice the standard deviations.
    pub spreads: [f64; 2],
}

/// Half of the way that the two directions stand apart, so that both are seen.
const APART: f64 = 1.5;

/// Means of both directions over the positions, each with a bar of two standard deviations on either side.
pub fn targets(title: &str, [position, unit]: [&str; 2], all: &[Target]) -> String {
    let (left, right, top, bottom) = (52.0, 632.0, 24.0, 236.0);
    let mut canvas = Canvas::new(640.0, 272.0, title);
    let ends = |target: &Target| {
        let of = |way: usize| {
            let spread = if target.spreads[way].is_finite() { target.spreads[way] } else { 0.0 };
            [target.means[way] - spread, target.means[way] + spread]
        };
        [of(0), of(1)]
    };
    let y = Scale::new(range(all.iter().flat_map(ends).flatten().chain([0.0])), [bottom, top]);
    let x = Scale::new(range(all.iter().map(|target| target.position)), [left, right]);
    canvas.text("n", [left, 14.0], title);
    canvas.text("e t", [right, 14.0], unit);
    canvas.bottom(x, [bottom, top], 8, position);
    canvas.left(y, [left, right], 6);
    for (way, class) in ["s0", "s1"].into_iter().enumerate() {
        let shift = if way == 0 { -APART } else { APART };
        for target in all.iter().filter(|target| target.means[way].is_finite()) {
            let (at, [low, high]) = (x.at(target.position) + shift, ends(target)[way]);
            canvas.line(&format!("{class} w"), [at, y.at(low), at, y.at(high)]);
        }
        let points = all.iter().map(|target| [x.at(target.position) + shift, y.at(target.means[way])]);
        canvas.path(&format!("{class} c{}", if way == 0 { "" } else { " d" }), &points.collect::<Vec<_>>());
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_direction_that_was_not_measured_is_left_out() {
        let target =
            |position: f64, down: f64| Target { position, means: [position / 50.0, down], spreads: [0.5, f64::NAN] };
        let all = [target(0.0, -1.0), target(100.0, f64::NAN), target(200.0, 3.0)];
        let svg = targets("X", ["mm", "µm"], &all);
        assert!(!svg.contains("NaN"), "{svg}");
        // A bar for each mean.
        let bars = |class: &str| svg.matches(&format!("class=\"{class} w\"")).count();
        assert_eq!([bars("s0"), bars("s1")], [3, 2], "{svg}");
    }
}
