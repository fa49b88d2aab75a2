//! The triangular factor of a least squares problem, and quantities that follow from it.

use faer::linalg::solvers::Svd;
use faer::{Mat, MatRef};

use crate::accumulate::Accumulator;
use crate::directions::Directions;
use crate::left_out::left_out;
use crate::vector::{norm, norm_of};

/// Triangular factor of `[J | r]`: `J = Q R`, with `Q^T r` and the sum of squares that remains after the full step.
#[derive(Debug, Clone)]
pub struct Factor {
    triangle: Mat<f64>,
    right: Vec<f64>,
    norms: Vec<f64>,
    rest: f64,
    rows: usize,
}

/// What one more unknown would do.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateTerm {
    /// Its number.
    pub unknown: usize,
    /// Its least squares value.
    pub value: f64,
    /// Its reduction of the sum of squares of r.
    pub explained: f64,
}

impl Factor {
    pub(crate) fn new(triangle: Mat<f64>, right: Vec<f64>, norms: Vec<f64>, rest: f64, rows: usize) -> Self {
        Self { triangle, right, norms, rest, rows }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.norms.len()
    }

    /// Number of rows that went in.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Norm of every column of J: the effect of one unit of the unknown on all rows together.
    pub fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// Column of the triangular factor. Inner products of its columns equal those of the columns of J.
    pub fn column(&self, unknown: usize) -> Vec<f64> {
        (0..self.unknowns()).map(|row| self.triangle[(row, unknown)]).collect()
    }

    pub(crate) fn triangle(&self) -> &Mat<f64> {
        &self.triangle
    }

    /// `Q^T r`: the residuals in the directions of the factor.
    pub fn right(&self) -> &[f64] {
        &self.right
    }

    /// The same factor, said to be of this many rows: those that its own rows are the triangles of.
    #[must_use]
    pub fn of_rows(self, rows: usize) -> Self {
        Self { rows, ..self }
    }

    /// The rows of its triangle, zeros before the diagonal, and a last one for what remains: n + 1 rows `[J | r]` that tell what all rows
    /// tell.
    pub fn lines(&self) -> Vec<Vec<f64>> {
        let n = self.unknowns();
        let line = |row: usize| (0..n).map(|column| self.triangle[(row, column)]).chain([self.right[row]]).collect();
        let rest = std::iter::repeat_n(0.0, n).chain([self.rest.sqrt()]).collect();
        (0..n).map(line).chain([rest]).collect()
    }

    /// The factor of all rows of several factors of the same unknowns; None for factors of other numbers of unknowns, and for none.
    ///
    /// ```
    /// use abbe_numerics::{Accumulator, Factor};
    ///
    /// let of = |rows: &[[f64; 3]]| {
    ///     let mut accumulator = Accumulator::new(2, rows.len());
    ///     rows.iter().for_each(|[one, two, residual]| accumulator.push(&[*one, *two], *residual, 1.0));
    ///     accumulator.finish()
    /// };
    /// let rows = [[1.0, 0.0, 0.5], [1.0, 1.0, 0.7], [1.0, 2.0, 1.2], [1.0, 3.0, 1.1]];
    /// let (one, two) = (of(&rows[..1]), of(&rows[1..]));
    /// let both = Factor::combined(&[&one, &two]).unwrap();
    /// assert_eq!(both.rows(), 4);
    /// assert!((both.remaining_cost() - of(&rows).remaining_cost()).abs() < 1e-14);
    /// ```
    pub fn combined(factors: &[&Self]) -> Option<Self> {
        let unknowns = factors.first()?.unknowns();
        if factors.iter().any(|factor| factor.unknowns() != unknowns) {
            return None;
        }
        let mut accumulator = Accumulator::new(unknowns, factors.len() * (unknowns + 1));
        for line in factors.iter().flat_map(|factor| factor.lines()) {
            accumulator.push(&line[..unknowns], line[unknowns], 1.0);
        }
        Some(accumulator.finish().of_rows(factors.iter().map(|factor| factor.rows).sum()))
    }

    /// The factor of the same rows with zeros in the columns of some unknowns. What is left of a triangle is one.
    pub fn with_zeros(&self, zero: &[bool]) -> Self {
        let mut factor = self.clone();
        for unknown in (0..self.unknowns()).filter(|&unknown| zero[unknown]) {
            factor.triangle.col_as_slice_mut(unknown).fill(0.0);
            factor.norms[unknown] = 0.0;
        }
        factor
    }

