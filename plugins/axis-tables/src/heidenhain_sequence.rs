//! The kinematics of a machine as a sequence of transformations from the tool to the table (KinematicsComp of Heidenhain), with the
//! errors of each axis before it.
//!
//! A place of the tool goes through the sequence and comes out in the table frame. Each entry moves it: `Trans` by a number,
//! `MachAxis` by the command of an axis. The nominal entries are moves to the points of rotary axes.

use abbe_compensation::rigid::{Errors, Joint, Machine, Part, Six};
use abbe_core::{AxisKind, Branch, Calibration, CommandCorrection, KinematicModel, Result};
use abbe_volumetric::position_unit;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::heidenhain::DECIMALS;
use crate::tables::rounded;

/// A displacement as entries X, Y, Z, A, B, C, carried out in this order: mm and degrees, as they are written.
fn entries(displacement: &Isometry3<f64>, frame: &Point3<f64>) -> Six {
    let shift = displacement.rotation.inverse() * (displacement * frame - frame);
    let (a, b, c) = displacement.rotation.euler_angles();
    [shift.x, shift.y, shift.z, a.to_degrees(), b.to_degrees(), c.to_degrees()].map(|value| rounded(value, DECIMALS))
}

/// The displacement of entries.
fn displacement(entries: &Six, frame: &Point3<f64>) -> Isometry3<f64> {
    let [x, y, z, a, b, c] = *entries;
    let there = Translation3::from(frame.coords);
    let turn = UnitQuaternion::from_euler_angles(a.to_radians(), b.to_radians(), c.to_radians());
    there * Isometry3::from_parts(Translation3::identity(), turn) * Translation3::new(x, y, z) * there.inverse()
}

/// An axis in the sequence.
pub struct Element {
    /// Its place among the joints of the machine.
    pub place: usize,
    /// Its letter among those of [`LETTERS`](abbe_compensation::rigid::LETTERS).
    pub letter: usize,
    /// The move of the origin before the errors, mm.
    pub shift: Vector3<f64>,
    /// Origin of the errors, in the table frame with all axes at zero.
    frame: Point3<f64>,
    /// Location errors of a rotary axis: before its error motions on the side of the workpiece, behind the axis on that of the tool.
    pub location: Six,
    /// Location errors that are active in the control already.
    pub present: Six,
    /// Points along the axis, mm or degrees.
    pub points: Vec<f64>,
    /// Errors before the axis at points, without that of its own position.
    pub errors: Vec<Six>,
    /// Errors of its own position at points.
    pub own: Vec<f64>,
    /// How many of the unit of points make one in memory.
    factor: f64,
}

impl Element {
    /// `points` with how many of their unit make one in memory.
    fn new(
        joint: &Joint,
        place: usize,
        (points, factor): (Vec<f64>, f64),
        errors: &Errors<'_>,
        frame: Point3<f64>,
    ) -> Result<Self> {
        let letter = joint.letter()?;
        let located = joint.displaced(&errors.of(place, Part::Location, 0.0)?);
        let is_rotary = joint.kind == AxisKind::Rotary;
        let (before, location) = match (is_rotary, joint.branch) {
            (false, _) => (located, Isometry3::identity()),
            (true, Branch::Tool) => (Isometry3::identity(), located),
            (true, Branch::Workpiece) => (Isometry3::identity(), located.inverse()),
        };
        let (mut six, mut own) = (Vec::new(), Vec::new());
        for point in &points {
            let command = point / factor;
            let body = before * joint.displaced(&errors.of(place, Part::Motion, command)?);
            let motion = joint.motion(command);
            let displaced = match joint.branch {
                Branch::Tool => motion.inverse() * body * motion,
                Branch::Workpiece => body.inverse(),
            };
            let mut all = entries(&displaced, &frame);
            own.push(std::mem::take(&mut all[letter]));
            six.push(all);
        }
        let location = entries(&location, &frame);
        Ok(Self {
            place,
            letter,
            shift: Vector3::zeros(),
            frame,
            location,
            present: [0.0; 6],
            points,
            errors: six,
            own,
            factor,
        })
    }

