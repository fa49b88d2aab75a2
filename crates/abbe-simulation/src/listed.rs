//! Gross errors that a truth file lists.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{DataRow, ObservationSet, Problem};

/// The listed gross errors, and how the list names a row.
pub struct Listed<'a> {
    distances: &'a BTreeMap<String, f64>,
    by_touch: bool,
    names: BTreeSet<String>,
}

impl<'a> Listed<'a> {
    /// The list, with the names of the rows of a problem.
    pub fn new(distances: &'a BTreeMap<String, f64>, problem: &Problem) -> Self {
        let by_touch = problem.sets.iter().any(|set| set.info().layout.data.labels("touch").is_some());
        let mut names = BTreeSet::new();
        if !distances.is_empty() {
            for set in &problem.sets {
                let rows = set.info().layout.rows.iter().filter_map(|row| row.data_row);
                names.extend(rows.filter_map(|row| name(set, row, by_touch)));
            }
        }
        Self { distances, by_touch, names }
    }

    /// The gross error of a row, mm.
    pub fn of(&self, set: &ObservationSet, data_row: DataRow) -> f64 {
        if self.distances.is_empty() {
            return 0.0;
        }
        name(set, data_row, self.by_touch).and_then(|name| self.distances.get(&name)).copied().unwrap_or(0.0)
    }

    /// Warns of names that are no row.
    pub fn warn(&self) {
        for missing in self.distances.keys().filter(|name| !self.names.contains(*name)) {
            tracing::warn!("noise: `outliers` names {missing}, which is no row that an artefact takes");
        }
    }
}

/// Name of a row in the list of outliers.
fn name(set: &ObservationSet, data_row: DataRow, by_touch: bool) -> Option<String> {
    let data = &set.info().layout.data;
    match by_touch {
        true => Some(data.labels("touch")?[data_row].to_string()),
        false => Some(data.origins[data_row].row.to_string()),
    }
}
