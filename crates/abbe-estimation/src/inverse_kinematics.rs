//! Commands of the linear axes that bring the tip to a point.

use abbe_core::{AxisKind, KinematicModel, PoseIndex, Poses, Problem, Result, RowIndex, Variable};
use nalgebra::{DMatrix, DVector};

/// Distance from a point at which the tip is on it, mm.
const ON: f64 = 1e-6;

/// Most steps of Newton's iteration; with linear axes it ends after two or three.
const STEPS: usize = 8;

/// Moves linear axes until tips are at points of the table frame.
pub struct InverseKinematics<'a> {
    model: &'a dyn KinematicModel,
    values: &'a [f64],
    wanted: Vec<Variable>,
    /// Status and range of every linear axis that moves.
    linear: Vec<(usize, Option<[f64; 2]>)>,
}

impl<'a> InverseKinematics<'a> {
    /// For a model with these values of its parameters; the axis with the status `held` does not move.
    pub fn new(model: &'a dyn KinematicModel, values: &'a [f64], held: Option<usize>) -> Self {
        let axes = model.info().axes.iter().enumerate();
        let linear = axes.filter(|(_, axis)| axis.kind == AxisKind::Linear && Some(axis.status) != held);
        let (wanted, linear) =
            linear.map(|(index, axis)| (Variable::Command(index), (axis.status, axis.range))).unzip();
        Self { model, values, wanted, linear }
    }

    fn evaluate(&self, statuses: &[Vec<f64>], wanted: &[Variable]) -> Result<Poses> {
        let mut poses = Poses::default();
        self.model.poses(&statuses.concat(), self.values, wanted, false, &mut poses)?;
        Ok(poses)
    }

    /// Tip positions, table frame, mm.
    pub fn tips(&self, statuses: &[Vec<f64>]) -> Result<Vec<[f64; 3]>> {
        Ok(self.evaluate(statuses, &[])?.positions)
    }

    /// The statuses with the tips at `points`; none if the linear axes cannot bring the tip there within their ranges.
    pub fn solve(&self, mut statuses: Vec<Vec<f64>>, points: &[[f64; 3]]) -> Result<Vec<Option<Vec<f64>>>> {
        let mut distances = vec![f64::INFINITY; statuses.len()];
        for _ in 0..STEPS {
            let poses = self.evaluate(&statuses, &self.wanted)?;
            for (pose, status) in statuses.iter_mut().enumerate() {
                let off = DVector::from_fn(3, |axis, _| points[pose][axis] - poses.positions[pose][axis]);
                distances[pose] = off.norm();
                self.step(&poses, pose, &off, status);
            }
            if distances.iter().all(|distance| *distance < ON) {
                break;
            }
        }
        let found = statuses.into_iter().zip(distances);
        Ok(found.map(|(status, distance)| (distance < ON && self.in_range(&status)).then_some(status)).collect())
    }

    /// The shortest step of the linear axes that brings a tip as near as possible to its point.
    fn step(&self, poses: &Poses, pose: usize, off: &DVector<f64>, status: &mut [f64]) {
        let count = self.linear.len();
        if count == 0 {
            return;
        }
        let derivatives =
            DMatrix::from_fn(3, count, |axis, column| poses.position_derivatives[pose * count + column][axis]);
        if let Ok(step) = derivatives.svd(true, true).solve(off, 1e-6) {
            self.linear.iter().zip(step.iter()).for_each(|((axis, _), step)| status[*axis] += step);
        }
    }

    fn in_range(&self, status: &[f64]) -> bool {
        let within = |status: f64, [from, to]: [f64; 2]| (from - ON..=to + ON).contains(&status);
        self.linear.iter().all(|(axis, range)| range.is_none_or(|range| within(status[*axis], range)))
    }
}

/// The rows of `recorded` as `other` would measure them, a problem with the same rows: `change` says what is different in a status, and
/// the linear axes bring every tip back to where it was, but for the axis with the status `held`. Rows for which they cannot are left
/// out. None if no row is left.
pub fn measured_again(
    recorded: &Problem,
    mut other: Problem,
    held: Option<usize>,
    change: impl Fn(&mut [f64]),
) -> Result<Option<Problem>> {
    let tip_as_recorded = InverseKinematics::new(recorded.model.as_ref(), &recorded.machine_values, held);
    let reach = InverseKinematics::new(other.model.as_ref(), &other.machine_values, held);
    for set in &mut other.sets {
        let mut poses = set.poses().clone();
        let measured: Vec<PoseIndex> = set.poses_of(&set.rows).collect();
        let mut reached = Vec::new();
        // A model is not asked for no poses.
        if !measured.is_empty() {
            let mut statuses: Vec<Vec<f64>> = measured.iter().map(|&pose| poses.row(pose).to_vec()).collect();
            let tips = tip_as_recorded.tips(&statuses)?;
            statuses.iter_mut().for_each(|status| change(status));
            for (pose, found) in measured.into_iter().zip(reach.solve(statuses, &tips)?) {
                if let Some(status) = found {
                    poses.row_mut(pose).copy_from_slice(&status);
                    reached.push(pose);
                }
            }
        }
        let layout = &set.observations.info().layout;
        let is_reached = |row: &RowIndex| {
            let row = layout.rows[*row];
            row.poses > 0 && row.pose_indices().all(|pose| reached.contains(&pose))
        };
        let rows = set.rows.iter().copied().filter(is_reached).collect();
        *set = set.with_poses(poses);
        set.rows = rows;
    }
    Ok((other.equations() > 0).then_some(other))
}
