//! Kinematic models: axes, status columns, parameters, and tool poses with derivatives in batches.
//!
//! The status of a pose is all values that the pose depends on: commands of axes, directions of approach, stylus, time, load,
//! temperatures, ... A batch has one row of values for every pose. One column of these rows is a [`StatusColumn`];
//! [`ModelInfo::status`] lists the columns, and [`Axis::status`] is the index of the column with the command of the axis.

use std::any::Any;
use std::f64::consts::TAU;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::factored::FactoredPoses;
use crate::parameter::{Parameter, ParameterRole};
use abbe_results::Calibration;
use abbe_settings::Quantity;
use abbe_settings::Result;
use abbe_settings::serial::number;

/// Linear or rotary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AxisKind {
    /// Commands in mm.
    Linear,
    /// Commands in rad.
    Rotary,
}

/// The side of the bed on which an axis sits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Branch {
    /// Between bed and tool.
    Tool,
    /// Between bed and workpiece.
    Workpiece,
}

/// An axis of the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Axis {
    /// Name, as in the columns of data files.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Side of the bed.
    pub branch: Branch,
    /// +1 or -1: for a positive command, the body that the axis carries moves along (about) `direction` in this sense.
    pub sense: f64,
    /// Unit direction, machine frame.
    pub direction: [f64; 3],
    /// Range of commands in mm or rad, if known.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
    /// Indexed and not interpolated (a spindle).
    #[serde(default)]
    pub indexed: bool,
    /// It turns on without an end: commands outside `range` are right.
    #[serde(default)]
    pub endless: bool,
    /// The column of its command: index into [`ModelInfo::status`].
    pub status: usize,
}

/// Part of the travel by which an axis may be beyond its ends: what is written of a machine is a little less than what it can do.
const BEYOND: f64 = 0.1;

impl Axis {
    /// Where the axis may be said to stand, mm or rad: its range and a tenth more at both ends, a turn more where it turns around,
    /// because controls count turns in different ways. None if it turns without an end, or if its range is not known.
    pub fn reach(&self) -> Option<[f64; 2]> {
        let [from, to] = self.range.filter(|_| !self.endless)?;
        let turns_around = self.kind == AxisKind::Rotary && to - from >= TAU * (1.0 - 1e-9);
        let more = if turns_around { TAU.max(BEYOND * (to - from)) } else { BEYOND * (to - from) };
        Some([from - more, to + more])
    }
}

/// What happens when the data have no column for a value of the status.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Absent {
    /// It is an error.
    #[serde(rename = "refused")]
    Required,
    /// It has this value in every row. NaN means that the value is unknown; errors that depend on it then have no effect.
    #[serde(rename = "taken")]
    Default(
        #[serde(deserialize_with = "number")]
        #[schemars(with = "Option<f64>")]
        f64,
    ),
}

/// What the values in a column of the status are.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StatusRole {
    /// The command of an axis, by its index among [`ModelInfo::axes`].
    Command(usize),
    /// The direction of the last approach of an axis, by its index: +1 or -1; 0 if it is not known.
    Direction(usize),
    /// The time of the row, s.
    Time,
    /// The stylus that touches.
    Stylus,
    /// A series of measurements with its own unknowns: day, set-up.
    Series,
    /// A temperature.
    Temperature,
    /// The force on the workpiece.
    Load,
    /// The feed, mm/s or rad/s.
    Feed,
    /// The velocity of an axis, mm/s or rad/s.
    Velocity(usize),
    /// The reading of a sensor of the machine, by its name.
    Sensor(String),
    /// The thermal state of a part of the machine, by its name: the output of a thermal model for temperatures and times.
    ThermalState(String),
    /// What the probe is: its kind, or how it triggers.
    Probe,
    /// Values that only this model knows.
    #[default]
    Other,
}

