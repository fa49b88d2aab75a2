//! A history on a PostgreSQL server: the tables stand in a schema of their own, `abbe_history`.

mod address;

use std::time::Duration;

use abbe_core::{Error, Result};
use postgres::error::SqlState;
use postgres::types::{ToSql, Type};
use postgres::{Client, NoTls, Row, Transaction};

use crate::PATIENCE;
use crate::entry::{Added, Written};
use crate::schema::{SCHEMA_VERSION, SERVER_STEPS, known};
use crate::statements::{ADD_CALIBRATION, ADD_ENTRY, Cell, KNOWN};
use address::Address;

/// One program at a time makes tables, or adds: the number of the lock that it takes, "Abbe". Who adds needs no more rights than
/// INSERT and SELECT.
const LOCK: i64 = 0x4162_6265;

/// How long a statement may take.
const LONGEST: Duration = Duration::from_secs(60);

/// A connection.
pub(crate) struct Server {
    name: String,
    client: Client,
}

impl Server {
    /// Connects to add; makes the tables where there are none.
    pub(crate) fn open(address: &str) -> Result<Self> {
        let mut server = Self::connected(address)?;
        if server.checked()? < SCHEMA_VERSION {
            server.bring_up_to_date()?;
        }
        Ok(server)
    }

    /// Connects to read; the server itself refuses to write.
    pub(crate) fn read(address: &str) -> Result<Self> {
        let mut server = Self::connected(address)?;
        let only_read = server.client.batch_execute("SET default_transaction_read_only = on");
        only_read.map_err(|error| failed(&server.name, &error))?;
        match server.checked()? {
            0 => {
                let message = format!("the data base of {} holds no history", server.name);
                Err(Error::usage(message).help("`abbe history add` makes it"))
            }
            _ => Ok(server),
        }
    }

    fn connected(address: &str) -> Result<Self> {
        let Address { name, config } = Address::of(address)?;
        let mut client = config.connect(NoTls).map_err(|error| cannot_connect(&name, &error))?;
        // What was said to be added is on the disk of the server, whatever its settings are.
        let settings = format!(
            "SET search_path = abbe_history; SET synchronous_commit = on; SET lock_timeout = '{}s'; \
             SET statement_timeout = '{}s'; SET idle_in_transaction_session_timeout = '{}s'",
            PATIENCE.as_secs(),
            LONGEST.as_secs(),
            LONGEST.as_secs()
        );
        client.batch_execute(&settings).map_err(|error| failed(&name, &error))?;
        Ok(Self { name, client })
    }

    /// The version of its tables; 0 without tables. Fails for what is no history of this program.
    fn checked(&mut self) -> Result<i64> {
        let found = version(&mut self.client).map_err(|error| failed(&self.name, &error))?;
        match found {
            Found::Nothing => Ok(0),
            Found::Version(version) => known(version, &self.name),
            Found::Other => {
                let message = format!("the schema abbe_history of {} is something else, not a history", self.name);
                Err(Error::usage(message).help("name another data base"))
            }
        }
    }

    /// Brings the tables to the version of this program, in one transaction.
    fn bring_up_to_date(&mut self) -> Result<()> {
        let mut migrate = || -> std::result::Result<(), postgres::Error> {
            let mut transaction = self.client.transaction()?;
            transaction.execute("SELECT pg_advisory_xact_lock($1)", &[&LOCK])?;
            // Another program may have done it in the meantime.
            let done = match version(&mut transaction)? {
                Found::Version(version) => version,
                Found::Nothing | Found::Other => 0,
            };
            // Whoever keeps the server may have made the schema, for a user who may not.
            let schema = "SELECT count(*) FROM pg_namespace WHERE nspname = 'abbe_history'";
            if transaction.query_one(schema, &[])?.try_get::<_, i64>(0)? == 0 {
                transaction.batch_execute("CREATE SCHEMA abbe_history")?;
            }
            for (step, number) in SERVER_STEPS.iter().zip(1..).skip(usize::try_from(done).unwrap_or(0)) {
                transaction.batch_execute(step)?;
                let number: i64 = number;
                transaction.execute("INSERT INTO version (number) VALUES ($1)", &[&number])?;
            }
            transaction.commit()
        };
        migrate().map_err(|error| failed(&self.name, &error))
    }

    /// Adds an entry in one transaction.
    pub(crate) fn add(&mut self, written: &Written<'_>) -> Result<Added> {
        let mut add = || -> std::result::Result<Added, postgres::Error> {
            let mut transaction = self.client.transaction()?;
            let added = added(&mut transaction, written)?;
            transaction.commit()?;
            Ok(added)
        };
        add().map_err(|error| failed(&self.name, &error))
    }

    /// The rows that a statement gives.
    pub(crate) fn rows(&mut self, statement: &str, given: &[Cell]) -> Result<Vec<Vec<Cell>>> {
        let given: Vec<&(dyn ToSql + Sync)> = given.iter().map(of_server).collect();
        let rows = self.client.query(statement, &given).map_err(|error| failed(&self.name, &error))?;
        let cells = |row: &Row| (0..row.len()).map(|index| cell(row, index)).collect();
        let read: std::result::Result<Vec<Vec<Cell>>, postgres::Error> = rows.iter().map(cells).collect();
        read.map_err(|error| failed(&self.name, &error))
    }

