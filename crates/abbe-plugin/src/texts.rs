//! The texts that cross the border, beside those of `abbe-core`. They refer to objects by index.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{
    Calibration, ColumnHeader, Considered, Dataset, EquationUncertainty, ErrorFunction, ExportedFile, Fit, Input,
    InputFile, Monitor, ObservationSet, Observations, ObservationsInfo, PoseTable, Prior, Problem, RowIndex, Tie,
    Unknown,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::peer::{Failure, Received};
use crate::proxy;
use crate::served::Served;

/// The description of observations.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct ObservationsText {
    #[serde(flatten)]
    pub info: ObservationsInfo,
    /// The data set; none if it is the one from which the observations were made.
    #[serde(default)]
    pub data: Option<Dataset>,
}

impl ObservationsText {
    pub fn of(observations: &dyn Observations, given: Option<&Arc<Dataset>>) -> Self {
        let info = observations.info().clone();
        let same = given.is_some_and(|given| Arc::ptr_eq(given, &info.layout.data));
        Self { data: (!same).then(|| info.layout.data.as_ref().clone()), info }
    }
}

/// A file that a stage reads.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct InputText {
    pub setting: String,
    pub path: PathBuf,
}

impl InputText {
    pub fn of(inputs: Vec<InputFile>) -> Vec<Self> {
        inputs.into_iter().map(|input| Self { setting: input.setting.to_owned(), path: input.path }).collect()
    }
}

/// Question of `check`.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct CheckText {
    pub headers: Vec<ColumnHeader>,
    pub file: Option<PathBuf>,
}

/// Question of `motion_error`.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct MotionText {
    pub function: ErrorFunction,
    pub values: Vec<f64>,
    /// `null` is NaN: an unknown value.
    pub status: Vec<Option<f64>>,
}

/// Question of `contact_tip`.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct TipText {
    pub row: RowIndex,
    pub tip: [f64; 3],
    pub own: Vec<f64>,
    pub inputs: Vec<f64>,
}

/// Question of `judge`.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct JudgeText {
    pub fits: Vec<FitText>,
    pub data: Vec<Dataset>,
}

/// A written file: a text, or bytes if it is no text.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct FileText {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    text: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    bytes: Vec<u8>,
}

impl From<ExportedFile> for FileText {
    fn from(file: ExportedFile) -> Self {
        match String::from_utf8(file.content) {
            Ok(text) => Self { name: file.name, text: Some(text), bytes: Vec::new() },
            Err(error) => Self { name: file.name, text: None, bytes: error.into_bytes() },
        }
    }
}

impl From<FileText> for ExportedFile {
    fn from(file: FileText) -> Self {
        Self { name: file.name, content: file.text.map_or(file.bytes, String::into_bytes) }
    }
}

/// A problem; model and observations are objects.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct ProblemText {
    name: String,
    model: usize,
    model_plugin: String,
    sets: Vec<SetText>,
    unknowns: Vec<Unknown>,
    /// Libraries of earlier programs know of none.
    #[serde(default)]
    ties: Vec<Tie>,
    machine: Vec<f64>,
    inputs: Vec<Input>,
    considered: Considered,
    /// Libraries of earlier programs know of none.
    #[serde(default)]
    priors: Vec<Prior>,
}

#[derive(Serialize, Deserialize, JsonSchema)]
struct SetText {
    name: String,
    observations: usize,
    rows: Vec<RowIndex>,
    inputs: Vec<f64>,
    own: Vec<f64>,
    uncertainty: EquationUncertainty,
    poses: PoseTable,
    disturbances: Option<Vec<f64>>,
}

fn put(objects: &mut Vec<Arc<Served>>, object: Served) -> usize {
    objects.push(Arc::new(object));
    objects.len() - 1
}

fn get(objects: &[Received], index: usize) -> Result<&Received, Failure> {
    objects
        .get(index)
        .ok_or_else(|| Failure::of("the other side", format!("names object {index}, which it does not give")))
}

impl ProblemText {
    /// The text of a problem; adds its objects.
    pub fn of(problem: &Problem, objects: &mut Vec<Arc<Served>>) -> Self {
        let model = put(objects, Served::Machine(problem.model.clone()));
        let set = |set: &ObservationSet, objects: &mut Vec<Arc<Served>>| SetText {
            name: set.name.clone(),
            observations: put(objects, Served::Observations(set.observations.clone(), None)),
            rows: set.rows.clone(),
            inputs: set.inputs.clone(),
            own: set.own.clone(),
            uncertainty: set.uncertainty.as_ref().clone(),
            poses: set.poses().clone(),
            disturbances: set.disturbances().map(<[f64]>::to_vec),
        };
        Self {
            name: problem.name.clone(),
            model,
            model_plugin: problem.model_plugin.clone(),
            sets: problem.sets.iter().map(|one| set(one, objects)).collect(),
            unknowns: problem.unknowns.clone(),
            ties: problem.ties.clone(),
            machine: problem.machine_values.clone(),
            inputs: problem.inputs.clone(),
            considered: problem.considered.clone(),
            priors: problem.priors.clone(),
        }
    }

    pub fn problem(self, objects: &[Received]) -> Result<Problem, Failure> {
        let mut sets = Vec::new();
        for set in self.sets {
            let observations = proxy::observations(get(objects, set.observations)?, None)?;
            let mut taken = ObservationSet::new(&set.name, observations);
            taken.rows = set.rows;
            taken.inputs = set.inputs;
            taken.own = set.own;
            taken.uncertainty = Arc::new(set.uncertainty);
            taken.set_poses(set.poses);
            if let Some(disturbances) = set.disturbances {
                taken.disturb(disturbances);
            }
            sets.push(taken);
        }
        Ok(Problem {
            name: self.name,
            model: proxy::machine(get(objects, self.model)?)?,
            model_plugin: self.model_plugin,
            sets,
            unknowns: self.unknowns,
            ties: self.ties,
            machine_values: self.machine,
            inputs: self.inputs,
            considered: self.considered,
            priors: self.priors,
            monitor: Monitor::default(),
        })
    }
}

/// A fit; its estimator is an object too.
#[derive(Serialize, Deserialize, JsonSchema)]
pub(crate) struct FitText {
    name: String,
    problem: ProblemText,
    estimator: usize,
    calibration: Calibration,
}

impl FitText {
    pub fn of(fit: &Fit, objects: &mut Vec<Arc<Served>>) -> Self {
        Self {
            name: fit.name.clone(),
            problem: ProblemText::of(&fit.problem, objects),
            estimator: put(objects, Served::Estimate(fit.estimator.clone())),
            calibration: fit.calibration.clone(),
        }
    }

    pub fn fit(self, objects: &[Received]) -> Result<Fit, Failure> {
        Ok(Fit {
            name: self.name,
            estimator: proxy::estimator(get(objects, self.estimator)?),
            problem: Arc::new(self.problem.problem(objects)?),
            calibration: self.calibration,
        })
    }
}
