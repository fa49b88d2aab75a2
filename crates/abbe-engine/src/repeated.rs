//! What a run would read twice: files with the same content, and rows that only validators read.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{DataRow, Kind, ObservationSet, Problem};
use abbe_estimation::{pasted_rows, repeated, repeated_in_words};

use crate::prediction::Predicted;
use crate::prepare::Prepared;
use crate::record::{FileRecord, files_with_same_content};
use crate::run::Datasets;

impl Prepared {
    /// Files of one content that different stages read, in words.
    pub(crate) fn same_content(&self, inputs: &[FileRecord]) -> Vec<String> {
        let read: Vec<PathBuf> = (self.stages(Kind::Ingest))
            .flat_map(|stage| self.ingests[&stage.name].inputs().into_iter().map(|input| input.path))
            .collect();
        files_with_same_content(&read, inputs)
    }

    /// Rows that are there twice in data that validators read and no estimate, in words. Estimates tell their own.
    pub(crate) fn repeated_evidence(
        &self,
        problems: &BTreeMap<String, Problem>,
        unseen: &Predicted<'_>,
        data: &Datasets,
    ) -> Vec<String> {
        let estimated = |files: &[PathBuf]| {
            problems.values().flat_map(|problem| &problem.sets).any(|set| set.info().layout.data.files == files)
        };
        let mut found: BTreeMap<&str, String> = BTreeMap::new();
        let whole = |name: &&String| !self.is_in_batches(name);
        for name in self.stages(Kind::Validate).flat_map(|stage| stage.reference("from")).filter(whole) {
            let words = repeated_in_words(&data[name], data[name].row_indices());
            if let Some(words) = words.filter(|_| !estimated(&data[name].files)) {
                found.insert(name, format!("{name}: {words}; each counts as a measurement of its own"));
            }
        }
        let mut sentences: Vec<String> = found.into_values().collect();
        for ((stage, _), problem) in unseen {
            for sentence in repeated(problem).iter().map(|sentence| format!("{stage}: {sentence}")) {
                if !sentences.contains(&sentence) {
                    sentences.push(sentence);
                }
            }
        }
        sentences
    }

    /// Rows by which a validator judges an estimate, and which are in the data of that estimate, too, under another name of the file, in
    /// words.
    pub(crate) fn pasted(&self, problems: &BTreeMap<String, Problem>, unseen: &Predicted<'_>) -> Vec<String> {
        let mut sentences = Vec::new();
        for ((stage, estimate), judged) in
            unseen.iter().filter(|((stage, _), _)| !self.validators[*stage].finds_features())
        {
            let Some(seen) = problems.get(*estimate) else { continue };
            let pairs = judged.sets.iter().flat_map(|set| seen.sets.iter().map(move |other| (set, other)));
            let found = pairs.filter_map(|(set, other)| pasted(set, other));
            sentences.extend(found.map(|words| {
                format!("{stage}: `{estimate}` was estimated from rows that it is judged by here: {words}")
            }));
        }
        sentences
    }
}

/// The rows of a set that are those of another one in another file, in words.
fn pasted(set: &ObservationSet, seen: &ObservationSet) -> Option<String> {
    let [judged, known] = [set, seen].map(|set| set.info().layout.data.as_ref());
    let [rows, of_known] = [set, seen].map(|set| -> Vec<DataRow> {
        set.rows.iter().filter_map(|row| set.info().layout.rows[*row].data_row).collect()
    });
    pasted_rows([judged, known], [&rows, &of_known])
}
