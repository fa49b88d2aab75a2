//! Calibrations: the result of an estimate, and the reader and writer of its file.
//!
//! `calibration.json` is a stable format that others read: its number stands in the key `abbe_calibration`, its schema
//! in `docs/schemas/calibration.schema.json`; `docs/formats.md` says what may change. A calibration is self-contained: pose
//! predictions and compensation need nothing else.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::{Error, Result};
use crate::format::FileFormat;
use crate::unit::{Quantity, Unit};

/// The number of the file format.
pub const CALIBRATION_FORMAT: u32 = 1;

const FORMAT: FileFormat = FileFormat { name: "calibration", key: "abbe_calibration", number: CALIBRATION_FORMAT };

/// What an estimate found out about a machine and its artefacts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Number of the format, [`CALIBRATION_FORMAT`].
    pub abbe_calibration: u32,
    /// Name of the estimate.
    pub estimate: String,
    /// The model, resolved.
    pub model: ModelRecord,
    /// Every parameter of the model, estimated or not.
    pub parameters: Vec<Estimated>,
    /// Every own unknown of the artefacts, as `<stage>.<own name>`.
    pub artefacts: Vec<Estimated>,
    /// Covariance of everything that was estimated.
    pub covariance: Covariance,
    /// The inputs that were considered, independent of each other, and how the estimates hang on them. None in files that were
    /// written before there were identities: what they share with others is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<Vec<ConsideredInput>>,
    /// The measurements that went in, directly or by an estimate that was known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub data: Vec<DataRecord>,
    /// Rows that the robust estimate leaves out or blames.
    pub outliers: Vec<Outlier>,
    /// How the fit went.
    pub fit: FitReport,
    /// How the uncertainties come about, and what they cover.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyBudget>,
    /// What a Monte Carlo calculation found, if the estimate is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub monte_carlo: Option<MonteCarlo>,
}

/// Plugin and settings from which the model is built again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelRecord {
    /// Name of the model plugin.
    pub plugin: String,
    /// Its resolved settings.
    pub settings: Value,
}

/// What a value of a calibration is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Estimated from the data.
    Estimated,
    /// Not estimated: taken as it is.
    Fixed,
    /// Not estimated, but its uncertainty is taken into account.
    Considered,
    /// The data cannot separate it from others; the value is one of many.
    Confounded,
}

/// A parameter with its value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimated {
    /// Name.
    pub name: String,
    /// Value in `unit`.
    pub value: f64,
    /// Unit, e.g. `mm/rad^2`.
    pub unit: String,
    /// Standard uncertainty in `unit`.
    pub standard_uncertainty: f64,
    /// What the value is worth.
    pub status: Status,
}

/// Covariance of the estimated values, in the units of the parameters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Covariance {
    /// Names, in the order of rows and columns.
    pub order: Vec<String>,
    /// The full symmetric matrix.
    pub rows: Vec<Vec<f64>>,
}

/// An input that is not estimated but whose uncertainty counts: a certificate, a stylus, a sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConsideredInput {
    /// Name in this estimate.
    pub name: String,
    /// Who it is, in any estimate: a declared `id`, or a hash of what its certificate says, and the quantity on it.
    pub identity: String,
    /// Value in `unit`.
    pub value: f64,
    /// Unit.
    pub unit: String,
    /// Standard uncertainty in `unit`.
    pub standard_uncertainty: f64,
    /// By how much each value changes with it, parameter unit per `unit`, in the order of the covariance.
    pub sensitivities: Vec<f64>,
}

impl ConsideredInput {
    /// Refuses one identity that two estimates state differently.
    pub fn agrees_with(&self, other: &Self) -> Result<()> {
        let differ = |one: f64, other: f64| (one - other).abs() > 1e-9 * one.abs().max(other.abs());
        let value = differ(self.value, other.value) || self.unit != other.unit;
        if !value && !differ(self.standard_uncertainty, other.standard_uncertainty) {
            return Ok(());
        }
        let told = |it: &Self| format!("{:e} {} (u = {:e})", it.value, it.unit, it.standard_uncertainty);
        Err(Error::data(format!(
            "`{}` and `{}` are one quantity ({}), but it is {} in one estimate and {} in the other",
            self.name,
            other.name,
            self.identity,
            told(self),
            told(other)
        ))
        .help("a new certificate needs a new `id`"))
    }
}

