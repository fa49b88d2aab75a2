//! Piecewise polynomials in truncated powers.

use std::ops::RangeInclusive;

use abbe_core::{Quantity, SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::knots::{Knots, knots, within};
use super::travel::Travel;
use super::{Argument, Family, Functions, Subject, Term, power, power_in_c, suits};

/// Piecewise polynomials (Soons 1993, eq. 3.2): powers `EXX[1]`, `EXX[2]` of the command up to the degree, and
/// `EXX[pp3,2]`, the square of the way beyond knot 3 and zero before it. There is no constant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Piecewise {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub piecewise: Vec<String>,
    /// Degree of the pieces, 1 to 9.
    pub degree: Whole<1, 9>,
    /// What is continuous at knots: 0 the value, 1 the slope too.
    pub continuity: Whole<0, 8>,
    /// Inner knots of errors of a linear axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_mm: Option<Knots>,
    /// Inner knots of errors of a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knots_deg: Option<Knots>,
    /// Travel of a linear axis. Default: the range of the axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_mm: Option<[f64; 2]>,
    /// Travel of a rotary axis. Default: the range of the axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_deg: Option<[f64; 2]>,
    /// For straightness: every function is taken without its least-squares line over the travel.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub without_line: bool,
    /// For errors of a rotary axis: every function is taken without its once-per-turn part.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub without_once_per_turn: bool,
    /// Every function is taken without its value at the command 0, which is not zero if a knot is below 0. The error at
    /// the command 0 is then zero for any coefficients.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub zero_at_zero: bool,
}

impl Piecewise {
    fn travel(&self) -> Travel {
        Travel {
            range_mm: self.range_mm,
            range_deg: self.range_deg,
            without_line: self.without_line,
            without_once_per_turn: self.without_once_per_turn,
        }
    }
}

impl Family for Piecewise {
    fn symbols(&self) -> &[String] {
        &self.piecewise
    }

    fn check(&self) -> Result<(), SettingsError> {
        check(self.degree, self.continuity)?;
        knots("a piecewise polynomial", &self.knots_mm, &self.knots_deg, 1)?;
        self.travel().check()
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        suits(("knots", "knots"), subject, self.knots_mm.is_some(), self.knots_deg.is_some())?;
        let knots = knots("a piecewise polynomial", &self.knots_mm, &self.knots_deg, 1)?;
        let range = self.travel().range(subject)?;
        if let Some(range) = range {
            within(&knots, range, subject.command == Quantity::Angle)?;
        }
        // A line without its least-squares line is zero, so degree 1 is left out.
        let powers = if self.without_line { 2 } else { 1 }..=self.degree.get() as u8;
        let mut functions = PiecewisePolynomial::new(knots, powers, self.continuity.get() as u8, range);
        if self.zero_at_zero {
            functions = functions.zero_at_zero();
        }
        Ok(vec![self.travel().without_trend(Box::new(functions), subject)?])
    }
}

pub(super) fn check(degree: Whole<1, 9>, continuity: Whole<0, 8>) -> Result<(), SettingsError> {
    let (degree, continuity) = (degree.get(), continuity.get());
    if continuity >= degree {
        let message = format!(
            "pieces of degree {degree} that continue {continuity} times have no knots: 0 to {} was expected",
            degree - 1
        );
        return Err(SettingsError::new("continuity", message));
    }
    Ok(())
}

/// Powers `q^n` of the command, and truncated ones: `(q - t)^n` beyond a knot t, zero before it.
#[derive(Debug, Clone, PartialEq)]
pub struct PiecewisePolynomial {
    knots: Vec<f64>,
    powers: RangeInclusive<u8>,
    truncated: RangeInclusive<u8>,
    range: Option<[f64; 2]>,
    /// Constants that are subtracted from the functions; none if empty.
    constants: Vec<f64>,
}

impl PiecewisePolynomial {
    /// Powers of the command from 1 on, truncated powers from `continuity` + 1 to the largest of them at every knot, and the travel.
    pub fn new(knots: Vec<f64>, powers: RangeInclusive<u8>, continuity: u8, range: Option<[f64; 2]>) -> Self {
        let truncated = continuity + 1..=*powers.end();
        Self { knots, powers, truncated, range, constants: Vec::new() }
    }

    /// The same functions without their values at the command 0.
    ///
    /// Data below 0 determine the functions with knots there up to their knots only. At 0, far from the knots, the error
    /// would be a small difference of large numbers.
    pub fn zero_at_zero(mut self) -> Self {
        let mut constants = vec![0.0; self.names().count()];
        self.each(0.0, &mut constants, |_, way, below| way * below);
        self.constants = constants;
        self
    }

    /// The name inside the bracket, with the power.
    pub(super) fn names(&self) -> impl Iterator<Item = (String, u8)> {
        let powers = self.powers.clone().map(|power| (power.to_string(), power));
        let truncated = (1..=self.knots.len())
            .flat_map(|knot| self.truncated.clone().map(move |power| (format!("pp{knot},{power}"), power)));
        powers.chain(truncated)
    }

    /// Calls `of` for every function with: power, distance from the origin or beyond the knot, and this distance to the power
    /// minus 1.
    fn each(&self, command: f64, out: &mut [f64], of: impl Fn(u8, f64, f64) -> f64) {
        let last = *self.powers.end();
        let mut out = out.iter_mut();
        let mut put = |way: f64, first: u8| {
            let mut below = power(way, first - 1);
            for (power, out) in (first..last + 1).zip(&mut out) {
                *out = of(power, way, below);
                below *= way;
            }
        };
        put(command, *self.powers.start());
        for knot in &self.knots {
            put((command - knot).max(0.0), *self.truncated.start());
        }
    }
}

