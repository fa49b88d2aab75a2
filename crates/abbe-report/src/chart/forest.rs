//! Values with intervals below each other.

use super::{Canvas, Scale, range};

/// A value of several estimates.
pub struct ForestRow {
    /// Its name.
    pub name: String,
    /// For each estimate value, half-width of the interval, and what to show when it is pointed at; none if it has none.
    pub values: Vec<Option<(f64, f64, String)>>,
}

/// Height of a line of one estimate.
const LINE: f64 = 9.0;

/// Rows on one scale. `unit` stands below the scale.
pub fn forest(title: &str, unit: &str, rows: &[ForestRow]) -> String {
    let count = rows.iter().map(|row| row.values.len()).max().unwrap_or(1);
    let height_of = |row: &ForestRow| 9.0 + LINE * row.values.iter().flatten().count().max(1) as f64;
    let height: f64 = rows.iter().map(height_of).sum();
    let (left, right, top) = (130.0, 700.0, 8.0);
    let all = rows.iter().flat_map(|row| row.values.iter().flatten());
    let ends = all.flat_map(|(value, half, _)| [value - half, value + half]).chain([0.0]);
    let scale = Scale::new(range(ends), [left, right]);
    let mut canvas = Canvas::new(720.0, top + height + 36.0, title);
    canvas.bottom(scale, [top + height, top], 6, unit);
    canvas.line("z", [scale.at(0.0), top, scale.at(0.0), top + height]);
    let mut y = top;
    for row in rows {
        let tall = height_of(row);
        canvas.text("e n", [left - 8.0, y + tall / 2.0 + 3.5], &row.name);
        let mut at = y + 4.5 + LINE / 2.0;
        for (series, value) in row.values.iter().enumerate().take(count) {
            let Some((value, half, tip)) = value else { continue };
            let series = series % super::SERIES;
            canvas.line(&format!("s{series} w"), [scale.at(value - half), at, scale.at(value + half), at]);
            canvas.mark(series, [scale.at(*value), at], tip);
            at += LINE;
        }
        y += tall;
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_estimates_of_a_value() {
        let value = |value, half| Some((value, half, format!("{value} ± {half}")));
        let rows = [
            ForestRow { name: "EXX[1]".to_owned(), values: vec![value(3.0, 1.0), value(2.0, 0.5)] },
            ForestRow { name: "EXX[2]".to_owned(), values: vec![None, value(-1.0, 2.0)] },
        ];
        insta::assert_snapshot!(forest("Parameters of X", "µm/m", &rows));
    }
}
