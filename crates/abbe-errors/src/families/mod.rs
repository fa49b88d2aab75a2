//! The families, one file each: what a line under `errors` says, and the functions that it becomes.

mod constant;
mod drift;
mod fourier;
mod polynomial;
mod reversal;
mod spline;

use std::fmt::Debug;
use std::ops::RangeInclusive;

use abbe_core::{PathItem, Quantity, SettingsError};

pub use constant::{Constant, Location, StylusIs};
pub use drift::{Drift, LegendreInTime, Per};
pub use fourier::{Fourier, FourierSeries};
pub use polynomial::{OrdinaryPolynomial, Polynomial};
pub use reversal::{Backlash, Reversal};
pub use spline::{EvenKnots, Knots, NaturalSpline, Spline};

/// What a function is a function of; a model knows where it finds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Argument {
    /// The command of the moving axis, mm or rad.
    Command,
    /// The direction of the last approach of the moving axis: +1, -1, or 0 where it is not known.
    Direction,
    /// Time in s; NaN where it is not known.
    Time,
    /// The series that a pose belongs to, as the index of its label; NaN where it belongs to none.
    Series,
    /// The stylus, as the index of its label.
    Stylus,
}

/// One function of a family: what its name says in the bracket, and what its coefficient is per.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Term {
    /// `[2]`, `[b]`, `[t1]`; empty for a constant.
    pub suffix: String,
    /// The power of the unit of the command in the denominator of the coefficient's unit.
    pub power: u8,
}

impl Term {
    fn new(suffix: impl Into<String>, power: u8) -> Self {
        Self { suffix: suffix.into(), power }
    }

    /// Unit of the coefficient of an error of quantity `of` on an axis whose commands are of quantity `command`.
    pub fn unit(&self, of: Quantity, command: Quantity) -> abbe_core::Unit {
        abbe_core::Unit::per(of, command, self.power)
    }
}

/// Functions of the status whose linear combination is an error.
pub trait Functions: Send + Sync + Debug {
    /// What they are functions of; `values` and `slopes` take the arguments in this order.
    fn arguments(&self) -> &'static [Argument];

    /// The functions.
    fn terms(&self) -> Vec<Term>;

    /// The value of every function.
    fn values(&self, arguments: &[f64], out: &mut [f64]);

    /// The derivative of every function to the first argument; zero for those that do not change smoothly.
    fn slopes(&self, _arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
    }
}

/// Checks a list of degrees or orders: not empty, within `allowed`, each once.
fn whole_numbers(setting: &str, one: &str, given: &[u8], allowed: RangeInclusive<u8>) -> Result<(), SettingsError> {
    if given.is_empty() {
        return Err(SettingsError::new(setting, format!("at least one {one} was expected")));
    }
    for (index, number) in given.iter().enumerate() {
        let at = |message: String| {
            SettingsError::new("", message).under([PathItem::Key(setting.to_owned()), PathItem::Index(index)])
        };
        if !allowed.contains(number) {
            let (least, most) = (allowed.start(), allowed.end());
            return Err(at(format!("{one} {number}: {least} to {most} was expected")));
        }
        if given[..index].contains(number) {
            return Err(at(format!("{one} {number} stands here twice")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod testing {
    use super::Functions;

    pub fn values(functions: &dyn Functions, arguments: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::NAN; functions.terms().len()];
        functions.values(arguments, &mut out);
        out
    }

    pub fn slopes(functions: &dyn Functions, arguments: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::NAN; functions.terms().len()];
        functions.slopes(arguments, &mut out);
        out
    }

    /// Slopes against central differences.
    pub fn slopes_agree(functions: &dyn Functions, at: f64, step: f64, tolerance: f64) {
        let (above, below) = (values(functions, &[at + step]), values(functions, &[at - step]));
        for ((above, below), slope) in above.iter().zip(&below).zip(slopes(functions, &[at])) {
            let difference = (above - below) / (2.0 * step);
            assert!((difference - slope).abs() <= tolerance * slope.abs().max(1.0), "{difference} {slope}");
        }
    }
}
