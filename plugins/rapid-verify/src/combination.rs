//! Combinations of point deviations that respond to one error alone (announced in Muelaner et al. 2014, section 4.1, but not
//! printed there): insensitive to shift, rotation and expansion of the artefact, with the least sum of absolute weights.

use abbe_numerics::{dot, norm};

/// Weights of the points and the gain of the combination.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// One weight a point; the largest is 1.
    pub weights: Vec<f64>,
    /// Value of the combination per unit of the error, mm/unit; positive.
    pub gain: f64,
}

/// Values below this count as zero where numbers are of size 1.
const ZERO: f64 = 1e-9;

/// Smallest part of an effect that changes of the artefact may leave over; less is rounding.
const DISTINCT: f64 = 1e-6;

/// The combination that responds to `effect` and not to `blind_to`; none if those effects can produce the same deviations.
pub fn combination(effect: &[f64], blind_to: &[Vec<f64>]) -> Option<Weights> {
    let blind = orthonormal(blind_to);
    let size = norm(effect);
    let own = without(effect, &blind);
    if size == 0.0 || norm(&own) <= DISTINCT * size {
        return None;
    }
    // min sum |w| with own . w = |own| and b . w = 0: each weight is the difference of two that are not negative.
    let scale = norm(&own);
    let mut rows: Vec<(Vec<f64>, f64)> = blind.iter().map(|row| (both(row, 1.0), 0.0)).collect();
    rows.push((both(&own, 1.0 / scale), 1.0));
    let solution = simplex(&rows, 2 * effect.len())?;
    let points = effect.len();
    let mut weights: Vec<f64> = (0..points).map(|point| solution[point] - solution[points + point]).collect();
    let largest = weights.iter().fold(0.0_f64, |largest, weight| largest.max(weight.abs()));
    weights.iter_mut().for_each(|weight| *weight /= largest);
    weights.iter_mut().filter(|weight| weight.abs() < ZERO).for_each(|weight| *weight = 0.0);
    let gain = dot(&weights, effect);
    Some(Weights { weights, gain })
}

/// A row for positive and negative parts of the weights.
fn both(row: &[f64], factor: f64) -> Vec<f64> {
    let positive = row.iter().map(|value| value * factor);
    positive.clone().chain(positive.map(|value| -value)).collect()
}

/// Minimises the sum of variables that are not negative under `row . x = value` with values that are not negative.
///
/// Dense tableau in two phases, the leaving and entering variables by Bland's rule, which cannot cycle: some dozens of points
/// and eight rows need no more.
fn simplex(rows: &[(Vec<f64>, f64)], count: usize) -> Option<Vec<f64>> {
    let artificial = rows.len();
    let width = count + artificial;
    let mut tableau: Vec<Vec<f64>> = Vec::new();
    for (index, (row, value)) in rows.iter().enumerate() {
        let mut line = row.clone();
        line.extend((0..artificial).map(|other| if other == index { 1.0 } else { 0.0 }));
        line.push(*value);
        tableau.push(line);
    }
    let mut base: Vec<usize> = (count..width).collect();
    let phase = |tableau: &mut Vec<Vec<f64>>, base: &mut Vec<usize>, cost: &dyn Fn(usize) -> f64, allowed: usize| {
        // A vertex has a finite number of neighbours, and none is visited twice; the bound is for rounding.
        for _ in 0..50 * width {
            let priced = |column: usize| {
                let of_base = base.iter().zip(tableau.iter()).map(|(&variable, line)| cost(variable) * line[column]);
                cost(column) - of_base.sum::<f64>()
            };
            let Some(entering) = (0..allowed).find(|column| !base.contains(column) && priced(*column) < -ZERO) else {
                return true;
            };
            let ratio = |line: &Vec<f64>| (line[entering] > ZERO).then(|| line[width] / line[entering]);
            let least = tableau.iter().filter_map(ratio).fold(f64::INFINITY, f64::min);
            let leaving = (0..base.len())
                .filter(|&index| ratio(&tableau[index]).is_some_and(|ratio| ratio <= least + ZERO * ZERO))
                .min_by_key(|&index| base[index]);
            let Some(leaving) = leaving else { return false };
            pivot(tableau, leaving, entering);
            base[leaving] = entering;
        }
        false
    };
    let is_artificial = |variable: usize| if variable >= count { 1.0 } else { 0.0 };
    let feasible = phase(&mut tableau, &mut base, &is_artificial, count);
    let rest: f64 =
        base.iter().zip(&tableau).filter(|(variable, _)| **variable >= count).map(|(_, line)| line[width]).sum();
    if !feasible || rest > ZERO {
        return None;
    }
    // Artificial variables that stay at zero leave the base, so that they cannot grow again.
    for index in 0..base.len() {
        if base[index] >= count
            && let Some(entering) = (0..count).find(|column| tableau[index][*column].abs() > ZERO)
        {
            pivot(&mut tableau, index, entering);
            base[index] = entering;
        }
    }
    if !phase(&mut tableau, &mut base, &|_| 1.0, count) {
        return None;
    }
    let mut solution = vec![0.0; count];
    for (&variable, line) in base.iter().zip(&tableau) {
        if variable < count {
            solution[variable] = line[width];
        }
    }
    Some(solution)
}

