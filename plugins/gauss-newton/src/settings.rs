//! The settings of the estimator.

use abbe_core::{Result, Whole};
use abbe_numerics::{Loss, Robust};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::select::Select;

/// Settings of the estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What to do when the data cannot separate the chosen parameters.
    #[serde(default)]
    pub on_confounded: OnConfounded,
    /// Unknowns that are estimated rather than dropped, the most preferred first: names and patterns (`on_confounded:
    /// drop`).
    #[serde(default)]
    pub prefer: Vec<String>,
    /// Singular values below this part of the largest count as zero; columns have norm 1.
    #[serde(default = "default_tolerance")]
    #[schemars(range(min = 1e-15, max = 1.0))]
    pub rank_tolerance: f64,
    /// Selection of parameters: those that are not significant are left out.
    #[serde(default)]
    pub select: Option<Select>,
    /// Robust weights, which reduce the effect of gross errors on the estimate.
    #[serde(default)]
    pub robust: Option<RobustSetting>,
    /// Take the stated standard uncertainties as they are, without the a-posteriori factor of the residuals.
    #[serde(default)]
    pub trust_uncertainties: bool,
    /// Whether one factor on the stated uncertainties holds for all readings, or every artefact stage has its own.
    #[serde(default)]
    pub variance: Variance,
    /// Probability that expanded uncertainties cover.
    #[serde(default = "default_probability")]
    pub coverage_probability: f64,
    /// Number of own unknowns of artefacts up to which their covariances are found. Where there are more, they are
    /// eliminated one artefact after another: they have values and standard uncertainties, and memory grows with their
    /// number and not with its square.
    #[serde(default = "default_own_covariances")]
    pub own_covariances: Whole<0, 5_000>,
    /// Most iterations.
    #[serde(default = "default_iterations")]
    pub iterations: Whole<1, 100_000>,
    /// Largest remaining deviation of the estimate at the end of the iteration, in standard uncertainties of all rows
    /// together.
    #[serde(default = "default_convergence")]
    pub tolerance: f64,
}

fn default_convergence() -> f64 {
    1e-9
}

fn default_probability() -> f64 {
    0.95
}

fn default_tolerance() -> f64 {
    // Contact is solved to 1e-11 mm in 1e2 mm. Lost directions have singular values of about 1e-14, the weakest useful one
    // has 1e-7.
    1e-10
}

fn default_own_covariances() -> Whole<0, 5_000> {
    Whole::new(1_000)
}

fn default_iterations() -> Whole<1, 100_000> {
    Whole::new(200)
}

/// What to do with confounded parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnConfounded {
    /// Stop and name them.
    #[default]
    Error,
    /// Leave as many parameters at their start values as directions are lost, and mark these parameters.
    Drop,
    /// Take the solution with the smallest effect of the unknowns, and mark the unknowns that take part in a lost
    /// direction.
    MinimumNorm,
}

/// Factors on the stated uncertainties of the readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Variance {
    /// One factor for all readings.
    #[default]
    Common,
    /// One factor for every artefact stage, which also changes the weights of its readings.
    PerStage,
}

/// Robust weights: the name of a loss, or a loss with its tuning.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum RobustSetting {
    /// A loss with 95 % efficiency on normal noise.
    Name(LossName),
    /// A loss with its tuning.
    Tuned(Tuned),
}

/// A loss with its tuning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tuned {
    /// The loss.
    loss: LossName,
    /// Cutoff in units of the residuals' scale.
    #[serde(default)]
    cutoff: Option<f64>,
    /// Studentised residual from which a row is listed as an outlier.
    #[serde(default)]
    outlier_at: Option<f64>,
}

/// The losses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LossName {
    /// Large residuals have a bounded influence.
    Huber,
    /// Large residuals have no influence.
    Tukey,
}

impl<'de> Deserialize<'de> for RobustSetting {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // Told apart here, because an untagged enum could not say what is wrong in either form.
        match Value::deserialize(deserializer)? {
            map @ Value::Object(_) => abbe_core::from_settings(&map).map(Self::Tuned),
            other => abbe_core::from_settings(&other).map(Self::Name),
        }
        .map_err(serde::de::Error::custom)
    }
}

impl RobustSetting {
    /// The loss with its cutoffs.
    pub fn robust(&self) -> Robust {
        let (loss, cutoff, outlier_at) = match self {
            Self::Name(loss) => (*loss, None, None),
            Self::Tuned(tuned) => (tuned.loss, tuned.cutoff, tuned.outlier_at),
        };
        let usual = match loss {
            LossName::Huber => Robust::HUBER,
            LossName::Tukey => Robust::TUKEY,
        };
        Robust {
            loss: if loss == LossName::Huber { Loss::Huber } else { Loss::Tukey },
            cutoff: cutoff.unwrap_or(usual.cutoff),
            outlier_at: outlier_at.unwrap_or(usual.outlier_at),
        }
    }
}
