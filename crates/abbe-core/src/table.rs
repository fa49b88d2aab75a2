//! Tables that a program holds in memory, as they come: numbers in the unit that the names of their columns say.

use std::fmt;
use std::sync::Arc;

/// Numbers that somebody else holds: they are not copied to be kept.
pub type SharedNumbers = Arc<dyn AsRef<[f64]> + Send + Sync>;

/// Some cells of a column that follow each other.
#[derive(Clone)]
pub enum Cells {
    /// Numbers; NaN is a cell without a number.
    Numbers(SharedNumbers),
    /// Whole numbers.
    Whole(Arc<Vec<i64>>),
    /// Texts; none is an empty cell.
    Texts(Arc<Vec<Option<String>>>),
}

impl Cells {
    /// Number of cells.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(numbers) => (**numbers).as_ref().len(),
            Self::Whole(numbers) => numbers.len(),
            Self::Texts(texts) => texts.len(),
        }
    }

    /// Whether there is no cell.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl fmt::Debug for Cells {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self {
            Self::Numbers(_) => "numbers",
            Self::Whole(_) => "whole numbers",
            Self::Texts(_) => "texts",
        };
        write!(formatter, "{} {kind}", self.len())
    }
}

/// A column of a table: its name, with the unit where it has one, and its cells in parts.
#[derive(Debug, Clone)]
pub struct TableColumn {
    /// As the head of a column in a file: `X_mm`, `feature`.
    pub name: String,
    /// The cells, part by part.
    pub parts: Vec<Cells>,
}

impl TableColumn {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.parts.iter().map(Cells::len).sum()
    }
}

/// A table in the place of the files of an ingest stage.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// The columns, all of the same length.
    pub columns: Vec<TableColumn>,
}

impl Table {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, TableColumn::rows)
    }

    /// The same table without its rows.
    pub fn without_rows(&self) -> Self {
        let column = |column: &TableColumn| TableColumn { name: column.name.clone(), parts: Vec::new() };
        Self { columns: self.columns.iter().map(column).collect() }
    }

    /// What it holds, part by part, for a digest: the same bytes for the same names and cells, however they are divided.
    pub fn each_part(&self, mut take: impl FnMut(&[u8])) {
        let mut counted = |bytes: &[u8]| {
            take(&(bytes.len() as u64).to_le_bytes());
            take(bytes);
        };
        for column in &self.columns {
            counted(column.name.as_bytes());
            for cells in &column.parts {
                match cells {
                    Cells::Numbers(numbers) => {
                        (**numbers).as_ref().iter().for_each(|number| counted(&number.to_le_bytes()));
                    }
                    Cells::Whole(numbers) => numbers.iter().for_each(|number| counted(number.to_string().as_bytes())),
                    Cells::Texts(texts) => {
                        texts.iter().for_each(|text| counted(text.as_deref().unwrap_or_default().as_bytes()));
                    }
                }
            }
        }
    }
}
