//! Ordinary polynomials of the command.

use abbe_core::SettingsError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Functions, Term, whole_numbers};

/// Ordinary polynomials of the axis command: `EXX[1]`, `EXX[2]`, ... in the unit of the error per power of mm or rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Polynomial {
    /// Motion errors by ISO 230-1 symbol, e.g. EYX; `?` and `*` are wildcards.
    pub polynomial: Vec<String>,
    /// The degrees, 0 to 9.
    pub degrees: Vec<u8>,
}

impl Polynomial {
    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        whole_numbers("degrees", "degree", &self.degrees, 0..=9)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{slopes_agree, values};

    #[test]
    fn powers_at_a_known_place() {
        assert_eq!(values(&OrdinaryPolynomial { degrees: vec![0, 1, 3] }, &[-2.0]), [1.0, -2.0, -8.0]);
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(at in -5.0..5.0_f64, degrees in proptest::collection::vec(0u8..=9, 1..4)) {
            slopes_agree(&OrdinaryPolynomial { degrees }, at, 1e-5, 1e-4);
        }
    }
}
