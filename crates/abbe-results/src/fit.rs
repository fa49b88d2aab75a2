//! Calibrations: the result of an estimate, and the reader and writer of its file.
//!
//! `calibration.json` is a stable format that others read: its number stands in the key `abbe_calibration`, its schema
//! in `docs/schemas/calibration.schema.json`; `docs/formats.md` says what may change. A calibration is self-contained: pose
//! predictions and compensation need nothing else.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::budget::{MonteCarlo, UncertaintyBudget};
use crate::covariance::NamedCovariance;
use crate::format::FileFormat;
use crate::identifiability::{EquivalentMotionError, WeakDirection};
use abbe_settings::{Error, Result, Termination};

/// The number of the file format.
pub const CALIBRATION_FORMAT: u32 = 1;

const FORMAT: FileFormat = FileFormat { name: "calibration", key: "abbe_calibration", number: CALIBRATION_FORMAT };

/// The result of an estimate for a machine and its artefacts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Calibration {
    /// Number of the format, [`CALIBRATION_FORMAT`].
    pub abbe_calibration: u32,
    /// Name of the estimate.
    pub estimate: String,
    /// The model, with all settings resolved.
    pub model: ModelRecord,
    /// Every parameter of the model, estimated or not.
    pub parameters: Vec<Estimated>,
    /// Every own unknown of the artefacts, as `<stage>.<own name>`, and every considered input that is no parameter of the
    /// model.
    pub artefacts: Vec<Estimated>,
    /// Covariance of everything that was estimated or considered.
    pub covariance: NamedCovariance,
    /// The considered inputs, independent of each other, and the sensitivities of the estimates to them. None in files of
    /// early versions without identities: the inputs that such a calibration shares with others are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inputs: Option<Vec<ConsideredInput>>,
    /// The measurements that were used, directly or by a known earlier estimate.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub data: Vec<DataRecord>,
    /// Rows that the robust estimate leaves out or calls outliers.
    pub outliers: Vec<Outlier>,
    /// Report of the fit.
    pub fit: FitReport,
    /// Uncertainty budgets and coverage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyBudget>,
    /// Results of a Monte Carlo calculation, if the estimate is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub monte_carlo: Option<MonteCarlo>,
    /// The group of rows that it was made of, if an estimate was made for every group.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<Group>,
}

/// A group of rows with an estimate of its own: those of one week, day or file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Group {
    /// What the rows have in common: the name of a column, or `file`.
    pub by: String,
    /// What stands there.
    pub label: String,
    /// The same as a time: the number, the day of a date (from 1970-01-01), or the place in the order of the groups.
    pub at: f64,
    /// Unit of `at`: `week`, `day`, or `test` where only the order is known.
    pub unit: String,
}

/// Plugin and settings from which the model is built again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelRecord {
    /// Name of the model plugin.
    pub plugin: String,
    /// Its resolved settings.
    pub settings: Value,
}

/// Status of a value of a calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// Estimated from the data.
    Estimated,
    /// Not estimated: a fixed value without uncertainty.
    Fixed,
    /// Not estimated, but its uncertainty is taken into account.
    Considered,
    /// The data cannot separate it from other unknowns; the value is one of many possible values.
    Confounded,
}

/// A parameter with its value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimated {
    /// Name.
    pub name: String,
    /// Value in `unit`.
    pub value: f64,
    /// Unit, e.g. `mm/rad^2`.
    pub unit: String,
    /// Standard uncertainty in `unit`.
    pub standard_uncertainty: f64,
    /// Status of the value.
    pub status: Status,
}

/// An estimated error that is larger than an error of a machine can be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ImplausibleValue {
    /// Name of the parameter.
    pub name: String,
    /// The largest error over the recorded travel that it makes, mm or rad.
    pub size: f64,
    /// What is plausible at most, mm or rad.
    pub plausible: f64,
}

/// An input that is not estimated but whose uncertainty is propagated: a certificate, a stylus, a sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConsideredInput {
    /// Name in this estimate.
    pub name: String,
    /// Its identity, the same in all estimates: a declared `id`, or a hash of the content of its certificate, and the
    /// quantity on it.
    pub identity: String,
    /// Value in `unit`.
    pub value: f64,
    /// Unit.
    pub unit: String,
    /// Standard uncertainty in `unit`.
    pub standard_uncertainty: f64,
    /// Sensitivity of each value to it, parameter unit per `unit`, in the order of the covariance.
    pub sensitivities: Vec<f64>,
}

impl ConsideredInput {
    /// Fails if two estimates state a quantity of one identity differently.
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

/// Rows of a file that an estimate was made from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DataRecord {
    /// The file, as it was named.
    pub file: String,
    /// SHA-256 of its content; none if it was no file that could be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Numbers of its data rows, from 1: first and last of each run of rows.
    pub rows: Vec<[usize; 2]>,
}

