//! Rank of a problem of block arrow structure: the ends of its spectrum, by iteration with its factor.

use faer::Mat;
use faer::linalg::solvers::Svd;

use super::factor::{ArrowFactor, EliminatedGroup};
use crate::factor::{SingularValues, Spectrum};
use crate::vector::{dot, norm};

/// Weak directions that are looked for beside lost ones.
const WEAK: usize = 5;

/// Directions of the iteration beyond these: they make it converge.
const MORE: usize = 3;

/// Lost directions that are looked for at most, beside the unknowns that depend on others of their group.
const MOST: usize = 64;

/// Iterations at most.
const ROUNDS: usize = 60;

/// Iterations towards the largest singular value at most.
const ROUNDS_OF_LARGEST: usize = 300;

/// What is weaker counts as this weak on the way: else one lost direction would leave nothing of the others.
const WEAKEST_ON_THE_WAY: f64 = 1e-7;

/// Change of a singular value, in parts of it, from which the iteration goes on.
const STANDS: f64 = 1e-4;

/// Singular values below this part of the largest are rounding and need no digits.
const ROUNDING: f64 = 1e-14;

/// What of a spectrum tells the rank.
#[derive(Debug, Clone)]
pub struct ArrowSpectrum {
    /// The largest singular value, the weakest within the rank, and the lost ones.
    pub ends: Spectrum,
    /// How many of these are within the rank.
    pub told: usize,
    /// The rank of all unknowns.
    pub rank: usize,
    /// Ratio of the largest to the smallest singular value within the rank.
    pub condition: f64,
}

/// A factor with columns of norm 1.
struct Scaled<'a> {
    factor: &'a ArrowFactor,
    groups: Vec<EliminatedGroup>,
    triangle: Mat<f64>,
    scale: Vec<f64>,
}

impl ArrowFactor {
    /// Whether the rank is certainly full, by the rule of [`Factor::is_surely_full_rank`](crate::Factor::is_surely_full_rank).
    pub fn is_surely_full_rank(&self, tolerance: f64) -> bool {
        if self.groups.iter().any(|group| group.kept < group.members.len()) {
            return false;
        }
        let scaled = Scaled::new(self);
        let size = scaled.inverse_norm();
        size.is_some_and(|size| size * (self.unknowns() as f64).sqrt() < 1.0 / tolerance)
    }

    /// The rank with this tolerance: singular values below this part of the largest count as zero, columns have norm 1.
    ///
    /// The smallest singular values are found by inverse iteration with all rows' factor, so they are those of one triangle of all
    /// unknowns. Where more than 64 directions beyond [`dependent`](Self::dependent) unknowns are lost, the rank is an upper bound.
    pub fn spectrum(&self, tolerance: f64) -> ArrowSpectrum {
        Scaled::new(self).spectrum(tolerance)
    }
}

impl<'a> Scaled<'a> {
    fn new(factor: &'a ArrowFactor) -> Self {
        let scale: Vec<f64> = factor.norms().iter().map(|&norm| if norm > 0.0 { 1.0 / norm } else { 1.0 }).collect();
        let scaled = |group: &EliminatedGroup| {
            let mut group = group.clone();
            let all: Vec<f64> = group.members.iter().chain(&factor.shared).map(|&unknown| scale[unknown]).collect();
            for line in group.lines.chunks_exact_mut(all.len() + 1) {
                line.iter_mut().zip(&all).for_each(|(value, scale)| *value *= scale);
            }
            group
        };
        let (groups, of) = (factor.groups.iter().map(scaled).collect(), factor.triangle.triangle());
        let entry = |row: usize, column: usize| match row <= column {
            true => of[(row, column)] * scale[factor.shared[column]],
            false => 0.0,
        };
        let triangle = Mat::from_fn(factor.shared.len(), factor.shared.len(), entry);
        Self { factor, groups, triangle, scale }
    }

