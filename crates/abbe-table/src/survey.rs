//! What a file seems to be, for people who are about to declare it, and what it holds when it is read as declared.
//!
//! No measurement is read this way: `ingest: csv` follows its settings alone. No unit is ever proposed.

mod faults;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{ColumnHeader, Error, Quantity, Result};

use self::faults::{TIME, is_time, jumps, summaries, twins};
use crate::layout::{Decimal, Encoding, Layout, Separator, Thousands};
use crate::number::{is_number, plain};
use crate::parse::{LONGEST_CELL, Records, ragged};
use crate::text::{LONGEST_LINE, NO_LINE_END, may_be_utf_16, text};

/// Rows that are looked at to find a layout.
const LOOKED_AT: usize = 500;

/// What a file seems to be.
#[derive(Debug, Clone, PartialEq)]
pub struct Likely {
    /// The layout, without `columns`.
    pub layout: Layout,
    /// What the file does not tell: sentences.
    pub open: Vec<String>,
}

/// The content of a file, read with a layout.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contents {
    /// Names of the columns: those of the header row, else their numbers.
    pub columns: Vec<Found>,
    /// Line of the header row.
    pub header_line: Option<usize>,
    /// Number of rows of data.
    pub rows: usize,
    /// Lines of the first and of the last row of data.
    pub lines: (usize, usize),
    /// The first rows.
    pub first: Vec<Vec<String>>,
    /// Rows with another number of cells than the first: line and cells.
    pub ragged: Vec<(usize, usize)>,
    /// Rows that are the same as an earlier one in all columns but one in front that counts the rows: lines of both.
    pub repeated: Vec<(usize, usize)>,
    /// Lines that begin with `#`.
    pub comments: usize,
    /// Jumps of the time of rows, the column `time_s` (or in another unit).
    pub jumps: Vec<Jump>,
    /// Other columns that seem to be times: their order is not looked at.
    pub other_times: Vec<String>,
    /// Names that several columns have.
    pub twins: Vec<String>,
    /// Rows at the end that seem to be sums or means of those before them.
    pub summaries: Vec<Summary>,
}

/// A row of sums or means at the end of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Its line.
    pub line: usize,
    /// The column of the word that says so, by its index.
    pub column: usize,
    /// The word.
    pub word: String,
}

/// A column of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Found {
    /// Its name in the file.
    pub name: String,
    /// Cells that are numbers.
    pub numbers: usize,
    /// Least and largest of them, as they are written.
    pub range: Option<[f64; 2]>,
    /// Empty cells.
    pub empty: usize,
    /// Other texts, with the number of cells of each.
    pub texts: BTreeMap<String, usize>,
}

/// Different texts that are counted of a column.
const TEXTS: usize = 1000;

impl Found {
    /// Whether most of its cells are numbers.
    pub fn is_numeric(&self) -> bool {
        let texts: usize = self.texts.values().sum();
        self.numbers > 0 && self.numbers >= texts + self.empty
    }

    /// Its texts that stand in the place of numbers, the most frequent first.
    pub fn marks(&self) -> Vec<(&str, usize)> {
        let mut marks: Vec<(&str, usize)> = self.texts.iter().map(|(text, count)| (text.as_str(), *count)).collect();
        if self.empty > 0 {
            marks.push(("", self.empty));
        }
        marks.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        marks
    }
}

/// A place where a time jumps or goes back.
#[derive(Debug, Clone, PartialEq)]
pub struct Jump {
    /// The column.
    pub column: String,
    /// Line of the row behind it.
    pub line: usize,
    /// The step, in the unit of the column.
    pub step: f64,
    /// The usual step.
    pub usual: f64,
}

/// How a file seems to be laid out. Fails only for what is no text in any encoding.
pub fn likely(path: &Path) -> Result<Likely> {
    likely_of(path, &crate::bytes_of(path)?)
}

