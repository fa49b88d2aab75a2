//! Rows of files that an estimate was made from, so that no measurement counts twice.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{DataRecord, DataRow, Error, Kind, Layout, Problem, Result};

use abbe_recipe::Stage;

use crate::batches::InBatches;
use crate::prediction::Predicted;
use crate::prepare::Prepared;
use crate::readings::{self, has_readings};
use crate::run::Datasets;

/// SHA-256 of the files that a recipe reads, by the file as it is named.
pub(crate) type Digests = BTreeMap<String, String>;

/// The rows that a problem uses.
pub(crate) fn of_problem(problem: &Problem, digests: &Digests) -> Vec<DataRecord> {
    rows_of(problem, digests, |layout| &layout.merged)
}

/// The rows that a problem uses, without those that went into others.
fn leading_rows(problem: &Problem, digests: &Digests) -> Vec<DataRecord> {
    rows_of(problem, digests, |_| &[])
}

fn rows_of(problem: &Problem, digests: &Digests, more: impl Fn(&Layout) -> &[DataRow]) -> Vec<DataRecord> {
    let mut all: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for set in &problem.sets {
        let layout = &set.observations.info().layout;
        let data = &layout.data;
        let mut of_files = vec![Vec::new(); data.files.len()];
        let own = set.rows.iter().filter_map(|&row| layout.rows[row].data_row);
        for row in own.chain(more(layout).iter().copied()) {
            let origin = &data.origins[row];
            of_files[origin.file].push(origin.row);
        }
        for (file, rows) in data.files.iter().zip(of_files).filter(|(_, rows)| !rows.is_empty()) {
            all.entry(file.display().to_string()).or_default().extend(rows);
        }
    }
    let sorted = |(file, mut rows): (String, Vec<usize>)| {
        rows.sort_unstable();
        rows.dedup();
        (file, runs(rows))
    };
    of_runs(all.into_iter().map(sorted).collect(), digests)
}

/// Records of the rows of files.
pub(crate) fn of_rows(rows: BTreeMap<String, BTreeSet<usize>>, digests: &Digests) -> Vec<DataRecord> {
    of_runs(rows.into_iter().map(|(file, rows)| (file, runs(rows))).collect(), digests)
}

/// Records of runs of rows of files.
pub(crate) fn of_runs(runs: BTreeMap<String, Vec<[usize; 2]>>, digests: &Digests) -> Vec<DataRecord> {
    let record =
        |(file, rows): (String, Vec<[usize; 2]>)| DataRecord { sha256: digests.get(&file).cloned(), rows, file };
    runs.into_iter().map(record).collect()
}

/// Ascending numbers as runs of successive numbers: first and last of each run.
fn runs(rows: impl IntoIterator<Item = usize>) -> Vec<[usize; 2]> {
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for row in rows {
        match runs.last_mut() {
            Some(last) if last[1] + 1 == row => last[1] = row,
            _ => runs.push([row, row]),
        }
    }
    runs
}

/// Whether two records are of the same file: the content decides (SHA-256), or the name if a hash is not known.
fn same_file(one: &DataRecord, other: &DataRecord) -> bool {
    match (&one.sha256, &other.sha256) {
        (Some(one), Some(other)) => one == other,
        _ => one.file == other.file,
    }
}

fn rows(record: &DataRecord) -> impl Iterator<Item = usize> + '_ {
    record.rows.iter().flat_map(|&[first, last]| first..=last)
}

/// Rows that both lists contain, with the file names of the first list.
pub(crate) fn shared(one: &[DataRecord], other: &[DataRecord]) -> Vec<DataRecord> {
    let mut shared = Vec::new();
    for record in one {
        let theirs: BTreeSet<usize> = other.iter().filter(|it| same_file(record, it)).flat_map(rows).collect();
        let both = runs(rows(record).filter(|row| theirs.contains(row)));
        if !both.is_empty() {
            shared.push(DataRecord { rows: both, ..record.clone() });
        }
    }
    shared
}

/// All rows of both lists.
pub(crate) fn joined(mut one: Vec<DataRecord>, other: &[DataRecord]) -> Vec<DataRecord> {
    for record in other {
        match one.iter_mut().find(|it| same_file(it, record)) {
            Some(known) => known.rows = joined_runs(&known.rows, &record.rows),
            None => one.push(record.clone()),
        }
    }
    one
}

/// The runs of all rows of two lists of runs, however many rows these are.
fn joined_runs(one: &[[usize; 2]], other: &[[usize; 2]]) -> Vec<[usize; 2]> {
    let mut all = [one, other].concat();
    all.sort_unstable();
    let mut joined: Vec<[usize; 2]> = Vec::with_capacity(all.len());
    for [first, last] in all {
        match joined.last_mut() {
            Some(before) if first <= before[1].saturating_add(1) => before[1] = before[1].max(last),
            _ => joined.push([first, last]),
        }
    }
    joined
}

/// Most runs of rows that an error names of a file.
const NAMED: usize = 6;

