//! A value through several runs.

use super::{Canvas, Scale, range};

/// A value with its intervals, run by run.
pub struct Trend {
    /// What it is.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Value and half-width of its interval; none where a run does not have it.
    pub points: Vec<Option<(f64, f64)>>,
}

/// A small chart.
pub fn trend(told: &Trend) -> String {
    let (left, right, top, bottom) = (52.0, 232.0, 20.0, 112.0);
    let mut canvas = Canvas::new(240.0, 146.0, &format!("{} in {} through the runs", told.name, told.unit));
    let known = || told.points.iter().enumerate().filter_map(|(run, point)| Some((run, (*point)?)));
    let ends = known().flat_map(|(_, (value, half))| [value - half, value + half]);
    let y = Scale::new(range(ends), [bottom, top]);
    let x = Scale::new([0.5, told.points.len() as f64 + 0.5], [left, right]);
    canvas.text("n", [left, 12.0], &told.name);
    canvas.text("e t", [right, 12.0], &told.unit);
    canvas.left(y, [left, right], 4);
    canvas.line("a", [left, bottom, right, bottom]);
    let every = told.points.len().div_ceil(8).max(1);
    for run in (0..told.points.len()).step_by(every) {
        canvas.text("m", [x.at(run as f64 + 1.0), bottom + 13.0], &(run + 1).to_string());
    }
    canvas.text("m l", [left.midpoint(right), bottom + 28.0], "run");
    let at = |run: usize, value: f64| [x.at(run as f64 + 1.0), y.at(value)];
    let line: Vec<[f64; 2]> = told
        .points
        .iter()
        .enumerate()
        .map(|(run, point)| point.map_or([f64::NAN; 2], |(value, _)| at(run, value)))
        .collect();
    canvas.path("s0 c", &line);
    for (run, (value, half)) in known() {
        let ([x1, y1], [x2, y2]) = (at(run, value - half), at(run, value + half));
        canvas.line("s0 w", [x1, y1, x2, y2]);
        canvas.mark(0, at(run, value), &format!("run {}: {}", run + 1, crate::number::with_uncertainty(value, half)));
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_the_value_interrupts_the_line() {
        let points = vec![Some((1.0, 0.2)), None, Some((2.0, 0.1)), Some((2.5, 0.3))];
        insta::assert_snapshot!(trend(&Trend { name: "EC0Y".to_owned(), unit: "µrad".to_owned(), points }));
    }
}
