//! The effect of one error at a time on a sphere that the machine measures by its nominal model (Rahman 2016, Table 6-1).

use std::collections::BTreeMap;

use abbe_core::{AxisKind, Error, KinematicModel, PathItem, Poses, Result, SettingsError, Variable, matches};
use nalgebra::{Matrix3, Vector3};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::figures::suffix;
use crate::sphere_touches::{Touches, tips};

/// Newton's iteration converges quadratically, and distances are almost linear along the approach: it needs three steps.
const STEPS: usize = 20;

/// Largest distance from the sphere that counts as contact, mm, and as part of coordinates.
const TOLERANCE: (f64, f64) = (1e-11, 1e-14);

/// An approach that brings the tip nearer by less than this, mm/mm, does not reach the sphere.
const GRAZING: f64 = 1e-3;

/// The errors that are set, one at a time, and their values.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct Sensitivity {
    /// Names or patterns of parameters of the model; each is set alone.
    parameters: Vec<String>,
    /// The value of the errors, for each usual unit of parameters: `um`, `urad`, `um_per_m`, ...
    #[serde(flatten)]
    values: BTreeMap<String, f64>,
}

/// A parameter that is set alone.
pub struct SingleError {
    /// Its name.
    pub name: String,
    /// Its index among the parameters of the model.
    index: usize,
    /// Its value in the unit of memory.
    value: f64,
}

/// A programme of perfect touches on one sphere.
pub struct Programme<'a> {
    model: &'a dyn KinematicModel,
    /// Commands of the linear axes, and their indices in a status.
    commands: Vec<Variable>,
    places: Vec<usize>,
    /// Statuses on the approaches.
    statuses: Vec<f64>,
    /// For every touch the direction in which the linear axes retract from the sphere, mm per mm of the tip.
    retraction: Vec<Vec<f64>>,
    /// Centre of the sphere in the table frame, and distance of the tip from it at contact, mm.
    centre: Vector3<f64>,
    reach: f64,
}

impl Sensitivity {
    /// Refuses settings that are wrong for every model.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.parameters.is_empty() {
            return Err(SettingsError::new("parameters", "at least one name was expected"));
        }
        if self.values.is_empty() {
            return Err(SettingsError::new("", "a value for each unit was expected").help("e.g. `um: 1, urad: 2.5`"));
        }
        match self.values.iter().find(|(_, value)| **value == 0.0 || !value.is_finite()) {
            Some((unit, value)) => {
                Err(SettingsError::new(unit, format!("{value}: a number other than zero was expected")))
            }
            None => Ok(()),
        }
    }

    /// The errors, in the order of the model's parameters.
    ///
    /// Fails for a name that matches no parameter, a parameter for whose unit there is no value and a value that no parameter
    /// takes.
    pub fn errors(&self, model: &dyn KinematicModel) -> Result<Vec<SingleError>> {
        let parameters = &model.info().parameters;
        for (index, pattern) in self.parameters.iter().enumerate() {
            if !parameters.iter().any(|parameter| matches(pattern, &parameter.name)) {
                let names = parameters.iter().map(|parameter| parameter.name.as_str());
                let mut error =
                    Error::usage(format!("`{pattern}` matches no parameter of the model")).suggest(pattern, names);
                error.setting = vec![PathItem::Key("parameters".to_owned()), PathItem::Index(index)];
                return Err(error);
            }
        }
        let mut unused: Vec<&String> = self.values.keys().collect();
        let mut errors = Vec::new();
        for (index, parameter) in parameters.iter().enumerate() {
            let name = &parameter.name;
            if !self.parameters.iter().any(|pattern| matches(pattern, name)) {
                continue;
            }
            let (symbol, factor) = parameter.unit.for_people();
            let unit = suffix(&symbol).trim_start_matches('_').to_owned();
            let value = self.values.get(&unit).ok_or_else(|| {
                Error::usage(format!("`{name}` is in {symbol}, for which there is no value"))
                    .help(format!("e.g. `{unit}: 1`"))
            })?;
            unused.retain(|other| **other != unit);
            errors.push(SingleError { name: name.clone(), index, value: value / factor });
        }
        match unused.first() {
            Some(unit) => Err(Error::usage(format!("none of these parameters is in `{unit}`")).setting(unit.as_str())),
            None => Ok(errors),
        }
    }
}

