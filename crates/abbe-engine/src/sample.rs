//! Rows that are chosen at random of data sets that are read in batches: where their estimates begin, and what tables of residuals and
//! charts show of them.

use std::path::Path;
use std::sync::{Arc, PoisonError};

use abbe_core::{DataRow, Dataset, Error, Fit, Monitor, Problem, Result, RowOrigin, free_threads};

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
        Ok(Some((self.problem_of_chosen(stage, whole, &data)?, remarks)))
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

    /// Keeps the chosen ones of candidates, if all of them are there.
    pub fn keep_chosen(&self, ingest: &str, candidates: &Candidates, all: usize) {
        let mut known = self.chosen.lock().unwrap_or_else(PoisonError::into_inner);
        known.extend(candidates.chosen(all).map(|chosen| (ingest.to_owned(), Arc::new(chosen))));
    }

    fn choose(&self, ingest: &str, monitor: &Monitor) -> Result<Dataset> {
        let all = self.rows_of(ingest);
        let batches: Vec<usize> = (0..self.count(ingest)).collect();
        let of_batch = |batch: &usize| {
            monitor.check()?;
            let (data, _) = self.with_batch(ingest, *batch)?;
            Ok(below(&data[ingest], bound_of(all)))
        };
        let found = in_order(&batches, free_threads(), of_batch, Dataset::append, |_| ())?;
        found.ok_or_else(|| Error::data("there are no rows").stage(ingest))
    }
}

/// Rows among which the chosen ones are, gathered while all rows are read the first time and nobody knows how many there are.
pub(crate) struct Candidates {
    rows: Dataset,
    /// The largest number of a row that is gathered.
    bound: u64,
}

/// Most candidates, a few times as many as are chosen: the bound is lowered before it reaches that of the chosen ones.
const CANDIDATES: usize = 3 * CHOSEN;

impl Candidates {
    /// Those of a batch; `bound` is that of other batches, and becomes lower with more of them.
    pub fn of(data: &Dataset, bound: u64) -> Self {
        let mut candidates = Self { rows: below(data, bound), bound };
        candidates.lower();
        candidates
    }

    /// Adds those of the next batch.
    pub fn append(&mut self, more: Self) -> Result<()> {
        self.bound = self.bound.min(more.bound);
        self.rows.append(more.rows)?;
        self.lower();
        Ok(())
    }

    fn lower(&mut self) {
        while self.rows.rows() > CANDIDATES {
            self.bound /= 2;
            self.rows = below(&self.rows, self.bound);
        }
    }

    /// The largest number of a row that is gathered.
    pub fn bound(&self) -> u64 {
        self.bound
    }

    /// The chosen rows of all; none if not all of them are here.
    fn chosen(&self, all: usize) -> Option<Dataset> {
        let bound = bound_of(all);
        (bound <= self.bound).then(|| below(&self.rows, bound))
    }
}

/// The rows whose numbers are no larger than a bound.
fn below(data: &Dataset, bound: u64) -> Dataset {
    let files: Vec<u64> = data.files.iter().map(|file| number_of_file(file)).collect();
    let is_below = |row: &DataRow| number(data.origins[*row], &files) <= bound;
    data.of_rows(&data.row_indices().filter(is_below).collect::<Vec<_>>())
}

/// The largest number of a row that is chosen of so many.
fn bound_of(all: usize) -> u64 {
    if all <= CHOSEN { u64::MAX } else { u64::MAX / all as u64 * CHOSEN as u64 }
}

/// The number of a row, which decides whether it is chosen: its file and its place there give it, whatever batch it is in. Files that
/// repeat a programme give other rows of it.
fn number(origin: RowOrigin, files: &[u64]) -> u64 {
    mixed(files[origin.file] ^ mixed(origin.row as u64))
}

fn number_of_file(file: &Path) -> u64 {
    // The name without its folders: the same rows wherever a recipe lies.
    let name = file.file_name().map(|name| name.as_encoded_bytes()).unwrap_or_default();
    name.iter().fold(SEED, |seed, byte| mixed(seed ^ u64::from(*byte)))
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
    use std::path::PathBuf;

    use super::*;

    #[test]
    fn about_as_many_rows_are_chosen_as_wanted() {
        let files = ["monday.csv", "tuesday.csv"].map(|file| number_of_file(Path::new(file)));
        for all in [1, CHOSEN, 3 * CHOSEN, 1_000_000] {
            let origin = |row: usize| RowOrigin { file: row % 2, line: row + 1, row: row / 2 };
            let is_chosen = |row: &usize| number(origin(*row), &files) <= bound_of(all);
            let chosen: Vec<usize> = (1..=all).filter(is_chosen).collect();
            let allowed = if all <= CHOSEN { 0 } else { CHOSEN / 20 };
            assert!(chosen.len().abs_diff(all.min(CHOSEN)) <= allowed, "{} of {all}", chosen.len());
            // The rows of one file say nothing of those of another one.
            let both = chosen.iter().filter(|row| *row % 2 == 0 && chosen.binary_search(&(*row + 1)).is_ok());
            assert!(all <= 3 * CHOSEN || both.count() < CHOSEN / 100);
        }
    }

    #[test]
    fn candidates_have_the_chosen_rows() {
        let files = vec![PathBuf::from("monday.csv")];
        let batch = |first: usize, rows: usize| Dataset {
            origins: (first..first + rows).map(|row| RowOrigin { file: 0, line: row + 1, row }).collect(),
            files: files.clone(),
            ..Dataset::default()
        };
        for all in [10, CHOSEN, CHOSEN + 1, 2 * CHOSEN, CANDIDATES + 7, 300_000] {
            let mut batches = (1..=all).step_by(7_000).map(|first| batch(first, 7_000.min(all + 1 - first)));
            let mut candidates = Candidates::of(&batches.next().unwrap(), u64::MAX);
            for batch in batches {
                // Other threads may not know of the present bound yet.
                let bound = candidates.bound().saturating_mul(2);
                candidates.append(Candidates::of(&batch, bound)).unwrap();
                assert!(candidates.rows.rows() <= CANDIDATES);
            }
            let chosen = candidates.chosen(all).expect("all of them are there");
            assert_eq!(chosen.origins, below(&batch(1, all), bound_of(all)).origins);
        }
    }
}
