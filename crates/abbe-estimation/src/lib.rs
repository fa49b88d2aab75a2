//! Everything that an estimator needs beside its own iteration: rows of unit variance, nominal contact, rank, propagation of
//! uncertainty, and advice on what to measure.
//!
//! # Model
//! A [`Problem`](abbe_core::Problem) has residuals `r(x)`, n equations in m unknowns x, with the stated covariance `V` of the
//! readings. [`Weighted`] transforms them to independent rows of unit variance, together with their derivatives `J`:
//!
//! ```text
//! e(x) = L^-1 r(x),    V = L L^T,    A = L^-1 J
//! ```
//!
//! An estimate minimises `e^T W e`, where W are robust weights, or 1. Everything else is the same for all kinds of iteration.
//!
//! # Rank
//! Rank, condition and null space are those of `A D^-1` (D makes the columns have norm 1) for the nominal machine and artefact at
//! **nominal contact** ([`Judgement`]): products of errors, and residuals at recorded positions ([`rank_point`]), act as if they were
//! information. Columns that are rounding, or digits of the data, are zero. Singular values below a part of the largest (1e-10, say)
//! count as zero; the vectors that belong to them are the directions that the data cannot tell.
//!
//! # Uncertainty
//! Three kinds of input make the covariance of the estimates ([`Propagation`]; JCGM 102:2011, equation 3):
//!
//! ```text
//! C = s^2 (A^T A)^-1  +  G K K^T G^T / f  +  G B S B^T G^T,    G = -(A^T A)^-1 A^T L^-1
//! ```
//!
//! - stated scatter, times the square of the a-posteriori factor `s^2 = e^T W e / (n - m)` (one for all, or one for every
//!   artefact: [`components`]); constraints of certificates are left out of s and are not multiplied by it;
//! - the scatter of repeats, with their deviations K and f degrees of freedom;
//! - considered quantities (known inputs, an earlier estimate), with derivatives B and covariance S.
//!
//! Without a unique solution, C belongs to the solution with the smallest effect of the unknowns, and every value in a lost
//! direction is marked as confounded.
//!
//! # An estimator of one's own
//! An estimator solves `Weighted` by its own iteration and passes the solution to [`UncertaintyEvaluation::calibration`].
//! `examples/own_estimator.rs` is a short example.
//!
//! **Architecture invariant:** this crate does no I/O and knows no plugin.

mod aliasing;
mod as_recorded;
mod beside;
mod calibration;
mod causes;
mod channels;
mod compared;
pub mod contact;
mod copies;
mod directions;
mod eliminated;
mod equivalent_motion_errors;
mod exchanged;
mod exchanged_channels;
mod gathered;
mod instruments;
mod inverse_kinematics;
mod judgement;
pub mod laws;
mod location;
mod lone_row;
mod lost_signs;
mod minutes;
mod mistakes;
mod parts;
mod places;
mod planned;
mod plausibility;
mod plausible;
mod preference;
mod probe_offset;
mod propagation;
mod quiet_channels;
mod rank;
mod reading_units;
mod remarks;
mod repeated_rows;
pub mod repeats;
mod residual_rows;
mod residuals;
mod row_order;
mod row_settings;
pub mod row_uncertainty;
mod separation;
mod solved;
mod times;
mod turned_readings;
mod variance;
mod variance_in_parts;
mod wavelength;
mod weighed_parts;
mod weighted;

pub use aliasing::aliased;
pub use calibration::calibration;
pub use causes::likely_causes;
pub use channels::dead_channels;
pub use compared::explaining_machine;
pub use contact::{Variation, at_contact, is_judged_as_recorded, rank_point};
pub use copies::{copied_runs, copies, repeated};
pub use eliminated::EliminatedRows;
pub use equivalent_motion_errors::equivalent_motion_errors;
pub use gathered::gathered_outliers;
pub use inverse_kinematics::InverseKinematics;
pub use judgement::Judgement;
pub use location::{LocationError, LocationErrors, Standing, location_errors};
pub use lone_row::{doubtful_row, spoiling_row, statement};
pub use mistakes::likely_mistakes;
pub use parts::{ChangedParts, RowsAtHand, RowsInParts, SolutionOfParts, joined_evidence, looked_at, part_evidence};
pub use plausibility::{
    Contradicted, LargeError, absurd_error, contradicted, implausible_errors, large_errors, opposite_factor,
};
pub use plausible::Plausible;
pub use preference::{check_preferences, in_order_of_preference};
pub use propagation::{AposterioriFactors, Linearisation, Propagation};
pub use quiet_channels::quiet_channels;
pub use rank::{confounded, identifiability, ill_conditioned, separated, weakest};
pub use remarks::{comparisons, missed, remarks, remarks_of_chosen_rows};
pub use repeated_rows::{pasted_rows, repeated_in_words};
pub use residual_rows::{RowResidual, residual_rows};
pub use residuals::{Constraints, ResidualStatistics, Sizes, outliers, radial_rms};
pub use row_settings::{Ids, PooledRepeats, RowSettings, RowUncertainty, SharedError};
pub use separation::{SeparationTrials, separating_measurements};
pub use solved::{EstimatorSolution, RankDeficiency, UncertaintyEvaluation};
pub use times::falling_times;
pub use variance::{VarianceComponents, components, with_factors_found};
pub use variance_in_parts::components_of_parts;
pub use wavelength::{Wavelength, rival_wavelengths, wavelengths};
pub use weighted::{MOST_AT_ONCE, Weighted};
