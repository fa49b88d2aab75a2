//! Reversal of joints: what the direction of the last move changes along a joint's own axis. Kinematics know no directions, so a
//! compensation file of each joint has it.

use abbe_core::{AxisKind, Error, KinematicModel, Result, StatusRole};
use abbe_volumetric::{Ranges, range_of};

use crate::joints::{Joint, known};

/// Trims of a joint at both ends of its travel: position, forward, reverse, in mm or degrees as in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct Reversal {
    rows: [[f64; 3]; 2],
}

/// The digits of the file, mm or degrees.
const DIGIT: f64 = 1e-7;

/// Largest curve of a reversal along its axis that a line may stand for, mm or rad.
const STRAIGHT: f64 = 1e-7;

impl Reversal {
    /// The reversal of a joint; none if it has none.
    ///
    /// Fails where the reversal along the axis is no straight line, or the range of an axis with a reversal is not known.
    pub fn new(
        model: &dyn KinematicModel,
        values: &[f64],
        joints: &[Joint],
        joint: &Joint,
        ranges: &Ranges,
    ) -> Result<Option<Self>> {
        let axis = &model.info().axes[joint.axis];
        let Some(direction_column) = model.info().status_index(&StatusRole::Direction(joint.axis)) else {
            return Ok(None);
        };
        let (from, to) = range_of(axis, ranges, "ranges")?;
        let trim = |position: f64| -> Result<[f64; 2]> {
            let mut status = known(model, joints, &vec![0.0; model.info().status.len()]);
            status[joint.status] = position / joint.factor;
            let mut at = |direction: f64| -> Result<f64> {
                status[direction_column] = direction;
                along(model, values, joint, &status)
            };
            let middle = at(0.0)?;
            Ok([at(1.0)? - middle, at(-1.0)? - middle].map(|error| -axis.sense * error * joint.factor))
        };
        let (first, last) = (trim(from)?, trim(to)?);
        for part in [0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875] {
            let found = trim(from + part * (to - from))?;
            let off = (0..2).map(|side| found[side] - first[side] - part * (last[side] - first[side]));
            if off.fold(0.0, |most: f64, off| most.max(off.abs())) > STRAIGHT * joint.factor {
                let message = format!("the reversal of {} changes along it in a curve", axis.name);
                return Err(Error::usage(message).help("estimate it without `degrees`, or with degree 1 alone"));
            }
        }
        let row = |position: f64, trims: [f64; 2]| [position, trims[0], trims[1]].map(|x| (x / DIGIT).round() * DIGIT);
        let rows = [row(from, first), row(to, last)];
        let is_there = rows.iter().any(|row| row[1] != 0.0 || row[2] != 0.0);
        Ok(is_there.then_some(Self { rows }))
    }

    /// The trim at a command, mm or degrees; that of an end beyond it.
    pub fn trim(&self, command: f64, direction: f64) -> f64 {
        let [from, to] = self.rows;
        let part = ((command - from[0]) / (to[0] - from[0])).clamp(0.0, 1.0);
        let column = match direction {
            forward if forward > 0.0 => 1,
            reverse if reverse < 0.0 => 2,
            _ => return 0.0,
        };
        from[column] + part * (to[column] - from[column])
    }

    /// The file, with trims (`COMP_FILE_TYPE = 1`).
    pub fn text(&self) -> String {
        self.rows
            .iter()
            .map(|[position, forward, reverse]| format!("{position:.7} {forward:.7} {reverse:.7}\n"))
            .collect()
    }
}

/// The error along (about) the own direction of a joint.
fn along(model: &dyn KinematicModel, values: &[f64], joint: &Joint, status: &[f64]) -> Result<f64> {
    let info = model.info();
    let first = if joint.kind == AxisKind::Linear { 0 } else { 3 };
    let mut error = 0.0;
    for function in info.error_functions.iter().filter(|function| function.axis == joint.axis) {
        let component = function.component.checked_sub(first);
        if let Some(part) = component.and_then(|component| info.axes[joint.axis].direction.get(component)) {
            error += part * model.motion_error(function, values, status)?.value;
        }
    }
    Ok(error)
}
