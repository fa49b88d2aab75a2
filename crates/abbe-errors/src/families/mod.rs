//! The families, one file each: the settings of a line under `errors`, and the functions that are made from it.

mod b_spline;
mod constant;
mod cyclic;
mod drift;
mod expansion;
mod fourier;
mod gravity;
mod knots;
mod lag;
mod load;
mod orthogonal;
mod periodic;
mod piecewise;
mod polynomial;
mod product;
mod reversal;
mod spline;
mod thermal;
mod thermal_log;
mod thermal_terms;
mod travel;

use std::fmt::Debug;

use abbe_core::{PathItem, Quantity, SettingsError, Unit, Whole};

pub use b_spline::{BSpline, BSplines};
pub use constant::{Constant, Location, StylusIndicator};
pub use cyclic::{Cyclic, Waves};
pub use drift::{Drift, LegendreInTime, Per};
pub use expansion::{ExpandingScale, Expansion};
pub use fourier::{Fourier, FourierSeries};
pub use gravity::{Gravity, MomentsOfWeight};
pub use knots::Knots;
pub use lag::{Lag, Late};
pub use load::{Load, LocationUnderLoad, UnderLoad};
pub use orthogonal::{Chebyshev, Legendre, Orthogonal, OrthogonalPolynomial};
pub use periodic::{Periodic, PeriodicPieces};
pub use piecewise::{Piecewise, PiecewisePolynomial};
pub use polynomial::{OrdinaryPolynomial, Polynomial};
pub use product::{CrossCoupling, Product};
pub use reversal::{Backlash, Reversal};
pub use spline::{NaturalSpline, Spline};
pub use thermal::Thermal;
pub use thermal_terms::ThermalTerms;
pub use travel::{Trend, WithoutTrend};

/// An argument of a function. The model finds its value in the status.
#[derive(Debug, Clone, PartialEq)]
pub enum Argument {
    /// The command of the moving axis, mm or rad.
    Command,
    /// The command of another axis, by its name.
    CommandOf(String),
    /// The direction of the last approach of the moving axis: +1, -1, or 0 where it is not known.
    Direction,
    /// The velocity of the moving axis, mm/s; 0 where it is not recorded.
    Velocity,
    /// Time in s; NaN where it is not known.
    Time,
    /// The series that a pose belongs to, as the index of its label in the column of this name; NaN where it belongs to none.
    Series(String),
    /// The stylus, as the index of its label.
    Stylus,
    /// Weight of the workpiece, N.
    Load,
    /// Where the load sits along z of the table, from its centre, mm.
    LoadZ,
    /// A temperature in °C, by the name of its column without unit; NaN where it is not known.
    Temperature(String),
    /// A parameter of the function itself in the unit of the command, one for each error: suffix of its name and nominal
    /// value.
    Shape(String, f64),
    /// A parameter that functions of several errors share: its name, nominal value and unit.
    SharedShape(String, f64, Unit),
}

/// One function of a family: the suffix of its name, and the unit of its coefficient.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Term {
    /// `[2]`, `[b]`, `[t1]`; empty for a constant.
    pub suffix: String,
    /// The power in the denominator of the coefficient's unit.
    pub power: u8,
    /// The quantity of the power; none if it is the command of the moving axis.
    pub per: Option<Quantity>,
    /// Unit of the coefficient, if it does not follow from these.
    pub unit: Option<Unit>,
}

impl Term {
    pub(crate) fn new(suffix: impl Into<String>, power: u8) -> Self {
        Self { suffix: suffix.into(), power, per: None, unit: None }
    }

    /// Unit of the coefficient of an error of quantity `of` on an axis whose commands are of quantity `command`.
    pub fn unit(&self, of: Quantity, command: Quantity) -> Unit {
        self.unit.unwrap_or_else(|| Unit::per(of, self.per.unwrap_or(command), self.power))
    }
}

/// Functions of the status whose linear combination is an error.
pub trait Functions: Send + Sync + Debug {
    /// Their arguments; `values` and `slopes` get them in this order.
    fn arguments(&self) -> Vec<Argument>;