/// Rows of a file that an estimate rests on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataRecord {
    /// The file, as it was named.
    pub file: String,
    /// SHA-256 of its content; none if it was no file that could be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Numbers of its data rows, from 1: first and last of each run of rows.
    pub rows: Vec<[usize; 2]>,
}

/// A row that does not go with the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outlier {
    /// Artefact stage.
    pub stage: String,
    /// File that the row stands in.
    pub file: String,
    /// Line in the file.
    pub line: usize,
    /// Number of the data row in the file, from 1.
    pub row: usize,
    /// Its residual (the largest of its equations) in µm (µrad for angles).
    pub residual_um: f64,
    /// The weight that it was left with, 0 to 1.
    pub weight: f64,
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Termination {
    /// The last step was below the tolerance.
    Converged,
    /// No step made the residuals smaller, and the last one was not small.
    NoProgress,
    /// The limit of iterations was reached.
    IterationLimit,
    /// The limit of rounds of robust weights was reached, and they still change.
    RoundLimit,
}

/// How the fit went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitReport {
    /// Number of equations used.
    pub observations: usize,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Numerical rank.
    pub rank: usize,
    /// Condition number of the weighted Jacobian with columns of norm 1, at contact points; without a lost direction.
    pub condition: f64,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// A-posteriori factor: weighted residual RMS over what the standard uncertainties promise; dimensionless.
    pub sigma: f64,
    /// Iterations.
    pub iterations: usize,
    /// How they ended.
    pub termination: Termination,
    /// Size of the last step, in standard uncertainties of all rows together; none where nothing was iterated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_step: Option<f64>,
    /// Largest cosine of the angle between the weighted residuals and a column of the derivatives, where the last step was
    /// computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gradient_cosine: Option<f64>,
    /// Largest absolute residual of lengths (without outliers), µm.
    pub residual_max_um: f64,
    /// Mean absolute residual of lengths, µm.
    pub residual_mean_abs_um: f64,
    /// Root mean square of the residuals of lengths, µm.
    pub residual_rms_um: f64,
    /// Largest absolute residual of angles, µrad; none if no angle was observed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_max_urad: Option<f64>,
    /// Mean absolute residual of angles, µrad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_mean_abs_urad: Option<f64>,
    /// Root mean square of the residuals of angles, µrad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_rms_urad: Option<f64>,
    /// What the data cannot determine.
    pub null_space: Vec<NullVector>,
    /// The combinations that they determine worst, the weakest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weakest: Vec<NullVector>,
    /// What was left out of the model because chance alone explains it; none if nothing was to be selected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection: Option<Selection>,
    /// Motion errors that the functions chosen for them tell apart, and not the machine.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub same_motion: Vec<SameMotion>,
    /// The factors on the stated uncertainties of every artefact, where each was given its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variance: Vec<VarianceFactor>,
    /// How well the calibrations agree of which this one was combined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<CombinedAgreement>,
}

impl FitReport {
    /// The report of so many values that no rows were solved for.
    pub fn without_rows(unknowns: usize) -> Self {
        Self {
            observations: 0,
            unknowns,
            rank: unknowns,
            condition: 1.0,
            degrees_of_freedom: 0,
            sigma: 1.0,
            iterations: 0,
            termination: Termination::Converged,
            last_step: None,
            gradient_cosine: None,
            residual_max_um: 0.0,
            residual_mean_abs_um: 0.0,
            residual_rms_um: 0.0,
            residual_max_urad: None,
            residual_mean_abs_urad: None,
            residual_rms_urad: None,
            null_space: Vec::new(),
            weakest: Vec::new(),
            selection: None,
            same_motion: Vec::new(),
            variance: Vec::new(),
            agreement: None,
        }
    }
}