/// Some rows in words, by file: `table.csv rows 1 to 5, 9`.
fn in_words(rows: &[DataRecord]) -> String {
    let of_file = |record: &DataRecord| {
        let runs = record.rows.iter().take(NAMED).map(|[first, last]| match first == last {
            true => first.to_string(),
            false => format!("{first} to {last}"),
        });
        let more = if record.rows.len() > NAMED { ", ..." } else { "" };
        format!("{} rows {}{more}", record.file, runs.collect::<Vec<_>>().join(", "))
    };
    rows.iter().map(of_file).collect::<Vec<_>>().join("; ")
}

/// The error for rows that would count twice.
pub(crate) fn counted_twice(shared: &[DataRecord], between: &str) -> Error {
    Error::usage(format!("{between}: what they tell would count twice: {}", in_words(shared)))
        .help("estimate all at once, observe other rows, or write `shared_rows: accepted` where that does no harm")
}

impl Prepared {
    /// Rows on which a validator predicts what an estimate has seen there, in words. One that finds features itself asks about readings.
    pub(crate) fn seen_before(
        &self,
        unseen: &Predicted<'_>,
        evidence: &BTreeMap<String, Vec<DataRecord>>,
        digests: &Digests,
    ) -> Vec<String> {
        let predicts = |stage: &str| !self.validators[stage].finds_features();
        let of_pair = |(&(stage, estimate), problem): (&(&str, &str), &Problem)| {
            // What rows went into others is known of all rows of an artefact, and not of those that are judged.
            let seen = shared(&leading_rows(problem, digests), evidence.get(estimate)?);
            (!seen.is_empty()).then(|| {
                format!(
                    "{stage}: `{estimate}` was estimated from rows that it is judged by here; of these nothing is predicted: {}",
                    in_words(&seen)
                )
            })
        };
        unseen.iter().filter(|((stage, _), _)| predicts(stage)).filter_map(of_pair).collect()
    }

    /// Whether other estimates refer to this one.
    fn is_referred_to(&self, estimate: &str) -> bool {
        let refers = |stage: &Stage| {
            ["known", "of"].iter().any(|key| stage.reference(key).iter().any(|other| other == estimate))
        };
        self.stages(Kind::Estimate).any(refers)
    }

    /// The rows that every estimate was made from. Fails if a row would count twice.
    pub(crate) fn evidence(
        &self,
        problems: &BTreeMap<String, Problem>,
        batches: &InBatches<'_>,
        data: &Datasets,
        digests: &Digests,
    ) -> Result<BTreeMap<String, Vec<DataRecord>>> {
        let mut all_rows: BTreeMap<String, Vec<DataRecord>> = BTreeMap::new();
        for stage in self.stages(Kind::Estimate) {
            let name = &stage.name;
            let mut all = match self.saved.get(name) {
                Some(saved) => saved.calibration.data.clone(),
                // They are noted when the rows are read, unless another estimate has to know before.
                None if self.has_passes(stage) && !self.is_referred_to(name) => Vec::new(),
                None if self.has_passes(stage) => batches.rows_read(stage, data, digests)?,
                None if has_readings(stage) => readings::rows(stage, data, digests),
                None => match problems.get(name) {
                    Some(problem) => of_problem(problem, digests),
                    None => batches.rows(name).to_vec(),
                },
            };
            for key in ["known", "of"] {
                for earlier in stage.reference(key) {
                    let theirs = &all_rows[earlier];
                    let shared = shared(&all, theirs);
                    if !shared.is_empty() && !stage.shared_rows {
                        let between = format!("`{name}` rests on rows on which `{earlier}` rests already");
                        return self.located(stage, Err(counted_twice(&shared, &between).setting(key)));
                    }
                    all = joined(all, theirs);
                }
            }
            all_rows.insert(name.clone(), all);
        }
        Ok(all_rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(file: &str, sha256: Option<&str>, rows: &[[usize; 2]]) -> DataRecord {
        DataRecord { file: file.to_owned(), sha256: sha256.map(str::to_owned), rows: rows.to_vec() }
    }

    #[test]
    fn rows_are_the_same_where_the_content_is() {
        let one = [record("a.csv", Some("1"), &[[1, 10], [20, 20]]), record("b.csv", None, &[[1, 2]])];
        let other = [record("copy.csv", Some("1"), &[[8, 12], [20, 30]]), record("b.csv", Some("2"), &[[2, 2]])];
        assert_eq!(
            shared(&one, &other),
            [record("a.csv", Some("1"), &[[8, 10], [20, 20]]), record("b.csv", None, &[[2, 2]])]
        );
        assert_eq!(shared(&one, &[record("a.csv", Some("3"), &[[1, 10]])]), []);
        let all = joined(one.to_vec(), &other);
        assert_eq!(all, [record("a.csv", Some("1"), &[[1, 12], [20, 30]]), record("b.csv", None, &[[1, 2]])]);
    }

    #[test]
    fn the_rows_are_named() {
        let shared = [record("a.csv", None, &[[8, 10], [20, 20]])];
        let error = counted_twice(&shared, "`fit-B` uses rows that `fit-A` used");
        assert!(error.message.ends_with("would count twice: a.csv rows 8 to 10, 20"), "{error}");
    }
}
