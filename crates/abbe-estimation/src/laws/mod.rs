//! Laws that every model, artefact and estimator has to keep. They are used in tests of plugins, and by `abbe plugin check`.
//!
//! - [`check_model`]: derivatives of poses and of motion errors (so those of error families) agree with difference quotients; a
//!   pose does not depend on other poses of its batch; names are unique.
//! - [`check_observations`]: derivatives of equations agree with difference quotients; rows do not depend on other rows of their
//!   batch, nor on their order; names are unique.
//! - [`check_gradient`]: sums of derivatives times residuals are those of the rows.
//! - [`check_independence`]: an artefact that says that its rows are independent makes the same of some rows as of all.
//! - [`check_parts`]: an estimator that takes rows in parts makes of them what it makes of all rows.
//! - [`check_estimator`]: the given errors are found again from exact data, for any order of rows, origin of the machine and
//!   position of the artefact; a second run gives the same bytes; uncertainties are those of the covariance.
//!
//! Each gives a sentence for every broken law; an empty list if all laws are kept. [`virtual_problem`] is a small machine
//! with its data.

mod estimator;
mod independence;
mod model;
mod observations;
mod parts;
mod virtual_machine;

pub use estimator::{check_estimate, check_estimator, largest_derivatives};
pub use independence::check_independence;
pub use model::{check_model, check_model_within, samples};
pub use observations::{check_gradient, check_observations};
pub use parts::check_parts;
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

/// Whether a derivative agrees with a difference quotient.
fn agrees(given: f64, found: f64, allowed: f64) -> bool {
    (given - found).abs() <= allowed * given.abs().max(found.abs()).max(1.0)
}
