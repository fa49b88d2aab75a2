//! Estimates of readings, and validators, whose data sets are read in batches: they see all rows again and again, in their order.
//!
//! While a batch is looked at, other threads read the next ones. Whoever looks sees the rows in their order, on one thread, so that
//! results do not depend on how many threads there are, nor on how large a batch is.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Mutex, PoisonError};

use abbe_core::{
    Batch, Batches, DataRecord, Dataset, Error, Findings, Fit, Kind, Monitor, Parts, Passes, Result, free_threads,
};
use abbe_recipe::Stage;

use crate::batches::InBatches;
use crate::evidence::{Digests, of_runs};
use crate::prepare::Prepared;
use crate::readings::has_readings;
use crate::run::Datasets;
use crate::travel::in_travel;

/// Runs of rows by the files that they stand in.
pub(crate) type Seen = BTreeMap<String, Vec<[usize; 2]>>;

/// A data set that is read in batches, for one stage that looks at it.
struct InPasses<'a> {
    ingest: &'a str,
    source: &'a dyn Batches,
    seen: &'a Mutex<BTreeMap<String, Seen>>,
    monitor: Monitor,
}

impl Passes for InPasses<'_> {
    fn pass(&self, look: &mut dyn FnMut(&Dataset) -> Result<()>) -> Result<()> {
        let is_first = !self.locked().contains_key(self.ingest);
        let (mut seen, mut rows, mut left_out) = (Seen::new(), 0, 0);
        let all = self.source.count();
        ahead(all, free_threads().saturating_sub(1), &|batch| self.source.read(batch), &mut |batch, read| {
            self.monitor.check()?;
            let Batch { data, left_out: out } = read;
            if is_first {
                note(&mut seen, &data);
            }
            left_out += out;
            rows += data.rows();
            data.pass(look)?;
            self.monitor.parts_done("batches", batch + 1, Some(all));
            Ok(())
        })?;
        if rows == 0 {
            return Err(no_rows());
        }
        if is_first && self.locked().insert(self.ingest.to_owned(), seen).is_none() {
            tell_left_out(self.ingest, left_out);
        }
        Ok(())
    }
}

impl InPasses<'_> {
    fn locked(&self) -> std::sync::MutexGuard<'_, BTreeMap<String, Seen>> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The error for a data set without rows.
pub(crate) fn no_rows() -> Error {
    let error = Error::data("no row is left after `no_data`, `within`, `ignore` and `keep`");
    error.help("name other rows there")
}

/// Tells how many rows are left out of a data set because a number was not measured.
pub(crate) fn tell_left_out(ingest: &str, left_out: usize) {
    if left_out > 0 {
        let [hold, are] = if left_out == 1 { ["row holds", "is"] } else { ["rows hold", "are"] };
        tracing::warn!("{ingest}: {left_out} {hold} a mark of `no_data` and {are} left out");
    }
}

/// Adds the rows of a batch to those that were seen.
fn note(seen: &mut Seen, data: &Dataset) {
    let mut runs: Vec<&mut Vec<[usize; 2]>> = Vec::new();
    let mut all: Vec<Vec<[usize; 2]>> = vec![Vec::new(); data.files.len()];
    runs.extend(all.iter_mut());
    for origin in &data.origins {
        match runs[origin.file].last_mut() {
            Some(last) if last[1] + 1 == origin.row => last[1] = origin.row,
            _ => runs[origin.file].push([origin.row, origin.row]),
        }
    }
    for (file, runs) in data.files.iter().zip(all).filter(|(_, runs)| !runs.is_empty()) {
        let known = seen.entry(file.display().to_string()).or_default();
        for run in runs {
            match known.last_mut() {
                Some(last) if last[1] + 1 == run[0] => last[1] = run[1],
                _ => known.push(run),
            }
        }
    }
}

