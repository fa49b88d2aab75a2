//! Decisions on figures with a limit, and decision rules.

use std::fmt;

use schemars::JsonSchema;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};

/// The decision on a figure, a verdict or a run. Of several decisions the greatest one is the total decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, JsonSchema)]
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
    /// ISO 14253-1:1998: a guard band of the expanded uncertainty U on either side of the limit, within which nothing is proved.
    #[serde(rename = "iso-14253-1-1998")]
    Iso14253Of1998 {
        /// Coverage probability of U, which is 2 u for 0.95.
        #[serde(default = "usual", deserialize_with = "probability")]
        #[schemars(range(min = 0.5, max = 0.9999))]
        probability: f64,
    },
    /// ISO 14253-1:2017: a guard band of 1.65 u for a probability of conformity of 0.95 on either side of the limit.
    #[serde(rename = "iso-14253-1-2017")]
    Iso14253Of2017 {
        /// Probability with which conformity, or its opposite, has to be proved.
        #[serde(default = "usual", deserialize_with = "probability")]
        #[schemars(range(min = 0.5, max = 0.9999))]
        probability: f64,
    },
    /// Two answers with a guard band of the expanded uncertainty U: a value that is not below the limit by U fails.
    #[serde(rename = "binary-guard-band")]
    Binary {
        /// Coverage probability of U, which is 2 u for 0.95.
        #[serde(default = "usual", deserialize_with = "probability")]
        #[schemars(range(min = 0.5, max = 0.9999))]
        probability: f64,
    },
}

fn usual() -> f64 {
    0.95
}

fn probability<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(deserializer)?;
    match (0.5..=0.9999).contains(&value) {
        true => Ok(value),
        false => Err(D::Error::custom(format_args!("{value}: a probability from 0.5 to 0.9999 was expected"))),
    }
}

impl Default for Rule {
    fn default() -> Self {
        Self::Simple {}
    }
}

/// Probability of a standard normal number below this one.
pub fn normal_below(number: f64) -> f64 {
    Normal::standard().cdf(number)
}

impl Rule {
    /// The guard band in standard uncertainties.
    ///
    /// For the edition of 2017 the normal quantile, rounded up to hundredths: 1.65 for 0.95. Else the coverage factor, rounded up
    /// to tenths as is usual: 2 for 0.95.
    pub fn factor(self) -> f64 {
        match self {
            Self::Simple {} => 0.0,
            Self::Iso14253Of2017 { probability } => {
                ((Normal::standard().inverse_cdf(probability) * 100.0 - 1e-9).ceil() / 100.0).max(0.0)
            }
            Self::Iso14253Of1998 { probability } | Self::Binary { probability } => {
                // A thousandth is let go: k = 3 for 0.9973.
                ((Normal::standard().inverse_cdf(0.5 + 0.5 * probability) - 1e-3) * 10.0).ceil() / 10.0
            }
        }
    }

    /// The guard band for a standard uncertainty, in its unit.
    pub fn guard_band(self, standard_uncertainty: f64) -> f64 {
        self.factor() * standard_uncertainty
    }

    /// The answer about a value within limits that are there, for a guard band w that is not negative. Limits belong to the
    /// acceptance zone, moved inwards by w. A rule of three answers is inconclusive up to w beyond a limit.
    pub fn answer(self, value: f64, band: f64, lower: Option<f64>, upper: Option<f64>) -> Decision {
        // What is on the border in decimals is on it: a few roundings are let go, but not for simple acceptance.
        let near = |limit: f64| if band > 0.0 { 8.0 * f64::EPSILON * (limit.abs() + band) } else { 0.0 };
        let inside = |by: f64| {
            lower.is_none_or(|lower| value >= lower + by - near(lower))
                && upper.is_none_or(|upper| value <= upper - by + near(upper))
        };
        match self {
            _ if inside(band) => Decision::Pass,
            Self::Iso14253Of1998 { .. } | Self::Iso14253Of2017 { .. } if inside(-band) => Decision::Inconclusive,
            _ => Decision::Fail,
        }
    }

    /// Judges a value against the largest admissible one. All three numbers have the same unit; the standard uncertainty is
    /// none if it is not known, and a rule that needs it is inconclusive then.
    ///
    /// A value of none (it could not be computed) or NaN fails by every rule.
    pub fn decide(self, value: Option<f64>, standard_uncertainty: Option<f64>, limit: f64) -> Decision {
        let Some(value) = value.filter(|value| !value.is_nan()) else { return Decision::Fail };
        match self.band_of(standard_uncertainty) {
            Some(band) => self.answer(value, band, None, Some(limit)),
            None => Decision::Inconclusive,
        }
    }

