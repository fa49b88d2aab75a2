//! Laws of kinematic models.

use abbe_core::{
    Absent, AxisKind, ErrorFunction, KinematicModel, ModelInfo, ParameterRole, Poses, Quantity, Result, StatusRole,
    Variable,
};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::{agrees, names};

/// Poses that are tried.
const POSES: usize = 7;

/// Largest deviation of a difference quotient, relative to the largest derivative to its variable.
const TOLERANCE: f64 = 1e-5;

/// The laws that a model breaks, at poses over its whole range; empty if it keeps them:
///
/// - derivatives of positions and, if it has them, of orientations agree with difference quotients;
/// - a pose is the same alone as among others, and with derivatives as without;
/// - the derivatives of a motion error agree with difference quotients, and none is missing for a coefficient that it has; there is a
///   parameter with its role, or one that makes it with other errors;
/// - every parameter has a name of its own.
///
/// A model may refuse orientations as a whole, but no pose within its range.
pub fn check_model(model: &dyn KinematicModel) -> Vec<String> {
    check_model_within(model, SECOND)
}

/// The same at times within a range, s: a machine that follows a log has no others.
pub fn check_model_within(model: &dyn KinematicModel, times: [f64; 2]) -> Vec<String> {
    let info = model.info();
    let mut broken = names(info.parameters.iter());
    if info.nominal.len() != info.parameters.len() || info.nominal_uncertainties.len() != info.parameters.len() {
        broken.push("it has not one nominal value, and one uncertainty of it, for every parameter".to_owned());
        return broken;
    }
    let of_no_axis = |role: &StatusRole| match role {
        StatusRole::Command(axis) | StatusRole::Direction(axis) | StatusRole::Velocity(axis) => {
            *axis >= info.axes.len()
        }
        _ => false,
    };
    let no_status = info.axes.iter().any(|axis| axis.status >= info.status.len());
    if no_status || info.status.iter().any(|column| of_no_axis(&column.role)) {
        broken.push("an axis has no status, or a status is of an axis that is not there".to_owned());
        return broken;
    }
    let (statuses, values) = samples_within(model, 1, times);
    for function in &info.error_functions {
        let ErrorFunction { symbol, axis, component, .. } = function;
        let role = ParameterRole::Motion { axis: *axis, component: *component };
        let has_role = info.parameters.iter().any(|parameter| parameter.role == role);
        // One that no coefficient makes: a body that grows makes several motion errors with one factor.
        let has_another =
            || model.motion_error(function, &values, &statuses).is_ok_and(|of| !of.derivatives.is_empty());
        if !has_role && !has_another() {
            broken.push(format!("no parameter has the role of the motion error {symbol}"));
        }
    }
    for (what, found) in [
        ("a pose", derivatives(model, times)),
        ("a pose", alone_and_together(model, times)),
        ("a motion error", motion_errors(model, times)),
    ] {
        match found {
            Ok(found) => broken.extend(found),
            Err(error) => broken.push(format!("it fails at {what} within its range: {error}")),
        }
    }
    broken
}

/// Times of models whose clock is not known, s.
const SECOND: [f64; 2] = [0.0, 1.0];

/// Statuses over the whole range of a model (poses x statuses), and realistic values of its parameters, near the nominal
/// ones; the same in every call.
pub fn samples(model: &dyn KinematicModel, poses: usize) -> (Vec<f64>, Vec<f64>) {
    samples_within(model, poses, SECOND)
}

