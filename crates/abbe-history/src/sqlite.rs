//! A history in an SQLite file.

use std::io::Read;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use rusqlite::types::{ToSqlOutput, Value as Held};
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, ToSql, TransactionBehavior, params};

use crate::PATIENCE;
use crate::entry::{Added, Written};
use crate::schema::{APPLICATION, SCHEMA_VERSION, migrate, version};
use crate::statements::{ADD_CALIBRATION, ADD_ENTRY, Cell, KNOWN};

/// The file.
pub(crate) struct File {
    path: PathBuf,
    pub(crate) connection: Connection,
}

impl ToSql for Cell {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        match self {
            Self::Integer(number) => number.to_sql(),
            Self::Real(number) => number.to_sql(),
            Self::Text(text) => text.to_sql(),
        }
    }
}

impl File {
    /// Opens a file to add to it; makes it if it is not there.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        is_file_if_there(path)?;
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let mut file = Self::connected(path, flags)?;
        if file.checked()? < SCHEMA_VERSION {
            file.bring_up_to_date()?;
        }
        Ok(file)
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

    /// A new one in memory. Messages name `path`.
    pub(crate) fn new(path: &Path) -> Result<Self> {
        let mut file = Self::configured(path, Connection::open_in_memory())?;
        file.bring_up_to_date()?;
        Ok(file)
    }

    /// Writes all of it to an empty file.
    pub(crate) fn save(&self, empty: &Path) -> Result<()> {
        let name = empty.to_str().ok_or_else(|| Error::usage(format!("{} is no name in UTF-8", empty.display())))?;
        let saved = self.connection.execute("VACUUM INTO ?1", [name]);
        saved.map(drop).map_err(|error| self.failed(&error))
    }

    /// Opens a file to read it; nothing is changed.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        is_file_if_there(path)?;
        if !path.is_file() && path.symlink_metadata().is_ok() {
            let message = format!("the history {} is a link that leads to nothing", path.display());
            return Err(Error::usage(message).help("name the file that it should lead to"));
        }
        if !path.is_file() {
            return Err(Error::usage(format!("the history {} does not exist", path.display()))
                .help("`abbe history add` makes it"));
        }
        // SQLite has to be able to write: what a writer left half done when it was killed is undone first.
        let file = Self::connected(path, OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX)?;
        file.connection.pragma_update(None, "query_only", true).map_err(|error| file.failed(&error))?;
        match file.checked()? {
            0 => Err(Error::usage(format!("{} is empty: it holds no history", path.display()))),
            _ => Ok(file),
        }
    }

    fn connected(path: &Path, flags: OpenFlags) -> Result<Self> {
        nobodys_journals(path)?;
        Self::configured(path, Connection::open_with_flags(path, flags))
    }

    fn configured(path: &Path, connection: rusqlite::Result<Connection>) -> Result<Self> {
        let failed = |error: rusqlite::Error| failed(path, &error);
        let connection = connection.map_err(failed)?;
        connection.busy_timeout(PATIENCE).map_err(failed)?;
        let file = Self { path: path.to_owned(), connection };
        let settings = || {
            // A power failure after an entry was said to be added does not lose it.
            file.connection.pragma_update(None, "synchronous", "FULL")?;
            file.connection.pragma_update(None, "foreign_keys", true)
        };
        settings().map_err(|error| file.failed(&error))?;
        Ok(file)
    }

    /// The version of its tables. Fails for what is no history of this program.
    fn checked(&self) -> Result<i64> {
        let found = || -> rusqlite::Result<(i64, i64, i64)> {
            // All of one moment: another program may make the tables just now.
            let moment = self.connection.unchecked_transaction()?;
            let application = moment.pragma_query_value(None, "application_id", |row| row.get(0))?;
            let tables = moment.query_row("SELECT count(*) FROM sqlite_master", [], |row| row.get(0))?;
            Ok((application, version(&moment)?, tables))
        };
        let (application, version, tables) = found().map_err(|error| self.failed(&error))?;
        // An empty file has no version either.
        if application != APPLICATION && (tables > 0 || version != 0) {
            let message = format!("{} is a data base of something else, not a history", self.path.display());
            return Err(Error::usage(message).help("name another file"));
        }
        crate::schema::known(version, &self.path.display().to_string())
    }

    fn failed(&self, error: &rusqlite::Error) -> Error {
        failed(&self.path, error)
    }

    /// Adds an entry in one transaction.
    pub(crate) fn add(&mut self, written: &Written<'_>) -> Result<Added> {
        let mut add = || -> rusqlite::Result<Added> {
            // From here on other writers wait: what is looked up stays so.
            let transaction = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let known = transaction.query_row(KNOWN, [&written.sha256], |row| row.get(0)).optional()?;
            if let Some(known) = known {
                return Ok(Added::Known(known));
            }
            let entry = params![written.sha256, written.entry.recipe, written.verdicts, written.evidence];
            let number: i64 = transaction.query_row(ADD_ENTRY, entry, |row| row.get(0))?;
            for (stored, content) in written.entry.calibrations.iter().zip(&written.contents) {
                let estimate = &stored.calibration.estimate;
                let calibration =
                    params![number, stored.machine, estimate, stored.label, stored.at, stored.unit, content];
                transaction.execute(ADD_CALIBRATION, calibration)?;
            }
            transaction.commit()?;
            Ok(Added::New(number))
        };
        add().map_err(|error| self.failed(&error))
    }

    /// The rows that a statement gives.
    pub(crate) fn rows(&self, statement: &str, given: &[Cell]) -> Result<Vec<Vec<Cell>>> {
        let row = |row: &Row<'_>| -> rusqlite::Result<Vec<Cell>> {
            let cell = |index| match row.get(index)? {
                Held::Integer(number) => Ok(Cell::Integer(number)),
                Held::Real(number) => Ok(Cell::Real(number)),
                Held::Text(text) => Ok(Cell::Text(text)),
                Held::Null | Held::Blob(_) => Ok(Cell::Text(String::new())),
            };
            (0..row.as_ref().column_count()).map(cell).collect()
        };
        let rows = || -> rusqlite::Result<Vec<Vec<Cell>>> {
            self.connection.prepare(statement)?.query_map(rusqlite::params_from_iter(given), row)?.collect()
        };
        rows().map_err(|error| self.failed(&error))
    }

    pub(crate) fn name(&self) -> String {
        self.path.display().to_string()
    }
}

