//! The triangular factor of a problem of block arrow structure.

use super::groups::Groups;
use super::reflect::{exchange, reflect};
use crate::accumulate::Accumulator;
use crate::factor::Factor;
use crate::vector::{dot, norm_of};

/// Part of the effect of an unknown of a group below which what others of its group leave of it is rounding.
const DEPENDENT: f64 = 1e-13;

/// The triangle of a group: rows `[D | S | r]` with its own columns, the shared ones and the residual.
#[derive(Debug, Clone)]
pub(super) struct EliminatedGroup {
    /// Its unknowns in the order of its columns.
    pub members: Vec<usize>,
    /// How many of them have a row; the effects of the others are combinations of theirs.
    pub kept: usize,
    /// The rows.
    pub lines: Vec<f64>,
}

impl EliminatedGroup {
    /// From rows that are at most as many as unknowns; gives also what is left of them: rows of the shared columns and the residual.
    pub fn new(mut members: Vec<usize>, mut lines: Vec<f64>, shared: usize) -> (Self, Vec<Vec<f64>>) {
        let (own, width) = (members.len(), members.len() + shared + 1);
        let rows = lines.len() / width;
        let size = |lines: &[f64], column: usize, first: usize| {
            norm_of(lines.chunks_exact(width).skip(first).map(|line| line[column]))
        };
        let mut norms: Vec<f64> = (0..own).map(|column| size(&lines, column, 0)).collect();
        let mut kept = 0;
        while kept < own.min(rows) {
            let part = |column: usize| match norms[column] {
                0.0 => 0.0,
                norm => size(&lines, column, kept) / norm,
            };
            let mut best = (kept, part(kept));
            for column in kept + 1..own {
                let part = part(column);
                // What is not finite goes on into the triangle, where it is seen.
                if part > best.1 || part.is_nan() {
                    best = (column, part);
                }
            }
            if best.1 <= DEPENDENT {
                break;
            }
            exchange(&mut lines, width, kept, best.0);
            members.swap(kept, best.0);
            norms.swap(kept, best.0);
            reflect(&mut lines, width, kept);
            kept += 1;
        }
        let left = lines[kept * width..].chunks_exact(width).map(|line| line[own..].to_vec()).collect();
        lines.truncate(kept * width);
        (Self { members, kept, lines }, left)
    }

    fn width(&self) -> usize {
        self.lines.len().checked_div(self.kept).unwrap_or(0)
    }

    /// The rows: own entries with zeros before the diagonal, those of shared unknowns, the residual.
    pub fn rows(&self) -> impl Iterator<Item = (&[f64], &[f64], f64)> {
        let (own, width) = (self.members.len(), self.width());
        self.lines.chunks_exact(width.max(1)).map(move |line| (&line[..own], &line[own..width - 1], line[width - 1]))
    }

    /// Entry of its triangle.
    pub fn entry(&self, row: usize, column: usize) -> f64 {
        self.lines[row * self.width() + column]
    }

    /// Replaces b by the solution of `D x = b`; pivots count as no less than `least`.
    pub fn solve(&self, b: &mut [f64], least: f64) {
        for row in (0..self.kept).rev() {
            let known: f64 = (row + 1..self.kept).map(|column| self.entry(row, column) * b[column]).sum();
            b[row] = (b[row] - known) / no_less(self.entry(row, row), least);
        }
    }

    /// Replaces b by the solution of `D' x = b`, in the same way.
    pub fn solve_transposed(&self, b: &mut [f64], least: f64) {
        for row in 0..self.kept {
            let known: f64 = (0..row).map(|above| self.entry(above, row) * b[above]).sum();
            b[row] = (b[row] - known) / no_less(self.entry(row, row), least);
        }
    }

    /// `D^-1 [1 | S]`, row by row.
    pub fn inverse(&self, shared: usize) -> Vec<Vec<f64>> {
        let width = self.kept + shared;
        let mut lines: Vec<Vec<f64>> =
            self.rows().map(|(_, shared, _)| [&vec![0.0; self.kept], shared].concat()).collect();
        for row in (0..self.kept).rev() {
            lines[row][row] = 1.0;
            let (above, below) = lines.split_at_mut(row + 1);
            let line = &mut above[row];
            for (column, other) in (row + 1..self.kept).zip(&*below) {
                let by = self.entry(row, column);
                (0..width).for_each(|k| line[k] -= by * other[k]);
            }
            let pivot = self.entry(row, row);
            line.iter_mut().for_each(|value| *value /= pivot);
        }
        lines
    }
}

