//! Remarks on a problem that users should know before they trust its results.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{
    Axis, AxisKind, Branch, Contact, DataRow, ObservationSet, Owner, ParameterRole, ProbeTerm, Problem, Quantity,
    RowIndex, SetIndex, StatusRole,
};

use crate::aliasing::aliased;
use crate::directions::turned;
use crate::instruments::instruments;

/// Most forgotten unknowns that a remark names.
const NAMED: usize = 3;

/// Sentences on effects of the choice of rows and unknowns: aliasing ([`aliased`]), and zeros of instruments that are not
/// estimated.
pub fn remarks(problem: &Problem) -> Vec<String> {
    let mut remarks = aliased(problem);
    remarks.extend(forgotten(problem));
    remarks.extend(repeated(problem));
    remarks.extend(reversed(problem));
    remarks.extend(instruments(problem));
    remarks.extend(shared(problem));
    remarks.extend(styli(problem));
    remarks.extend(missed(problem));
    remarks.extend(tilted_probe(problem));
    remarks.extend(turned(problem));
    remarks
}

/// Rows of a data set that are the same in every cell, but for a label that counts them: a file that was read twice, or a row that was
/// copied.
pub fn repeated(problem: &Problem) -> Vec<String> {
    let mut remarks = Vec::new();
    for set in &problem.sets {
        let data = &set.info().layout.data;
        let rows: BTreeSet<DataRow> = set.rows.iter().filter_map(|&row| set.info().layout.rows[row].data_row).collect();
        let repeated = data.repeated_in_words(rows);
        remarks.extend(repeated.map(|words| format!("{}: {words}; each counts as a measurement of its own", set.name)));
    }
    remarks
}

/// Sentences on readings that say less than they seem to: rows that are copies of others, and repetitions without scatter. They are
/// for what was measured: rows of a plan are no readings.
pub fn copies(problem: &Problem) -> Vec<String> {
    [copied(problem), unscattered(problem)].concat()
}

/// Most rows in turn that may be those of earlier ones by chance.
const IN_TURN: usize = 10;

/// Rows of a data set that follow each other as earlier ones do, the same in every cell but for times and labels of repetitions. No
/// machine repeats to the last digit so often.
fn copied(problem: &Problem) -> Vec<String> {
    let of_set = |set: &ObservationSet| {
        let data = &set.info().layout.data;
        let rows: BTreeSet<DataRow> = set.rows.iter().filter_map(|&row| set.info().layout.rows[row].data_row).collect();
        let (count, first) = data.copied_rows(rows, IN_TURN, false)?;
        let lines = first.map(|row| data.origins[row].line);
        Some(format!(
            "{}: {count} rows are those of earlier ones to the last digit, but for times and labels (the first: lines {} and {}): are \
             they copies? Each counts as a measurement of its own",
            set.name, lines[0], lines[1]
        ))
    };
    problem.sets.iter().filter_map(of_set).collect()
}

/// Largest step of the digits of readings, over their standard uncertainty, with which they are told apart: then ten in turn agree by chance
/// once in some hundred million runs (0.14 to the power of ten).
const FINE: f64 = 0.5;

/// Sentences on rows that follow each other as earlier ones do, the same in every number, whatever their labels say: one run, or what was
/// touched at one indexation, in the place of another. Readings of coarse digits agree by chance and are not told. They are for data that
/// are not exact: exact runs repeat to the last digit.
pub fn copied_runs(problem: &Problem) -> Vec<String> {
    let mut uncertainties: BTreeMap<SetIndex, f64> = BTreeMap::new();
    let equations =
        problem.equation_rows().into_iter().zip(problem.standard_uncertainties()).zip(problem.constraints());
    for (((set, _), u), _) in equations.filter(|(_, is_known)| !is_known) {
        let least = uncertainties.entry(set).or_insert(u);
        *least = u.min(*least);
    }
    let of_set = |(index, set): (SetIndex, &ObservationSet)| {
        let data = &set.info().layout.data;
        let rows: BTreeSet<DataRow> = set.rows.iter().filter_map(|&row| set.info().layout.rows[row].data_row).collect();
        let uncertainty = *uncertainties.get(&index)?;
        let columns = read_columns(set)?;
        let mut files: BTreeMap<usize, Vec<DataRow>> = BTreeMap::new();
        rows.iter().for_each(|&row| files.entry(data.origins[row].file).or_default().push(row));
        files.retain(|_, rows| columns.iter().any(|column| step(column, rows) < FINE * uncertainty));
        let fine: BTreeSet<DataRow> = files.into_values().flatten().collect();
        let (count, first) = data.copied_rows(fine, IN_TURN, true)?;
        // Told already.
        if data.copied_rows(rows.iter().copied(), IN_TURN, false).is_some() {
            return None;
        }
        let lines = first.map(|row| data.origins[row].line);
        let file = data.files.get(data.origins[first[1]].file).filter(|_| data.files.len() > 1);
        Some(format!(
            "{}: {count} rows have the numbers of earlier ones to the last digit under other labels (the first: lines {} and {}{}): are \
                 they copies? Each counts as a measurement of its own",
            set.name,
            lines[0],
            lines[1],
            file.map_or(String::new(), |file| format!(" of `{}`", file.display()))
        ))
    };
    SetIndex::enumerate(&problem.sets).filter_map(of_set).collect()
}

