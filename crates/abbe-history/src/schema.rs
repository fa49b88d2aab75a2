//! The tables, and how those of an older version become those of this one.

use abbe_core::{Error, Result};
use rusqlite::{Connection, Transaction};

/// The version of the tables that this program writes.
pub const SCHEMA_VERSION: i64 = 2;

/// Marks an SQLite file as a history: "Abbe" as a number.
pub(crate) const APPLICATION: i64 = 0x4162_6265;

/// The version of tables that this program can read; `name` is that of the history.
pub(crate) fn known(version: i64, name: &str) -> Result<i64> {
    if version <= SCHEMA_VERSION {
        return Ok(version);
    }
    let message = format!("{name} is a history of version {version}; this program reads up to {SCHEMA_VERSION}");
    Err(Error::usage(message).help("use the version of Abbe that wrote it, or a later one"))
}

/// The steps from one version to the next. A step adds; none changes or drops what is stored.
const STEPS: [&str; SCHEMA_VERSION as usize] = [
    // Entries and their calibrations. Triggers refuse to change or delete.
    "CREATE TABLE entry (
         number INTEGER PRIMARY KEY,
         sha256 TEXT NOT NULL UNIQUE,
         recipe TEXT NOT NULL,
         verdicts TEXT NOT NULL,
         evidence TEXT NOT NULL
     );
     CREATE TABLE calibration (
         entry INTEGER NOT NULL REFERENCES entry(number),
         machine TEXT NOT NULL,
         estimate TEXT NOT NULL,
         label TEXT NOT NULL,
         at REAL NOT NULL,
         unit TEXT NOT NULL,
         content TEXT NOT NULL,
         PRIMARY KEY (entry, estimate)
     );
     CREATE TRIGGER entry_stays BEFORE UPDATE ON entry BEGIN SELECT RAISE(ABORT, 'entries of a history never change'); END;
     CREATE TRIGGER entry_is_kept BEFORE DELETE ON entry BEGIN SELECT RAISE(ABORT, 'entries of a history are never deleted'); END;
     CREATE TRIGGER calibration_stays BEFORE UPDATE ON calibration
         BEGIN SELECT RAISE(ABORT, 'entries of a history never change'); END;
     CREATE TRIGGER calibration_is_kept BEFORE DELETE ON calibration
         BEGIN SELECT RAISE(ABORT, 'entries of a history are never deleted'); END;",
    // One machine among many is found without looking at the others.
    "CREATE INDEX calibration_of_machine ON calibration (machine, at);",
];

/// The same steps on a server. `rowid` is what every table of SQLite has anyway.
#[cfg(feature = "postgres")]
pub(crate) const SERVER_STEPS: [&str; SCHEMA_VERSION as usize] = [
    "CREATE TABLE version (number BIGINT PRIMARY KEY);
     CREATE TABLE entry (
         number BIGINT PRIMARY KEY,
         sha256 TEXT NOT NULL UNIQUE,
         recipe TEXT NOT NULL,
         verdicts TEXT NOT NULL,
         evidence TEXT NOT NULL
     );
     CREATE TABLE calibration (
         rowid BIGINT GENERATED ALWAYS AS IDENTITY,
         entry BIGINT NOT NULL REFERENCES entry(number),
         machine TEXT NOT NULL,
         estimate TEXT NOT NULL,
         label TEXT NOT NULL,
         at DOUBLE PRECISION NOT NULL,
         unit TEXT NOT NULL,
         content TEXT NOT NULL,
         PRIMARY KEY (entry, estimate)
     );
     CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS
         $$ BEGIN RAISE EXCEPTION 'entries of a history never change and are never deleted'; END $$;
     CREATE TRIGGER entry_stays BEFORE UPDATE OR DELETE OR TRUNCATE ON entry EXECUTE FUNCTION refuse();
     CREATE TRIGGER calibration_stays BEFORE UPDATE OR DELETE OR TRUNCATE ON calibration EXECUTE FUNCTION refuse();",
    "CREATE INDEX calibration_of_machine ON calibration (machine, at);",
];

/// The version of the tables of a file; 0 for an empty one.
pub(crate) fn version(connection: &Connection) -> rusqlite::Result<i64> {
    connection.pragma_query_value(None, "user_version", |row| row.get(0))
}

/// Brings the tables to the version of this program. Readers of the old version see the old one until it is done.
pub(crate) fn migrate(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    let found = version(transaction)?;
    let done = usize::try_from(found).unwrap_or(0);
    for step in STEPS.iter().skip(done) {
        transaction.execute_batch(step)?;
    }
    if found < SCHEMA_VERSION {
        transaction.pragma_update(None, "application_id", APPLICATION)?;
        transaction.pragma_update(None, "user_version", SCHEMA_VERSION)?;
    }
    Ok(())
}

#[cfg(test)]
pub(crate) fn first_version() -> &'static str {
    STEPS[0]
}