/// A row that does not agree with the others.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Outlier {
    /// Artefact stage.
    pub stage: String,
    /// File that the row stands in.
    pub file: String,
    /// Line in the file; 0 in a file that has no lines.
    pub line: usize,
    /// Number of the data row in the file, from 1.
    pub row: usize,
    /// Its residual (the largest of its equations) in µm (µrad for angles).
    pub residual_um: f64,
    /// Its robust weight, 0 to 1.
    pub weight: f64,
}

impl Outlier {
    /// Its file with the line, if the file has lines.
    pub fn place(&self) -> String {
        match self.line {
            0 => self.file.clone(),
            line => format!("{}:{line}", self.file),
        }
    }
}

/// Report of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    /// A-posteriori factor: weighted residual RMS relative to the value expected from the standard uncertainties;
    /// dimensionless.
    pub sigma: f64,
    /// Iterations.
    pub iterations: usize,
    /// How the iteration ended.
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
    /// Root mean square of the distances of points, µm: of rows that have three residuals of lengths; none if no row has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_radial_rms_um: Option<f64>,
    /// Largest absolute residual of angles, µrad; none if no angle was observed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_max_urad: Option<f64>,
    /// Mean absolute residual of angles, µrad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_mean_abs_urad: Option<f64>,
    /// Root mean square of the residuals of angles, µrad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_rms_urad: Option<f64>,
    /// Singular values below this part of the largest count as zero; none where nothing was solved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rank_tolerance: Option<f64>,
    /// What the data cannot determine.
    pub null_space: Vec<WeakDirection>,
    /// Unknowns that were left at their start values, so that others could be estimated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<String>,
    /// The combinations that they determine worst, the weakest first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weakest: Vec<WeakDirection>,
    /// The selection of parameters by their significance; none if no selection was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection: Option<Selection>,
    /// The selection of parameters by prediction; none if no such selection was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub selection_by_prediction: Option<SelectionByPrediction>,
    /// Motion errors with the same effect on the tip: only the functions chosen for them separate them, not the machine.
    #[serde(rename = "same_motion", default, skip_serializing_if = "Vec::is_empty")]
    pub equivalent_motion_errors: Vec<EquivalentMotionError>,
    /// Estimated errors that are larger than an error of a machine can be.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub implausible: Vec<ImplausibleValue>,
    /// Number of own unknowns of artefacts that were eliminated: they have values and standard uncertainties, and neither
    /// covariances nor budgets.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub eliminated: usize,
    /// The factors on the stated uncertainties of every artefact, where each was given its own.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variance: Vec<VarianceFactor>,
    /// How well the calibrations agree of which this one was combined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<CombinedAgreement>,
    /// The covariance as if residuals were independent, where that of the calibration is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ordinary_covariance: Option<NamedCovariance>,
    /// Smallest and largest load (N), temperature (°C) and the like of the rows, by the names of their columns.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub statuses: BTreeMap<String, [f64; 2]>,
    /// Degrees of freedom of parameters that were known from an earlier estimate, where they are finite.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub known_degrees_of_freedom: BTreeMap<String, f64>,
    /// What to know before the estimates are trusted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

fn is_zero(number: &usize) -> bool {
    *number == 0
}

impl FitReport {
    /// The report of a calibration with this number of unknowns that was not fitted to rows.
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
            residual_radial_rms_um: None,
            residual_max_urad: None,
            residual_mean_abs_urad: None,
            residual_rms_urad: None,
            rank_tolerance: None,
            null_space: Vec::new(),
            dropped: Vec::new(),
            weakest: Vec::new(),
            selection: None,
            selection_by_prediction: None,
            equivalent_motion_errors: Vec::new(),
            implausible: Vec::new(),
            eliminated: 0,
            variance: Vec::new(),
            agreement: None,
            ordinary_covariance: None,
            statuses: BTreeMap::new(),
            known_degrees_of_freedom: BTreeMap::new(),
            remarks: Vec::new(),
        }
    }
}

/// Scatter of the readings of an artefact, relative to their stated uncertainties.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VarianceFactor {
    /// The artefact stage.
    pub stage: String,
    /// The factor on its standard uncertainties.
    pub factor: f64,
    /// Its degrees of freedom; none if the readings cannot determine the factor, so that the stated uncertainties are used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
}

/// Whether calibrations that were combined agree within their uncertainties.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CombinedAgreement {
    /// Their weighted squared differences, inputs that they share taken into account.
    pub chi_squared: f64,
    /// The rank of the covariance of these differences.
    pub degrees_of_freedom: usize,
    /// Probability that chance alone makes them differ as much.
    pub probability: f64,
}

