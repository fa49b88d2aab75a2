//! The text of a table with other numbers in it.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{ColumnHeader, Error, Quantity, Result};

use crate::layout::{Encoding, Layout, Unit};
use crate::parse;
use crate::text::{encoded, text};

/// New contents of cells: by line (from 1), then by the header of the column as the file writes it.
pub type Cells = BTreeMap<usize, BTreeMap<String, String>>;

/// The text of a file ([`crate::read_text`]) in which some cells have other contents; everything else stays as it is.
///
/// Fails for a column that the file does not have, and as reading it does.
pub fn with_cells(path: &Path, bytes: &[u8], cells: &Cells) -> Result<String> {
    rewritten(path, bytes, cells, &Layout::default())
}

/// The bytes of a file with a layout of its own in which some cells have other contents, named and written as the data set has them;
/// everything else stays as it is. The lines of `comment` stand before the table.
///
/// Fails for a column that the file does not have, and as reading it does.
pub fn with_cells_laid_out(
    path: &Path,
    bytes: &[u8],
    cells: &Cells,
    layout: &Layout,
    comment: &str,
) -> Result<Vec<u8>> {
    let text = rewritten(path, bytes, cells, layout)?;
    let skipped: usize = text.split_inclusive('\n').take(layout.skip_lines).map(str::len).sum();
    let (before, table) = text.split_at(skipped);
    Ok(encoded(&format!("{before}{comment}{table}"), layout.encoding))
}

fn rewritten(path: &Path, bytes: &[u8], cells: &Cells, layout: &Layout) -> Result<String> {
    let text = text(path, bytes, layout.encoding)?;
    let places = parse::places(path, &text, layout)?;
    let mut written = String::with_capacity(text.len());
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let Some(cells) = cells.get(&(index + 1)) else {
            written.push_str(line);
            continue;
        };
        let content = line.trim_end_matches(['\n', '\r']);
        let mut row = parse::cells(path, content, layout.separator)?;
        for (name, cell) in cells {
            let place = places.iter().find(|(header, ..)| header.header == *name);
            let own = place.and_then(|(header, column, unit)| Some((header, row.get_mut(*column)?, *unit)));
            let (header, own, unit) = own.ok_or_else(|| {
                Error::usage(format!("`{name}` is no column of this file, so that nothing can be recorded there"))
                    .in_file(path)
                    .help("give the file this column; `constants` and joined tables are not written")
            })?;
            *own = as_laid_out(header, cell, unit, layout);
        }
        written.push_str(&parse::line(path, &row, layout.separator)?);
        written.push_str(&line[content.len()..]);
    }
    Ok(written)
}

/// A cell of the data set as the file writes it: in its unit, with its decimal character.
fn as_laid_out(header: &ColumnHeader, cell: &str, unit: Option<Unit>, layout: &Layout) -> String {
    let Ok(number) = cell.trim().parse::<f64>() else { return cell.to_owned() };
    if header.quantity == Quantity::Label {
        return cell.to_owned();
    }
    let (.., factor) = Quantity::of_column(&header.header);
    let written = unit.map_or_else(|| cell.to_owned(), |unit| unit.write(number * factor));
    written.replace('.', &layout.decimal.character().to_string())
}

/// The text of a file ([`crate::read_text`]) with columns more after its own: `headers`, and for every line of data (from 1) their
/// contents. Everything else stays as it is.
///
/// Fails if the file has one of these columns, and as reading it does.
pub fn with_columns(
    path: &Path,
    bytes: &[u8],
    headers: &[&str],
    cells: &BTreeMap<usize, Vec<String>>,
) -> Result<String> {
    let own = parse::headers(path, bytes)?;
    if let Some(taken) = headers.iter().find(|header| own.iter().any(|own| own.header == **header)) {
        return Err(Error::data(format!("there is a column `{taken}` already")).in_file(path));
    }
    let text = text(path, bytes, Encoding::Utf8)?;
    let mut written = String::with_capacity(2 * text.len());
    let mut has_header = false;
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let content = line.trim_end_matches(['\n', '\r']);
        written.push_str(content);
        let more = match cells.get(&(index + 1)) {
            Some(cells) => cells.join(","),
            // The first line that is neither a comment nor empty.
            None if !has_header && !content.is_empty() && !content.starts_with('#') => headers.join(","),
            None => String::new(),
        };
        if !more.is_empty() {
            has_header = true;
            written.extend([",", &more]);
        }
        written.push_str(&line[content.len()..]);
    }
    Ok(written)
}
