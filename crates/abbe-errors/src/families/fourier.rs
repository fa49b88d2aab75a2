//! Fourier series of the angle of a rotary axis.

use abbe_core::{Quantity, SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term, check_numbers, numbers};

/// Fourier series of the angle of a rotary axis: `EXC[cos2]`, `EXC[sin2]`, ... in the unit of the error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fourier {
    /// Motion errors of rotary axes by ISO 230-1 symbol, e.g. EXC; `?` and `*` are wildcards.
    pub fourier: Vec<String>,
    /// The orders, from 1 to 99; order 2 is twice per turn.
    pub orders: Vec<Whole<1, 99>>,
}

impl Family for Fourier {
    fn symbols(&self) -> &[String] {
        &self.fourier
    }

    fn check(&self) -> Result<(), SettingsError> {
        check_numbers("orders", "order", &self.orders)
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        if subject.command != Quantity::Angle {
            return Err(SettingsError::new("fourier", "a Fourier series is one of the angle of a rotary axis"));
        }
        Ok(vec![Box::new(FourierSeries { orders: numbers(&self.orders) })])
    }
}

/// `cos(N q)` and `sin(N q)` of the axis command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FourierSeries {
    /// The orders N.
    pub orders: Vec<u8>,
}

impl Functions for FourierSeries {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        let names = self.orders.iter().flat_map(|order| [format!("[cos{order}]"), format!("[sin{order}]")]);
        names.map(|name| Term::new(name, 0)).collect()
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        let command = arguments.first()?;
        let of = |order: &u8| [format!("cos({order}.0 * {command})"), format!("sin({order}.0 * {command})")];
        Some(self.orders.iter().flat_map(of).collect())
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        for (pair, &order) in out.chunks_exact_mut(2).zip(&self.orders) {
            let (sin, cos) = (f64::from(order) * arguments[0]).sin_cos();
            pair.copy_from_slice(&[cos, sin]);
        }
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        for (pair, &order) in out.chunks_exact_mut(2).zip(&self.orders) {
            let order = f64::from(order);
            let (sin, cos) = (order * arguments[0]).sin_cos();
            pair.copy_from_slice(&[-order * sin, order * cos]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{slopes_agree, values};

    #[test]
    fn values_and_names() {
        let series = FourierSeries { orders: vec![2, 3] };
        let names: Vec<String> = series.terms().into_iter().map(|term| term.suffix).collect();
        assert_eq!(names, ["[cos2]", "[sin2]", "[cos3]", "[sin3]"]);
        let at = std::f64::consts::FRAC_PI_4;
        let root = std::f64::consts::FRAC_1_SQRT_2;
        for (value, expected) in values(&series, &[at]).iter().zip([0.0, 1.0, -root, root]) {
            assert!((value - expected).abs() < 1e-15, "{value} {expected}");
        }
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(at in -7.0..7.0_f64, orders in proptest::collection::vec(1u8..=9, 1..4)) {
            slopes_agree(&FourierSeries { orders }, at, 1e-5, 1e-7);
        }
    }
}
