//! Rows that are copies of others, and repetitions without scatter: readings that say less than they seem to.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{
    Column, ColumnHeader, Contact, DataRow, Dataset, ObservationSet, Problem, Quantity, RowOrigin, SetIndex, Values,
};

use crate::repeated_rows::{copied_rows, repeated_in_words};

/// Rows of a data set that are the same in every cell, but for a label that counts them: a file that was read twice, or a row that was
/// copied.
pub fn repeated(problem: &Problem) -> Vec<String> {
    let mut remarks = Vec::new();
    for set in &problem.sets {
        let data = &set.info().layout.data;
        let repeated = repeated_in_words(data, rows_of(set));
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
        let (count, first) = copied_rows(data, rows_of(set), IN_TURN, false)?;
        let places = RowOrigin::both_in_words(first.map(|row| data.origins[row]));
        Some(format!(
            "{}: {count} rows are those of earlier ones to the last digit, but for times and labels (the first: {places}): are \
             they copies? Each counts as a measurement of its own",
            set.name
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
    let uncertainties = least_uncertainties(problem);
    let sets = SetIndex::enumerate(&problem.sets).filter_map(|(index, set)| Some((set, *uncertainties.get(&index)?)));
    let sets: Vec<(&ObservationSet, f64)> = sets.collect();
    let within: Vec<String> = sets.iter().filter_map(|(set, uncertainty)| copied_within(set, *uncertainty)).collect();
    // Sets with copies of their own would tell them again.
    if within.is_empty() { copied_across(&sets) } else { within }
}

/// The smallest standard uncertainty of the readings of every set.
pub(crate) fn least_uncertainties(problem: &Problem) -> BTreeMap<SetIndex, f64> {
    let mut uncertainties: BTreeMap<SetIndex, f64> = BTreeMap::new();
    let equations =
        problem.equation_rows().into_iter().zip(problem.standard_uncertainties()).zip(problem.constraints());
    for (((set, _), u), _) in equations.filter(|(_, is_known)| !is_known) {
        let least = uncertainties.entry(set).or_insert(u);
        *least = u.min(*least);
    }
    uncertainties
}

/// Copies within one set.
fn copied_within(set: &ObservationSet, uncertainty: f64) -> Option<String> {
    let data = &set.info().layout.data;
    let (count, first) = copied_rows(data, fine_rows(set, uncertainty)?, IN_TURN, true)?;
    // Told already.
    if copied_rows(data, rows_of(set), IN_TURN, false).is_some() {
        return None;
    }
    let places = RowOrigin::both_in_words(first.map(|row| data.origins[row]));
    let file = data.files.get(data.origins[first[1]].file).filter(|_| data.files.len() > 1);
    Some(format!(
        "{}: {count} rows have the numbers of earlier ones to the last digit under other labels (the first: {places}{}): are \
         they copies? Each counts as a measurement of its own",
        set.name,
        file.map_or(String::new(), |file| format!(" of `{}`", file.display()))
    ))
}

/// Copies of rows of one set in another that reads other files with the same columns of numbers.
fn copied_across(sets: &[(&ObservationSet, f64)]) -> Vec<String> {
    let mut found = Vec::new();
    for (place, (other, uncertainty)) in sets.iter().enumerate() {
        let Some(rows) = fine_rows(other, *uncertainty) else { continue };
        for (one, own) in &sets[..place] {
            let [first, second] = [one, other].map(|set| &set.info().layout.data);
            if first.files.iter().any(|file| second.files.contains(file)) {
                continue;
            }
            let Some(earlier) = fine_rows(one, *own) else { continue };
            let Some((count, lines)) = copied_between((first, earlier), (second, &rows)) else { continue };
            found.push(format!(
                "{} and {}: {count} rows have the same numbers to the last digit (the first: {} of `{}` and {} of `{}`): are \
                 they copies? Each counts as a measurement of its own",
                one.name,
                other.name,
                first.origins[lines[0]].in_words(),
                file_of(first, lines[0]),
                second.origins[lines[1]].in_words(),
                file_of(second, lines[1])
            ));
        }
    }
    found
}

fn file_of(data: &Dataset, row: DataRow) -> String {
    data.files.get(data.origins[row].file).map_or(String::new(), |file| file.display().to_string())
}

/// Rows that follow each other in both data sets with the same numbers, as [`copied_rows`].
fn copied_between(
    (first, earlier): (&Dataset, Vec<DataRow>),
    (second, rows): (&Dataset, &[DataRow]),
) -> Option<(usize, [DataRow; 2])> {
    let numbers = |data: &Dataset| {
        let columns = data.columns.iter().filter(|column| column.header.quantity != Quantity::Time);
        columns
            .filter_map(|column| match &column.values {
                Values::Numbers(numbers) => Some((column.header.name.clone(), numbers.clone())),
                Values::Labels(_) => None,
            })
            .collect::<BTreeMap<_, _>>()
    };
    let (mut one, other) = (numbers(first), numbers(second));
    if !one.keys().eq(other.keys()) {
        return None;
    }
    let count = first.rows();
    one.values_mut().zip(other.into_values()).for_each(|(one, other)| one.extend(other));
    let column = |(name, numbers): (String, Vec<f64>)| Column {
        header: ColumnHeader::parse(&name),
        values: Values::Numbers(numbers),
    };
    let origins = first.origins.iter().chain(&second.origins).copied().collect();
    let both = Dataset { columns: one.into_iter().map(column).collect(), origins, ..Dataset::default() };
    let later = rows.iter().map(|row| DataRow(row.0 + count));
    let (found, [early, late]) = copied_rows(&both, earlier.into_iter().chain(later), IN_TURN, true)?;
    Some((found, [early, DataRow(late.0 - count)]))
}

/// The rows of a data set that a set uses.
fn rows_of(set: &ObservationSet) -> BTreeSet<DataRow> {
    set.rows.iter().filter_map(|&row| set.info().layout.rows[row].data_row).collect()
}

/// Those whose file has readings with digits that are fine enough to tell copies; none where nothing is read.
fn fine_rows(set: &ObservationSet, uncertainty: f64) -> Option<Vec<DataRow>> {
    let data = &set.info().layout.data;
    let columns = read_columns(set)?;
    let mut files: BTreeMap<usize, Vec<DataRow>> = BTreeMap::new();
    rows_of(set).into_iter().for_each(|row| files.entry(data.origins[row].file).or_default().push(row));
    files.retain(|_, rows| columns.iter().any(|column| step(column, rows) < FINE * uncertainty));
    let mut rows: Vec<DataRow> = files.into_values().flatten().collect();
    rows.sort_unstable();
    Some(rows)
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
