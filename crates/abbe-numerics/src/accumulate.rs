//! Reduces the rows of a least squares problem to their triangular factor.

use std::collections::BTreeMap;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch, recommended_block_size};
use faer::{Mat, Par, Spec};

use crate::factor::Factor;
use crate::vector::norm_of;

/// Memory that the buffer of rows may take, in numbers; small problems are factorised in one go.
const BUFFER: usize = 1 << 21;

/// Rows that are factorised together where there are many unknowns, most of which are zero in most rows.
const BLOCK: usize = 1024;

/// Problems with no more unknowns than this are factorised as if none were zero.
const FEW: usize = 64;

/// Fewest rows that groups with the same rare columns have on average, to be factorised by themselves.
const ROWS_OF_GROUP: usize = 8;

/// Reduces rows `[J | r]` of a least squares problem to their triangular factor.
///
/// Rows are collected in a buffer. A full buffer is factorised over the columns that are not zero in it: if measurements come
/// run by run, most columns of unknowns of other runs are zero. The result is that of one QR of all rows, with the memory of
/// the buffer only.
pub struct Accumulator {
    unknowns: usize,
    /// The indices of all unknowns.
    all: Vec<usize>,
    /// Most rows of the buffer.
    capacity: usize,
    /// Derivatives and residual of rows, one row after another.
    buffer: Vec<f64>,
    /// What the rows of the buffer have places for.
    parts: Vec<Part>,
    filled: usize,
    /// The columns that are not zero in the first half of the buffer.
    present: Option<Vec<bool>>,
    rows: usize,
    done: Vec<Triangle>,
}

/// Rows of the buffer with derivatives to the same unknowns.
struct Part {
    unknowns: Vec<usize>,
    rows: usize,
}

/// Rows of the buffer with the same rare columns.
struct Group {
    /// The columns that are not zero in them, or are common, ascending.
    columns: Vec<usize>,
    /// Where each begins in the buffer, and the part that it is of.
    rows: Vec<(usize, usize)>,
}

/// The factor of some rows, over the columns that are not zero in them.
struct Triangle {
    /// The unknowns, ascending.
    columns: Vec<usize>,
    /// Upper triangle; the last column is the right side.
    values: Mat<f64>,
}

impl Triangle {
    /// The factor of a matrix whose last column is the right side. What is below its diagonal means nothing.
    fn of(columns: Vec<usize>, mut rows: Mat<f64>) -> Self {
        let (height, width) = rows.shape();
        let size = height.min(width);
        let block = recommended_block_size::<f64>(height, width);
        let room = qr_in_place_scratch::<f64>(height, width, block, Par::Seq, Spec::default());
        let (mut reflections, mut room) = (Mat::zeros(block, size), MemBuffer::new(room));
        qr_in_place(rows.as_mut(), reflections.as_mut(), Par::Seq, MemStack::new(&mut room), Spec::default());
        Self { columns, values: rows.get(..size, ..).to_owned() }
    }