/// Reads items 0, 1, ... and shows them in this order, while `threads` other threads read the next ones: each waits with one that it
/// has read until the one before it has been shown. Ends with the first error.
fn ahead<R: Send>(
    count: usize,
    threads: usize,
    read: &(dyn Fn(usize) -> Result<R> + Sync),
    look: &mut dyn FnMut(usize, R) -> Result<()>,
) -> Result<()> {
    let threads = threads.min(count.saturating_sub(1));
    std::thread::scope(|scope| {
        let mut readers: Vec<Receiver<Result<R>>> = Vec::new();
        for first in 0..threads {
            let (sender, receiver) = sync_channel(0);
            let all = move || {
                // Nobody waits for more once an error ends the pass.
                let _ = (first..count).step_by(threads).try_for_each(|item| sender.send(read(item)));
            };
            if std::thread::Builder::new().spawn_scoped(scope, all).is_err() {
                break;
            }
            readers.push(receiver);
        }
        (0..count).try_for_each(|item| {
            // Where the system gives no more threads, this one reads what they would.
            let found = match readers.get(if threads == 0 { 0 } else { item % threads }) {
                Some(reader) => reader.recv().unwrap_or_else(|_| read(item)),
                None => read(item),
            };
            look(item, found?)
        })
    })
}

impl Prepared {
    /// Whether a stage looks at data sets under `from` of which one at least is read in batches.
    pub(crate) fn has_passes(&self, stage: &Stage) -> bool {
        let looks = stage.kind == Kind::Validate || has_readings(stage);
        looks && stage.reference("from").iter().any(|ingest| self.is_in_batches(ingest))
    }

    /// Whether stages look at a data set that is read in batches, and no artefact observes it.
    pub(crate) fn is_only_looked_at(&self, ingest: &str) -> bool {
        let looks = |stage: &&Stage| self.has_passes(stage) && stage.reference("from").iter().any(|own| own == ingest);
        let observes = |stage: &&Stage| self.batched_of(stage).is_ok_and(|own| own.iter().any(|own| own == ingest));
        let mut looking = self.stages(Kind::Estimate).chain(self.stages(Kind::Validate));
        looking.any(|stage| looks(&stage)) && !self.stages(Kind::Estimate).any(|stage| observes(&stage))
    }

    /// What a validator says of fits and of the data sets under its `from`.
    pub(crate) fn said_of(
        &self,
        stage: &Stage,
        fits: &[&Fit],
        data: &Datasets,
        batches: &InBatches<'_>,
    ) -> Result<Findings> {
        if !self.has_passes(stage) {
            let data: Vec<&Dataset> = stage.reference("from").iter().map(|name| data[name].as_ref()).collect();
            self.located(stage, in_travel(fits, &data))?;
            return self.findings(stage, fits, &data);
        }
        let passes = batches.passes(stage, data)?;
        let all: Vec<&dyn Passes> = passes.iter().map(AsRef::as_ref).collect();
        if fits.iter().any(|fit| !fit.problem.model.info().axes.is_empty()) {
            all.iter().try_for_each(|data| data.pass(&mut |shown| self.located(stage, in_travel(fits, &[shown]))))?;
        }
        self.validators[&stage.name].validate_in_passes(fits, &all)
    }
}

impl Prepared {
    /// What a validator says that asks rows in batches again.
    pub(crate) fn said_of_parts(
        &self,
        stage: &Stage,
        fits: &[&Fit],
        data: &Datasets,
        batches: &InBatches<'_>,
    ) -> Result<Findings> {
        let data: Vec<&Dataset> = stage.reference("from").iter().map(|name| data[name].as_ref()).collect();
        let rows = fits.iter().map(|fit| batches.parts(fit, &batches.monitor.of_stage(&stage.name)));
        let rows = rows.collect::<Result<Vec<_>>>()?;
        let fits: Vec<(&Fit, Option<&dyn Parts>)> =
            fits.iter().zip(&rows).map(|(fit, rows)| (*fit, rows.as_deref())).collect();
        self.validators[&stage.name].validate_parts(&fits, &data)
    }
}