impl<'a> Programme<'a> {
    /// Touches on the nominal sphere, approached along the same lines as the measured touches. These were programmed on the
    /// nominal model, along lines through the centre, so that the nominal model gives the lines. If the nominal sphere is not
    /// known, the sphere that the nominal model measured is used.
    pub fn of(touches: &Touches, model: &'a dyn KinematicModel) -> Result<Self> {
        let axes = model.info().axes.iter().enumerate().filter(|(_, axis)| axis.kind == AxisKind::Linear);
        let (commands, places): (Vec<Variable>, Vec<usize>) =
            axes.map(|(index, axis)| (Variable::Command(index), axis.status)).unzip();
        let mut poses = Poses::default();
        let nominal = &model.info().nominal;
        model.poses(&touches.statuses, nominal, &commands, false, &mut poses)?;
        let tips: Vec<Vector3<f64>> = poses.positions.iter().map(|tip| Vector3::from(*tip)).collect();
        let measured = touches.through(&tips)?.shape;
        let centre = touches.centre.unwrap_or(measured.centre);
        let retraction = tips.iter().enumerate().map(|(index, tip)| {
            let derivatives = &poses.position_derivatives[index * commands.len()..(index + 1) * commands.len()];
            smallest_step(derivatives, &(tip - centre).normalize()).ok_or_else(unreachable)
        });
        Ok(Self {
            model,
            retraction: retraction.collect::<Result<_>>()?,
            statuses: touches.statuses.clone(),
            centre,
            reach: touches.reach.unwrap_or(measured.radius),
            commands,
            places,
        })
    }

    /// The tips by the nominal model if the machine has this error.
    pub fn measured_with(&self, error: &SingleError) -> Result<Vec<Vector3<f64>>> {
        let nominal = &self.model.info().nominal;
        let mut real = nominal.clone();
        real[error.index] = error.value;
        tips(self.model, &self.touched(&real)?, nominal)
    }

    /// The statuses in which the tips of a machine with these values touch the sphere.
    fn touched(&self, values: &[f64]) -> Result<Vec<f64>> {
        let width = self.model.info().status.len();
        let count = self.commands.len();
        let (mut statuses, mut poses) = (self.statuses.clone(), Poses::default());
        for _ in 0..STEPS {
            self.model.poses(&statuses, values, &self.commands, false, &mut poses)?;
            let mut all = true;
            for (index, (status, retraction)) in statuses.chunks_exact_mut(width).zip(&self.retraction).enumerate() {
                let from_centre = Vector3::from(poses.positions[index]) - self.centre;
                let distance = from_centre.norm() - self.reach;
                let coordinates = poses.positions[index].iter().fold(0.0_f64, |size, value| size.max(value.abs()));
                all &= distance.abs() <= TOLERANCE.0.max(TOLERANCE.1 * coordinates);
                let derivatives = &poses.position_derivatives[index * count..(index + 1) * count];
                let moved = derivatives.iter().zip(retraction).map(|(by, step)| Vector3::from(*by) * *step);
                let slope = from_centre.normalize().dot(&moved.sum());
                if slope.is_nan() || slope < GRAZING {
                    return Err(unreachable());
                }
                let way = -distance / slope;
                self.places.iter().zip(retraction).for_each(|(&place, step)| status[place] += way * step);
            }
            if all {
                return Ok(statuses);
            }
        }
        Err(unreachable())
    }
}

fn unreachable() -> Error {
    Error::data("the linear axes cannot bring the tip to the sphere along its approach")
}

/// The smallest step of the commands that moves the tip by this much; None if none does.
fn smallest_step(derivatives: &[[f64; 3]], missing: &Vector3<f64>) -> Option<Vec<f64>> {
    let columns = || derivatives.iter().map(|derivative| Vector3::from(*derivative));
    let effect: Matrix3<f64> = columns().map(|column| column * column.transpose()).sum();
    let weights = effect.cholesky()?.solve(missing);
    Some(columns().map(|column| column.dot(&weights)).collect())
}
