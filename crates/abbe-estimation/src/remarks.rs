//! Remarks on a problem that users should know before they trust its results.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{
    Axis, AxisKind, Branch, Contact, LabelText, Owner, ParameterRole, ProbeTerm, Problem, Quantity, RowIndex, SetIndex,
    StatusRole,
};

use crate::aliasing::aliased;
use crate::beside::beside_facets;
use crate::channels::doubtful_channels;
use crate::copies::repeated;
use crate::directions::turned;
use crate::exchanged::exchanged;
use crate::exchanged_channels::exchanged_channels;
use crate::instruments::instruments;
use crate::lost_signs::lost_signs;
use crate::minutes::minutes;
use crate::places::wrong_places;
use crate::planned::planned;
use crate::row_order::contradicted_by_order;
use crate::times::falling;
use crate::turned_readings::turned_readings;

/// Most forgotten unknowns that a remark names.
const NAMED: usize = 3;

/// Sentences on effects of the choice of rows and unknowns: aliasing ([`aliased`]), and zeros of instruments that are not
/// estimated.
pub fn remarks(problem: &Problem) -> Vec<String> {
    let mut remarks = aliased(problem);
    remarks.extend(forgotten(problem));
    remarks.extend(repeated(problem));
    remarks.extend(falling(problem));
    remarks.extend(instruments(problem));
    remarks.extend(doubtful_channels(problem));
    remarks.extend(shared(problem));
    remarks.extend(styli(problem));
    remarks.extend(missed(problem));
    remarks.extend(wrong_places(problem));
    remarks.extend(beside_facets(problem));
    remarks.extend(planned(problem));
    remarks.extend(minutes(problem));
    remarks.extend(tilted_probe(problem));
    remarks.extend(turned(problem));
    remarks.extend(contradicted_by_order(problem));
    remarks
}

/// Those of [`remarks`] that tell of each row by itself: rows that are chosen at random tell them of all.
pub fn remarks_of_chosen_rows(problem: &Problem) -> Vec<String> {
    let mut remarks: Vec<String> = forgotten(problem).into_iter().collect();
    remarks.extend(styli(problem));
    remarks.extend(missed(problem));
    remarks.extend(wrong_places(problem));
    remarks.extend(tilted_probe(problem));
    remarks.extend(turned(problem));
    remarks
}

/// Sentences on readings whose signs, and on columns whose places, the rest of the rows contradicts: other fits of the same rows tell.
/// They come after the fit itself, so that a machine that fails at other values fails there. With its values of the unknowns, the
/// `estimate`, those that residuals give no reason for are not made.
pub fn comparisons(problem: &Problem, estimate: Option<&[f64]>) -> Vec<String> {
    // A turned sign explains much of an exchange, and an exchange of a turned sign: the better one is told.
    let readings =
        [turned_readings(problem), exchanged_channels(problem), lost_signs(problem, estimate)].into_iter().flatten();
    let best = readings.min_by(|one, other| one.squares.total_cmp(&other.squares));
    best.map(|best| best.words).into_iter().chain(exchanged(problem, estimate)).collect()
}

/// Styli in the data that the model does not tell apart.
fn styli(problem: &Problem) -> Vec<String> {
    if problem.model.info().status_index(&StatusRole::Stylus).is_some() {
        return Vec::new();
    }
    let several = problem.sets.iter().filter_map(|set| {
        let layout = &set.info().layout;
        let labels = layout.data.labels("stylus")?;
        let used: BTreeSet<&LabelText> =
            set.rows.iter().filter_map(|&row| Some(&labels[layout.rows[row].data_row?])).collect();
        (used.len() > 1).then(|| {
            format!(
                "{}: the column `stylus` has {} labels, and the model describes one stylus: all rows count as touched with it",
                set.name,
                used.len()
            )
        })
    });
    several.collect()
}

