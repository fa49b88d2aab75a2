//! Parametric error families: functions of the machine status (axis position, direction, time, load). An error is a linear
//! combination of them.
//!
//! A [`Declaration`] is an entry of a recipe under `errors`; from it the [`Functions`] for one axis or set-up are made. A new
//! family is a file in `families/`, with its settings ([`Family`]) and its [`Functions`], and a line in `declaration.rs`.

mod bodies;
mod declaration;
mod families;
mod log;

pub use bodies::{Body, BodyKind, BodyTerms, Guide, Mount, Section, Turning};
pub use declaration::Declaration;
pub use families::*;