    /// Position in the table, mm or degrees: the point before and the part of the way to the next one; ends beyond them.
    fn between(&self, command: f64) -> (usize, f64) {
        let position = command * self.factor;
        let last = self.points.len().saturating_sub(2);
        let before = self.points.partition_point(|point| *point <= position).saturating_sub(1).min(last);
        let part = (position - self.points[before]) / (self.points[before + 1] - self.points[before]);
        (before, part.clamp(0.0, 1.0))
    }

    /// Errors before the axis at a command, mm and degrees.
    fn at(&self, command: f64) -> Six {
        let (before, part) = self.between(command);
        std::array::from_fn(|six| (1.0 - part) * self.errors[before][six] + part * self.errors[before + 1][six])
    }

    /// The error of its own position at a command, in memory.
    fn own_at(&self, command: f64) -> f64 {
        let (before, part) = self.between(command);
        ((1.0 - part) * self.own[before] + part * self.own[before + 1]) / self.factor
    }

    /// The displacement of the body that the axis carries.
    fn displaced(&self, joint: &Joint, command: f64) -> Isometry3<f64> {
        let before = displacement(&self.at(command), &self.frame);
        let located = displacement(&self.location, &self.frame);
        let motion = joint.motion(command);
        match joint.branch {
            Branch::Tool => located * motion * before * motion.inverse(),
            Branch::Workpiece => located.inverse() * before.inverse(),
        }
    }
}

/// The axes from the tool to the table.
pub struct Sequence {
    pub machine: Machine,
    pub elements: Vec<Element>,
    /// The last move, to the origin of the table frame, mm.
    pub to_table: Vector3<f64>,
    /// Values of a status.
    width: usize,
}

impl Sequence {
    /// `tool_length`: from the tip to the reference point of tools, mm. `points`: those of a joint, mm or degrees.
    pub fn new(
        calibration: &Calibration,
        model: &dyn KinematicModel,
        tool_length: f64,
        points: impl Fn(&Joint) -> Result<Vec<f64>>,
    ) -> Result<Self> {
        let machine = Machine::new(model)?;
        let mut order = machine.branch(Branch::Tool);
        order.reverse();
        order.extend(machine.branch(Branch::Workpiece));
        let errors = Errors::new(model, &machine, calibration);
        let mut origin = machine.tip + machine.tool * tool_length;
        let mut elements = Vec::new();
        for place in order {
            let joint = &machine.joints[place];
            let frame = if joint.kind == AxisKind::Rotary { joint.point } else { origin };
            let (_, factor) = position_unit(&model.info().axes[joint.axis]);
            let mut element = Element::new(joint, place, (points(joint)?, factor), &errors, frame)?;
            element.shift = (origin - frame).map(|value| rounded(value, DECIMALS));
            origin = frame;
            elements.push(element);
        }
        let to_table = origin.coords.map(|value| rounded(value, DECIMALS));
        Ok(Self { machine, elements, to_table, width: model.info().status.len().max(1) })
    }
}

/// The control brings the tip where its sequence says, by its linear axes; then each axis corrects its own position.
impl CommandCorrection for Sequence {
    fn commands(&self, programmed: &[f64]) -> Result<Vec<f64>> {
        let displaced = |place: usize, command: f64| {
            let element = self.elements.iter().find(|element| element.place == place);
            element.map_or_else(Isometry3::identity, |element| element.displaced(&self.machine.joints[place], command))
        };
        let mut all = Vec::with_capacity(programmed.len());
        for (point, status) in programmed.chunks(self.width).enumerate() {
            let mut status = self.machine.corrected(status, &displaced).map_err(|error| error.at_pose(point))?;
            for element in &self.elements {
                let column = self.machine.joints[element.place].status;
                status[column] -= element.own_at(status[column]);
            }
            all.extend(status);
        }
        Ok(all)
    }
}