/// Observations that two artefact stages make of the same lines: what misses contact by the same at the start is the same measurement.
fn shared(problem: &Problem) -> Vec<String> {
    let Ok(residuals) = problem.residuals(&problem.start()) else { return Vec::new() };
    let mut rows: BTreeMap<(SetIndex, RowIndex), Vec<u64>> = BTreeMap::new();
    for (row, residual) in problem.equation_rows().into_iter().zip(residuals) {
        rows.entry(row).or_default().push(residual.to_bits());
    }
    let (mut first, mut pairs) = (BTreeMap::new(), BTreeMap::new());
    for ((set, row), residuals) in rows {
        let Some((file, origin)) = problem.origin(set, row) else { continue };
        // Residuals first: they hardly ever agree, and paths take long to compare.
        let other = *first.entry((residuals, origin.row, file)).or_insert(set);
        if other != set {
            *pairs.entry((other, set)).or_insert(0) += 1;
        }
    }
    let sentence = |((one, other), count): ((SetIndex, SetIndex), usize)| {
        let lines = if count == 1 { "1 line".to_owned() } else { format!("{count} lines") };
        let (one, other) = (&problem.sets[one].name, &problem.sets[other].name);
        format!(
            "{one} and {other} use the same {lines} of a file in the same way; each counts as a measurement of its own"
        )
    };
    pairs.into_iter().map(sentence).collect()
}

/// Difference of positions of a tilting axis that is told, rad.
const TILTED: f64 = 0.02;

/// A probe that lobes, and hangs differently in some rows: gravity changes its lobing (Soons 1993, section 3.3.1), which the terms of a
/// probe do not describe.
fn tilted_probe(problem: &Problem) -> Option<String> {
    let info = problem.model.info();
    let is_lobe = |index: usize| matches!(info.parameters[index].role, ParameterRole::Probe { term, .. } if !matches!(term, ProbeTerm::Radius | ProbeTerm::Delay));
    let estimated = problem.machine_unknowns().iter().any(|unknown| is_lobe(unknown.index));
    let known = problem.machine_values.iter().enumerate().any(|(index, value)| *value != 0.0 && is_lobe(index));
    if !estimated && !known {
        return None;
    }
    let tilts = |axis: &&Axis| {
        axis.kind == AxisKind::Rotary && axis.branch == Branch::Tool && axis.direction[2].abs() < 1.0 - 1e-3
    };
    let differs = |axis: &&Axis| {
        let touched = problem.sets.iter().filter(|set| set.info().contact == Contact::LinearAxes);
        let positions = touched.flat_map(|set| set.poses_of(&set.rows).map(|pose| set.poses().row(pose)[axis.status]));
        let (low, high) = positions.fold((f64::MAX, f64::MIN), |(low, high), at| (low.min(at), high.max(at)));
        high - low > TILTED
    };
    let axis = info.axes.iter().filter(tilts).find(differs)?;
    Some(format!(
        "the probe is touched at several positions of {}, which tilts it: gravity changes its lobing with the tilt, and the terms of the \
         probe are the same at all tilts",
        axis.name
    ))
}

/// Median distance from nominal contact that is told, mm: features are where they should be within a millimetre.
const MISSED: f64 = 1.0;

/// The same of a quarter of the rows, mm: a tool of another length shows where it is touched along it.
const MISSED_BY_A_QUARTER: f64 = 2.5;

/// The same of a tenth of the rows, mm: a wrong place or direction of a rotary axis shows only where that is turned.
const MISSED_BY_MANY: f64 = 10.0;

