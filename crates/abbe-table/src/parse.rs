//! From the bytes of a file to a data set.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::BufRead;
use std::ops::RangeInclusive;
use std::path::Path;

use abbe_core::{Class, Column, ColumnHeader, Dataset, Error, Quantity, Result, RowOrigin, Values};

use crate::text::{newlines, read_line, text};
use crate::{empty_column, unreadable};

/// Bytes of the longest cell: 64 KiB.
const LONGEST_CELL: usize = 64 << 10;

/// Characters of a cell that a message shows.
const SHOWN: usize = 60;

/// The columns of a file. Only the part of the file that is needed is read.
pub(crate) fn headers(path: &Path, mut reader: impl BufRead) -> Result<Vec<ColumnHeader>> {
    let mut bytes = Vec::new();
    loop {
        let start = bytes.len();
        let is_read = read_line(&mut reader, &mut bytes).map_err(|error| unreadable(path, &error))?;
        let line = &bytes[start..];
        if is_read && (line.starts_with(b"#") || line.trim_ascii().is_empty()) {
            continue;
        }
        match Records::new(path, &text(path, &bytes)?).header()? {
            Some(headers) => return Ok(headers),
            None if !is_read => return Err(empty(path)),
            None => {}
        }
    }
}

/// The data set of one file.
pub(crate) fn dataset(path: &Path, bytes: &[u8]) -> Result<Dataset> {
    let text = text(path, bytes)?;
    let mut records = Records::new(path, &text);
    let mut columns: Vec<Column> =
        records.header()?.ok_or_else(|| empty(path))?.into_iter().map(empty_column).collect();
    let mut origins = Vec::new();
    while records.advance()? {
        let found = records.cells.len();
        if found != columns.len() {
            let cells = if found == 1 { "cell" } else { "cells" };
            let message = format!("the row has {found} {cells}; {} were expected", columns.len());
            return Err(Error::data(message).at(path, records.line, None));
        }
        for (index, (column, cell)) in columns.iter_mut().zip(records.cells.iter()).enumerate() {
            match &mut column.values {
                Values::Numbers(numbers) => numbers.push(
                    number(&column.header.header, cell)
                        .map_err(|message| records.at_cell(Error::data(message), index))?,
                ),
                Values::Labels(labels) => labels.push(cell.trim().to_owned()),
            }
        }
        origins.push(RowOrigin { file: 0, line: records.line, row: origins.len() + 1 });
    }
    if origins.is_empty() {
        return Err(Error::data("the file has no data rows").in_file(path));
    }
    Ok(Dataset { columns, origins, files: vec![path.to_owned()], averaged: false, is_log: false })
}

/// Temperatures that are read, °C: no machine is measured at others, and 293 is in kelvin.
pub const TEMPERATURES: RangeInclusive<f64> = -100.0..=200.0;

/// Reads a number as it stands in a cell of the column `header`, in the unit used in memory; else says what is wrong.
pub fn number(header: &str, cell: &str) -> Result<f64, String> {
    let cell = cell.trim();
    let (_, quantity, factor) = Quantity::of_column(header);
    match cell.parse::<f64>() {
        Ok(value) if quantity == Quantity::Temperature && !TEMPERATURES.contains(&value) => Err(format!(
            "`{header}` is `{}`; a temperature from {} to {} °C was expected",
            shown(cell),
            TEMPERATURES.start(),
            TEMPERATURES.end()
        )),
        Ok(value) if value.is_finite() => Ok(value * factor),
        Ok(_) => Err(format!("`{header}` is `{}`, which is not a finite number", shown(cell))),
        Err(_) if cell.is_empty() => Err(format!("`{header}` is empty; a number was expected")),
        Err(_) if cell.replacen(',', ".", 1).parse::<f64>().is_ok() => {
            Err(format!("`{header}` is `{}`; a number with a decimal point was expected", shown(cell)))
        }
        Err(_) => Err(format!("`{header}` is `{}`; a number was expected", shown(cell))),
    }
}

/// The beginning of a cell, which may be long.
fn shown(cell: &str) -> Cow<'_, str> {
    match cell.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &cell[..end]).into(),
        None => cell.into(),
    }
}

/// The cells of one line, as they stand there.
pub(crate) fn cells(path: &Path, line: &str) -> Result<Vec<String>> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(line.as_bytes());
    let mut record = csv::StringRecord::new();
    reader.read_record(&mut record).map_err(|error| Error::data(error.to_string()).in_file(path))?;
    Ok(record.iter().map(str::to_owned).collect())
}

/// A line with these cells, quoted where they have to be.
pub(crate) fn line(path: &Path, cells: &[String]) -> Result<String> {
    let wrong = |message: String| Error::data(message).in_file(path);
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::Any(b'\n')).from_writer(Vec::new());
    writer.write_record(cells).map_err(|error| wrong(error.to_string()))?;
    let bytes = writer.into_inner().map_err(|error| wrong(error.to_string()))?;
    let text = String::from_utf8(bytes).map_err(|error| wrong(error.to_string()))?;
    Ok(text.trim_end_matches('\n').to_owned())
}

fn empty(path: &Path) -> Error {
    Error::data("the file is empty").in_file(path)
}

