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
    /// A positive command moves the tool positively relative to the workpiece (ISO 841), so what an axis of the
    /// workpiece branch carries moves the other way.
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
    /// Directions of the three translations and axes of the three rotations as they act one after another.
    directions: [Vector3<f64>; 6],
    /// The point that the rotations turn about.
    origin: Vector3<f64>,
    /// +1 on the tool branch, -1 on the workpiece branch.
    sign: f64,
}

impl Default for Slot {
    fn default() -> Self {
        Self { directions: [Vector3::zeros(); 6], origin: Vector3::zeros(), sign: 1.0 }
    }
}

/// Pose of the tool relative to the table and what moves it.
#[derive(Debug, Clone, Default)]
pub struct Evaluation {
    /// Tip in the table frame, mm.
    pub position: Vector3<f64>,
    /// Rotation from the tool frame to the table frame.
    pub rotation: Matrix3<f64>,
    /// d(position)/d(error) of every slot.
    pub by_error: Vec<[Vector3<f64>; 6]>,
    /// d(rotation vector, table frame)/d(error) of every slot; empty unless asked for.
    pub turn_by_error: Vec<[Vector3<f64>; 6]>,
    /// d(position)/d(command) of every axis, its motion errors held.
    pub by_command: Vec<Vector3<f64>>,
    /// d(rotation vector)/d(command) of every axis.
    pub turn_by_command: Vec<Vector3<f64>>,
    slots: Vec<Slot>,
    /// Direction of the motion of every axis and the point it turns about, bed coordinates, per unit of command.
    motions: Vec<(Vector3<f64>, Vector3<f64>)>,
}

impl Evaluation {
    /// Orientation as a unit quaternion w, x, y, z.
    pub fn quaternion(&self) -> [f64; 4] {
        let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation));
        [quaternion.w, quaternion.i, quaternion.j, quaternion.k]
    }
}

/// A frame on the way outwards, bed coordinates.
struct Frame {
    rotation: Matrix3<f64>,
    origin: Vector3<f64>,
    /// Nominal position of the frame with all axes at zero.
    nominal: Vector3<f64>,
    sign: f64,
}

impl Frame {
    fn bed(sign: f64) -> Self {
        Self { rotation: Matrix3::identity(), origin: Vector3::zeros(), nominal: Vector3::zeros(), sign }
    }

    /// Lets errors act, and records where they do.
    fn err(&mut self, errors: &Errors) -> Slot {
        let before = self.rotation;
        let column = |index: usize| before.column(index).into_owned();
        self.origin += before * Vector3::new(errors[0], errors[1], errors[2]);
        let mut directions = [column(0), column(1), column(2), column(0), column(1), column(2)];
        if errors[3..] != [0.0; 3] {
            let [(sin_a, cos_a), (sin_b, cos_b), (sin_c, cos_c)] = [errors[3], errors[4], errors[5]].map(f64::sin_cos);
            // The frame after Rz, then after Ry, then after Rx; each step turns two columns.
            let [x, y, z] = [column(0), column(1), column(2)];
            let (about_z_x, about_z_y) = (x * cos_c + y * sin_c, y * cos_c - x * sin_c);
            let (about_y_x, about_y_z) = (about_z_x * cos_b - z * sin_b, z * cos_b + about_z_x * sin_b);
            let (about_x_y, about_x_z) = (about_z_y * cos_a + about_y_z * sin_a, about_y_z * cos_a - about_z_y * sin_a);
            directions[4] = about_z_y;
            directions[3] = about_y_x;
            self.rotation = Matrix3::from_columns(&[about_y_x, about_x_y, about_x_z]);
        }
        Slot { directions, origin: self.origin, sign: self.sign }
    }