/// How much the readings of an artefact scatter compared with what was stated of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VarianceFactor {
    /// The artefact stage.
    pub stage: String,
    /// The factor on its standard uncertainties.
    pub factor: f64,
    /// Its degrees of freedom; none if the readings cannot tell it, so that what was stated counts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
}

/// Whether calibrations that were combined agree within their uncertainties.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CombinedAgreement {
    /// Their weighted squared differences, inputs that they share taken into account.
    pub chi_squared: f64,
    /// The rank of the covariance of these differences.
    pub degrees_of_freedom: usize,
    /// Probability that chance alone makes them differ as much.
    pub probability: f64,
}

/// A selection of parameters by their significance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Selection {
    /// Probability with which chance may make a parameter look as significant as those that are kept.
    pub level: f64,
    /// How it went about.
    pub direction: SelectionDirection,
    /// The candidates that are kept.
    pub kept: Vec<String>,
    /// The candidates that are left out, at their nominal values.
    pub left_out: Vec<String>,
    /// Its steps.
    pub steps: Vec<SelectionStep>,
}

/// In which direction parameters are selected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SelectionDirection {
    /// Starting from all, they go out.
    #[default]
    Backward,
    /// Starting from none, they come in.
    Forward,
    /// Starting from none, they come in and may go out again, or be replaced by better ones.
    Both,
}

/// A step of a selection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelectionStep {
    /// The parameter.
    pub parameter: String,
    /// Whether it came in or went out.
    pub entered: bool,
    /// Probability that chance alone makes it look as significant at this step.
    pub probability: f64,
}

/// A motion error of an axis that moves the tip at every recorded pose as other errors of this axis do, whatever functions they
/// are: other knots may make it look determined, the machine does not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SameMotion {
    /// Symbol of the error.
    pub error: String,
    /// The errors of the same axis that do the same, and how much of each one unit of `error` is.
    pub combination: Vec<Combination>,
    /// Which of all these errors are not estimated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_estimated: Vec<String>,
}

impl SameMotion {
    /// One sentence for people.
    pub fn describe(&self) -> String {
        let parts = self.combination.iter().map(|part| {
            let (symbol, factor) = part.unit.parse().map_or((part.unit.clone(), 1.0), |unit: Unit| match unit.per {
                // As sizes of both errors that people read: per 1 µrad or 1 µm.
                Some((per, 1)) => {
                    let (of, factor) = Unit { of: unit.of, per: None }.for_people();
                    (of, factor / Unit { of: per, per: None }.for_people().1)
                }
                _ => unit.for_people(),
            });
            let size = format!("{:.6}", part.coefficient * factor);
            format!("{} {symbol} of {}", size.trim_end_matches('0').trim_end_matches('.'), part.name)
        });
        let does = if self.combination.len() == 1 { "does" } else { "do" };
        let one = match self.combination.first().and_then(|part| part.unit.parse::<Unit>().ok()) {
            Some(Unit { per: Some((Quantity::Angle, 1)), .. }) => "1 µrad",
            _ => "1 µm",
        };
        let same = format!("{one} of {} moves the tip as {} {does} at every recorded pose", self.error, and(parts));
        if self.not_estimated.is_empty() {
            return format!("{same}: only the functions chosen for them tell them apart, not the machine");
        }
        let held = and(self.not_estimated.iter().cloned());
        format!("{same}: {held} not being estimated, the values of the others contain it")
    }
}

/// A list for people: `a, b and c`.
fn and(parts: impl Iterator<Item = String>) -> String {
    let mut parts: Vec<String> = parts.collect();
    let Some(last) = parts.pop() else { return String::new() };
    if parts.is_empty() { last } else { format!("{} and {last}", parts.join(", ")) }
}

/// A direction in which the data do not change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NullVector {
    /// Singular value relative to the largest, columns normalised.
    pub singular_value: f64,
    /// The change of the unknowns in that direction, parameter units; the one with the largest effect is 1.
    pub combination: Vec<Combination>,
    /// Measurements that would tell the change: sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub separated_by: Vec<String>,
}

/// One unknown of a [`NullVector`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Combination {
    /// Name.
    pub name: String,
    /// Change in parameter units.
    pub coefficient: f64,
    /// The unit.
    pub unit: String,
}

