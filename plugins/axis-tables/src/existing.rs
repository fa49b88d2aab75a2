//! Files with tables that are active in the control already.

use std::path::Path;

use abbe_core::{Error, Result};
use abbe_files::{LARGEST_TEXT, read_text};

/// The text of a file that a setting names.
pub fn text(path: &Path) -> Result<String> {
    read_text(path, LARGEST_TEXT)
        .map_err(|error| Error::data(format!("it cannot be read: {error}")).in_file(path).setting("existing"))
}

/// An error at a line of such a file, counted from 0.
pub fn wrong(path: &Path, line: usize, message: impl Into<String>) -> Error {
    Error::data(message).at(path, line + 1, None).setting("existing")
}
