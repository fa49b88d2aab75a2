//! Data sets: named columns, one row a measurement.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::index::{DataRow, IndexRange};
use abbe_settings::Quantity;
use abbe_settings::serial::numbers;
use abbe_settings::{Error, Result, nearest};

/// The name of a column, as found in a file's header.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ColumnHeader {
    /// Name without its unit: `X` of `X_mm`.
    pub name: String,
    /// Name as written in the file.
    pub header: String,
    /// What it is a quantity of.
    pub quantity: Quantity,
}

impl ColumnHeader {
    /// Reads name and unit off a header cell.
    pub fn parse(header: &str) -> Self {
        let (name, quantity, _) = Quantity::of_column(header);
        Self { name: name.to_owned(), header: header.to_owned(), quantity }
    }
}

/// The text of a label in a data set: a short one needs no memory of its own.
///
/// It is read like a `str`, and is made of one by `into()`.
///
/// ```
/// let label = abbe_core::LabelText::from("ball 12");
/// assert_eq!(label.as_str(), "ball 12");
/// ```
pub type LabelText = smol_str::SmolStr;

/// The cells of a column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Values {
    /// Numbers in the unit used in memory.
    Numbers(
        #[serde(deserialize_with = "numbers")]
        #[schemars(with = "Vec<Option<f64>>")]
        Vec<f64>,
    ),
    /// Identifiers.
    Labels(#[schemars(with = "Vec<String>")] Vec<LabelText>),
}

/// A column: header and cells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Column {
    /// Name and unit.
    pub header: ColumnHeader,
    /// One cell a row.
    pub values: Values,
}

impl Column {
    /// Whether another column has the same header, and values of the same kind.
    fn is_like(&self, other: &Self) -> bool {
        let numbers = |column: &Self| matches!(column.values, Values::Numbers(_));
        self.header.header == other.header.header && numbers(self) == numbers(other)
    }
}

/// Where a row was read, so that messages and results can point at it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RowOrigin {
    /// Index into [`Dataset::files`].
    pub file: usize,
    /// Line in that file, from 1; 0 in a file that has no lines.
    pub line: usize,
    /// Number of the data row in that file, from 1; header and comments are not counted.
    pub row: usize,
}

impl RowOrigin {
    /// Its place in its file: `line 17`, or `row 16` where the file has no lines.
    pub fn in_words(&self) -> String {
        match self.line {
            0 => format!("row {}", self.row),
            line => format!("line {line}"),
        }
    }

    /// The places of two rows of one file: `lines 17 and 18`.
    pub fn both_in_words([one, other]: [Self; 2]) -> String {
        match (one.line, other.line) {
            (0, _) | (_, 0) => format!("rows {} and {}", one.row, other.row),
            (one, other) => format!("lines {one} and {other}"),
        }
    }

    /// Its place with its file: `a.csv:17`, or `a.parquet: row 16`.
    pub fn in_file(&self, file: &Path) -> String {
        match self.line {
            0 => format!("{}: row {}", file.display(), self.row),
            line => format!("{}:{line}", file.display()),
        }
    }

    /// The error with the place of the row in its file.
    pub fn blame(&self, error: Error, file: &Path) -> Error {
        match self.line {
            0 => Error { message: format!("row {}: {}", self.row, error.message), ..error.in_file(file) },
            line => error.at(file, line, None),
        }
    }
}

/// Measurements as they come from ingest: named columns with units, one row a measurement.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Dataset {
    /// The columns, all of the same length.
    pub columns: Vec<Column>,
    /// Where each row stands.
    pub origins: Vec<RowOrigin>,
    /// The files that the rows come from.
    pub files: Vec<PathBuf>,
    /// Rows are means of several rows of the files; each has the origin of the first.
    pub averaged: bool,
    /// Rows are a log of sensors with its own clock: a model gets from it what a row needs, by the time of the row.
    #[serde(default)]
    pub is_log: bool,
    /// The stylus tips that the files state in their headers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stated_tips: Vec<StatedTip>,
}

/// The stylus tip with which the header of a file says that it was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StatedTip {
    /// Diameter, mm.
    pub diameter: f64,
    /// Index into [`Dataset::files`].
    pub file: usize,
    /// Line in that file, from 1.
    pub line: usize,
}

