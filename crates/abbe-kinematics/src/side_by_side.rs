//! The walk along both branches of a chain, for several poses side by side: the vector units of a processor take several of them
//! at once.

use abbe_core::{AxisKind, Branch};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use pulp::{Arch, Scalar, Simd, WithSimd};

use crate::chain::{Chain, ChainAxis, Derivatives, ErrorFrame};
use crate::frame::{Frame, MOST, Turn, any};
use crate::number::{Directions, Number, Vector};

mod first_order;

/// What is evaluated. In each list the numbers of all poses stand side by side: those of the first axis, then those of the second.
#[derive(Debug, Clone, Copy)]
pub struct Given<'a> {
    /// Commands, mm or rad: axes x poses.
    pub commands: &'a [f64],
    /// ex, ey, ez in mm, ea, eb, ec in rad: slots x 6 x poses.
    pub errors: &'a [f64],
    /// Nominal tips in the last frame of the tool branch, mm: 3 x poses.
    pub tips: &'a [f64],
}

/// Poses of the tool relative to the table with their derivatives, and the buffers of their evaluation. In each list the numbers of
/// all poses stand side by side.
#[derive(Debug, Clone)]
pub struct Evaluations {
    poses: usize,
    /// Tips in the table frame, mm.
    positions: Vec<f64>,
    /// Rotations from the tool frame to the table frame, column by column.
    rotations: Vec<f64>,
    /// d(position)/d(error) of every slot, zero where they are not wanted; empty if none are.
    by_error: Vec<f64>,
    /// d(rotation vector, table frame)/d(error) of every slot.
    turn_by_error: Vec<f64>,
    /// d(position)/d(command) of every axis, its motion errors held.
    by_command: Vec<f64>,
    /// d(rotation vector)/d(command) of every axis.
    turn_by_command: Vec<f64>,
    /// Where the errors of each slot act; empty if nothing is recorded. Bed coordinates: the directions of the three
    /// translations in the frame just before it, the axes of the rotations ea and eb, which act in sequence (the axis of ec is the
    /// third direction), and the point that they turn about.
    slots: Vec<f64>,
    /// The motion of every axis per unit of its command, bed coordinates: its direction, and the point that it turns about.
    motions: Vec<f64>,
    /// The last turn of every rotary axis: poses of a run have many turns in common.
    turns: Vec<Turn>,
}

/// Vectors of a slot: three directions, two axes, and a point.
const OF_SLOT: usize = 6;

/// Vectors of a motion: a direction and a point.
const OF_MOTION: usize = 2;

/// One of the poses that were evaluated side by side.
#[derive(Debug, Clone, Copy)]
pub struct EvaluatedPose<'a> {
    all: &'a Evaluations,
    pose: usize,
}

/// Derivatives of the position or of the rotation of a pose.
#[derive(Debug, Clone, Copy)]
pub struct ByErrorAndCommand<'a> {
    poses: usize,
    pose: usize,
    by_error: &'a [f64],
    by_command: &'a [f64],
}

/// The vector of one of some poses at a place of a list.
#[inline]
fn vector(list: &[f64], place: usize, (poses, pose): (usize, usize)) -> Vector3<f64> {
    let own = &list[3 * poses * place..3 * poses * (place + 1)];
    Vector3::new(own[pose], own[poses + pose], own[2 * poses + pose])
}

impl<'a> EvaluatedPose<'a> {
    /// Tip in the table frame, mm.
    pub fn position(&self) -> Vector3<f64> {
        vector(&self.all.positions, 0, (self.all.poses, self.pose))
    }

    /// Rotation from the tool frame to the table frame.
    pub fn rotation(&self) -> Matrix3<f64> {
        let columns = [0, 1, 2].map(|column| vector(&self.all.rotations, column, (self.all.poses, self.pose)));
        Matrix3::from_columns(&columns)
    }

    /// Orientation as a unit quaternion w, x, y, z.
    pub fn quaternion(&self) -> [f64; 4] {
        quaternion(&self.rotation())
    }