impl NullVector {
    /// One sentence for people: which unknowns cannot be told apart, and the sizes that cancel each other.
    pub fn describe(&self) -> String {
        let names: Vec<&str> = self.combination.iter().map(|part| part.name.as_str()).collect();
        match names.as_slice() {
            [] => "a direction without a name is lost".to_owned(),
            [one] => format!("{one} has no effect on these measurements"),
            [one, other] => {
                format!("{one} and {other} cannot be told apart by these measurements ({})", self.changes())
            }
            [..] => format!("these measurements do not change when all of these do: {}", self.changes()),
        }
    }

    /// The same with the measurement that separates them best, where one is known.
    pub fn advise(&self) -> String {
        let lost = self.describe();
        self.separated_by.first().map_or(lost.clone(), |measurement| format!("{lost}; {measurement}"))
    }

    /// The changes in the units that people read, the first one unit large.
    pub fn changes(&self) -> String {
        const SHOWN: usize = 8;
        let for_people = |part: &Combination| part.unit.parse().map_or((part.unit.clone(), 1.0), Unit::for_people);
        let first = self.combination.first().map_or(1.0, |part| part.coefficient * for_people(part).1);
        let changes = self.combination.iter().take(SHOWN).map(|part| {
            let (symbol, factor) = for_people(part);
            let change = part.coefficient * factor / first;
            // Four digits, without an exponent where people read none.
            match change.abs() {
                size if (1e-3..1e5).contains(&size) => {
                    let decimals = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
                    let text = format!("{change:+.decimals$}");
                    let text =
                        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
                    format!("{} {text} {symbol}", part.name)
                }
                _ => format!("{} {change:+.3e} {symbol}", part.name),
            }
        });
        let more = match self.combination.len().saturating_sub(SHOWN) {
            0 => String::new(),
            rest => format!(" and {rest} more"),
        };
        changes.collect::<Vec<_>>().join(", ") + &more
    }
}

/// What a problem can determine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identifiability {
    /// Number of equations.
    pub observations: usize,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Numerical rank.
    pub rank: usize,
    /// Condition number, columns of norm 1, of what is determined.
    pub condition: f64,
    /// What is not.
    pub null_space: Vec<NullVector>,
    /// The combinations that are determined worst, the weakest first.
    pub weakest: Vec<NullVector>,
    /// Motion errors that the functions chosen for them tell apart, and not the machine.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub same_motion: Vec<SameMotion>,
    /// The uncertainties that the stated ones of the inputs promise; none where a direction is lost.
    pub uncertainty: Option<UncertaintyBudget>,
    /// What people should be told besides: sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

/// How the uncertainties of the estimates come about and what they cover (GUM; JCGM 102).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UncertaintyBudget {
    /// Probability that the intervals and regions cover.
    pub coverage_probability: f64,
    /// The a-posteriori factor by which the stated uncertainties of rows were multiplied; 1 if they are trusted.
    pub scale: f64,
    /// All estimated machine parameters together.
    pub joint: JointCoverage,
    /// One entry an estimated parameter.
    pub parameters: Vec<ParameterBudget>,
    /// Pairs that are hardly told apart: absolute correlation above 0.95.
    pub correlations: Vec<Correlated>,
}

/// Coverage of several quantities together (JCGM 102:2011, 6.5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// What it is made of, the largest first; squares add up.
    pub contributions: Vec<Contribution>,
}

/// The part of a standard uncertainty that comes from one input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contribution {
    /// The input: an artefact stage (the scatter of its rows), a known input, an earlier estimate.
    pub input: String,
    /// The standard uncertainty that it alone gives.
    pub standard_uncertainty: f64,
}

/// Two estimates with a large correlation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Correlated {
    /// One.
    pub one: String,
    /// The other.
    pub other: String,
    /// Their correlation coefficient.
    pub correlation: f64,
}

/// What a Monte Carlo calculation found (JCGM 101; JCGM 102).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
}

/// The distribution of one parameter, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