    /// The Frobenius norm of the inverse; none if there is no inverse.
    fn inverse_norm(&self) -> Option<f64> {
        let shared = self.triangle.nrows();
        if (0..shared).any(|row| self.triangle[(row, row)] == 0.0) {
            return None;
        }
        let mut inverse = Mat::<f64>::identity(shared, shared);
        let (upper, unknown) = (self.triangle.as_ref(), inverse.as_mut());
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(upper, unknown, faer::Par::Seq);
        let mut squares = inverse.norm_l2().powi(2);
        for group in &self.groups {
            for line in group.inverse(shared) {
                let (own, of_shared) = line.split_at(group.kept);
                let through = |column: usize| (0..=column).map(|row| of_shared[row] * inverse[(row, column)]).sum();
                squares += dot(own, own) + (0..shared).map(through).map(|sum: f64| sum * sum).sum::<f64>();
            }
        }
        Some(squares.sqrt()).filter(|size| size.is_finite())
    }

    /// `T^-1 T'^-1` of the triangle of the shared unknowns, with singular values that are not too weak; none if there is none.
    fn inverse_of_shared(&self) -> Option<Mat<f64>> {
        let svd = self.triangle.norm_l2().is_finite().then(|| Svd::new(self.triangle.as_ref()).ok())??;
        let size = self.triangle.nrows();
        let by = |k: usize| 1.0 / svd.S().column_vector()[k].max(WEAKEST_ON_THE_WAY);
        let half = Mat::from_fn(size, size, |row, k| svd.V()[(row, k)] * by(k));
        Some(&half * half.transpose())
    }

    fn of_shared(&self, x: &[f64]) -> Vec<f64> {
        self.factor.shared.iter().map(|&unknown| x[unknown]).collect()
    }

    /// `R x`; rows have the places of unknowns.
    fn times(&self, x: &[f64]) -> Vec<f64> {
        let (mut product, of_shared) = (vec![0.0; x.len()], self.of_shared(x));
        for group in &self.groups {
            for ((own, shared, _), &place) in group.rows().zip(&group.members) {
                let kept = group.members.iter().zip(&own[..group.kept]);
                product[place] =
                    kept.map(|(&unknown, value)| value * x[unknown]).sum::<f64>() + dot(shared, &of_shared);
            }
        }
        for (row, &place) in self.factor.shared.iter().enumerate() {
            product[place] =
                (row..of_shared.len()).map(|column| self.triangle[(row, column)] * of_shared[column]).sum();
        }
        product
    }

    /// `R' y`.
    fn transposed_times(&self, y: &[f64]) -> Vec<f64> {
        let (mut product, of_shared) = (vec![0.0; y.len()], self.of_shared(y));
        for (column, &unknown) in self.factor.shared.iter().enumerate() {
            product[unknown] = (0..=column).map(|row| self.triangle[(row, column)] * of_shared[row]).sum();
        }
        for group in &self.groups {
            for ((own, shared, _), &place) in group.rows().zip(&group.members) {
                let entries = group.members.iter().zip(&own[..group.kept]).chain(self.factor.shared.iter().zip(shared));
                entries.for_each(|(&unknown, value)| product[unknown] += value * y[place]);
            }
        }
        product
    }

