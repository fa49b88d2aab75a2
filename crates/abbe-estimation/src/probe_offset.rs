//! The recorded rows measured again with another probe offset: the tip is elsewhere in the frame of the tool.

use abbe_core::{Owner, ParameterRole, PoseIndex, Problem, Result, RowIndex, Unit, Unknown};

use crate::inverse_kinematics::InverseKinematics;

/// How far the tip of the other probe is from that of the recorded one, mm.
pub const OFFSETS: [f64; 2] = [100.0, -100.0];

/// The offset of the tip along x, y and z of the tool, by the names that conventions give it.
const TIP: [&str; 3] = ["dxt", "dyt", "dzt"];

/// The offsets of the tip that the model has, with the letter of the direction.
pub fn tip_offsets(problem: &Problem) -> Vec<(char, Unknown)> {
    let parameters = problem.model.info().parameters.iter().enumerate();
    let offsets = parameters.filter_map(|(index, parameter)| {
        let axis = TIP.iter().position(|name| *name == parameter.name)?;
        let unknown = Unknown { name: parameter.name.clone(), unit: parameter.unit, owner: Owner::Machine, index };
        (parameter.role == ParameterRole::SetUp && parameter.unit == Unit::MM)
            .then_some((['X', 'Y', 'Z'][axis], unknown))
    });
    offsets.collect()
}

/// The rows with the tip of the probe elsewhere by `shift` in mm along one of its [`tip_offsets`]. The linear axes bring it to where
/// the recorded one was; rows that they cannot reach are left out. None if no row is left.
pub fn with_offset(recorded: &Problem, offset: &Unknown, shift: f64) -> Result<Option<Problem>> {
    let mut moved = recorded.clone();
    moved.shift(offset, shift);
    let recorded_tip = InverseKinematics::new(recorded.model.as_ref(), &recorded.machine, None);
    let other_tip = InverseKinematics::new(moved.model.as_ref(), &moved.machine, None);
    let mut sets = recorded.sets.clone();
    for set in &mut sets {
        let rows = set.rows.clone();
        let measured: Vec<PoseIndex> = set.poses_of(&rows).collect();
        if measured.is_empty() {
            set.rows.clear();
            continue;
        }
        let statuses: Vec<Vec<f64>> = measured.iter().map(|&pose| set.poses().row(pose).to_vec()).collect();
        let tips = recorded_tip.tips(&statuses)?;
        let found = other_tip.at(statuses, &tips)?;
        let mut poses = set.poses().clone();
        let mut reached = Vec::new();
        for (pose, found) in measured.into_iter().zip(found) {
            if let Some(status) = found {
                poses.row_mut(pose).copy_from_slice(&status);
                reached.push(pose);
            }
        }
        let layout = &set.observations.info().layout;
        let all_poses = |row: &RowIndex| {
            let row = layout.rows[*row];
            row.poses > 0 && row.pose_indices().all(|pose| reached.contains(&pose))
        };
        let rows = rows.into_iter().filter(all_poses).collect();
        *set = set.with_poses(poses);
        set.rows = rows;
    }
    moved.sets = sets;
    Ok((moved.equations() > 0).then_some(moved))
}