/// The same at times within a range, s.
fn samples_within(model: &dyn KinematicModel, poses: usize, times: [f64; 2]) -> (Vec<f64>, Vec<f64>) {
    let info = model.info();
    // Weyl's sequence: spread evenly, without a random number.
    let spread = |index: usize, salt: usize| {
        let step = (index as f64 + 1.0) * 0.618_033_988_749_894_9 + salt as f64 * 0.414_213_562_373_095_1;
        step - step.floor()
    };
    let mut statuses = Vec::new();
    for pose in 0..poses {
        for (index, column) in info.status.iter().enumerate() {
            let part = spread(pose, index);
            statuses.push(match column.role {
                StatusRole::Command(axis) => {
                    let axis = &info.axes[axis];
                    let usual = if axis.kind == AxisKind::Linear { 100.0 } else { 0.8 };
                    let [low, high] = axis.range.unwrap_or([-usual, usual]);
                    low + (0.05 + 0.9 * part) * (high - low)
                }
                StatusRole::Direction(_) if part < 0.5 => -1.0,
                StatusRole::Direction(_) => 1.0,
                StatusRole::Velocity(_) => 100.0 * (part - 0.5),
                _ if column.quantity == Quantity::Label => 0.0,
                _ => match column.absent {
                    Absent::Default(value) if value.is_finite() => value,
                    _ if column.role == StatusRole::Time => times[0] + part * (times[1] - times[0]),
                    _ => part,
                },
            });
        }
    }
    let small = |index: usize| match info.parameters[index].unit.per {
        None => (spread(index, 7) - 0.5) * 2e-3,
        Some(_) => (spread(index, 7) - 0.5) * 1e-7,
    };
    let values = info.nominal.iter().enumerate().map(|(index, nominal)| nominal + small(index));
    (statuses, values.collect())
}

/// Everything that a model has derivatives to.
fn variables(model: &dyn KinematicModel) -> Vec<Variable> {
    let parameters = (0..model.info().parameters.len()).map(Variable::Parameter);
    parameters.chain((0..model.info().axes.len()).map(Variable::Command)).collect()
}

/// Whether the model has orientations. A model without them has to refuse them with an error.
fn has_orientations(model: &dyn KinematicModel) -> bool {
    let (statuses, values) = samples(model, 1);
    match model.poses(&statuses, &values, &[], true, &mut Poses::default()) {
        Ok(()) => true,
        // A fatal error is reported by the comparison of derivatives.
        Err(error) => error.fatal,
    }
}

fn derivatives(model: &dyn KinematicModel, times: [f64; 2]) -> Result<Vec<String>> {
    let (statuses, values) = samples_within(model, POSES, times);
    let (wanted, orientation) = (variables(model), has_orientations(model));
    let (mut at, mut broken, info) = (Poses::default(), Vec::new(), model.info());
    model.poses(&statuses, &values, &wanted, orientation, &mut at)?;
    for (k, &variable) in wanted.iter().enumerate() {
        let column = |list: &[[f64; 3]]| -> Vec<Vector3<f64>> {
            (0..list.len() / wanted.len()).map(|pose| list[pose * wanted.len() + k].into()).collect()
        };
        let (moves, turns) = (column(&at.position_derivatives), column(&at.rotation_derivatives));
        let largest = moves.iter().chain(&turns).map(Vector3::norm).fold(0.0, f64::max);
        // A step that moves the tip by a micrometre; if nothing seems to move, 1e-3 in the unit of the variable. Shapes of
        // functions get a smaller step, because they change the phase much more at the end of a long axis.
        let step = match variable {
            Variable::Parameter(index) if info.parameters[index].role == ParameterRole::Shape => {
                shape_step(info, index)
            }
            _ if largest > 1e-9 => 1e-3 / largest,
            _ => 1e-3,
        };
        let shifted = |step: f64| -> Result<Poses> {
            let (mut statuses, mut values, mut out) = (statuses.clone(), values.clone(), Poses::default());
            match variable {
                Variable::Parameter(index) => values[index] += step,
                Variable::Command(index) => {
                    let column = info.axes[index].status;
                    let width = info.status.len();
                    statuses.chunks_exact_mut(width).for_each(|status| status[column] += step);
                }
            }
            model.poses(&statuses, &values, &[], orientation, &mut out)?;
            Ok(out)
        };
        let (over, under) = (shifted(step)?, shifted(-step)?);
        let moved =
            |pose: usize| (Vector3::from(over.positions[pose]) - Vector3::from(under.positions[pose])) / (2.0 * step);
        let turned =
            |pose: usize| (unit(over.orientations[pose]) / unit(under.orientations[pose])).scaled_axis() / (2.0 * step);
        let off = |given: &[Vector3<f64>], found: &dyn Fn(usize) -> Vector3<f64>| {
            (0..given.len()).map(|pose| (given[pose] - found(pose)).norm()).fold(0.0, f64::max)
        };
        // If the derivative is zero, the difference has to be zero within rounding.
        let allowed = TOLERANCE * largest + 1e-9;
        for (kind, off) in [("position", off(&moves, &moved)), ("rotation", off(&turns, &turned))] {
            if off.is_nan() || off > allowed {
                let what = named(model, variable);
                broken.push(format!(
                    "the derivative of the {kind} to {what} is off by {off:.3e}; its largest size is {largest:.3e}"
                ));
            }
        }
    }
    Ok(broken)
}

