//! Outliers and large residuals that are no single gross errors: they gather where one axis stands.

use std::collections::BTreeMap;

use abbe_core::{Axis, AxisKind, Calibration, ObservationSet, Outlier, Problem, RowIndex, SetIndex, StatusRole};
use abbe_numerics::{LeastSquares, drawn_by_chance};

use crate::weighted::Weighted;

/// Probability, of all groups of a set together, below which outliers have not gathered by chance.
const BY_CHANCE: f64 = 1e-3;

/// Fewest outliers that gather.
const SEVERAL: usize = 3;

/// Two commands of an axis are one place if they differ by less, mm or rad.
const SAME: f64 = 1e-3;

/// Part of the rows that a place has if an axis is usually there.
const USUAL: f64 = 0.2;

/// Most places of an axis whose rows are looked at, and the fewest rows of one.
const PLACES: usize = 100;
const ROWS: usize = 5;

/// How many times the median of all residuals is far: of normal ones 4 of 100.
const FAR: f64 = 3.0;

/// Part of the largest singular value from which rows tell unknowns apart.
const TOLD_APART: f64 = 1e-6;

/// Residuals of exact data, in standard uncertainties, whose rounding gathers where axes are.
const EXACT: f64 = 0.05;

/// Part of the rows of a group that are far if something is wrong with it, and of the others if nothing is.
const MOST: f64 = 0.5;
const FEW: f64 = 0.2;

/// Rows of a set with an axis where it is not usually, or at one place, and those among them that are told apart.
#[derive(Clone)]
struct Group {
    axis: String,
    /// The place, mm or degrees; none for all that are not the usual one.
    place: Option<String>,
    rows: usize,
    told: usize,
}

impl Group {
    fn words(&self) -> String {
        let Self { axis, place, .. } = self;
        match place {
            Some(place) => format!("{axis} is at {place}"),
            None => format!("{axis} is not where it usually is"),
        }
    }
}

/// Sentences on sets whose outliers, or else whose large residuals, gather in rows in which one axis is not where it usually is, or at
/// one place: its column may be wrong, or the machine lacks an error that this axis shows. Robust weights hide such rows, and what they
/// would tell. `residuals` are those of the fit, mm or rad; none where they cannot be evaluated.
pub fn gathered_outliers(problem: &Problem, calibration: &Calibration, residuals: &[f64]) -> Vec<String> {
    let sizes = sizes(problem, residuals);
    let told = |held: &[Vec<f64>]| -> Vec<String> {
        let of_set = |(index, set): (SetIndex, &ObservationSet)| {
            let (own, held) = (sizes.get(index.0)?, held.get(index.0).map_or(&[][..], Vec::as_slice));
            of_outliers(problem, set, &calibration.outliers, own, held)
                .or_else(|| of_large_residuals(problem, set, own, held))
        };
        SetIndex::enumerate(&problem.sets).filter_map(of_set).collect()
    };
    let found = told(&[]);
    if found.is_empty() || problem.considered.unknowns.is_empty() {
        return found;
    }
    // Rows are not independent where they see what is held: it may be off, and they gather.
    of_held_values(problem, calibration).map_or(found, |held| told(&held))
}

/// What held values may make of the residual of a row, in standard uncertainties.
fn held_of(held: &[f64], place: usize) -> f64 {
    held.get(place).copied().filter(|held| held.is_finite()).unwrap_or(0.0)
}

