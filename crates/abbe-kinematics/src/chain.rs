//! The structural loop as transforms.
//!
//! Both branches are evaluated from the bed. The transform of axis k from the frame before it is
//! `S_k E(location) J_k(q) E(motion)` (error frame moving) or `S_k E(location) E(motion) J_k(q)` (fixed), with
//! `E(ex, ey, ez, ea, eb, ec) = [Rz(ec) Ry(eb) Rx(ea) | (ex, ey, ez)]`. The tip seen from the table is
//! `p = T_workpiece^-1 T_tool tip`.

use abbe_core::{AxisKind, Branch};
use nalgebra::{Matrix3, Matrix6, Rotation3, Unit, UnitQuaternion, Vector3, Vector6};

/// Where the motion errors of an axis act.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ErrorFrame {
    /// In the frame that moves with the axis.
    #[default]
    Moving,
    /// In the frame at its zero position.
    Fixed,
}

/// The six errors of a location, a motion or a set-up: ex, ey, ez in mm, ea, eb, ec in rad.
pub type Errors = [f64; 6];

/// An axis with its nominal geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainAxis {
    /// Name.
    pub name: String,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Side of the bed.
    pub branch: Branch,
    /// Unit direction in the machine frame, all axes at zero.
    pub direction: Vector3<f64>,
    /// A point of the line of a rotary axis, machine coordinates with all axes at zero, mm.
    pub point: Vector3<f64>,
    /// A positive command moves the body the other way.
    pub reverse: bool,
    /// Where its motion errors act.
    pub error_frame: ErrorFrame,
}

impl ChainAxis {
    /// +1 or -1: the sense in which the carried body moves along (about) `direction` for a positive command.
    ///
    /// A positive command moves the tool positively relative to the workpiece (ISO 841), so the body that an axis of the
    /// workpiece branch carries moves in the opposite direction.
    pub fn sense(&self) -> f64 {
        let by_branch = if self.branch == Branch::Tool { 1.0 } else { -1.0 };
        if self.reverse { -by_branch } else { by_branch }
    }
}

/// A serial chain from workpiece to tool.
///
/// Errors act in slots: slot `2 k` is the location, slot `2 k + 1` the motion of axis k (in the order of
/// [`axes`](Self::axes)), then come the workpiece set-up and the tool set-up, see
/// [`workpiece_slot`](Self::workpiece_slot) and [`tool_slot`](Self::tool_slot).
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    axes: Vec<ChainAxis>,
    /// Indices from the bed outwards.
    workpiece: Vec<usize>,
    tool: Vec<usize>,
}

/// Where an error acts: the frame just before it, bed coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Slot {
    /// Directions of the three translations.
    frame: Directions,
    /// The axes of the rotations ea and eb, which act in sequence; the axis of ec is the third direction of `frame`.
    about: [Vector3<f64>; 2],
    /// The point that the rotations turn about.
    origin: Vector3<f64>,
    /// +1 on the tool branch, -1 on the workpiece branch.
    sign: f64,
}

impl Default for Slot {
    fn default() -> Self {
        Self { frame: Directions::SAME, about: [Vector3::zeros(); 2], origin: Vector3::zeros(), sign: 1.0 }
    }
}