    /// The functions.
    fn terms(&self) -> Vec<Term>;

    /// The value of every function.
    fn values(&self, arguments: &[f64], out: &mut [f64]);

    /// The same at several places side by side: `arguments` are arguments x places, `out` is functions x places; `room` may hold anything.
    fn values_side_by_side(&self, places: usize, arguments: &[f64], room: &mut Vec<f64>, out: &mut [f64]) {
        let (count, functions) = (arguments.len() / places, out.len() / places);
        room.resize(count + functions, 0.0);
        let (own, values) = room.split_at_mut(count);
        for place in 0..places {
            own.iter_mut().enumerate().for_each(|(argument, own)| *own = arguments[argument * places + place]);
            self.values(own, values);
            values.iter().enumerate().for_each(|(function, value)| out[function * places + place] = *value);
        }
    }

    /// The derivative of every function to the argument with the number `by`; zero for those that do not change smoothly.
    fn slopes(&self, _by: usize, _arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
    }

    /// The range of commands of the moving axis for which they are defined; none if all commands are allowed.
    fn range(&self) -> Option<[f64; 2]> {
        None
    }

    /// Value of the coefficients of all functions if they are not estimated.
    fn nominal(&self) -> f64 {
        0.0
    }

    /// Standard uncertainty of that value.
    fn nominal_uncertainty(&self) -> f64 {
        0.0
    }

    /// Why they are not known at these arguments; none if they are.
    fn refused(&self, _arguments: &[f64]) -> Option<String> {
        None
    }

    /// The period of the functions in the command of the moving axis, with these arguments; none if they are not periodic.
    fn period(&self, _arguments: &[f64]) -> Option<f64> {
        None
    }

    /// The value of every function as an expression of C, of arguments that are names or numbers of C; none if they have no such form.
    fn in_c(&self, _arguments: &[String]) -> Option<Vec<String>> {
        None
    }

    /// Commands at which they are not smooth; between these they are.
    fn breaks(&self) -> &[f64] {
        &[]
    }
}

/// The kind of errors that a family can describe.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Errors of the location of axes.
    Location,
    /// Errors of the motion of axes.
    Motion,
    /// Errors of location and of motion.
    LocationOrMotion,
    /// Set-up parameters of tool and workpiece.
    SetUp,
    /// All of them.
    Any,
}

/// The error for which a family makes functions.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Whether it is an error of location.
    pub location: bool,
    /// Its quantity: length or angle.
    pub of: Quantity,
    /// Quantity of the commands of its axis.
    pub command: Quantity,
    /// Movement of the body that a linear axis carries, in the direction of the error, for a command of 1 mm; zero for errors
    /// that are angles.
    pub along: f64,
    /// Travel of its axis, mm or rad, if known.
    pub range: Option<[f64; 2]>,
    /// The axes of the machine, with the quantities of their commands.
    pub axes: &'a [(String, Quantity)],
    /// Labels of the series of a drift, in the order of their indices.
    pub labels: &'a [String],
}

/// One line under `errors`.
pub trait Family {
    /// The symbols (or patterns) that the line lists.
    fn symbols(&self) -> &[String];

    /// The kind of errors that the symbols can match.
    fn group(&self) -> Group {
        Group::Motion
    }

    /// Patterns of coefficients that are zero by definition and no parameters (setting `zero`).
    fn zero(&self) -> &[String] {
        &[]
    }

    /// Whether errors of one axis have the same functions.
    fn shares_functions(&self) -> bool {
        true
    }

    /// Checks the settings as far as they do not depend on the machine.
    fn check(&self) -> Result<(), SettingsError> {
        Ok(())
    }

    /// The functions for an error; fails if the family cannot describe this error.
    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError>;
}

/// Refuses a list of degrees or orders that is empty, or that has a number twice.
fn check_numbers<const LEAST: u64, const MOST: u64>(
    setting: &str,
    one: &str,
    given: &[Whole<LEAST, MOST>],
) -> Result<(), SettingsError> {
    if given.is_empty() {
        return Err(SettingsError::new(setting, format!("at least one {one} was expected")));
    }
    let twice = given.iter().enumerate().find(|(index, number)| given[..*index].contains(number));
    if let Some((index, number)) = twice {
        let message = format!("{one} {} stands here twice", number.get());
        return Err(SettingsError::new("", message).under([PathItem::Key(setting.to_owned()), PathItem::Index(index)]));
    }
    Ok(())
}