fn no_less(pivot: f64, least: f64) -> f64 {
    if pivot.abs() < least { least.copysign(pivot) } else { pivot }
}

/// Triangular factor of `[J | r]` where unknowns stand in [`Groups`]: a triangle of each group, and one of the shared unknowns.
///
/// Inner products of its columns are those of the columns of J, as with a [`Factor`].
#[derive(Debug, Clone)]
pub struct ArrowFactor {
    pub(super) groups: Vec<EliminatedGroup>,
    pub(super) shared: Vec<usize>,
    pub(super) triangle: Factor,
    of_sources: Vec<Factor>,
    norms: Vec<f64>,
}

impl ArrowFactor {
    pub(super) fn new(groups: &Groups, eliminated: Vec<EliminatedGroup>, of_sources: Vec<Factor>) -> Self {
        let triangle = match of_sources.as_slice() {
            [only] => only.clone(),
            several => Factor::combined(&several.iter().collect::<Vec<_>>())
                .unwrap_or_else(|| Accumulator::new(groups.shared().len(), 0).finish()),
        };
        Self::of(groups.unknowns(), groups.shared().to_vec(), eliminated, (triangle, of_sources))
    }

    fn of(
        unknowns: usize,
        shared: Vec<usize>,
        groups: Vec<EliminatedGroup>,
        (triangle, of_sources): (Factor, Vec<Factor>),
    ) -> Self {
        let mut squares = vec![0.0; unknowns];
        for (&unknown, norm) in shared.iter().zip(triangle.norms()) {
            squares[unknown] += norm * norm;
        }
        for group in &groups {
            for (own, of_shared, _) in group.rows() {
                let entries = group.members.iter().zip(own).chain(shared.iter().zip(of_shared));
                entries.for_each(|(&unknown, value)| squares[unknown] += value * value);
            }
        }
        let norms = squares.into_iter().map(f64::sqrt).collect();
        Self { groups, shared, triangle, of_sources, norms }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.norms.len()
    }

    /// Number of rows that went in.
    pub fn rows(&self) -> usize {
        self.triangle.rows()
    }

    /// Norm of every column of J.
    pub fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// The shared unknowns, ascending.
    pub fn shared(&self) -> &[usize] {
        &self.shared
    }

    /// The factor of what all rows tell of the shared unknowns alone, whatever those of the groups are.
    pub fn of_shared(&self) -> &Factor {
        &self.triangle
    }

    /// The same of the rows of each source.
    pub fn of_sources(&self) -> &[Factor] {
        &self.of_sources
    }

    /// Unknowns of groups whose effects are combinations of the effects of others of their group, ascending; nothing determines them.
    pub fn dependent(&self) -> Vec<usize> {
        let mut all: Vec<usize> =
            self.groups.iter().flat_map(|group| group.members[group.kept..].iter().copied()).collect();
        all.sort_unstable();
        all
    }

    /// The factor of the same rows with zeros in the columns of some unknowns, without what single sources tell.
    #[must_use]
    pub fn with_zeros(&self, zero: &[bool]) -> Self {
        let shared = self.shared.len();
        let zero_of_shared: Vec<bool> = self.shared.iter().map(|&unknown| zero[unknown]).collect();
        let mut left = Vec::new();
        let groups = self.groups.iter().map(|group| {
            let mut lines = group.lines.clone();
            let all: Vec<bool> =
                group.members.iter().map(|&member| zero[member]).chain(zero_of_shared.iter().copied()).collect();
            for line in lines.chunks_exact_mut(all.len() + 1) {
                line.iter_mut().zip(&all).filter(|(_, zero)| **zero).for_each(|(value, _)| *value = 0.0);
            }
            let (group, of_group) = EliminatedGroup::new(group.members.clone(), lines, shared);
            left.extend(of_group);
            group
        });
        let groups: Vec<EliminatedGroup> = groups.collect();
        let triangle = self.triangle.with_zeros(&zero_of_shared);
        let mut accumulator = Accumulator::new(shared, shared + 1 + left.len());
        for line in triangle.lines().iter().chain(&left) {
            accumulator.push(&line[..shared], line[shared], 1.0);
        }
        let triangle = accumulator.finish().of_rows(self.rows());
        Self::of(self.unknowns(), self.shared.clone(), groups, (triangle, Vec::new()))
    }

