//! Residuals: one by one, by group, against quantiles, around an axis.

use super::{Canvas, Scale, range};
use crate::number::short;

/// A point of a scatter plot.
pub struct Point {
    /// Time or number of the row.
    pub x: f64,
    /// Residual.
    pub y: f64,
    /// Its series.
    pub series: usize,
    /// What to show when it is pointed at, for those that stand out; else empty.
    pub tip: String,
}

/// Residuals in the order in which they were measured. Those with a text are ringed. `within` bounds the values: what is beyond
/// stands at the edge, with its value.
pub fn scatter(title: &str, [x_name, y_name]: [&str; 2], points: &[Point], within: [f64; 2]) -> String {
    let (left, right, top, bottom) = (52.0, 712.0, 20.0, 232.0);
    let mut canvas = Canvas::new(720.0, 266.0, title);
    let x = Scale::new(range(points.iter().map(|point| point.x)), [left, right]);
    let y = Scale::new(range(within.into_iter().chain([0.0])), [bottom, top]);
    canvas.bottom(x, [bottom, top], 8, x_name);
    canvas.left(y, [left, right], 6);
    canvas.text("t", [4.0, 12.0], y_name);
    for series in 0..super::SERIES {
        let of = points.iter().filter(|point| point.series % super::SERIES == series);
        let at = |point: &Point| [x.at(point.x), y.at(point.y).clamp(top, bottom)];
        canvas.dots(&format!("s{series} p"), of.map(at));
    }
    for point in points.iter().filter(|point| !point.tip.is_empty()) {
        let at = [x.at(point.x), y.at(point.y).clamp(top, bottom)];
        canvas.ring("o", at, 5.0, &point.tip);
        if point.y < within[0] || point.y > within[1] {
            let inside = if point.y < within[0] { -9.0 } else { 15.0 };
            canvas.text("m t", [at[0], at[1] + inside], &short(point.y));
        }
    }
    canvas.svg()
}

/// For each group its name, mean, root mean square and number of residuals: a bar for the root mean square, a mark for the
/// mean.
pub fn groups(title: &str, unit: &str, groups: &[(String, f64, f64, usize)]) -> String {
    let (left, right, top) = (130.0, 700.0, 6.0);
    let line = 15.0;
    let height = line * groups.len() as f64;
    let mut canvas = Canvas::new(720.0, top + height + 36.0, title);
    let ends = groups.iter().flat_map(|(_, mean, rms, _)| [*mean, *rms]).chain([0.0]);
    let x = Scale::new(range(ends), [left, right]);
    canvas.bottom(x, [top + height, top], 6, unit);
    for (index, (name, mean, rms, count)) in groups.iter().enumerate() {
        let y = top + line * index as f64;
        canvas.text("e t", [left - 6.0, y + 11.0], name);
        canvas.rectangle("bar", [x.at(0.0), y + 3.0, x.at(*rms) - x.at(0.0), line - 6.0]);
        let tip = format!("{name}: mean {mean:.2}, RMS {rms:.2} {unit}, {count} residuals");
        canvas.mark(1, [x.at(*mean), y + line / 2.0], &tip);
    }
    canvas.line("z", [x.at(0.0), top, x.at(0.0), top + height]);
    canvas.svg()
}

/// Two values of one size under a name.
pub struct Pair {
    /// The name.
    pub name: String,
    /// The bar.
    pub first: f64,
    /// The mark, if it is known.
    pub second: Option<f64>,
}

/// A bar for the first value of each pair, a mark for the second.
pub fn pairs(title: &str, unit: &str, told: &[Pair]) -> String {
    let (left, right, top, line) = (130.0, 700.0, 6.0, 15.0);
    let height = line * told.len() as f64;
    let mut canvas = Canvas::new(720.0, top + height + 36.0, title);
    let ends = told.iter().flat_map(|pair| [Some(pair.first), pair.second]).flatten().chain([0.0]);
    let x = Scale::new(range(ends), [left, right]);
    canvas.bottom(x, [top + height, top], 6, unit);
    for (index, pair) in told.iter().enumerate() {
        let y = top + line * index as f64;
        canvas.text("e t", [left - 6.0, y + 11.0], &pair.name);
        canvas.rectangle("bar", [x.at(0.0), y + 3.0, x.at(pair.first) - x.at(0.0), line - 6.0]);
        if let Some(second) = pair.second {
            let tip = format!("{}: {} and {} {unit}", pair.name, short(pair.first), short(second));
            canvas.mark(1, [x.at(second), y + line / 2.0], &tip);
        }
    }
    canvas.svg()
}

