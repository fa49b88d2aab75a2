//! Logs of tool setters (Muelaner, Yang, Davy, Verma & Maropoulos 2014, 3.5): `tool-dimensions` finds the dimensions of
//! every tool in every session and their wear, `tools` judges them, `tool-offsets` writes them for controls.
//!
//! The estimate has no machine. Its record has the tool table and what was measured when (`record`); verdicts follow from
//! that and from the values with their covariance (`judge`), for the estimate, the validator and the exporter alike.

mod controls;
mod covariance;
mod dimensions;
mod estimate;
mod impossible;
mod judge;
mod log;
mod offsets;
mod record;
mod settings;
mod tables;
mod validate;
mod wear;
