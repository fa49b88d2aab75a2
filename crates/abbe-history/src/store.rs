//! Adding and reading entries.

use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Calibration, Error, Result, Verdict};
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, TransactionBehavior, params};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::schema::{APPLICATION, SCHEMA_VERSION, migrate, version};

/// How long one program waits for another that is writing.
const PATIENCE: Duration = Duration::from_secs(30);

/// What one run found.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Name of the recipe.
    pub recipe: String,
    /// Its calibrations, each with its machine and its time.
    pub calibrations: Vec<Stored>,
    /// Its verdicts.
    pub verdicts: Vec<Verdict>,
    /// What it was made of: the files that were read, with their hashes, and the plugins.
    pub evidence: Value,
}

/// A calibration with its machine and its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// The machine.
    pub machine: String,
    /// What the test is called: a week, a date.
    pub label: String,
    /// When it was, in `unit`.
    pub at: f64,
    /// `week`, `day`, ...
    pub unit: String,
    /// The result.
    pub calibration: Calibration,
}

/// What came of adding an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Added {
    /// It has this number now.
    New(i64),
    /// The same content has this number already: nothing was done.
    Known(i64),
}

/// Which calibrations are wanted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    /// Those of one machine.
    pub machine: Option<String>,
    /// Those of one entry.
    pub entry: Option<i64>,
}

/// A history in an SQLite file.
pub struct History {
    path: PathBuf,
    connection: Connection,
}

