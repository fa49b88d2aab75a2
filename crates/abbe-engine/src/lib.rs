//! Resolves plugins, runs the graph of stages, tells what is going on, and leaves results whole or not at all.
//!
//! [`prepare`] finds everything that can be wrong without reading data rows; [`Prepared::check`] adds what the planned fits
//! can determine; [`Prepared::run`] does the work and keeps the results in memory; [`Outcome::write`] puts them on disk.

mod outcome;
mod prepare;
mod run;

pub use outcome::Outcome;
pub use prepare::{Prepared, prepare};
pub use run::{Event, Listener, Planned, model_of};