    /// Derivatives of the position.
    pub fn of_position(&self) -> ByErrorAndCommand<'a> {
        let Evaluations { poses, by_error, by_command, .. } = self.all;
        ByErrorAndCommand { poses: *poses, pose: self.pose, by_error, by_command }
    }

    /// Derivatives of the rotation vector, table frame.
    pub fn of_rotation(&self) -> ByErrorAndCommand<'a> {
        let Evaluations { poses, turn_by_error, turn_by_command, .. } = self.all;
        ByErrorAndCommand { poses: *poses, pose: self.pose, by_error: turn_by_error, by_command: turn_by_command }
    }

    /// The frame and the origin of a slot, bed coordinates.
    pub(crate) fn slot(&self, slot: usize) -> (Matrix3<f64>, Vector3<f64>) {
        let at = |place| vector(&self.all.slots, OF_SLOT * slot + place, (self.all.poses, self.pose));
        (Matrix3::from_columns(&[at(0), at(1), at(2)]), at(OF_SLOT - 1))
    }
}

impl ByErrorAndCommand<'_> {
    /// The derivative to an error of a slot; zero where that was not wanted.
    #[inline]
    pub fn error(&self, slot: usize, component: usize) -> Vector3<f64> {
        vector(self.by_error, 6 * slot + component, (self.poses, self.pose))
    }

    /// The derivative to the command of an axis, its motion errors held.
    #[inline]
    pub fn command(&self, axis: usize) -> Vector3<f64> {
        vector(self.by_command, axis, (self.poses, self.pose))
    }
}

/// A rotation as a unit quaternion w, x, y, z.
pub(crate) fn quaternion(rotation: &Matrix3<f64>) -> [f64; 4] {
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    [quaternion.w, quaternion.i, quaternion.j, quaternion.k]
}

/// How many poses the processor takes at once.
struct AtOnce;

impl WithSimd for AtOnce {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        if S::F64_LANES.is_power_of_two() && S::F64_LANES <= MOST { S::F64_LANES } else { 1 }
    }
}

/// An evaluation as a whole: compiled for each kind of vector unit.
struct Whole<'a> {
    chain: &'a Chain,
    given: Given<'a>,
    derivatives: Derivatives<'a>,
    out: &'a mut Evaluations,
}

impl WithSimd for Whole<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chain, given, derivatives, out } = self;
        let (workpiece, tool) = out.walk_both(simd, chain, given);
        out.differentiate(simd, chain.axes(), (workpiece, tool), derivatives);
    }
}

impl Evaluations {
    /// Room for as many poses as this processor takes at once.
    pub fn side_by_side() -> Self {
        Self::of(Arch::new().dispatch(AtOnce))
    }

    /// Room for one pose.
    pub fn one() -> Self {
        Self::of(1)
    }

    fn of(poses: usize) -> Self {
        let (by_error, turn_by_error, by_command, turn_by_command) = Default::default();
        let (slots, motions, turns) = Default::default();
        let (positions, rotations) = (vec![0.0; 3 * poses], vec![0.0; 9 * poses]);
        Self {
            poses,
            positions,
            rotations,
            by_error,
            turn_by_error,
            by_command,
            turn_by_command,
            slots,
            motions,
            turns,
        }
    }

    /// How many poses it has: 1, 2, 4 or 8.
    pub fn poses(&self) -> usize {
        self.poses
    }