    /// The guard band; none if the rule needs an uncertainty that is not known.
    fn band_of(self, standard_uncertainty: Option<f64>) -> Option<f64> {
        match self {
            Self::Simple {} => Some(0.0),
            _ => standard_uncertainty.filter(|u| *u >= 0.0).map(|u| self.guard_band(u)),
        }
    }

    /// Why a value cannot be decided by this rule, a sentence; none if it can.
    pub fn undecided(
        self,
        value: Option<f64>,
        standard_uncertainty: Option<f64>,
        limit: f64,
        unit: &str,
    ) -> Option<String> {
        if self.decide(value, standard_uncertainty, limit) != Decision::Inconclusive {
            return None;
        }
        Some(match self.band_of(standard_uncertainty) {
            None => format!("`{}` needs the standard uncertainty of this figure, which is not known", self.name()),
            Some(band) => {
                format!("it is nearer to its limit than the guard band of {band:.3} {unit} (`{}`)", self.name())
            }
        })
    }

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Simple {} => "simple",
            Self::Iso14253Of1998 { .. } => "iso-14253-1-1998",
            Self::Iso14253Of2017 { .. } => "iso-14253-1-2017",
            Self::Binary { .. } => "binary-guard-band",
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

    #[test]
    fn guard_bands_in_standard_uncertainties() {
        let of_2017 = |probability| Rule::Iso14253Of2017 { probability }.factor();
        assert_eq!([0.5, 0.9, 0.95, 0.975, 0.99].map(of_2017), [0.0, 1.29, 1.65, 1.96, 2.33]);
        let of_1998 = |probability| Rule::Iso14253Of1998 { probability }.factor();
        assert_eq!([0.6827, 0.95, 0.9545, 0.99, 0.9973].map(of_1998), [1.0, 2.0, 2.0, 2.6, 3.0]);
        assert_eq!(Rule::Simple {}.factor(), 0.0);
    }

    #[test]
    fn rules_with_guard_bands() {
        use Decision::{Fail, Inconclusive, Pass};
        let probability = 0.95;
        let (old, new) = (Rule::Iso14253Of1998 { probability }, Rule::Iso14253Of2017 { probability });
        let binary = Rule::Binary { probability };
        // u = 0.5, limit 10.
        let cases = [
            (9.0, [Pass, Pass, Pass]),
            (9.175, [Inconclusive, Pass, Fail]),
            (9.2, [Inconclusive, Inconclusive, Fail]),
            (10.8, [Inconclusive, Inconclusive, Fail]),
            (10.9, [Inconclusive, Fail, Fail]),
            (11.1, [Fail, Fail, Fail]),
        ];
        for (value, expected) in cases {
            let found = [old, new, binary].map(|rule| rule.decide(Some(value), Some(0.5), 10.0));
            assert_eq!(found, expected, "{value}");
        }
        for rule in [old, new, binary] {
            // What is not known decides nothing, what is known to be exact all, and what could not be computed fails.
            assert_eq!(rule.decide(Some(1.0), None, 10.0), Inconclusive);
            assert_eq!(rule.decide(Some(10.0), Some(0.0), 10.0), Pass);
            assert_eq!(rule.decide(Some(10.1), Some(0.0), 10.0), Fail);
            assert_eq!(rule.decide(None, Some(0.5), 10.0), Fail);
            let written = json!(rule);
            assert_eq!(written, json!({ "rule": rule.name(), "probability": 0.95 }));
            assert_eq!(serde_json::from_value::<Rule>(json!({ "rule": rule.name() })).unwrap(), rule);
            assert_eq!(serde_json::from_value::<Rule>(written).unwrap(), rule);
        }
        let both = |value| new.answer(value, 1.155, Some(-1.0), Some(1.0));
        // The guard bands overlap: nothing is proved to conform.
        assert_eq!([0.0, 0.3, 2.2, -2.2].map(both), [Inconclusive, Inconclusive, Fail, Fail]);
        let why = new.undecided(Some(9.5), Some(0.5), 10.0, "um").unwrap();
        assert_eq!(why, "it is nearer to its limit than the guard band of 0.825 um (`iso-14253-1-2017`)");
        assert!(old.undecided(Some(9.5), None, 10.0, "um").unwrap().contains("not known"));
        assert_eq!(new.undecided(Some(9.0), Some(0.5), 10.0, "um"), None);
    }
}
