//! Reduces the rows of a least squares problem to their triangular factor.

use faer::linalg::solvers::Qr;
use faer::{Mat, MatRef};

use crate::factor::Factor;
use crate::vector::norm_of;

/// Memory that the buffer of rows may take, in numbers; small problems are factorised in one go.
const BUFFER: usize = 1 << 21;

/// Rows that are factorised together where there are many unknowns, most of which are zero in most rows.
const BLOCK: usize = 1024;

/// Problems with no more unknowns than this are factorised as if none were zero.
const FEW: usize = 64;

/// Reduces rows `[J | r]` of a least squares problem to their triangular factor.
///
/// Rows are collected in a buffer. A full buffer is factorised over the columns that are not zero in it: if measurements come
/// run by run, most columns of unknowns of other runs are zero. The result is that of one QR of all rows, with the memory of
/// the buffer only.
pub struct Accumulator {
    unknowns: usize,
    /// Most rows of the buffer.
    capacity: usize,
    /// Derivatives and residual of rows, one row after another.
    buffer: Vec<f64>,
    filled: usize,
    /// The columns that are not zero in the first half of the buffer.
    present: Option<Vec<bool>>,
    rows: usize,
    done: Vec<Triangle>,
}

/// The factor of some rows, over the columns that are not zero in them.
struct Triangle {
    /// The unknowns, ascending.
    columns: Vec<usize>,
    /// Upper triangle; the last column is the right side.
    values: Mat<f64>,
}

impl Triangle {
    /// The factor of a matrix whose last column is the right side.
    fn of(columns: Vec<usize>, rows: &Mat<f64>) -> Self {
        Self { columns, values: Qr::new(rows.as_ref()).thin_R().to_owned() }
    }

    /// Entry in a row, zero below the diagonal.
    fn entry(&self, row: usize, column: usize) -> f64 {
        if row <= column && row < self.values.nrows() { self.values[(row, column)] } else { 0.0 }
    }

    /// The same factor with these columns (their indices in this triangle) first; the others keep their order.
    fn starting_with(&self, first: &[usize]) -> Self {
        let count = self.columns.len();
        let others = (0..count).filter(|column| !first.contains(column));
        let order: Vec<usize> = first.iter().copied().chain(others).collect();
        let rows = Mat::from_fn(self.values.nrows(), count + 1, |row, column| {
            self.entry(row, order.get(column).copied().unwrap_or(count))
        });
        Self::of(order.iter().map(|&column| self.columns[column]).collect(), &rows)
    }
}

impl Accumulator {
    /// For `unknowns` unknowns and about `rows` rows.
    pub fn new(unknowns: usize, rows: usize) -> Self {
        let width = unknowns + 1;
        let capacity = match unknowns <= FEW || rows <= BLOCK {
            true => rows.clamp(1, (BUFFER / width).max(3 * width)) + width,
            false => BLOCK.max(2 * width),
        };
        Self {
            unknowns,
            capacity,
            buffer: Vec::with_capacity(capacity * width),
            filled: 0,
            present: None,
            rows: 0,
            done: Vec::new(),
        }
    }

    /// Adds one row, multiplied by `weight` (the square root of its statistical weight).
    pub fn push(&mut self, derivatives: &[f64], residual: f64, weight: f64) {
        if self.filled == self.capacity || (self.filled >= self.capacity / 2 && self.is_of_others(derivatives)) {
            self.flush();
        }
        self.buffer.extend(derivatives.iter().map(|derivative| derivative * weight));
        self.buffer.push(residual * weight);
        self.filled += 1;
        self.rows += 1;
    }

    /// Whether a row has unknowns that the buffer does not have: the first row of the next run.
    fn is_of_others(&mut self, derivatives: &[f64]) -> bool {
        if self.unknowns <= FEW {
            return false;
        }
        let present = self.present.get_or_insert_with(|| present(&self.buffer, self.unknowns));
        derivatives.iter().zip(present).any(|(derivative, present)| *derivative != 0.0 && !*present)
    }

