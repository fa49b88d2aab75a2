//! Uncertainty budgets by the law of propagation of uncertainty, and results of the propagation of distributions.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Uncertainty budgets of the estimates, and coverage (GUM; JCGM 102).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UncertaintyBudget {
    /// Probability that the intervals and regions cover.
    pub coverage_probability: f64,
    /// The a-posteriori factor by which the stated uncertainties of rows were multiplied; 1 if they are trusted.
    pub scale: f64,
    /// All estimated machine parameters together.
    pub joint: JointCoverage,
    /// One entry an estimated parameter.
    pub parameters: Vec<ParameterBudget>,
    /// Pairs that are strongly correlated: absolute correlation above 0.95.
    pub correlations: Vec<Correlated>,
}

/// Coverage of several quantities together (JCGM 102:2011, 6.5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JointCoverage {
    /// Number of quantities: the estimated machine parameters.
    pub quantities: usize,
    /// Smallest effective degrees of freedom of one of them; none if they are infinite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// Factor of the ellipsoid that covers them jointly; none with fewer degrees of freedom than quantities.
    pub ellipsoid_factor: Option<f64>,
    /// Factor on every standard uncertainty, so that all intervals hold together.
    pub rectangle_factor: f64,
}

/// The uncertainty of one estimated parameter, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterBudget {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Standard uncertainty.
    pub standard_uncertainty: f64,
    /// Standard uncertainty with the stated uncertainties of rows as they are, without the a-posteriori factor.
    pub stated_standard_uncertainty: f64,
    /// Effective degrees of freedom (Welch-Satterthwaite); none if they are infinite.
    pub degrees_of_freedom: Option<f64>,
    /// Coverage factor of this quantity alone.
    pub coverage_factor: f64,
    /// Expanded uncertainty: coverage factor times standard uncertainty.
    pub expanded_uncertainty: f64,
    /// Contributions to the standard uncertainty, the largest first; their squares add up to its square.
    pub contributions: Vec<Contribution>,
}

/// The part of a standard uncertainty that comes from one input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Contribution {
    /// The input: an artefact stage (the scatter of its rows), a known input, an earlier estimate.
    pub input: String,
    /// The standard uncertainty from this input alone.
    pub standard_uncertainty: f64,
}

/// Two estimates with a large correlation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Correlated {
    /// One.
    pub one: String,
    /// The other.
    pub other: String,
    /// Their correlation coefficient.
    pub correlation: f64,
}

/// Results of a Monte Carlo calculation (JCGM 101; JCGM 102).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MonteCarlo {
    /// Number of trials.
    pub trials: usize,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Whether the figures reached the stated number of digits; none if a fixed number of trials was asked for.
    pub stable: Option<bool>,
    /// Trials whose estimate did not converge; they do not count.
    pub failed: usize,
    /// Probability that the intervals cover.
    pub coverage_probability: f64,
    /// What was varied, in words.
    pub inputs: Vec<String>,
    /// One entry an estimated parameter.
    pub parameters: Vec<SimulatedParameter>,
    /// The values of every trial, if they are kept. They are no part of the file of a calibration.
    #[serde(skip)]
    pub samples: Option<Samples>,
}

/// The values of the trials of a Monte Carlo calculation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Samples {
    /// Names and units of what varies: the unknowns first.
    pub quantities: Vec<(String, String)>,
    /// Trials x quantities, in the units used in memory, in the order of the trials; failed ones are left out.
    pub values: Vec<f64>,
}

/// The distribution of one parameter, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SimulatedParameter {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Mean of the trials.
    pub mean: f64,
    /// Their standard deviation.
    pub standard_uncertainty: f64,
    /// Effective degrees of freedom with which the propagated uncertainties are known, those of the GUM framework; none if
    /// they are infinite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// Probabilistically symmetric coverage interval: low and high end.
    pub symmetric_interval: [f64; 2],
    /// Shortest coverage interval.
    pub shortest_interval: [f64; 2],
    /// The comparison with the interval of the GUM uncertainty framework (JCGM 101:2008, clause 8); none if the estimate states
    /// no uncertainty of this parameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gum: Option<GumComparison>,
}

/// Whether the GUM interval of an estimate agrees with that of the Monte Carlo calculation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GumComparison {
    /// Estimate plus and minus the expanded uncertainty.
    pub interval: [f64; 2],
    /// Absolute differences of the low and of the high ends.
    pub differences: [f64; 2],
    /// The numerical tolerance that both have to keep.
    pub tolerance: f64,
    /// Whether both keep it.
    pub validated: bool,
}