pub(crate) fn likely_of(path: &Path, bytes: &[u8]) -> Result<Likely> {
    let mut open = Vec::new();
    let encoding = encoding_of(bytes);
    if matches!(encoding, Encoding::Latin1 | Encoding::Gb18030) {
        open.push(format!("the characters do not say their encoding for certain; {} is likely", encoding.name()));
    }
    let text = text(path, bytes, encoding)?;
    let lines: Vec<(usize, &str)> = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'))
        .take(LOOKED_AT)
        .collect();
    if let Some((at, _)) = lines.iter().find(|(_, line)| line.len() > LONGEST_LINE) {
        return Err(Error::data(NO_LINE_END).at(path, at + 1, None).help("name another file"));
    }
    let separator = separator_of(&lines);
    let rows: Vec<(usize, Vec<String>)> = lines.iter().map(|(at, line)| (*at, cells(line, separator))).collect();
    let width = usual_width(&rows);
    lines.iter().try_for_each(|(at, line)| no_longest_cell(path, *at, line, separator, width))?;
    let all: Vec<&str> =
        rows.iter().filter(|(_, row)| row.len() == width).flat_map(|(_, row)| row).map(String::as_str).collect();
    let (decimal, thousands) = numbers_of(&all, separator, &mut open);
    let layout = Layout { encoding, separator, decimal, thousands, ..Layout::default() };
    let layout = header_of(&rows, width, &text, layout);
    let found = contents_of(path, &text, &layout)?;
    let mut no_data = BTreeSet::new();
    for column in found.columns.iter().filter(|column| column.is_numeric()) {
        no_data.extend(column.marks().into_iter().map(|(mark, _)| mark.to_owned()));
    }
    let no_data = if no_data.len() > MARKS { Vec::new() } else { no_data.into_iter().collect() };
    Ok(Likely { layout: Layout { no_data, ..layout }, open })
}

/// Most different marks of numbers that were not measured.
const MARKS: usize = 4;

fn encoding_of(bytes: &[u8]) -> Encoding {
    if may_be_utf_16(bytes) {
        return Encoding::Utf16;
    }
    if std::str::from_utf8(bytes).is_ok() {
        return Encoding::Utf8;
    }
    // Characters of GB 2312 have two bytes above 0x7F; letters with accents mostly stand alone.
    let mut runs = bytes.split(u8::is_ascii).filter(|run| !run.is_empty());
    match runs.all(|run| run.len() % 2 == 0) {
        true => Encoding::Gb18030,
        false => Encoding::Latin1,
    }
}

fn cells(line: &str, separator: Separator) -> Vec<String> {
    let mut records = Records::new(Path::new(""), line, separator);
    match records.advance() {
        Ok(true) => records.cells.iter().map(|cell| cell.trim().to_owned()).collect(),
        _ => vec![line.to_owned()],
    }
}

/// Refuses a row of the table, its row of names too, with a cell that is longer than any that is read. Lines that are no rows of the table
/// may be longer.
fn no_longest_cell(path: &Path, at: usize, line: &str, separator: Separator, width: usize) -> Result<()> {
    if line.len() <= LONGEST_CELL {
        return Ok(());
    }
    let mut records = Records::new(path, line, separator);
    records.line += at;
    let read = records.advance();
    if records.cells.len() == width { read.map(drop) } else { Ok(()) }
}

/// Any way to write a number.
fn seems_numeric(cell: &str) -> bool {
    let ways = [
        (Decimal::Point, Thousands::None),
        (Decimal::Comma, Thousands::None),
        (Decimal::Comma, Thousands::Blank),
        (Decimal::Point, Thousands::Blank),
        (Decimal::Comma, Thousands::Point),
        (Decimal::Point, Thousands::Comma),
        (Decimal::Point, Thousands::Apostrophe),
    ];
    ways.into_iter().any(|(decimal, thousands)| is_number(cell, decimal, thousands))
}