fn of_outliers(
    problem: &Problem,
    set: &ObservationSet,
    outliers: &[Outlier],
    sizes: &[f64],
    held: &[f64],
) -> Option<String> {
    let layout = &set.info().layout;
    let own: Vec<&Outlier> = outliers.iter().filter(|outlier| outlier.stage == set.name).collect();
    let is_out = |row: &RowIndex| {
        let Some(row) = layout.rows[*row].data_row else { return false };
        let origin = layout.data.origins[row];
        let file = layout.data.files[origin.file].display().to_string();
        own.iter().any(|out| (out.line, out.row) == (origin.line, origin.row) && out.file == file)
    };
    let is_told = |(place, row): (usize, &RowIndex)| {
        let is_explained = sizes.get(place).is_some_and(|size| *size <= FAR * held_of(held, place));
        (*row, !own.is_empty() && !is_explained && is_out(row))
    };
    let rows: Vec<(RowIndex, bool)> = set.rows.iter().enumerate().map(is_told).collect();
    let (told, all) = gathered(problem, set, &rows, |_| true)?;
    Some(format!(
        "{} of the {} rows of {} in which {} are outliers, and {} of the {} others: is the column of {} right, or does the machine lack an \
         error of it?",
        told.told,
        told.rows,
        set.name,
        told.words(),
        all - told.told,
        rows.len() - told.rows,
        told.axis
    ))
}

/// The largest residual of each row in standard uncertainties, by sets; NaN without a residual.
fn sizes(problem: &Problem, residuals: &[f64]) -> Vec<Vec<f64>> {
    if residuals.is_empty() {
        return Vec::new();
    }
    of_rows(problem, residuals.iter().zip(problem.standard_uncertainties()).map(|(residual, u)| residual / u))
}

/// The largest size of each row, by sets, of numbers in the order of the equations; NaN without one.
fn of_rows(problem: &Problem, mut equations: impl Iterator<Item = f64>) -> Vec<Vec<f64>> {
    let mut of_set = |set: &ObservationSet| {
        let layout = &set.info().layout;
        let of_row = |row: &RowIndex| {
            equations.by_ref().take(layout.rows[*row].equations).map(f64::abs).fold(f64::NAN, f64::max)
        };
        set.rows.iter().map(of_row).collect()
    };
    problem.sets.iter().map(&mut of_set).collect()
}

/// What the uncertainty of all that is considered makes of the residuals of each row, in standard uncertainties, by sets: the unknowns
/// have taken their part of it. None where it cannot be told.
fn of_held_values(problem: &Problem, calibration: &Calibration) -> Option<Vec<Vec<f64>>> {
    let (own, considered) = (problem.unknowns.len(), &problem.considered);
    let mut extended = problem.with_values(&problem.values_of(calibration));
    extended.unknowns.extend(considered.unknowns.iter().cloned());
    let (weighted, at) = (Weighted::new(&extended).ok()?, extended.start());
    let together = weighted.factor(&at, None).ok()?;
    // Unknowns that no row tells apart share what rows see of them.
    let spectrum = together.without_unknowns(|unknown| unknown >= own).spectrum();
    let root = spectrum.covariance_root(spectrum.singular_values().rank(TOLD_APART));
    let follow = root.sensitivities(&together);
    let mut sizes = vec![0.0; weighted.rows()];
    let left_of = |line: &[f64]| -> f64 {
        let left: Vec<f64> = (0..considered.unknowns.len())
            .map(|held| line[own + held] + line.iter().zip(&follow).map(|(by, step)| by * step[held]).sum::<f64>())
            .collect();
        let of_line = |covariance: &Vec<f64>| left.iter().zip(covariance).map(|(by, with)| by * with).sum::<f64>();
        left.iter().zip(&considered.covariance).map(|(by, covariance)| by * of_line(covariance)).sum()
    };
    let taken = weighted.linearise(&at, &mut |first, residuals, derivatives| {
        let lines = derivatives.chunks_exact(own + considered.unknowns.len());
        for (size, line) in sizes[first..first + residuals.len()].iter_mut().zip(lines) {
            *size = left_of(line).max(0.0).sqrt();
        }
    });
    taken.ok()?;
    Some(of_rows(problem, sizes.into_iter()))
}

