//! A measurement on a machine: the axis that moves, the positions of the others, the body and direction of the reading.

use std::collections::BTreeMap;

use abbe_core::{
    Absent, Axis, AxisKind, Branch, ColumnHeader, KinematicModel, PathItem, Poses, Quantity, Result, SettingsError,
    StatusColumn, StatusRole, Variable,
};
use nalgebra::Vector3;

use crate::{Body, Direction, Kind, Letter, Measurement};

/// Smallest cosine between the directions of reading and of motion for a displacement; below it the reading is a
/// straightness.
const ALONG: f64 = 0.5;

/// A measurement on a machine.
#[derive(Debug, Clone)]
pub struct Line {
    /// The motions: one leg, for squares two.
    pub legs: Vec<Leg>,
    /// Whether angles are read.
    pub angle: bool,
    /// Statuses that all its poses have: (index, value).
    pub at: Vec<(usize, f64)>,
    /// The unknown tilt of the line, if there is one: slope of a straightedge, angle of a square.
    pub tilt: Option<Tilt>,
    /// Columns with the labels of runs: each run has its own datum.
    pub datum_columns: Vec<String>,
    /// Whether it drifts.
    pub drift: bool,
    /// Standard uncertainty of a reading, mm or rad.
    pub standard_uncertainty: f64,
}

/// An unknown tilt of a line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Tilt {
    /// The slope of a straightedge, with its name if it has one.
    Slope(Option<String>),
    /// The angle of a square on the table.
    Angle,
}

/// A motion that is read.
#[derive(Debug, Clone)]
pub struct Leg {
    /// The axis that moves, by its name in the column `leg`.
    pub name: String,
    /// Statuses of its command and of its direction of approach.
    pub command: Option<usize>,
    pub approach: Option<usize>,
    /// Derivative of the reading to the translation (rotation) of the tool relative to the table: s n.
    pub sensitivity: Vector3<f64>,
    /// Derivative of the reading to the tilt, per unit of position.
    pub by_tilt: f64,
}

/// Columns of statuses: those of axes are settled by each measurement, unless the data have them; the others are plain.
pub fn naming(status: &StatusColumn, axis: Option<&Axis>) -> (Vec<String>, Absent) {
    let absent = if axis.is_some() { Absent::Default(f64::NAN) } else { status.absent };
    (vec![status.name.clone()], absent)
}

/// The index of an axis.
pub fn axis(model: &dyn KinematicModel, name: &str) -> Result<usize, SettingsError> {
    let names = || model.info().axes.iter().map(|axis| axis.name.as_str());
    names()
        .position(|axis| axis == name)
        .ok_or_else(|| SettingsError::new("moves", format!("the machine has no axis {name}")).suggest(name, names()))
}

impl Line {
    /// Fails inside where the settings do not suit the machine, outside where the model fails.
    pub fn new(
        measurement: &Measurement,
        standard_uncertainty: f64,
        headers: &[ColumnHeader],
        model: &dyn KinematicModel,
    ) -> Result<Result<Self, SettingsError>> {
        let statuses = match statuses(measurement, headers, model) {
            Ok(statuses) => statuses,
            Err(error) => return Ok(Err(error)),
        };
        let mut moving = Vec::new();
        for name in measurement.moving() {
            match axis(model, name) {
                Ok(axis) => moving.push((axis, motion(axis, &statuses, model)?)),
                Err(error) => return Ok(Err(error)),
            }
        }
        let legs = match legs(measurement, &moving, model) {
            Ok(legs) => legs,
            Err(error) => return Ok(Err(error)),
        };
        let tilt = match measurement.kind {
            Kind::Straightness => Some(Tilt::Slope(measurement.slope.clone())),
            Kind::Square => Some(Tilt::Angle),
            Kind::Displacement | Kind::Angle => None,
        };
        Ok(Ok(Self {
            legs,
            angle: measurement.kind == Kind::Angle,
            at: statuses.into_iter().collect(),
            tilt,
            datum_columns: measurement.datum_columns(headers),
            drift: measurement.drifts(headers),
            standard_uncertainty,
        }))
    }
}

/// The statuses that the settings say: where axes rest, the stylus.
fn statuses(
    measurement: &Measurement,
    headers: &[ColumnHeader],
    model: &dyn KinematicModel,
) -> Result<BTreeMap<usize, f64>, SettingsError> {
    let mut statuses = BTreeMap::new();
    for (setting, given, kind, factor) in [
        ("at_mm", &measurement.at_mm, AxisKind::Linear, 1.0),
        ("at_deg", &measurement.at_deg, AxisKind::Rotary, 1f64.to_radians()),
    ] {
        for (name, value) in given {
            let under = |error: SettingsError| error.under([PathItem::Key(setting.to_owned())]);
            let index = axis(model, name).map_err(|error| under(SettingsError { path: Vec::new(), ..error }))?;
            let axis = &model.info().axes[index];
            if axis.kind != kind {
                let right = if kind == AxisKind::Linear { "at_deg" } else { "at_mm" };
                return Err(under(SettingsError::new(name, format!("this axis belongs under `{right}`"))));
            }
            statuses.insert(axis.status, value * factor);
        }
    }
    let moving = measurement.moving();
    for axis in &model.info().axes {
        // Along a square an axis moves on its own leg and rests on the other.
        let moves = moving.len() == 1 && moving[0] == axis.name;
        if moves && statuses.contains_key(&axis.status) {
            let setting = if axis.kind == AxisKind::Linear { "at_mm" } else { "at_deg" };
            let error = SettingsError::new(&axis.name, "this axis moves: `position` says where it stands");
            return Err(error.under([PathItem::Key(setting.to_owned())]));
        }
        let recorded = headers.iter().any(|header| header.name == axis.name);
        if moves || recorded || statuses.contains_key(&axis.status) {
            continue;
        }
        match axis.kind {
            AxisKind::Rotary => drop(statuses.insert(axis.status, 0.0)),
            AxisKind::Linear => {
                let message = format!("it is not said where {} stands", axis.name);
                let help = format!("add `at_mm: {{ {}: .. }}`, or a column `{}_mm` to the data", axis.name, axis.name);
                return Err(SettingsError::new("at_mm", message).help(help));
            }
        }
    }
    if let Some(stylus) = &measurement.stylus {
        let column = model.info().status.iter().enumerate().find(|(_, status)| status.name == "stylus");
        let levels = column.map_or(&[][..], |(_, status)| &status.levels);
        match (column, levels.iter().position(|level| *level == stylus.0)) {
            (Some((status, _)), Some(level)) => drop(statuses.insert(status, level as f64)),
            // The tool itself need not be listed.
            (None, _) if stylus.0 == "1" => {}
            _ => {
                let message = format!("the machine has no stylus {}", stylus.0);
                return Err(SettingsError::new("stylus", message)
                    .help("describe it by `styli: { <number>: { tip_mm: [x, y, z] } }` in the model"));
            }
        }
    }
    Ok(statuses)
}

