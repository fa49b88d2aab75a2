//! A selection of unknowns that the rows can separate, in an order of preference.

use faer::Mat;

use crate::factor::{Factor, SingularValues};
use crate::vector::dot;

/// Coefficients of a combination (unknowns scaled by their effect) below this are rounding.
const NOTHING: f64 = 1e-8;

/// Unknowns that are kept, and the others as combinations of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Selection {
    /// The unknowns that are kept, in the order of preference.
    pub kept: Vec<usize>,
    /// The unknowns that are left out, in the order of preference.
    pub left_out: Vec<UnestimableUnknown>,
    /// Ratio of the largest to the smallest singular value of the kept columns, scaled to norm 1.
    pub condition: f64,
}

/// An unknown that is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct UnestimableUnknown {
    /// The unknown.
    pub unknown: usize,
    /// The combination of kept unknowns with the same effect on the rows as one unit of it: (unknown, coefficient in its
    /// unit). Empty if it has no effect on any row.
    pub same_as: Vec<(usize, f64)>,
}

impl Factor {
    /// Goes through unknowns in an order of preference. It keeps each unknown whose effect on the rows is not a combination
    /// of the effects of the kept ones before it: the remaining part is more than `tolerance` of its effect (Gram-Schmidt
    /// orthogonalisation, twice for each column). `order` need not contain all unknowns.
    pub fn select(&self, order: &[usize], tolerance: f64) -> Selection {
        let (mut kept, mut left_out) = (Vec::new(), Vec::new());
        // Directions of norm 1, and the kept columns (scaled to norm 1) as combinations of them, an upper triangle.
        let (mut directions, mut parts): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        for &unknown in order {
            let norm = self.norms()[unknown];
            if norm == 0.0 {
                left_out.push(UnestimableUnknown { unknown, same_as: Vec::new() });
                continue;
            }
            let mut rest: Vec<f64> = self.column(unknown).iter().map(|value| value / norm).collect();
            let mut part = vec![0.0; directions.len()];
            for _ in 0..2 {
                for (direction, part) in directions.iter().zip(&mut part) {
                    let along = dot(direction, &rest);
                    *part += along;
                    rest.iter_mut().zip(direction).for_each(|(value, direction)| *value -= along * direction);
                }
            }
            let length = dot(&rest, &rest).sqrt();
            if length > tolerance {
                part.push(length);
                parts.push(part);
                rest.iter_mut().for_each(|value| *value /= length);
                directions.push(rest);
                kept.push(unknown);
            } else {
                let combination = combination(&parts, part);
                let same = combination.into_iter().zip(&kept).filter(|(effect, _)| effect.abs() > NOTHING);
                let same_as = same.map(|(effect, &other)| (other, effect * norm / self.norms()[other])).collect();
                left_out.push(UnestimableUnknown { unknown, same_as });
            }
        }
        let size = parts.len();
        let entry = |row: usize, column: usize| parts[column].get(row).copied().unwrap_or(0.0);
        let values = Mat::from_fn(size, size, entry).singular_values().unwrap_or_default();
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        Selection { kept, left_out, condition: SingularValues::new(values).condition(size) }
    }
}

/// The combination of the columns of an upper triangle that gives `right`, by substitution.
fn combination(columns: &[Vec<f64>], mut right: Vec<f64>) -> Vec<f64> {
    for (index, column) in columns.iter().enumerate().rev() {
        let factor = right[index] / column[index];
        right[..index].iter_mut().zip(column).for_each(|(value, column)| *value -= factor * column);
        right[index] = factor;
    }
    right
}

#[cfg(test)]
mod tests {
    use crate::Accumulator;

    use super::*;

    fn factor(rows: &[[f64; 4]]) -> Factor {
        let mut accumulator = Accumulator::new(4, rows.len());
        rows.iter().for_each(|row| accumulator.push(row, 0.0, 1.0));
        accumulator.finish()
    }

    #[test]
    fn the_order_decides_which_of_several_is_kept() {
        // The third column is 2 a - 3 b, the fourth does nothing.
        let rows: Vec<[f64; 4]> = [(1.0, 0.5), (0.0, 2.0), (-1.0, 1.0), (4.0, 0.0), (2.0, -7.0)]
            .map(|(a, b)| [a, b, 2.0 * a - 3.0 * b, 0.0])
            .to_vec();
        let factor = factor(&rows);
        let first = factor.select(&[0, 1, 2, 3], 1e-9);
        assert_eq!(first.kept, [0, 1]);
        assert_eq!(first.left_out[1], UnestimableUnknown { unknown: 3, same_as: Vec::new() });
        for ((unknown, found), (other, expected)) in first.left_out[0].same_as.iter().zip([(0, 2.0), (1, -3.0)]) {
            assert!(*unknown == other && (found - expected).abs() < 1e-13, "{found}");
        }
        let second = factor.select(&[2, 3, 1, 0], 1e-9);
        assert_eq!(second.kept, [2, 1]);
        let same_as = &second.left_out[1].same_as;
        assert!((same_as[0].1 - 0.5).abs() < 1e-13 && (same_as[1].1 - 1.5).abs() < 1e-13, "{same_as:?}");
        assert!(first.condition > 1.0 && second.condition > first.condition);
        assert_eq!(factor.select(&[1], 1e-9).condition, 1.0);
    }
}