    /// `R^-1 R'^-1 x` with the inverse of the shared unknowns.
    fn inverse_twice(&self, x: &[f64], inverse: &Mat<f64>) -> Vec<f64> {
        let mut of_shared = self.of_shared(x);
        let own =
            |group: &EliminatedGroup| -> Vec<f64> { group.members[..group.kept].iter().map(|&one| x[one]).collect() };
        let mut of_groups: Vec<Vec<f64>> = self.groups.iter().map(own).collect();
        for (group, own) in self.groups.iter().zip(&mut of_groups) {
            group.solve_transposed(own, WEAKEST_ON_THE_WAY);
            for ((_, shared, _), value) in group.rows().zip(own.iter()) {
                of_shared.iter_mut().zip(shared).for_each(|(sum, by)| *sum -= by * value);
            }
        }
        let product = |row: usize| (0..of_shared.len()).map(|column| inverse[(row, column)] * of_shared[column]).sum();
        let of_shared: Vec<f64> = (0..of_shared.len()).map(product).collect();
        let mut solution = vec![0.0; x.len()];
        self.factor.shared.iter().zip(&of_shared).for_each(|(&unknown, value)| solution[unknown] = *value);
        for (group, own) in self.groups.iter().zip(&mut of_groups) {
            own.iter_mut().zip(group.rows()).for_each(|(value, (_, shared, _))| *value -= dot(shared, &of_shared));
            group.solve(own, WEAKEST_ON_THE_WAY);
            group.members.iter().zip(own).for_each(|(&unknown, value)| solution[unknown] = *value);
        }
        solution
    }

    /// The largest singular value and its direction.
    fn largest(&self) -> (f64, Vec<f64>) {
        let mut direction = unit(self.independent((0..self.scale.len()).map(noise).collect()));
        let mut last = 0.0;
        for _ in 0..ROUNDS_OF_LARGEST {
            direction = unit(self.independent(self.transposed_times(&self.times(&direction))));
            let value = norm(&self.times(&direction));
            if (value - last).abs() <= ROUNDING.sqrt() * value {
                break;
            }
            last = value;
        }
        (norm(&self.times(&direction)), direction)
    }

    /// A direction without parts along unknowns that depend on others.
    fn independent(&self, mut direction: Vec<f64>) -> Vec<f64> {
        let dependent = self.groups.iter().flat_map(|group| &group.members[group.kept..]);
        dependent.for_each(|&unknown| direction[unknown] = 0.0);
        direction
    }

    /// The smallest singular values of the independent unknowns, the smallest first, and their directions. The last ones are rough.
    fn smallest(&self, count: usize, inverse: &Mat<f64>) -> Vec<(f64, Vec<f64>)> {
        let start = |k: usize| (0..self.scale.len()).map(|row| noise(row * MOST * 2 + k)).collect();
        let mut basis: Vec<Vec<f64>> = orthonormal((1..=count).map(|k| self.independent(start(k))).collect());
        let mut last: Vec<f64> = Vec::new();
        for _ in 0..ROUNDS {
            let next = basis.iter().map(|direction| self.inverse_twice(direction, inverse)).collect();
            let (values, turned) = self.turned(orthonormal(next));
            basis = turned;
            let exact = count.saturating_sub(MORE).max(1);
            let stands = |(value, last): (&f64, &f64)| *value < ROUNDING || (value - last).abs() <= STANDS * value;
            let all = !last.is_empty() && values.iter().zip(&last).take(exact).all(stands);
            last = values;
            if all {
                break;
            }
        }
        last.into_iter().zip(basis).collect()
    }

    /// A basis turned to the singular directions within it, and their singular values, the smallest first.
    fn turned(&self, basis: Vec<Vec<f64>>) -> (Vec<f64>, Vec<Vec<f64>>) {
        let images: Vec<Vec<f64>> = basis.iter().map(|direction| self.times(direction)).collect();
        let product = Mat::from_fn(self.scale.len(), images.len(), |row, column| images[column][row]);
        let Ok(svd) = Svd::new_thin(product.as_ref()) else { return (vec![f64::NAN; basis.len()], basis) };
        let order = (0..basis.len()).rev();
        let turned = order.clone().map(|k| {
            let mut sum = vec![0.0; self.scale.len()];
            for (row, direction) in basis.iter().enumerate() {
                let by = svd.V()[(row, k)];
                sum.iter_mut().zip(direction).for_each(|(value, part)| *value += by * part);
            }
            sum
        });
        (order.clone().map(|k| svd.S().column_vector()[k]).collect(), turned.collect())
    }

