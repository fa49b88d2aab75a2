//! Validators: residuals and their dependence on time, comparison of fits, hold-out, comparison with a CMM, limits of
//! uncertainty, consistency of calibrations, repeatability, influence of rows, the machine as a measuring machine.
//!
//! Every figure is about one fit, unless it is about a data set. Rows that the fit lists as outliers do not count in statistics but are counted.

mod artefact_cmm;
mod cause;
mod cmm;
mod compare;
mod compensated;
mod consistency;
mod drift;
mod figures;
mod folds;
mod geometric_bias;
mod hold_out;
mod in_parts;
mod influence;
mod minimal_set;
mod one_at_a_time;
mod prediction;
mod probing;
mod repeatability;
mod repeats;
mod residuals;
mod rivals;
mod sphere_touches;
mod sphericity;
#[cfg(test)]
mod testing;
mod tip_cmm;
mod uncertainty;