/// How far the nominal machine is from contact at the recorded positions, if that is too far for a good set-up: of a set, or of some
/// of its files.
pub fn missed(problem: &Problem) -> Vec<String> {
    let Ok(residuals) = problem.residuals(&problem.start()) else { return Vec::new() };
    let equations = residuals.iter().zip(problem.quantities()).zip(problem.equation_rows());
    // Where the geometry is singular there is no distance; that is an error of its own.
    let equations = equations.filter(|((residual, _), _)| residual.is_finite());
    let mut of_sets: BTreeMap<SetIndex, Vec<f64>> = BTreeMap::new();
    let mut of_files: BTreeMap<(SetIndex, &Path), Vec<f64>> = BTreeMap::new();
    for ((residual, _), (set, row)) in equations.filter(|((_, quantity), _)| *quantity == Quantity::Length) {
        of_sets.entry(set).or_default().push(*residual);
        let layout = &problem.sets[set].info().layout;
        let origin = layout.rows[row].data_row.map(|row| layout.data.origins[row]);
        if let Some(file) = origin.and_then(|origin| layout.data.files.get(origin.file)) {
            of_files.entry((set, file)).or_default().push(*residual);
        }
    }
    let sentence = |of: String, Missed { median, largest, is_one }: Missed| {
        let cause = match is_one {
            true => {
                "all rows alike, as with another radius of the stylus or of what is touched, or, where all is touched from one side, \
                 another length or place"
            }
            false => "a sign, a unit, a length or a place may be wrong",
        };
        format!(
            "{of}: at the recorded positions the nominal machine is {} mm away from contact (median; {} mm at most): {cause}",
            short(median),
            short(largest)
        )
    };
    let mut remarks = Vec::new();
    for (set, sizes) in of_sets {
        let name = &problem.sets[set].name;
        let is_touched = problem.sets[set].info().contact == Contact::LinearAxes;
        let far = |sizes: Vec<f64>| far(sizes).map(|missed| Missed { is_one: missed.is_one && is_touched, ..missed });
        if let Some(sizes) = far(sizes) {
            remarks.push(sentence(name.clone(), sizes));
            continue;
        }
        let files = of_files.iter().filter(|((own, _), _)| *own == set);
        let files = files.filter_map(|((_, file), sizes)| Some((file.display(), far(sizes.clone())?)));
        remarks.extend(files.map(|(file, sizes)| sentence(format!("{name}, `{file}`"), sizes)));
    }
    remarks
}

/// Tenths of a millimetre, or three digits of what is no distance.
fn short(distance: f64) -> String {
    if distance < 1e6 { format!("{distance:.1}") } else { format!("{distance:.2e}") }
}

/// Distances from contact that are too far, mm.
struct Missed {
    median: f64,
    largest: f64,
    /// Whether all are the same, on the same side.
    is_one: bool,
}

/// Part of their median within which distances from contact are the same, and the fewest that tell.
const ALIKE: f64 = 0.1;
const SEVERAL: usize = 6;

/// How far these distances from contact, mm, positive to one side, are; none if that is not too far.
fn far(distances: Vec<f64>) -> Option<Missed> {
    let mut sizes: Vec<f64> = distances.iter().map(|distance| distance.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let (median, largest) = (*sizes.get(sizes.len() / 2)?, *sizes.last()?);
    let [of_quarter, of_many] = [*sizes.get(sizes.len() * 3 / 4)?, *sizes.get(sizes.len() * 9 / 10)?];
    let is_alike = |distance: &f64| (distance.abs() - median).abs() < ALIKE * median;
    let is_one = distances.len() >= SEVERAL
        && distances.iter().all(|distance| is_alike(distance) && distance.signum() == distances[0].signum());
    let is_far = median > MISSED || of_quarter > MISSED_BY_A_QUARTER || of_many > MISSED_BY_MANY;
    is_far.then_some(Missed { median, largest, is_one })
}

/// Own unknowns of the set-up ([`ParameterRole::SetUp`]) that are neither estimated nor known from an earlier estimate: their
/// values then change the estimated errors of the machine.
fn forgotten(problem: &Problem) -> Option<String> {
    let mut names = Vec::new();
    for (index, set) in SetIndex::enumerate(&problem.sets) {
        let mut settled = vec![false; set.own.len()];
        for unknown in problem.unknowns.iter().chain(&problem.considered.unknowns) {
            if unknown.owner == Owner::Set(index) {
                settled[unknown.index] = true;
            }
        }
        let own = set.info().unknowns.iter().zip(settled);
        let own = own.filter(|(own, settled)| own.role == ParameterRole::SetUp && !settled);
        names.extend(own.map(|(own, _)| format!("{}.{}", set.name, own.name)));
    }
    let more = names.len().saturating_sub(NAMED);
    names.truncate(NAMED);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!names.is_empty()).then(|| {
        format!(
            "{}{rest} count as zero, and what they are goes into the errors of the machine: list them under `parameters`",
            names.join(", ")
        )
    })
}
