//! The text of a table with other numbers in it.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Error, Result};

use crate::layout::Encoding;
use crate::parse;
use crate::text::text;

/// New contents of cells: by line (from 1), then by the header of the column as the file writes it.
pub type Cells = BTreeMap<usize, BTreeMap<String, String>>;

/// The text of a file ([`crate::read_text`]) in which some cells have other contents; everything else stays as it is.
///
/// Fails for a column that the file does not have, and as reading it does.
pub fn with_cells(path: &Path, bytes: &[u8], cells: &Cells) -> Result<String> {
    let headers = parse::headers(path, bytes)?;
    let text = text(path, bytes, Encoding::Utf8)?;
    let mut written = String::with_capacity(text.len());
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let Some(cells) = cells.get(&(index + 1)) else {
            written.push_str(line);
            continue;
        };
        let content = line.trim_end_matches(['\n', '\r']);
        let mut row = parse::cells(path, content)?;
        for (name, cell) in cells {
            let column = headers.iter().position(|header| header.header == *name);
            let place = column.and_then(|column| row.get_mut(column)).ok_or_else(|| {
                Error::usage(format!("`{name}` is no column of this file, so that nothing can be recorded there"))
                    .in_file(path)
                    .help("give the file this column; `constants` and joined tables are not written")
            })?;
            place.clone_from(cell);
        }
        written.push_str(&parse::line(path, &row)?);
        written.push_str(&line[content.len()..]);
    }
    Ok(written)
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
