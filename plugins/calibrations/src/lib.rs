//! Estimates that are not solved from measurements of their own: `calibration` recalls the file of another run, `stated`
//! takes what a report says of a machine, `combine` makes one calibration of several.
//!
//! All three give a calibration like any other: for `known`, `start`, `machine` and `of`.

mod combine;
mod saved;
mod stated;