    /// Sum of squares of r.
    pub fn cost(&self) -> f64 {
        let of_group = |group: &EliminatedGroup| group.rows().map(|(_, _, right)| right * right).sum::<f64>();
        self.triangle.cost() + self.groups.iter().map(of_group).sum::<f64>()
    }

    /// Sum of squares of r that remains after the full step.
    pub fn remaining_cost(&self) -> f64 {
        self.triangle.remaining_cost()
    }

    /// The Gauss-Newton step of a problem of full rank; None if there is none.
    pub fn step(&self) -> Option<Vec<f64>> {
        let of_shared = self.triangle.step()?;
        let mut step = vec![0.0; self.unknowns()];
        self.shared.iter().zip(&of_shared).for_each(|(&unknown, value)| step[unknown] = *value);
        for group in &self.groups {
            if group.kept < group.members.len() {
                return None;
            }
            let mut own: Vec<f64> = group.rows().map(|(_, shared, right)| -right - dot(shared, &of_shared)).collect();
            group.solve(&mut own, 0.0);
            group.members.iter().zip(own).for_each(|(&unknown, value)| step[unknown] = value);
        }
        step.iter().all(|value| value.is_finite()).then_some(step)
    }

    /// Norm of `J x`: the change of all rows together by x.
    pub fn row_norm(&self, x: &[f64]) -> f64 {
        let of_shared: Vec<f64> = self.shared.iter().map(|&unknown| x[unknown]).collect();
        let mut squares = self.triangle.row_norm(&of_shared).powi(2);
        for group in &self.groups {
            for (own, shared, _) in group.rows() {
                let entries = group.members.iter().zip(own);
                let of_own: f64 = entries.map(|(&unknown, value)| value * x[unknown]).sum();
                squares += (of_own + dot(shared, &of_shared)).powi(2);
            }
        }
        squares.sqrt()
    }

    /// Largest cosine of the angle between r and a column of J: zero at a minimum, and where r is zero.
    pub fn gradient_cosine(&self) -> f64 {
        let mut along = vec![0.0; self.unknowns()];
        for (place, &unknown) in self.shared.iter().enumerate() {
            along[unknown] = dot(&self.triangle.column(place), self.triangle.right());
        }
        for group in &self.groups {
            for (own, shared, right) in group.rows() {
                let entries = group.members.iter().zip(own).chain(self.shared.iter().zip(shared));
                entries.for_each(|(&unknown, value)| along[unknown] += value * right);
            }
        }
        let size = self.cost().sqrt();
        let cosine = |(along, norm): (&f64, &f64)| {
            if size > 0.0 && *norm > 0.0 { along.abs() / norm / size } else { 0.0 }
        };
        along.iter().zip(&self.norms).map(cosine).fold(0.0, f64::max)
    }

    /// Variances of the unknowns of groups, in their units squared; none for those that depend on others. `scatter` is the variance of
    /// the rows, and `covariance` that of the shared unknowns, row by row.
    ///
    /// A group's unknowns are `-D^-1 (r + S y)` with the shared ones y: what its own rows scatter, and what y does to them.
    pub fn own_variances(&self, scatter: f64, covariance: &[Vec<f64>]) -> Vec<(usize, f64)> {
        let mut variances = Vec::new();
        for group in &self.groups {
            for (&unknown, line) in group.members.iter().zip(group.inverse(self.shared.len())) {
                let (own, shared) = line.split_at(group.kept);
                let of_shared: f64 = shared
                    .iter()
                    .zip(covariance)
                    .map(|(by, row)| by * dot(row, shared))
                    .filter(|part| *part != 0.0)
                    .sum();
                variances.push((unknown, scatter * dot(own, own) + of_shared));
            }
        }
        variances
    }
}
