//! Reversal errors.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Argument, Functions, Term};

/// Reversal errors: `EXX[b]` is half the reversal value, added after a positive approach and taken off after a negative one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backlash {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub backlash: Vec<String>,
}

/// The direction of approach: its coefficient is half the reversal value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reversal;

impl Functions for Reversal {
    fn arguments(&self) -> &'static [Argument] {
        &[Argument::Direction]
    }

    fn terms(&self) -> Vec<Term> {
        vec![Term::new("[b]", 0)]
    }

    fn values(&self, arguments: &[f64], out: &mut [f64]) {
        out[0] = arguments[0];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::testing::values;

    #[test]
    fn the_direction_is_the_value() {
        assert_eq!(values(&Reversal, &[-1.0]), [-1.0]);
        assert_eq!(Reversal.terms()[0].suffix, "[b]");
    }
}