    pub(crate) fn name(&self) -> String {
        self.name.clone()
    }
}

/// What stands in the schema.
enum Found {
    Nothing,
    Version(i64),
    Other,
}

fn version(client: &mut impl postgres::GenericClient) -> std::result::Result<Found, postgres::Error> {
    let tables = "SELECT count(*), count(*) FILTER (WHERE tablename = 'version') FROM pg_tables \
                  WHERE schemaname = 'abbe_history'";
    let row = client.query_one(tables, &[])?;
    match (row.try_get::<_, i64>(0)?, row.try_get::<_, i64>(1)?) {
        (0, _) => Ok(Found::Nothing),
        (_, 0) => Ok(Found::Other),
        _ => {
            let last = client.query_one("SELECT coalesce(max(number), 0) FROM abbe_history.version", &[])?;
            Ok(Found::Version(last.try_get(0)?))
        }
    }
}

fn added(transaction: &mut Transaction<'_>, written: &Written<'_>) -> std::result::Result<Added, postgres::Error> {
    // From here on other writers wait, readers do not: what is looked up stays so.
    transaction.execute("SELECT pg_advisory_xact_lock($1)", &[&LOCK])?;
    if let Some(row) = transaction.query_opt(KNOWN, &[&written.sha256])? {
        return Ok(Added::Known(row.try_get(0)?));
    }
    let recipe = &written.entry.recipe;
    let row = transaction.query_one(ADD_ENTRY, &[&written.sha256, recipe, &written.verdicts, &written.evidence])?;
    let number: i64 = row.try_get(0)?;
    let statement = transaction.prepare(ADD_CALIBRATION)?;
    for (stored, content) in written.entry.calibrations.iter().zip(&written.contents) {
        let estimate = &stored.calibration.estimate;
        let calibration: [&(dyn ToSql + Sync); 7] =
            [&number, &stored.machine, estimate, &stored.label, &stored.at, &stored.unit, content];
        transaction.execute(&statement, &calibration)?;
    }
    Ok(Added::New(number))
}

fn of_server(cell: &Cell) -> &(dyn ToSql + Sync) {
    match cell {
        Cell::Integer(number) => number,
        Cell::Real(number) => number,
        Cell::Text(text) => text,
    }
}

fn cell(row: &Row, index: usize) -> std::result::Result<Cell, postgres::Error> {
    match *row.columns()[index].type_() {
        Type::INT8 => row.try_get(index).map(Cell::Integer),
        Type::FLOAT8 => row.try_get(index).map(Cell::Real),
        _ => row.try_get(index).map(Cell::Text),
    }
}

fn cannot_connect(name: &str, error: &postgres::Error) -> Error {
    let said = reason(error);
    let error = match error.code() {
        Some(&SqlState::INVALID_PASSWORD | &SqlState::INVALID_AUTHORIZATION_SPECIFICATION) => {
            Error::usage(format!("{name} refuses this user: {said}"))
        }
        Some(&SqlState::INVALID_CATALOG_NAME) => Error::usage(format!("{name} has no such data base: {said}")),
        _ => Error::data(format!("{name} cannot be reached: {said}")),
    };
    error.help(
        "the user is that of the address; the password comes from PGPASSWORD or a service file. Nothing was added",
    )
}

/// What the server, or what is below it, said. It knows nothing of passwords.
fn reason(error: &postgres::Error) -> String {
    if let Some(said) = error.as_db_error() {
        return said.message().to_owned();
    }
    let mut text = error.to_string();
    let mut below = std::error::Error::source(error);
    while let Some(cause) = below {
        let cause_text = cause.to_string();
        if !text.contains(&cause_text) {
            text = format!("{text}: {cause_text}");
        }
        below = cause.source();
    }
    text
}

fn failed(name: &str, error: &postgres::Error) -> Error {
    let said = reason(error);
    match error.code() {
        Some(&SqlState::LOCK_NOT_AVAILABLE) => {
            let message = format!("{name} is being written by another program, for {} s now", PATIENCE.as_secs());
            Error::data(message).help("try again; nothing of this entry was added")
        }
        Some(&SqlState::INSUFFICIENT_PRIVILEGE) => Error::usage(format!("{name} refuses it to this user: {said}")).help(
            "who makes a history needs the right to create schemas, who adds to it INSERT and SELECT, who reads it SELECT and the \
             use of the schema abbe_history",
        ),
        Some(&SqlState::DISK_FULL) => Error::data(format!("{name} cannot write: its disk is full")),
        _ if error.is_closed() => Error::data(format!("the connection to {name} ended: {said}"))
            .help("add it again: what is there already is not added twice"),
        _ => Error::data(format!("the history of {name}: {said}")),
    }
}
