//! The equations of observed poses and their derivatives.

use abbe_core::rotation::{inverse_right_jacobian, left_jacobian};
use abbe_core::{
    Contact, Equations, Layout, Observations, ObservationsInfo, Orientation, Parameter, Result, RowBatch, RowIndex,
    Unit,
};
use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::start::Start;
use crate::{Observer, Pose, tools};

/// Unknowns of a frame: where its origin is, mm, and how it is turned from its start orientation, rad.
pub(crate) const OF_A_FRAME: [(&str, Unit); 6] =
    [("x", Unit::MM), ("y", Unit::MM), ("z", Unit::MM), ("a", Unit::RAD), ("b", Unit::RAD), ("c", Unit::RAD)];

/// Observed poses.
pub struct Observed {
    info: ObservationsInfo,
    /// The observed pose of every row.
    observed: Vec<Isometry3<f64>>,
    pose: Pose,
    observer: Observer,
    start: Start,
}

/// A frame at some values of its unknowns.
pub(crate) struct Placed {
    /// Its pose in the frame that it is fixed to.
    pub(crate) pose: Isometry3<f64>,
    /// d(small rotation, axes of that frame)/d(a, b, c).
    pub(crate) turn: Matrix3<f64>,
}

impl Placed {
    /// A frame that is not estimated.
    fn fixed(pose: Isometry3<f64>) -> Self {
        Self { pose, turn: Matrix3::zeros() }
    }

    /// A frame at its unknowns x, y, z, a, b, c: a, b, c are the rotation vector on top of the start orientation.
    pub(crate) fn at(start: &Isometry3<f64>, own: &[f64]) -> Self {
        let turn = Vector3::new(own[3], own[4], own[5]);
        let rotation = UnitQuaternion::from_scaled_axis(turn) * start.rotation;
        let pose = Isometry3::from_parts(Translation3::new(own[0], own[1], own[2]), rotation);
        Self { pose, turn: left_jacobian(&turn) }
    }
}

/// The residuals of a row with their derivatives, 6 x 6: position in mm, then orientation in rad.
struct Row {
    residuals: Vector6<f64>,
    by_tool: Matrix6<f64>,
    by_target: Matrix6<f64>,
    by_observer: Matrix6<f64>,
}

impl Row {
    /// The row that observed this, with the tool at `tool` in the table frame; `pose` says what was observed.
    fn new(pose: Pose, observed: &Isometry3<f64>, tool: &Isometry3<f64>, target: &Placed, observer: &Placed) -> Self {
        let in_table = tool * observer.pose;
        let (seeing, seen) = match pose {
            Pose::TargetInObserver => (&in_table, &target.pose),
            Pose::ObserverInTarget => (&target.pose, &in_table),
        };
        let predicted = seeing.inverse() * seen;
        let turn = (observed.rotation * predicted.rotation.inverse()).scaled_axis();
        let position = observed.translation.vector - predicted.translation.vector;

        // Derivatives of the residuals to small motions of both frames: shift of the origin and rotation about it, table
        // axes.
        let to_seeing = matrix(&seeing.rotation).transpose();
        let between = (seen.translation.vector - seeing.translation.vector).cross_matrix();
        let turned = inverse_right_jacobian(&turn) * to_seeing;
        let by_seen = blocks([-to_seeing, Matrix3::zeros(), -turned]);
        let by_seeing = blocks([to_seeing, -to_seeing * between, turned]);
        let (by_target, by_observer) = match pose {
            Pose::TargetInObserver => (by_seen, by_seeing),
            Pose::ObserverInTarget => (by_seeing, by_seen),
        };

        let (tool_rotation, identity) = (matrix(&tool.rotation), Matrix3::identity());
        let arm = (in_table.translation.vector - tool.translation.vector).cross_matrix();
        Self {
            residuals: Vector6::new(position.x, position.y, position.z, turn.x, turn.y, turn.z),
            by_tool: by_observer * blocks([identity, -arm, identity]),
            by_target: by_target * blocks([identity, Matrix3::zeros(), target.turn]),
            by_observer: by_observer * blocks([tool_rotation, Matrix3::zeros(), tool_rotation * observer.turn]),
        }
    }
}

