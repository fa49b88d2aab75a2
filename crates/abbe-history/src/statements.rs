//! What is asked of a history, in words that SQLite and PostgreSQL understand alike.

/// The number of an entry by its hash.
pub(crate) const KNOWN: &str = "SELECT number FROM entry WHERE sha256 = $1";

/// Adds an entry under the next number.
pub(crate) const ADD_ENTRY: &str = "INSERT INTO entry (number, sha256, recipe, verdicts, evidence) \
     VALUES ((SELECT coalesce(max(number), 0) + 1 FROM entry), $1, $2, $3, $4) RETURNING number";

/// Adds a calibration to an entry.
pub(crate) const ADD_CALIBRATION: &str = "INSERT INTO calibration (entry, machine, estimate, label, at, unit, content) \
     VALUES ($1, $2, $3, $4, $5, $6, $7)";

/// The entries, the oldest first.
pub(crate) const ENTRIES: &str = "SELECT number, sha256, recipe FROM entry ORDER BY number";

/// The last ones before a number, the last first.
pub(crate) const ENTRIES_BEFORE: &str =
    "SELECT number, sha256, recipe FROM entry WHERE number < $1 ORDER BY number DESC LIMIT $2";

/// One entry.
pub(crate) const ENTRY: &str = "SELECT sha256, recipe, verdicts, evidence FROM entry WHERE number = $1";

/// Its calibrations, in the order in which they were added.
pub(crate) const OF_ENTRY: &str =
    "SELECT entry, machine, label, at, unit, content FROM calibration WHERE entry = $1 ORDER BY rowid";

/// The machines with the number of their calibrations.
pub(crate) const MACHINES: &str = "SELECT machine, count(*) FROM calibration GROUP BY machine";

/// When the last calibration of a machine was.
pub(crate) const LAST: &str =
    "SELECT label, unit FROM calibration WHERE machine = $1 ORDER BY at DESC, entry DESC LIMIT 1";

/// All calibrations in the order of time.
pub(crate) const ALL: &str = "SELECT entry, machine, label, at, unit, content FROM calibration ORDER BY at, entry";

/// Those of one machine.
pub(crate) const OF_MACHINE: &str =
    "SELECT entry, machine, label, at, unit, content FROM calibration WHERE machine = $1 ORDER BY at, entry";

/// A value in a row, or one that a statement is given.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cell {
    Integer(i64),
    Real(f64),
    Text(String),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

/// The cells of a row, one after the other. A cell of another kind than what is asked for is a fault of the tables.
pub(crate) struct Cells(std::vec::IntoIter<Cell>);

impl Cells {
    pub(crate) fn new(row: Vec<Cell>) -> Self {
        Self(row.into_iter())
    }

    pub(crate) fn integer(&mut self) -> Option<i64> {
        match self.0.next()? {
            Cell::Integer(number) => Some(number),
            _ => None,
        }
    }

    pub(crate) fn real(&mut self) -> Option<f64> {
        match self.0.next()? {
            Cell::Real(number) => Some(number),
            Cell::Integer(number) => Some(number as f64),
            Cell::Text(_) => None,
        }
    }

    pub(crate) fn text(&mut self) -> Option<String> {
        match self.0.next()? {
            Cell::Text(text) => Some(text),
            _ => None,
        }
    }
}
