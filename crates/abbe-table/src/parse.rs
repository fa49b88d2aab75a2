//! From the bytes of a file to a data set.

use std::collections::HashMap;
use std::io::BufRead;
use std::path::Path;

use abbe_core::{Class, Column, ColumnHeader, Dataset, Error, Quantity, Result, RowOrigin, Values};

use crate::layout::{Encoding, Layout, Separator, Unit};
use crate::lost_rows::no_lost_row;
use crate::number::{help_for, number_in_column, shown};
use crate::text::{newlines, read_line, text};
use crate::{empty_column, unreadable};

/// What to do about a row with too many or too few cells.
const RAGGED: &str = "correct the file: a separator is missing there or one too many, or a text or a decimal comma is not \
                      quoted; titles before the table are left out by `skip_lines`";

/// What to do about two columns of one name.
const TWINS: &str = "give one of them another name in the file, or take columns by number: `header: false`, with `skip_lines` for \
                     the header row and `columns: { X_mm: 1 }`";

/// What to do about a header row that has the same number twice.
const NUMBERS: &str =
    "the first line names the columns, and this one has numbers: is the row of names missing, or does no line end?";

/// Bytes of the longest cell: 64 KiB.
pub(crate) const LONGEST_CELL: usize = 64 << 10;

/// Cells of the widest row: more than any table has.
pub(crate) const MOST_CELLS: usize = 1 << 17;

/// The error for a row with another number of cells.
pub(crate) fn ragged(path: &Path, line: usize, found: usize, expected: usize) -> Error {
    let cells = if found == 1 { "cell" } else { "cells" };
    Error::data(format!("the row has {found} {cells}; {expected} were expected")).at(path, line, None).help(RAGGED)
}

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
        let text = text(path, &bytes, Encoding::Utf8)?;
        match Records::new(path, &text, Separator::Comma).header()? {
            Some(headers) => return Ok(headers),
            None if !is_read => return Err(empty(path)),
            None => {}
        }
    }
}

/// The columns of a file that has this layout.
pub(crate) fn headers_laid_out(path: &Path, bytes: &[u8], layout: &Layout) -> Result<Vec<ColumnHeader>> {
    let text = text(path, bytes, layout.encoding)?;
    let taken = Table::begin(path, &text, layout)?.taken;
    Ok(taken.into_iter().map(|column| column.header).collect())
}

/// The data set of one file, and the number of rows that are left out because a number was not measured.
pub(crate) fn dataset(path: &Path, bytes: &[u8], layout: &Layout) -> Result<(Dataset, usize)> {
    let text = text(path, bytes, layout.encoding)?;
    let Table { mut records, taken, width } = Table::begin(path, &text, layout)?;
    for _ in 0..layout.skip_after_header {
        records.advance()?;
    }
    let rows = Rows { taken: &taken, width, before: 0 };
    let (data, row) = rows.read(records, layout, &text)?;
    if data.origins.is_empty() {
        let (message, help) = match row {
            0 if newlines(&text) == 0 => (
                "the file is one line: names of columns, and no rows of data",
                "each row needs a line of its own; save the table again if it had some",
            ),
            0 => ("the file has no data rows", "`skip_lines` and `skip_after_header` may skip them"),
            _ => ("all rows of the file hold a mark of `no_data`", "`no_data` may list what is a number"),
        };
        return Err(Error::data(message).in_file(path).help(help));
    }
    let left_out = row - data.origins.len();
    Ok((data, left_out))
}

/// The columns of a file, without what its rows hold.
pub(crate) struct Head {
    taken: Vec<Taken>,
    /// Cells of a row, if a header row says so.
    pub(crate) width: Option<usize>,
}

impl Head {
    /// The columns of a file that begins with this text.
    pub(crate) fn new(path: &Path, text: &str, layout: &Layout) -> Result<Self> {
        let Table { taken, width, .. } = Table::begin(path, text, layout)?;
        Ok(Self { taken, width })
    }