impl Entry {
    /// SHA-256 of its content, in hexadecimal digits. Times have no part in it: the same data give the same result on any day.
    pub fn sha256(&self) -> Result<String> {
        let mut parts = Vec::new();
        for stored in &self.calibrations {
            let content = serde_json::to_value(&stored.calibration).map_err(|error| unwritable(&error))?;
            parts.push(json!([stored.machine, content]));
        }
        let content = json!([self.recipe, parts, self.verdicts, self.evidence]);
        Ok(Sha256::digest(content.to_string().as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

fn unwritable(error: &serde_json::Error) -> Error {
    Error::data(format!("a result cannot be kept: {error}"))
}

impl History {
    /// Opens a history to add to it; makes it if it is not there.
    ///
    /// Fails for a file that is something else, and for a history of a later version of this program.
    pub fn open(path: &Path) -> Result<Self> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut history = Self::connected(path, flags)?;
        let found = history.checked()?;
        if found < SCHEMA_VERSION {
            history.bring_up_to_date()?;
        }
        Ok(history)
    }

    /// Brings the tables to the version of this program.
    fn bring_up_to_date(&mut self) -> Result<()> {
        let migrated = (|| {
            let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            migrate(&transaction)?;
            transaction.commit()
        })();
        migrated.map_err(|error| self.failed(&error))
    }

    /// A new history in memory, to be [saved](Self::save) when its first entries are in it. Messages name `path`.
    pub fn new(path: &Path) -> Result<Self> {
        let connection = Connection::open_in_memory();
        let mut history = Self::configured(path, connection)?;
        history.bring_up_to_date()?;
        Ok(history)
    }

    /// Writes all of it to an empty file.
    pub fn save(&self, empty: &Path) -> Result<()> {
        let name = empty.to_str().ok_or_else(|| Error::usage(format!("{} is no name in UTF-8", empty.display())))?;
        let saved = self.connection.execute("VACUUM INTO ?1", [name]);
        saved.map(drop).map_err(|error| self.failed(&error))
    }

    /// Opens a history to read it; nothing is changed, an older version is read as it is.
    pub fn read(path: &Path) -> Result<Self> {
        if !path.is_file() {
            return Err(Error::usage(format!("the history {} does not exist", path.display()))
                .help("`abbe history add` makes it"));
        }
        let history = Self::connected(path, OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX)?;
        match history.checked()? {
            0 => Err(Error::usage(format!("{} is empty: it holds no history", path.display()))),
            _ => Ok(history),
        }
    }

    fn connected(path: &Path, flags: OpenFlags) -> Result<Self> {
        Self::configured(path, Connection::open_with_flags(path, flags))
    }

    fn configured(path: &Path, connection: rusqlite::Result<Connection>) -> Result<Self> {
        let failed =
            |error: rusqlite::Error| Error::usage(format!("the history {} cannot be opened: {error}", path.display()));
        let connection = connection.map_err(failed)?;
        connection.busy_timeout(PATIENCE).map_err(failed)?;
        let history = Self { path: path.to_owned(), connection };
        let settings = || {
            // A power failure after an entry was said to be added does not lose it.
            history.connection.pragma_update(None, "synchronous", "FULL")?;
            history.connection.pragma_update(None, "foreign_keys", true)
        };
        settings().map_err(|error| history.failed(&error))?;
        Ok(history)
    }

    /// The version of its tables. Fails for what is no history of this program.
    fn checked(&self) -> Result<i64> {
        let found = || -> rusqlite::Result<(i64, i64, i64)> {
            let application = self.connection.pragma_query_value(None, "application_id", |row| row.get(0))?;
            let tables = self.connection.query_row("SELECT count(*) FROM sqlite_master", [], |row| row.get(0))?;
            Ok((application, version(&self.connection)?, tables))
        };
        let (application, version, tables) = found().map_err(|error| self.failed(&error))?;
        let path = self.path.display();
        match version {
            _ if application != APPLICATION && tables > 0 => {
                Err(Error::usage(format!("{path} is a data base of something else, not a history"))
                    .help("name another file"))
            }
            SCHEMA_VERSION.. if version > SCHEMA_VERSION => {
                let message =
                    format!("{path} is a history of version {version}; this program reads up to {SCHEMA_VERSION}");
                Err(Error::usage(message).help("use the version of Abbe that wrote it, or a later one"))
            }
            version => Ok(version),
        }
    }

    fn failed(&self, error: &rusqlite::Error) -> Error {
        use rusqlite::ErrorCode::{DatabaseBusy, DiskFull, NotADatabase, ReadOnly};
        let path = self.path.display();
        match error.sqlite_error_code() {
            Some(NotADatabase) => Error::usage(format!("{path} is no history")).help("name another file"),
            Some(DatabaseBusy) => {
                let message = format!("{path} is being written by another program, for {} s now", PATIENCE.as_secs());
                Error::data(message).help("try again; nothing was added")
            }
            Some(ReadOnly) => Error::usage(format!("{path} cannot be written")).help("nothing was added"),
            Some(DiskFull) => Error::data(format!("the history {path} cannot be written: the disk is full"))
                .help("make room, or name a file on another disk; nothing was added"),
            _ => Error::data(format!("the history {path}: {error}")),
        }
    }

    /// Adds an entry, unless its content is there already. When this returns the entry is on the disk, or there is an error and it
    /// is not.
    pub fn add(&mut self, entry: &Entry) -> Result<Added> {
        let sha256 = entry.sha256()?;
        let mut calibrations = Vec::new();
        for stored in &entry.calibrations {
            calibrations.push((stored, stored.calibration.to_json()?));
        }
        let verdicts = serde_json::to_string(&entry.verdicts).map_err(|error| unwritable(&error))?;
        let evidence = entry.evidence.to_string();
        let mut add = || -> rusqlite::Result<Added> {
            // From here on other writers wait: what is looked up stays so.
            let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let known = transaction
                .query_row("SELECT number FROM entry WHERE sha256 = ?1", [&sha256], |row| row.get(0))
                .optional()?;
            if let Some(known) = known {
                return Ok(Added::Known(known));
            }
            transaction.execute(
                "INSERT INTO entry (sha256, recipe, verdicts, evidence) VALUES (?1, ?2, ?3, ?4)",
                params![sha256, entry.recipe, verdicts, evidence],
            )?;
            let number = transaction.last_insert_rowid();
            for (stored, content) in &calibrations {
                let estimate = &stored.calibration.estimate;
                transaction.execute(
                    "INSERT INTO calibration (entry, machine, estimate, label, at, unit, content) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                    params![number, stored.machine, estimate, stored.label, stored.at, stored.unit, content],
                )?;
            }
            transaction.commit()?;
            Ok(Added::New(number))
        };
        add().map_err(|error| self.failed(&error))
    }

    /// The numbers of all entries, with hash and recipe, the oldest first.
    pub fn entries(&self) -> Result<Vec<(i64, String, String)>> {
        let read = || -> rusqlite::Result<Vec<(i64, String, String)>> {
            let mut query = self.connection.prepare("SELECT number, sha256, recipe FROM entry ORDER BY number")?;
            query.query_map([], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?.collect()
        };
        read().map_err(|error| self.failed(&error))
    }

    /// The machines, with the number of their calibrations.
    pub fn machines(&self) -> Result<Vec<(String, i64)>> {
        let read = || -> rusqlite::Result<Vec<(String, i64)>> {
            let text = "SELECT machine, count(*) FROM calibration GROUP BY machine ORDER BY machine";
            self.connection.prepare(text)?.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?.collect()
        };
        read().map_err(|error| self.failed(&error))
    }

    /// Calibrations in the order of their times, with the numbers of their entries.
    pub fn calibrations(&self, filter: &Filter) -> Result<Vec<(i64, Stored)>> {
        let columns = "SELECT entry, machine, label, at, unit, content FROM calibration";
        let text = match filter.machine.is_some() {
            true => format!("{columns} WHERE machine = ?1 AND (?2 IS NULL OR entry = ?2) ORDER BY at, entry"),
            false => format!("{columns} WHERE ?1 IS NULL AND (?2 IS NULL OR entry = ?2) ORDER BY at, entry"),
        };
        let stored = |row: &Row<'_>| {
            let content: String = row.get(5)?;
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?, content))
        };
        type Line = (i64, String, String, f64, String, String);
        let read = || -> rusqlite::Result<Vec<Line>> {
            self.connection.prepare(&text)?.query_map(params![filter.machine, filter.entry], stored)?.collect()
        };
        let lines = read().map_err(|error| self.failed(&error))?;
        let calibration = |(entry, machine, label, at, unit, content): Line| {
            let calibration = Calibration::from_json(&content)?;
            Ok((entry, Stored { machine, label, at, unit, calibration }))
        };
        lines.into_iter().map(calibration).collect()
    }

    /// An entry as it was added; none if there is no entry of this number.
    pub fn entry(&self, number: i64) -> Result<Option<Entry>> {
        let read = || {
            let text = "SELECT recipe, verdicts, evidence FROM entry WHERE number = ?1";
            let columns = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?));
            self.connection.query_row(text, [number], columns).optional()
        };
        let found: Option<(String, String, String)> = read().map_err(|error| self.failed(&error))?;
        let Some((recipe, verdicts, evidence)) = found else { return Ok(None) };
        let damaged = |error: serde_json::Error| {
            Error::data(format!("entry {number} of the history {} is damaged: {error}", self.path.display()))
        };
        let text = "SELECT machine, label, at, unit, content FROM calibration WHERE entry = ?1 ORDER BY rowid";
        let columns = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?, row.get(4)?));
        type Line = (String, String, f64, String, String);
        let read = || -> rusqlite::Result<Vec<Line>> {
            self.connection.prepare(text)?.query_map([number], columns)?.collect()
        };
        let calibrations =
            read().map_err(|error| self.failed(&error))?.into_iter().map(|(machine, label, at, unit, content)| {
                Ok(Stored { machine, label, at, unit, calibration: Calibration::from_json(&content)? })
            });
        Ok(Some(Entry {
            recipe,
            calibrations: calibrations.collect::<Result<_>>()?,
            verdicts: serde_json::from_str(&verdicts).map_err(damaged)?,
            evidence: serde_json::from_str(&evidence).map_err(damaged)?,
        }))
    }
}

#[cfg(test)]
mod tests;
