//! Rows of a data set that are there twice.

use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};

use abbe_core::{Column, DataRow, Dataset, Quantity, RowOrigin, Values};

/// Rows that are the same in every column as an earlier one, each with that one. Labels that count the rows are not compared: a
/// copy of a row has another one.
pub fn repeated_rows(data: &Dataset, rows: impl IntoIterator<Item = DataRow>) -> Vec<(DataRow, DataRow)> {
    same_in(data, rows, |_| true)
}

/// Number of rows that follow each other, at least so many in turn, as earlier rows of the same content do; with the first of them
/// behind its earlier one. Times and labels of repetitions (`day`, `cycle`) may differ; all labels may with `any_labels`.
pub fn copied_rows(
    data: &Dataset,
    rows: impl IntoIterator<Item = DataRow>,
    in_turn: usize,
    any_labels: bool,
) -> Option<(usize, [DataRow; 2])> {
    let stretches = copied_stretches(data, rows, in_turn, any_labels);
    let &(_, first) = stretches.first()?;
    Some((stretches.iter().map(|(count, _)| count).sum(), first))
}

/// The stretches of such rows: how many each has, and the first of them behind its earlier one.
pub fn copied_stretches(
    data: &Dataset,
    rows: impl IntoIterator<Item = DataRow>,
    in_turn: usize,
    any_labels: bool,
) -> Vec<(usize, [DataRow; 2])> {
    let is_of_the_content = |column: &Column| match &column.values {
        Values::Numbers(_) => column.header.quantity != Quantity::Time,
        Values::Labels(_) => !any_labels && !["day", "cycle"].contains(&column.header.name.as_str()),
    };
    let same = same_in(data, rows, is_of_the_content);
    let follows =
        |pair: &(DataRow, DataRow), next: &(DataRow, DataRow)| next.0.0 == pair.0.0 + 1 && next.1.0 == pair.1.0 + 1;
    let stretches = same.chunk_by(follows).filter(|run| run.len() >= in_turn);
    stretches.map(|run| (run.len(), [run[0].0, run[0].1])).collect()
}

/// Rows in turn that are the same in two files before they are told: chance makes no more of coarse digits.
const PASTED: usize = 4;

/// Rows by which an estimate is judged, and which are among those of a fit in another file, in words.
///
/// ```
/// # use abbe_core::Dataset;
/// fn told(judged: &Dataset, of_fit: &Dataset) -> Option<String> {
///     let [rows, known]: [Vec<_>; 2] = [judged, of_fit].map(|data| data.row_indices().collect());
///     abbe_estimation::pasted_rows([judged, of_fit], [&rows, &known])
/// }
/// ```
pub fn pasted_rows([judged, known]: [&Dataset; 2], [rows, of_known]: [&[DataRow]; 2]) -> Option<String> {
    if judged.files.iter().any(|file| known.files.contains(file)) {
        return None;
    }
    let stretches = stretches_in_both([known, judged], [of_known, rows], PASTED);
    let &(_, [first, other]) = stretches.first()?;
    let place = |data: &Dataset, row: DataRow| {
        let origin = &data.origins[row];
        origin.in_file(&data.files[origin.file])
    };
    Some(format!(
        "{} rows are the same in every column that both have (the first: {} and {})",
        stretches.iter().map(|(count, _)| count).sum::<usize>(),
        place(judged, other),
        place(known, first)
    ))
}

/// Rows of the same content at which a stretch is tried to begin, at most.
const TRIED: usize = 16;