impl Calibration {
    /// Reads a calibration file.
    ///
    /// Keys that are not known are left alone. Fails on text that is not JSON, on another format number, on missing parts, units
    /// that are not known, values that are not finite and a covariance whose shape does not match its names.
    pub fn from_json(text: &str) -> Result<Self> {
        let calibration: Self = FORMAT.read(text)?;
        calibration.check()?;
        Ok(calibration)
    }

    fn check(&self) -> Result<()> {
        let mut names = BTreeSet::new();
        for estimated in self.parameters.iter().chain(&self.artefacts) {
            let name = &estimated.name;
            estimated.unit.parse::<Unit>().map_err(|error| Error::data(format!("`{name}`: {error}")))?;
            if !(estimated.value.is_finite() && estimated.standard_uncertainty >= 0.0) {
                return Err(Error::data(format!("`{name}` has no finite value with an uncertainty of at least zero")));
            }
            if !names.insert(name) {
                return Err(Error::data(format!("`{name}` stands here twice")));
            }
        }
        let Covariance { order, rows } = &self.covariance;
        if let Some(unknown) = order.iter().find(|name| !names.contains(name)) {
            return Err(Error::data(format!("the covariance names `{unknown}`, which is no parameter")));
        }
        let size = order.len();
        if rows.len() != size || rows.iter().any(|row| row.len() != size) {
            return Err(Error::data(format!("the covariance is not {size} x {size} as its names promise")));
        }
        for input in self.inputs.iter().flatten() {
            let ConsideredInput { name, value, unit, standard_uncertainty, sensitivities, .. } = input;
            unit.parse::<Unit>().map_err(|error| Error::data(format!("`{name}`: {error}")))?;
            if !(value.is_finite()
                && *standard_uncertainty > 0.0
                && sensitivities.iter().all(|value| value.is_finite()))
            {
                return Err(Error::data(format!(
                    "the input `{name}` has a number that is not finite, or no uncertainty"
                )));
            }
            if sensitivities.len() != size {
                let given = sensitivities.len();
                return Err(Error::data(format!("the input `{name}` has {given} sensitivities for {size} values")));
            }
        }
        let entries = || (0..size).flat_map(|row| (0..row).map(move |column| (row, column)));
        if let Some((row, column)) = entries().find(|&(row, column)| rows[row][column] != rows[column][row]) {
            let (one, other) = (&order[row], &order[column]);
            return Err(Error::data(format!("the covariance of `{one}` and `{other}` is not symmetric")));
        }
        Ok(())
    }

    /// The text of the calibration file. The same calibration gives the same bytes.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string_pretty(self)
            .map(|text| text + "\n")
            .map_err(|error| Error::data(format!("the calibration cannot be written: {error}")))
    }

    /// The smallest degrees of freedom with which the uncertainty of one of some parameters is known; infinite where they
    /// were all stated.
    pub fn degrees_of_freedom(&self, is_one: impl Fn(&str) -> bool) -> f64 {
        let budgets = self.uncertainty.iter().flat_map(|budget| &budget.parameters);
        let simulated = self.monte_carlo.iter().flat_map(|found| &found.parameters);
        let all = budgets
            .map(|parameter| (&parameter.name, parameter.degrees_of_freedom))
            .chain(simulated.map(|parameter| (&parameter.name, parameter.degrees_of_freedom)));
        all.filter(|(name, _)| is_one(name)).filter_map(|(_, freedom)| freedom).fold(f64::INFINITY, f64::min)
    }

    /// The inputs that this calibration and another one share, as each has them.
    ///
    /// Fails where the two state one differently.
    pub fn shared_inputs<'a>(&'a self, other: &'a Self) -> Result<Vec<(&'a ConsideredInput, &'a ConsideredInput)>> {
        let mut shared = Vec::new();
        for one in self.inputs.iter().flatten() {
            if let Some(two) = other.inputs.iter().flatten().find(|two| two.identity == one.identity) {
                one.agrees_with(two)?;
                shared.push((one, two));
            }
        }
        Ok(shared)
    }

    /// Any value of the calibration, of the machine or of an artefact.
    pub fn get(&self, name: &str) -> Option<&Estimated> {
        self.parameters.iter().chain(&self.artefacts).find(|estimated| estimated.name == name)
    }
}
