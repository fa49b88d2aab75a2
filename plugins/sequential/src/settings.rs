//! Settings of a sequential estimate.

use abbe_core::{PathItem, SettingsError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of a sequential estimate.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Probability that rows that agree with what is known are refused.
    #[serde(default = "default_significance")]
    pub significance: f64,
    /// What to do with rows that do not agree with what is known: the model of then no longer holds.
    #[serde(default)]
    pub on_disagreement: OnDisagreement,
    /// Parameters that may have changed since the earlier estimate, each by itself.
    #[serde(default)]
    pub changed: Vec<Changed>,
    /// Singular values below this part of the largest count as zero; columns have norm 1.
    #[serde(default = "default_rank_tolerance")]
    #[schemars(range(min = 1e-15, max = 1.0))]
    pub rank_tolerance: f64,
}

fn default_significance() -> f64 {
    0.01
}

fn default_rank_tolerance() -> f64 {
    1e-10
}

/// What to do with rows that do not agree with what is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnDisagreement {
    /// Stop and name what is off most.
    #[default]
    Error,
    /// Continue; the calibration file states that they do not agree.
    Warn,
}

/// Parameters that may have changed since the earlier estimate.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Changed {
    /// Names or patterns of chosen parameters that are known: `dzt[*`.
    pub parameters: Vec<String>,
    /// Standard uncertainty of the change of each, in its unit (mm, rad, mm/K, ...): the square root of what a day adds to
    /// the variance, times the days.
    pub standard_uncertainty: f64,
}

impl Settings {
    /// Refuses settings that are wrong whatever the data.
    pub fn check(&self) -> Result<(), SettingsError> {
        let between = |name: &str, value: f64| match value > 0.0 && value < 1.0 {
            true => Ok(()),
            false => Err(SettingsError::new(name, "a number between 0 and 1 was expected")),
        };
        if !(1e-9..=0.5).contains(&self.significance) {
            return Err(SettingsError::new("significance", "a probability from 1e-9 to 0.5 was expected"));
        }
        between("rank_tolerance", self.rank_tolerance)?;
        for (index, changed) in self.changed.iter().enumerate() {
            let under =
                |error: SettingsError| error.under([PathItem::Key("changed".to_owned()), PathItem::Index(index)]);
            let most = "a number above 0 and up to 1e6 was expected, in the unit of the parameters (mm, rad, mm/K)";
            if !(changed.standard_uncertainty > 0.0 && changed.standard_uncertainty <= 1e6) {
                return Err(under(SettingsError::new("standard_uncertainty", most)));
            }
            if changed.parameters.is_empty() {
                return Err(under(SettingsError::new("parameters", "at least one name or pattern was expected")));
            }
        }
        Ok(())
    }
}
