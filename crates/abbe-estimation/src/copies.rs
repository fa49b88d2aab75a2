//! Rows that are copies of others, and repetitions without scatter: readings that say less than they seem to.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

use abbe_core::{
    Column, ColumnHeader, Contact, DataRow, Dataset, ObservationSet, Problem, Quantity, RowOrigin, SetIndex, Values,
};

use abbe_numerics::resolution;

use crate::repeated_rows::{copied_rows, copied_stretches, repeated_in_words};

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

/// Logarithm of the probability below which rows in turn agree by chance: that of ten rows with one reading each whose digits have half
/// the size of its standard uncertainty (0.14 to the power of ten), once in some hundred million runs.
const BY_CHANCE: f64 = -19.6;

/// Most rows in turn that are asked for: coarser readings are not told.
const MOST_IN_TURN: usize = 200;

/// Sentences on rows that follow each other as earlier ones do, the same in every number, whatever their labels say: one run, or what was
/// touched at one indexation, in the place of another. Readings of coarse digits agree by chance: it takes more of them. They are for data that
/// are not exact: exact runs repeat to the last digit.
pub fn copied_runs(problem: &Problem) -> Vec<String> {
    let uncertainties = least_uncertainties(problem);
    let sets = SetIndex::enumerate(&problem.sets).filter_map(|(index, set)| Some((set, *uncertainties.get(&index)?)));
    let sets: Vec<(&ObservationSet, Least)> = sets.collect();
    let within: Vec<String> = sets.iter().filter_map(|(set, least)| copied_within(set, *least)).collect();
    // Sets with copies of their own would tell them again.
    if within.is_empty() { copied_across(&sets) } else { within }
}

/// The smallest standard uncertainties of readings, mm and rad; infinite where nothing is read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Least {
    length: f64,
    angle: f64,
}

impl Least {
    /// That of a quantity.
    pub fn of(self, quantity: Quantity) -> f64 {
        if quantity == Quantity::Angle { self.angle } else { self.length }
    }
}

/// The smallest standard uncertainties of the readings of every set.
pub(crate) fn least_uncertainties(problem: &Problem) -> BTreeMap<SetIndex, Least> {
    let mut uncertainties: BTreeMap<SetIndex, Least> = BTreeMap::new();
    let equations = problem.equation_rows().into_iter().zip(problem.standard_uncertainties());
    let equations = equations.zip(problem.quantities()).zip(problem.constraints());
    for ((((set, _), u), quantity), _) in equations.filter(|(_, is_known)| !is_known) {
        let least = uncertainties.entry(set).or_insert(Least { length: f64::INFINITY, angle: f64::INFINITY });
        let own = if quantity == Quantity::Angle { &mut least.angle } else { &mut least.length };
        *own = u.min(*own);
    }
    uncertainties
}

