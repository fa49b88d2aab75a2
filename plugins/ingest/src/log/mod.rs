//! Logs of measuring programs: one form for all controls, matched to the plan by the numbers of the touches.
//!
//! `words` cuts lines, `record` understands them, `controls` says what each control prints besides, `grbl` reads the console of
//! a host, `step` whether its answers fit the lines that were sent, `plan` knows what was expected, `far` compares, `matched` makes the data set.

mod controls;
mod far;
mod grbl;
mod matched;
mod plan;
mod record;
mod step;
mod words;

pub(crate) use record::shown;
pub(crate) use words::{Word, words};

#[cfg(test)]
mod tests;
