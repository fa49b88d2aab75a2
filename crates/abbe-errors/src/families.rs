//! The functions of the families: values and slopes at a status.

use std::fmt::Debug;

use abbe_core::Quantity;

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

/// A constant: location errors and set-up parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Constant;

impl Functions for Constant {
    fn arguments(&self) -> &'static [Argument] {
        &[]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("", 0)]
    }

    fn values(&self, _: &[f64], out: &mut [f64]) {
        out[0] = 1.0;
    }
}

/// One for a stylus, zero for all others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StylusIs(pub usize);

impl Functions for StylusIs {
    fn arguments(&self) -> &'static [Argument] {
        &[Argument::Stylus]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("", 0)]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = f64::from(arguments[0] == self.0 as f64);
    }
}

/// Ordinary polynomials `q^n` of the axis command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OrdinaryPolynomial {
    /// The degrees n.
    pub degrees: Vec<u8>,
}

impl Functions for OrdinaryPolynomial {
    fn arguments(&self) -> &'static [Argument] {
        &[Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        self.degrees.iter().map(|&degree| Term::new(format!("[{degree}]"), degree)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        for (value, &degree) in out.iter_mut().zip(&self.degrees) {
            *value = arguments[0].powi(i32::from(degree));
        }
    }

    fn slopes(&self, arguments: &[f64], out: &mut [f64]) {
        for (slope, &degree) in out.iter_mut().zip(&self.degrees) {
            let degree = i32::from(degree);
            *slope = if degree == 0 { 0.0 } else { f64::from(degree) * arguments[0].powi(degree - 1) };
        }
    }
}

/// The direction of approach: its coefficient is half the reversal value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reversal;

impl Functions for Reversal {
    fn arguments(&self) -> &'static [Argument] {
        &[Argument::Direction]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("[b]", 0)]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = arguments[0];
    }
}

/// Legendre polynomials of the time scaled to -1..1 over a series; zero in other series and without a time.
#[derive(Debug, Clone, PartialEq)]
pub struct LegendreInTime {
    /// The degrees.
    pub degrees: Vec<u8>,
    /// First and last time of the series, s.
    pub time: [f64; 2],
    /// Index of the series' label; none if there is one series only.
    pub series: Option<usize>,
    /// What the names begin with inside the bracket: `day2.`.
    pub prefix: String,
}

impl Functions for LegendreInTime {
    fn arguments(&self) -> &'static [Argument] {
        if self.series.is_some() { &[Argument::Time, Argument::Series] } else { &[Argument::Time] }
    }

    fn terms(&self) -> Vec<Term> {
        self.degrees.iter().map(|degree| Term::new(format!("[{}t{degree}]", self.prefix), 0)).collect()
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        let elsewhere = self.series.is_some_and(|series| arguments[1] != series as f64);
        if elsewhere || arguments[0].is_nan() {
            return out.fill(0.0);
        }
        let [from, to] = self.time;
        let scaled = if to > from { (2.0 * arguments[0] - from - to) / (to - from) } else { 0.0 };
        for (value, &degree) in out.iter_mut().zip(&self.degrees) {
            *value = legendre(degree, scaled);
        }
    }
}

/// The Legendre polynomial of a degree by Bonnet's recursion.
fn legendre(degree: u8, x: f64) -> f64 {
    let (mut before, mut current) = (1.0, x);
    for n in 1..degree {
        let n = f64::from(n);
        (before, current) = (current, ((2.0 * n + 1.0) * x * current - n * before) / (n + 1.0));
    }
    if degree == 0 { 1.0 } else { current }
}

/// The unit of a coefficient: the unit of the error per power of that of the command.
impl Term {
    /// Unit of the coefficient of an error of quantity `of` on an axis whose commands are of quantity `command`.
    pub fn unit(&self, of: Quantity, command: Quantity) -> abbe_core::Unit {
        abbe_core::Unit::per(of, command, self.power)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(functions: &dyn Functions, arguments: &[f64]) -> Vec<f64> {
        let mut out = vec![f64::NAN; functions.terms().len()];
        functions.values(arguments, &mut out);
        out
    }

    #[test]
    fn functions_at_known_places() {
        let polynomial = OrdinaryPolynomial { degrees: vec![0, 1, 3] };
        assert_eq!(values(&polynomial, &[-2.0]), [1.0, -2.0, -8.0]);
        assert_eq!(values(&Reversal, &[-1.0]), [-1.0]);
        let drift =
            |series| LegendreInTime { degrees: vec![1, 2, 4], time: [10.0, 30.0], series, prefix: String::new() };
        assert_eq!(values(&drift(None), &[10.0]), [-1.0, 1.0, 1.0]);
        assert_eq!(values(&drift(None), &[20.0]), [0.0, -0.5, 0.375]);
        assert_eq!(values(&drift(None), &[f64::NAN]), [0.0; 3]);
        assert_eq!(values(&drift(Some(1)), &[30.0, 1.0]), [1.0; 3]);
        assert_eq!(values(&drift(Some(1)), &[30.0, 0.0]), [0.0; 3]);
        assert_eq!(values(&StylusIs(1), &[1.0]), [1.0]);
        assert_eq!(values(&StylusIs(1), &[0.0]), [0.0]);
    }

    #[test]
    fn names_of_terms() {
        let drift =
            LegendreInTime { degrees: vec![2], time: [0.0, 1.0], series: Some(0), prefix: Per::Day.prefix("2") };
        assert_eq!(drift.terms()[0].suffix, "[day2.t2]");
        assert_eq!(Reversal.terms()[0].suffix, "[b]");
    }

    use crate::Per;

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(at in -5.0..5.0_f64, degrees in proptest::collection::vec(0u8..=9, 1..4)) {
            let polynomial = OrdinaryPolynomial { degrees };
            let step = 1e-5;
            let (above, below) = (values(&polynomial, &[at + step]), values(&polynomial, &[at - step]));
            let mut slopes = vec![0.0; above.len()];
            polynomial.slopes(&[at], &mut slopes);
            for ((above, below), slope) in above.iter().zip(&below).zip(&slopes) {
                let difference = (above - below) / (2.0 * step);
                assert!((difference - slope).abs() <= 1e-7 * slope.abs().max(1e3), "{difference} {slope}");
            }
        }
    }
}
