//! Numerics on faer: accumulated QR of scaled least squares problems, rank and null space, covariance, Gauss-Newton with
//! step control, robust weights, and the tests of significance that go with them.
//!
//! **Architecture invariant:** this crate knows rows of numbers, not machines. faer runs single-threaded (its parallel
//! feature is off), because its results would otherwise depend on the number of cores.

mod factor;
mod gauss_newton;
mod robust;
mod significance;

pub use factor::{Accumulator, Factor, SingularValues, Spectrum, Whitener};
pub use gauss_newton::{End, LeastSquares, Options, Sink, Solution, solve};
pub use robust::{Loss, Robust, RobustReport};
pub use significance::{f_test, two_sided_normal};