fn pivot(tableau: &mut [Vec<f64>], row: usize, column: usize) {
    let by = tableau[row][column];
    tableau[row].iter_mut().for_each(|value| *value /= by);
    let line = tableau[row].clone();
    for (index, other) in tableau.iter_mut().enumerate().filter(|(index, _)| *index != row) {
        debug_assert!(index != row);
        let factor = other[column];
        if factor != 0.0 {
            other.iter_mut().zip(&line).for_each(|(value, own)| *value -= factor * own);
        }
    }
}

/// A vector without its parts along orthonormal ones; twice, for what the first pass leaves by rounding.
fn without(vector: &[f64], directions: &[Vec<f64>]) -> Vec<f64> {
    let mut left = vector.to_vec();
    for _ in 0..2 {
        for direction in directions {
            let part = dot(direction, &left);
            left.iter_mut().zip(direction).for_each(|(value, along)| *value -= part * along);
        }
    }
    left
}

/// An orthonormal basis of some vectors.
fn orthonormal(vectors: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for vector in vectors {
        let left = without(vector, &basis);
        let size = norm(&left);
        if size > DISTINCT * norm(vector) {
            basis.push(left.iter().map(|value| value / size).collect());
        }
    }
    basis
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_the_difference_of_two_ends() {
        // Positions -1, 0, 1, 2; blind to a shift.
        let found = combination(&[-1.0, 0.0, 1.0, 2.0], &[vec![1.0; 4]]).unwrap();
        assert_eq!((found.weights.as_slice(), found.gain), (&[-1.0, 0.0, 0.0, 1.0][..], 3.0));
    }

    #[test]
    fn a_bow_needs_three_points_if_shift_and_turn_are_not_to_count() {
        let places = [-2.0_f64, -1.0, 0.0, 1.0, 2.0];
        let bow: Vec<f64> = places.iter().map(|place| place * place).collect();
        let found = combination(&bow, &[vec![1.0; 5], places.to_vec()]).unwrap();
        for (weight, expected) in found.weights.iter().zip([0.5, 0.0, -1.0, 0.0, 0.5]) {
            assert!((weight - expected).abs() < 1e-12, "{found:?}");
        }
        assert!((found.gain - 4.0).abs() < 1e-12);
    }

    #[test]
    fn what_the_artefact_can_do_has_no_combination() {
        assert_eq!(combination(&[2.0, 2.0], &[vec![1.0; 2]]), None);
        assert_eq!(combination(&[0.0, 0.0], &[vec![1.0; 2]]), None);
    }
}
