//! Proves that `Chain::evaluate` gives position and rotation as the conventions' section 2 says, for any chain.

use abbe_kinematics::Derivatives;

use crate::oracle::{Machine, Random, place, turn};
use crate::subject;

#[test]
fn poses_are_those_of_the_conventions() {
    let (mut farthest, mut most_turned) = (0.0_f64, 0.0_f64);
    for seed in 0..150 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        for (mm, rad) in [(0.0, 0.0), (0.5, 1e-3), (0.5, 1e-3), (50.0, 0.3)] {
            let commands = machine.random_commands(random);
            let errors = machine.random_errors(random, mm, rad);
            let expected = machine.tool_in_table(&commands, &errors);
            let found = subject::evaluate(&machine, &chain, &commands, &subject::slots(&chain, &errors));
            let size = machine.size(&commands) + mm;
            farthest = farthest.max((found.position - place(&expected)).norm() / size);
            most_turned = most_turned.max((found.rotation - turn(&expected)).norm());
            let [w, x, y, z] = found.quaternion();
            let quaternion = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
            most_turned = most_turned.max((quaternion.to_rotation_matrix().matrix() - turn(&expected)).norm());
        }
    }
    println!("largest deviation: position {farthest:.1e} of its size, rotation {most_turned:.1e}");
    assert!(farthest < 1e-12 && most_turned < 1e-12, "{farthest:e} {most_turned:e}");
}

#[test]
fn one_evaluation_may_serve_chains_of_any_size() {
    // Buffers are handed in again and again: nothing of the chain before may stay in them.
    let mut used = abbe_kinematics::Evaluation::default();
    for seed in 0..40 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        let commands = machine.random_commands(random);
        let slots = subject::slots(&chain, &machine.random_errors(random, 0.5, 1e-3));
        chain.evaluate(
            &commands,
            &slots,
            &machine.tip,
            Derivatives::OfPositionAndRotation(&vec![true; chain.slots()]),
            &mut used,
        );
        let fresh = subject::evaluate(&machine, &chain, &commands, &slots);
        assert_eq!((used.position, used.rotation), (fresh.position, fresh.rotation));
        assert_eq!((&used.by_error, &used.turn_by_error), (&fresh.by_error, &fresh.turn_by_error));
        assert_eq!((&used.by_command, &used.turn_by_command), (&fresh.by_command, &fresh.turn_by_command));
    }
}