/// Copies within one set.
fn copied_within(set: &ObservationSet, uncertainty: Least) -> Option<String> {
    let data = &set.info().layout.data;
    let (rows, in_turn) = telling_rows(set, uncertainty)?;
    let (count, first) = copied_rows(data, rows, in_turn, true)?;
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
fn copied_across(sets: &[(&ObservationSet, Least)]) -> Vec<String> {
    let mut found = Vec::new();
    for (place, (other, uncertainty)) in sets.iter().enumerate() {
        let Some((rows, in_turn)) = telling_rows(other, *uncertainty) else { continue };
        for (one, own) in &sets[..place] {
            let [first, second] = [one, other].map(|set| &set.info().layout.data);
            if first.files.iter().any(|file| second.files.contains(file)) {
                continue;
            }
            let Some((earlier, also)) = telling_rows(one, *own) else { continue };
            let Some((count, lines)) = copied_between((first, earlier), (second, &rows), in_turn.max(also)) else {
                continue;
            };
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

/// Rows that follow each other in both data sets with the same numbers, as [`copied_rows`]. Copies within one of them are others.
fn copied_between(
    (first, earlier): (&Dataset, Vec<DataRow>),
    (second, rows): (&Dataset, &[DataRow]),
    in_turn: usize,
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
    let found = copied_stretches(&both, earlier.into_iter().chain(later), in_turn, true);
    let across = |(_, [early, late]): &(usize, [DataRow; 2])| early.0 < count && late.0 >= count;
    let across: Vec<(usize, [DataRow; 2])> = found.into_iter().filter(across).collect();
    let &(_, [early, late]) = across.first()?;
    Some((across.iter().map(|(rows, _)| rows).sum(), [early, DataRow(late.0 - count)]))
}

/// The rows of a data set that a set uses.
fn rows_of(set: &ObservationSet) -> BTreeSet<DataRow> {
    set.rows.iter().filter_map(|&row| set.info().layout.rows[row].data_row).collect()
}

/// Those of files with readings that tell copies, and how many in turn it takes: the coarser the digits, the more; none where nothing is
/// read.
fn telling_rows(set: &ObservationSet, uncertainty: Least) -> Option<(Vec<DataRow>, usize)> {
    let data = &set.info().layout.data;
    let columns = read_columns(set)?;
    let is_each_read = !matches!(set.info().contact, Contact::LinearAxes | Contact::NotSimulated(_));
    let mut files: BTreeMap<usize, Vec<DataRow>> = BTreeMap::new();
    rows_of(set).into_iter().for_each(|row| files.entry(data.origins[row].file).or_default().push(row));
    let mut in_turn = IN_TURN;
    files.retain(|_, rows| {
        let agreeing = columns.iter().map(|column| agreement(step(column, rows), uncertainty.of(column.0)));
        // Where axes move until contact, what was measured is in one of their positions.
        let of_a_row = if is_each_read { agreeing.sum::<f64>() } else { agreeing.fold(0.0, f64::min) };
        let needed = if of_a_row < 0.0 { (BY_CHANCE / of_a_row).ceil() } else { f64::INFINITY };
        if needed <= MOST_IN_TURN as f64 {
            in_turn = in_turn.max(needed as usize);
        }
        needed <= MOST_IN_TURN as f64
    });
    let mut rows: Vec<DataRow> = files.into_values().flatten().collect();
    rows.sort_unstable();
    Some((rows, in_turn))
}

/// Step of the digits of readings, over their standard uncertainty, from which on nothing is told: they may repeat although their noise is
/// small.
const COARSE: f64 = 1.0;

/// Logarithm of the probability that two readings of one thing are the same, by the step of their digits: the density of a difference of
/// two normal errors at zero, times the step.
fn agreement(step: f64, uncertainty: f64) -> f64 {
    if uncertainty.is_finite() && step < COARSE * uncertainty {
        (step / (2.0 * PI.sqrt() * uncertainty)).ln()
    } else {
        0.0
    }
}

/// The columns of numbers that are measured.
fn read_columns(set: &ObservationSet) -> Option<Vec<(Quantity, &[f64])>> {
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
    names.into_iter().map(|name| Some((data.column(name)?.header.quantity, data.numbers(name)?))).collect()
}

/// The step of the digits of a column in mm or rad; without digits the smallest difference of two numbers.
pub(crate) fn step((quantity, column): &(Quantity, &[f64]), rows: &[DataRow]) -> f64 {
    // Angles have digits in degrees.
    let unit = if *quantity == Quantity::Angle { PI / 180.0 } else { 1.0 };
    let mut numbers: Vec<f64> =
        rows.iter().map(|&row| column[row] / unit).filter(|number| number.is_finite()).collect();
    numbers.sort_by(f64::total_cmp);
    let steps = numbers.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    let smallest = steps.fold(f64::INFINITY, f64::min);
    // A column that stands tells nothing.
    let step = if smallest.is_finite() { resolution(&numbers).unwrap_or(smallest) } else { smallest };
    unit * step.min(smallest)
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
