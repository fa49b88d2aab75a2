//! What is refused, and where.

use std::path::Path;

use abbe_core::Error;

use crate::dialect::Dialect;

/// Something in a line that cannot be corrected.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// Where it stands in the line, bytes from 0.
    pub column: usize,
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub help: String,
}

impl Refusal {
    /// A word that cannot be handled: `G41`, and what it is.
    pub fn new(column: usize, word: &str, what: &str, help: &str) -> Self {
        let message = if word.is_empty() { what.to_owned() } else { format!("`{word}`: {what}") };
        Self { column, message, help: help.to_owned() }
    }

    /// The same where the control's own interpreter may write out what is to be written out.
    pub(crate) fn or_written_out(mut self, dialect: Dialect) -> Self {
        if dialect == Dialect::Linuxcnc && self.help.starts_with("write out ") {
            self.help.push_str("; LinuxCNC's interpreter does it with `--write-out`");
        }
        self
    }

    /// The error of a line; lines count from 1.
    pub fn at(self, file: &Path, line: usize, text: &[u8]) -> Error {
        let before = &text[..self.column.min(text.len())];
        let column = String::from_utf8_lossy(before).chars().count() + 1;
        Error::data(self.message).help(self.help).at(file, line, Some(column))
    }
}
