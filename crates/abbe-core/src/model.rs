//! What a kinematic model offers: axes, status columns, parameters, and tool poses with derivatives in batches.

use std::any::Any;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use abbe_settings::Result;
use abbe_settings::serial::number;
use abbe_settings::{Quantity, Unit};

/// Linear or rotary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AxisKind {
    /// Commands in mm.
    Linear,
    /// Commands in rad.
    Rotary,
}

/// The side of the bed on which an axis sits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Branch {
    /// Between bed and tool.
    Tool,
    /// Between bed and workpiece.
    Workpiece,
}

/// An axis of the machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Name, as in the columns of data files.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Side of the bed.
    pub branch: Branch,
    /// +1 or -1: the sense in which the body that the axis carries moves along its direction for a positive command.
    pub sense: f64,
    /// Unit direction, machine frame.
    pub direction: [f64; 3],
    /// Range of commands in mm or rad, if known.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
    /// Indexed and not interpolated (a spindle).
    #[serde(default)]
    pub indexed: bool,
    /// Index of the command among [`ModelInfo::status`].
    pub status: usize,
}

/// What happens when the data have no column for a status.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Absent {
    /// It is an error.
    Refused,
    /// This value is taken for every row; NaN means that the status is unknown and what depends on it has no effect.
    Taken(#[serde(deserialize_with = "number")] f64),
}

/// What a status is.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StatusRole {
    /// The command of an axis, by its index among [`ModelInfo::axes`].
    Command(usize),
    /// From which side an axis came where it stands: +1 or -1, 0 if that is not known.
    Direction(usize),
    /// The time of the row, s.
    Time,
    /// The stylus that touches.
    Stylus,
    /// A series of measurements that has unknowns of its own: day, set-up.
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
    /// The thermal state of a part of the machine, by its name: what a thermal model makes of temperatures and times.
    ThermalState(String),
    /// What the probe is: its kind, or how it triggers.
    Probe,
    /// Something that no one but the model knows.
    #[default]
    Other,
}

impl StatusRole {
    /// The name that columns of data give it; none if the model names it.
    pub fn column_name(&self, axes: &[Axis]) -> Option<String> {
        match self {
            Self::Command(axis) => Some(axes[*axis].name.clone()),
            Self::Direction(axis) => Some(format!("{DIRECTION}{}", axes[*axis].name)),
            Self::Time => Some(TIME.to_owned()),
            Self::Stylus => Some(STYLUS.to_owned()),
            _ => None,
        }
    }
}

/// What columns of data are called that say the side from which an axis came, the time, and the stylus.
const DIRECTION: &str = "dir_";
const TIME: &str = "time";
const STYLUS: &str = "stylus";

/// A column of the status of a pose that a model takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// What a parameter or an unknown is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ParameterRole {
    /// A coefficient of an error motion of an axis (ISO 230-1: `EXX`).
    Motion {
        /// The axis, by its index among [`ModelInfo::axes`].
        axis: usize,
        /// 0..6: x, y, z, a, b, c.
        component: usize,
    },
    /// A coefficient of a position or orientation error of an axis (ISO 230-1: `EX0C`).
    Location {
        /// The axis, by its index among [`ModelInfo::axes`].
        axis: usize,
        /// 0..6: x, y, z, a, b, c.
        component: usize,
    },
    /// What the set-up decides, and nobody knows beforehand: the offset of a tool, the zero of an instrument.
    SetUp,
    /// What shapes a function that coefficients multiply: a wavelength.
    Shape,
    /// The place or the size of a feature of an artefact.
    Feature,
    /// Something else.
    #[default]
    Other,
}

/// A parameter or an unknown: name, unit, and what it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name as in the conventions, e.g. `EXX[1]`.
    pub name: String,
    /// Unit of its value.
    pub unit: Unit,
    /// What it is.
    #[serde(default)]
    pub role: ParameterRole,
}

impl Parameter {
    /// A parameter of which no more is said than name and unit.
    pub fn new(name: impl Into<String>, unit: Unit) -> Self {
        Self { name: name.into(), unit, role: ParameterRole::Other }
    }

