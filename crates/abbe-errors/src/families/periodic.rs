//! Periodic errors of scales and screws.

use abbe_core::{Quantity, SettingsError, Whole};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term, suits};

/// Periodic errors with a wavelength: `EXX[per0.635:1]`, `EXX[per0.635:2]`, ... in the unit of the error. Their combinations have any
/// phase.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Periodic {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub periodic: Vec<String>,
    /// Nominal wavelength on a linear axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelength_mm: Option<f64>,
    /// Nominal wavelength on a rotary axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelength_deg: Option<f64>,
    /// Number of functions, 2 to 99; they have as many knots in each period.
    pub functions: Whole<2, 99>,
    /// Whether the wavelength is a parameter: `EXX[per0.635].wavelength`, which starts from the nominal one.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub estimate_wavelength: bool,
}

impl Family for Periodic {
    fn symbols(&self) -> &[String] {
        &self.periodic
    }

    fn check(&self) -> Result<(), SettingsError> {
        let (setting, wavelength) = match (self.wavelength_mm, self.wavelength_deg) {
            (Some(wavelength), None) => ("wavelength_mm", wavelength),
            (None, Some(wavelength)) => ("wavelength_deg", wavelength),
            (Some(_), Some(_)) => {
                return Err(SettingsError::new("wavelength_deg", "there is `wavelength_mm` already"));
            }
            (None, None) => {
                let message = "a periodic error needs `wavelength_mm` (or `wavelength_deg` of a rotary axis)";
                return Err(SettingsError::new("", message));
            }
        };
        if !(wavelength > 0.0 && wavelength.is_finite()) {
            return Err(SettingsError::new(setting, format!("a wavelength is positive; {wavelength} is not")));
        }
        Ok(())
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        let given = [self.wavelength_mm, self.wavelength_deg];
        suits(("wavelength", "wavelength"), subject, given[0].is_some(), given[1].is_some())?;
        let written = given[0].or(given[1]).unwrap_or(f64::NAN);
        let wavelength = if subject.command == Quantity::Angle { written.to_radians() } else { written };
        Ok(vec![Box::new(PeriodicPieces {
            name: format!("per{written}"),
            wavelength,
            count: self.functions.get() as u8,
            estimated: self.estimate_wavelength,
        })])
    }
}

/// Periodic piecewise parabolas (Soons 1993, eq. 3.12-3.15). w = 0..1 is the position within the period, and t = k / (count +
/// 1). Function k is `max(w - t, 0)^2 - a1 w - a2 w^2`. The constants a1 and a2 make value and slope continuous from w = 1 to
/// w = 0.
///
/// There is no phase parameter. The second derivative of a combination may jump at any knot and at w = 0, so combinations can
/// have any phase, as those of sine and cosine can.
#[derive(Debug, Clone, PartialEq)]
pub struct PeriodicPieces {
    /// Prefix of the names inside the bracket: `per0.635`.
    pub name: String,
    /// Nominal wavelength, mm or rad.
    pub wavelength: f64,
    /// Number of functions.
    pub count: u8,
    /// Whether the wavelength is an argument.
    pub estimated: bool,
}

impl PeriodicPieces {
    fn place(&self, arguments: &[f64]) -> (f64, f64) {
        let wavelength = if self.estimated { arguments[1] } else { self.wavelength };
        let periods = arguments[0] / wavelength;
        (periods - periods.floor(), wavelength)
    }

    /// Knot, and the constants a1 and a2, of every function.
    fn each(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let pieces = f64::from(self.count) + 1.0;
        (1..=self.count).map(move |k| {
            let knot = f64::from(k) / pieces;
            // From value and slope of (w - t)^2 at w = 1, both zero at w = 0.
            let bend = 1.0 - knot;
            (knot, bend * bend - bend, bend)
        })
    }
}

impl Functions for PeriodicPieces {
    fn arguments(&self) -> Vec<Argument> {
        let shape = Argument::Shape(format!("[{}].wavelength", self.name), self.wavelength);
        std::iter::once(Argument::Command).chain(self.estimated.then_some(shape)).collect()
    }

    fn terms(&self) -> Vec<Term> {
        (1..=self.count).map(|k| Term::new(format!("[{}:{k}]", self.name), 0)).collect()
    }

    fn period(&self, arguments: &[f64]) -> Option<f64> {
        Some(self.place(arguments).1)
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        let (w, _) = self.place(arguments);
        for (out, (knot, line, bend)) in out.iter_mut().zip(self.each()) {
            let beyond = (w - knot).max(0.0);
            *out = beyond * beyond - w * (line + bend * w);
        }
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        let (w, wavelength) = self.place(arguments);
        // w changes by 1 / wavelength with the command, and by -command / wavelength^2 with the wavelength.
        let place = if by == 0 { 1.0 / wavelength } else { -arguments[0] / (wavelength * wavelength) };
        for (out, (knot, line, bend)) in out.iter_mut().zip(self.each()) {
            *out = place * (2.0 * (w - knot).max(0.0) - line - 2.0 * bend * w);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::families::testing::{names, slopes_agree_by, slopes_by, values};

    fn pieces(count: u8) -> PeriodicPieces {
        PeriodicPieces { name: "per0.635".to_owned(), wavelength: 0.635, count, estimated: true }
    }

    #[test]
    fn values_by_hand() {
        let pieces = pieces(3);
        assert_eq!(names(&pieces), ["[per0.635:1]", "[per0.635:2]", "[per0.635:3]"]);
        assert_eq!(pieces.arguments()[1], Argument::Shape("[per0.635].wavelength".to_owned(), 0.635));
        // w = 1/2: (w - t)^2 = 1/16, 0, 0; a1 = (1 - t)^2 - (1 - t), a2 = 1 - t.
        assert_eq!(values(&pieces, &[1.0, 2.0]), [-0.03125, 0.0, 0.03125]);
        assert_eq!(values(&pieces, &[0.0, 2.0]), [0.0; 3]);
    }

    proptest! {
        #[test]
        fn they_repeat(at in -50.0..50.0_f64, periods in -20i8..20, count in 2u8..6) {
            let pieces = pieces(count);
            let moved = [at + 0.5 * f64::from(periods), 0.5];
            for (one, other) in values(&pieces, &[at, 0.5]).iter().zip(values(&pieces, &moved)) {
                prop_assert!((one - other).abs() < 1e-12, "{one} {other}");
            }
        }

        #[test]
        fn neither_value_nor_slope_jumps(knot in 0u8..5, count in 2u8..6, period in -3i8..3) {
            let pieces = pieces(count);
            let at = f64::from(period) + f64::from(knot.min(count)) / (f64::from(count) + 1.0);
            for of in [|pieces: &PeriodicPieces, at| values(pieces, &[at, 1.0]), |pieces: &PeriodicPieces, at| slopes_by(pieces, 0, &[at, 1.0])] {
                let (left, right) = (of(&pieces, at - 1e-9), of(&pieces, at + 1e-9));
                for (left, right) in left.iter().zip(right) {
                    prop_assert!((left - right).abs() < 1e-7, "{left} {right}");
                }
            }
        }

        #[test]
        fn slopes_are_those_of_the_values(at in -5.0..5.0_f64, wavelength in 0.4..0.9_f64, by in 0usize..2) {
            slopes_agree_by(&pieces(3), by, &[at, wavelength], 1e-7, 1e-4);
        }
    }
}
