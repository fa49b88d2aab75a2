//! Channels of instruments whose readings no working one makes, and those that are cut off or stand.

use std::collections::BTreeMap;

use abbe_core::{Contact, DataRow, ObservationSet, Problem, Quantity, SetIndex, Unit};
use abbe_numerics::{Channel, InstrumentFault, instrument_faults};

use crate::copies::least_uncertainties;

/// Fewest rows of a file in which an instrument is told that reads the same.
const SEVERAL: usize = 10;

/// The channels of an instrument: the names of their columns, and the quantity that they read.
pub(crate) fn channels_of(set: &ObservationSet) -> Vec<String> {
    match &set.info().contact {
        Contact::Reading(column) => vec![column.clone()],
        Contact::Readings(columns) => columns.clone(),
        Contact::Pose { .. } | Contact::LinearAxes | Contact::NotSimulated(_) => Vec::new(),
    }
}

/// Rows of a data set by file.
pub(crate) fn by_file(set: &ObservationSet) -> BTreeMap<usize, Vec<DataRow>> {
    let layout = &set.info().layout;
    let mut files: BTreeMap<usize, Vec<DataRow>> = BTreeMap::new();
    for row in set.rows.iter().filter_map(|&row| layout.rows[row].data_row) {
        let rows = files.entry(layout.data.origins[row].file).or_default();
        // A row may have several equations.
        if rows.last() != Some(&row) {
            rows.push(row);
        }
    }
    files
}

/// The faults of the instruments of a problem, file by file: whether each is certain, and a sentence.
fn faults(problem: &Problem) -> Vec<(bool, String)> {
    let uncertainties = least_uncertainties(problem);
    let mut found = Vec::new();
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        let (names, data) = (channels_of(set), &set.info().layout.data);
        let columns: Option<Vec<&[f64]>> = names.iter().map(|name| data.numbers(name)).collect();
        let Some(columns) = columns.filter(|columns| !columns.is_empty()) else { continue };
        let quantity = data.column(&names[0]).map_or(Quantity::Length, |column| column.header.quantity);
        let (unit, factor) = Unit::for_people(Unit { of: quantity, per: None, and_per: None });
        let uncertainty = uncertainties.get(&index).map(|least| least.of(quantity)).filter(|least| least.is_finite());
        let files = by_file(set);
        let is_still = |rows: &[DataRow]| {
            rows.len() >= SEVERAL && columns.iter().all(|column| rows.iter().all(|row| column[*row] == column[rows[0]]))
        };
        let moves = files.values().any(|rows| rows.len() >= SEVERAL && !is_still(rows));
        for (file, rows) in files {
            let readings: Vec<Vec<f64>> =
                columns.iter().map(|column| rows.iter().map(|row| column[*row]).collect()).collect();
            let channels: Vec<Channel<'_>> =
                names.iter().zip(&readings).map(|(name, readings)| Channel { name, readings }).collect();
            let faults = instrument_faults(&channels, uncertainty);
            let file = data.files.get(file).map_or(String::new(), |file| format!(", `{}`", file.display()));
            let words = |fault: &InstrumentFault| {
                format!("{}{file}: {}", set.name, fault.describe(&channels, (factor, unit.as_str())))
            };
            found.extend(faults.iter().map(|fault| (fault.is_certain(), words(fault))));
            // One column alone is told beside those of other instruments.
            if columns.len() > 1 && moves && is_still(&rows) {
                let words = format!(
                    "{}{file}: all {} readings of all channels are the same, and those of other files are not: was the instrument \
                     connected?",
                    set.name,
                    rows.len()
                );
                found.push((true, words));
            }
        }
    }
    found
}

/// Sentences on channels that are cut off at the end of a range, or stand for a while.
pub(crate) fn doubtful_channels(problem: &Problem) -> Vec<String> {
    faults(problem).into_iter().filter(|(is_certain, _)| !is_certain).map(|(_, words)| words).collect()
}

/// Sentences on channels that were not connected, or have the readings of another one: nothing that is estimated from them is right.
/// They are for data that are not exact: without noise a direction in which nothing moves reads the same.
pub fn dead_channels(problem: &Problem) -> Vec<String> {
    faults(problem).into_iter().filter(|(is_certain, _)| *is_certain).map(|(_, words)| words).collect()
}
