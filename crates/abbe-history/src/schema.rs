//! The tables, and how those of an older version become those of this one.

use rusqlite::{Connection, Transaction};

/// The version of the tables that this program writes.
pub const SCHEMA_VERSION: i64 = 2;

/// Marks an SQLite file as a history: "Abbe" as a number.
pub(crate) const APPLICATION: i64 = 0x4162_6265;

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