/// The width that most rows have.
fn usual_width(rows: &[(usize, Vec<String>)]) -> usize {
    let mut widths: BTreeMap<usize, usize> = BTreeMap::new();
    rows.iter().for_each(|(_, row)| *widths.entry(row.len()).or_default() += 1);
    widths.into_iter().max_by_key(|(width, count)| (*count, *width)).map_or(1, |(width, _)| width)
}

/// The separator that cuts most lines into the same number of cells, of which most are numbers.
fn separator_of(lines: &[(usize, &str)]) -> Separator {
    let order = [Separator::Semicolon, Separator::Tab, Separator::Stroke, Separator::Comma, Separator::Space];
    let mut best = (0.0, Separator::Comma);
    for separator in order {
        let rows: Vec<(usize, Vec<String>)> = lines.iter().map(|(at, line)| (*at, cells(line, separator))).collect();
        let width = usual_width(&rows);
        if width < 2 {
            continue;
        }
        let usual: Vec<&Vec<String>> = rows.iter().map(|(_, row)| row).filter(|row| row.len() == width).collect();
        let all: Vec<&String> = usual.iter().flat_map(|row| row.iter()).filter(|cell| !cell.is_empty()).collect();
        let numeric = all.iter().filter(|cell| seems_numeric(cell)).count() as f64 / all.len().max(1) as f64;
        let score = usual.len() as f64 / rows.len() as f64 * (0.2 + numeric);
        if score > best.0 * (1.0 + 1e-9) {
            best = (score, separator);
        }
    }
    best.1
}

/// The decimal character and the separator of thousands that fit most cells; what cannot be told is added to `open`.
fn numbers_of(cells: &[&str], separator: Separator, open: &mut Vec<String>) -> (Decimal, Thousands) {
    let fitting = |decimal, thousands| cells.iter().filter(|cell| is_number(cell, decimal, thousands)).count();
    // The simplest that fits most: later ones have to fit more.
    let mut best = (fitting(Decimal::Point, Thousands::None), Decimal::Point, Thousands::None);
    let mut others = vec![
        (Decimal::Comma, Thousands::None),
        (Decimal::Point, Thousands::Blank),
        (Decimal::Comma, Thousands::Blank),
        (Decimal::Comma, Thousands::Point),
        (Decimal::Point, Thousands::Comma),
        (Decimal::Point, Thousands::Apostrophe),
    ];
    if separator == Separator::Comma {
        // Who separates columns by commas writes 1,234 for a thousand, in quotation marks.
        others.rotate_right(2);
    }
    for (decimal, thousands) in others {
        if separator == Separator::Space && thousands == Thousands::Blank {
            continue;
        }
        let count = fitting(decimal, thousands);
        if count > best.0 {
            best = (count, decimal, thousands);
        }
    }
    let (_, decimal, thousands) = best;
    open.extend(ambiguous(cells, separator, (decimal, thousands)));
    (decimal, thousands)
}

/// What else all numbers with a mark may be: 1,234 is a thousand or has three decimals.
fn ambiguous(cells: &[&str], separator: Separator, read: (Decimal, Thousands)) -> Option<String> {
    let (mark, other, advice) = match read {
        (Decimal::Comma, Thousands::None) => (
            ',',
            (Decimal::Point, Thousands::Comma),
            "if that is more than a thousand, write `thousands: comma` and leave `decimal` out",
        ),
        (Decimal::Point, Thousands::Comma) => (
            ',',
            (Decimal::Comma, Thousands::None),
            "if that is a number with three decimals, write `decimal: comma` and leave `thousands` out",
        ),
        // Where commas separate columns, the point is the decimal mark.
        (Decimal::Point, Thousands::None) if separator != Separator::Comma => (
            '.',
            (Decimal::Comma, Thousands::Point),
            "if that is more than a thousand, write `decimal: comma` and `thousands: point`",
        ),
        _ => return None,
    };
    let is = |cell: &&&str, (decimal, thousands)| is_number(cell, decimal, thousands);
    let mut marked = cells.iter().filter(|cell| cell.contains(mark) && is(cell, read)).peekable();
    let example = *marked.peek()?;
    let is_open = marked.all(|cell| is(&cell, other) && is(&cell, read));
    let name = if mark == ',' { "comma" } else { "point" };
    is_open.then(|| format!("every number with a {name} is like `{example}`: {advice}"))
}

