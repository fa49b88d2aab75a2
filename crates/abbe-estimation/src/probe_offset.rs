//! The recorded rows measured again with another probe offset: the tip is elsewhere in the frame of the tool.

use abbe_core::{Owner, ParameterRole, Problem, Result, Unit, Unknown};

use crate::inverse_kinematics::measured_again;

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
    measured_again(recorded, moved, None, |_| {})
}
