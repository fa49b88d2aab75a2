//! Parametric error families: functions of the machine status (axis position, direction, time and, later, load and
//! temperature) that an error is a linear combination of.
//!
//! A [`Declaration`] is what a recipe says under `errors`; [`Functions`] are what it becomes for one axis or set-up.
//! A new family is a file in `families/`, with its settings and its [`Functions`], and a line in `declaration.rs`.

mod declaration;
mod families;

pub use declaration::Declaration;
pub use families::{
    Argument, Backlash, Constant, Drift, EvenKnots, Fourier, FourierSeries, Functions, Knots, LegendreInTime, Location,
    NaturalSpline, OrdinaryPolynomial, Per, Polynomial, Reversal, Spline, StylusIs, Term,
};