    /// The effect of each unknown from number `own` on if it alone is added to the first `own` unknowns, which are all
    /// determined, at their least squares values. An unknown whose effect is a combination of theirs is left out.
    pub fn candidate_terms(&self, own: usize) -> Vec<CandidateTerm> {
        let n = self.unknowns();
        let mut terms = Vec::new();
        for unknown in own..n {
            let new: Vec<f64> = (own..n).map(|row| self.triangle[(row, unknown)]).collect();
            let size = norm(&new);
            if size > 1e-9 * self.norms[unknown] {
                let along: f64 = new.iter().zip(&self.right[own..]).map(|(new, right)| new * right).sum::<f64>() / size;
                terms.push(CandidateTerm { unknown, value: -along / size, explained: along * along });
            }
        }
        terms
    }

    /// Sum of squares of r that remains after the step of the first `own` unknowns alone.
    pub fn remaining_cost_of(&self, own: usize) -> f64 {
        self.rest + self.right[own..].iter().map(|value| value * value).sum::<f64>()
    }

    /// Sum of squares of r.
    pub fn cost(&self) -> f64 {
        self.rest + self.right.iter().map(|value| value * value).sum::<f64>()
    }

    /// Sum of squares of r that remains after the full step.
    pub fn remaining_cost(&self) -> f64 {
        self.rest
    }

    /// The Gauss-Newton step `-R^-1 Q^T r` of a problem of full rank; None if R is singular.
    pub fn step(&self) -> Option<Vec<f64>> {
        self.solved(self.right.iter().map(|value| -value).collect())
    }

    /// `R^-1 right`; None if R is singular.
    pub(crate) fn solved(&self, mut right: Vec<f64>) -> Option<Vec<f64>> {
        for column in (0..self.unknowns()).rev() {
            let entries = self.triangle.col_as_slice(column);
            if entries[column] == 0.0 {
                return None;
            }
            right[column] /= entries[column];
            let known = right[column];
            right[..column].iter_mut().zip(entries).for_each(|(above, entry)| *above -= entry * known);
        }
        right.iter().all(|value| value.is_finite()).then_some(right)
    }

    /// Largest cosine of the angle between r and a column of J: zero at a minimum, and where r is zero.
    pub fn gradient_cosine(&self) -> f64 {
        let size = self.cost().sqrt();
        let cosine = |column: usize| {
            let along: f64 = (0..=column).map(|row| self.triangle[(row, column)] * self.right[row]).sum();
            if size > 0.0 && self.norms[column] > 0.0 { along.abs() / self.norms[column] / size } else { 0.0 }
        };
        (0..self.unknowns()).map(cosine).fold(0.0, f64::max)
    }

    /// Norm of `J x`: the change of all rows together by x.
    pub fn row_norm(&self, x: &[f64]) -> f64 {
        norm_of(self.of_all_rows(x).into_iter())
    }

    /// `R x`, which has the inner products of `J x`.
    pub(crate) fn of_all_rows(&self, x: &[f64]) -> Vec<f64> {
        let n = self.unknowns();
        (0..n).map(|row| (row..n).map(|column| self.triangle[(row, column)] * x[column]).sum()).collect()
    }

    /// The root of the covariance within the first `rank` singular directions.
    pub fn covariance_root(&self, rank: usize) -> CovarianceRoot {
        if rank < self.unknowns() {
            return self.spectrum().covariance_root(rank);
        }
        let scale = self.scale();
        let inverse = self.inverse(&self.scaled(&scale));
        CovarianceRoot(Mat::from_fn(scale.len(), scale.len(), |row, column| scale[row] * inverse[(row, column)]))
    }

    /// Factors that scale every column of J to norm 1; 1 for a column of zeros.
    fn scale(&self) -> Vec<f64> {
        self.norms.iter().map(|&norm| if norm > 0.0 { 1.0 / norm } else { 1.0 }).collect()
    }

    fn scaled(&self, scale: &[f64]) -> Mat<f64> {
        Mat::from_fn(scale.len(), scale.len(), |row, column| self.triangle[(row, column)] * scale[column])
    }

