//! Numerics on faer: accumulated QR of scaled least squares problems, rank and null space, covariance, Gauss-Newton
//! with step control, robust weights, and the tests of significance that go with them; coverage factors, and the
//! propagation of distributions by random trials; the choice of measurements by optimal design.
//!
//! **Architecture invariant:** this crate knows rows of numbers, not machines. faer runs single-threaded (its parallel
//! feature is off), because its results would otherwise depend on the number of cores.

mod accumulate;
mod coverage;
mod design;
mod factor;
mod gauss_newton;
mod linear;
mod monte_carlo;
mod regression;
mod robust;
mod sampling;
mod selection;
mod significance;

pub use accumulate::Accumulator;
pub use coverage::{
    binomial_band, chi_squared_quantile, chi_squared_upper_tail, coverage_factor, effective_degrees_of_freedom,
    hotelling_quantile, hotelling_upper_tail, joint_coverage_factor, rectangular_coverage_factor,
};
pub use design::{Choice, Criterion, Design, DesignFigures};
pub use factor::{Factor, Information, Joining, SingularValues, Spectrum, Whitener};
pub use gauss_newton::{End, LeastSquares, Options, Sink, Solution, solve, solve_from};
pub use linear::{DesignMatrix, LinearFit, fit_linear};
pub use monte_carlo::{Adaptive, Agreement, Interval, Trials, gum_agrees, least_trials, numerical_tolerance};
pub use regression::{Direction, Influence, SelectionStep, StepwiseSelection};
pub use robust::{Loss, Robust, RobustReport};
pub use sampling::Generator;
pub use selection::{LeftOut, Selection};
pub use significance::{f_test, two_sided_normal};