    /// The rows of a part of the file, which begins after so many lines and rows of data; and how many are left out because a number was
    /// not measured. None may be left.
    pub(crate) fn part(
        &self,
        path: &Path,
        text: &str,
        [lines, rows]: [usize; 2],
        layout: &Layout,
    ) -> Result<(Dataset, usize)> {
        let mut records = Records::new(path, text, layout.separator);
        records.line += lines;
        let (data, row) = Rows { taken: &self.taken, width: self.width, before: rows }.read(records, layout, text)?;
        let left_out = row - rows - data.origins.len();
        Ok((data, left_out))
    }
}

/// Rows of data of one file.
struct Rows<'a> {
    taken: &'a [Taken],
    /// Cells of a row, if that is known.
    width: Option<usize>,
    /// Rows of data before them.
    before: usize,
}

impl Rows<'_> {
    /// The data set, and the number of the last row of data in the file.
    fn read(&self, mut records: Records<'_>, layout: &Layout, text: &str) -> Result<(Dataset, usize)> {
        let Self { taken, mut width, before } = *self;
        let mut columns: Vec<Column> = taken.iter().map(|column| empty_column(column.header.clone())).collect();
        let (mut origins, mut row, mut numbers) = (Vec::new(), before, Vec::new());
        // Room for all rows at once: a column that grows would take twice as much for a while. Each cell of a row takes a byte at least.
        let rows = newlines(text).min(text.len() / columns.len().max(1)).saturating_add(1);
        for column in &mut columns {
            match &mut column.values {
                Values::Numbers(numbers) => numbers.reserve_exact(rows),
                Values::Labels(labels) => labels.reserve_exact(rows),
            }
        }
        while records.advance()? {
            row += 1;
            let found = records.cells.len();
            let expected = *width.get_or_insert(found);
            if found != expected {
                return Err(ragged(records.path, records.line, found, expected));
            }
            if taken.iter().any(|column| column.is_absent(&records, layout)) {
                continue;
            }
            numbers.clear();
            for column in taken.iter().filter(|column| column.header.quantity != Quantity::Label) {
                let cell = records.cell(column)?;
                let of_header = (column.header.quantity, column.factor);
                let number = number_in_column(&column.header.header, of_header, cell, column.unit, layout);
                numbers.push(number.map_err(|message| {
                    let error = records.at_cell(Error::data(message), column.index);
                    match help_for(&column.header.header, cell, layout) {
                        Some(help) => error.help(help),
                        None => error,
                    }
                })?);
            }
            let mut number = numbers.iter();
            for (column, taken) in columns.iter_mut().zip(taken) {
                match &mut column.values {
                    Values::Numbers(numbers) => numbers.extend(number.next()),
                    Values::Labels(labels) => labels.push(records.cell(taken)?.trim().into()),
                }
            }
            origins.push(RowOrigin { file: 0, line: records.line, row });
        }
        Ok((Dataset { columns, origins, files: vec![records.path.to_owned()], ..Dataset::default() }, row))
    }
}

/// A column of the data set, and where it stands in the file.
struct Taken {
    header: ColumnHeader,
    index: usize,
    unit: Option<Unit>,
    /// From the unit of the header to the one used in memory.
    factor: f64,
}

impl Taken {
    fn new(header: ColumnHeader, index: usize, unit: Option<Unit>) -> Self {
        let (.., factor) = Quantity::of_column(&header.header);
        Self { header, index, unit, factor }
    }

    /// Whether the row has the mark of a number that was not measured here.
    fn is_absent(&self, records: &Records, layout: &Layout) -> bool {
        !layout.no_data.is_empty()
            && self.header.quantity != Quantity::Label
            && records.cells.get(self.index).is_some_and(|cell| layout.is_mark(cell.trim()))
    }
}

/// A table whose header row has been read.
struct Table<'a> {
    records: Records<'a>,
    taken: Vec<Taken>,
    /// Cells of a row, if a header row says so.
    width: Option<usize>,
}

