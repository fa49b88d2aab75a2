//! Reversal errors.

use abbe_core::{SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term, check_numbers, numbers, power_in_c};

/// Reversal errors: `EXX[b]` is half the reversal value, added after a positive approach and subtracted after a
/// negative one. With `degrees` the reversal value changes along the axis: `EXX[b*1]`, `EXX[b*2]`, ... are half the
/// difference of the curves for positive and negative approach. The mean of the two curves is the error that the other
/// families describe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backlash {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub backlash: Vec<String>,
    /// Powers of the command, 1 to 9, with which it changes along the axis.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub degrees: Vec<Whole<1, 9>>,
}

impl Family for Backlash {
    fn symbols(&self) -> &[String] {
        &self.backlash
    }

    fn check(&self) -> Result<(), SettingsError> {
        if self.degrees.is_empty() { Ok(()) } else { check_numbers("degrees", "degree", &self.degrees) }
    }

    fn functions(&self, _: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        Ok(vec![Box::new(Reversal { degrees: numbers(&self.degrees) })])
    }
}

/// The direction of approach, and its products with powers of the command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reversal {
    /// The powers of the command. The function without a power is always there and comes first.
    pub degrees: Vec<u8>,
}

impl Functions for Reversal {
    fn arguments(&self) -> Vec<Argument> {
        match self.degrees.is_empty() {
            true => vec![Argument::Direction],
            false => vec![Argument::Direction, Argument::Command],
        }
    }

    fn terms(&self) -> Vec<Term> {
        let along = self.degrees.iter().map(|&degree| Term::new(format!("[b*{degree}]"), degree));
        std::iter::once(Term::new("[b]", 0)).chain(along).collect()
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        let direction = arguments.first()?;
        let along = self.degrees.iter().zip(arguments.get(1).into_iter().cycle());
        let along = along.map(|(&degree, command)| format!("{direction} * {}", power_in_c(command, degree)));
        Some(std::iter::once(direction.clone()).chain(along).collect())
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = arguments[0];
        for (value, &degree) in out[1..].iter_mut().zip(&self.degrees) {
            *value = arguments[0] * arguments[1].powi(i32::from(degree));
        }
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        if by == 1 {
            for (slope, &degree) in out[1..].iter_mut().zip(&self.degrees) {
                *slope = arguments[0] * f64::from(degree) * arguments[1].powi(i32::from(degree) - 1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree_by, values};

    #[test]
    fn the_direction_is_the_value() {
        let reversal = Reversal { degrees: Vec::new() };
        assert_eq!(values(&reversal, &[-1.0]), [-1.0]);
        assert_eq!(names(&reversal), ["[b]"]);
        let along = Reversal { degrees: vec![1, 2] };
        assert_eq!(names(&along), ["[b]", "[b*1]", "[b*2]"]);
        assert_eq!(values(&along, &[-1.0, 3.0]), [-1.0, -3.0, -9.0]);
        slopes_agree_by(&along, 1, &[-1.0, 3.0], 1e-5, 1e-9);
    }
}
