//! Where the calibrations of machines are kept: one SQLite file, to which entries are added and in which nothing is ever
//! changed.
//!
//! An entry is what one run found: its calibrations, verdicts and evidence. It is known by the hash of that content, so that it
//! is there once however often it is added. An entry is added in one transaction: a program that is killed leaves it whole or
//! not at all. Several programs may add at a time; they wait for each other.

mod schema;
mod store;

pub use schema::SCHEMA_VERSION;
pub use store::{Added, Entry, Filter, History, Stored};