impl StatusRole {
    /// The name of its data column; none if the model chooses the name.
    pub fn column_name(&self, axes: &[Axis]) -> Option<String> {
        match self {
            Self::Command(axis) => Some(axes[*axis].name.clone()),
            Self::Direction(axis) => Some(format!("{DIRECTION}{}", axes[*axis].name)),
            Self::Velocity(axis) => Some(format!("{VELOCITY}{}", axes[*axis].name)),
            Self::Time => Some(TIME.to_owned()),
            Self::Stylus => Some(STYLUS.to_owned()),
            _ => None,
        }
    }
}

/// Names of data columns: prefix of the direction of approach of an axis, time, stylus.
const DIRECTION: &str = "dir_";
const VELOCITY: &str = "velocity_";
const TIME: &str = "time";
const STYLUS: &str = "stylus";

/// One column of the status of poses: a value that the model needs of every pose, and the data column that it is read from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StatusColumn {
    /// Name without unit: `X`, `dir_X`, `time`, `day`, `stylus`.
    pub name: String,
    /// What it is.
    #[serde(default)]
    pub role: StatusRole,
    /// Its quantity; `Label` with `levels`.
    pub quantity: Quantity,
    /// For labels: the known ones, passed to the model as their index; an unknown one as NaN.
    #[serde(default)]
    pub levels: Vec<String>,
    /// What an absent column means.
    pub absent: Absent,
}

impl StatusColumn {
    /// The name of its column where a row has several poses, counted from 1: `X1`, `dir1_X`.
    pub fn column_of_pose(&self, pose: usize) -> String {
        let axis = self.name.strip_prefix(DIRECTION).filter(|_| matches!(self.role, StatusRole::Direction(_)));
        match axis {
            Some(axis) => format!("{}{pose}_{axis}", DIRECTION.trim_end_matches('_')),
            None => format!("{}{pose}", self.name),
        }
    }
}

/// What a derivative is taken with respect to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variable {
    /// Index into [`ModelInfo::parameters`].
    Parameter(usize),
    /// The command of an axis: index into [`ModelInfo::axes`].
    Command(usize),
}

/// Tool poses relative to the workpiece, and their derivatives, for a batch of statuses.
///
/// Derivatives are stored pose by pose, in the order of the variables asked for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Poses {
    /// Tip position in the table frame, mm.
    pub positions: Vec<[f64; 3]>,
    /// Tool orientation in the table frame as unit quaternion w, x, y, z; empty unless asked for.
    pub orientations: Vec<[f64; 4]>,
    /// d(position)/d(variable): poses x variables.
    pub position_derivatives: Vec<[f64; 3]>,
    /// d(rotation vector, table frame)/d(variable): poses x variables; empty unless orientations were asked for.
    pub rotation_derivatives: Vec<[f64; 3]>,
}

impl Poses {
    /// Makes room for `poses` poses with derivatives to `variables` variables; everything is zero afterwards.
    pub fn reset(&mut self, poses: usize, variables: usize, orientation: bool) {
        fn zero<const N: usize>(list: &mut Vec<[f64; N]>, length: usize) {
            list.clear();
            list.resize(length, [0.0; N]);
        }
        let turned = usize::from(orientation);
        zero(&mut self.positions, poses);
        zero(&mut self.orientations, poses * turned);
        zero(&mut self.position_derivatives, poses * variables);
        zero(&mut self.rotation_derivatives, poses * variables * turned);
    }

    /// The lists as slices.
    pub fn as_mut(&mut self) -> PosesMut<'_> {
        PosesMut {
            positions: &mut self.positions,
            orientations: &mut self.orientations,
            position_derivatives: &mut self.position_derivatives,
            rotation_derivatives: &mut self.rotation_derivatives,
        }
    }
}