    fn height(&self) -> usize {
        self.values.nrows()
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
        Self::of(order.iter().map(|&column| self.columns[column]).collect(), rows)
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
            all: (0..unknowns).collect(),
            capacity,
            buffer: Vec::with_capacity(capacity * width),
            parts: Vec::new(),
            filled: 0,
            present: None,
            rows: 0,
            done: Vec::new(),
        }
    }

    /// Adds one row, multiplied by `weight` (the square root of its statistical weight).
    pub fn push(&mut self, derivatives: &[f64], residual: f64, weight: f64) {
        let all = std::mem::take(&mut self.all);
        self.push_some(&all, derivatives, residual, weight);
        self.all = all;
    }

    /// Adds one row, multiplied by `weight`, that depends on some unknowns only: `unknowns` has their indices, ascending,
    /// and `derivatives` one derivative for each.
    ///
    /// ```
    /// use abbe_numerics::Accumulator;
    ///
    /// let (mut one, mut other) = (Accumulator::new(3, 4), Accumulator::new(3, 4));
    /// for [first, last, residual] in [[1.0, 2.0, 0.5], [1.0, 0.5, 0.3], [0.5, 3.0, 0.1], [2.0, 1.0, 0.0]] {
    ///     one.push(&[first, 0.0, last], residual, 1.0);
    ///     other.push_some(&[0, 2], &[first, last], residual, 1.0);
    /// }
    /// assert_eq!(one.finish().norms(), other.finish().norms());
    /// ```
    pub fn push_some(&mut self, unknowns: &[usize], derivatives: &[f64], residual: f64, weight: f64) {
        if self.filled == self.capacity
            || (self.filled >= self.capacity / 2 && self.is_of_others(unknowns, derivatives))
        {
            self.flush();
        }
        match self.parts.last_mut().filter(|part| part.unknowns == unknowns) {
            Some(part) => part.rows += 1,
            None => self.parts.push(Part { unknowns: unknowns.to_vec(), rows: 1 }),
        }
        self.buffer.extend(derivatives.iter().map(|derivative| derivative * weight));
        self.buffer.push(residual * weight);
        self.filled += 1;
        self.rows += 1;
    }

    /// Whether a row has unknowns that the buffer does not have: the first row of the next run.
    fn is_of_others(&mut self, unknowns: &[usize], derivatives: &[f64]) -> bool {
        if self.unknowns <= FEW {
            return false;
        }
        let present = self.present.take().unwrap_or_else(|| self.present());
        let mut entries = unknowns.iter().zip(derivatives);
        let of_others = entries.any(|(&unknown, derivative)| *derivative != 0.0 && !present[unknown]);
        self.present = Some(present);
        of_others
    }

    /// The parts of the buffer with their rows.
    fn lines(&self) -> impl Iterator<Item = (&Part, &[f64])> {
        let mut rest = self.buffer.as_slice();
        self.parts.iter().map(move |part| {
            let (own, others) = rest.split_at(part.rows * (part.unknowns.len() + 1));
            rest = others;
            (part, own)
        })
    }

    /// Which unknowns have derivatives in the buffer that are not zero.
    fn present(&self) -> Vec<bool> {
        let mut present = vec![false; self.unknowns];
        for (part, lines) in self.lines() {
            let mut sizes = vec![0.0_f64; part.unknowns.len()];
            for line in lines.chunks_exact(part.unknowns.len() + 1) {
                // This sum is faster than a test of each value. NaN counts as not zero.
                sizes.iter_mut().zip(line).for_each(|(size, value)| *size += value.abs());
            }
            part.unknowns.iter().zip(sizes).for_each(|(&unknown, size)| present[unknown] |= size != 0.0);
        }
        present
    }

    /// The factor of the rows of the buffer over these columns.
    ///
    /// Where most rows have few of the rare columns, as touches that each know one of many features, rows with the same ones are
    /// factorised by themselves, over the columns that they have, and then their triangles.
    fn reduced(&self, columns: Vec<usize>) -> Triangle {
        let width = columns.len() + 1;
        let work = |rows: usize, width: usize| rows * width * width;
        let is_less = |groups: &Vec<Group>| {
            let heights = groups.iter().map(|group| group.rows.len().min(group.columns.len() + 1)).sum();
            let apart = groups.iter().map(|group| work(group.rows.len(), group.columns.len() + 1)).sum::<usize>();
            2 * (apart + work(heights, width)) <= work(self.filled, width)
        };
        let Some(groups) = self.groups().filter(is_less) else {
            let rows = self.matrix(&columns);
            return Triangle::of(columns, rows);
        };
        let triangles = groups.into_iter().map(|Group { columns, rows }| {
            let width = columns.len() + 1;
            // Column by column, the residuals last.
            let mut own = Mat::zeros(rows.len(), width);
            for (row, (start, part)) in rows.into_iter().enumerate() {
                let part = &self.parts[part].unknowns;
                let (line, mut next) = (&self.buffer[start..=start + part.len()], 0);
                for (unknown, value) in part.iter().zip(line) {
                    while columns.get(next).is_some_and(|column| column < unknown) {
                        next += 1;
                    }
                    if columns.get(next) == Some(unknown) {
                        own[(row, next)] = *value;
                    }
                }
                own[(row, width - 1)] = line[part.len()];
            }
            Triangle::of(columns, own)
        });
        stacked(&triangles.collect::<Vec<_>>(), columns)
    }

    /// The rows of the buffer in groups with the same rare columns: those that are not zero in a quarter of the rows at most. None
    /// where there are too many groups: to look for them, and to put their triangles together, then takes longer than it saves.
    fn groups(&self) -> Option<Vec<Group>> {
        let mut users = vec![0; self.unknowns];
        for (part, lines) in self.lines() {
            for line in lines.chunks_exact(part.unknowns.len() + 1) {
                part.unknowns
                    .iter()
                    .zip(line)
                    .for_each(|(&unknown, value)| users[unknown] += usize::from(*value != 0.0));
            }
        }
        let is_rare: Vec<bool> = users.iter().map(|users| 4 * users <= self.filled).collect();
        let (mut groups, mut known): (Vec<Group>, BTreeMap<Vec<usize>, usize>) = Default::default();
        let (mut start, mut rare) = (0, Vec::new());
        for (number, (part, lines)) in self.lines().enumerate() {
            let width = part.unknowns.len() + 1;
            for line in lines.chunks_exact(width) {
                rare.clear();
                let own =
                    part.unknowns.iter().zip(line).filter(|(unknown, value)| is_rare[**unknown] && **value != 0.0);
                rare.extend(own.map(|(unknown, _)| *unknown));
                let group = match known.get(&rare) {
                    Some(group) => *group,
                    None if ROWS_OF_GROUP * groups.len() >= self.filled => return None,
                    None => {
                        known.insert(rare.clone(), groups.len());
                        let columns = (0..self.unknowns).filter(|column| match is_rare[*column] {
                            true => rare.contains(column),
                            false => users[*column] > 0,
                        });
                        groups.push(Group { columns: columns.collect(), rows: Vec::new() });
                        groups.len() - 1
                    }
                };
                groups[group].rows.push((start, number));
                start += width;
            }
        }
        Some(groups)
    }

    /// The rows of the buffer over these columns, the residuals last.
    fn matrix(&self, columns: &[usize]) -> Mat<f64> {
        let mut place = vec![None; self.unknowns];
        columns.iter().enumerate().for_each(|(index, &column)| place[column] = Some(index));
        let mut rows = Mat::zeros(self.filled, columns.len() + 1);
        let mut first = 0;
        for (part, lines) in self.lines() {
            let width = part.unknowns.len() + 1;
            let places = part.unknowns.iter().map(|&unknown| place[unknown]).chain([Some(columns.len())]);
            for (from, to) in places.enumerate().filter_map(|(from, to)| Some((from, to?))) {
                let column = &mut rows.col_as_slice_mut(to)[first..first + part.rows];
                column.iter_mut().zip(lines.chunks_exact(width)).for_each(|(entry, line)| *entry = line[from]);
            }
            first += part.rows;
        }
        rows
    }

    /// Replaces the rows in the buffer by their triangular factor.
    fn flush(&mut self) {
        let present = self.present();
        let columns: Vec<usize> = (0..self.unknowns).filter(|&column| present[column]).collect();
        let triangle = self.reduced(columns);
        self.buffer.clear();
        self.parts.clear();
        self.present = None;
        self.filled = 0;
        self.done.push(triangle);
        self.stack();
    }

    /// Adds the rows of another one, for the same unknowns.
    ///
    /// ```
    /// use abbe_numerics::Accumulator;
    ///
    /// let rows = |from: u32, to: u32| {
    ///     let mut rows = Accumulator::new(2, 10);
    ///     (from..to).map(f64::from).for_each(|t| rows.push(&[1.0, t], t.sin(), 1.0));
    ///     rows
    /// };
    /// let (mut one, all) = (rows(0, 4), rows(0, 10).finish());
    /// one.append(rows(4, 10));
    /// let both = one.finish();
    /// assert_eq!(both.rows(), 10);
    /// assert!((both.step().unwrap()[1] - all.step().unwrap()[1]).abs() < 1e-15);
    /// ```
    pub fn append(&mut self, mut other: Self) {
        for part in [&mut *self, &mut other] {
            if part.filled > 0 {
                part.flush();
            }
        }
        self.rows += other.rows;
        self.done.append(&mut other.done);
    }

    /// Replaces its rows by triangles, and triangles over nearly the same columns by one.
    pub fn reduce(&mut self) {
        if self.filled > 0 {
            self.flush();
        }
        self.done = gathered(std::mem::take(&mut self.done), self.unknowns + 1);
    }

    /// Puts triangles together where they have become many.
    fn stack(&mut self) {
        let are_many =
            |all: &[Triangle]| all.iter().map(Triangle::height).sum::<usize>() * (self.unknowns + 1) > BUFFER;
        if !are_many(&self.done) {
            return;
        }
        self.done = gathered(std::mem::take(&mut self.done), self.unknowns + 1);
        if are_many(&self.done) {
            let triangles = std::mem::take(&mut self.done);
            self.done.push(stacked(&triangles, (0..self.unknowns).collect()));
        }
    }

    /// The factor of all rows.
    pub fn finish(mut self) -> Factor {
        let all: Vec<usize> = std::mem::take(&mut self.all);
        if self.done.is_empty() {
            return self.factor(&self.reduced(all));
        }
        self.reduce();
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

/// The same rows in fewer triangles: those over nearly the same columns become one, where this makes less work for a factor of all,
/// over so many columns with the right side.
fn gathered(mut triangles: Vec<Triangle>, width: usize) -> Vec<Triangle> {
    let work = |rows: usize, width: usize| rows * width * width;
    // What triangles of this height over so many columns cost, alone and as rows of the factor of all.
    let cost = |height: usize, columns: usize, count: usize| {
        let own = if count > 1 { work(height, columns + 1) } else { 0 };
        own + work(height.min(columns + 1), width)
    };
    triangles.sort_by(|one, other| one.columns.cmp(&other.columns));
    let mut groups: Vec<(Vec<Triangle>, Vec<usize>, usize)> = Vec::new();
    for triangle in triangles {
        let (height, columns) = (triangle.height(), triangle.columns.len());
        if let Some((group, union, sum)) = groups.last_mut() {
            let both = union_of(union, &triangle.columns);
            let apart = cost(*sum, union.len(), group.len()) + cost(height, columns, 1);
            if cost(*sum + height, both.len(), group.len() + 1) < apart {
                group.push(triangle);
                *sum += height;
                *union = both;
                continue;
            }
        }
        let union = triangle.columns.clone();
        groups.push((vec![triangle], union, height));
    }
    let one = |(mut group, union, _): (Vec<Triangle>, Vec<usize>, usize)| match group.len() {
        1 => group.swap_remove(0),
        _ => stacked(&group, union),
    };
    groups.into_iter().map(one).collect()
}

/// What is in one of two ascending lists, ascending.
fn union_of(one: &[usize], other: &[usize]) -> Vec<usize> {
    let mut all = [one, other].concat();
    all.sort_unstable();
    all.dedup();
    all
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
    Triangle::of(columns, rows)
}