    /// The directions of unknowns that depend on others of their group, no more than [`MOST`].
    fn dependent(&self) -> Vec<Vec<f64>> {
        let mut directions = Vec::new();
        for group in &self.groups {
            for column in group.kept..group.members.len() {
                if directions.len() == MOST {
                    return directions;
                }
                let mut own: Vec<f64> = (0..group.kept).map(|row| -group.entry(row, column)).collect();
                group.solve(&mut own, 0.0);
                let mut direction = vec![0.0; self.scale.len()];
                group.members.iter().zip(own).for_each(|(&unknown, value)| direction[unknown] = value);
                direction[group.members[column]] = 1.0;
                directions.push(direction);
            }
        }
        directions
    }

    fn spectrum(self, tolerance: f64) -> ArrowSpectrum {
        let n = self.scale.len();
        let not_kept: usize = self.groups.iter().map(|group| group.members.len() - group.kept).sum();
        let independent = n - not_kept;
        let inverse = self.inverse_of_shared().filter(|_| self.scale.iter().all(|scale| scale.is_finite()));
        let (largest, main) = if inverse.is_some() { self.largest() } else { (f64::NAN, vec![0.0; n]) };
        let is_lost = |value: f64| !(value > tolerance * largest && value > 0.0);
        let mut wanted = 1 + WEAK;
        let smallest = loop {
            let smallest = |inverse| self.smallest((wanted + MORE).min(independent), inverse);
            let found = inverse.as_ref().map_or_else(Vec::new, smallest);
            let lost = found.iter().filter(|(value, _)| is_lost(*value)).count();
            if lost + WEAK <= wanted || wanted >= MOST || wanted + MORE >= independent {
                break found;
            }
            wanted *= 2;
        };
        let lost = smallest.iter().filter(|(value, _)| is_lost(*value)).count();
        let rank = if inverse.is_some() { independent - lost } else { 0 };
        let weak = smallest.len().saturating_sub(lost).min(WEAK).min(rank);
        let condition = match smallest.get(lost) {
            Some((smallest, _)) if rank > 0 => largest / smallest,
            _ => 1.0,
        };
        let weakest = smallest[lost..lost + weak].iter().rev().chain(smallest[..lost].iter().rev());
        let first = (rank > weak).then_some((largest, main));
        let told = weak + usize::from(first.is_some());
        let dependent = self.dependent().into_iter().map(|direction| (0.0, direction));
        let all = first.into_iter().chain(weakest.cloned()).chain(dependent);
        let (values, directions): (Vec<f64>, Vec<Vec<f64>>) = all.unzip();
        let vectors = Mat::from_fn(n, directions.len(), |row, k| directions[k][row]);
        // It tells what is lost, and makes no steps.
        let right = vec![f64::NAN; values.len()];
        let ends = Spectrum { singular_values: SingularValues::new(values), vectors, right, scale: self.scale };
        ArrowSpectrum { ends, told, rank, condition }
    }
}

fn unit(mut direction: Vec<f64>) -> Vec<f64> {
    let size = norm(&direction).max(f64::MIN_POSITIVE);
    direction.iter_mut().for_each(|value| *value /= size);
    direction
}

/// An orthonormal basis of what some directions span (Gram-Schmidt, twice).
fn orthonormal(directions: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(directions.len());
    for direction in directions {
        let mut direction = unit(direction);
        for _ in 0..2 {
            for other in &basis {
                let along = dot(other, &direction);
                direction.iter_mut().zip(other).for_each(|(value, other)| *value -= along * other);
            }
            direction = unit(direction);
        }
        basis.push(direction);
    }
    basis
}

/// A number between -1/2 and 1/2 that depends on its place alone (the finaliser of SplitMix64, Steele et al. 2014).
fn noise(place: usize) -> f64 {
    let mut bits = (place as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}