/// Which derivatives of a pose are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Derivatives<'a> {
    /// None: the pose alone.
    None,
    /// Those of the position to the commands and to the errors of these slots (one entry a slot).
    OfPosition(&'a [bool]),
    /// Those of position and rotation to the commands and to the errors of these slots.
    OfPositionAndRotation(&'a [bool]),
}

/// Pose of the tool relative to the table, and its derivatives to errors and commands.
#[derive(Debug, Clone, Default)]
pub struct Evaluation {
    /// Tip in the table frame, mm.
    pub position: Vector3<f64>,
    /// Rotation from the tool frame to the table frame.
    pub rotation: Matrix3<f64>,
    /// d(position)/d(error) of every slot, zero where they are not wanted; empty if none are.
    pub by_error: Vec<[Vector3<f64>; 6]>,
    /// d(rotation vector, table frame)/d(error) of every slot.
    pub turn_by_error: Vec<[Vector3<f64>; 6]>,
    /// d(position)/d(command) of every axis, its motion errors held.
    pub by_command: Vec<Vector3<f64>>,
    /// d(rotation vector)/d(command) of every axis.
    pub turn_by_command: Vec<Vector3<f64>>,
    /// Where errors act; empty if no derivatives are wanted.
    slots: Vec<Slot>,
    /// The motion of every axis.
    motions: Vec<Motion>,
    /// The last turn of every rotary axis: poses of a run have many turns in common.
    turns: Vec<Turn>,
}

/// The motion of an axis per unit of its command, bed coordinates.
#[derive(Debug, Clone, Default)]
struct Motion {
    direction: Vector3<f64>,
    /// The point that it turns about.
    origin: Vector3<f64>,
}

/// A turn about a direction of a frame.
#[derive(Debug, Clone)]
struct Turn {
    /// Direction times angle.
    vector: Vector3<f64>,
    /// Where it turns the directions of the frame.
    turned: Directions,
}

impl Default for Turn {
    fn default() -> Self {
        Self { vector: Vector3::zeros(), turned: Directions::SAME }
    }
}

impl Turn {
    /// Makes it the turn about a unit direction.
    fn become_of(&mut self, direction: &Vector3<f64>, angle: f64) {
        let vector = direction * angle;
        if vector != self.vector {
            let turn = Rotation3::from_axis_angle(&Unit::new_unchecked(*direction), angle);
            let turned = [0, 1, 2].map(|column| turn.matrix().column(column).into_owned());
            *self = Self { vector, turned: Directions(turned) };
        }
    }
}

impl Evaluation {
    /// Orientation as a unit quaternion w, x, y, z.
    pub fn quaternion(&self) -> [f64; 4] {
        let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        [quaternion.w, quaternion.i, quaternion.j, quaternion.k]
    }

    /// Computes the derivatives from the recorded slots and motions; `table` and `tip` are the table's directions and the
    /// tip, bed coordinates.
    fn differentiate(&mut self, axes: &[ChainAxis], (table, tip): (Directions, Vector3<f64>), wanted: Derivatives<'_>) {
        let (slots, turns): (&[bool], bool) = match wanted {
            Derivatives::None => (&[], false),
            Derivatives::OfPosition(slots) => (slots, false),
            Derivatives::OfPositionAndRotation(slots) => (slots, true),
        };
        let still = Vector3::zeros();
        self.by_error.resize(slots.len(), [still; 6]);
        self.turn_by_error.resize(if turns { slots.len() } else { 0 }, [still; 6]);
        self.by_command.clear();
        self.turn_by_command.clear();
        if wanted == Derivatives::None {
            return;
        }
        for (index, Slot { frame: Directions([x, y, z]), about: [a, b], origin, sign }) in self.slots.iter().enumerate()
        {
            let seen = |vector: &Vector3<f64>| table.inwards(vector) * *sign;
            let lever = tip - origin;
            let turned = |axis: &Vector3<f64>| seen(&axis.cross(&lever));
            // Values of the evaluation before are overwritten, also for slots that are not wanted.
            self.by_error[index] = match slots[index] {
                true => [seen(x), seen(y), seen(z), turned(a), turned(b), turned(z)],
                false => [still; 6],
            };
            if turns {
                self.turn_by_error[index] = match slots[index] {
                    true => [still, still, still, seen(a), seen(b), seen(z)],
                    false => [still; 6],
                };
            }
        }
        for (axis, Motion { direction, origin }) in axes.iter().zip(&self.motions) {
            let sign = if axis.branch == Branch::Tool { 1.0 } else { -1.0 };
            let seen = |vector: &Vector3<f64>| table.inwards(vector) * sign;
            let (shift, turn) = match axis.kind {
                AxisKind::Linear => (seen(direction), still),
                AxisKind::Rotary => (seen(&direction.cross(&(tip - origin))), seen(direction)),
            };
            self.by_command.push(shift);
            self.turn_by_command.push(turn);
        }
    }
}

/// The directions of a frame's axes in another frame: a rotation. Its products are written out, because they take most of the
/// time of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Directions([Vector3<f64>; 3]);

impl Directions {
    const SAME: Self = Self([Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)]);

    /// A vector of the frame, in the other one.
    fn outwards(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        let [x, y, z] = &self.0;
        x * vector.x + y * vector.y + z * vector.z
    }

    /// A vector of the other frame, in this one.
    fn inwards(&self, vector: &Vector3<f64>) -> Vector3<f64> {
        let [x, y, z] = &self.0;
        Vector3::new(x.dot(vector), y.dot(vector), z.dot(vector))
    }
}