/// The columns of numbers that are measured.
fn read_columns(set: &ObservationSet) -> Option<Vec<&[f64]>> {
    let info = set.info();
    let data = &info.layout.data;
    let names: Vec<&str> = match &info.contact {
        Contact::Reading(column) => vec![column],
        Contact::Readings(columns) => columns.iter().map(String::as_str).collect(),
        Contact::Pose { position, .. } => position.iter().map(String::as_str).collect(),
        // Linear axes move until contact.
        Contact::LinearAxes | Contact::NotSimulated(_) => data
            .columns
            .iter()
            .filter(|column| column.header.quantity == Quantity::Length)
            .map(|column| column.header.name.as_str())
            .collect(),
    };
    names.into_iter().map(|name| data.numbers(name)).collect()
}

/// The smallest difference of two numbers of a column: the step of its digits.
fn step(column: &[f64], rows: &[DataRow]) -> f64 {
    let mut numbers: Vec<f64> = rows.iter().map(|&row| column[row]).filter(|number| number.is_finite()).collect();
    numbers.sort_by(f64::total_cmp);
    numbers.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min)
}

/// Scatter of repetitions, mm or rad, below which there is none.
const NO_SCATTER: f64 = 1e-9;

/// Repetitions without scatter, of which an uncertainty is made.
fn unscattered(problem: &Problem) -> Vec<String> {
    let is_still = |set: &&ObservationSet| {
        let pooled = set.uncertainty.pooled.as_ref();
        pooled.is_some_and(|pooled| pooled.deviations.iter().flatten().all(|off| off.abs() < NO_SCATTER))
    };
    let sentence = |set: &ObservationSet| {
        format!(
            "{}: the repetitions are the same to the last digit, so that their scatter tells no uncertainty: are they copies? State \
             `standard_uncertainty_um` instead of `pooled`",
            set.name
        )
    };
    problem.sets.iter().filter(is_still).map(sentence).collect()
}

/// Times that fall in every row.
fn reversed(problem: &Problem) -> Vec<String> {
    let falls = |set: &&ObservationSet| {
        let rows = || set.rows.iter().filter_map(|&row| set.info().layout.rows[row].data_row);
        let times = set.info().layout.data.numbers("time");
        let times: Vec<f64> = times.map_or(Vec::new(), |times| rows().map(|row| times[row]).collect());
        // A row may have several equations.
        times.first() > times.last() && times.windows(2).all(|pair| pair[1] <= pair[0])
    };
    let sentence = |set: &ObservationSet| {
        format!("{}: the time falls from row to row: its sign, or the order of the rows, may be wrong", set.name)
    };
    problem.sets.iter().filter(falls).map(sentence).collect()
}

/// Styli in the data that the model does not tell apart.
fn styli(problem: &Problem) -> Vec<String> {
    if problem.model.info().status_index(&StatusRole::Stylus).is_some() {
        return Vec::new();
    }
    let several = problem.sets.iter().filter_map(|set| {
        let layout = &set.info().layout;
        let labels = layout.data.labels("stylus")?;
        let used: BTreeSet<&String> =
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
        let other = *first.entry((file, origin.line, residuals)).or_insert(set);
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

/// How far the nominal machine is from contact at the recorded positions, if that is too far for a good set-up: of a set, or of some
/// of its files.
fn missed(problem: &Problem) -> Vec<String> {
    let Ok(residuals) = problem.residuals(&problem.start()) else { return Vec::new() };
    let equations = residuals.iter().zip(problem.quantities()).zip(problem.equation_rows());
    let mut of_sets: BTreeMap<SetIndex, Vec<f64>> = BTreeMap::new();
    let mut of_files: BTreeMap<(SetIndex, &Path), Vec<f64>> = BTreeMap::new();
    for ((residual, _), (set, row)) in equations.filter(|((_, quantity), _)| *quantity == Quantity::Length) {
        of_sets.entry(set).or_default().push(residual.abs());
        let layout = &problem.sets[set].info().layout;
        let origin = layout.rows[row].data_row.map(|row| layout.data.origins[row]);
        if let Some(file) = origin.and_then(|origin| layout.data.files.get(origin.file)) {
            of_files.entry((set, file)).or_default().push(residual.abs());
        }
    }
    let sentence = |of: String, (median, largest): (f64, f64)| {
        format!(
            "{of}: at the recorded positions the nominal machine is {median:.1} mm away from contact (median; {largest:.1} mm at most): a \
             sign, a unit, a length or a place may be wrong"
        )
    };
    let mut remarks = Vec::new();
    for (set, sizes) in of_sets {
        let name = &problem.sets[set].name;
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

/// Median and largest of distances from contact, if they are too far.
fn far(mut sizes: Vec<f64>) -> Option<(f64, f64)> {
    sizes.sort_by(f64::total_cmp);
    let (median, largest) = (*sizes.get(sizes.len() / 2)?, *sizes.last()?);
    (median > MISSED).then_some((median, largest))
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