/// `held` is what values that are held may make of the residuals of each row, in standard uncertainties; none where they make nothing.
fn of_large_residuals(problem: &Problem, set: &ObservationSet, sizes: &[f64], held: &[f64]) -> Option<String> {
    let mut sorted: Vec<f64> = sizes.iter().copied().filter(|size| size.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() / 2).copied().filter(|usual| *usual > EXACT)?;
    let is_far = |(place, size): (usize, &f64)| *size > FAR * usual.hypot(held_of(held, place));
    let rows: Vec<(RowIndex, bool)> = set.rows.iter().copied().zip(sizes.iter().enumerate().map(is_far)).collect();
    let all = rows.iter().filter(|(_, is_far)| *is_far).count();
    let is_wrong = |group: &Group| {
        let others = rows.len() - group.rows;
        group.told as f64 > MOST * group.rows as f64 && ((all - group.told) as f64) < FEW * others as f64
    };
    let (told, _) = gathered(problem, set, &rows, is_wrong)?;
    Some(format!(
        "the residuals of {} of the {} rows of {} in which {} are more than {FAR} times the usual ones, and of {} of the {} others: is the \
         column of {} right, or does the machine lack an error of it?",
        told.told,
        told.rows,
        set.name,
        told.words(),
        all - told.told,
        rows.len() - told.rows,
        told.axis
    ))
}

/// The group in which rows that are told apart have gathered most, if not by chance, and how many of these there are.
fn gathered(
    problem: &Problem,
    set: &ObservationSet,
    rows: &[(RowIndex, bool)],
    is_wrong: impl Fn(&Group) -> bool,
) -> Option<(Group, usize)> {
    let all = rows.iter().filter(|(_, is_told)| *is_told).count();
    if all < SEVERAL {
        return None;
    }
    let groups = groups(problem, set, rows);
    // There are many more places than axes.
    let places = groups.iter().filter(|group| group.place.is_some()).count();
    let tried = [groups.len() - places, places];
    let chance = |group: &Group| {
        let alone = drawn_by_chance(rows.len(), group.rows, all, group.told);
        alone * tried[usize::from(group.place.is_some())] as f64
    };
    let several = groups.iter().filter(|group| group.told >= SEVERAL && is_wrong(group));
    let told = several.min_by(|one, other| chance(one).total_cmp(&chance(other)))?;
    (chance(told) < BY_CHANCE).then(|| (told.clone(), all))
}

/// For each axis the rows that are not where it usually is, and those of each place if there are not many.
fn groups(problem: &Problem, set: &ObservationSet, rows: &[(RowIndex, bool)]) -> Vec<Group> {
    let (info, layout) = (problem.model.info(), &set.info().layout);
    let axes = info.status.iter().enumerate().filter_map(|(column, status)| match status.role {
        StatusRole::Command(axis) => Some((column, &info.axes[axis])),
        _ => None,
    });
    let of_axis = |(column, axis): (usize, &Axis)| {
        let place = |row: RowIndex| {
            let pose = layout.rows[row].pose_indices().next()?;
            Some((layout.poses.row(pose)[column] / SAME).round() as i64)
        };
        // Rows of each place, and those among them that are told apart.
        let mut counts: BTreeMap<i64, [usize; 2]> = BTreeMap::new();
        for (row, is_told) in rows {
            if let Some(place) = place(*row) {
                let [rows, told] = counts.entry(place).or_default();
                *rows += 1;
                *told += usize::from(*is_told);
            }
        }
        let all: usize = counts.values().map(|own| own[0]).sum();
        let is_usual = |own: &[usize; 2]| own[0] as f64 >= USUAL * all as f64;
        let sum = |of: usize| counts.values().filter(|own| !is_usual(own)).map(|own| own[of]).sum::<usize>();
        let [rows, told] = [0, 1].map(sum);
        let away = (2 * rows < all).then(|| Group { axis: axis.name.clone(), place: None, rows, told });
        let places = counts.iter().filter(|(_, own)| counts.len() <= PLACES && own[0] >= ROWS && own[0] < all);
        let at = places.map(|(place, [rows, told])| Group {
            axis: axis.name.clone(),
            place: Some(match axis.kind {
                AxisKind::Linear => format!("{} mm", *place as f64 * SAME),
                AxisKind::Rotary => format!("{:.1} deg", (*place as f64 * SAME).to_degrees()),
            }),
            rows: *rows,
            told: *told,
        });
        away.into_iter().chain(at).filter(|group| group.rows > 0).collect::<Vec<_>>()
    };
    axes.flat_map(of_axis).collect()
}
