//! Decisions on figures with a limit, and decision rules.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The decision on a figure, a verdict or a run. Of several decisions the greatest one is the total decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Decision {
    /// The limit is kept, or there is none.
    #[default]
    Pass,
    /// It cannot be decided whether the limit is kept. This is no failure, but it is reported.
    Inconclusive,
    /// The limit is not kept.
    Fail,
}

impl Decision {
    /// The total decision: it fails if one part fails, else it is inconclusive if one part is, else it passes.
    pub fn of_all(parts: impl IntoIterator<Item = Self>) -> Self {
        parts.into_iter().max().unwrap_or_default()
    }

    /// Whether it is no failure: pass or inconclusive.
    pub fn passes(self) -> bool {
        self != Self::Fail
    }
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pass => "pass",
            Self::Inconclusive => "inconclusive",
            Self::Fail => "fail",
        })
    }
}

/// The rule that a limit is judged by (decision rule; JCGM 106:2012, 3.3.12), with its settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "rule", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Rule {
    /// Simple acceptance: a value that is not above the limit passes, whatever its uncertainty.
    // JCGM 106:2012, 8.2: the guard band of 8.3 with w = 0. A map, so that settings that it does not have are refused.
    Simple {},
}

impl Default for Rule {
    fn default() -> Self {
        Self::Simple {}
    }
}

impl Rule {
    /// Judges a value against the largest admissible one. All three numbers have the same unit; the standard uncertainty is
    /// none if it is not known.
    ///
    /// A value of none (it could not be computed) or NaN fails by every rule.
    pub fn decide(self, value: Option<f64>, standard_uncertainty: Option<f64>, limit: f64) -> Decision {
        let Some(value) = value.filter(|value| !value.is_nan()) else { return Decision::Fail };
        match (self, standard_uncertainty) {
            (Self::Simple {}, _) if value <= limit => Decision::Pass,
            (Self::Simple {}, _) => Decision::Fail,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn simple_acceptance_looks_at_the_value_alone() {
        let limit = 30.0_f64;
        let cases = [
            (Some(29.9), Decision::Pass),
            (Some(limit), Decision::Pass),
            (Some(limit.next_up()), Decision::Fail),
            (Some(-1e300), Decision::Pass),
            (Some(f64::INFINITY), Decision::Fail),
            (Some(f64::NAN), Decision::Fail),
            (None, Decision::Fail),
        ];
        for (value, expected) in cases {
            // The guard band is zero: no uncertainty changes anything.
            for uncertainty in [None, Some(0.0), Some(100.0)] {
                assert_eq!(Rule::default().decide(value, uncertainty, limit), expected, "{value:?} {uncertainty:?}");
            }
        }
    }

    #[test]
    fn the_worst_part_decides() {
        use Decision::{Fail, Inconclusive, Pass};
        let cases: [(&[Decision], Decision, bool); 5] = [
            (&[], Pass, true),
            (&[Pass, Pass], Pass, true),
            (&[Pass, Inconclusive, Pass], Inconclusive, true),
            (&[Fail, Inconclusive, Pass], Fail, false),
            (&[Inconclusive, Fail], Fail, false),
        ];
        for (parts, expected, passes) in cases {
            let whole = Decision::of_all(parts.iter().copied());
            assert_eq!((whole, whole.passes()), (expected, passes), "{parts:?}");
        }
    }

    #[test]
    fn names_in_files() {
        let decisions = [Decision::Pass, Decision::Inconclusive, Decision::Fail];
        assert_eq!(json!(decisions), json!(["pass", "inconclusive", "fail"]));
        decisions.iter().for_each(|decision| assert_eq!(json!(decision), json!(decision.to_string())));
        assert_eq!(json!(Rule::default()), json!({ "rule": "simple" }));
        assert_eq!(serde_json::from_value::<Rule>(json!({ "rule": "simple" })).unwrap(), Rule::default());
    }
}
