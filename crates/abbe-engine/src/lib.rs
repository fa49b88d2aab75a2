//! Resolves plugins, runs the graph of stages, reports progress, and writes results completely or not at all.
//!
//! [`prepare`] finds all errors that can be found without reading data rows; [`Prepared::check`] adds the identifiability of
//! the planned fits; [`Prepared::run`] does the work and keeps the results in memory; [`Outcome::write`] puts them on disk.
//! [`Prepared::plan`] chooses which measurements to make; [`Prepared::simulate`] measures the programme of a recipe on a
//! virtual machine instead.

mod batched_settings;
mod batches;
mod check;
mod circles;
mod copied_sensors;
mod described;
mod doubts;
mod evidence;
mod folder;
mod given;
mod groups;
mod in_order;
mod kept;
mod laws;
mod lengths;
pub mod number;
mod outcome;
mod parts;
mod passes;
mod places;
mod plan;
mod plausibility;
mod prediction;
mod prepare;
mod problems;
mod program;
mod readings;
mod record;
mod recorded;
mod rehearsal;
mod repeated;
mod results;
mod row_settings;
mod run;
mod sample;
mod saved;
mod sensors;
mod simulate;
mod staging;
mod statuses;
mod told;
mod travel;
mod understood;
mod units;

pub use abbe_estimation::{
    Contradicted, LocationError, LocationErrors, Standing, contradicted, copied_runs, gathered_outliers,
    quiet_channels, repeated_in_words,
};
pub use abbe_measuring::Control;
pub use abbe_planning::{LargestOfInput, Order, Plan, PlanFigures, Reached, Revisit};
pub use check::Planned;
pub use described::{Described, prepare_text};
pub use folder::{can_write_folder, write_folder};
pub use given::{Given, prepare_given};
pub use groups::day_of;
pub use laws::Laws;
pub use outcome::{CALIBRATION, Failure, Outcome, REPORT, VERDICTS, residuals_file};
pub use parts::{OfParts, Part, PartSet, Share};
pub use plan::Measurements;
pub use prepare::{Prepared, prepare, prepared};
pub use record::{FailureRecord, FileRecord, PluginRecord, RUN_FORMAT, Remark, RunRecord, sha256};
pub use saved::{model_of, model_with_log};
pub use simulate::{Simulated, SimulatedFile, UnchangedFile};
pub use staging::{MadeFolders, Staging, refuse_temporary_place, temporary_file, temporary_folder};
pub use understood::Understood;
