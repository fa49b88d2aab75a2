//! Rows of a problem of block arrow structure, group by group to its triangular factor.

use super::factor::{ArrowFactor, EliminatedGroup};
use super::groups::{Groups, Place};
use super::reflect::eliminate;
use crate::accumulate::Accumulator;

/// Numbers of rows that wait for their elimination.
const WAITING: usize = 1 << 20;

/// Reduces rows of a least squares problem whose unknowns stand in [`Groups`] to their triangular factor.
///
/// The rows of a group are reduced by reflections of their own columns; what remains has the shared unknowns alone, and goes on to
/// their triangle (Golub and Van Loan 2013, section 5.3; the elimination of Golub and Plemmons 1980, Linear Algebra Appl. 34:3). So the
/// result is that of one QR of all rows, and as accurate, but it takes memory in proportion to the number of groups.
///
/// ```
/// use abbe_numerics::{ArrowAccumulator, GroupSearch};
///
/// // Each of two unknowns has two readings, and a drift is shared.
/// let rows = [(1, 0.0, 1.0), (1, 1.0, 1.5), (2, 2.0, 4.0), (2, 3.0, 4.5)];
/// let mut search = GroupSearch::new(vec![false, true, true]);
/// rows.iter().for_each(|(own, time, _)| search.row(&[0, *own], &[*time, 1.0]));
/// let groups = search.groups();
/// let mut accumulator = ArrowAccumulator::new(&groups, &[rows.len()]);
/// for (own, time, reading) in rows {
///     accumulator.push(0, &[0, own], &[time, 1.0], -reading, 1.0).unwrap();
/// }
/// let step = accumulator.finish().step().unwrap();
/// assert!([0.5, 1.0, 3.0].iter().zip(&step).all(|(expected, found)| (expected - found).abs() < 1e-14));
/// ```
pub struct ArrowAccumulator<'a> {
    groups: &'a Groups,
    /// The rows of every group that are not eliminated yet, and its triangle so far: own columns, shared ones, the residual.
    waiting: Vec<Waiting>,
    /// Groups with rows that are new.
    touched: Vec<usize>,
    /// Numbers in new rows.
    pending: usize,
    /// What is left of the rows of each source.
    left: Vec<Accumulator>,
    rows: Vec<usize>,
}

#[derive(Clone, Default)]
struct Waiting {
    source: usize,
    is_touched: bool,
    lines: Vec<f64>,
}

/// A row that has unknowns of two groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OfTwoGroups {
    /// One of its unknowns.
    pub one: usize,
    /// One of another group.
    pub other: usize,
}

impl std::fmt::Display for OfTwoGroups {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "a row has the unknowns {} and {}, which are of two groups", self.one, self.other)
    }
}

impl std::error::Error for OfTwoGroups {}

impl<'a> ArrowAccumulator<'a> {
    /// For about so many rows of each source. What the rows of a source tell of the shared unknowns is known by itself
    /// ([`ArrowFactor::of_sources`]); all rows of a group have to come from one source.
    pub fn new(groups: &'a Groups, rows: &[usize]) -> Self {
        let shared = groups.shared().len();
        Self {
            groups,
            waiting: vec![Waiting::default(); groups.members().len()],
            touched: Vec::new(),
            pending: 0,
            left: rows.iter().map(|&rows| Accumulator::new(shared, rows)).collect(),
            rows: vec![0; rows.len()],
        }
    }

