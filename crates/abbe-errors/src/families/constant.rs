//! Constants: errors of location and set-up parameters.

use abbe_core::SettingsError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Family, Functions, Group, Subject, Term};

/// Constant errors of the location of axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Location {
    /// Location errors by ISO 230-1 symbol, e.g. EA0B; `?` and `*` are wildcards.
    pub location: Vec<String>,
}

impl Family for Location {
    fn symbols(&self) -> &[String] {
        &self.location
    }

    fn group(&self) -> Group {
        Group::Location
    }

    fn functions(&self, _: &Subject<'_>) -> Result<Vec<Box<dyn Functions>>, SettingsError> {
        Ok(vec![Box::new(Constant)])
    }
}

/// A constant: location errors and set-up parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Constant;

impl Functions for Constant {
    fn arguments(&self) -> Vec<Argument> {
        Vec::new()
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("", 0)]
    }

    fn values(&self, _: &[f64], out: &mut [f64]) {
        out[0] = 1.0;
    }
}

/// The value 1 for one stylus (its index), 0 for all others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StylusIndicator(pub usize);

impl Functions for StylusIndicator {
    fn arguments(&self) -> Vec<Argument> {
        vec![Argument::Stylus]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("", 0)]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = f64::from(arguments[0] == self.0 as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::values;

    #[test]
    fn a_stylus_has_its_own() {
        assert_eq!(values(&StylusIndicator(1), &[1.0]), [1.0]);
        assert_eq!(values(&StylusIndicator(1), &[0.0]), [0.0]);
        assert_eq!(values(&Constant, &[]), [1.0]);
    }
}