/// Output for poses: the lists of [`Poses`] as mutable slices. They have the right lengths and are filled with zeros.
#[derive(Debug)]
pub struct PosesMut<'a> {
    /// As [`Poses::positions`].
    pub positions: &'a mut [[f64; 3]],
    /// As [`Poses::orientations`].
    pub orientations: &'a mut [[f64; 4]],
    /// As [`Poses::position_derivatives`].
    pub position_derivatives: &'a mut [[f64; 3]],
    /// As [`Poses::rotation_derivatives`].
    pub rotation_derivatives: &'a mut [[f64; 3]],
}

impl PosesMut<'_> {
    /// Copies poses. Panics unless all lists have the same lengths.
    pub fn copy_from(self, poses: &Poses) {
        self.positions.copy_from_slice(&poses.positions);
        self.orientations.copy_from_slice(&poses.orientations);
        self.position_derivatives.copy_from_slice(&poses.position_derivatives);
        self.rotation_derivatives.copy_from_slice(&poses.rotation_derivatives);
    }
}

/// One value for every parameter of a model, in the units of memory: that of a calibration, or the nominal one where it has none.
pub fn machine_values(model: &dyn KinematicModel, calibration: &Calibration) -> Vec<f64> {
    let parameters = model.info().parameters.iter().zip(&model.info().nominal);
    parameters
        .map(|(parameter, nominal)| calibration.get(&parameter.name).map_or(*nominal, |known| known.value))
        .collect()
}

/// A motion error of an axis that can be evaluated by itself, to sample it or to compensate it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorFunction {
    /// ISO 230-1 symbol, e.g. `EYX`.
    pub symbol: String,
    /// Index of the moving axis.
    pub axis: usize,
    /// 0..6: x, y, z, a, b, c.
    pub component: usize,
    /// Length or angle.
    pub quantity: Quantity,
}

/// A part of a motion error that repeats along its axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PeriodicError {
    /// ISO 230-1 symbol of the error, e.g. `EXX`.
    pub symbol: String,
    /// Index of the moving axis.
    pub axis: usize,
    /// Nominal length of a period, mm or rad.
    pub length: f64,
    /// Indices of its parameters.
    pub parameters: Vec<usize>,
    /// Indices of the parameters that shape it: its length, where that may be estimated.
    #[serde(default)]
    pub shapes: Vec<usize>,
}

/// The value of a motion error at a status, and how it depends on parameters.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotionError {
    /// Its value, mm or rad.
    pub value: f64,
    /// Derivatives to parameters: (index, derivative). The derivative to a coefficient is the value of its function.
    pub derivatives: Vec<(usize, f64)>,
}

/// Description of a kinematic model: everything that is known without evaluating a pose.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelInfo {
    /// The axes, in the order of the structural loop.
    pub axes: Vec<Axis>,
    /// The columns of the status of a pose. Every row of a batch has its values in this order.
    pub status: Vec<StatusColumn>,
    /// Every parameter that exists in this model.
    pub parameters: Vec<Parameter>,
    /// Nominal value of every parameter: zero, except for parameters of the shape of a function, such as a wavelength, and
    /// others with a known value, such as a coefficient of expansion.
    #[serde(default)]
    pub nominal: Vec<f64>,
    /// Standard uncertainty of every nominal value: zero, except for values that are known from another source, such as a
    /// coefficient of expansion. It is propagated if the parameter is not estimated.
    #[serde(default)]
    pub nominal_uncertainties: Vec<f64>,
    /// Effective stylus radius in mm.
    #[serde(default)]
    pub stylus_radius: f64,
    /// Settings from which the same plugin builds the same model again, without data.
    pub settings: Value,
    /// The motion errors that this model can evaluate one by one ([`KinematicModel::motion_error`]).
    #[serde(default)]
    pub error_functions: Vec<ErrorFunction>,
    /// The parts of motion errors that repeat along their axes.
    #[serde(default)]
    pub periods: Vec<PeriodicError>,
}

