//! Resolves plugins, runs the graph of stages, tells what is going on, and leaves results whole or not at all.
//!
//! [`prepare`] finds everything that can be wrong without reading data rows; [`Prepared::check`] adds what the planned fits
//! can determine; [`Prepared::run`] does the work and keeps the results in memory; [`Outcome::write`] puts them on disk.
//! [`Prepared::simulate`] measures the programme of a recipe on a virtual machine instead.

mod outcome;
mod places;
mod prepare;
mod run;
mod simulate;
mod uncertainty;

pub use outcome::Outcome;
pub use prepare::{Prepared, prepare};
pub use run::{Event, Listener, Planned, model_of};
pub use simulate::{Simulated, SimulatedFile, UnchangedFile};
