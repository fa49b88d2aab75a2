//! Scales that expand with temperature.

use abbe_core::{PathItem, Quantity, SettingsError, Unit, not_negative};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Subject, Term};

/// Expansion of a scale, from a column with its temperature. Rows without a temperature have no expansion.
/// `EXX[expansion]` is the coefficient of expansion in 1/K. It has a value even if it is not estimated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "units are written as in column names")]
pub struct Expansion {
    /// Positioning errors by ISO 230-1 symbol, e.g. EXX.
    pub expansion: Vec<String>,
    /// Name of the column with the temperature of the scale, without its unit: `T_X` is the column `T_X_degC`.
    pub temperature: String,
    /// Coefficient of linear thermal expansion: the value of the parameter if it is not estimated.
    pub coefficient_per_K: f64,
    /// Standard uncertainty of the coefficient, which is used if the coefficient is not estimated. The errors of
    /// different scales are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub standard_uncertainty_per_K: Option<f64>,
    /// Temperature at which the scale has no error of expansion.
    #[serde(default = "reference", skip_serializing_if = "is_reference")]
    pub reference_degC: f64,
}

/// The reference temperature of all lengths, °C (ISO 1).
fn reference() -> f64 {
    20.0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_reference(temperature: &f64) -> bool {
    *temperature == reference()
}

impl Family for Expansion {
    fn symbols(&self) -> &[String] {
        &self.expansion
    }

    fn shares_functions(&self) -> bool {
        false
    }

    fn check(&self) -> Result<(), SettingsError> {
        for (index, symbol) in self.expansion.iter().enumerate() {
            if !matches!(symbol.as_bytes().get(1), Some(b'X' | b'Y' | b'Z')) {
                let error = SettingsError::new("", "an expanding scale is a positioning error: EXX, EYY or EZZ");
                return Err(error.under([PathItem::Key("expansion".to_owned()), PathItem::Index(index)]));
            }
        }
        let (base, quantity, _) = Quantity::of_column(&self.temperature);
        if quantity != Quantity::Label || base.is_empty() {
            let message = format!("the name of a column without its unit was expected, not `{}`", self.temperature);
            return Err(SettingsError::new("temperature", message).help("`T_X` is the column `T_X_degC`"));
        }
        for (setting, value) in [("coefficient_per_K", self.coefficient_per_K), ("reference_degC", self.reference_degC)]
        {
            if !value.is_finite() {
                return Err(SettingsError::new(setting, "a finite number was expected"));
            }
        }
        not_negative("standard_uncertainty_per_K", self.standard_uncertainty_per_K.unwrap_or(0.0)).map(|_| ())
    }

    fn functions(&self, subject: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        if subject.command != Quantity::Length {
            return Err(SettingsError::new("", "the scale of a rotary axis keeps its angles when it expands"));
        }
        if subject.along.abs() < 1.0 - 1e-9 {
            return Err(SettingsError::new("", "the axis does not move in the direction of this error"));
        }
        Ok(vec![Box::new(ExpandingScale {
            temperature: self.temperature.clone(),
            coefficient: self.coefficient_per_K,
            uncertainty: self.standard_uncertainty_per_K.unwrap_or(0.0),
            reference: self.reference_degC,
            sense: subject.along.signum(),
        })])
    }
}

/// The function `s (T - reference) q`; its coefficient is the coefficient of thermal expansion.
///
/// A scale that expanded shows too little: at an indicated q the slide is at `q (1 + a (T - reference))`, so that the error, actual minus nominal, is
/// `+ a (T - reference) q` in the sense s in which a positive command moves the body (Soons 1993, section 2.4).
#[derive(Debug, Clone, PartialEq)]
pub struct ExpandingScale {
    /// Name of the status that is its temperature.
    pub temperature: String,
    /// Nominal coefficient of expansion, 1/K.
    pub coefficient: f64,
    /// Its standard uncertainty, 1/K.
    pub uncertainty: f64,
    /// Temperature at which it is right, °C.
    pub reference: f64,
    /// +1, or -1 if a positive command moves the body the other way.
    pub sense: f64,
}

impl ExpandingScale {
    /// Excess temperature; zero where it is not known.
    fn excess(&self, temperature: f64) -> f64 {
        if temperature.is_nan() { 0.0 } else { self.sense * (temperature - self.reference) }
    }
}

impl Functions for ExpandingScale {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Command, Argument::Temperature(self.temperature.clone())]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term { unit: Some(Unit::of(Quantity::PerTemperature)), ..Term::new("[expansion]", 0) }]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = self.excess(arguments[1]) * arguments[0];
    }

    fn slopes(&self, by: usize, arguments: &[f64], out: &mut [f64]) {
        out[0] = match by {
            0 => self.excess(arguments[1]),
            _ if arguments[1].is_nan() => 0.0,
            _ => self.sense * arguments[0],
        };
    }

    fn nominal(&self) -> f64 {
        self.coefficient
    }

    fn nominal_uncertainty(&self) -> f64 {
        self.uncertainty
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::{names, slopes_agree_by, values};

    fn scale(sense: f64) -> ExpandingScale {
        ExpandingScale { temperature: "T_X".to_owned(), coefficient: 11.5e-6, uncertainty: 0.0, reference: 20.0, sense }
    }

    #[test]
    fn values_by_hand() {
        assert_eq!(names(&scale(1.0)), ["[expansion]"]);
        assert_eq!(values(&scale(1.0), &[500.0, 22.0]), [1000.0]);
        assert_eq!(values(&scale(-1.0), &[500.0, 22.0]), [-1000.0]);
        assert_eq!(values(&scale(1.0), &[500.0, 20.0]), [0.0]);
        assert_eq!(values(&scale(1.0), &[500.0, f64::NAN]), [0.0]);
        assert_eq!(scale(1.0).terms()[0].unit(Quantity::Length, Quantity::Length).to_string(), "1/K");
        assert_eq!(scale(1.0).nominal(), 11.5e-6);
    }

    proptest::proptest! {
        #[test]
        fn slopes_are_those_of_the_values(q in -500.0..500.0_f64, t in 10.0..30.0_f64) {
            for by in 0..2 {
                slopes_agree_by(&scale(-1.0), by, &[q, t], 1e-3, 1e-6);
            }
        }
    }
}