impl Functions for PiecewisePolynomial {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        self.names().map(|(name, power)| Term::new(format!("[{name}]"), power)).collect()
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        let command = arguments.first()?;
        let powers = self.powers.clone().map(|degree| power_in_c(command, degree));
        let truncated = self.knots.iter().flat_map(|knot| {
            let beyond = format!("fmax({command} - ({knot:e}), 0.0)");
            self.truncated.clone().map(move |degree| power_in_c(&beyond, degree))
        });
        let constants = self.constants.iter().copied().chain(std::iter::repeat(0.0));
        Some(powers.chain(truncated).zip(constants).map(|(value, less)| format!("({value} - ({less:e}))")).collect())
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        self.each(arguments[0], out, |_, way, below| way * below);
        out.iter_mut().zip(&self.constants).for_each(|(out, constant)| *out -= constant);
    }

    fn values_side_by_side(&self, places: usize, arguments: &[f64], room: &mut Vec<f64>, out: &mut [f64]) {
        room.resize(2 * places, 0.0);
        let (ways, below) = room.split_at_mut(places);
        let mut rows = out.chunks_exact_mut(places);
        let mut put = |ways: &[f64], powers: &RangeInclusive<u8>| {
            below.iter_mut().zip(ways).for_each(|(below, way)| *below = power(*way, powers.start() - 1));
            for row in rows.by_ref().take(powers.clone().count()) {
                for ((value, below), way) in row.iter_mut().zip(&mut *below).zip(ways) {
                    *value = way * *below;
                    *below *= way;
                }
            }
        };
        put(arguments, &self.powers);
        for knot in &self.knots {
            ways.iter_mut().zip(arguments).for_each(|(way, command)| *way = (command - knot).max(0.0));
            put(ways, &self.truncated);
        }
        for (row, constant) in out.chunks_exact_mut(places).zip(&self.constants) {
            row.iter_mut().for_each(|value| *value -= constant);
        }
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        self.each(arguments[0], out, |power, _, below| f64::from(power) * below);
        // The slope of a truncated line jumps at its knot, from zero.
        if *self.truncated.start() == 1 {
            let before = self.powers.clone().count();
            let step = self.truncated.clone().count();
            for (out, knot) in out[before..].iter_mut().step_by(step).zip(&self.knots) {
                *out = f64::from(arguments[0] > *knot);
            }
        }
    }

    fn range(&self) -> Option<[f64; 2]> {
        self.range
    }

    fn breaks(&self) -> &[f64] {
        &self.knots
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::families::testing::{names, side_by_side_is_each, slopes, slopes_agree, values};

    #[test]
    fn values_by_hand() {
        let pieces = PiecewisePolynomial::new(vec![50.0, 100.0], 1..=2, 1, None);
        assert_eq!(names(&pieces), ["[1]", "[2]", "[pp1,2]", "[pp2,2]"]);
        assert_eq!(values(&pieces, &[80.0]), [80.0, 6400.0, 900.0, 0.0]);
        assert_eq!(slopes(&pieces, &[110.0]), [1.0, 220.0, 120.0, 20.0]);
        let kinked = PiecewisePolynomial::new(vec![50.0], 1..=2, 0, None);
        assert_eq!(names(&kinked), ["[1]", "[2]", "[pp1,1]", "[pp1,2]"]);
        assert_eq!(slopes(&kinked, &[40.0]), [1.0, 80.0, 0.0, 0.0]);
        assert_eq!(slopes(&kinked, &[60.0]), [1.0, 120.0, 1.0, 20.0]);
    }

    #[test]
    fn an_error_can_be_zero_at_zero() {
        let pieces = PiecewisePolynomial::new(vec![-50.0, 100.0], 1..=2, 1, None);
        assert_eq!(values(&pieces, &[0.0]), [0.0, 0.0, 2500.0, 0.0]);
        let zero = pieces.clone().zero_at_zero();
        assert_eq!(values(&zero, &[0.0]), [0.0; 4]);
        assert_eq!(values(&zero, &[-80.0]), [-80.0, 6400.0, -2500.0, 0.0]);
        assert_eq!(slopes(&zero, &[-20.0]), slopes(&pieces, &[-20.0]));
    }

    proptest! {
        #[test]
        fn values_side_by_side_are_those_of_each_place(
            at in proptest::collection::vec(-150.0..150.0_f64, 1..9), highest in 1u8..=4, continuity in 0u8..=3, zero in any::<bool>(),
        ) {
            let own = PiecewisePolynomial::new(vec![-50.0, 20.0, 100.0], 1..=highest, continuity.min(highest - 1), None);
            let own = if zero { own.zero_at_zero() } else { own };
            side_by_side_is_each(&own, &at);
        }

        #[test]
        fn values_and_slopes_do_not_jump_at_knots(knot in -200.0..200.0_f64, degree in 2u8..5) {
            let pieces = PiecewisePolynomial::new(vec![knot, knot + 10.0], 1..=degree, 1, None);
            let near = 1e-9;
            for of in [values, slopes] {
                let (left, right) = (of(&pieces, &[knot - near]), of(&pieces, &[knot + near]));
                for (left, right) in left.iter().zip(right) {
                    prop_assert!((left - right).abs() < 1e-6 * left.abs().max(1.0), "{left} {right}");
                }
            }
        }

        #[test]
        fn slopes_are_those_of_the_values(at in -5.0..5.0_f64, degree in 2u8..5) {
            slopes_agree(&PiecewisePolynomial::new(vec![-2.5, 1.0], 1..=degree, 1, None), at, 1e-6, 1e-5);
        }
    }
}
