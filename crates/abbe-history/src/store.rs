//! Adding and reading entries.

#[cfg(feature = "postgres")]
use std::cell::RefCell;
use std::path::Path;

use abbe_core::{Calibration, Error, Result, in_parallel};
use serde_json::{Value, json};

use crate::entry::{Added, Entry, Filter, Stored, Written, hash_of};
#[cfg(feature = "postgres")]
use crate::server::Server;
use crate::sqlite::File;
use crate::statements::{ALL, Cell, Cells, ENTRIES, ENTRIES_BEFORE, ENTRY, LAST, MACHINES, OF_ENTRY, OF_MACHINE};

/// A history: a file, or tables on a server.
pub struct History {
    kept: Kept,
}

enum Kept {
    File(File),
    #[cfg(feature = "postgres")]
    Server(Box<RefCell<Server>>),
}

impl History {
    /// Opens a file to add to it; makes it if it is not there.
    ///
    /// Fails for a file that is something else, and for a history of a later version of this program.
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self { kept: Kept::File(File::open(path)?) })
    }

    /// A new history in memory, to be [saved](Self::save) when its first entries are in it. Messages name `path`.
    pub fn new(path: &Path) -> Result<Self> {
        Ok(Self { kept: Kept::File(File::new(path)?) })
    }

    /// Opens a file to read it; nothing is changed, an older version is read as it is.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self { kept: Kept::File(File::read(path)?) })
    }

    /// Connects to a PostgreSQL server to add to the history in one of its data bases; makes the tables if they are not there.
    ///
    /// Fails for an address with a password: that comes from the variable `PGPASSWORD` or from a service file. Fails in a program
    /// without the feature `postgres`.
    pub fn on_server(address: &str) -> Result<Self> {
        Self::connected(address, false)
    }

    /// The same to read: nothing is changed, and cannot be.
    pub fn read_server(address: &str) -> Result<Self> {
        Self::connected(address, true)
    }

    #[cfg(feature = "postgres")]
    fn connected(address: &str, only_read: bool) -> Result<Self> {
        let server = if only_read { Server::read(address)? } else { Server::open(address)? };
        Ok(Self { kept: Kept::Server(Box::new(RefCell::new(server))) })
    }

    #[cfg(not(feature = "postgres"))]
    fn connected(_: &str, _: bool) -> Result<Self> {
        let message = "this program was built without PostgreSQL: it keeps histories in files";
        Err(Error::usage(message).help("build it with `--features postgres`, or name a file"))
    }

    /// Writes all of it to an empty file.
    pub fn save(&self, empty: &Path) -> Result<()> {
        match &self.kept {
            Kept::File(file) => file.save(empty),
            #[cfg(feature = "postgres")]
            Kept::Server(_) => Err(Error::usage("a history on a server is no file")),
        }
    }

    /// Adds an entry, unless its content is there already. When this returns the entry is on the disk, or there is an error and it
    /// is not.
    pub fn add(&mut self, entry: &Entry) -> Result<Added> {
        let written = Written::of(entry)?;
        let added = match &mut self.kept {
            Kept::File(file) => file.add(&written),
            #[cfg(feature = "postgres")]
            Kept::Server(server) => server.get_mut().add(&written),
        }?;
        if let Added::Known(number) = added {
            self.verify([number])?;
        }
        Ok(added)
    }

    /// Fails if an entry is not what was added: its content has another hash than the one that is kept with it.
    pub fn verify(&self, numbers: impl IntoIterator<Item = i64>) -> Result<()> {
        numbers.into_iter().try_for_each(|number| self.entry(number).map(drop))
    }

    fn rows(&self, statement: &str, given: &[Cell]) -> Result<Vec<Vec<Cell>>> {
        match &self.kept {
            Kept::File(file) => file.rows(statement, given),
            #[cfg(feature = "postgres")]
            Kept::Server(server) => server.borrow_mut().rows(statement, given),
        }
    }

    /// Its place, as messages name it.
    pub fn name(&self) -> String {
        match &self.kept {
            Kept::File(file) => file.name(),
            #[cfg(feature = "postgres")]
            Kept::Server(server) => server.borrow().name(),
        }
    }

    fn damaged(&self, what: &str) -> Error {
        Error::data(format!("the history {} is damaged: {what}", self.name())).help("take the last copy that is whole")
    }

    /// The numbers of all entries, with hash and recipe, the oldest first.
    pub fn entries(&self) -> Result<Vec<(i64, String, String)>> {
        self.listed(ENTRIES, &[])
    }

    /// The last entries before a number, `most` of them at most, the last one first: number, hash and recipe.
    pub fn entries_before(&self, number: i64, most: i64) -> Result<Vec<(i64, String, String)>> {
        self.listed(ENTRIES_BEFORE, &[Cell::Integer(number), Cell::Integer(most)])
    }

    fn listed(&self, statement: &str, given: &[Cell]) -> Result<Vec<(i64, String, String)>> {
        let entry = |row| {
            let mut cells = Cells::new(row);
            let entry = (|| Some((cells.integer()?, cells.text()?, cells.text()?)))();
            entry.ok_or_else(|| self.damaged("its entries cannot be read"))
        };
        self.rows(statement, given)?.into_iter().map(entry).collect()
    }

    /// The machines by name, with the number of their calibrations.
    pub fn machines(&self) -> Result<Vec<(String, i64)>> {
        let machine = |row| {
            let mut cells = Cells::new(row);
            let machine = (|| Some((cells.text()?, cells.integer()?)))();
            machine.ok_or_else(|| self.damaged("its machines cannot be read"))
        };
        let mut machines = self.rows(MACHINES, &[])?.into_iter().map(machine).collect::<Result<Vec<_>>>()?;
        machines.sort();
        Ok(machines)
    }

    /// Label and unit of time of the last calibration of a machine.
    pub fn last(&self, machine: &str) -> Result<Option<(String, String)>> {
        let Some(row) = self.rows(LAST, &[machine.into()])?.pop() else { return Ok(None) };
        let mut cells = Cells::new(row);
        let last = (|| Some((cells.text()?, cells.text()?)))();
        last.map(Some).ok_or_else(|| self.damaged("its calibrations cannot be read"))
    }

    /// Calibrations in the order of their times, with the numbers of their entries.
    pub fn calibrations(&self, filter: &Filter) -> Result<Vec<(i64, Stored)>> {
        let mut found = match (&filter.machine, filter.entry) {
            (Some(machine), _) => self.stored(OF_MACHINE, &[machine.as_str().into()])?,
            (None, Some(entry)) => self.stored(OF_ENTRY, &[Cell::Integer(entry)])?,
            (None, None) => self.stored(ALL, &[])?,
        };
        if let Some(entry) = filter.entry {
            found.retain(|(own, _)| *own == entry);
            found.sort_by(|(_, one), (_, other)| one.at.total_cmp(&other.at));
        }
        Ok(found)
    }

    fn stored(&self, statement: &str, given: &[Cell]) -> Result<Vec<(i64, Stored)>> {
        self.parsed(self.lines(statement, given)?)
    }

    fn lines(&self, statement: &str, given: &[Cell]) -> Result<Vec<Line>> {
        let line = |row| {
            let mut cells = Cells::new(row);
            let mut read = || {
                let (entry, machine, label) = (cells.integer()?, cells.text()?, cells.text()?);
                Some(Line { entry, machine, label, at: cells.real()?, unit: cells.text()?, content: cells.text()? })
            };
            read().ok_or_else(|| self.damaged("its calibrations cannot be read"))
        };
        self.rows(statement, given)?.into_iter().map(line).collect()
    }

    /// The calibrations of lines, in their order. To read the texts is most of the work: all processors share it.
    fn parsed(&self, lines: Vec<Line>) -> Result<Vec<(i64, Stored)>> {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let share = lines.len().div_ceil(threads).max(SHARE);
        let shares: Vec<&[Line]> = lines.chunks(share).collect();
        let one = |line: &Line| Calibration::from_json(&line.content).map_err(|error| (line.entry, error));
        let read = |lines: &&[Line]| lines.iter().map(one).collect();
        let read: std::result::Result<Vec<Vec<Calibration>>, _> =
            in_parallel(&shares, None, read).into_iter().collect();
        let calibrations = read.map_err(|(entry, error)| {
            let error = self.damaged(&format!("a calibration of entry {entry}: {}", error.message));
            error.help("take it from a copy of the history, or add its results to a new one")
        })?;
        let stored = |(line, calibration): (Line, Calibration)| {
            let Line { entry, machine, label, at, unit, .. } = line;
            (entry, Stored { machine, label, at, unit, calibration })
        };
        Ok(lines.into_iter().zip(calibrations.into_iter().flatten()).map(stored).collect())
    }

    /// An entry as it was added; none if there is no entry of this number.
    ///
    /// Fails if it is not what was added.
    pub fn entry(&self, number: i64) -> Result<Option<Entry>> {
        let Some(row) = self.rows(ENTRY, &[Cell::Integer(number)])?.pop() else { return Ok(None) };
        let mut cells = Cells::new(row);
        let mut read = || Some((cells.text()?, cells.text()?, cells.text()?, cells.text()?));
        let (sha256, recipe, verdicts, evidence) = read().ok_or_else(|| self.damaged("an entry cannot be read"))?;
        let damaged = |error: serde_json::Error| self.damaged(&format!("entry {number}: {error}"));
        let lines = self.lines(OF_ENTRY, &[Cell::Integer(number)])?;
        let part =
            |line: &Line| serde_json::from_str::<Value>(&line.content).map(|content| json!([line.machine, content]));
        let parts = lines.iter().map(part).collect::<std::result::Result<Vec<_>, _>>().map_err(damaged)?;
        let [verdicts, evidence]: [Value; 2] =
            [serde_json::from_str(&verdicts).map_err(damaged)?, serde_json::from_str(&evidence).map_err(damaged)?];
        if hash_of(&recipe, &parts, &verdicts, &evidence) != sha256 {
            let error = self.damaged(&format!("entry {number} is not what was added; its content has another SHA-256"));
            return Err(error.help("take it from a copy of the history, or add its results to a new one"));
        }
        Ok(Some(Entry {
            recipe,
            calibrations: self.parsed(lines)?.into_iter().map(|(_, stored)| stored).collect(),
            verdicts: serde_json::from_value(verdicts).map_err(damaged)?,
            evidence,
        }))
    }
}

/// A row of calibrations as it is kept.
struct Line {
    entry: i64,
    machine: String,
    label: String,
    at: f64,
    unit: String,
    content: String,
}

/// Lines of one thread at least: to start one takes longer than to read a few.
const SHARE: usize = 16;

#[cfg(test)]
mod tests;