impl Observed {
    /// Observations from what was observed in every row of the layout.
    pub fn new(layout: Layout, observed: Vec<Isometry3<f64>>, pose: Pose, observer: Observer, start: Start) -> Self {
        let frames: &[&str] = if observer == Observer::Estimated { &["target", "observer"] } else { &["target"] };
        let own = frames.iter().flat_map(|frame| OF_A_FRAME.map(|(own, unit)| (format!("{frame}.{own}"), unit)));
        let unknowns: Vec<Parameter> = own.map(|(name, unit)| Parameter::new(name, unit)).collect();
        let values = [start.target, start.observer].map(|frame| {
            let [x, y, z] = frame.translation.vector.into();
            [x, y, z, 0.0, 0.0, 0.0]
        });
        let contact = Contact::Pose {
            position: crate::POSITION.map(str::to_owned),
            orientation: crate::ORIENTATION.map(str::to_owned),
        };
        // No features: the target has no nominal place that it could be compared with.
        let info = ObservationsInfo {
            start: values.into_iter().flatten().take(unknowns.len()).collect(),
            orientation: Orientation::Exact,
            angles: layout.rows.iter().flat_map(|row| row.equation_indices().skip(3)).collect(),
            ..ObservationsInfo::new(layout, unknowns, contact)
        };
        Self { info, observed, pose, observer, start }
    }
}

impl Observations for Observed {
    fn info(&self) -> &ObservationsInfo {
        &self.info
    }

    fn evaluate(&self, batch: RowBatch<'_>, out: &mut Equations) -> Result<()> {
        let RowBatch { rows, own, .. } = batch;
        let (of_target, of_observer) = own.split_at(OF_A_FRAME.len());
        let target = Placed::at(&self.start.target, of_target);
        let observer = match self.observer {
            Observer::Estimated => Placed::at(&self.start.observer, of_observer),
            Observer::AtTool => Placed::fixed(self.start.observer),
        };
        for (&RowIndex(row), tool) in rows.iter().zip(tools(batch.positions, batch.orientations)) {
            let row = Row::new(self.pose, &self.observed[row], &tool, &target, &observer);
            for (equation, residual) in row.residuals.iter().enumerate() {
                let by = |matrix: &Matrix6<f64>, first: usize| [0, 1, 2].map(|i| matrix[(equation, first + i)]);
                out.equation(*residual);
                out.position(by(&row.by_tool, 0));
                out.rotation(by(&row.by_tool, 3));
                let columns = row.by_target.row(equation).into_owned();
                let others = row.by_observer.row(equation).into_owned();
                let own = columns.iter().chain(&others).take(self.info.unknowns.len());
                own.enumerate().for_each(|(unknown, derivative)| out.own(unknown, *derivative));
            }
        }
        Ok(())
    }
}

pub(crate) fn matrix(rotation: &UnitQuaternion<f64>) -> Matrix3<f64> {
    rotation.to_rotation_matrix().into_inner()
}

