//! Proves that `Chain::evaluate` gives position and rotation as the conventions' section 2 says, for any chain.

use abbe_kinematics::{Derivatives, Evaluations, Given};

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

#[test]
fn poses_side_by_side_are_those_that_each_is_alone() {
    for seed in 0..150 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        let mut all = Evaluations::side_by_side();
        let poses = all.poses();
        // Some errors are zero, small or large in some of the poses only.
        let sizes = [(0.0, 0.0), (0.5, 1e-3), (50.0, 0.3)];
        let each: Vec<(Vec<f64>, Vec<[f64; 6]>)> = (0..poses)
            .map(|_| {
                let (mm, rad) = sizes[random.below(3)];
                let errors = subject::slots(&chain, &machine.random_errors(random, mm, rad));
                let commands = machine.random_commands(random);
                (if random.below(4) == 0 { vec![0.0; commands.len()] } else { commands }, errors)
            })
            .collect();
        let [commands, errors, tips] = subject::beside(&machine, &each);
        let given = Given { commands: &commands, errors: &errors, tips: &tips };
        all.evaluate(&chain, given, Derivatives::OfPositionAndRotation(&vec![true; chain.slots()]));
        for (number, (commands, errors)) in each.iter().enumerate() {
            let (pose, alone) = (all.pose(number), subject::evaluate(&machine, &chain, commands, errors));
            assert_eq!((pose.position(), pose.rotation()), (alone.position, alone.rotation));
            for (slot, component) in (0..chain.slots()).flat_map(|slot| (0..6).map(move |component| (slot, component)))
            {
                assert_eq!(pose.of_position().error(slot, component), alone.by_error[slot][component]);
                assert_eq!(pose.of_rotation().error(slot, component), alone.turn_by_error[slot][component]);
            }
            for axis in 0..chain.axes().len() {
                assert_eq!(pose.of_position().command(axis), alone.by_command[axis]);
                assert_eq!(pose.of_rotation().command(axis), alone.turn_by_command[axis]);
            }
        }
    }
}
