//! Laws that every model, artefact and estimator keeps, whatever it is: for its own tests, for those of whoever ships one,
//! and for `abbe plugin check`.
//!
//! - [`of_model`]: derivatives of poses and of motion errors (so those of error families) are those of differences; poses
//!   do not depend on those beside them; names stand once.
//! - [`of_observations`]: derivatives of equations; rows do not depend on those beside them, nor on their order; names.
//! - [`of_estimator`]: errors that were put in come back from exact data, whatever the order of rows, the origin of the
//!   machine and the place of the artefact; a second run gives the same bytes; uncertainties are those of the covariance.
//!
//! Each gives what is broken, in sentences; nothing if all is well. [`virtual_problem`] is a small machine with data that
//! it made.

mod estimator;
mod model;
mod observations;
mod virtual_machine;

pub use estimator::{largest_derivatives, of_estimate, of_estimator};
pub use model::{of_model, samples};
pub use observations::of_observations;
pub use virtual_machine::virtual_problem;

use abbe_core::Parameter;

/// What is wrong with the names of parameters: one that is empty, or stands twice.
fn names<'a>(parameters: impl Iterator<Item = &'a Parameter>) -> Vec<String> {
    let mut names: Vec<&str> = parameters.map(|parameter| parameter.name.as_str()).collect();
    names.sort_unstable();
    let twice = names.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| format!("`{}` stands twice", pair[0]));
    let empty = names.first().filter(|name| name.is_empty()).map(|_| "a name is empty".to_owned());
    twice.chain(empty).collect()
}

/// Whether a derivative is that of differences.
fn agrees(given: f64, found: f64, allowed: f64) -> bool {
    (given - found).abs() <= allowed * given.abs().max(found.abs()).max(1.0)
}