/// Blocks of derivatives: of position by shift, of position by turn, of orientation by turn (a shift turns nothing).
fn blocks([shift, lever, turn]: [Matrix3<f64>; 3]) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(&shift);
    all.fixed_view_mut::<3, 3>(0, 3).copy_from(&lever);
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    all
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;

    use super::*;
    use crate::tests::Random;

    /// Whatever is moved by small motions: shift and turn (fixed axes) of the tool, or the unknowns of a frame.
    fn residuals(pose: Pose, observed: &Isometry3<f64>, steps: &[f64], frames: &[Isometry3<f64>; 3]) -> Row {
        let [tool, target, observer] = frames;
        let shift = Translation3::new(steps[0], steps[1], steps[2]);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(steps[3], steps[4], steps[5]));
        let position = Translation3::from(shift.vector + tool.translation.vector);
        let tool = Isometry3::from_parts(position, turn * tool.rotation);
        let (target, observer) = (Placed::at(target, &steps[6..12]), Placed::at(observer, &steps[12..]));
        Row::new(pose, observed, &tool, &target, &observer)
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let mut random = Random(1);
        for trial in 0..200 {
            let pose = if trial % 2 == 0 { Pose::TargetInObserver } else { Pose::ObserverInTarget };
            let frames = [(); 3].map(|()| random.pose(500.0));
            let mut at: Vec<f64> = (0..18).map(|_| random.number()).collect();
            at[..6].fill(0.0);
            // Every fourth observation is all wrong; the others are off by 1e-6 to 0.1 rad.
            let exact = residuals(pose, &Isometry3::identity(), &at, &frames);
            let [x, y, z] = [0, 1, 2].map(|i| -exact.residuals[i]);
            let off = Vector3::from([(); 3].map(|()| random.number())) * 10_f64.powi(-1 - trial % 6);
            let [tool, target, observer] = &frames;
            let placed = (Placed::at(target, &at[6..12]), Placed::at(observer, &at[12..]));
            let in_table = tool * placed.1.pose;
            let predicted = match pose {
                Pose::TargetInObserver => in_table.inverse() * placed.0.pose,
                Pose::ObserverInTarget => placed.0.pose.inverse() * in_table,
            };
            assert!((predicted.translation.vector - Vector3::new(x, y, z)).norm() < 1e-9);
            let rotation = UnitQuaternion::from_scaled_axis(off) * predicted.rotation;
            let mut observed = Isometry3::from_parts(Translation3::new(x, y + 0.1, z), rotation);
            if trial % 4 == 3 {
                observed = random.pose(500.0);
            }
            let here = residuals(pose, &observed, &at, &frames);
            if trial % 4 != 3 {
                assert!((here.residuals - Vector6::new(0.0, 0.1, 0.0, off.x, off.y, off.z)).norm() < 1e-9);
            }
            if here.residuals.fixed_rows::<3>(3).norm() > 3.0 {
                continue; // A rotation vector near pi jumps to its opposite.
            }
            let by = [here.by_tool, here.by_target, here.by_observer];
            for unknown in 0..18 {
                let step = if unknown % 6 < 3 { 1e-2 } else { 1e-5 };
                let difference = [1.0, -1.0].map(|sign| {
                    let mut moved = at.clone();
                    moved[unknown] += sign * step;
                    residuals(pose, &observed, &moved, &frames).residuals
                });
                let expected = (difference[0] - difference[1]) / (2.0 * step);
                let found = by[unknown / 6].column(unknown % 6).into_owned();
                let error = (found - expected).norm();
                assert!(error < 1e-6 * (1.0 + expected.norm()), "trial {trial}, {unknown}: {found} {expected}");
            }
        }
    }

    /// Rank can be judged at any observed pose: another observed pose multiplies the derivatives of a row by an invertible
    /// factor.
    #[test]
    fn derivatives_of_what_was_seen_are_those_of_what_was_predicted_times_an_invertible_matrix() {
        let mut random = Random(2);
        for trial in 0..400 {
            let pose = if trial % 2 == 0 { Pose::TargetInObserver } else { Pose::ObserverInTarget };
            let frames = [(); 3].map(|()| random.pose(500.0));
            let at: Vec<f64> = (0..18).map(|_| 0.3 * random.number()).collect();
            let derivatives = |observed: &Isometry3<f64>| {
                let row = residuals(pose, observed, &at, &frames);
                let mut all = SMatrix::<f64, 6, 18>::zeros();
                for (index, by) in [row.by_tool, row.by_target, row.by_observer].iter().enumerate() {
                    all.fixed_view_mut::<6, 6>(0, 6 * index).copy_from(by);
                }
                (row.residuals, all)
            };
            let any = random.pose(500.0);
            let (residuals, seen) = derivatives(&any);
            let turn: Vector3<f64> = residuals.fixed_rows::<3>(3).into_owned();
            let predicted = Isometry3::from_parts(
                (any.translation.vector - residuals.fixed_rows::<3>(0)).into(),
                UnitQuaternion::from_scaled_axis(-turn) * any.rotation,
            );
            let (none, exact) = derivatives(&predicted);
            assert!(none.norm() < 1e-9);
            let mut factor = Matrix6::identity();
            factor.fixed_view_mut::<3, 3>(3, 3).copy_from(&inverse_right_jacobian(&turn));
            assert!((factor * exact - seen).norm() < 1e-9 * seen.norm(), "trial {trial}");
            // Half a turn, the largest there is, has a condition of pi/2.
            let values = factor.singular_values();
            assert!(values.max() / values.min() < 1.6, "trial {trial}: {values}");
        }
    }
}