    /// Says what it is.
    pub fn with_role(self, role: ParameterRole) -> Self {
        Self { role, ..self }
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

/// Where poses go: the lists of [`Poses`] as slices, of the right lengths and zero, wherever they live.
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

/// A motion error of an axis, for those who sample or compensate it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Period {
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
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionError {
    /// Its value, mm or rad.
    pub value: f64,
    /// Derivatives to parameters: (index, derivative). Of a coefficient that is the function that it multiplies.
    pub derivatives: Vec<(usize, f64)>,
}

/// What a kinematic model is: all that there is to know of it without evaluating a pose.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelInfo {
    /// The axes, in the order of the structural loop.
    pub axes: Vec<Axis>,
    /// The status columns that a pose of this model is made of; the row of a batch has them in this order.
    pub status: Vec<StatusColumn>,
    /// Every parameter that exists in this model.
    pub parameters: Vec<Parameter>,
    /// Nominal value of every parameter: zero, apart from those that shape a function, such as a wavelength.
    #[serde(default)]
    pub nominal: Vec<f64>,
    /// Standard uncertainty of every nominal value: zero, apart from those that are known from elsewhere, such as a
    /// coefficient of expansion. It counts as long as the parameter is not estimated.
    #[serde(default)]
    pub nominal_uncertainties: Vec<f64>,
    /// Effective stylus radius in mm.
    #[serde(default)]
    pub stylus_radius: f64,
    /// Settings from which the same plugin builds this very model again, without any data.
    pub settings: Value,
    /// The motion errors that this model can tell one by one.
    #[serde(default)]
    pub error_functions: Vec<ErrorFunction>,
    /// The parts of motion errors that repeat along their axes.
    #[serde(default)]
    pub periods: Vec<Period>,
}

impl ModelInfo {
    /// A model whose parameters are all nominally zero, and known to be.
    pub fn new(axes: Vec<Axis>, status: Vec<StatusColumn>, parameters: Vec<Parameter>, settings: Value) -> Self {
        let zero = vec![0.0; parameters.len()];
        let (nominal, nominal_uncertainties) = (zero.clone(), zero);
        Self { axes, status, parameters, nominal, nominal_uncertainties, settings, ..Self::default() }
    }

    /// The index of the status that is this; none if poses do not have it.
    pub fn status_of(&self, role: &StatusRole) -> Option<usize> {
        self.status.iter().position(|column| column.role == *role)
    }

    /// The index of the parameter of this name.
    pub fn parameter(&self, name: &str) -> Option<usize> {
        self.parameters.iter().position(|parameter| parameter.name == name)
    }
}

/// A batch of poses that are asked for.
#[derive(Debug, Clone, Copy)]
pub struct PoseBatch<'a> {
    /// Poses x [`ModelInfo::status`], pose by pose.
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

    /// Poses and derivatives of a batch, written where `out` says: slices of the right lengths, zero before the call.
    ///
    /// Fails where there is no pose, or none within the range of the model; the error names the pose
    /// ([`Error::of_pose`](crate::Error::of_pose)).
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

    /// A motion error at a status; `values` has one value a parameter.
    ///
    /// Fails where the status is outside the range of the error's functions.
    fn motion_error(&self, _function: &ErrorFunction, _values: &[f64], _status: &[f64]) -> Result<MotionError> {
        Ok(MotionError::default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn some_roles_give_the_names_of_columns() {
        let axis = |(status, name): (usize, &str)| Axis {
            name: name.to_owned(),
            kind: AxisKind::Linear,
            branch: Branch::Tool,
            sense: 1.0,
            direction: [1.0, 0.0, 0.0],
            range: None,
            indexed: false,
            status,
        };
        let axes: Vec<Axis> = ["X", "Z"].into_iter().enumerate().map(axis).collect();
        for (role, name) in [
            (StatusRole::Command(1), "Z"),
            (StatusRole::Direction(0), "dir_X"),
            (StatusRole::Time, "time"),
            (StatusRole::Stylus, "stylus"),
        ] {
            assert_eq!(role.column_name(&axes).as_deref(), Some(name));
        }
        assert_eq!(StatusRole::Temperature.column_name(&axes), None);
    }
}