/// The direction in which a linear axis moves the tip relative to the table; zero for a rotary one.
fn motion(axis: usize, at: &BTreeMap<usize, f64>, model: &dyn KinematicModel) -> Result<Vector3<f64>> {
    if model.info().axes[axis].kind == AxisKind::Rotary {
        return Ok(Vector3::zeros());
    }
    let status: Vec<f64> = (model.info().status.iter().enumerate())
        .map(|(index, status)| match (at.get(&index), status.absent) {
            (Some(value), _) => *value,
            (None, Absent::Default(value)) => value,
            (None, Absent::Required) => 0.0,
        })
        .collect();
    let mut poses = Poses::default();
    model.poses(&status, &model.info().nominal, &[Variable::Command(axis)], false, &mut poses)?;
    Ok(Vector3::from(poses.position_derivatives[0]).try_normalize(1e-9).unwrap_or_else(Vector3::zeros))
}

/// Sensitivities of the reading on every leg.
fn legs(
    measurement: &Measurement,
    moving: &[(usize, Vector3<f64>)],
    model: &dyn KinematicModel,
) -> Result<Vec<Leg>, SettingsError> {
    let said = measurement.direction.as_ref().map(|direction| match direction {
        Direction::Named(Letter::X) => Vector3::x(),
        Direction::Named(Letter::Y) => Vector3::y(),
        Direction::Named(Letter::Z) => Vector3::z(),
        Direction::Vector(vector) => Vector3::from(*vector).normalize(),
    });
    let sign = |axis: Option<usize>| match (measurement.body, axis.map(|axis| model.info().axes[axis].branch)) {
        (Some(Body::Table), _) | (None, Some(Branch::Workpiece)) => -1.0,
        _ => 1.0,
    };
    let leg = |axis: Option<usize>, direction: Vector3<f64>, by_tilt: f64| {
        let sign = sign(axis);
        let named = axis.map(|axis| &model.info().axes[axis]);
        Leg {
            name: named.map_or_else(String::new, |axis| axis.name.clone()),
            command: named.map(|axis| axis.status),
            approach: axis.and_then(|axis| model.info().status_index(&StatusRole::Direction(axis))),
            sensitivity: direction * sign,
            by_tilt: by_tilt * sign,
        }
    };
    let (axis, along) = match *moving {
        [] => return Ok(vec![leg(None, said.unwrap_or_default(), 0.0)]),
        [one] => one,
        [(one, first), (other, second), ..] => {
            if first.norm() == 0.0 || second.norm() == 0.0 || first.dot(&second).abs() > ALONG {
                return Err(SettingsError::new("legs", "two linear axes at right angles were expected"));
            }
            // Turned from its first leg to its second, a block rises along the first and falls along the second.
            return Ok(vec![leg(Some(one), second, -1.0), leg(Some(other), first, 1.0)]);
        }
    };
    let (direction, name) = (said.unwrap_or(along), &model.info().axes[axis].name);
    let cosine = direction.dot(&along).abs();
    let (help, wrong) = match measurement.kind {
        Kind::Displacement => ("a motion across is read as `kind: straightness`", cosine < ALONG),
        Kind::Straightness => ("a motion along is read as `kind: displacement`", cosine > ALONG),
        Kind::Square | Kind::Angle => ("", false),
    };
    if wrong {
        let message = match measurement.kind {
            Kind::Displacement => format!("{name} does not move along this direction: no displacement can be read"),
            _ => format!("{name} moves along this direction: no straightness can be read"),
        };
        return Err(SettingsError::new("direction", message).help(help));
    }
    let by_tilt = if measurement.kind == Kind::Straightness { -1.0 } else { 0.0 };
    Ok(vec![leg(Some(axis), direction, by_tilt)])
}

/// The quantity of a tilt per unit of position.
pub fn of_tilt(model: &dyn KinematicModel, leg: &Leg) -> abbe_core::Unit {
    let commands = leg.command.map_or(Quantity::Length, |status| model.info().status[status].quantity);
    match commands {
        Quantity::Angle => abbe_core::Unit::per(Quantity::Length, Quantity::Angle, 1),
        _ => abbe_core::Unit::RAD,
    }
}
