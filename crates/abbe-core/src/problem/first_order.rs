//! Orientations to first order in the errors, for observations that add up angular errors.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::model::{Poses, Variable};
use crate::problem::Problem;
use crate::rotation::left_jacobian;
use abbe_settings::Result;

impl Problem {
    /// Evaluates poses whose orientation is the nominal one, turned by the sum of the rotations of the single parameters:
    /// derivative at the nominal values times value. Parameters with a nominal value that is not zero (shapes of functions)
    /// keep their current values, so that the functions are the current ones.
    ///
    /// Positions are exact. Derivatives to shapes and commands are those of the exact rotation, which differ by products
    /// of errors.
    pub(crate) fn first_order(&self, statuses: &[f64], wanted: &[Variable], out: &mut Poses) -> Result<()> {
        let nominal = &self.model.info().nominal;
        let linear = |variable: &Variable| match variable {
            Variable::Parameter(index) => Some(*index).filter(|index| nominal[*index] == 0.0),
            Variable::Command(_) => None,
        };
        let exact = wanted.iter().any(|variable| linear(variable).is_none());
        self.model.poses(statuses, &self.machine_values, wanted, exact, out)?;

        let values: Vec<f64> = self
            .machine_values
            .iter()
            .zip(nominal)
            .map(|(value, nominal)| if *nominal == 0.0 { 0.0 } else { *value })
            .collect();
        let mut column = vec![None; nominal.len()];
        let mut variables = Vec::new();
        let moved = (0..nominal.len()).filter(|&index| nominal[index] == 0.0 && self.machine_values[index] != 0.0);
        for index in moved.chain(wanted.iter().filter_map(linear)) {
            column[index].get_or_insert_with(|| {
                variables.push(Variable::Parameter(index));
                variables.len() - 1
            });
        }
        let mut at_nominal = Poses::default();
        self.model.poses(statuses, &values, &variables, true, &mut at_nominal)?;

        let poses = at_nominal.orientations.len();
        out.orientations.clear();
        out.rotation_derivatives.resize(poses * wanted.len(), [0.0; 3]);
        for pose in 0..poses {
            let alone = &at_nominal.rotation_derivatives[pose * variables.len()..(pose + 1) * variables.len()];
            let mut turn = Vector3::zeros();
            for (variable, by) in variables.iter().zip(alone) {
                if let Variable::Parameter(index) = variable {
                    turn += Vector3::from(*by) * self.machine_values[*index];
                }
            }
            let [w, x, y, z] = at_nominal.orientations[pose];
            let nominal = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let turned = UnitQuaternion::from_scaled_axis(turn) * nominal;
            out.orientations.push([turned.w, turned.i, turned.j, turned.k]);
            let rotation = left_jacobian(&turn);
            let derivatives = &mut out.rotation_derivatives[pose * wanted.len()..(pose + 1) * wanted.len()];
            for (derivative, variable) in derivatives.iter_mut().zip(wanted) {
                if let Some(place) = linear(variable).and_then(|index| column[index]) {
                    // Most are zero: a reading turns with few of the errors.
                    let by = alone[place];
                    *derivative = if by == [0.0; 3] { by } else { (rotation * Vector3::from(by)).into() };
                }
            }
        }
        Ok(())
    }
}
