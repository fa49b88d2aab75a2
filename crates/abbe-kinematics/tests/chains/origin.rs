//! Proves that predictions do not depend on where the machine origin is: points of rotary axes, the tip and the errors
//! that turn about the origin are moved, and the tool stays where it was relative to the table.

use nalgebra::Vector3;

use crate::oracle::{Machine, MachineErrors, Random, error_matrix, place, translation};
use crate::subject;

/// An error that turns about the origin, written about an origin that is moved by `v`.
fn about(errors: &mut [f64; 6], v: Vector3<f64>) {
    let moved = place(&(translation(-v) * error_matrix(errors) * translation(v)));
    errors[..3].copy_from_slice(moved.as_slice());
}

/// The same machine with its origin moved by `v`; also how far the table frame moves with the origin.
///
/// A rotary axis carries frames of its own: what comes after it depends on its point. So only what stands between the bed
/// and the first rotary axis of a branch notices, and the tip or the table frame if the branch has no rotary axis.
fn moved(machine: &Machine, errors: &MachineErrors, v: Vector3<f64>) -> (Machine, MachineErrors, Vector3<f64>) {
    let (mut machine, mut errors) = (machine.clone(), errors.clone());
    for axis in &mut machine.axes {
        axis.point -= v;
    }
    let sides: [Vec<usize>; 2] = [(0..machine.bed).rev().collect(), (machine.bed..machine.axes.len()).collect()];
    let [mut carried, mut tipped] = [v, v];
    for (side, frame) in sides.iter().zip([&mut carried, &mut tipped]) {
        for &axis in side {
            if machine.axes[axis].rotary {
                *frame = Vector3::zeros();
                break;
            }
            about(&mut errors.location[axis], v);
            about(&mut errors.motion[axis], v);
        }
    }
    machine.tip -= tipped;
    about(&mut errors.workpiece, carried);
    (machine, errors, carried)
}

#[test]
fn predictions_do_not_depend_on_the_origin() {
    let mut farthest = [0.0_f64; 2];
    let mut kinds = [0; 4];
    for seed in 0..120 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let rotary = |range: std::ops::Range<usize>| machine.axes[range].iter().any(|axis| axis.rotary);
        let kind = 2 * usize::from(rotary(0..machine.bed)) + usize::from(rotary(machine.bed..machine.axes.len()));
        kinds[kind] += 1;
        for (with_errors, (mm, rad)) in [(0.0, 0.0), (0.5, 1e-3)].into_iter().enumerate() {
            let errors = machine.random_errors(random, mm, rad);
            let v = random.vector(500.0);
            let (other, other_errors, frame) = moved(&machine, &errors, v);
            let (chain, other_chain) = (subject::chain(&machine), subject::chain(&other));
            let commands = machine.random_commands(random);
            let here = subject::evaluate(&machine, &chain, &commands, &subject::slots(&chain, &errors));
            let slots = subject::slots(&other_chain, &other_errors);
            let there = subject::evaluate(&other, &other_chain, &commands, &slots);
            let size = machine.size(&commands) + other.size(&commands);
            let deviation = (there.position + frame - here.position).norm() / size;
            farthest[with_errors] = farthest[with_errors].max(deviation);
            assert!((there.rotation - here.rotation).norm() < 1e-13);
        }
    }
    assert!(kinds.iter().all(|&count| count > 3), "each branch with and without a rotary axis: {kinds:?}");
    println!("largest deviation of the size: {:.1e} without, {:.1e} with errors", farthest[0], farthest[1]);
    assert!(farthest.iter().all(|&deviation| deviation < 1e-12), "{farthest:?}");
}
