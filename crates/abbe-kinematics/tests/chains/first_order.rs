//! Proves that the first-order form misses the exact one by the square of the errors, that both have the same
//! derivative at zero, and that first-order evaluations have the derivatives of themselves.

use abbe_kinematics::{Chain, Derivatives, Errors, Evaluation, Evaluations, Given};

use crate::oracle::{Machine, Random, rotation_vector};
use crate::{derivatives, subject};

fn first_order(machine: &Machine, chain: &Chain, commands: &[f64], slots: &[Errors]) -> Evaluation {
    let mut out = Evaluation::default();
    chain.evaluate_first_order(commands, slots, &machine.tip, &mut out);
    out
}

fn scaled(slots: &[Errors], by: f64) -> Vec<Errors> {
    slots.iter().map(|errors| errors.map(|error| error * by)).collect()
}

#[test]
fn what_linearising_costs_shrinks_with_the_square() {
    let mut farthest = 0.0_f64;
    for seed in 0..40 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        let commands = machine.random_commands(random);
        let slots = subject::slots(&chain, &machine.random_errors(random, 0.5, 1e-3));
        let costs: Vec<(f64, f64)> = (0..4)
            .map(|halvings| {
                let slots = scaled(&slots, 0.5_f64.powi(halvings));
                let exact = subject::evaluate(&machine, &chain, &commands, &slots);
                let linear = first_order(&machine, &chain, &commands, &slots);
                let turned = rotation_vector(&(exact.rotation * linear.rotation.transpose()));
                ((exact.position - linear.position).norm(), turned.norm())
            })
            .collect();
        for pair in costs.windows(2) {
            for ratio in [pair[0].0 / pair[1].0, pair[0].1 / pair[1].1] {
                farthest = farthest.max((ratio / 4.0 - 1.0).abs());
                assert!((ratio / 4.0 - 1.0).abs() < 0.1, "chain {seed}: {ratio} of {costs:?}");
            }
        }
    }
    println!("largest deviation of the ratio from 4: {:.1} %", 100.0 * farthest);
}

#[test]
fn the_sum_of_matrices_is_the_sum_of_derivatives() {
    // `first_order` is Soons' sum of 6 x 6 matrices, `evaluate_first_order` a sum of derivatives at zero.
    let mut farthest = 0.0_f64;
    for seed in 0..40 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        let commands = machine.random_commands(random);
        let size = machine.size(&commands);
        let none = vec![[0.0; 6]; chain.slots()];
        let exact = subject::evaluate(&machine, &chain, &commands, &none);
        let nominal = chain.first_order(&commands, &none, &machine.tip);
        assert_eq!(nominal, exact.position);
        for slot in 0..chain.slots() {
            for component in 0..6 {
                let mut one = none.clone();
                // The form is linear, so any size will do; this one leaves no digit of the difference to rounding.
                one[slot][component] = if component < 3 { size } else { 1.0 };
                let effect = chain.first_order(&commands, &one, &machine.tip) - nominal;
                let expected = exact.by_error[slot][component] * one[slot][component];
                farthest = farthest.max((effect - expected).norm() / size);
            }
        }
        let slots = subject::slots(&chain, &machine.random_errors(random, 50.0, 0.3));
        let sum = first_order(&machine, &chain, &commands, &slots).position;
        let matrices = chain.first_order(&commands, &slots, &machine.tip);
        farthest = farthest.max((sum - matrices).norm() / (size + 1e3));
    }
    println!("largest deviation: {farthest:.1e} of the machine's size");
    assert!(farthest < 1e-12, "{farthest:e}");
}

#[test]
fn first_order_evaluations_have_the_derivatives_of_themselves() {
    let worst = derivatives::worst(0..20, first_order);
    println!("largest deviation of a derivative: {worst:.1e} of the largest of its kind");
    assert!(worst < 1e-7, "{worst:e}");
}

/// Without derivatives, several poses are evaluated at once, in another way: the nominal one, and the errors beside it.
#[test]
fn first_order_poses_without_derivatives_are_the_same() {
    let mut farthest = 0.0_f64;
    for seed in 0..400 {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        let mut all = if seed % 4 == 0 { Evaluations::one() } else { Evaluations::side_by_side() };
        let poses: Vec<(Vec<f64>, Vec<Errors>)> = (0..all.poses())
            .map(|_| {
                let slots = subject::slots(&chain, &machine.random_errors(random, 50.0, 0.3));
                (machine.random_commands(random), slots)
            })
            .collect();
        let [commands, errors, tips] = subject::beside(&machine, &poses);
        let given = Given { commands: &commands, errors: &errors, tips: &tips };
        all.evaluate_first_order(&chain, given, Derivatives::None, true);
        for (pose, (commands, slots)) in poses.iter().enumerate() {
            let expected = first_order(&machine, &chain, commands, slots);
            let off = (all.pose(pose).position() - expected.position).norm() / (machine.size(commands) + 1e3);
            let turned = (all.pose(pose).rotation() - expected.rotation).norm();
            farthest = farthest.max(off).max(turned);
        }
    }
    println!("largest deviation: {farthest:.1e}");
    assert!(farthest < 1e-12, "{farthest:e}");
}