/// Stretches of rows of two data sets, at least so many in turn in both, that are the same in all columns that both have, but for times
/// and labels that count the rows or name the file: how many each has, and the first row of it in either. None where fewer than two
/// columns of numbers are compared.
fn stretches_in_both(
    [one, other]: [&Dataset; 2],
    [rows, other_rows]: [&[DataRow]; 2],
    in_turn: usize,
) -> Vec<(usize, [DataRow; 2])> {
    let is_compared = |column: &&Column| {
        let header = &column.header;
        header.quantity != Quantity::Time && header.name != "file" && !counts_rows(column)
    };
    let pairs = one.columns.iter().filter(is_compared).filter_map(|column| {
        let same = |other: &&Column| other.header.name == column.header.name;
        Some((column, other.columns.iter().filter(is_compared).find(same)?))
    });
    let (compared, with): (Vec<&Column>, Vec<&Column>) = pairs.unzip();
    let numbers = compared.iter().filter(|column| matches!(column.values, Values::Numbers(_))).count();
    if numbers < 2 {
        return Vec::new();
    }
    let mut known: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for (place, row) in rows.iter().enumerate() {
        known.entry(digest(&compared, *row)).or_default().push(place);
    }
    let is_same = |place: usize, other: usize| match (rows.get(place), other_rows.get(other)) {
        (Some(row), Some(other)) => cells(&compared, *row).eq(cells(&with, *other)),
        _ => false,
    };
    let (mut found, mut next) = (Vec::new(), 0);
    while let Some(other) = other_rows.get(next) {
        let places = known.get(&digest(&with, *other)).into_iter().flatten().take(TRIED);
        let lengths = places.map(|&place| ((0..).take_while(|more| is_same(place + more, next + more)).count(), place));
        match lengths.max().filter(|(count, _)| *count >= in_turn) {
            Some((count, place)) => {
                found.push((count, [rows[place], *other]));
                next += count;
            }
            None => next += 1,
        }
    }
    found
}

/// The cells of a row in some columns.
fn cells<'a>(columns: &'a [&'a Column], row: DataRow) -> impl Iterator<Item = Cell<'a>> {
    columns.iter().map(move |column| Cell::of(column, row))
}

/// Rows are kept by a digest, which is small; whether they are the same is seen cell by cell.
fn digest(columns: &[&Column], row: DataRow) -> u64 {
    let mut hasher = DefaultHasher::new();
    cells(columns, row).for_each(|cell| cell.hash(&mut hasher));
    hasher.finish()
}

/// Rows that are the same as an earlier one in these columns, each with the last one of these.
fn same_in(
    data: &Dataset,
    rows: impl IntoIterator<Item = DataRow>,
    is_compared: impl Fn(&Column) -> bool,
) -> Vec<(DataRow, DataRow)> {
    let compared = data.columns.iter().filter(|column| !counts_rows(column) && is_compared(column));
    let compared: Vec<&Column> = compared.collect();
    let same = |one: &DataRow, other: DataRow| cells(&compared, *one).eq(cells(&compared, other));
    let mut seen: BTreeMap<u64, DataRow> = BTreeMap::new();
    let mut repeated = Vec::new();
    for row in rows {
        if let Some(earlier) = seen.insert(digest(&compared, row), row).filter(|earlier| same(earlier, row)) {
            repeated.push((earlier, row));
        }
    }
    repeated
}

/// The repeated rows in words, with the places of the first.
pub fn repeated_in_words(data: &Dataset, rows: impl IntoIterator<Item = DataRow>) -> Option<String> {
    let repeated = repeated_rows(data, rows);
    let &(one, other) = repeated.first()?;
    let rows = if repeated.len() == 1 { "1 row is".to_owned() } else { format!("{} rows are", repeated.len()) };
    let place = |row: DataRow| data.origins[row];
    let file = data.files.get(place(other).file).filter(|_| data.files.len() > 1);
    Some(format!(
        "{rows} in the data twice, the same in every column (the first: {}{})",
        RowOrigin::both_in_words([place(one), place(other)]),
        file.map_or(String::new(), |file| format!(" of `{}`", file.display()))
    ))
}

/// Whether a column of labels counts the rows: a copy has another one.
fn counts_rows(column: &Column) -> bool {
    match &column.values {
        Values::Labels(labels) => labels.iter().collect::<BTreeSet<_>>().len() == labels.len(),
        Values::Numbers(_) => false,
    }
}

/// A cell, to be compared with others.
#[derive(PartialEq, Eq, Hash)]
enum Cell<'a> {
    Number(u64),
    Label(&'a str),
}

impl<'a> Cell<'a> {
    fn of(column: &'a Column, row: DataRow) -> Self {
        match &column.values {
            Values::Numbers(numbers) => Self::Number(numbers[row].to_bits()),
            Values::Labels(labels) => Self::Label(&labels[row]),
        }
    }
}