    /// Adds one row of a source, multiplied by `weight` (the square root of its statistical weight): its unknowns, ascending, and one
    /// derivative for each.
    ///
    /// Fails for a row that has unknowns of two groups.
    pub fn push(
        &mut self,
        source: usize,
        unknowns: &[usize],
        derivatives: &[f64],
        residual: f64,
        weight: f64,
    ) -> Result<(), OfTwoGroups> {
        let Some(group) = self.group_of(unknowns, derivatives)? else {
            let (mut columns, mut values) = (Vec::with_capacity(unknowns.len()), Vec::with_capacity(unknowns.len()));
            for (unknown, value) in unknowns.iter().zip(derivatives) {
                if let Place::Shared(place) = self.groups.place(*unknown) {
                    columns.push(place);
                    values.push(*value);
                }
            }
            self.left[source].push_some(&columns, &values, residual, weight);
            self.rows[source] += 1;
            return Ok(());
        };
        let (members, shared) = (&self.groups.members()[group], self.groups.shared().len());
        let waiting = &mut self.waiting[group];
        let (first, width) = (waiting.lines.len(), members.len() + shared + 1);
        waiting.lines.resize(first + width, 0.0);
        let line = &mut waiting.lines[first..];
        for (unknown, value) in unknowns.iter().zip(derivatives).filter(|(_, value)| **value != 0.0) {
            let column = match self.groups.place(*unknown) {
                Place::Shared(place) => members.len() + place,
                Place::Own(_) => members.partition_point(|member| member < unknown),
            };
            line[column] = value * weight;
        }
        line[width - 1] = residual * weight;
        waiting.source = source;
        if !std::mem::replace(&mut waiting.is_touched, true) {
            self.touched.push(group);
        }
        self.rows[source] += 1;
        self.pending += width;
        if self.pending > WAITING {
            self.eliminate_waiting();
        }
        Ok(())
    }

    /// Adds the rows of another one with the same groups and as many sources.
    pub fn join(&mut self, mut other: Self) {
        other.eliminate_waiting();
        for (group, own) in other.waiting.into_iter().enumerate().filter(|(_, own)| !own.lines.is_empty()) {
            let waiting = &mut self.waiting[group];
            waiting.source = own.source;
            waiting.lines.extend(&own.lines);
            if !std::mem::replace(&mut waiting.is_touched, true) {
                self.touched.push(group);
            }
            self.pending += own.lines.len();
        }
        let shared = self.groups.shared().len();
        for (left, own) in self.left.iter_mut().zip(other.left) {
            for line in own.finish().lines() {
                left.push(&line[..shared], line[shared], 1.0);
            }
        }
        self.rows.iter_mut().zip(other.rows).for_each(|(rows, own)| *rows += own);
        if self.pending > WAITING {
            self.eliminate_waiting();
        }
    }

    /// The group of a row; none if it has shared unknowns alone.
    fn group_of(&self, unknowns: &[usize], derivatives: &[f64]) -> Result<Option<usize>, OfTwoGroups> {
        let mut found: Option<(usize, usize)> = None;
        for (&unknown, _) in unknowns.iter().zip(derivatives).filter(|(_, value)| **value != 0.0) {
            if let Place::Own(group) = self.groups.place(unknown) {
                match found {
                    Some((known, one)) if known != group => return Err(OfTwoGroups { one, other: unknown }),
                    _ => found = Some((group, unknown)),
                }
            }
        }
        Ok(found.map(|(group, _)| group))
    }

    /// Reduces the new rows of all groups.
    fn eliminate_waiting(&mut self) {
        let shared = self.groups.shared().len();
        for group in std::mem::take(&mut self.touched) {
            let own = self.groups.members()[group].len();
            let waiting = &mut self.waiting[group];
            waiting.is_touched = false;
            let width = own + shared + 1;
            eliminate(&mut waiting.lines, width, own);
            let kept = waiting.lines.len().min(own * width);
            for line in waiting.lines[kept..].chunks_exact(width) {
                self.left[waiting.source].push(&line[own..own + shared], line[width - 1], 1.0);
            }
            waiting.lines.truncate(kept);
            waiting.lines.shrink_to_fit();
        }
        self.pending = 0;
    }

    /// The factor of all rows.
    pub fn finish(mut self) -> ArrowFactor {
        self.eliminate_waiting();
        let shared = self.groups.shared().len();
        let mut eliminated = Vec::with_capacity(self.waiting.len());
        for (members, waiting) in self.groups.members().iter().zip(self.waiting) {
            let (group, left) = EliminatedGroup::new(members.clone(), waiting.lines, shared);
            for line in left {
                self.left[waiting.source].push(&line[..shared], line[shared], 1.0);
            }
            eliminated.push(group);
        }
        let of_sources = self.left.into_iter().zip(&self.rows).map(|(left, rows)| left.finish().of_rows(*rows));
        ArrowFactor::new(self.groups, eliminated, of_sources.collect())
    }
}