impl Dataset {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.origins.len()
    }

    /// The indices of all rows.
    pub fn row_indices(&self) -> IndexRange<DataRow> {
        DataRow::first(self.rows())
    }

    /// A data set of some of its rows.
    pub fn of_rows(&self, rows: &[DataRow]) -> Self {
        let values = |values: &Values| match values {
            Values::Numbers(numbers) => Values::Numbers(rows.iter().map(|row| numbers[*row]).collect()),
            Values::Labels(labels) => Values::Labels(rows.iter().map(|row| labels[*row].clone()).collect()),
        };
        let column = |column: &Column| Column { header: column.header.clone(), values: values(&column.values) };
        Self {
            columns: self.columns.iter().map(column).collect(),
            origins: rows.iter().map(|row| self.origins[*row]).collect(),
            files: self.files.clone(),
            averaged: self.averaged,
            is_log: self.is_log,
            stated_tips: self.stated_tips.clone(),
        }
    }

    /// Adds the rows of a data set with the same columns, in any order. Files that both have are one.
    ///
    /// Fails, and adds nothing, where a column of one is not in the other.
    pub fn append(&mut self, more: Self) -> Result<()> {
        let place = |column: &Column| more.columns.iter().position(|other| other.is_like(column));
        let places: Option<Vec<usize>> = self.columns.iter().map(place).collect();
        let Some(places) = places.filter(|places| places.len() == more.columns.len()) else {
            let (own, other) = (list(&self.headers()), list(&more.headers()));
            return Err(Error::data(format!("rows with the columns {own} and {other} do not belong together")));
        };
        let mut values: Vec<Values> = more.columns.into_iter().map(|column| column.values).collect();
        for (column, place) in self.columns.iter_mut().zip(places) {
            match (&mut column.values, &mut values[place]) {
                (Values::Numbers(own), Values::Numbers(more)) => own.append(more),
                (Values::Labels(own), Values::Labels(more)) => own.append(more),
                // They are alike.
                _ => {}
            }
        }
        let files: Vec<usize> = more.files.into_iter().map(|file| self.place_of(file)).collect();
        let origin = |origin: RowOrigin| RowOrigin { file: files[origin.file], ..origin };
        self.origins.extend(more.origins.into_iter().map(origin));
        for tip in more.stated_tips.into_iter().map(|tip| StatedTip { file: files[tip.file], ..tip }) {
            if !self.stated_tips.contains(&tip) {
                self.stated_tips.push(tip);
            }
        }
        Ok(())
    }

    /// The index of a file, which is added if it is not known yet.
    fn place_of(&mut self, file: PathBuf) -> usize {
        let known = self.files.iter().position(|known| *known == file);
        known.unwrap_or_else(|| {
            self.files.push(file);
            self.files.len() - 1
        })
    }

    /// The headers of all columns.
    pub fn headers(&self) -> Vec<ColumnHeader> {
        self.columns.iter().map(|column| column.header.clone()).collect()
    }

    /// The column of that name (without unit).
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.header.name == name)
    }

    /// The numbers of a column.
    pub fn numbers(&self, name: &str) -> Option<&[f64]> {
        match &self.column(name)?.values {
            Values::Numbers(numbers) => Some(numbers),
            Values::Labels(_) => None,
        }
    }

    /// The labels of a column.
    pub fn labels(&self, name: &str) -> Option<&[LabelText]> {
        match &self.column(name)?.values {
            Values::Labels(labels) => Some(labels),
            Values::Numbers(_) => None,
        }
    }

    /// The labels of a column that has to be there.
    pub fn required_labels(&self, name: &str) -> Result<&[LabelText]> {
        self.labels(name).ok_or_else(|| missing_column(self.files.first(), name, &self.headers()))
    }

    /// The numbers of a column that has to be there.
    pub fn required_numbers(&self, name: &str) -> Result<&[f64]> {
        self.numbers(name).ok_or_else(|| missing_column(self.files.first(), name, &self.headers()))
    }

    /// An error that points at a row.
    pub fn error_at(&self, row: DataRow, message: impl Into<String>) -> Error {
        let origin = self.origins[row];
        origin.blame(Error::data(message), &self.files[origin.file])
    }
}

