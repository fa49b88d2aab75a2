//! Numerics on faer: accumulated QR of scaled least squares problems, rank and null space, covariance, Gauss-Newton
//! with step control, robust weights, and the tests of significance that go with them; coverage factors, and the
//! propagation of distributions by random trials; the choice of measurements by optimal design.
//!
//! # Least squares
//! A [`LeastSquares`] problem gives rows of unit variance: residuals `e(x)` and derivatives `A`. Householder reflections
//! reduce them, block by block, to the upper triangle R of `A D^-1 = Q R`, where D are the norms of the columns. So A is
//! never stored as a whole ([`Accumulator`], [`Factor`]). The step of Gauss-Newton is
//!
//! ```text
//! R y = -Q^T e,    dx = D^-1 y
//! ```
//!
//! It is halved as long as it makes `e^T W e` larger. The iteration has converged when the remaining error of the estimate is
//! below the tolerance, in standard uncertainties of all rows together ([`Options`] has the rule with its constants).
//!
//! # Rank and covariance
//! The singular values of R give rank and condition. The vectors of singular values below a part of the largest one span the
//! null space ([`Spectrum`]). With `A^T A = D R^T R D` the covariance of the estimates is `P P^T`, `P = D^-1 R^-1`
//! ([`CovarianceRoot`]); without full rank, the columns of P are the singular vectors divided by their singular values,
//! within the rank. Sensitivities to further columns B are `G = -P P^T A^T B`.
//!
//! # Robust weights
//! Weights are a function of studentised deleted residuals divided by their scale ([`Robust`]; Huber 1964, Beaton & Tukey 1974):
//! how far a row is from what the others say of it. They are computed in rounds until they no longer change; each round lowers one
//! objective. [`scatter_factor`] makes a factor of uncertainties of the influences.
//!
//! # Example
//! A line through three points:
//!
//! ```
//! use abbe_numerics::{LeastSquares, Options, Sink, solve};
//!
//! struct Line;
//!
//! impl LeastSquares for Line {
//!     type Error = std::convert::Infallible;
//!     fn unknowns(&self) -> usize { 2 }
//!     fn rows(&self) -> usize { 3 }
//!     fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), Self::Error> {
//!         for (row, (at, measured)) in [(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)].into_iter().enumerate() {
//!             sink(row, &[x[0] + x[1] * at - measured], &[1.0, at]);
//!         }
//!         Ok(())
//!     }
//! }
//!
//! let found = solve(&Line, &[0.0, 0.0], &Options::USUAL).unwrap();
//! assert!((found.x[0] - 1.0).abs() < 1e-12 && (found.x[1] - 2.0).abs() < 1e-12);
//! assert_eq!(found.factor.singular_values().rank(1e-10), 2);
//! ```
//!
//! **Architecture invariant:** this crate works on rows of numbers and knows no machines. faer runs single-threaded (its
//! parallel feature is off), because its results would otherwise depend on the number of cores.

mod accumulate;
mod arrow;
mod channels;
mod coverage;
mod descent;
mod design;
mod directions;
mod factor;
mod gauss_newton;
mod left_out;
mod lower;
mod monte_carlo;
mod near;
mod one_pass;
mod passes;
mod regression;
mod repeated_channel;
mod reweighting;
mod robust;
mod row_noise;
mod sampling;
mod selection;
mod significance;
mod vector;
mod without_unknowns;

pub use accumulate::Accumulator;
pub use arrow::{ArrowAccumulator, ArrowFactor, ArrowSpectrum, GroupSearch, Groups, OfTwoGroups};
pub use channels::{
    Channel, ClippedEnd, InstrumentFault, clipped_ends, instrument_faults, repeats_are_copies, resolution,
};
pub use coverage::{
    binomial_band, binomial_upper_tail, chi_squared_quantile, chi_squared_upper_tail, correlation_by_chance,
    coverage_factor, drawn_by_chance, effective_degrees_of_freedom, hotelling_quantile, hotelling_upper_tail,
    joint_coverage_factor, rectangular_coverage_factor,
};
pub use descent::{Descent, Steps, solve_plain};
pub use design::{Criterion, Design, DesignFigures, DesignProblem};
pub use directions::{Directions, RestrictedProblem};
pub use factor::{CandidateTerm, CovarianceRoot, Factor, Information, SingularValues, Spectrum};
pub use gauss_newton::{End, LeastSquares, Options, Sink, Solution, solve, solve_from};
pub use lower::Lower;
pub use monte_carlo::{
    AdaptiveProcedure, Agreement, Interval, Trials, compare_with_gum, least_trials, numerical_tolerance,
};
pub use near::{solve_by_gradients, solve_near};
pub use one_pass::{Chosen, Ends};
pub use passes::{HuberPoint, InPasses, RobustPass, RowWeight, Weighing, huber_point, solve_in_passes};
pub use regression::{Influence, SelectionStep, StepwiseDirection, StepwiseSelection};
pub use repeated_channel::Repeats;
pub use robust::{Loss, Robust, RobustReport, counted_scatter_factor, scatter_factor};
pub use row_noise::{RowNoise, row_noise};
pub use sampling::{Generator, mixed};
pub use selection::{Selection, UnestimableUnknown};
pub use significance::{f_test, two_sided_normal};
pub use vector::{dot, norm};