impl<'a> Table<'a> {
    fn begin(path: &'a Path, text: &'a str, layout: &Layout) -> Result<Self> {
        let mut records = Records::after(path, text, layout);
        let Some(columns) = &layout.columns else {
            let headers = records.header()?.ok_or_else(|| no_header(path, layout))?;
            let width = Some(headers.len());
            let taken = headers.into_iter().enumerate();
            let taken = taken.map(|(index, header)| Taken::new(header, index, None)).collect();
            return Ok(Self { records, taken, width });
        };
        let names =
            if layout.has_header { Some(records.names()?.ok_or_else(|| no_header(path, layout))?) } else { None };
        let mut taken = Vec::with_capacity(columns.len());
        for (name, source) in columns {
            let index = match &names {
                Some(names) => records.place_of(&source.column, names)?,
                None => {
                    source.column.parse::<usize>().ok().and_then(|number| number.checked_sub(1)).ok_or_else(|| {
                        let message = format!("`{}` is no number of a column; 1, 2, ... was expected", source.column);
                        Error::usage(message).in_file(path)
                    })?
                }
            };
            taken.push(Taken::new(ColumnHeader::parse(name), index, source.unit));
        }
        Ok(Self { records, taken, width: names.map(|names| names.len()) })
    }
}

/// The columns of a text that has this layout: header in the data set, index in a row, and unit in the file if it is another one.
pub(crate) fn places(path: &Path, text: &str, layout: &Layout) -> Result<Vec<(ColumnHeader, usize, Option<Unit>)>> {
    let taken = Table::begin(path, text, layout)?.taken;
    Ok(taken.into_iter().map(|column| (column.header, column.index, column.unit)).collect())
}

/// The cells of one line, as they stand there.
pub(crate) fn cells(path: &Path, line: &str, separator: Separator) -> Result<Vec<String>> {
    if separator == Separator::Space {
        return Ok(line.split_whitespace().map(str::to_owned).collect());
    }
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .delimiter(separator.character() as u8)
        .from_reader(line.as_bytes());
    let mut record = csv::StringRecord::new();
    reader.read_record(&mut record).map_err(|error| Error::data(error.to_string()).in_file(path))?;
    Ok(record.iter().map(str::to_owned).collect())
}

/// A line with these cells, quoted where they have to be.
pub(crate) fn line(path: &Path, cells: &[String], separator: Separator) -> Result<String> {
    if separator == Separator::Space {
        return Ok(cells.join(" "));
    }
    let wrong = |message: String| Error::data(message).in_file(path);
    let mut writer = csv::WriterBuilder::new()
        .delimiter(separator.character() as u8)
        .terminator(csv::Terminator::Any(b'\n'))
        .from_writer(Vec::new());
    writer.write_record(cells).map_err(|error| wrong(error.to_string()))?;
    let bytes = writer.into_inner().map_err(|error| wrong(error.to_string()))?;
    let text = String::from_utf8(bytes).map_err(|error| wrong(error.to_string()))?;
    Ok(text.trim_end_matches('\n').to_owned())
}

fn empty(path: &Path) -> Error {
    Error::data("the file is empty")
        .in_file(path)
        .help("a row with the names of the columns was expected, and rows of data")
}

fn no_header(path: &Path, layout: &Layout) -> Error {
    match layout.skip_lines {
        0 => empty(path),
        lines => Error::usage(format!("there is no row after the {lines} lines of `skip_lines`"))
            .in_file(path)
            .help("the row of names follows them"),
    }
}

/// The rows of a text one after another, the header row too, with the place of each.
pub(crate) struct Records<'a> {
    path: &'a Path,
    text: &'a str,
    separator: Separator,
    reader: csv::Reader<&'a [u8]>,
    pub(crate) cells: csv::StringRecord,
    /// Where the current row begins.
    start: usize,
    /// Line of the current row, from 1.
    pub(crate) line: usize,
    /// Cells of the first row.
    width: Option<usize>,
}

impl<'a> Records<'a> {
    pub(crate) fn new(path: &'a Path, text: &'a str, separator: Separator) -> Self {
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            // Where white space separates, a line is one cell for the library and is cut afterwards.
            .delimiter(if separator == Separator::Space { 0x1F } else { separator.character() as u8 })
            .quoting(separator != Separator::Space)
            .from_reader(text.as_bytes());
        Self { path, text, separator, reader, cells: csv::StringRecord::new(), start: 0, line: 1, width: None }
    }

