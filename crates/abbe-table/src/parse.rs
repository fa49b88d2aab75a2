//! From the bytes of a file to a data set.

use std::io::BufRead;
use std::path::Path;
use std::str;

use abbe_core::{Class, Column, ColumnHeader, Dataset, Error, Quantity, Result, RowOrigin, Values};

use crate::{empty_column, unreadable};

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// The columns of a file. Only the part of the file that is needed is read.
pub(crate) fn headers(path: &Path, mut reader: impl BufRead) -> Result<Vec<ColumnHeader>> {
    let mut bytes = Vec::new();
    loop {
        let start = bytes.len();
        let length = reader.read_until(b'\n', &mut bytes).map_err(|error| unreadable(path, &error))?;
        if bytes[start..].starts_with(b"#") {
            continue;
        }
        match Records::new(path, &bytes)?.header()? {
            Some(headers) => return Ok(headers),
            None if length == 0 => return Err(empty(path)),
            None => {}
        }
    }
}

/// The data set of one file.
pub(crate) fn dataset(path: &Path, bytes: &[u8]) -> Result<Dataset> {
    let mut records = Records::new(path, bytes)?;
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
    Ok(Dataset { columns, origins, files: vec![path.to_owned()], averaged: false })
}

/// Reads a number as it stands in a cell of the column `header`, in the unit used in memory; else says what is wrong.
pub fn number(header: &str, cell: &str) -> Result<f64, String> {
    let cell = cell.trim();
    let (_, _, factor) = Quantity::of_column(header);
    match cell.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value * factor),
        Ok(_) => Err(format!("`{header}` is `{cell}`, which is not a finite number")),
        Err(_) if cell.is_empty() => Err(format!("`{header}` is empty; a number was expected")),
        Err(_) => Err(format!("`{header}` is `{cell}`; a number was expected")),
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
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
        let text = str::from_utf8(bytes).map_err(|error| {
            let good = String::from_utf8_lossy(&bytes[..error.valid_up_to()]);
            let column = good.chars().rev().take_while(|&c| c != '\n').count() + 1;
            Error::data("the file is not text in UTF-8").at(path, 1 + newlines(&good), Some(column))
        })?;
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .from_reader(text.as_bytes());
        Ok(Self { path, text, reader, cells: csv::StringRecord::new(), start: 0, line: 1 })
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
            return Ok(true);
        }
        Ok(false)
    }

    /// Goes to the header row and reads it, if there is one.
    fn header(&mut self) -> Result<Option<Vec<ColumnHeader>>> {
        if !self.advance().map_err(|error| Error { class: Class::Use, ..error })? {
            return Ok(None);
        }
        let mut headers: Vec<ColumnHeader> = Vec::new();
        for (index, cell) in self.cells.iter().enumerate() {
            let header = ColumnHeader::parse(cell.trim());
            let twin = headers.iter().find(|other| other.name == header.name);
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

fn newlines(text: &str) -> usize {
    text.bytes().filter(|&byte| byte == b'\n').count()
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
