//! The virtual machine: at which axis positions a machine with known errors really meets an artefact with known errors, as
//! measured with a probe of known noise, drift, lobing and resolution.
//!
//! Positions follow from the exact equations of the model and the artefact and not from their linear form, so that what an
//! estimator makes of them shows its own faults too (Soons 1993; Viprey 2019). Simulation shares the kinematics with the
//! estimator all the same: it proves that the two are consistent, not that either is correct.
//!
//! **Architecture invariant:** this crate does no I/O. It gets a [`Problem`] and gives one, which any estimator solves
//! without a file in between.

mod listed;
mod lobing;
mod measure;
mod names;
mod noise;
mod sensors;
mod truth;

pub use lobing::{Lobing, contact_directions};
pub use measure::measure;
pub use names::NotSimulated;
pub use noise::{Drift, Noise, Outliers, RandomOutliers, StandardDeviation};
pub use sensors::{BySensor, Recorded, Sensors};
pub use truth::Truth;

#[cfg(doc)]
use abbe_core::Problem;