    /// The rows after the lines that a layout skips.
    pub(crate) fn after(path: &'a Path, text: &'a str, layout: &Layout) -> Self {
        let skipped: usize = text.split_inclusive('\n').take(layout.skip_lines).map(str::len).sum();
        let mut records = Self::new(path, &text[skipped..], layout.separator);
        records.line += newlines(&text[..skipped]);
        records
    }

    /// Goes to the next row; false if there is none.
    pub(crate) fn advance(&mut self) -> Result<bool> {
        let wrong = |error: csv::Error| Error::data(error.to_string()).in_file(self.path);
        loop {
            // Before the comments and blank lines that `csv` skips.
            let from = self.reader.position().byte() as usize;
            let start = from + skipped(self.text.get(from..).unwrap_or(""));
            self.no_row_beyond_measure(from, start)?;
            let is_row = self.reader.read_record(&mut self.cells).map_err(wrong)?;
            let line = self.line + newlines(self.text.get(self.start..from).unwrap_or(""));
            let comments = self.text.get(from..start).unwrap_or("");
            for (at, comment) in comments.split('\n').enumerate() {
                no_lost_row(self.path, line + at, comment)?;
            }
            if !is_row {
                return Ok(false);
            }
            (self.line, self.start) = (line + newlines(comments), start);
            if self.cells.len() == 1 && self.cells[0].trim().is_empty() {
                continue;
            }
            if self.separator == Separator::Space {
                self.cells = self.cells.iter().flat_map(str::split_whitespace).collect::<Vec<_>>().into();
            }
            let found = self.cells.len();
            if found > MOST_CELLS {
                return Err(self.too_wide(self.line, found));
            }
            self.width.get_or_insert(found);
            // A superfluous quotation mark makes such a cell; it would contain several rows.
            let is_open = newlines(self.cells.as_slice()) > 0;
            if let Some(cell) = self.cells.iter().position(|cell| is_open && cell.contains(['\n', '\r'])) {
                let error = Error::data("a quotation mark is not closed in its line")
                    .help("close it, or take it out; a text with a quotation mark in it has it twice");
                return Err(self.at_cell(error, cell));
            }
            if self.cells.as_slice().len() > LONGEST_CELL
                && let Some(cell) = self.cells.iter().position(|cell| cell.len() > LONGEST_CELL)
            {
                let length = self.cells[cell].len().div_ceil(1024);
                let message = format!("a cell has {length} KiB; at most {} are read", LONGEST_CELL >> 10);
                let error = Error::data(message).help("is it a table? `abbe data FILE` shows what is understood of it");
                return Err(self.at_cell(error, cell));
            }
            return Ok(true);
        }
    }

    /// Goes to the header row and reads it, if there is one.
    fn header(&mut self) -> Result<Option<Vec<ColumnHeader>>> {
        if !self.advance().map_err(|error| Error { class: Class::Use, ..error })? {
            return Ok(None);
        }
        if let Some((separator, setting)) = other_separator(&self.cells, self.separator) {
            let expected = self.separator.expected();
            let message = format!("the columns are separated by {separator}; {expected} was expected");
            let help = format!(
                "write `separator: {setting}` where it is read by `ingest: csv`, or save the table with commas, and with points in its numbers"
            );
            return Err(self.at_cell(Error::usage(message).help(help), 0));
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
            let help = match twin {
                Some(twin) if twin.header.parse::<f64>().is_ok() => NUMBERS,
                Some(_) => TWINS,
                None => {
                    "give it one, or take columns by name: `columns: { X_mm: NAME }` where it is read by `ingest: csv`"
                }
            };
            return Err(self.at_cell(Error::usage(message).help(help), index));
        }
        Ok(Some(headers))
    }

    /// Reads the header row, if there is one, as it is written.
    fn names(&mut self) -> Result<Option<Vec<String>>> {
        if !self.advance().map_err(|error| Error { class: Class::Use, ..error })? {
            return Ok(None);
        }
        Ok(Some(self.cells.iter().map(|cell| cell.trim().to_owned()).collect()))
    }

