//! Cyclic errors of a known pitch.

use std::f64::consts::TAU;

use abbe_core::{Quantity, SettingsError, Whole, positive};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term, check_numbers, numbers};

/// Cyclic errors of a ball screw or a scale with a known pitch: `EXX[cyc10:cos1]`, `EXX[cyc10:sin1]`, ... in the unit of the
/// error. The amplitude is the root of the sum of their squares.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cyclic {
    /// Motion errors of linear axes by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub cyclic: Vec<String>,
    /// The way in which the error repeats.
    #[schemars(range(min = 1e-3, max = 1e4))]
    pub pitch_mm: f64,
    /// The orders, from 1 to 99; order 2 is twice per pitch. Order 1 alone if this is left out.
    #[serde(default = "once", skip_serializing_if = "is_once")]
    pub orders: Vec<Whole<1, 99>>,
}

fn once() -> Vec<Whole<1, 99>> {
    vec![Whole::new(1)]
}

fn is_once(orders: &[Whole<1, 99>]) -> bool {
    orders == once()
}

impl Family for Cyclic {
    fn symbols(&self) -> &[String] {
        &self.cyclic
    }

    fn check(&self) -> Result<(), SettingsError> {
        positive("pitch_mm", self.pitch_mm)?;
        check_numbers("orders", "order", &self.orders)
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        if subject.command != Quantity::Length {
            let message = "a pitch is a way of a linear axis; for a rotary axis use `fourier`";
            return Err(SettingsError::new("cyclic", message));
        }
        Ok(vec![Box::new(Waves { pitch: self.pitch_mm, orders: numbers(&self.orders) })])
    }
}

/// `cos(2 pi N q / p)` and `sin(2 pi N q / p)` of the axis command.
#[derive(Debug, Clone, PartialEq)]
pub struct Waves {
    /// The pitch p, mm.
    pub pitch: f64,
    /// The orders N.
    pub orders: Vec<u8>,
}

impl Waves {
    /// Radians per mm, of every order.
    fn rates(&self) -> impl Iterator<Item = f64> {
        self.orders.iter().map(|order| TAU * f64::from(*order) / self.pitch)
    }
}

impl Functions for Waves {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        let of = |wave: &str, order: &u8| Term::new(format!("[cyc{}:{wave}{order}]", self.pitch), 0);
        self.orders.iter().flat_map(|order| [of("cos", order), of("sin", order)]).collect()
    }

    fn period(&self, _: &[f64]) -> Option<f64> {
        Some(self.pitch)
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        let command = arguments.first()?;
        Some(self.rates().flat_map(|rate| ["cos", "sin"].map(|wave| format!("{wave}({rate:e} * {command})"))).collect())
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        for (pair, rate) in out.chunks_exact_mut(2).zip(self.rates()) {
            let (sin, cos) = (rate * arguments[0]).sin_cos();
            pair.copy_from_slice(&[cos, sin]);
        }
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        for (pair, rate) in out.chunks_exact_mut(2).zip(self.rates()) {
            let (sin, cos) = (rate * arguments[0]).sin_cos();
            pair.copy_from_slice(&[-rate * sin, rate * cos]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree, values};

    #[test]
    fn values_and_names() {
        let waves = Waves { pitch: 10.0, orders: vec![1, 2] };
        assert_eq!(names(&waves), ["[cyc10:cos1]", "[cyc10:sin1]", "[cyc10:cos2]", "[cyc10:sin2]"]);
        for (value, expected) in values(&waves, &[2.5]).iter().zip([0.0, 1.0, -1.0, 0.0]) {
            assert!((value - expected).abs() < 1e-15, "{value} {expected}");
        }
        assert_eq!(waves.period(&[]), Some(10.0));
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(at in -500.0..500.0_f64, pitch in 0.5..40.0_f64, orders in proptest::collection::vec(1u8..=4, 1..4)) {
            slopes_agree(&Waves { pitch, orders }, at, 1e-5, 1e-4);
        }

        #[test]
        fn they_repeat(at in -50.0..50.0_f64, periods in -20i8..20, pitch in 0.5..40.0_f64) {
            let waves = Waves { pitch, orders: vec![1, 3] };
            for (one, other) in values(&waves, &[at]).iter().zip(values(&waves, &[at + pitch * f64::from(periods)])) {
                proptest::prop_assert!((one - other).abs() < 1e-9, "{one} {other}");
            }
        }
    }
}
