//! Many calibrations as independent jobs, on one machine or on an engine that deals them out.
//!
//! [`Fleet`] reads what is wanted: a recipe for every combination of variables, the trials of a Monte Carlo calculation in
//! blocks, or one estimate of files that no process has all of, in shards. [`plan`] makes a [`Manifest`] of it: jobs that are known by the hash of all that their results depend on. A [`Worker`]
//! does a job and puts its result into a [`Store`], whole or not at all; [`supervise`] does many in processes of their own.
//! [`merge`] puts the results together in the order of the manifest, wherever and in which order they were made.
//!
//! **Architecture invariant:** a result has no time, no path of its machine and no trace of the worker that made it, so that a job
//! that was done twice gave the same bytes twice.

mod combinations;
mod fleet;
mod hash;
mod manifest;
mod merge;
mod mistaken;
mod own_files;
mod plan;
mod rounds;
mod seal;
mod status;
mod store;
mod supervise;
mod table;
mod text;
mod worker;

pub use fleet::Fleet;
pub use manifest::{Family, Head, Job, MANIFEST_FORMAT, Manifest, Point, Shard, Trials};
pub use merge::{Merged, merge};
pub use plan::plan;
pub use rounds::{Rounds, next_round};
pub use status::{Status, status};
pub use store::{RESULT_FORMAT, Store};
pub use supervise::{Finished, Limits, supervise};
pub use worker::{Registries, Worker, serve};

use std::io;
use std::path::Path;

use abbe_core::Error;

/// What to do about a result that cannot be read.
const BROKEN: &str = "remove the file: `abbe fleet run` does the job again";

/// What is said of a file that cannot be read.
fn unreadable(path: &Path, error: &io::Error) -> Error {
    Error::data(format!("the file cannot be read: {}", abbe_files::why(error))).in_file(path)
}

/// What is said of a file that cannot be written.
fn unwritable(path: &Path, error: &io::Error) -> Error {
    Error::data(format!("the file cannot be written: {}", abbe_files::why(error))).in_file(path)
}