    /// Singular values of J with its columns scaled to norm 1, the largest first; NaN if J is not finite.
    ///
    /// Scaling makes the result independent of units. Without it an unknown in mm/mm^3 would seem lost beside one in mm. A
    /// column of zeros is not scaled and gives a singular value of zero.
    pub fn singular_values(&self) -> SingularValues {
        let scaled = self.scaled(&self.scale());
        let values = if scaled.norm_l2().is_finite() { scaled.singular_values().ok() } else { None };
        SingularValues(values.unwrap_or_else(|| vec![f64::NAN; self.unknowns()]))
    }

    /// Singular values and vectors of J with its columns scaled to norm 1.
    pub fn spectrum(&self) -> Spectrum {
        let n = self.unknowns();
        let scale = self.scale();
        let scaled = self.scaled(&scale);
        let svd = if scaled.norm_l2().is_finite() { Svd::new(scaled.as_ref()).ok() } else { None };
        let Some(svd) = svd else {
            let singular_values = SingularValues(vec![f64::NAN; n]);
            return Spectrum { singular_values, vectors: Mat::zeros(n, n), right: vec![f64::NAN; n], scale };
        };
        let singular_values = SingularValues((0..n).map(|i| svd.S().column_vector()[i]).collect());
        let right = (0..n).map(|i| (0..n).map(|row| svd.U()[(row, i)] * self.right[row]).sum()).collect();
        Spectrum { singular_values, vectors: svd.V().to_owned(), right, scale }
    }

    /// Whether the rank is certainly full: the norm of the inverse bounds the smallest singular value. This is much faster
    /// than [`singular_values`](Self::singular_values). If it is false, the rank may still be full, and the singular values
    /// decide.
    pub fn is_surely_full_rank(&self, tolerance: f64) -> bool {
        let n = self.unknowns();
        let scaled = self.scaled(&self.scale());
        if (0..n).any(|i| scaled[(i, i)] == 0.0) {
            return false;
        }
        // Columns have norm 1, so the largest singular value is at most the root of their number.
        self.inverse(&scaled).norm_l2() * (n as f64).sqrt() < 1.0 / tolerance
    }

    fn inverse(&self, triangle: &Mat<f64>) -> Mat<f64> {
        let mut inverse = Mat::<f64>::identity(triangle.nrows(), triangle.ncols());
        let (upper, unknown) = (triangle.as_ref(), inverse.as_mut());
        faer::linalg::triangular_solve::solve_upper_triangular_in_place(upper, unknown, faer::Par::Seq);
        inverse
    }
}

/// A root A of the covariance of the estimates, `A A^T = (J^T J)^-1`: unknowns x directions, in the units of the unknowns.
#[derive(Debug, Clone)]
pub struct CovarianceRoot(Mat<f64>);

impl CovarianceRoot {
    /// `B A`: the root for what is `B y`, where this one is that for y.
    pub(crate) fn seen_through(&self, directions: &Mat<f64>) -> Self {
        Self(directions * &self.0)
    }

    /// Sensitivities of the estimates to further columns K of the same rows, `-A A^T J^T K`: unknowns x columns, row by row, in the
    /// unit of the unknown per unit of the column.
    ///
    /// `extended` is the factor of `[J K | r]`; a change of the residuals by `K k` changes the estimates by the sensitivities
    /// times k.
    pub fn sensitivities(&self, extended: &Factor) -> Vec<Vec<f64>> {
        let n = self.0.nrows();
        let own = extended.triangle.get(..n, ..n);
        let others = extended.triangle.get(..n, n..);
        let answer = &self.0 * ((own * &self.0).transpose() * others);
        (0..n).map(|row| (0..answer.ncols()).map(|column| -answer[(row, column)]).collect()).collect()
    }

    /// The part of the covariance that comes from some of the rows, `A A^T S^T S A A^T` with the factor S of those rows;
    /// symmetric to the last bit. The parts of all rows together are the covariance.
    pub fn part(&self, of_rows: &Factor) -> Vec<Vec<f64>> {
        let n = self.0.nrows();
        let root = &self.0 * (of_rows.triangle.get(..n, ..n) * &self.0).transpose();
        Self(root).covariance()
    }

    /// The share of some of the rows in the information, `A^T S^T S A` with the factor S of those rows. The information of
    /// all rows together is the identity.
    pub fn information(&self, of_rows: &Factor) -> Information {
        let n = self.0.nrows();
        let root = of_rows.triangle.get(..n, ..n) * &self.0;
        Information(root.transpose() * &root)
    }