impl ModelInfo {
    /// A model whose parameters all have the nominal value zero, with standard uncertainty zero.
    pub fn new(axes: Vec<Axis>, status: Vec<StatusColumn>, parameters: Vec<Parameter>, settings: Value) -> Self {
        let zero = vec![0.0; parameters.len()];
        let (nominal, nominal_uncertainties) = (zero.clone(), zero);
        Self { axes, status, parameters, nominal, nominal_uncertainties, settings, ..Self::default() }
    }

    /// The index of the column of the status with this role; none if the status does not have it.
    pub fn status_index(&self, role: &StatusRole) -> Option<usize> {
        self.status.iter().position(|column| column.role == *role)
    }

    /// Values of a machine without errors: nominal ones, and factors of known errors zero.
    pub fn without_errors(&self) -> Vec<f64> {
        let each = self.parameters.iter().zip(&self.nominal);
        each.map(|(parameter, nominal)| if parameter.role == ParameterRole::Factor { 0.0 } else { *nominal }).collect()
    }

    /// The index of the parameter of this name.
    pub fn parameter(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|parameter| parameter.name == name)
    }
}

/// A batch of poses that are asked for.
#[derive(Debug, Clone, Copy)]
pub struct PoseBatch<'a> {
    /// The status of every pose, pose by pose: poses x columns of [`ModelInfo::status`].
    pub statuses: &'a [f64],
    /// One value a parameter.
    pub values: &'a [f64],
    /// The variables that derivatives are wanted for.
    pub wanted: &'a [Variable],
    /// Whether orientations (and their derivatives) are wanted.
    pub orientation: bool,
}

/// A machine: where its tool is relative to its workpiece, given axis positions, status and parameters.
///
/// Implementations are immutable and may be called from several threads at once.
pub trait KinematicModel: Any + Send + Sync {
    /// What the model is.
    fn info(&self) -> &ModelInfo;

    /// Writes poses and derivatives of a batch into `out`. Its slices have the right lengths and are zero before the call.
    ///
    /// Fails if a pose does not exist, or is outside the range of the model. The error names the pose
    /// ([`Error::at_pose`](crate::Error::at_pose)).
    fn evaluate(&self, batch: PoseBatch<'_>, out: PosesMut<'_>) -> Result<()>;

    /// Makes room in `out` and evaluates a batch into it.
    fn poses(
        &self,
        statuses: &[f64],
        values: &[f64],
        wanted: &[Variable],
        orientation: bool,
        out: &mut Poses,
    ) -> Result<()> {
        out.reset(statuses.len() / self.info().status.len().max(1), wanted.len(), orientation);
        self.evaluate(PoseBatch { statuses, values, wanted, orientation }, out.as_mut())
    }

    /// Makes room in `out` and evaluates a batch into it, with derivatives in factors. Fails as [`evaluate`](Self::evaluate) does.
    ///
    /// A model whose parameters share effects is much faster if it gives these; the default is one for each variable.
    fn factored(&self, batch: PoseBatch<'_>, out: &mut FactoredPoses) -> Result<()> {
        let PoseBatch { statuses, values, wanted, orientation } = batch;
        self.poses(statuses, values, wanted, orientation, &mut out.poses)?;
        out.take_derivatives(wanted.len());
        Ok(())
    }

    /// A motion error at a status; `values` has one value a parameter.
    ///
    /// Fails where the status is outside the range of the error's functions.
    fn motion_error(&self, _function: &ErrorFunction, _values: &[f64], _status: &[f64]) -> Result<MotionError> {
        Ok(MotionError::default())
    }

    /// Poses as C code: one function for each name and values of the parameters,
    /// `static void NAME(const double *q, double *tip, double *axis)`. `q` has the commands of the axes (mm, rad), `tip` and `axis`
    /// become tip and tool axis in the table frame. Directions of approach are 0; all else is as for data without a column for it.
    ///
    /// Fails for a model, or an error of it, that has no form in C.
    fn poses_in_c(&self, _functions: &[(&str, &[f64])]) -> Result<String> {
        Err(abbe_settings::Error::usage("this model of a machine cannot be written in C"))
    }
}
