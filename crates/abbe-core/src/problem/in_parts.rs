//! Work on the rows of a problem in parts, which threads share.

use super::Problem;
use super::evaluation::Evaluation;
use super::linearise::{CHUNK, Columns, CompactBlock, Linearised};
use crate::index::{EquationIndex, RowIndex, SetIndex};
use abbe_settings::{Result, in_parallel};

/// Parts of the rows that are summed by themselves: their number, and with it the last digits, do not depend on that of threads.
const PARTS: usize = 8;

/// Rows of a set that are evaluated together, with their first equation.
pub type Chunk<'a> = (SetIndex, &'a [RowIndex], EquationIndex);

/// A part of the rows of a problem at some values.
pub struct PartOfRows<'a> {
    at: &'a Problem,
    columns: &'a Columns,
    chunks: &'a [Chunk<'a>],
}

impl PartOfRows<'_> {
    /// Their residuals and derivatives, block by block, without the columns that are zero in a whole block.
    pub fn linearise(&self, mut sink: impl FnMut(CompactBlock<'_>)) -> Result<()> {
        let (mut work, mut linear) = (Evaluation::default(), Linearised::default());
        for &(set, rows, first) in self.chunks {
            self.at.linearise_rows(set, rows, self.columns, &mut work, &mut linear)?;
            sink(linear.block(first));
        }
        Ok(())
    }
}

impl Problem {
    /// What `work` makes of parts of the rows at `x`, in their order. Threads share the parts; there are `parts` at most, whatever the
    /// number of threads.
    pub fn linearise_in_parts<R: Send>(
        &self,
        x: &[f64],
        parts: usize,
        work: impl Fn(&PartOfRows<'_>) -> Result<R> + Sync,
    ) -> Result<Vec<R>> {
        let (at, columns) = (&self.with_values(x), &Columns::of(self));
        let work = |chunks: &[Chunk<'_>]| work(&PartOfRows { at, columns, chunks });
        at.in_so_many_parts(parts, self.unknowns.len(), work).into_iter().collect()
    }

    /// What `work` makes of parts of the rows, in their order. Threads share them if derivatives to so many variables are worth it.
    pub fn in_parts<R: Send>(&self, variables: usize, work: impl Fn(&[Chunk<'_>]) -> R + Sync) -> Vec<R> {
        self.in_so_many_parts(PARTS, variables, work)
    }

    fn in_so_many_parts<R: Send>(
        &self,
        parts: usize,
        variables: usize,
        work: impl Fn(&[Chunk<'_>]) -> R + Sync,
    ) -> Vec<R> {
        let mut first = EquationIndex(0);
        let sets = SetIndex::enumerate(&self.sets);
        let chunks = sets.flat_map(|(index, set)| set.rows.chunks(CHUNK).map(move |rows| (index, set, rows)));
        let chunks = chunks.map(|(index, set, rows)| {
            let start = first;
            first += set.equations_of(rows).count();
            (index, rows, start)
        });
        let chunks: Vec<Chunk<'_>> = chunks.collect();
        let parts: Vec<&[Chunk<'_>]> = chunks.chunks(chunks.len().div_ceil(parts.max(1)).max(1)).collect();
        in_parallel(&parts, Some(self.threads(variables)), |part| work(part))
    }
}
