//! Tables that come by columns: of files that hold columns and not text, and of programs.

use std::borrow::Cow;
use std::fmt;

/// A column as it is named: its name, and its unit if one is stated beside the name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    /// The name, with its unit or without: `X_mm`, `feature`.
    pub name: String,
    /// The unit that stands beside it: the symbol of a suffix (`mm`, `um/m`) or of a unit that people write in (`in`).
    pub unit: Option<String>,
}

/// What a cell holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell<'a> {
    /// Nothing: an empty cell of a table in CSV.
    Missing,
    /// A number, in the unit that its column says.
    Number(f64),
    /// A whole number.
    Whole(i128),
    /// A text.
    Text(Cow<'a, str>),
}

/// The cells of a column, in some rows that follow each other. Whoever holds them gives them as they are: nothing is copied.
pub trait ColumnCells {
    /// The cell of a row, from 0.
    fn cell(&self, row: usize) -> Cell<'_>;
}

impl ColumnCells for Vec<Cell<'static>> {
    fn cell(&self, row: usize) -> Cell<'_> {
        match &self[row] {
            Cell::Text(text) => Cell::Text(Cow::Borrowed(text)),
            other => other.clone(),
        }
    }
}

impl ColumnCells for Vec<f64> {
    fn cell(&self, row: usize) -> Cell<'_> {
        Cell::Number(self[row])
    }
}

impl ColumnCells for Vec<i64> {
    fn cell(&self, row: usize) -> Cell<'_> {
        Cell::Whole(self[row].into())
    }
}

/// Cells that several threads read.
pub type SharedCells = Box<dyn ColumnCells + Send + Sync>;

/// Rows that follow each other.
pub struct RowsOfTable {
    /// Their number.
    pub rows: usize,
    /// Their cells, by the columns of the table.
    pub cells: Vec<SharedCells>,
}

impl fmt::Debug for RowsOfTable {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} rows x {} columns", self.rows, self.cells.len())
    }
}

/// A table that a program holds in memory, in the place of the files of an ingest stage.
#[derive(Debug, Default)]
pub struct Table {
    /// The columns.
    pub fields: Vec<Field>,
    /// The rows, part by part.
    pub parts: Vec<RowsOfTable>,
}

impl Table {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.parts.iter().map(|part| part.rows).sum()
    }

    /// What it holds, for a digest: the same bytes for the same names, units and cells, however the rows are divided.
    pub fn each_byte(&self, mut take: impl FnMut(&[u8])) {
        for (column, field) in self.fields.iter().enumerate() {
            for text in [Some(&field.name), field.unit.as_ref()] {
                text_bytes(text.map_or("", String::as_str), &mut take);
            }
            for part in &self.parts {
                (0..part.rows).for_each(|row| cell_bytes(&part.cells[column].cell(row), &mut take));
            }
        }
    }
}

/// The bytes of a cell begin with its kind, so that no two cells have the same.
fn cell_bytes(cell: &Cell<'_>, take: &mut impl FnMut(&[u8])) {
    match cell {
        Cell::Missing => take(&[0]),
        Cell::Number(number) => {
            let mut bytes = [1; 9];
            bytes[1..].copy_from_slice(&number.to_le_bytes());
            take(&bytes);
        }
        Cell::Whole(number) => {
            let mut bytes = [2; 17];
            bytes[1..].copy_from_slice(&number.to_le_bytes());
            take(&bytes);
        }
        Cell::Text(text) => {
            take(&[3]);
            text_bytes(text, take);
        }
    }
}

fn text_bytes(text: &str, take: &mut impl FnMut(&[u8])) {
    take(&(text.len() as u64).to_le_bytes());
    take(text.as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(names: &[&str], parts: Vec<Vec<Vec<Cell<'static>>>>) -> Vec<u8> {
        let fields = names.iter().map(|name| Field { name: (*name).to_owned(), unit: None }).collect();
        let part = |columns: Vec<Vec<Cell<'static>>>| RowsOfTable {
            rows: columns.first().map_or(0, Vec::len),
            cells: columns.into_iter().map(|column| Box::new(column) as SharedCells).collect(),
        };
        let mut found = Vec::new();
        let table = Table { fields, parts: parts.into_iter().map(part).collect() };
        table.each_byte(|bytes| found.extend_from_slice(bytes));
        found
    }

    #[test]
    fn bytes_tell_tables_apart_and_not_how_they_are_divided() {
        let text = |text: &'static str| Cell::Text(text.into());
        let (one, two) = (vec![Cell::Number(1.0), Cell::Missing], vec![text("a"), Cell::Whole(3)]);
        let whole = bytes(&["x", "y"], vec![vec![one.clone(), two.clone()]]);
        let row = |row: usize| vec![vec![one[row].clone()], vec![two[row].clone()]];
        assert_eq!(whole, bytes(&["x", "y"], vec![row(0), row(1)]));
        for other in [
            bytes(&["x", "z"], vec![vec![one.clone(), two.clone()]]),
            bytes(&["x", "y"], vec![vec![two.clone(), one.clone()]]),
            bytes(&["x", "y"], vec![vec![one.clone(), vec![text("a3"), Cell::Missing]]]),
            bytes(&["x", "y"], vec![vec![vec![Cell::Number(1.0), text("")], two]]),
        ] {
            assert_ne!(other, whole);
        }
    }
}
