//! The text of a table with other numbers in it.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Error, Result};

use crate::parse;
use crate::text::text;

/// New contents of cells: by line (from 1), then by the header of the column as the file writes it.
pub type Cells = BTreeMap<usize, BTreeMap<String, String>>;

/// The text of a file ([`crate::read_text`]) in which some cells have other contents; everything else stays as it is.
///
/// Fails for a column that the file does not have, and as reading it does.
pub fn with_cells(path: &Path, bytes: &[u8], cells: &Cells) -> Result<String> {
    let headers = parse::headers(path, bytes)?;
    let text = text(path, bytes)?;
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
