//! Axes that follow their commands late.

use abbe_core::{Quantity, SettingsError, Unit};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term};

/// A linear axis that follows its command late: `EXX[lag]`, in s. The axis is behind by this time times its velocity (column
/// `velocity_X`): the error is -EXX\[lag\] v.
///
/// Circles and other paths that two axes interpolate tell the difference of their lags, the servo mismatch. Axes that are equally
/// late follow the same path later.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lag {
    /// Positioning errors of linear axes by ISO 230-1 symbol: EXX, EYY, EZZ; `?` and `*` are wildcards.
    pub lag: Vec<String>,
}

impl Family for Lag {
    fn symbols(&self) -> &[String] {
        &self.lag
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        if subject.of != Quantity::Length || subject.command != Quantity::Length || subject.along == 0.0 {
            return Err(SettingsError::new("lag", "a lag is a positioning error of a linear axis: EXX, EYY or EZZ"));
        }
        Ok(vec![Box::new(Late { along: subject.along })])
    }
}

/// The velocity of the axis with the other sign, in the direction of the error.
#[derive(Debug, Clone, PartialEq)]
pub struct Late {
    /// Movement of the body that the axis carries, in the direction of the error, for a command of 1 mm.
    pub along: f64,
}

impl Functions for Late {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Velocity]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term { unit: Some(Unit::of(Quantity::Time)), ..Term::new("[lag]", 0) }]
    }

    fn in_c(&self, arguments: &[String]) -> Option<Vec<String>> {
        Some(vec![format!("({:e}) * {}", -self.along, arguments.first()?)])
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = -self.along * arguments[0];
    }

    fn slopes(&self, _: usize, _: &[f64], out: &mut [f64]) {
        out[0] = -self.along;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree, values};

    /// At 10 mm/s in the positive direction an axis that is 2 ms late is 0.02 mm short of its command.
    #[test]
    fn a_late_axis_is_behind() {
        let late = Late { along: 1.0 };
        assert_eq!(names(&late), ["[lag]"]);
        assert_eq!(late.terms()[0].unit(Quantity::Length, Quantity::Length), Unit::of(Quantity::Time));
        assert_eq!([10.0, -10.0].map(|velocity| 2e-3 * values(&late, &[velocity])[0]), [-0.02, 0.02]);
        // The body of a table moves the other way.
        assert_eq!(values(&Late { along: -1.0 }, &[10.0]), [10.0]);
        slopes_agree(&late, 3.0, 1e-3, 1e-9);
    }
}
