//! Problems of block arrow structure: many unknowns, of which each row has a few besides those that all rows share.

mod accumulate;
mod factor;
mod groups;
mod reflect;
mod spectrum;

pub use accumulate::{ArrowAccumulator, OfTwoGroups};
pub use factor::ArrowFactor;
pub use groups::{GroupSearch, Groups};
pub use spectrum::ArrowSpectrum;
