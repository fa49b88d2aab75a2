//! Charts as SVG. Colours and lines are classes, which the style of the page sets for light, dark and paper.

mod choices;
mod control;
mod curves;
mod forest;
mod heat;
mod hemisphere;
mod residuals;
mod targets;
mod trend;
mod views;

use std::fmt::Write;

use crate::html::escape;
use crate::number::short;

pub use choices::{Choice, Span, choices, sequence};
pub use control::{Control, control};
pub use curves::{Curve, curve};
pub use forest::{ForestRow, forest};
pub use heat::heat_map;
pub use hemisphere::hemisphere;
pub use residuals::{Pair, Point, Polar, groups, pairs, polar, quantiles, scatter};
pub use targets::{Target, targets};
pub use trend::{Trend, trend};
pub use views::views;

/// Number of colours and marks that tell series apart.
pub const SERIES: usize = 6;

/// From values to places on the page.
#[derive(Debug, Clone, Copy)]
pub struct Scale {
    from: f64,
    to: f64,
    start: f64,
    end: f64,
}

impl Scale {
    /// Values from `from` to `to` between the places `start` and `end`. A range without a width gets one.
    pub fn new([from, to]: [f64; 2], [start, end]: [f64; 2]) -> Self {
        let wide = to > from && (to - from).is_finite();
        let more = (from.abs() * 0.1).max(1e-9);
        let (from, to) = if wide { (from, to) } else { (from - more, from + more) };
        Self { from, to, start, end }
    }

    /// The place of a value.
    pub fn at(self, value: f64) -> f64 {
        self.start + (value - self.from) / (self.to - self.from) * (self.end - self.start)
    }

    /// Round values in the range, about so many.
    pub fn ticks(self, about: usize) -> Vec<f64> {
        let step = (self.to - self.from) / about.max(1) as f64;
        let power = 10_f64.powf(step.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|part| part * power).into_iter().find(|round| *round >= step * 0.999);
        let step = step.unwrap_or(power * 10.0);
        let (first, last) = ((self.from / step - 1e-9).ceil() as i64, (self.to / step + 1e-9).floor() as i64);
        (first..=last.min(first + 50)).map(|index| index as f64 * step).collect()
    }
}

/// The smallest range that has all values, with a little more at both ends; 0 to 1 without values.
pub fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = values.filter(|value| value.is_finite());
    let [from, to] = finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[from, to], one| [from.min(one), to.max(one)]);
    if from > to {
        return [0.0, 1.0];
    }
    let more = (to - from) * 0.04;
    [from - more, to + more]
}

