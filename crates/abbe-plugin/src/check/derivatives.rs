//! Derivatives of machines against differences of their poses.

use abbe_core::{KinematicModel, Poses, Result, Variable};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::Findings;
use super::promises::{machines, samples, variables};
use crate::loader::Library;

/// Poses that are tried.
const POSES: usize = 7;

/// By how much a difference may be off, relative to the largest derivative to its variable.
const TOLERANCE: f64 = 1e-5;

pub(super) fn derivatives(library: &Library, findings: &mut Findings) {
    for (name, machine) in machines(library, findings) {
        let (statuses, values) = samples(machine.as_ref(), 1);
        let turned = machine.evaluate(&statuses, &values, &[], true, &mut Poses::default());
        let orientation = turned.is_ok();
        match turned {
            Ok(()) => {}
            // A machine may have none and say so; what names the plugin is the host's own complaint.
            Err(error) if error.message.starts_with(&format!("the plugin `{name}` of ")) => {
                findings.wrong(error.message)
            }
            Err(error) => findings.skip(format!("orientations of `{name}`: {error}")),
        }
        if let Err(error) = compare(&name, machine.as_ref(), orientation, findings) {
            findings.wrong(format!("`{name}` fails at a pose within its range: {error}"));
        }
    }
}

fn compare(name: &str, machine: &dyn KinematicModel, orientation: bool, findings: &mut Findings) -> Result<()> {
    let (statuses, values) = samples(machine, POSES);
    let wanted = variables(machine);
    let mut at = Poses::default();
    machine.evaluate(&statuses, &values, &wanted, orientation, &mut at)?;
    for (k, &variable) in wanted.iter().enumerate() {
        let column = |list: &[[f64; 3]]| -> Vec<Vector3<f64>> {
            (0..list.len() / wanted.len()).map(|pose| list[pose * wanted.len() + k].into()).collect()
        };
        let (moves, turns) = (column(&at.position_derivatives), column(&at.rotation_derivatives));
        let largest = moves.iter().chain(&turns).map(Vector3::norm).fold(0.0, f64::max);
        // A step that moves the tip by micrometres; a micrometre or microradian itself where nothing seems to move.
        let step = if largest > 0.0 { 1e-3 / largest } else { 1e-3 };
        let shifted = |step: f64| -> Result<Poses> {
            let (mut statuses, mut values, mut out) = (statuses.clone(), values.clone(), Poses::default());
            match variable {
                Variable::Parameter(index) => values[index] += step,
                Variable::Command(index) => {
                    let column = machine.axes()[index].status;
                    statuses.chunks_exact_mut(machine.status().len()).for_each(|status| status[column] += step);
                }
            }
            machine.evaluate(&statuses, &values, &[], orientation, &mut out)?;
            Ok(out)
        };
        let (over, under) = (shifted(step)?, shifted(-step)?);
        let what = match variable {
            Variable::Parameter(index) => machine.parameters()[index].name.clone(),
            Variable::Command(index) => format!("the command of {}", machine.axes()[index].name),
        };
        let difference =
            |pose: usize| (Vector3::from(over.positions[pose]) - Vector3::from(under.positions[pose])) / (2.0 * step);
        let turned =
            |pose: usize| (unit(over.orientations[pose]) / unit(under.orientations[pose])).scaled_axis() / (2.0 * step);
        let off = |found: &[Vector3<f64>], difference: &dyn Fn(usize) -> Vector3<f64>| {
            (0..found.len()).map(|pose| (found[pose] - difference(pose)).norm()).fold(0.0, f64::max)
        };
        // Where nothing moves by the derivative, the difference has to vanish but for rounding.
        let allowed = TOLERANCE * largest + 1e-9;
        for (kind, off) in [("position", off(&moves, &difference)), ("rotation", off(&turns, &turned))] {
            if off.is_nan() || off > allowed {
                findings.wrong(format!(
                    "`{name}`: the derivative of the {kind} to {what} is off by {off:.3e}; its largest size is {largest:.3e}"
                ));
            }
        }
    }
    Ok(())
}

fn unit([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}
