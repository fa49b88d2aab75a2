//! Rows that are chosen at random of data sets that are read in batches: where their estimates begin, and what tables of residuals and
//! charts show of them.

use std::path::PathBuf;
use std::sync::{Arc, PoisonError};

use abbe_core::{DataRow, Dataset, Error, Fit, Monitor, Problem, Result, RowOrigin, free_threads};

use abbe_estimation::with_factors_found;
use abbe_recipe::Stage;

use crate::batches::InBatches;
use crate::in_order::in_order;
use crate::parts::Rows;
use crate::record::Remark;
use crate::run::Datasets;

/// How many rows of a data set are chosen, about: enough for a chart, and no more than a batch has, as a rule.
const CHOSEN: usize = 5_000;

/// The seed of the choice.
const SEED: u64 = 20;

impl InBatches<'_> {
    /// The problem of an estimate on rows that are chosen at random, and what to say of them if these are not all; none for an
    /// estimate of rows that are held.
    pub fn sampled(&self, fit: &Fit, monitor: &Monitor) -> Result<Option<(Problem, Vec<Remark>)>> {
        let Some(whole) = self.problem(&fit.name) else { return Ok(None) };
        let stage = self.prepared.recipe_stage(&fit.name)?;
        let (mut data, mut remarks) = (self.data.clone(), Vec::from_iter(self.unlisted(&fit.name)));
        for ingest in self.prepared.batched_of(stage)? {
            let all = self.rows_of(&ingest);
            let chosen = self.chosen(&ingest, monitor)?;
            if chosen.rows() < all {
                let text = format!(
                    "the table of its residuals, the charts and exports of residuals show {} of {all} rows of `{ingest}`, chosen at \
                     random (seed {SEED})",
                    chosen.rows()
                );
                remarks.push(Remark { estimate: fit.name.clone(), text });
            }
            data.insert(ingest, chosen);
        }
        let problem = self.problem_of_chosen(stage, whole, &data)?;
        Ok(Some((with_factors_found(&problem, &fit.calibration.fit.variance), remarks)))
    }

    /// The problem of an estimate on the rows of each data set that are chosen at random.
    pub fn chosen_problem(&self, stage: &Stage, whole: &Problem, monitor: &Monitor) -> Result<Problem> {
        let mut data = self.data.clone();
        for ingest in self.prepared.batched_of(stage)? {
            let chosen = self.chosen(&ingest, monitor)?;
            data.insert(ingest, chosen);
        }
        self.problem_of_chosen(stage, whole, &data)
    }

    fn problem_of_chosen(&self, stage: &Stage, whole: &Problem, data: &Datasets) -> Result<Problem> {
        let observed = self.prepared.observed(stage, |ingest| match self.prepared.is_in_batches(ingest) {
            true => Some(Rows::Some),
            false => Some(Rows::All),
        })?;
        let problem = self.prepared.part_problem(stage, whole.model.clone(), &observed, data, None);
        self.prepared.located(stage, problem)
    }

    /// The chosen rows of a data set, in their order. They are chosen once.
    fn chosen(&self, ingest: &str, monitor: &Monitor) -> Result<Arc<Dataset>> {
        let mut known = self.chosen.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = known.get(ingest) {
            return Ok(known.clone());
        }
        let chosen = Arc::new(self.choose(ingest, monitor)?);
        known.insert(ingest.to_owned(), chosen.clone());
        Ok(chosen)
    }

    fn choose(&self, ingest: &str, monitor: &Monitor) -> Result<Dataset> {
        let all = self.rows_of(ingest);
        let batches: Vec<usize> = (0..self.count(ingest)).collect();
        let of_batch = |batch: &usize| {
            monitor.check()?;
            let (data, _) = self.with_batch(ingest, *batch)?;
            let data = &data[ingest];
            let is_chosen = |row: &DataRow| is_chosen(data.origins[*row], &data.files, all);
            Ok(data.of_rows(&data.row_indices().filter(is_chosen).collect::<Vec<_>>()))
        };
        let found = in_order(&batches, free_threads(), of_batch, Dataset::append, |_| ())?;
        found.ok_or_else(|| Error::data("there are no rows").stage(ingest))
    }
}

/// Whether a row of a data set is among the chosen ones of all: its file and its place there decide, whatever batch it is in. Files that
/// repeat a programme give other rows of it.
fn is_chosen(origin: RowOrigin, files: &[PathBuf], all: usize) -> bool {
    // The name without its folders: the same rows wherever a recipe lies.
    let name = files[origin.file].file_name().map(|name| name.as_encoded_bytes()).unwrap_or_default();
    let file = name.iter().fold(SEED, |seed, byte| mixed(seed ^ u64::from(*byte)));
    all <= CHOSEN || mixed(file ^ mixed(origin.row as u64)) % (all as u64) < CHOSEN as u64
}

/// A number as good as a random one (the finaliser of SplitMix64: Steele, Lea and Flood 2014, OOPSLA).
fn mixed(number: u64) -> u64 {
    let mut mixed = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn about_as_many_rows_are_chosen_as_wanted() {
        let files = ["monday.csv", "tuesday.csv"].map(PathBuf::from);
        for all in [1, CHOSEN, 3 * CHOSEN, 1_000_000] {
            let origin = |row: usize| RowOrigin { file: row % 2, line: row + 1, row: row / 2 };
            let chosen: Vec<usize> = (1..=all).filter(|row| is_chosen(origin(*row), &files, all)).collect();
            let allowed = if all <= CHOSEN { 0 } else { CHOSEN / 20 };
            assert!(chosen.len().abs_diff(all.min(CHOSEN)) <= allowed, "{} of {all}", chosen.len());
            // The rows of one file say nothing of those of another one.
            let both = chosen.iter().filter(|row| *row % 2 == 0 && chosen.binary_search(&(*row + 1)).is_ok());
            assert!(all <= 3 * CHOSEN || both.count() < CHOSEN / 100);
        }
    }
}
