//! Axes of the machine as joints of LinuxCNC.

use abbe_core::{Absent, AxisKind, Error, KinematicModel, Result, SettingsError, StatusRole};
use abbe_volumetric::position_unit;

/// The letters of LinuxCNC in the order of its joints, with the names of their fields in `EmcPose`.
const LETTERS: [(&str, &str); 9] = [
    ("X", "tran.x"),
    ("Y", "tran.y"),
    ("Z", "tran.z"),
    ("A", "a"),
    ("B", "b"),
    ("C", "c"),
    ("U", "u"),
    ("V", "v"),
    ("W", "w"),
];

/// A joint: trivial kinematics, one joint an axis.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Index of its axis.
    pub axis: usize,
    /// The letter of the axis.
    pub letter: &'static str,
    /// Its field in `EmcPose`.
    pub field: &'static str,
    /// The column of its command.
    pub status: usize,
    /// How many of its unit (mm, degrees) make one in memory.
    pub factor: f64,
    pub kind: AxisKind,
}

/// The joints of a machine in the order of LinuxCNC; spindles are none.
///
/// Fails for an axis that LinuxCNC has no letter for.
pub fn joints(model: &dyn KinematicModel) -> Result<Vec<Joint>> {
    let axes = &model.info().axes;
    let unknown = axes.iter().find(|axis| !axis.indexed && !LETTERS.iter().any(|(letter, _)| axis.name == *letter));
    if let Some(axis) = unknown {
        let message = format!("LinuxCNC has no axis `{}`; its axes are X Y Z A B C U V W", axis.name);
        return Err(Error::usage(message));
    }
    let found = LETTERS.iter().filter_map(|&(letter, field)| {
        let index = axes.iter().position(|axis| !axis.indexed && axis.name == letter)?;
        let axis = &axes[index];
        let factor = position_unit(axis).1;
        Some(Joint { axis: index, letter, field, status: axis.status, factor, kind: axis.kind })
    });
    Ok(found.collect())
}

/// The status that the component knows: commands of joints, no directions, all else as for data without a column for it.
pub fn known(model: &dyn KinematicModel, joints: &[Joint], status: &[f64]) -> Vec<f64> {
    let columns = model.info().status.iter().enumerate();
    columns
        .map(|(index, column)| match (&column.role, column.absent) {
            _ if joints.iter().any(|joint| joint.status == index) => status[index],
            (StatusRole::Direction(_), _) | (_, Absent::Required) => 0.0,
            (_, Absent::Default(value)) => value,
        })
        .collect()
}

/// Refuses a name that is none of a component.
pub fn plain_name(name: &str) -> Result<(), SettingsError> {
    let is_plain = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_';
    if !name.starts_with(|first: char| first.is_ascii_lowercase()) || !name.chars().all(is_plain) || name.len() > 40 {
        let message = "a name of small letters, digits and `_` was expected, with a letter first, at most 40 of them";
        return Err(SettingsError::new("component", message));
    }
    Ok(())
}
