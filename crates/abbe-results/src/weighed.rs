//! What robust estimates need of rows that nobody holds: sums, and numbers by classes.

use std::collections::BTreeMap;

use crate::fit::Outlier;

/// How many numbers there are about a size: their number and their sum by classes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Histogram(BTreeMap<i64, (usize, f64)>);

impl Histogram {
    /// Adds a number to a class.
    pub fn add(&mut self, class: f64, value: f64) {
        // A class beyond the numbers is the last one.
        #[expect(clippy::cast_possible_truncation, reason = "the conversion saturates")]
        let (count, sum) = self.0.entry(class as i64).or_default();
        *count += 1;
        *sum += value;
    }

    /// Adds those of another one.
    pub fn join(&mut self, other: &Self) {
        for (class, (count, sum)) in &other.0 {
            let own = self.0.entry(*class).or_default();
            own.0 += count;
            own.1 += sum;
        }
    }

    /// The mean of each class with the number of its numbers, ascending.
    pub fn counted(&self) -> Vec<(f64, f64)> {
        self.0.values().map(|(count, sum)| (sum / *count as f64, *count as f64)).collect()
    }
}

/// The most outliers that are kept of rows in batches.
pub const MOST_OUTLIERS: usize = 10_000;

/// What robust weights make of some rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WeighedSums {
    /// The sum of the losses.
    pub objective: f64,
    /// The sum of the weights of measured rows.
    pub weights: f64,
    /// The sum of the slopes of their influence.
    pub slopes: f64,
    /// Their studentised sizes.
    pub sizes: Histogram,
    /// The slopes of those that are not left out; only at the solution.
    pub used_slopes: Histogram,
    /// Outliers, in the order of the rows: the [`MOST_OUTLIERS`] with the largest residuals; only at the solution.
    pub outliers: Vec<Outlier>,
    /// How many outliers there are.
    pub found: usize,
    /// Equations that are left out, and all, by artefact stage; only at the solution.
    pub left_out: BTreeMap<String, (usize, usize)>,
}

impl WeighedSums {
    /// Adds what later rows give.
    pub fn join(&mut self, later: &Self) {
        self.objective += later.objective;
        self.weights += later.weights;
        self.slopes += later.slopes;
        self.sizes.join(&later.sizes);
        self.used_slopes.join(&later.used_slopes);
        self.outliers.extend(later.outliers.iter().cloned());
        self.outliers = largest(std::mem::take(&mut self.outliers), MOST_OUTLIERS);
        self.found += later.found;
        for (set, (out, all)) in &later.left_out {
            let own = self.left_out.entry(set.clone()).or_default();
            own.0 += out;
            own.1 += all;
        }
    }
}

/// The outliers with the largest residuals, in their order; of equal ones the first.
fn largest(outliers: Vec<Outlier>, most: usize) -> Vec<Outlier> {
    if outliers.len() <= most {
        return outliers;
    }
    let mut order: Vec<usize> = (0..outliers.len()).collect();
    let size = |index: &usize| outliers[*index].residual_um.abs();
    order.sort_by(|one, other| size(other).total_cmp(&size(one)));
    let mut kept = vec![false; outliers.len()];
    order[..most].iter().for_each(|index| kept[*index] = true);
    outliers.into_iter().zip(kept).filter(|(_, kept)| *kept).map(|(outlier, _)| outlier).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_counted() {
        let (mut one, mut other) = (Histogram::default(), Histogram::default());
        one.add(-1.0, -0.5);
        one.add(2.0, 2.25);
        other.add(2.0, 2.75);
        one.join(&other);
        assert_eq!(one.counted(), [(-0.5, 1.0), (2.5, 2.0)]);
    }

    #[test]
    fn the_largest_outliers_stay_in_their_order() {
        let outlier = |row: usize, residual_um: f64| Outlier {
            stage: "table".to_owned(),
            file: "touches.csv".to_owned(),
            line: row + 1,
            row,
            residual_um,
            weight: 0.0,
        };
        let all = [5.0, -9.0, 9.0, 1.0].into_iter().enumerate().map(|(row, size)| outlier(row, size)).collect();
        let rows: Vec<usize> = largest(all, 2).iter().map(|outlier| outlier.row).collect();
        assert_eq!(rows, [1, 2]);
    }
}