/// Adds where the header row and the first row of data are.
fn header_of(rows: &[(usize, Vec<String>)], width: usize, text: &str, layout: Layout) -> Layout {
    let numeric = |cell: &String| is_number(cell, layout.decimal, layout.thousands);
    let usual: Vec<&(usize, Vec<String>)> = rows.iter().filter(|(_, row)| row.len() == width).collect();
    let columns: Vec<usize> = (0..width)
        .filter(|&column| 2 * usual.iter().filter(|(_, row)| numeric(&row[column])).count() > usual.len().max(2))
        .collect();
    // A table of one row below its names has too few rows for that.
    let is_data = |row: &[String]| match columns.is_empty() {
        true => row.iter().any(numeric),
        false => columns.iter().any(|&column| numeric(&row[column])),
    };
    let data = usual.iter().position(|(_, row)| is_data(row)).unwrap_or(usual.len().min(1));
    let filled = |row: &[String]| row.iter().filter(|cell| !cell.is_empty()).count();
    let most = usual[..data].iter().map(|(_, row)| filled(row)).max();
    let header = most.and_then(|most| usual[..data].iter().find(|(_, row)| filled(row) == most));
    let first = header.or_else(|| usual.get(data)).map_or(0, |(at, _)| *at);
    let before = text.lines().take(first);
    let is_content = |line: &str| !line.trim().is_empty() && !line.starts_with('#');
    let skip_lines = if before.clone().any(is_content) { first } else { 0 };
    let between = |(at, _): &&(usize, Vec<String>)| usual.get(data).is_some_and(|(data, _)| *at > first && at < data);
    Layout {
        skip_lines,
        has_header: header.is_some(),
        skip_after_header: if header.is_some() { rows.iter().filter(between).count() } else { 0 },
        ..layout
    }
}

/// What a file holds, read with a layout. Its `columns` are not looked at; cells that do not fit are counted, not refused.
pub fn contents(path: &Path, layout: &Layout) -> Result<Contents> {
    let bytes = crate::bytes_of(path)?;
    let text = text(path, &bytes, layout.encoding)?;
    contents_of(path, &text, layout)
}

/// Rows that are shown.
const FIRST: usize = 5;

/// How many times more cells than columns a row may have, and how many more: what has still more is no row of this table.
const WIDER: (usize, usize) = (10, 1000);

/// How many times more cells than bytes a table may seem to have, each column in each row counted: more is where hardly a row fills it.
const EMPTIER: usize = 16;