    /// Replaces the rows in the buffer by their triangular factor.
    fn flush(&mut self) {
        let present = present(&self.buffer, self.unknowns);
        let columns: Vec<usize> = (0..self.unknowns).filter(|&column| present[column]).collect();
        let width = self.unknowns + 1;
        let at = |column: usize| columns.get(column).copied().unwrap_or(self.unknowns);
        let rows = Mat::from_fn(self.filled, columns.len() + 1, |row, column| self.buffer[row * width + at(column)]);
        self.buffer.clear();
        self.present = None;
        self.filled = 0;
        self.done.push(Triangle::of(columns, &rows));
        if self.done.iter().map(|triangle| triangle.values.nrows()).sum::<usize>() * (self.unknowns + 1) > BUFFER {
            let triangles = std::mem::take(&mut self.done);
            self.done.push(stacked(&triangles, (0..self.unknowns).collect()));
        }
    }

    /// The factor of all rows.
    pub fn finish(mut self) -> Factor {
        let all = (0..self.unknowns).collect();
        if self.done.is_empty() {
            let rows = MatRef::from_row_major_slice(&self.buffer, self.filled, self.unknowns + 1).to_owned();
            return self.factor(&Triangle::of(all, &rows));
        }
        self.flush();
        let mut users = vec![0; self.unknowns];
        self.done.iter().flat_map(|triangle| &triangle.columns).for_each(|&column| users[column] += 1);
        // Unknowns that only one triangle has are eliminated there. Only the remaining rows are combined with other
        // triangles.
        let (mut settled, mut shared) = (Vec::new(), Vec::new());
        for triangle in &self.done {
            let own = (0..triangle.columns.len()).filter(|&column| users[triangle.columns[column]] == 1);
            let own: Vec<usize> = own.collect();
            let split = triangle.starting_with(&own);
            let (height, width) = (split.values.nrows(), split.columns.len() + 1);
            let above = own.len().min(height);
            let rows = Mat::from_fn(above, width, |row, column| split.entry(row, column));
            let below = Mat::from_fn(height - above, width - own.len(), |row, column| {
                split.entry(above + row, own.len() + column)
            });
            let columns = split.columns[own.len()..].to_vec();
            settled.push(Triangle { columns: split.columns, values: rows });
            shared.push(Triangle { columns, values: below });
        }
        let common = (0..self.unknowns).filter(|&column| users[column] > 1).collect();
        settled.push(stacked(&shared, common));
        let triangle = stacked(&settled, all);
        self.factor(&triangle)
    }

    fn factor(&self, triangle: &Triangle) -> Factor {
        let n = self.unknowns;
        let mut values = Mat::zeros(n, n);
        for column in 0..n {
            for row in 0..=column {
                values[(row, column)] = triangle.entry(row, column);
            }
        }
        let right = (0..n).map(|row| triangle.entry(row, n)).collect();
        let norms = (0..n).map(|column| norm_of((0..=column).map(|row| values[(row, column)]))).collect();
        Factor::new(values, right, norms, triangle.entry(n, n).powi(2), self.rows)
    }
}

/// Which columns are not zero in some rows.
fn present(rows: &[f64], unknowns: usize) -> Vec<bool> {
    let mut sizes = vec![0.0_f64; unknowns];
    for row in rows.chunks_exact(unknowns + 1) {
        // This sum is faster than a test of each value. NaN counts as not zero.
        sizes.iter_mut().zip(row).for_each(|(size, value)| *size += value.abs());
    }
    sizes.into_iter().map(|size| size != 0.0).collect()
}

/// The factor of all rows of some triangles, over `columns`, which contain the columns of all triangles.
fn stacked(triangles: &[Triangle], columns: Vec<usize>) -> Triangle {
    let height = triangles.iter().map(|triangle| triangle.values.nrows()).sum();
    let mut rows = Mat::zeros(height, columns.len() + 1);
    let mut first = 0;
    for triangle in triangles {
        let last = triangle.columns.len();
        let places = triangle.columns.iter().map(|column| columns.partition_point(|other| other < column));
        for (column, place) in places.chain([columns.len()]).enumerate() {
            for row in 0..triangle.values.nrows().min(if column < last { column + 1 } else { usize::MAX }) {
                rows[(first + row, place)] = triangle.values[(row, column)];
            }
        }
        first += triangle.values.nrows();
    }
    Triangle::of(columns, &rows)
}
