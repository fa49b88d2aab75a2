//! Proves the analytic derivatives of position and rotation to every error of every slot and to every command, at
//! errors that are not zero, against differences.

use abbe_kinematics::{Chain, Errors, Evaluation};
use nalgebra::Vector3;

use crate::oracle::{Machine, Random, rotation_vector};
use crate::subject;

/// Central differences at two steps, extrapolated to none: position and rotation vector.
fn differences(step: f64, mut at: impl FnMut(f64) -> Evaluation) -> (Vector3<f64>, Vector3<f64>) {
    let mut central = |step: f64| {
        let (above, below) = (at(step), at(-step));
        let turned = rotation_vector(&(above.rotation * below.rotation.transpose()));
        ((above.position - below.position) / (2.0 * step), turned / (2.0 * step))
    };
    let (wide, narrow) = (central(step), central(0.5 * step));
    ((narrow.0 * 4.0 - wide.0) / 3.0, (narrow.1 * 4.0 - wide.1) / 3.0)
}

/// The largest deviation of derivatives of one kind, and the largest derivative.
#[derive(Default)]
struct Deviation {
    deviation: f64,
    largest: f64,
}

impl Deviation {
    fn add(&mut self, analytic: Vector3<f64>, difference: Vector3<f64>) {
        self.deviation = self.deviation.max((analytic - difference).norm());
        self.largest = self.largest.max(difference.norm());
    }

    fn relative(&self) -> f64 {
        if self.deviation == 0.0 { 0.0 } else { self.deviation / self.largest }
    }
}

type Evaluate = fn(&Machine, &Chain, &[f64], &[Errors]) -> Evaluation;

/// The largest relative deviation over random chains.
pub fn worst(seeds: std::ops::Range<u64>, evaluate: Evaluate) -> f64 {
    let mut worst = 0.0_f64;
    for seed in seeds {
        let random = &mut Random::new(seed);
        let machine = Machine::random(random);
        let chain = subject::chain(&machine);
        let commands = machine.random_commands(random);
        let (mm, rad) = if seed % 4 == 3 { (50.0, 0.3) } else { (0.5, 1e-3) };
        let slots = subject::slots(&chain, &machine.random_errors(random, mm, rad));
        let analytic = evaluate(&machine, &chain, &commands, &slots);
        // By translations, by angles, by commands; of positions and of rotations.
        let mut kinds: [Deviation; 6] = Default::default();
        for slot in 0..chain.slots() {
            for component in 0..6 {
                let step = if component < 3 { 1.0 } else { 2e-3 };
                let (position, rotation) = differences(step, |by| {
                    let mut slots = slots.clone();
                    slots[slot][component] += by;
                    evaluate(&machine, &chain, &commands, &slots)
                });
                let kind = usize::from(component >= 3);
                kinds[kind].add(analytic.by_error[slot][component], position);
                kinds[3 + kind].add(analytic.turn_by_error[slot][component], rotation);
            }
        }
        for (index, axis) in machine.axes.iter().enumerate() {
            let (position, rotation) = differences(if axis.rotary { 2e-3 } else { 1.0 }, |by| {
                let mut commands = commands.clone();
                commands[index] += by;
                evaluate(&machine, &chain, &commands, &slots)
            });
            kinds[2].add(analytic.by_command[index], position);
            kinds[5].add(analytic.turn_by_command[index], rotation);
        }
        for kind in &kinds {
            // Translations turn nothing; what rounding makes of that is no derivative to be relative to.
            if kind.largest > 1e-9 {
                worst = worst.max(kind.relative());
            } else {
                assert!(kind.deviation < 1e-12, "chain {seed}: {:e}", kind.deviation);
            }
        }
    }
    worst
}

#[test]
fn derivatives_are_those_of_the_differences() {
    let worst = worst(0..24, subject::evaluate);
    println!("largest deviation of a derivative: {worst:.1e} of the largest of its kind");
    assert!(worst < 1e-7, "{worst:e}");
}