/// The current frame on the way from the bed outwards, bed coordinates.
struct Frame {
    directions: Directions,
    origin: Vector3<f64>,
    /// Nominal position of the frame with all axes at zero.
    nominal: Vector3<f64>,
    sign: f64,
}

impl Frame {
    fn bed(sign: f64) -> Self {
        Self { directions: Directions::SAME, origin: Vector3::zeros(), nominal: Vector3::zeros(), sign }
    }

    /// Applies errors to the frame, and records the slot where they act if that is wanted.
    fn err(&mut self, errors: &Errors, slot: Option<&mut Slot>) {
        let [x, y, z] = self.directions.0;
        if errors[..3] != [0.0; 3] {
            self.origin += self.directions.outwards(&Vector3::new(errors[0], errors[1], errors[2]));
        }
        let mut about = [x, y];
        let frame = self.directions;
        if errors[3..] != [0.0; 3] {
            let ((sin_a, cos_a), (sin_b, cos_b), (sin_c, cos_c)) =
                (sin_cos(errors[3]), sin_cos(errors[4]), sin_cos(errors[5]));
            // The frame after Rz, then after Ry, then after Rx; each step turns two of its axes.
            let (about_z_x, about_z_y) = (x * cos_c + y * sin_c, y * cos_c - x * sin_c);
            let (about_y_x, about_y_z) = (about_z_x * cos_b - z * sin_b, z * cos_b + about_z_x * sin_b);
            let (about_x_y, about_x_z) = (about_z_y * cos_a + about_y_z * sin_a, about_y_z * cos_a - about_z_y * sin_a);
            about = [about_y_x, about_z_y];
            self.directions = Directions([about_y_x, about_x_y, about_x_z]);
        }
        if let Some(slot) = slot {
            // Field by field, because assigning a whole slot would copy it.
            (slot.frame, slot.about, slot.origin, slot.sign) = (frame, about, self.origin, self.sign);
        }
    }

    /// Applies a command to the frame, and records the motion. `turn` is the last one of this axis.
    fn command(&mut self, axis: &ChainAxis, command: f64, turn: &mut Turn, motion: &mut Motion) {
        motion.direction = self.directions.outwards(&axis.direction) * axis.sense();
        match axis.kind {
            AxisKind::Linear => self.origin += motion.direction * command,
            AxisKind::Rotary => {
                turn.become_of(&axis.direction, axis.sense() * command);
                // A spindle stands still as a rule.
                if turn.turned != Directions::SAME {
                    self.directions = Directions(turn.turned.0.map(|direction| self.directions.outwards(&direction)));
                }
            }
        }
        motion.origin = self.origin;
    }
}

/// Sine and cosine of an angle that is usually small. Up to 0.01 rad, power series are used, which are exact in double
/// precision.
fn sin_cos(angle: f64) -> (f64, f64) {
    if angle.abs() > 0.01 {
        return angle.sin_cos();
    }
    let square = angle * angle;
    let sin = angle - angle * square * (1.0 / 6.0) * (1.0 - square * (1.0 / 20.0) * (1.0 - square * (1.0 / 42.0)));
    let cos = 1.0 - square * 0.5 * (1.0 - square * (1.0 / 12.0) * (1.0 - square * (1.0 / 30.0)));
    (sin, cos)
}

impl Chain {
    /// A chain of axes in the order of the notation, from workpiece to tool. Directions are normalised.
    pub fn new(mut axes: Vec<ChainAxis>) -> Self {
        for axis in &mut axes {
            axis.direction.normalize_mut();
        }
        let on = |branch| move |(index, axis): (usize, &ChainAxis)| (axis.branch == branch).then_some(index);
        let workpiece = axes.iter().enumerate().rev().filter_map(on(Branch::Workpiece)).collect();
        let tool = axes.iter().enumerate().filter_map(on(Branch::Tool)).collect();
        Self { axes, workpiece, tool }
    }

    /// The axes, in the order of the notation.
    pub fn axes(&self) -> &[ChainAxis] {
        &self.axes
    }

    /// Number of slots.
    pub fn slots(&self) -> usize {
        2 * self.axes.len() + 2
    }

