//! Least squares geometric elements: circle, sphere, plane, line and cylinder with the smallest sum of squared orthogonal
//! distances of the points (Gaussian associated features; ISO 10360-6; A. B. Forbes, *Least-squares best-fit geometric
//! elements*, NPL report DITC 140/89, 1991).
//!
//! Points and results share one unit of length. Data are centred and scaled first, so neither the distance from the origin
//! nor the unit matters; planes and lines come from a singular value decomposition, the others from an algebraic start and
//! Gauss-Newton iteration on the distances themselves.
//!
//! **Architecture invariant:** this crate knows points, not machines, artefacts or files.

mod cloud;
mod cylinder;
mod error;
mod fitted;
mod flat;
mod iteration;
mod round;
mod spatial;

pub use cylinder::{Cylinder, cylinder};
pub use error::FitError;
pub use fitted::Fitted;
pub use flat::{Line, Plane, across, line, plane};
pub use round::{Circle, Hypersphere, Sphere, circle, sphere};
pub use spatial::{SpatialCircle, SpatialFit, spatial_circle};