/// A number as a label of a tick.
pub fn tick_label(value: f64) -> String {
    let text = short(value);
    match text.contains('.') && !text.contains('e') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// The parts of an SVG.
pub struct Canvas {
    width: f64,
    height: f64,
    title: String,
    body: String,
}

impl Canvas {
    /// An empty one. `title` is what a screen reader says of it.
    pub fn new(width: f64, height: f64, title: &str) -> Self {
        Self { width, height, title: title.to_owned(), body: String::new() }
    }

    /// A straight line.
    pub fn line(&mut self, class: &str, [x1, y1, x2, y2]: [f64; 4]) {
        let [x1, y1, x2, y2] = [x1, y1, x2, y2].map(coordinate);
        let _ = writeln!(self.body, "<path class=\"{class}\" d=\"M{x1} {y1}L{x2} {y2}\"/>");
    }

    /// A rectangle.
    pub fn rectangle(&mut self, class: &str, [x, y, width, height]: [f64; 4]) {
        let [x, y, width, height] = [x, y, width.max(0.0), height.max(0.0)].map(coordinate);
        let _ =
            writeln!(self.body, "<rect class=\"{class}\" x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"/>");
    }

    /// Text; `class` says how it is aligned (`m` middle, `e` end).
    pub fn text(&mut self, class: &str, [x, y]: [f64; 2], text: &str) {
        let [x, y] = [x, y].map(coordinate);
        let _ = writeln!(self.body, "<text class=\"{class}\" x=\"{x}\" y=\"{y}\">{}</text>", escape(text));
    }

    /// A path through points; it is interrupted where a point is not finite.
    pub fn path(&mut self, class: &str, points: &[[f64; 2]]) {
        let _ = writeln!(self.body, "<path class=\"{class}\" d=\"{}\"/>", through(points));
    }

    /// Dots as one path of points with round ends.
    pub fn dots(&mut self, class: &str, points: impl Iterator<Item = [f64; 2]>) {
        let mut data = String::new();
        for [x, y] in points.filter(|point| point.iter().all(|part| part.is_finite())) {
            let _ = write!(data, "M{} {}h0", coordinate(x), coordinate(y));
        }
        if !data.is_empty() {
            let _ = writeln!(self.body, "<path class=\"{class}\" d=\"{data}\"/>");
        }
    }

    /// A mark of a series: its shape tells it as well as its colour.
    pub fn mark(&mut self, series: usize, [x, y]: [f64; 2], tip: &str) {
        let series = series % SERIES;
        let [x, y] = [x, y].map(coordinate);
        let shape = match series {
            0 => format!("M{x} {y}m-3.2 0a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0-6.4 0"),
            1 => format!("M{x} {y}m-3-3h6v6h-6z"),
            2 => format!("M{x} {y}m0-4l3.6 6.4h-7.2z"),
            3 => format!("M{x} {y}m0-4.2l4.2 4.2l-4.2 4.2l-4.2-4.2z"),
            4 => format!("M{x} {y}m-3.6-2.8h7.2l-3.6 6.4z"),
            _ => format!("M{x} {y}m-1.2-3.6h2.4v2.4h2.4v2.4h-2.4v2.4h-2.4v-2.4h-2.4v-2.4h2.4z"),
        };
        let _ = writeln!(self.body, "<path class=\"s{series} f\" d=\"{shape}\">{}</path>", tip_of(tip));
    }

    /// A circle with a text that shows when it is pointed at.
    pub fn ring(&mut self, class: &str, [x, y]: [f64; 2], radius: f64, tip: &str) {
        let [x, y, radius] = [x, y, radius].map(coordinate);
        let _ = writeln!(
            self.body,
            "<circle class=\"{class}\" cx=\"{x}\" cy=\"{y}\" r=\"{radius}\">{}</circle>",
            tip_of(tip)
        );
    }

    /// Markup of a path that is there already.
    pub fn raw_path(&mut self, class: &str, data: &str) {
        let _ = writeln!(self.body, "<path class=\"{class}\" d=\"{data}\"/>");
    }

    /// A horizontal axis below `y` with its grid up to `top`.
    pub fn bottom(&mut self, scale: Scale, [y, top]: [f64; 2], ticks: usize, name: &str) {
        for value in scale.ticks(ticks) {
            let x = scale.at(value);
            self.line("g", [x, top, x, y]);
            self.text("m", [x, y + 13.0], &tick_label(value));
        }
        self.line("a", [scale.start, y, scale.end, y]);
        self.text("m l", [scale.start.midpoint(scale.end), y + 28.0], name);
    }

    /// A vertical axis left of `x` with its grid up to `right`.
    pub fn left(&mut self, scale: Scale, [x, right]: [f64; 2], ticks: usize) {
        for value in scale.ticks(ticks) {
            let y = scale.at(value);
            self.line(if value == 0.0 { "a" } else { "g" }, [x, y, right, y]);
            self.text("e", [x - 4.0, y + 3.5], &tick_label(value));
        }
        self.line("a", [x, scale.start, x, scale.end]);
    }

    /// The whole.
    pub fn svg(self) -> String {
        let Self { width, height, title, body } = self;
        format!(
            "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" role=\"img\" aria-label=\"{}\">\n{body}</svg>\n",
            escape(&title)
        )
    }
}

fn tip_of(tip: &str) -> String {
    if tip.is_empty() { String::new() } else { format!("<title>{}</title>", escape(tip)) }
}

/// Path data through points.
fn through(points: &[[f64; 2]]) -> String {
    let mut data = String::new();
    let mut pen = 'M';
    for [x, y] in points {
        if !(x.is_finite() && y.is_finite()) {
            pen = 'M';
            continue;
        }
        let _ = write!(data, "{pen}{} {}", coordinate(*x), coordinate(*y));
        pen = 'L';
    }
    data
}

/// A coordinate to a tenth of a unit, as short as possible.
fn coordinate(value: f64) -> Tenth {
    Tenth((value.clamp(-1e6, 1e6) * 10.0).round() as i64)
}

/// Tenths of a unit.
struct Tenth(i64);

impl std::fmt::Display for Tenth {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (sign, size) = (if self.0 < 0 { "-" } else { "" }, self.0.unsigned_abs());
        match size % 10 {
            0 => write!(f, "{sign}{}", size / 10),
            tenth => write!(f, "{sign}{}.{tenth}", size / 10),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_in_the_range() {
        let cases = [
            ([0.0, 10.0], vec![0.0, 5.0, 10.0]),
            ([-3.2, 4.1], vec![-2.0, 0.0, 2.0, 4.0]),
            ([1e-5, 3e-5], vec![1e-5, 1.5e-5, 2e-5, 2.5e-5, 3e-5]),
        ];
        for (range, expected) in cases {
            let found = Scale::new(range, [0.0, 1.0]).ticks(4);
            assert_eq!(found.len(), expected.len(), "{range:?}: {found:?}");
            for (one, other) in found.iter().zip(&expected) {
                assert!((one - other).abs() < 1e-12, "{range:?}: {found:?}");
            }
        }
        // A range without a width, or one that is not finite, does no harm.
        for range in [[5.0, 5.0], [0.0, 0.0], [f64::NEG_INFINITY, f64::INFINITY]] {
            assert!(Scale::new(range, [0.0, 100.0]).ticks(5).len() < 60, "{range:?}");
        }
    }

    #[test]
    fn coordinates_are_short() {
        let told = [0.0, -0.04, -0.25, 12.349, 1e300, f64::NAN].map(|value| coordinate(value).to_string());
        assert_eq!(told, ["0", "0", "-0.3", "12.3", "1000000", "0"]);
        assert_eq!(through(&[[0.0, 1.0], [f64::NAN, 0.0], [2.0, 3.0], [4.0, 5.5]]), "M0 1M2 3L4 5.5");
    }

    #[test]
    fn a_chart_says_what_it_is() {
        let mut canvas = Canvas::new(100.0, 50.0, "a < b");
        canvas.bottom(Scale::new([0.0, 1.0], [10.0, 90.0]), [30.0, 5.0], 2, "X mm");
        canvas.mark(7, [50.0, 20.0], "\"tip\"");
        insta::assert_snapshot!(canvas.svg());
    }
}