    /// Where the column `name` stands in the header row, which is the current one.
    fn place_of(&self, name: &str, names: &[String]) -> Result<usize> {
        let mut places = (0..names.len()).filter(|&place| names[place] == name.trim());
        match (places.next(), places.next()) {
            (Some(place), None) => Ok(place),
            (Some(_), Some(twin)) => {
                let error = Error::usage(format!("there are two columns `{}`", shown(name))).help(TWINS);
                Err(self.at_cell(error, twin))
            }
            _ => {
                let named: Vec<String> = names.iter().map(|name| format!("`{}`", shown(name))).collect();
                let message = format!("there is no column `{}`; the columns are {}", shown(name), named.join(", "));
                Err(Error::usage(message).at(self.path, self.line, None).help(
                    "`skip_lines` says how many lines stand before the row of names, `separator` what is between them",
                ))
            }
        }
    }

    /// A cell of the current row.
    fn cell(&self, column: &Taken) -> Result<&str> {
        self.cells.get(column.index).ok_or_else(|| {
            let message = format!("the row has {} cells, and none for `{}`", self.cells.len(), column.header.header);
            Error::data(message).at(self.path, self.line, None).help(RAGGED)
        })
    }

    /// Refuses a row of far too many cells before any is made of it: each would take room.
    fn no_row_beyond_measure(&self, from: usize, start: usize) -> Result<()> {
        let rest = self.text.get(start..).unwrap_or("");
        let row = &rest[..rest.find('\n').unwrap_or(rest.len())];
        // Separators within quotation marks separate nothing.
        if row.len() <= MOST_CELLS || row.contains('"') {
            return Ok(());
        }
        let found = match self.separator {
            Separator::Space => row.split_whitespace().count(),
            separator => row.matches(separator.character()).count() + 1,
        };
        if found <= MOST_CELLS {
            return Ok(());
        }
        let before = newlines(self.text.get(self.start..from).unwrap_or("")) + newlines(&self.text[from..start]);
        Err(self.too_wide(self.line + before, found))
    }

    fn too_wide(&self, line: usize, found: usize) -> Error {
        match self.width {
            Some(width) => ragged(self.path, line, found, width),
            None => Error::data(format!("the row has {found} cells; at most {MOST_CELLS} are read"))
                .at(self.path, line, None)
                .help("is it a table? each row needs a line of its own"),
        }
    }

    /// Points at a cell of the current row.
    fn at_cell(&self, error: Error, cell: usize) -> Error {
        let row = self.text.get(self.start..).unwrap_or("");
        error.at(self.path, self.line, Some(row[..cell_start(row, cell, self.separator)].chars().count() + 1))
    }
}

/// What separates the columns where a header row is not separated as expected: for a message, and as a setting.
fn other_separator(header: &csv::StringRecord, expected: Separator) -> Option<(&'static str, &'static str)> {
    let line = header.get(0).filter(|_| header.len() == 1)?.trim();
    // A name may have spaces in it; its unit ends it.
    let is_column = |name: &str| ColumnHeader::parse(name).quantity != Quantity::Label;
    let separates = |separator| match separator {
        ' ' => line.rsplit_once(' ').is_some_and(|(before, _)| before.split(' ').any(is_column)),
        _ => line.contains(separator),
    };
    let mut others = Separator::ALL.into_iter().filter(|(separator, ..)| *separator != expected);
    others.find(|(_, character, ..)| separates(*character)).map(|(_, _, name, setting)| (name, setting))
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
fn cell_start(row: &str, cell: usize, separator: Separator) -> usize {
    let is_space = |c: char| c.is_whitespace() && !['\n', '\r'].contains(&c);
    if separator == Separator::Space {
        let row_end = row.find(['\n', '\r']).unwrap_or(row.len());
        let starts = row[..row_end].char_indices().scan(true, |after_space, (at, character)| {
            let begins = *after_space && !character.is_whitespace();
            *after_space = character.is_whitespace();
            Some(begins.then_some(at))
        });
        return starts.flatten().nth(cell).unwrap_or(0);
    }
    let (mut index, mut start, mut open) = (0, 0, false);
    for (at, character) in row.char_indices() {
        match character {
            _ if index == cell => break,
            '"' if row[start..].starts_with('"') => open = !open,
            _ if character == separator.character() && !open => {
                index += 1;
                start = at + character.len_utf8();
            }
            _ => {}
        }
    }
    let content = row[start..].trim_start_matches(is_space);
    row.len() - content.len()
}