    /// Covariance `(J^T J)^-1` in the units of the unknowns, row by row, symmetric to the last bit.
    pub fn covariance(&self) -> Vec<Vec<f64>> {
        let product = &self.0 * self.0.transpose();
        let entry = |row: usize, column: usize| product[(row.min(column), row.max(column))];
        let n = self.0.nrows();
        (0..n).map(|row| (0..n).map(|column| entry(row, column)).collect()).collect()
    }

    /// Standard uncertainties of the unknowns, in their units: the roots of the diagonal of the covariance.
    pub fn standard_uncertainties(&self) -> Vec<f64> {
        (0..self.0.nrows()).map(|row| norm_of((0..self.0.ncols()).map(|k| self.0[(row, k)]))).collect()
    }

    /// `j (J^T J)^-1 j^T` of rows j, one after another: their leverages if they had weight 1.
    pub fn leverages(&self, rows: &[f64]) -> Vec<f64> {
        let n = self.0.nrows();
        if n == 0 {
            return Vec::new();
        }
        let white = MatRef::from_row_major_slice(rows, rows.len() / n, n) * &self.0;
        (0..white.nrows()).map(|row| (0..white.ncols()).map(|k| white[(row, k)] * white[(row, k)]).sum()).collect()
    }
}

/// The share of some rows of a problem in the information on its determined directions.
#[derive(Debug, Clone)]
pub struct Information(Mat<f64>);

impl Information {
    /// Number of unknowns that these rows determine (not whole): the sum of their leverages.
    pub fn trace(&self) -> f64 {
        (0..self.0.nrows()).map(|row| self.0[(row, row)]).sum()
    }

    /// Trace of the product with the information of other rows.
    pub fn product_trace(&self, other: &Self) -> f64 {
        let n = self.0.nrows();
        (0..n).map(|row| (0..n).map(|column| self.0[(row, column)] * other.0[(column, row)]).sum::<f64>()).sum()
    }
}

/// Singular values of a problem with columns of norm 1.
#[derive(Debug, Clone, PartialEq)]
pub struct SingularValues(Vec<f64>);

impl SingularValues {
    /// From values, the largest first.
    pub(crate) fn new(values: Vec<f64>) -> Self {
        Self(values)
    }

    /// The values, the largest first.
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// Number of singular values above `tolerance` times the largest.
    pub fn rank(&self, tolerance: f64) -> usize {
        let largest = self.0.first().copied().unwrap_or(0.0);
        self.0.iter().filter(|&&value| value > tolerance * largest && value > 0.0).count()
    }

    /// Ratio of the largest to the smallest of the first `rank` singular values.
    pub fn condition(&self, rank: usize) -> f64 {
        match (self.0.first(), rank.checked_sub(1).and_then(|last| self.0.get(last))) {
            (Some(largest), Some(smallest)) => largest / smallest,
            _ => 1.0,
        }
    }
}

/// Singular value decomposition of a scaled problem.
#[derive(Debug, Clone)]
pub struct Spectrum {
    pub(crate) singular_values: SingularValues,
    pub(crate) vectors: Mat<f64>,
    pub(crate) right: Vec<f64>,
    pub(crate) scale: Vec<f64>,
}

impl Spectrum {
    /// The singular values.
    pub fn singular_values(&self) -> &SingularValues {
        &self.singular_values
    }

    /// The direction of the k-th singular value in scaled unknowns, of norm 1.
    pub fn direction(&self, k: usize) -> Vec<f64> {
        (0..self.scale.len()).map(|row| self.vectors[(row, k)]).collect()
    }

    /// The least squares step within the first `rank` singular directions: of all steps with the same effect the shortest,
    /// with unknowns scaled by their effect.
    pub fn step(&self, rank: usize) -> Vec<f64> {
        let coefficients: Vec<f64> = (0..rank).map(|k| -self.right[k] / self.singular_values.0[k]).collect();
        let sum = |row: usize| -> f64 { (0..rank).map(|k| self.vectors[(row, k)] * coefficients[k]).sum() };
        (0..self.scale.len()).map(|row| self.scale[row] * sum(row)).collect()
    }