/// The step of a parameter of the shape of a function: a small part of its nominal value, if that is not zero.
fn shape_step(info: &ModelInfo, index: usize) -> f64 {
    3e-7 * if info.nominal[index] == 0.0 { 1.0 } else { info.nominal[index].abs() }
}

fn named(model: &dyn KinematicModel, variable: Variable) -> String {
    match variable {
        Variable::Parameter(index) => model.info().parameters[index].name.clone(),
        Variable::Command(index) => format!("the command of {}", model.info().axes[index].name),
    }
}

fn unit([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// Checks that every pose of a batch is the same alone and without derivatives.
fn alone_and_together(model: &dyn KinematicModel, times: [f64; 2]) -> Result<Vec<String>> {
    let (statuses, values) = samples_within(model, POSES, times);
    let orientation = has_orientations(model);
    let (mut together, mut alone) = (Poses::default(), Poses::default());
    model.poses(&statuses, &values, &variables(model), orientation, &mut together)?;
    let mut differs = false;
    for (pose, status) in statuses.chunks_exact(model.info().status.len().max(1)).enumerate() {
        model.poses(status, &values, &[], orientation, &mut alone)?;
        let pairs = alone.positions[0].iter().zip(&together.positions[pose]);
        differs |= pairs.clone().any(|(one, other)| !agrees(*one, *other, 1e-12));
        if orientation {
            let angle = unit(alone.orientations[0]).angle_to(&unit(together.orientations[pose]));
            differs |= angle.is_nan() || angle > 1e-7;
        }
    }
    let sentence = "a pose is another one alone, without derivatives, than among others with them";
    Ok(Vec::from_iter(differs.then(|| sentence.to_owned())))
}

/// Checks motion errors, and so the functions of error families: derivatives against difference quotients, for every
/// coefficient.
fn motion_errors(model: &dyn KinematicModel, times: [f64; 2]) -> Result<Vec<String>> {
    let (statuses, values) = samples_within(model, POSES, times);
    let mut broken = Vec::new();
    for function in &model.info().error_functions {
        for status in statuses.chunks_exact(model.info().status.len().max(1)) {
            let found = motion_error(model, function, status, &values)?;
            broken.extend(found);
            if !broken.is_empty() {
                return Ok(broken);
            }
        }
    }
    Ok(broken)
}

fn motion_error(
    model: &dyn KinematicModel,
    function: &ErrorFunction,
    status: &[f64],
    values: &[f64],
) -> Result<Vec<String>> {
    let at = model.motion_error(function, values, status)?;
    let mut broken = Vec::new();
    for (index, parameter) in model.info().parameters.iter().enumerate() {
        let given: f64 = at.derivatives.iter().filter(|by| by.0 == index).map(|by| by.1).sum();
        let ErrorFunction { axis, component, symbol, .. } = function;
        let own = parameter.role == ParameterRole::Motion { axis: *axis, component: *component };
        if !own && given == 0.0 {
            continue;
        }
        let info = model.info();
        let step = if parameter.role == ParameterRole::Shape { shape_step(info, index) } else { 1e-5 };
        let shifted = |step: f64| {
            let mut values = values.to_vec();
            values[index] += step;
            model.motion_error(function, &values, status).map(|error| error.value)
        };
        let found = (shifted(step)? - shifted(-step)?) / (2.0 * step);
        if (given - found).abs() > TOLERANCE * given.abs().max(found.abs()) + 1e-9 {
            broken.push(format!(
                "the derivative of {symbol} to {} is {found:.6e} by differences, and given as {given:.6e}",
                parameter.name
            ));
        }
    }
    Ok(broken)
}

#[cfg(test)]
mod tests {
    use super::super::virtual_problem;
    use super::*;
    use abbe_core::{MotionError, PoseBatch, PosesMut};

    /// The virtual machine, spoilt.
    struct Spoilt {
        machine: std::sync::Arc<dyn KinematicModel>,
        info: ModelInfo,
        spoil: fn(&mut PosesMut<'_>),
        /// It tells no derivatives of its motion errors.
        silent: bool,
    }

    impl KinematicModel for Spoilt {
        fn info(&self) -> &ModelInfo {
            &self.info
        }

        fn evaluate(&self, batch: PoseBatch<'_>, mut out: PosesMut<'_>) -> Result<()> {
            let PosesMut { positions, orientations, position_derivatives, rotation_derivatives } = &mut out;
            let lent = PosesMut { positions, orientations, position_derivatives, rotation_derivatives };
            self.machine.evaluate(batch, lent)?;
            (self.spoil)(&mut out);
            Ok(())
        }

        fn motion_error(&self, function: &ErrorFunction, values: &[f64], status: &[f64]) -> Result<MotionError> {
            let error = self.machine.motion_error(function, values, status)?;
            Ok(if self.silent { MotionError { derivatives: Vec::new(), ..error } } else { error })
        }
    }

    fn spoilt() -> Spoilt {
        let machine = virtual_problem().unwrap().0.model;
        Spoilt { info: machine.info().clone(), machine, spoil: |_| {}, silent: false }
    }

    #[test]
    fn the_virtual_machine_keeps_the_laws() {
        assert_eq!(check_model(&spoilt()), Vec::<String>::new());
    }

    #[test]
    fn a_wrong_slope_is_found() {
        let spoil = |out: &mut PosesMut<'_>| out.position_derivatives.iter_mut().for_each(|by| by[0] *= 1.001);
        let found = check_model(&Spoilt { spoil, ..spoilt() });
        assert!(found[0].starts_with("the derivative of the position to EXX[1] is off by"), "{found:#?}");
    }

    #[test]
    fn a_pose_that_hangs_on_others_is_found() {
        let spoil = |out: &mut PosesMut<'_>| {
            let last = out.positions.len() - 1;
            out.positions[last][2] += if last > 0 { 1e-9 } else { 0.0 };
        };
        let found = check_model(&Spoilt { spoil, ..spoilt() });
        assert!(found.iter().any(|law| law.contains("another one alone")), "{found:#?}");
    }

    #[test]
    fn names_that_stand_twice_are_found() {
        let mut spoilt = spoilt();
        spoilt.info.parameters[1].name = "EXX[1]".to_owned();
        assert_eq!(check_model(&spoilt), ["`EXX[1]` stands twice"]);
    }

    #[test]
    fn what_is_of_no_axis_is_found() {
        let (mut status, mut axis) = (spoilt(), spoilt());
        status.info.status[0].role = StatusRole::Direction(3);
        axis.info.axes[2].status = 3;
        for spoilt in [status, axis] {
            assert_eq!(check_model(&spoilt), ["an axis has no status, or a status is of an axis that is not there"]);
        }
    }

    #[test]
    fn a_coefficient_that_an_error_does_not_tell_is_found() {
        let found = check_model(&Spoilt { silent: true, ..spoilt() });
        assert!(found[0].starts_with("the derivative of EXX to EXX[1] is"), "{found:#?}");
    }
}