/// The error for a column that is not there, with the nearest that is.
pub(crate) fn missing_column(file: Option<&PathBuf>, name: &str, headers: &[ColumnHeader]) -> Error {
    let (base, ..) = Quantity::of_column(name);
    let in_file = |error: Error| match file {
        Some(file) => error.in_file(file),
        None => error,
    };
    if let Some(other) = headers.iter().find(|header| header.name == name || header.header == name) {
        let wrong = |is: &str, expected: &str| {
            Error::usage(format!("the column `{}` has {is}; {expected} were expected", other.header))
        };
        return in_file(match other.quantity {
            Quantity::Label => wrong("labels", "numbers").help("names of numbers end in their unit: `X_mm`, `B_deg`"),
            _ => wrong("numbers", "labels"),
        });
    }
    let near = nearest(base, headers.iter().map(|header| header.name.as_str()));
    let near = near.and_then(|near| headers.iter().find(|header| header.name == near));
    let mut error = Error::usage(format!("there is no column `{name}`; the columns are {}", list(headers)));
    if let [only] = headers
        && let Some(other) = [';', '\t'].into_iter().find(|other| only.header.contains(*other))
    {
        error = error.help(format!("the cells seem to be separated by {other:?}; commas were expected"));
    } else if let Some(other) = headers.iter().find(|header| has_unit_of_its_own(&header.header, base)) {
        error = error.help(format!(
            "is it `{}`? Names end in the unit: `X_mm`, `B_deg`. Where `ingest: csv` reads the file, its setting `columns` \
             takes other names and units",
            other.header
        ));
    } else if let Some(near) = near {
        error = error.help(format!("did you mean `{}`?", near.header));
    }
    in_file(error)
}

/// Whether a header is a name with a unit that is not read: `X [mm]`, `X_inch`.
fn has_unit_of_its_own(header: &str, name: &str) -> bool {
    let rest = header.strip_prefix(name).unwrap_or("");
    rest.starts_with([' ', '_', '(', '[', '/', '-', '.'])
}

fn list(headers: &[ColumnHeader]) -> String {
    headers.iter().map(|header| format!("`{}`", header.header)).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(header: &str, values: Values) -> Column {
        Column { header: ColumnHeader::parse(header), values }
    }

    /// Rows of two files, in one order of the columns or the other.
    fn rows(files: [&str; 2], first: f64, turned: bool) -> Dataset {
        let mut columns = vec![
            column("X_mm", Values::Numbers(vec![first, first + 1.0])),
            column("feature", Values::Labels(vec![format!("{first}").into(), "b".into()])),
        ];
        if turned {
            columns.reverse();
        }
        let origin = |file| RowOrigin { file, line: file + 2, row: file + 1 };
        let stated_tips = vec![StatedTip { diameter: first, file: 1, line: 1 }];
        let files = files.map(PathBuf::from).to_vec();
        Dataset { columns, origins: vec![origin(0), origin(1)], files, stated_tips, ..Dataset::default() }
    }

    #[test]
    fn rows_are_added_with_their_files() {
        let mut all = rows(["a.csv", "b.csv"], 1.0, false);
        all.append(rows(["b.csv", "c.csv"], 3.0, true)).unwrap();
        assert_eq!(all.numbers("X").unwrap(), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(all.labels("feature").unwrap(), ["1", "b", "3", "b"]);
        assert_eq!(all.files, ["a.csv", "b.csv", "c.csv"].map(PathBuf::from));
        assert_eq!(all.origins.iter().map(|origin| origin.file).collect::<Vec<_>>(), [0, 1, 1, 2]);
        assert_eq!(all.stated_tips.iter().map(|tip| tip.file).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn rows_with_other_columns_are_refused_and_nothing_is_added() {
        let all = rows(["a.csv", "b.csv"], 1.0, false);
        let mut fewer = all.clone();
        fewer.columns.pop();
        let mut others = all.clone();
        others.columns[1] = column("feature", Values::Numbers(vec![1.0, 2.0]));
        for (mut one, other) in [(all.clone(), fewer.clone()), (fewer, all.clone()), (all, others)] {
            let before = one.clone();
            one.append(other).unwrap_err();
            assert_eq!(one, before);
        }
    }
}
