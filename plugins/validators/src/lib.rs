//! Validators: residuals and their dependence on time, comparison of fits, hold-out, comparison with a CMM.
//!
//! Every figure is about one fit. Rows that the fit lists as outliers do not count in statistics but are counted.

mod artefact_cmm;
mod cmm;
mod compare;
mod drift;
mod figures;
mod folds;
mod hold_out;
mod residuals;
#[cfg(test)]
mod testing;
mod tip_cmm;