/// Refuses pipes, devices and folders before SQLite opens them.
fn is_file_if_there(path: &Path) -> Result<()> {
    match path.metadata() {
        Ok(found) if !found.is_file() => {
            let what = if found.is_dir() { "a folder" } else { "no regular file" };
            Err(Error::usage(format!("{} is {what}, and no history", path.display())).help("name another file"))
        }
        _ => Ok(()),
    }
}

/// What SQLite calls the files beside a data base that it replays, and removes, behind its name; and how each begins, in bytes
/// (<https://www.sqlite.org/fileformat.html>, sections 3 and 4.1). One that is not complete yet begins with zeros, or is empty.
const JOURNALS: [(&str, &[u8]); 2] =
    [("-journal", &[0xd9, 0xd5, 0x05, 0xf9, 0x20, 0xa1, 0x63, 0xd7]), ("-wal", &[0x37, 0x7f, 0x06])];

/// Refuses a history beside which somebody's file has the name of a journal: SQLite would remove it.
fn nobodys_journals(path: &Path) -> Result<()> {
    for (ending, start) in JOURNALS {
        let mut journal = path.as_os_str().to_owned();
        journal.push(ending);
        let journal = PathBuf::from(journal);
        let Some(found) = journal.metadata().ok().filter(|found| !found.is_dir()) else { continue };
        let mut head = Vec::new();
        // A pipe is not opened, here or by SQLite, which would wait for it.
        if found.is_file() {
            let file = std::fs::File::open(&journal);
            let _ = file.and_then(|file| file.take(start.len() as u64).read_to_end(&mut head));
        }
        let is_journal = start.starts_with(&head) || head.iter().all(|byte| *byte == 0);
        if !found.is_file() || !is_journal {
            let message = format!("{} is a file of something else", journal.display());
            let help = format!(
                "SQLite takes it for a journal of {}, and would remove it: give one another name",
                path.display()
            );
            return Err(Error::usage(message).help(help));
        }
    }
    Ok(())
}

/// What SQLite could not do, with what its user can.
fn failed(path: &Path, error: &rusqlite::Error) -> Error {
    use rusqlite::ErrorCode::{
        CannotOpen, DatabaseBusy, DatabaseCorrupt, DiskFull, NotADatabase, PermissionDenied, ReadOnly, SystemIoFailure,
    };
    let path = path.display();
    let told = |what: &str, help: &str| Error::usage(format!("the history {path} cannot be {what}")).help(help);
    match error.sqlite_error_code() {
        Some(NotADatabase) => Error::usage(format!("{path} is no history")).help("name another file"),
        Some(DatabaseBusy) => {
            let message = format!("{path} is being written by another program, for {} s now", PATIENCE.as_secs());
            Error::data(message).help("try again when it is done; nothing was changed")
        }
        Some(ReadOnly | PermissionDenied) => told(
            "written",
            "nothing of this entry was added: this user may not write the file, or not make files beside it in its folder",
        ),
        Some(CannotOpen) => told(
            &format!("opened: {error}"),
            "its folder has to exist, and this user has to have the right to read and write the file and to make files beside it",
        ),
        Some(SystemIoFailure) => told(
            &format!("read or written: {error}"),
            "nothing of this entry was added: does the drive fail, is it full, or is it a network drive?",
        ),
        Some(DiskFull) => Error::data(format!("the history {path} cannot be written: the disk is full"))
            .help("make room, or name a file on another disk; nothing of this entry was added"),
        Some(DatabaseCorrupt) => {
            Error::data(format!("the history {path} is damaged: {error}")).help("take the last copy that is whole")
        }
        _ => Error::data(format!("the history {path}: {error}")),
    }
}
