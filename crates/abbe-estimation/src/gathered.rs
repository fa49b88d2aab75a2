//! Outliers that are no single gross errors: they gather where one axis stands elsewhere.

use std::collections::BTreeMap;

use abbe_core::{Calibration, ObservationSet, Outlier, Problem, RowIndex, StatusRole};
use abbe_numerics::drawn_by_chance;

/// Probability, of all groups of a set together, below which outliers have not gathered by chance.
const BY_CHANCE: f64 = 1e-3;

/// Fewest outliers that gather.
const SEVERAL: usize = 3;

/// Two commands of an axis are one place if they differ by less, mm or rad.
const SAME: f64 = 1e-3;

/// The rows of a set with an axis away from where it usually stands, and the outliers among them.
struct Away {
    axis: String,
    rows: usize,
    outliers: usize,
}

/// Sentences on sets whose outliers gather in the rows in which one axis is not where it usually is: its column may be wrong, or the
/// machine lacks an error that this axis shows. Robust weights hide such rows, and what they would tell.
pub fn gathered_outliers(problem: &Problem, calibration: &Calibration) -> Vec<String> {
    problem.sets.iter().filter_map(|set| of_set(problem, set, &calibration.outliers)).collect()
}

fn of_set(problem: &Problem, set: &ObservationSet, outliers: &[Outlier]) -> Option<String> {
    let layout = &set.info().layout;
    let own: Vec<&Outlier> = outliers.iter().filter(|outlier| outlier.stage == set.name).collect();
    if own.len() < SEVERAL {
        return None;
    }
    let is_out = |row: &RowIndex| {
        let Some(row) = layout.rows[*row].data_row else { return false };
        let origin = layout.data.origins[row];
        let file = layout.data.files[origin.file].display().to_string();
        own.iter().any(|out| (out.line, out.row) == (origin.line, origin.row) && out.file == file)
    };
    let rows: Vec<(RowIndex, bool)> = set.rows.iter().map(|row| (*row, is_out(row))).collect();
    let all = rows.iter().filter(|(_, is_out)| *is_out).count();
    let groups = away(problem, set, &rows);
    let chance = |group: &Away| drawn_by_chance(rows.len(), group.rows, all, group.outliers);
    let several = groups.iter().filter(|group| group.outliers >= SEVERAL);
    let told = several.min_by(|one, other| chance(one).total_cmp(&chance(other)))?;
    (chance(told) * (groups.len() as f64) < BY_CHANCE).then(|| {
        let Away { axis, rows: count, outliers } = told;
        format!(
            "{outliers} of the {count} rows of {} in which {axis} is not where it usually is are outliers, and {} of the {} others: is \
             the column of {axis} right, or does the machine lack an error of it?",
            set.name,
            all - outliers,
            rows.len() - count
        )
    })
}

/// For each axis that stands in one place in most rows: the others.
fn away(problem: &Problem, set: &ObservationSet, rows: &[(RowIndex, bool)]) -> Vec<Away> {
    let (info, layout) = (problem.model.info(), &set.info().layout);
    let axes = info.status.iter().enumerate().filter_map(|(column, status)| match status.role {
        StatusRole::Command(axis) => Some((column, info.axes[axis].name.clone())),
        _ => None,
    });
    let of_axis = |(column, axis): (usize, String)| {
        let place = |row: RowIndex| {
            let pose = layout.rows[row].pose_indices().next()?;
            Some((layout.poses.row(pose)[column] / SAME).round() as i64)
        };
        let places = rows.iter().filter_map(|(row, is_out)| Some((place(*row)?, *is_out)));
        let places: Vec<(i64, bool)> = places.collect();
        let mut counts: BTreeMap<i64, usize> = BTreeMap::new();
        places.iter().for_each(|(place, _)| *counts.entry(*place).or_default() += 1);
        let (usual, count) = counts.into_iter().max_by_key(|(_, count)| *count)?;
        let others = || places.iter().filter(|(place, _)| *place != usual);
        let outliers = others().filter(|(_, is_out)| *is_out).count();
        (2 * count > places.len()).then(|| Away { axis, rows: others().count(), outliers })
    };
    axes.filter_map(of_axis).filter(|away| away.rows > 0).collect()
}
