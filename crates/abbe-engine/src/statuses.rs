//! Loads, temperatures and the like of the rows that an estimate was made from: beyond them its errors are extrapolated.

use std::collections::BTreeMap;

use abbe_core::{Calibration, Fit, Problem, Quantity, SetIndex, StatusRole};

/// Smallest and largest value by the name of the column.
pub(crate) type Ranges = BTreeMap<String, [f64; 2]>;

/// The ranges of the rows that a problem uses.
pub(crate) fn of_problem(problem: &Problem) -> Ranges {
    let columns = problem.model.info().status.iter().enumerate().filter(|(_, column)| {
        let has_range = matches!(column.role, StatusRole::Load | StatusRole::Temperature | StatusRole::Other);
        has_range && !matches!(column.quantity, Quantity::Label)
    });
    let columns: Vec<(usize, &String)> = columns.map(|(index, column)| (index, &column.name)).collect();
    let mut ranges = Ranges::new();
    if columns.is_empty() {
        return ranges;
    }
    for (_, set) in SetIndex::enumerate(&problem.sets) {
        let layout = &set.observations.info().layout;
        let poses = set.rows.iter().flat_map(|&row| layout.rows[row].pose_indices());
        for status in poses.map(|pose| layout.poses.row(pose)) {
            for (index, name) in &columns {
                let value = status[*index];
                if value.is_finite() {
                    extend(&mut ranges, name, [value; 2]);
                }
            }
        }
    }
    ranges
}

/// Adds the ranges of another estimate that this one rests on.
pub(crate) fn join(ranges: &mut Ranges, other: &Ranges) {
    other.iter().for_each(|(name, range)| extend(ranges, name, *range));
}

/// A calibration that was combined of others, with their ranges.
pub(crate) fn with_those_of(mut combined: Calibration, of: &[&Fit]) -> Calibration {
    of.iter().for_each(|fit| join(&mut combined.fit.statuses, &fit.calibration.fit.statuses));
    combined
}

fn extend(ranges: &mut Ranges, name: &str, [low, high]: [f64; 2]) {
    let known = ranges.entry(name.to_owned()).or_insert([low, high]);
    *known = [known[0].min(low), known[1].max(high)];
}