impl InBatches<'_> {
    /// The data sets under `from` of a stage, in their order.
    pub(crate) fn passes<'a>(&'a self, stage: &'a Stage, data: &'a Datasets) -> Result<Vec<Box<dyn Passes + 'a>>> {
        let one = |ingest: &'a String| -> Result<Box<dyn Passes + 'a>> {
            if !self.prepared.is_in_batches(ingest) {
                let held: &'a Dataset = data[ingest].as_ref();
                return Ok(Box::new(held));
            }
            let source = self.source(ingest)?;
            Ok(Box::new(InPasses { ingest, source, seen: &self.seen, monitor: self.monitor.of_stage(&stage.name) }))
        };
        stage.reference("from").iter().map(one).collect()
    }

    /// The rows that an estimate of readings rests on: all that it reads. Of a data set that nobody has looked at yet all rows are read.
    pub(crate) fn rows_read(&self, stage: &Stage, data: &Datasets, digests: &Digests) -> Result<Vec<DataRecord>> {
        let passes = self.passes(stage, data)?;
        let mut rows = Seen::new();
        for (ingest, passes) in stage.reference("from").iter().zip(passes) {
            let known = self.seen.lock().unwrap_or_else(PoisonError::into_inner).get(ingest).cloned();
            match known {
                Some(known) => rows.extend(known),
                None => passes.pass(&mut |data| {
                    note(&mut rows, data);
                    Ok(())
                })?,
            }
        }
        Ok(of_runs(rows, digests))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn items_are_shown_in_their_order_and_few_wait() {
        for threads in [0, 1, 3, 50] {
            let (read, shown, mut most) = (AtomicUsize::new(0), AtomicUsize::new(0), 0);
            let number = |item: usize| {
                read.fetch_add(1, Ordering::Relaxed);
                Ok(item)
            };
            let mut found = Vec::new();
            ahead(20, threads, &number, &mut |place, item| {
                assert_eq!(place, item);
                most = most.max(read.load(Ordering::Relaxed) - shown.fetch_add(1, Ordering::Relaxed));
                found.push(item);
                Ok(())
            })
            .unwrap();
            assert_eq!(found, (0..20).collect::<Vec<_>>());
            assert!(most <= threads.max(1) + 1, "{threads}: {most}");
        }
        ahead(0, 3, &Ok, &mut |_, _: usize| Ok(())).unwrap();
    }

    #[test]
    fn the_first_error_ends_a_pass() {
        let read = |item: usize| if item == 7 { Err(Error::data("read 7")) } else { Ok(item) };
        for threads in [0, 1, 2, 5] {
            let mut last = 0;
            let error = ahead(20, threads, &read, &mut |item, _| {
                last = item;
                Ok(())
            });
            assert_eq!((error.unwrap_err().message.as_str(), last), ("read 7", 6));
            let look = &mut |item: usize, _| if item == 3 { Err(Error::data("looked at 3")) } else { Ok(()) };
            assert_eq!(ahead(20, threads, &read, look).unwrap_err().message, "looked at 3");
        }
    }

    #[test]
    fn rows_are_noted_over_batches() {
        let data = |rows: &[(usize, usize)]| Dataset {
            origins: rows.iter().map(|&(file, row)| abbe_core::RowOrigin { file, line: row + 1, row }).collect(),
            files: vec!["a.csv".into(), "b.csv".into()],
            ..Dataset::default()
        };
        let mut seen = Seen::new();
        note(&mut seen, &data(&[(0, 1), (0, 2), (0, 4)]));
        note(&mut seen, &data(&[(0, 5), (1, 1)]));
        note(&mut seen, &data(&[(1, 2), (1, 3)]));
        assert_eq!(seen["a.csv"], [[1, 2], [4, 5]]);
        assert_eq!(seen["b.csv"], [[1, 3]]);
    }
}