fn contents_of(path: &Path, text: &str, layout: &Layout) -> Result<Contents> {
    let mut found =
        Contents { comments: text.lines().filter(|line| line.starts_with('#')).count(), ..Contents::default() };
    let mut records = Records::after(path, text, layout);
    if layout.has_header && records.advance()? {
        found.header_line = Some(records.line);
        let named = |name: &str| Found { name: name.trim().to_owned(), ..Found::default() };
        found.columns = records.cells.iter().map(named).collect();
    }
    for _ in 0..layout.skip_after_header {
        records.advance()?;
    }
    let (mut rows, mut lines): (Vec<Vec<String>>, Vec<usize>) = (Vec::new(), Vec::new());
    while records.advance()? {
        let cells = records.cells.len();
        if found.columns.is_empty() {
            let numbered = |index: usize| Found { name: (index + 1).to_string(), ..Found::default() };
            found.columns = (0..cells).map(numbered).collect();
        }
        let columns = found.columns.len();
        if cells > WIDER.0 * columns + WIDER.1 {
            return Err(ragged(path, records.line, cells, columns));
        }
        if cells != columns {
            found.ragged.push((records.line, cells));
        }
        rows.push(records.cells.iter().map(|cell| cell.trim().to_owned()).collect());
        lines.push(records.line);
    }
    // Each column is looked at in each row.
    if let Some((line, cells)) = found.ragged.first()
        && rows.len().saturating_mul(found.columns.len()) / EMPTIER > text.len()
    {
        return Err(ragged(path, *line, *cells, found.columns.len()));
    }
    found.rows = rows.len();
    found.lines = (lines.first().copied().unwrap_or(0), lines.last().copied().unwrap_or(0));
    found.first = rows.iter().take(FIRST).cloned().collect();
    let mut counters = Vec::new();
    for index in 0..found.columns.len() {
        let cells: Vec<&str> = rows.iter().map(|row| row.get(index).map_or("", String::as_str)).collect();
        let numbers = describe(&mut found.columns[index], &cells, layout);
        let header = ColumnHeader::parse(declared(&found.columns[index].name, layout));
        match (header.quantity, header.name == TIME) {
            (Quantity::Time, true) => found.jumps.extend(jumps(&header.header, &numbers, &lines)),
            (Quantity::Label, _) if !is_time(&header.name, &cells) => {}
            (Quantity::Time | Quantity::Label, _) => found.other_times.push(found.columns[index].name.clone()),
            _ => {}
        }
        let whole = numbers.len() == rows.len() && numbers.windows(2).all(|pair| pair[1].1 - pair[0].1 == 1.0);
        // A number of rows stands in front and has no unit; other columns may count by chance.
        counters.push(index == 0 && header.quantity == Quantity::Label && whole && rows.len() > 1);
    }
    found.twins = twins(&found.columns);
    found.summaries = summaries(&rows, &lines);
    // Cells are compared where they are: copies of wide rows would take as much memory again.
    let compared = |index: usize| !counters.get(index).copied().unwrap_or(false);
    let mut seen: BTreeMap<Vec<&str>, usize> = BTreeMap::new();
    let filled = rows.iter().zip(&lines).filter(|(row, _)| row.iter().any(|cell| !cell.is_empty()));
    for (row, &line) in filled {
        let cells: Vec<&str> =
            row.iter().enumerate().filter(|(index, _)| compared(*index)).map(|(_, cell)| cell.as_str()).collect();
        let earlier = *seen.entry(cells).or_insert(line);
        if earlier != line {
            found.repeated.push((earlier, line));
        }
    }
    Ok(found)
}

/// The name that a column of a file has in the data set.
fn declared<'a>(name: &'a str, layout: &'a Layout) -> &'a str {
    let mut columns = layout.columns.iter().flatten();
    columns.find(|(_, source)| source.column == name).map_or(name, |(declared, _)| declared)
}

/// Fills in what the cells of a column are; gives its numbers with their rows.
fn describe(column: &mut Found, cells: &[&str], layout: &Layout) -> Vec<(usize, f64)> {
    let mut numbers = Vec::new();
    for (row, cell) in cells.iter().enumerate() {
        let number = plain(cell, layout.decimal, layout.thousands).and_then(|cell| cell.parse::<f64>().ok());
        match number.filter(|number| number.is_finite()) {
            _ if !cell.is_empty() && layout.is_mark(cell) => {
                *column.texts.entry((*cell).to_owned()).or_default() += 1;
            }
            Some(number) => numbers.push((row, number)),
            None if cell.is_empty() => column.empty += 1,
            None if column.texts.len() < TEXTS || column.texts.contains_key(*cell) => {
                *column.texts.entry((*cell).to_owned()).or_default() += 1;
            }
            None => {}
        }
    }
    column.numbers = numbers.len();
    let least = numbers.iter().map(|(_, number)| *number).fold(f64::INFINITY, f64::min);
    let largest = numbers.iter().map(|(_, number)| *number).fold(f64::NEG_INFINITY, f64::max);
    column.range = (!numbers.is_empty()).then_some([least, largest]);
    numbers
}

#[cfg(test)]
mod tests;