    /// One of the poses.
    pub fn pose(&self, pose: usize) -> EvaluatedPose<'_> {
        EvaluatedPose { all: self, pose }
    }

    /// The exact poses of a chain, with `derivatives` at these errors.
    pub fn evaluate(&mut self, chain: &Chain, given: Given<'_>, derivatives: Derivatives<'_>) {
        let recorded = if derivatives == Derivatives::None { 0 } else { chain.slots() };
        self.make_room(chain, derivatives, recorded);
        let (poses, whole) = (self.poses, Whole { chain, given, derivatives, out: self });
        match poses {
            1 => whole.with_simd(Scalar),
            _ => Arch::new().dispatch(whole),
        }
    }

    /// Room for what is wanted, and for what so many slots record.
    fn make_room(&mut self, chain: &Chain, derivatives: Derivatives<'_>, recorded: usize) {
        let (axes, wants) = (chain.axes().len(), derivatives != Derivatives::None);
        let (wanted, turns) = match derivatives {
            Derivatives::None => (0, 0),
            Derivatives::OfPosition(slots) => (slots.len(), 0),
            Derivatives::OfPositionAndRotation(slots) => (slots.len(), slots.len()),
        };
        let vectors = 3 * self.poses;
        self.slots.resize(vectors * OF_SLOT * recorded, 0.0);
        self.motions.resize(vectors * OF_MOTION * axes, 0.0);
        self.turns.resize(axes, Turn::default());
        self.by_error.resize(vectors * 6 * wanted, 0.0);
        self.turn_by_error.resize(vectors * 6 * turns, 0.0);
        let commands = if wants { axes } else { 0 };
        self.by_command.resize(vectors * commands, 0.0);
        self.turn_by_command.resize(vectors * commands, 0.0);
    }

    /// Walks both branches; returns the directions of the table, and the tip, bed coordinates.
    #[inline(always)]
    fn walk_both<S: Simd>(&mut self, simd: S, chain: &Chain, given: Given<'_>) -> (Directions<S>, Vector<S>) {
        let [workpiece, tool] = self.ends(chain, given, || Frame::bed(simd));
        let table = workpiece.directions;
        self.write_pose(table.inwards(tool.origin - workpiece.origin), table.all_inwards(tool.directions.0));
        (table, tool.origin)
    }

    /// The table, and the frame of the tool at its tip.
    #[inline(always)]
    fn ends<S: Simd>(&mut self, chain: &Chain, given: Given<'_>, bed: impl Fn() -> Frame<S>) -> [Frame<S>; 2] {
        let mut workpiece = bed();
        self.walk(chain, Branch::Workpiece, &mut workpiece, given);
        self.err(&mut workpiece, chain.workpiece_slot(), given.errors);
        let mut tool = bed();
        self.walk(chain, Branch::Tool, &mut tool, given);
        let tip = Vector::at(tool.simd, S::as_simd_f64s(given.tips).0, 0);
        tool.origin = tool.origin + tool.directions.outwards(tip);
        self.err(&mut tool, chain.tool_slot(), given.errors);
        [workpiece, tool]
    }

    #[inline(always)]
    fn write_pose<S: Simd>(&mut self, position: Vector<S>, rotation: [Vector<S>; 3]) {
        position.write(S::as_mut_simd_f64s(&mut self.positions).0, 0);
        Directions(rotation).write(S::as_mut_simd_f64s(&mut self.rotations).0, 0);
    }

    /// Walks one branch from the bed outwards.
    #[inline(always)]
    fn walk<S: Simd>(&mut self, chain: &Chain, branch: Branch, frame: &mut Frame<S>, given: Given<'_>) {
        for &index in chain.branch(branch) {
            let axis = &chain.axes()[index];
            if axis.kind == AxisKind::Rotary {
                frame.go_to(&axis.point);
            }
            self.err(frame, chain.location_slot(index), given.errors);
            match axis.error_frame {
                ErrorFrame::Moving => {
                    self.command(frame, (index, axis), given.commands);
                    self.err(frame, chain.motion_slot(index), given.errors);
                }
                ErrorFrame::Fixed => {
                    self.err(frame, chain.motion_slot(index), given.errors);
                    self.command(frame, (index, axis), given.commands);
                }
            }
        }
    }

    /// Applies the errors of a slot to the frame, and records the slot if that is wanted.
    #[inline(always)]
    fn err<S: Simd>(&mut self, frame: &mut Frame<S>, slot: usize, errors: &[f64]) {
        let width = self.poses;
        let errors = &errors[6 * width * slot..6 * width * (slot + 1)];
        let (shifts, turns) = errors.split_at(3 * width);
        if !frame.is_moved_by_errors {
            return self.note(frame, slot, (shifts, turns));
        }
        if any(shifts) {
            frame.origin =
                frame.origin + frame.directions.outwards(Vector::at(frame.simd, S::as_simd_f64s(shifts).0, 0));
        }
        let before = frame.directions;
        let [x, y, _] = before.0;
        let about = if any(turns) { frame.turn_by(turns) } else { [x, y] };
        if !self.slots.is_empty() {
            let slots = S::as_mut_simd_f64s(&mut self.slots).0;
            let first = OF_SLOT * slot;
            before.write(slots, first);
            about[0].write(slots, first + 3);
            about[1].write(slots, first + 4);
            frame.origin.write(slots, first + 5);
        }
    }

    /// Applies the commands of an axis to the frame, and records the motion.
    #[inline(always)]
    fn command<S: Simd>(&mut self, frame: &mut Frame<S>, (index, axis): (usize, &ChainAxis), commands: &[f64]) {
        let commands = &commands[self.poses * index..self.poses * (index + 1)];
        let (simd, sense) = (frame.simd, axis.sense());
        let direction = frame.directions.outwards(Vector::all(simd, &axis.direction)) * Number::all(simd, sense);
        match axis.kind {
            AxisKind::Linear => {
                frame.origin = frame.origin + direction * Number::at(simd, S::as_simd_f64s(commands).0, 0);
            }
            AxisKind::Rotary => frame.rotate(&axis.direction, sense, commands, &mut self.turns[index]),
        }
        let motions = S::as_mut_simd_f64s(&mut self.motions).0;
        direction.write(motions, OF_MOTION * index);
        frame.origin.write(motions, OF_MOTION * index + 1);
    }

    /// Computes the derivatives from the recorded slots and motions; `table` and `tip` are the table's directions and the
    /// tip, bed coordinates.
    #[inline(always)]
    fn differentiate<S: Simd>(
        &mut self,
        simd: S,
        axes: &[ChainAxis],
        (table, tip): (Directions<S>, Vector<S>),
        wanted: Derivatives<'_>,
    ) {
        let (slots, turns): (&[bool], bool) = match wanted {
            Derivatives::None => return,
            Derivatives::OfPosition(slots) => (slots, false),
            Derivatives::OfPositionAndRotation(slots) => (slots, true),
        };
        let still = Vector::all(simd, &Vector3::zeros());
        let recorded = S::as_simd_f64s(&self.slots).0;
        let by_error = S::as_mut_simd_f64s(&mut self.by_error).0;
        let turn_by_error = S::as_mut_simd_f64s(&mut self.turn_by_error).0;
        for (slot, wanted) in slots.iter().enumerate() {
            // Values of the evaluation before are overwritten, also for slots that are not wanted.
            if !wanted {
                let (first, vectors) = (18 * slot, 18 * (slot + 1));
                by_error[first..vectors].fill(simd.splat_f64s(0.0));
                if turns {
                    turn_by_error[first..vectors].fill(simd.splat_f64s(0.0));
                }
                continue;
            }
            let sign = Number::all(simd, sign_of(slot, axes));
            let table = Directions([table.0[0] * sign, table.0[1] * sign, table.0[2] * sign]);
            let first = OF_SLOT * slot;
            let Directions([x, y, z]) = Directions::at(simd, recorded, first);
            let (a, b) = (Vector::at(simd, recorded, first + 3), Vector::at(simd, recorded, first + 4));
            let lever = tip - Vector::at(simd, recorded, first + 5);
            Directions(table.all_inwards([x, y, z])).write(by_error, 6 * slot);
            let turned = [a.cross(lever), b.cross(lever), z.cross(lever)];
            Directions(table.all_inwards(turned)).write(by_error, 6 * slot + 3);
            if turns {
                Directions([still, still, still]).write(turn_by_error, 6 * slot);
                Directions(table.all_inwards([a, b, z])).write(turn_by_error, 6 * slot + 3);
            }
        }
        let motions = S::as_simd_f64s(&self.motions).0;
        let by_command = S::as_mut_simd_f64s(&mut self.by_command).0;
        let turn_by_command = S::as_mut_simd_f64s(&mut self.turn_by_command).0;
        for (index, axis) in axes.iter().enumerate() {
            let sign = Number::all(simd, sign_of_branch(axis.branch));
            let direction = Vector::at(simd, motions, OF_MOTION * index) * sign;
            let (shift, turn) = match axis.kind {
                AxisKind::Linear => (direction, still),
                AxisKind::Rotary => {
                    (direction.cross(tip - Vector::at(simd, motions, OF_MOTION * index + 1)), direction)
                }
            };
            let (shift, turn) = (table.inwards(shift), table.inwards(turn));
            shift.write(by_command, index);
            turn.write(turn_by_command, index);
        }
    }
}

/// +1 on the tool branch, -1 on the workpiece branch.
fn sign_of_branch(branch: Branch) -> f64 {
    if branch == Branch::Tool { 1.0 } else { -1.0 }
}

/// The sign of the branch of a slot: two for each axis, then those of workpiece and tool.
pub(crate) fn sign_of(slot: usize, axes: &[ChainAxis]) -> f64 {
    let of_workpiece = slot == 2 * axes.len();
    let branch = if of_workpiece { Branch::Workpiece } else { Branch::Tool };
    sign_of_branch(axes.get(slot / 2).map_or(branch, |axis| axis.branch))
}