/// Ordered values against the quantiles of the normal distribution. The line is that of values that scatter as stated.
pub fn quantiles(title: &str, ordered: &[f64]) -> String {
    let (left, right, top, bottom) = (46.0, 312.0, 10.0, 232.0);
    let mut canvas = Canvas::new(320.0, 266.0, title);
    let count = ordered.len().max(1) as f64;
    let at = |index: usize| normal_quantile((index as f64 + 0.5) / count);
    let ends = ordered.iter().copied().chain([at(0), at(ordered.len().saturating_sub(1))]);
    let y = Scale::new(range(ends), [bottom, top]);
    let x = Scale::new(range([at(0), at(ordered.len().saturating_sub(1))].into_iter()), [left, right]);
    canvas.bottom(x, [bottom, top], 5, "expected, standard uncertainties");
    canvas.left(y, [left, right], 6);
    // All that stand out, and enough of the others.
    let every = (ordered.len() / 600).max(1);
    let edge = 60.min(ordered.len());
    let shown = (0..ordered.len())
        .filter(|index| index % every == 0 || *index < edge || *index + edge >= ordered.len())
        .map(|index| [x.at(at(index)), y.at(ordered[index])]);
    canvas.dots("s0 p", shown);
    let ends = [at(0), -at(0)];
    canvas.line("z", [x.at(ends[0]), y.at(ends[0]), x.at(ends[1]), y.at(ends[1])]);
    canvas.svg()
}

/// Residuals around a rotary axis.
pub struct Polar {
    /// Name of the axis, or of the axes that go round.
    pub axis: String,
    /// What the angle is of.
    pub of: String,
    /// Angles in degrees and values, of each series.
    pub series: Vec<Vec<(f64, f64)>>,
}

/// Values around a circle whose radius stands for zero.
pub fn polar(title: &str, unit: &str, told: &Polar) -> String {
    let middle = 164.0;
    let most = told.series.iter().flatten().map(|(_, value)| value.abs()).fold(1e-9, f64::max);
    let radius = |value: f64| 75.0 + value / most * 55.0;
    let mut canvas = Canvas::new(328.0, 336.0, title);
    for (class, value) in [("g", most), ("a", 0.0), ("g", -most)] {
        canvas.ring(&format!("{class} h"), [middle, middle], radius(value), "");
    }
    for degrees in [0.0_f64, 90.0, 180.0, 270.0] {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        let at = |radius: f64| [middle + radius * cosine, middle - radius * sine];
        let ([x1, y1], [x2, y2]) = (at(20.0), at(130.0));
        canvas.line("g", [x1, y1, x2, y2]);
        let [x, y] = at(141.0);
        canvas.text("m t", [x, y + 4.0], &format!("{degrees:.0}°"));
    }
    let at = |(degrees, value): &(f64, f64)| {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        [middle + radius(*value) * cosine, middle - radius(*value) * sine]
    };
    for (number, points) in told.series.iter().enumerate() {
        canvas.dots(&format!("s{number} p"), points.iter().map(at));
    }
    let text = format!("{}: rings at 0 and ± {} {unit}", told.axis, super::tick_label(most));
    canvas.text("m l", [middle, 330.0], &text);
    canvas.svg()
}

/// Quantile of the normal distribution to about 4.5e-4 (Abramowitz & Stegun 1964, 26.2.23): enough for a chart.
fn normal_quantile(probability: f64) -> f64 {
    let tail = probability.min(1.0 - probability).max(1e-12);
    let t = (-2.0 * tail.ln()).sqrt();
    let size = t
        - (2.515_517 + 0.802_853 * t + 0.010_328 * t * t)
            / (1.0 + 1.432_788 * t + 0.189_269 * t * t + 0.001_308 * t * t * t);
    if probability < 0.5 { -size } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_tables() {
        for (probability, expected) in [(0.5, 0.0), (0.975, 1.959_96), (0.001, -3.090_23), (0.158_655, -1.0)] {
            assert!((normal_quantile(probability) - expected).abs() < 5e-4, "{probability}");
        }
    }

    #[test]
    fn points_groups_and_circles() {
        let point = |x: f64, y: f64, tip: &str| Point { x, y, series: 0, tip: tip.to_owned() };
        let points = [point(1.0, 0.5, ""), point(2.0, -0.5, ""), point(3.0, 8.0, "a.csv:3")];
        insta::assert_snapshot!("scatter", scatter("Residuals", ["row", "µm"], &points, [-1.0, 1.0]));
        insta::assert_snapshot!("groups", groups("By feature", "µm", &[("7".to_owned(), -0.5, 1.25, 3)]));
        let pair = |name: &str, second| Pair { name: name.to_owned(), first: 3.0, second };
        insta::assert_snapshot!("pairs", pairs("Predicted", "µm", &[pair("5", Some(2.5)), pair("8", None)]));
        insta::assert_snapshot!("quantiles", quantiles("QQ", &[-1.2, -0.1, 0.2, 1.4]));
        let told = Polar { axis: "C".to_owned(), of: String::new(), series: vec![vec![(0.0, 1.0), (90.0, -2.0)]] };
        insta::assert_snapshot!("polar", polar("Around C", "µm", &told));
    }
}
