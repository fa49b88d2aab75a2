//! The structural loop as transforms.
//!
//! Both branches are evaluated from the bed. The transform of axis k from the frame before it is
//! `S_k E(location) J_k(q) E(motion)` (error frame moving) or `S_k E(location) E(motion) J_k(q)` (fixed), with
//! `E(ex, ey, ez, ea, eb, ec) = [Rz(ec) Ry(eb) Rx(ea) | (ex, ey, ez)]`. The tip seen from the table is
//! `p = T_workpiece^-1 T_tool tip`.

use abbe_core::{AxisKind, Branch};
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};

use crate::side_by_side::{ByErrorAndCommand, Evaluations, Given, quaternion, sign_of};

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
}

impl Evaluation {
    /// Orientation as a unit quaternion w, x, y, z.
    pub fn quaternion(&self) -> [f64; 4] {
        quaternion(&self.rotation)
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
        let mut one = Evaluations::one();
        let given = Given { commands, errors: errors.as_flattened(), tips: tip.as_slice() };
        one.evaluate(self, given, derivatives);
        let pose = one.pose(0);
        let errors = |by: ByErrorAndCommand<'_>, wanted: bool| {
            let slots = 0..if wanted { self.slots() } else { 0 };
            slots.map(|slot| std::array::from_fn(|component| by.error(slot, component))).collect()
        };
        let commands = |by: ByErrorAndCommand<'_>, wanted: bool| {
            (0..if wanted { self.axes.len() } else { 0 }).map(|axis| by.command(axis)).collect()
        };
        let (some, turns) =
            (derivatives != Derivatives::None, matches!(derivatives, Derivatives::OfPositionAndRotation(_)));
        *out = Evaluation {
            position: pose.position(),
            rotation: pose.rotation(),
            by_error: errors(pose.of_position(), some),
            turn_by_error: errors(pose.of_rotation(), turns),
            by_command: commands(pose.of_position(), some),
            turn_by_command: commands(pose.of_rotation(), some),
        };
    }

    /// The axes of one side of the bed, from the bed outwards.
    pub(crate) fn branch(&self, branch: Branch) -> &[usize] {
        match branch {
            Branch::Workpiece => &self.workpiece,
            Branch::Tool => &self.tool,
        }
    }

    /// Position of the tip to first order in the errors: the nominal position plus the sum of each error times its
    /// 6 x 6 matrix (Soons 1993, eq. 2.24 to 2.28), carried from the tool frame into the table frame.
    ///
    /// The difference to [`evaluate`](Self::evaluate) is the linearisation error; it decreases with the square of the errors.
    pub fn first_order(&self, commands: &[f64], errors: &[Errors], tip: &Vector3<f64>) -> Vector3<f64> {
        let no_errors = vec![0.0; 6 * self.slots()];
        let wanted = vec![false; self.slots()];
        let mut nominal = Evaluations::one();
        let given = Given { commands, errors: &no_errors, tips: tip.as_slice() };
        nominal.evaluate(self, given, Derivatives::OfPosition(&wanted));
        let pose = nominal.pose(0);
        let (tool_frame, tool_origin) = pose.slot(self.tool_slot());
        let to_tool = tool_frame.transpose();
        let mut sum = Vector6::zeros();
        for (slot, errors) in errors.iter().enumerate() {
            let (frame, origin) = pose.slot(slot);
            let rotation = to_tool * frame;
            let arm = rotation.transpose() * to_tool * (tool_origin - origin);
            // eq. 2.27: rotations (first three) act on the position through their arm, translations directly.
            let mut propagation = Matrix6::zeros();
            propagation.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
            propagation.fixed_view_mut::<3, 3>(3, 0).copy_from(&(rotation * arm.cross_matrix().transpose()));
            propagation.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
            let [x, y, z, a, b, c] = *errors;
            sum += propagation * Vector6::new(a, b, c, x, y, z) * sign_of(slot, &self.axes);
        }
        pose.position() + pose.rotation() * sum.fixed_rows::<3>(3)
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