    /// The root of the covariance within the first `rank` singular directions.
    pub fn covariance_root(&self, rank: usize) -> CovarianceRoot {
        let entry = |row: usize, k: usize| self.scale[row] * self.vectors[(row, k)] / self.singular_values.0[k];
        CovarianceRoot(Mat::from_fn(self.scale.len(), rank, entry))
    }

    /// The first `rank` singular directions, in the units of the unknowns.
    pub fn determined(&self, rank: usize) -> Directions {
        Directions::new(Mat::from_fn(self.scale.len(), rank, |row, k| self.scale[row] * self.vectors[(row, k)]))
    }

    /// A basis of what is lost beyond `rank`, as sparse as elimination makes it: the relative singular value and the
    /// direction in scaled unknowns, its largest entry 1, what is below `1e-5` set to zero.
    ///
    /// Multiply by [`scale`](Self::scale) for parameter units.
    pub fn null_basis(&self, rank: usize) -> Vec<(f64, Vec<f64>)> {
        let mut basis: Vec<Vec<f64>> = (rank..self.vectors.ncols()).map(|k| self.direction(k)).collect();
        // Reduced row echelon form: each vector has one unknown that no other vector has.
        for (index, column) in owners(&basis).into_iter().enumerate() {
            let size = |row: &usize| basis[*row][column].abs();
            let row = (index..basis.len()).max_by(|one, other| size(one).total_cmp(&size(other))).unwrap_or(index);
            basis.swap(index, row);
            let pivot = basis[index][column];
            basis[index].iter_mut().for_each(|value| *value /= pivot);
            let own = basis[index].clone();
            for (other, vector) in basis.iter_mut().enumerate() {
                let factor = vector[column];
                if other != index && factor != 0.0 {
                    vector.iter_mut().zip(&own).for_each(|(value, own)| *value -= factor * own);
                }
            }
        }
        let largest = self.singular_values.0.first().copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
        let lost = self.singular_values.0[rank..].iter().map(|value| value / largest);
        let mut named: Vec<(f64, Vec<f64>)> = lost.zip(basis).collect();
        for (_, vector) in &mut named {
            let peak = vector.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
            for value in vector.iter_mut() {
                *value /= peak;
                if value.abs() < 1e-5 {
                    *value = 0.0;
                }
            }
        }
        named
    }

    /// One unknown for every lost direction such that the others are determined without them: of those that take part enough in
    /// what is lost (a tenth of the largest share, or more where the others would then be determined much worse than they can be), the
    /// last in the order of preference goes first.
    ///
    /// `order` has all unknowns, the most preferred first.
    pub fn dependent(&self, rank: usize, order: &[usize]) -> Vec<usize> {
        let n = self.scale.len();
        let lost: Vec<Vec<f64>> = (0..n).map(|row| (rank..n).map(|k| self.vectors[(row, k)]).collect()).collect();
        left_out(&lost, order)
    }

    /// Factors from scaled unknowns to the units of the unknowns.
    pub fn scale(&self) -> &[f64] {
        &self.scale
    }
}

/// One unknown for each direction of an orthonormal basis: that with the largest part in those that remain after those before it.
/// Its part does not depend on the choice of the basis, which is arbitrary. Of unknowns that differ by rounding, the first is taken.
fn owners(basis: &[Vec<f64>]) -> Vec<usize> {
    let mut left = basis.to_vec();
    let mut owners: Vec<usize> = Vec::new();
    for _ in basis {
        let count = left.first().map_or(0, Vec::len);
        let size = |column: usize| norm_of(left.iter().map(|vector| vector[column]));
        let sizes: Vec<f64> =
            (0..count).map(|column| if owners.contains(&column) { 0.0 } else { size(column) }).collect();
        let largest = sizes.iter().copied().fold(0.0, f64::max);
        let Some(owner) = sizes.iter().position(|size| *size > 0.0 && *size >= largest * (1.0 - 1e-6)) else { break };
        let along: Vec<f64> = left.iter().map(|vector| vector[owner] / sizes[owner]).collect();
        for column in 0..count {
            let shared: f64 = left.iter().zip(&along).map(|(vector, along)| vector[column] * along).sum();
            left.iter_mut().zip(&along).for_each(|(vector, along)| vector[column] -= shared * along);
        }
        owners.push(owner);
    }
    owners
}
