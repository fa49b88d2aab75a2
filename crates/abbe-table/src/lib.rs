//! Reads CSV tables whose column names carry units.
//!
//! The usual format: UTF-8 (a byte order mark is tolerated), comma, one header row, `.` as decimal point. Lines that begin
//! with `#` are comments, blank lines are skipped, white space around cells does not count, and lines may end in CRLF or CR.
//! A cell may be quoted, but stays on its line, and has 64 KiB at most. What a column holds follows from its name
//! ([`abbe_core::Quantity::of_column`]); numbers are converted to the unit used in memory. A [`Layout`] describes files of
//! instruments and spreadsheets that are written otherwise: nothing of it is guessed. A file may be packed by gzip or
//! Zstandard: its content decides, and lines are those of what is packed. Tables that come by columns ([`DataOfColumns`]) have the same meaning.

mod batches;
mod columns;
mod layout;
mod lost_rows;
mod number;
mod parse;
mod rewrite;
mod settings;
mod shared;
mod survey;
mod text;
mod unpacking;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use abbe_core::{Column, ColumnHeader, DataRow, Dataset, Error, LabelText, Quantity, Result, Values};

pub use abbe_core::ranges::TEMPERATURES;
pub use batches::FileInBatches;
pub use columns::{DataOfColumns, NamedColumns};
pub use layout::{ColumnSource, Decimal, Encoding, Layout, Separator, Thousands, Unit};
pub use number::{number, number_in};
pub use rewrite::{Cells, with_cells, with_cells_laid_out, with_columns};
pub use settings::{ColumnInUnit, Declared, Source};
pub use shared::{of_table, of_table_without_rows};
pub use survey::{Contents, Found, Jump, Likely, Summary, contents, likely};

/// Reads the columns of a file, not its rows.
pub fn read_headers(path: &Path) -> Result<Vec<ColumnHeader>> {
    let content = abbe_files::open_content(path).map_err(|error| unreadable(path, &error))?;
    parse::headers(path, BufReader::new(content))
}

/// Reads a file.
pub fn read(path: &Path) -> Result<Dataset> {
    Ok(parse::dataset(path, &bytes_of(path)?, &Layout::default())?.0)
}

/// Reads the columns of a file with a layout of its own, not its rows.
pub fn read_headers_laid_out(path: &Path, layout: &Layout) -> Result<Vec<ColumnHeader>> {
    match *layout == Layout::default() {
        true => read_headers(path),
        false => parse::headers_laid_out(path, &bytes_of(path)?, layout),
    }
}

/// Reads a file with a layout of its own. Rows that have no number where one is needed ([`Layout::no_data`]) are left out; those
/// that stay keep their line and number; how many are left out is told beside the data set.
pub fn read_laid_out(path: &Path, layout: &Layout) -> Result<(Dataset, usize)> {
    parse::dataset(path, &bytes_of(path)?, layout)
}

/// The text of a file without byte order mark, in which every line ends in LF or CRLF.
pub fn read_text(path: &Path) -> Result<String> {
    read_text_in(path, Encoding::Utf8)
}

/// The same of a file in another encoding.
pub fn read_text_in(path: &Path, encoding: Encoding) -> Result<String> {
    text::text(path, &bytes_of(path)?, encoding).map(Cow::into_owned)
}

/// Bytes that are read at a time.
const PART: u64 = 1 << 20;

pub(crate) fn bytes_of(path: &Path) -> Result<Vec<u8>> {
    let mut file = abbe_files::open_content(path).map_err(|error| unreadable(path, &error))?;
    let mut bytes = Vec::new();
    loop {
        let start = bytes.len();
        let part = file.by_ref().take(PART).read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
        // What follows a zero byte is not read: the text ends there with an error. Text in UTF-16 has many.
        let is_binary = !text::may_be_utf_16(&bytes) && bytes[start..].contains(&0);
        if part == 0 || is_binary {
            return Ok(bytes);
        }
    }
}

/// The data set that a text is; `path` names it in messages.
pub fn parse(path: &Path, text: &[u8]) -> Result<Dataset> {
    Ok(parse::dataset(path, text, &Layout::default())?.0)
}

/// The error for a file that cannot be opened or read.
pub fn unreadable(path: &Path, error: &io::Error) -> Error {
    if abbe_files::is_of_packing(error) {
        let help = "pack the table again, or unpack it to see what is there";
        return Error::data(format!("the file cannot be read: {}", abbe_files::why(error))).in_file(path).help(help);
    }
    let message = match error.kind() {
        io::ErrorKind::NotFound => "there is no such file".to_owned(),
        _ => format!("the file cannot be read: {}", abbe_files::why(error)),
    };
    Error::usage(message)
        .in_file(path)
        .help("is the path right? In a recipe it is relative to the folder of the recipe")
}

/// A column without rows.
pub fn empty_column(header: ColumnHeader) -> Column {
    let values = match header.quantity {
        Quantity::Label => Values::Labels(Vec::new()),
        _ => Values::Numbers(Vec::new()),
    };
    Column { header, values }
}