    /// Slot of the location errors of an axis.
    pub fn location_slot(&self, axis: usize) -> usize {
        2 * axis
    }

    /// Slot of the motion errors of an axis.
    pub fn motion_slot(&self, axis: usize) -> usize {
        2 * axis + 1
    }

    /// Slot of the workpiece set-up errors, at the last frame of the workpiece branch.
    pub fn workpiece_slot(&self) -> usize {
        2 * self.axes.len()
    }

    /// Slot of the tool set-up errors, at the tip in the last frame of the tool branch: rotations do not move the tip.
    pub fn tool_slot(&self) -> usize {
        2 * self.axes.len() + 1
    }

    /// Walks one branch from the bed outwards.
    fn walk(&self, branch: &[usize], frame: &mut Frame, commands: &[f64], errors: &[Errors], out: &mut Evaluation) {
        for &index in branch {
            let axis = &self.axes[index];
            if axis.kind == AxisKind::Rotary {
                frame.origin += frame.directions.outwards(&(axis.point - frame.nominal));
                frame.nominal = axis.point;
            }
            let (location, motion) = (self.location_slot(index), self.motion_slot(index));
            frame.err(&errors[location], out.slots.get_mut(location));
            match axis.error_frame {
                ErrorFrame::Moving => {
                    frame.command(axis, commands[index], &mut out.turns[index], &mut out.motions[index]);
                    frame.err(&errors[motion], out.slots.get_mut(motion));
                }
                ErrorFrame::Fixed => {
                    frame.err(&errors[motion], out.slots.get_mut(motion));
                    frame.command(axis, commands[index], &mut out.turns[index], &mut out.motions[index]);
                }
            }
        }
    }

    /// The exact pose at `commands` (mm or rad, one an axis) under `errors` (one entry a slot) with `derivatives` at
    /// these errors. `tip` is the nominal tip in the last frame of the tool branch, mm.
    pub fn evaluate(
        &self,
        commands: &[f64],
        errors: &[Errors],
        tip: &Vector3<f64>,
        derivatives: Derivatives<'_>,
        out: &mut Evaluation,
    ) {
        let recorded = if derivatives == Derivatives::None { 0 } else { self.slots() };
        out.slots.resize(recorded, Slot::default());
        out.motions.resize(self.axes.len(), Motion::default());
        out.turns.resize(self.axes.len(), Turn::default());
        let mut workpiece = Frame::bed(-1.0);
        self.walk(&self.workpiece, &mut workpiece, commands, errors, out);
        workpiece.err(&errors[self.workpiece_slot()], out.slots.get_mut(self.workpiece_slot()));
        let mut tool = Frame::bed(1.0);
        self.walk(&self.tool, &mut tool, commands, errors, out);
        tool.origin += tool.directions.outwards(tip);
        tool.err(&errors[self.tool_slot()], out.slots.get_mut(self.tool_slot()));

        let table = workpiece.directions;
        out.position = table.inwards(&(tool.origin - workpiece.origin));
        out.rotation = Matrix3::from_columns(&tool.directions.0.map(|direction| table.inwards(&direction)));
        out.differentiate(&self.axes, (table, tool.origin), derivatives);
    }

    /// Position of the tip to first order in the errors: the nominal position plus the sum of each error times its
    /// 6 x 6 matrix (Soons 1993, eq. 2.24 to 2.28), carried from the tool frame into the table frame.
    ///
    /// The difference to [`evaluate`](Self::evaluate) is the linearisation error; it decreases with the square of the errors.
    pub fn first_order(&self, commands: &[f64], errors: &[Errors], tip: &Vector3<f64>) -> Vector3<f64> {
        let mut nominal = Evaluation::default();
        let recorded = vec![false; self.slots()];
        let of = Derivatives::OfPosition(&recorded);
        self.evaluate(commands, &vec![[0.0; 6]; self.slots()], tip, of, &mut nominal);
        let tool = nominal.slots[self.tool_slot()];
        let frame_of = |slot: &Slot| Matrix3::from_columns(&slot.frame.0);
        let to_tool = frame_of(&tool).transpose();
        let mut sum = Vector6::zeros();
        for (slot, errors) in nominal.slots.iter().zip(errors) {
            let frame = frame_of(slot);
            let rotation = to_tool * frame;
            let arm = rotation.transpose() * to_tool * (tool.origin - slot.origin);
            // eq. 2.27: rotations (first three) act on the position through their arm, translations directly.
            let mut propagation = Matrix6::zeros();
            propagation.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
            propagation.fixed_view_mut::<3, 3>(3, 0).copy_from(&(rotation * arm.cross_matrix().transpose()));
            propagation.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
            let [x, y, z, a, b, c] = *errors;
            sum += propagation * Vector6::new(a, b, c, x, y, z) * slot.sign;
        }
        nominal.position + nominal.rotation * sum.fixed_rows::<3>(3)
    }

