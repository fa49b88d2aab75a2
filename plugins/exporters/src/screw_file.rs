//! Reads screw compensation files of LinuxCNC.

use std::path::Path;

use abbe_core::{Error, Result};
use abbe_files::{LARGEST_TEXT, read_text};

/// The lines of a file: nominal position, and what stands there for both directions.
///
/// Fails for a line that LinuxCNC would not read, and for more than `most` lines.
pub fn read(path: &Path, most: usize) -> Result<Vec<[f64; 3]>> {
    let text = read_text(path, LARGEST_TEXT)
        .map_err(|error| Error::data(format!("it cannot be read: {error}")).in_file(path))?;
    let mut rows: Vec<[f64; 3]> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let wrong = |message: &str| Err(Error::data(message).at(path, index + 1, None));
        let cells: Vec<f64> = line.split_whitespace().map_while(|cell| cell.parse().ok()).collect();
        let &[nominal, forward, reverse] = cells.as_slice() else {
            return wrong("three numbers were expected; LinuxCNC reads no further than such a line");
        };
        if !cells.iter().all(|cell| cell.is_finite()) || rows.last().is_some_and(|last| last[0] >= nominal) {
            return wrong("finite numbers were expected, with increasing positions");
        }
        rows.push([nominal, forward, reverse]);
    }
    match rows.len() {
        count if (1..=most).contains(&count) => Ok(rows),
        count => Err(Error::data(format!("1 to {most} points were expected, {count} were found")).in_file(path)),
    }
}