    /// Moves by a command, and records how.
    fn command(&mut self, axis: &ChainAxis, command: f64) -> (Vector3<f64>, Vector3<f64>) {
        let direction = self.rotation * axis.direction * axis.sense();
        match axis.kind {
            AxisKind::Linear => self.origin += direction * command,
            AxisKind::Rotary => {
                let about = Unit::new_unchecked(axis.direction);
                self.rotation *= Rotation3::from_axis_angle(&about, axis.sense() * command).matrix();
            }
        }
        (direction, self.origin)
    }
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
                frame.origin += frame.rotation * (axis.point - frame.nominal);
                frame.nominal = axis.point;
            }
            let (location, motion) = (self.location_slot(index), self.motion_slot(index));
            out.slots[location] = frame.err(&errors[location]);
            match axis.error_frame {
                ErrorFrame::Moving => {
                    out.motions[index] = frame.command(axis, commands[index]);
                    out.slots[motion] = frame.err(&errors[motion]);
                }
                ErrorFrame::Fixed => {
                    out.slots[motion] = frame.err(&errors[motion]);
                    out.motions[index] = frame.command(axis, commands[index]);
                }
            }
        }
    }

    /// The exact pose at `commands` (mm or rad, one an axis) under `errors` (one entry a slot) with all derivatives at
    /// these errors, those of the rotation only if `turns` is set. `tip` is the nominal tip in the last frame of the tool
    /// branch, mm.
    pub fn evaluate(&self, commands: &[f64], errors: &[Errors], tip: &Vector3<f64>, turns: bool, out: &mut Evaluation) {
        out.slots.resize(self.slots(), Slot::default());
        out.motions.resize(self.axes.len(), (Vector3::zeros(), Vector3::zeros()));
        let mut workpiece = Frame::bed(-1.0);
        self.walk(&self.workpiece, &mut workpiece, commands, errors, out);
        out.slots[self.workpiece_slot()] = workpiece.err(&errors[self.workpiece_slot()]);
        let mut tool = Frame::bed(1.0);
        self.walk(&self.tool, &mut tool, commands, errors, out);
        tool.origin += tool.rotation * tip;
        out.slots[self.tool_slot()] = tool.err(&errors[self.tool_slot()]);

        let to_table = workpiece.rotation.transpose();
        out.position = to_table * (tool.origin - workpiece.origin);
        out.rotation = to_table * tool.rotation;
        out.by_error.clear();
        out.turn_by_error.clear();
        for slot in &out.slots {
            let seen = to_table * slot.sign;
            let lever = tool.origin - slot.origin;
            let [x, y, z, a, b, c] = slot.directions;
            let turned = [a, b, c].map(|axis| seen * axis.cross(&lever));
            out.by_error.push([seen * x, seen * y, seen * z, turned[0], turned[1], turned[2]]);
            if turns {
                let still = Vector3::zeros();
                out.turn_by_error.push([still, still, still, seen * a, seen * b, seen * c]);
            }
        }
        out.by_command.clear();
        out.turn_by_command.clear();
        for (axis, (direction, origin)) in self.axes.iter().zip(&out.motions) {
            let seen = to_table * if axis.branch == Branch::Tool { 1.0 } else { -1.0 };
            let (shift, turn) = match axis.kind {
                AxisKind::Linear => (seen * direction, Vector3::zeros()),
                AxisKind::Rotary => (seen * direction.cross(&(tool.origin - origin)), seen * direction),
            };
            out.by_command.push(shift);
            out.turn_by_command.push(turn);
        }
    }

    /// Position of the tip to first order in the errors: the nominal position plus the sum of each error times its
    /// 6 x 6 matrix (Soons 1993, eq. 2.24 to 2.28), carried from the tool frame into the table frame.
    ///
    /// The difference to [`evaluate`](Self::evaluate) is what linearising costs; it shrinks with the square of the errors.
    pub fn first_order(&self, commands: &[f64], errors: &[Errors], tip: &Vector3<f64>) -> Vector3<f64> {
        let mut nominal = Evaluation::default();
        self.evaluate(commands, &vec![[0.0; 6]; self.slots()], tip, false, &mut nominal);
        let tool = nominal.slots[self.tool_slot()];
        let frame_of = |slot: &Slot| Matrix3::from_columns(&slot.directions[..3]);
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

    /// The pose to first order in the errors, with the derivatives of that very pose: what [`evaluate`](Self::evaluate) is
    /// replaced by to see what linearising costs.
    ///
    /// The position is that of [`first_order`](Self::first_order); the tool turns by the sum of the errors' turns.
    pub fn evaluate_first_order(&self, commands: &[f64], errors: &[Errors], tip: &Vector3<f64>, out: &mut Evaluation) {
        self.evaluate(commands, &vec![[0.0; 6]; self.slots()], tip, true, out);
        let (mut shift, mut turn) = (Vector3::zeros(), Vector3::zeros());
        let mut by_command = vec![(Vector3::zeros(), Vector3::zeros()); self.axes.len()];
        for (slot, errors) in errors.iter().enumerate() {
            for (component, &error) in errors.iter().enumerate().filter(|(_, error)| **error != 0.0) {
                let by_error = out.by_error[slot][component] * error;
                let turn_by_error = out.turn_by_error[slot][component] * error;
                shift += by_error;
                turn += turn_by_error;
                // Of two motions, the one nearer to the workpiece carries the effect of the other along.
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
        // A rotation vector that is not zero: its derivative is not that of the rotation, but Bortz's matrix away from it.
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
