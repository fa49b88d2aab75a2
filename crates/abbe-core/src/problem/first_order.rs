//! Orientations to first order in the errors, for observations that add up angular errors.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::factored::FactoredPoses;
use crate::model::{PoseBatch, Variable};
use crate::problem::Problem;
use crate::rotation::left_jacobian;
use abbe_settings::Result;

impl Problem {
    /// Evaluates poses whose orientation is the nominal one, turned by the sum of the rotations of the single parameters:
    /// derivative at the nominal values times value. Parameters with a nominal value that is not zero (shapes of functions)
    /// keep their current values, so that the functions are the current ones.
    ///
    /// Positions are exact, and without derivatives ([`add_positions`](Self::add_positions)): readings of angles have none.
    /// Derivatives to shapes and commands are those of the exact rotation, which differ by products of errors.
    pub(crate) fn first_order(&self, statuses: &[f64], wanted: &[Variable], out: &mut FactoredPoses) -> Result<()> {
        let nominal = &self.model.info().nominal;
        let linear = |variable: &Variable| match variable {
            Variable::Parameter(index) => Some(*index).filter(|index| nominal[*index] == 0.0),
            Variable::Command(_) => None,
        };
        let as_is = PoseBatch { statuses, values: &self.machine_values, wanted: &[], orientation: false };
        self.model.factored(as_is, out)?;
        let mut rotations = FactoredPoses::default();
        let others: Vec<usize> = (0..wanted.len()).filter(|&index| linear(&wanted[index]).is_none()).collect();
        if !others.is_empty() {
            let wanted: Vec<Variable> = others.iter().map(|&index| wanted[index]).collect();
            self.model.factored(PoseBatch { wanted: &wanted, orientation: true, ..as_is }, &mut rotations)?;
            out.add_rotations(&rotations, |variable| Some(others[variable]));
        }
        let values = self.machine_values.iter().zip(nominal);
        let values: Vec<f64> = values.map(|(value, nominal)| if *nominal == 0.0 { 0.0 } else { *value }).collect();
        let mut place = vec![None; nominal.len()];
        for (index, variable) in wanted.iter().enumerate() {
            linear(variable).into_iter().for_each(|parameter| place[parameter] = Some(index));
        }
        let turning: Vec<usize> = (0..nominal.len())
            .filter(|&index| nominal[index] == 0.0 && (self.machine_values[index] != 0.0 || place[index].is_some()))
            .collect();
        let variables: Vec<Variable> = turning.iter().map(|&index| Variable::Parameter(index)).collect();
        let at_nominal = PoseBatch { statuses, values: &values, wanted: &variables, orientation: true };
        self.model.factored(at_nominal, &mut rotations)?;
        out.poses.orientations.clear();
        for pose in 0..rotations.poses.orientations.len() {
            let turn = rotations.turn(pose, |variable| self.machine_values[turning[variable]]);
            let [w, x, y, z] = rotations.poses.orientations[pose];
            let nominal = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let turned = UnitQuaternion::from_scaled_axis(turn) * nominal;
            out.poses.orientations.push([turned.w, turned.i, turned.j, turned.k]);
            let rotation = left_jacobian(&turn);
            let effects = pose * rotations.effects..(pose + 1) * rotations.effects;
            // Most are zero: a reading turns with few of the errors.
            for effect in rotations.rotation_effects[effects].iter_mut().filter(|effect| **effect != [0.0; 3]) {
                *effect = (rotation * Vector3::from(*effect)).into();
            }
        }
        out.add_rotations(&rotations, |variable| place[turning[variable]]);
        Ok(())
    }

    /// Adds the effects on the positions of such poses.
    pub(crate) fn add_positions(&self, statuses: &[f64], wanted: &[Variable], out: &mut FactoredPoses) -> Result<()> {
        let mut positions = FactoredPoses::default();
        let as_is = PoseBatch { statuses, values: &self.machine_values, wanted, orientation: false };
        self.model.factored(as_is, &mut positions)?;
        out.add_positions(&positions);
        Ok(())
    }
}
