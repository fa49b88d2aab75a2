//! Volumetric error: how far the tip is from where it would be on the nominal machine, anywhere in the workspace, and how
//! well a calibration knows that.
//!
//! The error of a pose is the actual tip minus the nominal tip, table frame (VIM 2.16). Its uncertainty is that of the
//! calibrated parameters, propagated with their covariance (Soons 1993, appendix A.2).

mod causes;
mod ellipsoid;
mod grid;
mod predict;
mod sampling;
#[cfg(test)]
mod testing;

pub use causes::{Cause, Causes, Known, causes, is_machine_error, rms_without};
pub use ellipsoid::Ellipsoid;
pub use grid::{Grid, MOST_POSES, Points, standing};
pub use predict::{VolumetricError, machine_covariance, predict};
pub use sampling::{
    Range, Ranges, Steps, check_axes, check_ranges, places, points_every, position_unit, range_of, rounded_position,
    within,
};
