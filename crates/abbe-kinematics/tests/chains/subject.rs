//! Proves nothing by itself: a random machine of the oracle as the chain under test.

use abbe_core::{AxisKind, Branch};
use abbe_kinematics::{Chain, ChainAxis, Derivatives, ErrorFrame, Errors, Evaluation};

use crate::oracle::{Machine, MachineErrors};

pub fn chain(machine: &Machine) -> Chain {
    let axes = machine.axes.iter().enumerate().map(|(index, axis)| ChainAxis {
        name: format!("{}{index}", if axis.rotary { 'C' } else { 'X' }),
        kind: if axis.rotary { AxisKind::Rotary } else { AxisKind::Linear },
        branch: if index < machine.bed { Branch::Workpiece } else { Branch::Tool },
        direction: axis.direction,
        point: axis.point,
        reverse: axis.reverse,
        error_frame: if axis.fixed { ErrorFrame::Fixed } else { ErrorFrame::Moving },
    });
    Chain::new(axes.collect())
}

/// The errors in the order of slots.
pub fn slots(chain: &Chain, errors: &MachineErrors) -> Vec<Errors> {
    let mut all = vec![[0.0; 6]; chain.slots()];
    for axis in 0..chain.axes().len() {
        all[chain.location_slot(axis)] = errors.location[axis];
        all[chain.motion_slot(axis)] = errors.motion[axis];
    }
    all[chain.workpiece_slot()] = errors.workpiece;
    all[chain.tool_slot()] = errors.tool;
    all
}

pub fn evaluate(machine: &Machine, chain: &Chain, commands: &[f64], slots: &[Errors]) -> Evaluation {
    let mut out = Evaluation::default();
    chain.evaluate(
        commands,
        slots,
        &machine.tip,
        Derivatives::OfPositionAndRotation(&vec![true; chain.slots()]),
        &mut out,
    );
    out
}

/// Commands, errors and tips of some poses, those of one axis of all poses one after another, and so on.
pub fn beside(machine: &Machine, poses: &[(Vec<f64>, Vec<Errors>)]) -> [Vec<f64>; 3] {
    let (commands, errors) = &poses[0];
    let all = |count: usize, number: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        (0..count).flat_map(|place| (0..poses.len()).map(move |pose| number(place, pose))).collect()
    };
    [
        all(commands.len(), &|axis, pose| poses[pose].0[axis]),
        all(6 * errors.len(), &|error, pose| poses[pose].1.as_flattened()[error]),
        all(3, &|coordinate, _| machine.tip[coordinate]),
    ]
}