/// A selection of parameters by their significance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Selection {
    /// Significance level: largest probability that chance alone makes a kept parameter look as significant.
    pub level: f64,
    /// Its direction.
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
    /// Starts with all parameters and removes some.
    #[default]
    Backward,
    /// Starts with none and adds some.
    Forward,
    /// Starts with none and adds some. Added parameters may be removed again, or replaced by better ones.
    Both,
}

/// A step of a selection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SelectionStep {
    /// The parameter.
    pub parameter: String,
    /// Whether it came in or went out.
    pub entered: bool,
    /// Probability that chance alone makes it look as significant at this step.
    pub probability: f64,
}

/// A selection of parameters by the prediction of runs that no estimate has seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SelectionByPrediction {
    /// The runs that were left out in turn.
    pub runs: Vec<String>,
    /// Part by which predictions may be worse than the best ones.
    pub worse: f64,
    /// The parameters that are kept, of those that could be left out.
    pub kept: Vec<String>,
    /// Those that are left out, at their nominal values.
    pub left_out: Vec<String>,
    /// What was chosen.
    pub chosen: PredictedStructure,
    /// What was tried.
    pub tried: Vec<PredictedStructure>,
}

/// Candidates that were left out, and how well the others predict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PredictedStructure {
    /// The candidates, as the recipe names them.
    pub left_out: Vec<String>,
    /// Root mean square of what is predicted wrong, in standard uncertainties of the readings: as stated, or the scatter of all candidates.
    pub error: f64,
}

impl Calibration {
    /// Reads a calibration file.
    ///
    /// Keys that are not known are left alone. Fails on text that is not JSON, on another format number, on missing parts, units
    /// that are not known, values that are not finite, and a covariance that does not match its names, is none, or contradicts the standard
    /// uncertainties.
    pub fn from_json(text: &str) -> Result<Self> {
        let calibration: Self = FORMAT.read(text)?;
        calibration.check()?;
        Ok(calibration)
    }

    /// The text of the calibration file. The same calibration gives the same bytes.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string_pretty(self)
            .map(|text| text + "\n")
            .map_err(|error| Error::data(format!("the calibration cannot be written: {error}")))
    }

    /// Takes over what an earlier estimate did not know well of the parameters that it gave: those that were confounded stay so, with
    /// the directions that they share, and degrees of freedom stay as few.
    pub fn keep_limits_of_known(&mut self, known: &Self) {
        for parameter in self.parameters.iter_mut().filter(|parameter| parameter.status == Status::Considered) {
            if known.get(&parameter.name).is_some_and(|known| known.status == Status::Confounded) {
                parameter.status = Status::Confounded;
            }
            let freedom = known.degrees_of_freedom(|name| name == parameter.name);
            if freedom.is_finite() {
                self.fit.known_degrees_of_freedom.insert(parameter.name.clone(), freedom);
            }
        }
        let confounded = |name: &str| {
            let own = self.parameters.iter().find(|parameter| parameter.name == name);
            own.is_some_and(|own| own.status == Status::Confounded)
        };
        let shared =
            known.fit.null_space.iter().filter(|one| one.combination.iter().any(|part| confounded(&part.name)));
        let kept: Vec<WeakDirection> = shared.filter(|one| !self.fit.null_space.contains(one)).cloned().collect();
        self.fit.null_space.extend(kept);
    }

    /// The smallest degrees of freedom of the uncertainties of some parameters; infinite if all are infinite or not known.
    pub fn degrees_of_freedom(&self, is_one: impl Fn(&str) -> bool) -> f64 {
        let budgets = self.uncertainty.iter().flat_map(|budget| &budget.parameters);
        let simulated = self.monte_carlo.iter().flat_map(|found| &found.parameters);
        let all = budgets
            .map(|parameter| (&parameter.name, parameter.degrees_of_freedom))
            .chain(simulated.map(|parameter| (&parameter.name, parameter.degrees_of_freedom)));
        let known = self.fit.known_degrees_of_freedom.iter().map(|(name, freedom)| (name, Some(*freedom)));
        let all = all.chain(known).filter(|(name, _)| is_one(name));
        all.filter_map(|(_, freedom)| freedom).fold(f64::INFINITY, f64::min)
    }

    /// The inputs that this calibration and another one share: pairs of this and the other record.
    ///
    /// Fails if the two calibrations state an input differently.
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

    /// The value with this name, of the machine or of an artefact.
    pub fn get(&self, name: &str) -> Option<&Estimated> {
        self.parameters.iter().chain(&self.artefacts).find(|estimated| estimated.name == name)
    }

    /// All values by their names, for many questions.
    pub fn by_name(&self) -> BTreeMap<&str, &Estimated> {
        let all = self.parameters.iter().chain(&self.artefacts).rev();
        all.map(|estimated| (estimated.name.as_str(), estimated)).collect()
    }
}
