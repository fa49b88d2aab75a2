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

/// Rows that are the same as an earlier one in these columns, each with the last one of these.
fn same_in(
    data: &Dataset,
    rows: impl IntoIterator<Item = DataRow>,
    is_compared: impl Fn(&Column) -> bool,
) -> Vec<(DataRow, DataRow)> {
    let compared = data.columns.iter().filter(|column| !counts_rows(column) && is_compared(column));
    let compared: Vec<&Column> = compared.collect();
    let cells = |row: DataRow| compared.iter().map(move |column| Cell::of(column, row));
    let digest = |row: DataRow| {
        let mut hasher = DefaultHasher::new();
        cells(row).for_each(|cell| cell.hash(&mut hasher));
        hasher.finish()
    };
    // Rows are kept by a digest, which is small; whether they are the same is seen cell by cell.
    let mut seen: BTreeMap<u64, DataRow> = BTreeMap::new();
    let mut repeated = Vec::new();
    for row in rows {
        if let Some(earlier) = seen.insert(digest(row), row).filter(|earlier| cells(*earlier).eq(cells(row))) {
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