    /// The pose to first order in the errors, with the derivatives of this first-order pose. It replaces
    /// [`evaluate`](Self::evaluate) to determine the linearisation error.
    ///
    /// The position is that of [`first_order`](Self::first_order); the rotation vector of the tool is the sum of those of the
    /// single errors.
    pub fn evaluate_first_order(&self, commands: &[f64], errors: &[Errors], tip: &Vector3<f64>, out: &mut Evaluation) {
        self.evaluate(
            commands,
            &vec![[0.0; 6]; self.slots()],
            tip,
            Derivatives::OfPositionAndRotation(&vec![true; self.slots()]),
            out,
        );
        let (mut shift, mut turn) = (Vector3::zeros(), Vector3::zeros());
        let mut by_command = vec![(Vector3::zeros(), Vector3::zeros()); self.axes.len()];
        for (slot, errors) in errors.iter().enumerate() {
            for (component, &error) in errors.iter().enumerate().filter(|(_, error)| **error != 0.0) {
                let by_error = out.by_error[slot][component] * error;
                let turn_by_error = out.turn_by_error[slot][component] * error;
                shift += by_error;
                turn += turn_by_error;
                // Of an error and a motion, the one nearer to the workpiece also turns the effect of the other.
                for (axis, (shift, turn)) in by_command.iter_mut().enumerate() {
                    if self.is_beyond(slot, axis) {
                        *shift += out.turn_by_command[axis].cross(&by_error);
                        *turn += out.turn_by_command[axis].cross(&turn_by_error);
                    } else {
                        *shift += turn_by_error.cross(&out.by_command[axis]);
                    }
                }
            }
        }
        // The rotation vector is not zero, so its derivative differs from that of the rotation by its left Jacobian (the
        // matrix of Bortz).
        let angle = turn.norm();
        let (half, rest) = match angle > 1e-4 {
            true => ((1.0 - angle.cos()) / angle.powi(2), (angle - angle.sin()) / angle.powi(3)),
            false => (0.5 - angle.powi(2) / 24.0, 1.0 / 6.0 - angle.powi(2) / 120.0),
        };
        let seen = |by: Vector3<f64>| by + turn.cross(&by) * half + turn.cross(&turn.cross(&by)) * rest;
        let turned = Rotation3::new(turn);
        out.position += shift;
        out.rotation = turned.matrix() * out.rotation;
        for derivative in out.turn_by_error.iter_mut().flatten() {
            *derivative = seen(*derivative);
        }
        for (axis, (shift, turn)) in by_command.into_iter().enumerate() {
            out.by_command[axis] += shift;
            out.turn_by_command[axis] = turned * out.turn_by_command[axis] + seen(turn);
        }
    }

    /// Whether errors of a slot act beyond the motion of an axis, looking from the workpiece.
    fn is_beyond(&self, slot: usize, axis: usize) -> bool {
        let of = slot / 2;
        if slot >= self.workpiece_slot() || of != axis {
            return slot == self.tool_slot() || (slot != self.workpiece_slot() && of > axis);
        }
        let outside = slot == self.motion_slot(axis) && self.axes[axis].error_frame == ErrorFrame::Moving;
        outside == (self.axes[axis].branch == Branch::Tool)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_of_small_angles_are_sine_and_cosine() {
        for step in -1200..=1200 {
            let angle = f64::from(step) * 1e-5 + 1e-9;
            let (sin, cos) = sin_cos(angle);
            assert!((sin - angle.sin()).abs() <= 2.0 * f64::EPSILON * angle.abs(), "{angle}");
            assert!((cos - angle.cos()).abs() <= f64::EPSILON, "{angle}");
        }
    }
}
