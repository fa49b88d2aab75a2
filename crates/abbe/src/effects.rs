//! What single errors of a machine do at the tip of its tool, from the model itself.

use std::path::Path;

use abbe_core::{Absent, AxisKind, Error, KinematicModel, ModelInfo, Poses, Registry, Result, StatusRole, Variable};
use abbe_engine::{Described, prepare_text};
use serde_json::{Value, json};

/// A stand of the machine, and where its tip is there without errors.
#[derive(Debug, Clone)]
pub struct Stand {
    /// One value for every column of the status.
    pub status: Vec<f64>,
    /// The tip in the table frame, mm.
    pub tip: [f64; 3],
    /// The tool in the table frame: a unit quaternion w, x, y, z.
    pub turned: [f64; 4],
}

/// What a parameter of one unit (mm, rad, ...) does to the tool as seen from the workpiece, at a stand; first order.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Effect {
    /// How far the tip moves, table frame.
    pub shift: [f64; 3],
    /// How the tool turns: a rotation vector, table frame.
    pub turn: [f64; 3],
}

impl Effect {
    /// The size of the error that one unit of the parameter is, at this stand: that of its turn, else of its shift.
    pub fn size(&self) -> f64 {
        let turn = norm(self.turn);
        if turn > 1e-15 { turn } else { norm(self.shift) }
    }
}

/// Length of a vector.
pub fn norm(of: [f64; 3]) -> f64 {
    of.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// A part of its travel from the middle, so that arms of levers are not zero.
const OF_TRAVEL: f64 = 0.25;

/// Where a linear axis stands whose travel is not known, mm.
const ANYWHERE: f64 = 300.0;

impl Stand {
    /// Linear axes a quarter of their travel beyond its middle, rotary ones at zero, as far as `at` does not say something else.
    ///
    /// Fails for an axis that the machine does not have.
    pub fn new(model: &dyn KinematicModel, at: &[(String, f64)]) -> Result<Self> {
        let info = model.info();
        let mut status: Vec<f64> = info
            .status
            .iter()
            .map(|column| match column.absent {
                // An error that is known from one direction only has no effect where the direction is not known.
                _ if matches!(column.role, StatusRole::Direction(_)) => 1.0,
                Absent::Default(value) => value,
                Absent::Required => 0.0,
            })
            .collect();
        for axis in info.axes.iter().filter(|axis| axis.kind == AxisKind::Linear) {
            let beyond = |[from, to]: [f64; 2]| ((from + to) / 2.0 + OF_TRAVEL * (to - from)).round();
            status[axis.status] = axis.range.map_or(ANYWHERE, beyond);
        }
        for (place, (name, position)) in at.iter().enumerate() {
            if at[..place].iter().any(|(earlier, _)| earlier == name) {
                return Err(Error::usage(format!("the axis {name} is to stand at two positions")));
            }
            let axis = info.axes.iter().find(|axis| axis.name == *name).ok_or_else(|| {
                Error::usage(format!("the machine has no axis {name}"))
                    .suggest(name, info.axes.iter().map(|axis| axis.name.as_str()))
            })?;
            status[axis.status] = if axis.kind == AxisKind::Rotary { position.to_radians() } else { *position };
        }
        Self::of(model, status)
    }

    fn of(model: &dyn KinematicModel, status: Vec<f64>) -> Result<Self> {
        let mut poses = Poses::default();
        model.poses(&status, &model.info().without_errors(), &[], true, &mut poses)?;
        Ok(Self { status, tip: poses.positions[0], turned: poses.orientations[0] })
    }

    /// The positions of the axes, for people: `X 250 mm, C 0°`.
    pub fn text(&self, info: &ModelInfo) -> String {
        let one = |axis: &abbe_core::Axis| match axis.kind {
            AxisKind::Linear => format!("{} {} mm", axis.name, crate::table::plain(self.status[axis.status])),
            AxisKind::Rotary => {
                format!("{} {}°", axis.name, crate::table::plain(self.status[axis.status].to_degrees()))
            }
        };
        info.axes.iter().map(one).collect::<Vec<_>>().join(", ")
    }

    /// What parameters do here.
    pub fn effects(&self, model: &dyn KinematicModel, parameters: &[usize]) -> Result<Vec<Effect>> {
        let wanted: Vec<Variable> = parameters.iter().map(|index| Variable::Parameter(*index)).collect();
        let mut poses = Poses::default();
        model.poses(&self.status, &model.info().without_errors(), &wanted, true, &mut poses)?;
        let both = poses.position_derivatives.iter().zip(&poses.rotation_derivatives);
        Ok(both.map(|(shift, turn)| Effect { shift: *shift, turn: *turn }).collect())
    }

    /// The same stand of the same machine with other errors, whose status may have other columns.
    pub fn in_model(&self, model: &dyn KinematicModel) -> Result<Self> {
        let mut status = Self::new(model, &[])?.status;
        // The axes are the same, in the same columns.
        model.info().axes.iter().for_each(|axis| status[axis.status] = self.status[axis.status]);
        Self::of(model, status)
    }

    /// The same machine with one value of its status changed.
    pub fn with(&self, model: &dyn KinematicModel, column: usize, value: f64) -> Result<Self> {
        let mut status = self.status.clone();
        status[column] = value;
        Self::of(model, status)
    }
}

/// A machine with other errors: `errors` as it stands in a machine file. None for a model that has no list of errors.
pub fn with_errors(machine: &Described, errors: &Value, registry: &Registry) -> Result<Option<Described>> {
    let mut settings = machine.model.info().settings.clone();
    let Some(own) = settings.as_object_mut().filter(|_| machine.locations.is_some()) else { return Ok(None) };
    own.insert("errors".to_owned(), errors.clone());
    own.shift_remove("bodies");
    own.insert("model".to_owned(), Value::from(machine.plugin.as_str()));
    let recipe = json!({ "abbe": 1, "name": "A machine", "stages": { "machine": settings } });
    let made = prepare_text(Path::new("machine.yaml"), &recipe.to_string(), registry);
    // The recipe was made here: its lines say nothing.
    let made = made.map_err(|error| Error { place: None, stage: None, ..error })?;
    Ok(made.described()?.into_iter().next())
}

/// A number for people: three digits, without a minus sign before zero.
pub fn digits(value: f64) -> String {
    if value.abs() < 5e-4 {
        return "0".to_owned();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).clamp(0, 3) as usize;
    let text = format!("{value:.decimals$}");
    let short = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

/// Three numbers in brackets.
pub fn vector(of: [f64; 3]) -> String {
    format!("({})", of.map(digits).join(", "))
}
