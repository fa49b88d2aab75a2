//! Parametric error families: functions of the machine status (axis position, direction, time and, later, load and
//! temperature) that an error is a linear combination of.
//!
//! A [`Declaration`] is what a recipe says under `errors`; [`Functions`] are what it becomes for one axis or set-up.
//! A new family is a struct with its settings, an implementation of [`Functions`] and a line in `declaration.rs`.

mod declaration;
mod families;

pub use declaration::{Backlash, Declaration, Drift, Location, Per, Polynomial};
pub use families::{Argument, Constant, Functions, LegendreInTime, OrdinaryPolynomial, Reversal, StylusIs, Term};