/// The labels of a column (named without unit) that has to be there.
pub fn labels<'a>(data: &'a Dataset, name: &str) -> Result<&'a [LabelText]> {
    match data.column(name) {
        Some(Column { header, values: Values::Numbers(_) }) => {
            Err(wrong_column(data, format!("the column `{}` holds numbers; labels were expected", header.header))
                .help("labels have names without a unit"))
        }
        _ => data.required_labels(name),
    }
}

/// The numbers of a column (named without unit) that has to be there and of that quantity.
pub fn numbers<'a>(data: &'a Dataset, name: &str, quantity: Quantity) -> Result<&'a [f64]> {
    let expected = format!("{name}{}", quantity.usual_suffix());
    match data.column(name).map(|column| &column.header) {
        // No column is named with its unit, so this gives the error that lists those that are there.
        None => data.required_numbers(&expected),
        Some(header) if header.quantity == quantity => data.required_numbers(name),
        Some(header) if header.quantity == Quantity::Label => {
            Err(wrong_column(data, format!("the column `{}` does not say its unit", header.header))
                .help(format!("write its unit into its name: `{expected}`")))
        }
        Some(header) => {
            let message =
                format!("the column `{}` has the wrong unit; {} was expected", header.header, quantity.symbol());
            Err(wrong_column(data, message).help(format!("write its unit into its name: `{expected}`")))
        }
    }
}

/// Checks that columns (named without unit) are among those of a file, with the right quantity, before its rows are read.
pub fn require(headers: &[ColumnHeader], file: Option<&PathBuf>, columns: &[(&str, Quantity)]) -> Result<()> {
    let data = Dataset {
        columns: headers.iter().cloned().map(empty_column).collect(),
        origins: Vec::new(),
        files: file.into_iter().cloned().collect(),
        averaged: false,
        is_log: false,
        stated_tips: Vec::new(),
    };
    for (name, quantity) in columns {
        match quantity {
            Quantity::Label => labels(&data, name).map(drop)?,
            _ => numbers(&data, name, *quantity).map(drop)?,
        }
    }
    Ok(())
}

fn wrong_column(data: &Dataset, message: String) -> Error {
    let error = Error::usage(message);
    match data.files.first() {
        Some(file) => error.in_file(file),
        None => error,
    }
}

/// The row of each label of a column in which no label may occur twice.
pub fn unique_labels<'a>(data: &'a Dataset, name: &str) -> Result<BTreeMap<&'a str, DataRow>> {
    let mut rows = BTreeMap::new();
    for (row, label) in DataRow::enumerate(labels(data, name)?) {
        if let Some(first) = rows.insert(label.as_str(), row) {
            let place = data.origins[first].in_words();
            return Err(data.error_at(row, format!("{name} `{label}` is in {place} already")));
        }
    }
    Ok(rows)
}

/// Which rows touch which features.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Touched {
    /// Rows that touch a feature, with its index in `features`.
    pub rows: Vec<(DataRow, usize)>,
    /// The nominal features that are touched, ascending.
    pub features: Vec<usize>,
}

/// Sorts rows by the nominal feature that each touches, none for rows of other artefacts. A feature that nobody touched is
/// left out.
pub fn touched(of_rows: &[Option<usize>], nominal: &Path) -> Result<Touched> {
    touched_by_some(of_rows).ok_or_else(|| untouched(nominal))
}

/// The error for rows none of which touches a feature.
pub fn untouched(nominal: &Path) -> Error {
    Error::data(format!("no row touches a feature of {}", nominal.display()))
        .help("`feature` in the data and in the nominal file have to agree")
}

/// As [`touched`], of rows of which none may touch a feature: then there is nothing.
pub fn touched_by_some(of_rows: &[Option<usize>]) -> Option<Touched> {
    let mut features: Vec<usize> = of_rows.iter().flatten().copied().collect();
    features.sort_unstable();
    features.dedup();
    if features.is_empty() {
        return None;
    }
    let place = |feature: usize| features.binary_search(&feature).ok();
    let rows = DataRow::enumerate(of_rows);
    let rows = rows.filter_map(|(row, feature)| feature.and_then(place).map(|place| (row, place))).collect();
    Some(Touched { rows, features })
}

/// The points that three columns of lengths hold (`["x", "y", "z"]`), mm, one a row.
pub fn points(data: &Dataset, names: [&str; 3]) -> Result<Vec<[f64; 3]>> {
    triples(data, names, Quantity::Length)
}

/// The vectors that three dimensionless columns hold (`["nx", "ny", "nz"]`), one a row, as written.
pub fn vectors(data: &Dataset, names: [&str; 3]) -> Result<Vec<[f64; 3]>> {
    triples(data, names, Quantity::Ratio)
}

fn triples(data: &Dataset, [x, y, z]: [&str; 3], quantity: Quantity) -> Result<Vec<[f64; 3]>> {
    let (x, y, z) = (numbers(data, x, quantity)?, numbers(data, y, quantity)?, numbers(data, z, quantity)?);
    Ok(x.iter().zip(y).zip(z).map(|((&x, &y), &z)| [x, y, z]).collect())
}

#[cfg(test)]
mod tests;