/// The rows of a text one after another, the header row too, with the place of each.
struct Records<'a> {
    path: &'a Path,
    text: &'a str,
    reader: csv::Reader<&'a [u8]>,
    cells: csv::StringRecord,
    /// Where the current row begins.
    start: usize,
    /// Line of the current row, from 1.
    line: usize,
}

impl<'a> Records<'a> {
    fn new(path: &'a Path, text: &'a str) -> Self {
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .from_reader(text.as_bytes());
        Self { path, text, reader, cells: csv::StringRecord::new(), start: 0, line: 1 }
    }

    /// Goes to the next row; false if there is none.
    fn advance(&mut self) -> Result<bool> {
        let wrong = |error: csv::Error| Error::data(error.to_string()).in_file(self.path);
        while self.reader.read_record(&mut self.cells).map_err(wrong)? {
            // The position that `csv` gives is before the comments and blank lines that it has skipped.
            let from = self.cells.position().map_or(0, |position| position.byte() as usize);
            let start = from + skipped(self.text.get(from..).unwrap_or(""));
            self.line += newlines(self.text.get(self.start..start).unwrap_or(""));
            self.start = start;
            if self.cells.len() == 1 && self.cells[0].trim().is_empty() {
                continue;
            }
            // A superfluous quotation mark makes such a cell; it would contain several rows.
            if let Some(cell) = self.cells.iter().position(|cell| cell.contains(['\n', '\r'])) {
                return Err(self.at_cell(Error::data("a quotation mark is not closed in its line"), cell));
            }
            if self.cells.as_slice().len() > LONGEST_CELL
                && let Some(cell) = self.cells.iter().position(|cell| cell.len() > LONGEST_CELL)
            {
                let length = self.cells[cell].len().div_ceil(1024);
                let message = format!("a cell has {length} KiB; at most {} are read", LONGEST_CELL >> 10);
                return Err(self.at_cell(Error::data(message), cell));
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// Goes to the header row and reads it, if there is one.
    fn header(&mut self) -> Result<Option<Vec<ColumnHeader>>> {
        if !self.advance().map_err(|error| Error { class: Class::Use, ..error })? {
            return Ok(None);
        }
        if let Some(separator) = other_separator(&self.cells) {
            let message = format!("the columns are separated by {separator}; a comma was expected");
            let error = Error::usage(message).help("save the table with commas, and with points in its numbers");
            return Err(self.at_cell(error, 0));
        }
        let mut headers: Vec<ColumnHeader> = Vec::new();
        let mut names = HashMap::new();
        for (index, cell) in self.cells.iter().enumerate() {
            let header = ColumnHeader::parse(cell.trim());
            let twin = names.insert(header.name.clone(), index).map(|other| &headers[other]);
            let message = match twin {
                _ if header.name.is_empty() => "a column has no name".to_owned(),
                Some(twin) if twin.header == header.header => format!("there are two columns `{}`", header.header),
                Some(twin) => {
                    format!("the columns `{}` and `{}` are both named `{}`", twin.header, header.header, header.name)
                }
                None => {
                    headers.push(header);
                    continue;
                }
            };
            return Err(self.at_cell(Error::usage(message), index));
        }
        Ok(Some(headers))
    }

    /// Points at a cell of the current row.
    fn at_cell(&self, error: Error, cell: usize) -> Error {
        let row = self.text.get(self.start..).unwrap_or("");
        error.at(self.path, self.line, Some(row[..cell_start(row, cell)].chars().count() + 1))
    }
}

/// What separates the columns where a header row is not separated by commas.
fn other_separator(header: &csv::StringRecord) -> Option<&'static str> {
    let line = header.get(0).filter(|_| header.len() == 1)?.trim();
    let separators = [(';', "semicolons"), ('\t', "tabs"), ('|', "vertical strokes"), (' ', "spaces")];
    // A name may have spaces in it; its unit ends it.
    let is_column = |name: &str| ColumnHeader::parse(name).quantity != Quantity::Label;
    let separates = |separator| match separator {
        ' ' => line.rsplit_once(' ').is_some_and(|(before, _)| before.split(' ').any(is_column)),
        _ => line.contains(separator),
    };
    separators.into_iter().find(|(separator, _)| separates(*separator)).map(|(_, name)| name)
}

/// Length of the comments and empty lines that a text begins with.
fn skipped(text: &str) -> usize {
    let mut rest = text;
    loop {
        rest = rest.trim_start_matches(['\n', '\r']);
        if !rest.starts_with('#') {
            return text.len() - rest.len();
        }
        rest = rest.find('\n').map_or("", |end| &rest[end..]);
    }
}

/// Where in a row the content of a cell begins.
fn cell_start(row: &str, cell: usize) -> usize {
    let (mut index, mut start, mut open) = (0, 0, false);
    for (at, character) in row.char_indices() {
        match character {
            _ if index == cell => break,
            '"' if row[start..].starts_with('"') => open = !open,
            ',' if !open => {
                index += 1;
                start = at + 1;
            }
            _ => {}
        }
    }
    let content = row[start..].trim_start_matches(|c: char| c.is_whitespace() && !['\n', '\r'].contains(&c));
    row.len() - content.len()
}