/// The numbers of a list of degrees or orders.
fn numbers<const LEAST: u64, const MOST: u64>(given: &[Whole<LEAST, MOST>]) -> Vec<u8> {
    given.iter().map(|number| number.get() as u8).collect()
}

/// Refuses a setting in mm for a rotary axis and one in degrees for a linear one; `(setting, what)` without unit.
fn suits((setting, what): (&str, &str), subject: &Subject<'_>, mm: bool, deg: bool) -> Result<(), SettingsError> {
    let wrong = |given: &str, axis: &str, unit: &str| {
        let verb = if what.ends_with('s') { "are" } else { "is made of" };
        let right = if given == "mm" { "deg" } else { "mm" };
        let message = format!("the {what} of a {axis} axis {verb} {unit}: `{setting}_{right}`");
        Err(SettingsError::new(&format!("{setting}_{given}"), message))
    };
    match subject.command {
        Quantity::Angle if mm => wrong("mm", "rotary", "angles"),
        Quantity::Length if deg => wrong("deg", "linear", "lengths"),
        _ => Ok(()),
    }
}

/// A power as products, which is faster for small degrees; polynomials spend most of their time here.
fn power(value: f64, degree: u8) -> f64 {
    match degree {
        0 => 1.0,
        1 => value,
        2 => value * value,
        3 => value * value * value,
        _ => value.powi(i32::from(degree)),
    }
}

/// A power as products, in C.
fn power_in_c(value: &str, degree: u8) -> String {
    if degree == 0 { "1.0".to_owned() } else { vec![value; usize::from(degree)].join(" * ") }
}

#[cfg(test)]
mod testing {
    use super::Functions;

    pub fn values(functions: &dyn Functions, arguments: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::NAN; functions.terms().len()];
        functions.values(arguments, &mut out);
        out
    }

    /// Checks that functions of one argument have the same values at several places side by side as at each.
    pub fn side_by_side_is_each(functions: &dyn Functions, places: &[f64]) {
        let count = places.len();
        let mut all = vec![f64::NAN; functions.terms().len() * count];
        functions.values_side_by_side(count, places, &mut vec![f64::NAN; 3], &mut all);
        for (place, argument) in places.iter().enumerate() {
            let own: Vec<f64> = all.iter().skip(place).step_by(count).copied().collect();
            assert_eq!(own, values(functions, &[*argument]), "{argument}");
        }
    }

    pub fn slopes(functions: &dyn Functions, arguments: &[f64]) -> Vec<f64> {
        slopes_by(functions, 0, arguments)
    }

    pub fn slopes_by(functions: &dyn Functions, by: usize, arguments: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::NAN; functions.terms().len()];
        functions.slopes(by, arguments, &mut out);
        out
    }

    pub fn names(functions: &dyn Functions) -> Vec<String> {
        functions.terms().into_iter().map(|term| term.suffix).collect()
    }

    /// Slopes against central differences.
    pub fn slopes_agree(functions: &dyn Functions, at: f64, step: f64, tolerance: f64) {
        slopes_agree_by(functions, 0, &[at], step, tolerance);
    }

    /// Slopes to an argument against central differences.
    pub fn slopes_agree_by(functions: &dyn Functions, by: usize, arguments: &[f64], step: f64, tolerance: f64) {
        let moved = |step: f64| {
            let mut arguments = arguments.to_vec();
            arguments[by] += step;
            values(functions, &arguments)
        };
        let (above, below) = (moved(step), moved(-step));
        for ((above, below), slope) in above.iter().zip(&below).zip(slopes_by(functions, by, arguments)) {
            let difference = (above - below) / (2.0 * step);
            assert!((difference - slope).abs() <= tolerance * slope.abs().max(1.0), "{difference} {slope}");
        }
    }
}
