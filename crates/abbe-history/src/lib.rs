//! Where the calibrations of machines are kept: one SQLite file, or a data base on a PostgreSQL server, to which entries are
//! added and in which nothing is ever changed.
//!
//! An entry is what one run found: its calibrations, verdicts and evidence. It is known by the hash of that content, so that it
//! is there once however often it is added. An entry is added in one transaction: a program that is killed leaves it whole or
//! not at all. Several programs may add at a time; they wait for each other.
//!
//! Both kinds of data base have the same tables and get the same statements. Servers need the feature `postgres`.

mod entry;
mod schema;
#[cfg(feature = "postgres")]
mod server;
mod sqlite;
mod statements;
mod store;

use std::time::Duration;

pub use entry::{Added, Entry, Filter, Stored};
pub use schema::SCHEMA_VERSION;
pub use store::History;

/// How long one program waits for another that is writing.
const PATIENCE: Duration = Duration::from_secs(30);
