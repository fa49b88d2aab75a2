//! Rapid verification with an uncalibrated artefact (Muelaner, Yang, Davy, Verma & Maropoulos 2014): points that are probed after a
//! calibration (the baseline) and again before a cut; go or no-go, the likely source, and the programs that do it on the
//! controller alone.
//!
//! - artefact `probed-points`: the points
//! - validator `verify`: go or no-go of runs against the baseline, and what the pattern of deviations comes from
//! - validator `verify-cut`: the stock that a cut left, against the allowance
//! - exporter `verify-sensitivity`: what each error does to each point, and combinations that answer to one error alone
//! - exporters `verify-siemens` and `verify-fanuc`: baseline and verify programs

mod artefact;
mod baseline;
mod candidates;
mod combination;
mod controller;
mod copies;
mod cut;
mod diagnosis;
mod export;
mod fanuc;
mod material;
mod others;
mod plan;
mod points;
mod program;
mod siemens;
mod verify;

pub use material::{MATERIALS, largest_expansion, material};
