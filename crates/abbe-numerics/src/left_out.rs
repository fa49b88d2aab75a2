//! Which unknowns are left out where directions are lost.

use faer::Mat;

use crate::vector::norm;

/// Parts of the largest share in what is lost from which an unknown may be the one that is left out: the smaller, the more is left to
/// the preference, and the worse may be what remains.
const SHARES: [f64; 4] = [0.1, 0.3, 0.6, 0.9];

/// How many times as large an error of a start value may stand in the others as it does where those that take part most are left out.
const WORSE: f64 = 10.0;

/// One unknown for every lost direction; `lost` has the shares of every unknown in the directions, which are orthonormal.
///
/// Of those that take part enough, the last in the order of preference goes first. Each choice is good enough by itself, and many of them
/// may be bad together: then more is asked of each.
pub(crate) fn left_out(lost: &[Vec<f64>], order: &[usize]) -> Vec<usize> {
    let choices = SHARES.map(|share| chosen(lost, order, share));
    let worst = |choice: &Vec<usize>| smallest_singular_value(lost, choice);
    let asked = choices.last().map_or(0.0, worst) / WORSE;
    let [by_preference @ .., by_share] = &choices;
    by_preference.iter().find(|choice| worst(choice) >= asked).unwrap_or(by_share).clone()
}

/// One unknown for every lost direction, each with at least some part of the largest share in what the others have left of it.
fn chosen(lost: &[Vec<f64>], order: &[usize], share: f64) -> Vec<usize> {
    let mut left = lost.to_vec();
    let mut chosen = Vec::new();
    for _ in 0..lost.first().map_or(0, Vec::len) {
        let free = || order.iter().rev().copied().filter(|row| !chosen.contains(row));
        let largest = free().map(|row| norm(&left[row])).fold(0.0, f64::max);
        let Some(next) = free().find(|&row| norm(&left[row]) >= share * largest) else { break };
        let length = norm(&left[next]).max(f64::MIN_POSITIVE);
        let direction: Vec<f64> = left[next].iter().map(|value| value / length).collect();
        for row in &mut left {
            let along: f64 = row.iter().zip(&direction).map(|(value, direction)| value * direction).sum();
            row.iter_mut().zip(&direction).for_each(|(value, direction)| *value -= along * direction);
        }
        chosen.push(next);
    }
    chosen.sort_unstable();
    chosen
}

/// The smallest singular value of some of the rows; 0 where there is none.
fn smallest_singular_value(lost: &[Vec<f64>], rows: &[usize]) -> f64 {
    let columns = lost.first().map_or(0, Vec::len);
    let matrix = Mat::from_fn(rows.len(), columns, |row, column| lost[rows[row]][column]);
    matrix.singular_values().ok().and_then(|values| values.last().copied()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use crate::sampling::Generator;

    use super::*;

    /// Shares of some unknowns in lost directions, which are orthonormal; some unknowns take part in them far less than others.
    fn lost(random: &mut Generator, unknowns: usize, directions: usize) -> Vec<Vec<f64>> {
        let sizes: Vec<f64> = (0..unknowns).map(|_| 10.0_f64.powf(-1.5 * random.uniform())).collect();
        let shares = Mat::from_fn(unknowns, directions, |row, _| sizes[row] * random.normal());
        let basis = shares.qr().compute_thin_Q();
        (0..unknowns).map(|row| (0..directions).map(|column| basis[(row, column)]).collect()).collect()
    }

    #[test]
    fn choices_together_are_hardly_worse_than_the_best() {
        let mut worse_by_the_first_share = 0;
        for seed in 0..500 {
            let random = &mut Generator::new(seed, 0);
            let lost = lost(random, 14, 1 + (seed % 7) as usize);
            let mut order: Vec<usize> = (0..lost.len()).collect();
            order.sort_by_key(|_| random.uniform().to_bits());
            let smallest = |rows: &[usize]| smallest_singular_value(&lost, rows);
            let best = smallest(&chosen(&lost, &order, 0.9));
            let left_out = left_out(&lost, &order);
            assert_eq!(left_out.len(), lost[0].len(), "seed {seed}");
            assert!(smallest(&left_out) >= best / WORSE, "seed {seed}: {:e} of {best:e}", smallest(&left_out));
            worse_by_the_first_share += usize::from(smallest(&chosen(&lost, &order, SHARES[0])) < best / WORSE);
        }
        assert!(worse_by_the_first_share > 5, "{worse_by_the_first_share}: the law would hold by itself");
    }
}
