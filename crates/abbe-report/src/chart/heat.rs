//! A map of correlations.

use std::fmt::Write;

use super::Canvas;

/// Steps of the absolute correlation, weakest first; weaker ones are left white.
const STEPS: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 0.95];

/// The lower triangle of a matrix of correlations from -1 to 1.
pub fn heat_map(title: &str, names: &[String], correlation: impl Fn(usize, usize) -> f64) -> String {
    let count = names.len();
    let cell = (600.0 / count.max(1) as f64).clamp(4.0, 16.0);
    let left = 96.0;
    let size = cell * count as f64;
    let mut canvas = Canvas::new(left + size + 150.0, size + 22.0, title);
    let mut paths = vec![String::new(); 2 * STEPS.len()];
    for row in 0..count {
        for column in 0..row {
            let value = correlation(row, column);
            let Some(step) = STEPS.iter().rposition(|least| value.abs() >= *least) else { continue };
            let (x, y) = (left + column as f64 * cell, 4.0 + row as f64 * cell);
            let path = &mut paths[2 * step + usize::from(value < 0.0)];
            let side = super::coordinate(cell - 0.4);
            let _ = write!(path, "M{} {}h{side}v{side}h-{side}z", super::coordinate(x), super::coordinate(y));
        }
    }
    for (index, path) in paths.iter().enumerate().filter(|(_, path)| !path.is_empty()) {
        canvas.raw_path(&format!("c{index}"), path);
    }
    // Every name where there is room, else some of them.
    let every = (11.0 / cell).ceil().max(1.0) as usize;
    for (index, name) in names.iter().enumerate().filter(|(index, _)| index % every == 0) {
        canvas.text("e t", [left - 4.0, 4.0 + (index as f64 + 0.5) * cell + 3.0], name);
    }
    for (step, least) in STEPS.iter().enumerate() {
        let y = 10.0 + 16.0 * step as f64;
        canvas.rectangle(&format!("c{}", 2 * step), [left + size - 4.0, y, 12.0, 12.0]);
        canvas.rectangle(&format!("c{}", 2 * step + 1), [left + size + 10.0, y, 12.0, 12.0]);
        canvas.text("t", [left + size + 28.0, y + 9.5], &format!("+ / - {least} and more"));
    }
    canvas.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strong_correlations_have_cells() {
        let names = ["a", "b", "c"].map(str::to_owned);
        let correlation = |row: usize, column: usize| [[1.0; 3], [-0.97, 1.0, 1.0], [0.1, 0.5, 1.0]][row][column];
        insta::assert_snapshot!(heat_map("Correlations", &names, correlation));
    }
}
