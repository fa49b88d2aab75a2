//! Figures that standards and published rules define, as pure functions of readings.
//!
//! A module is a standard, or the part of one that belongs together. Functions take numbers in the units that their page says and
//! give numbers; what they cannot answer is `None`. Where the text of a standard was not at hand its module says so.

pub mod circular;
pub mod conformity;
pub mod diagonals;
pub mod lengths;
pub mod material;
pub mod positioning;
pub mod probing;
pub mod rotary_interpolation;
pub mod spindle;
pub mod thermal_drift;
mod zone;

#[cfg(test)]
mod expected;
