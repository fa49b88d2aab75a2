//! Ordinary polynomials of the command.

use abbe_core::{SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::travel::Travel;
use super::{Argument, Family, Functions, Subject, Term, check_numbers, numbers, power, power_in_c};

/// Ordinary polynomials of the axis command: `EXX[1]`, `EXX[2]`, ... in the unit of the error per power of mm or rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Polynomial {
    /// Motion errors by ISO 230-1 symbol, e.g. EYX; `?` and `*` are wildcards.
    pub polynomial: Vec<String>,
    /// The degrees, 0 to 9.
    pub degrees: Vec<Whole<0, 9>>,
    /// Travel of a linear axis over which `without_line` holds. Default: the range of the axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_mm: Option<[f64; 2]>,
    /// Travel of a rotary axis over which `without_once_per_turn` holds. Default: the range of the axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_deg: Option<[f64; 2]>,
    /// For straightness: every function is taken without its least-squares line over the travel.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub without_line: bool,
    /// For errors of a rotary axis: every function is taken without its once-per-turn part.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub without_once_per_turn: bool,
}

impl Polynomial {
    fn travel(&self) -> Travel {
        Travel {
            range_mm: self.range_mm,
            range_deg: self.range_deg,
            without_line: self.without_line,
            without_once_per_turn: self.without_once_per_turn,
        }
    }
}

impl Family for Polynomial {
    fn symbols(&self) -> &[String] {
        &self.polynomial
    }

    fn check(&self) -> Result<(), SettingsError> {
        check_numbers("degrees", "degree", &self.degrees)?;
        self.travel().check()?;
        self.travel().check_degrees("degrees", &numbers(&self.degrees))
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        let functions = OrdinaryPolynomial { degrees: numbers(&self.degrees) };
        Ok(vec![self.travel().without_trend(Box::new(functions), subject)?])
    }
}

/// Ordinary polynomials `q^n` of the axis command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OrdinaryPolynomial {
    /// The degrees n.
    pub degrees: Vec<u8>,
}

impl Functions for OrdinaryPolynomial {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command]
    }

    fn terms(&self) -> Vec<Term> {
        self.degrees.iter().map(|&degree| Term::new(format!("[{degree}]"), degree)).collect()
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        let command = arguments.first()?;
        Some(self.degrees.iter().map(|&degree| power_in_c(command, degree)).collect())
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        for (value, &degree) in out.iter_mut().zip(&self.degrees) {
            *value = power(arguments[0], degree);
        }
    }

    fn values_side_by_side(&self, places: usize, arguments: &[f64], _: &mut Vec<f64>, out: &mut [f64]) {
        for (values, &degree) in out.chunks_exact_mut(places).zip(&self.degrees) {
            let each = values.iter_mut().zip(arguments);
            // One loop for each of the usual degrees, so that the vector units take several places at once.
            match degree {
                1 => each.for_each(|(value, argument)| *value = power(*argument, 1)),
                2 => each.for_each(|(value, argument)| *value = power(*argument, 2)),
                3 => each.for_each(|(value, argument)| *value = power(*argument, 3)),
                _ => each.for_each(|(value, argument)| *value = power(*argument, degree)),
            }
        }
    }

    fn slopes(&self, _: usize, arguments: &[f64], out: &mut [f64]) {
        for (slope, &degree) in out.iter_mut().zip(&self.degrees) {
            *slope = if degree == 0 { 0.0 } else { f64::from(degree) * power(arguments[0], degree - 1) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{side_by_side_is_each, slopes_agree, values};

    #[test]
    fn powers_at_a_known_place() {
        assert_eq!(values(&OrdinaryPolynomial { degrees: vec![0, 1, 3] }, &[-2.0]), [1.0, -2.0, -8.0]);
    }

    #[test]
    fn powers_side_by_side_are_those_of_each_place() {
        let places: Vec<f64> = (0..7).map(|place| 1.3 * f64::from(place) - 4.0).collect();
        side_by_side_is_each(&OrdinaryPolynomial { degrees: (0..10).collect() }, &places);
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(at in -5.0..5.0_f64, degrees in proptest::collection::vec(0u8..=9, 1..4)) {
            slopes_agree(&OrdinaryPolynomial { degrees }, at, 1e-5, 1e-4);
        }
    }
}
