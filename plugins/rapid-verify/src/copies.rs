//! Runs whose readings are those of the baseline or of an earlier run to the last digit: all of them, or more than chance makes.

use std::f64::consts::PI;

use abbe_numerics::{binomial_upper_tail, resolution};

/// With fewer points than this, readings of two runs may be the same by chance.
const FEW: usize = 5;

/// Probability below which readings of two runs do not agree by chance.
const BY_CHANCE: f64 = 1e-8;

/// Probability below which readings that follow each other do not agree by chance with those of one other run: with sixty other runs, less
/// than once in a thousand.
const IN_TURN_BY_CHANCE: f64 = 1e-5;

/// How many times as quiet as it is stated a healthy machine may be.
const QUIETER: f64 = 2.0;

/// Part of the readings that differ which have to do so by more than one step of the digits: else the machine is so quiet, and its digits
/// are so coarse, that the others agree by themselves.
const APART: f64 = 0.5;

/// Readings of a run that are those of another one.
#[derive(Debug, Clone, PartialEq)]
pub struct Copied {
    /// The name of the other run, or `the baseline`.
    pub of: String,
    /// How many readings are the same.
    pub same: usize,
    /// How many there are.
    pub all: usize,
}

impl Copied {
    /// The remark on a run.
    pub fn remark(&self, run: &str) -> String {
        let Self { of, same, all } = self;
        if same == all {
            return format!(
                "{run}: all readings are those of {of} to the last digit: is it a copy of that file? Then it says nothing about the machine \
                 of today"
            );
        }
        format!(
            "{run}: {same} of {all} readings are those of {of} to the last digit, far more than chance makes of digits that are finer than \
             healthy runs scatter: were these rows copied? Then they say nothing about the machine of today"
        )
    }
}

/// What the readings of a run, mm, are copies of: the run with the most of them, with its name, among `others`. `scatter` is the standard
/// deviation of the difference of one reading between healthy runs, mm; coarser digits agree by chance.
pub fn copied<'a>(readings: &[f64], others: impl Iterator<Item = (&'a str, Vec<f64>)>, scatter: f64) -> Option<Copied> {
    let all = readings.len();
    if all < FEW {
        return None;
    }
    let others: Vec<(&str, Vec<f64>)> = others.collect();
    let found = others.iter().enumerate().filter_map(|(place, (name, other))| {
        let same = same(readings, other);
        let is_told = match same == all {
            true => !digits_explain(readings, scatter, usual(&others, place)),
            false => is_beyond_chance(readings, other, same, scatter),
        };
        is_told.then_some((*name, same))
    });
    // The first of those that have the most.
    let most = found.reduce(|most, next| if next.1 > most.1 { next } else { most });
    most.map(|(of, same)| Copied { of: of.to_owned(), same, all })
}

fn same(one: &[f64], other: &[f64]) -> usize {
    one.iter().zip(other).filter(|(one, other)| one == other).count()
}

/// The largest part of the readings that two of these runs have in common, without the one at a place and without copies.
fn usual(runs: &[(&str, Vec<f64>)], without: usize) -> f64 {
    let kept: Vec<&Vec<f64>> =
        runs.iter().enumerate().filter(|(place, _)| *place != without).map(|(_, (_, run))| run).collect();
    let pairs = kept.iter().enumerate().flat_map(|(place, one)| kept[..place].iter().map(|other| same(one, other)));
    let all = runs[without].1.len();
    pairs.filter(|same| *same < all).max().unwrap_or_default() as f64 / all.max(1) as f64
}

/// The chance that one reading is the same in two healthy runs, with digits of this step.
fn chance(step: f64, scatter: f64) -> f64 {
    // The density of a normal difference is largest at zero.
    (step * QUIETER / ((2.0 * PI).sqrt() * scatter)).min(1.0)
}

/// Whether all readings of two healthy runs may be the same because digits are coarser than these scatter, by what is stated or by the
/// part of them that is usually the same.
fn digits_explain(readings: &[f64], scatter: f64, usual: f64) -> bool {
    let all = readings.len().min(1000) as i32;
    resolution(readings).is_some_and(|step| chance(step, scatter).max(usual).powi(all) > IN_TURN_BY_CHANCE)
}

/// Whether two runs agree in more readings than chance makes of digits of this step.
fn is_beyond_chance(one: &[f64], other: &[f64], same: usize, scatter: f64) -> bool {
    let both = [one, other].concat();
    // Data without noise have no such digits: there points agree that a change does not move.
    let Some(step) = resolution(&both) else { return false };
    let chance = chance(step, scatter);
    let differ: Vec<f64> =
        one.iter().zip(other).map(|(one, other)| (one - other).abs()).filter(|off| *off > 0.0).collect();
    let apart = differ.iter().filter(|off| **off > 1.5 * step).count();
    // So many readings in turn may begin at any of them.
    let of_in_turn = one.len() as f64 * chance.powi(in_turn(one, other).min(1000) as i32);
    let is_rare = binomial_upper_tail(one.len(), chance, same) < BY_CHANCE || of_in_turn < IN_TURN_BY_CHANCE;
    is_rare && apart as f64 >= APART * differ.len() as f64
}

/// Most readings in turn that are the same: rows are copied in blocks.
fn in_turn(one: &[f64], other: &[f64]) -> usize {
    let same: Vec<bool> = one.iter().zip(other).map(|(one, other)| one == other).collect();
    same.chunk_by(|one, next| one == next).filter(|block| block[0]).map(<[bool]>::len).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Readings with noise of a size and digits of a step, both mm, of points that lie anywhere.
    fn run(random: &mut Generator, points: &[f64], noise: f64, step: f64) -> Vec<f64> {
        points.iter().map(|point| ((point + noise * random.normal()) / step).round() * step).collect()
    }

    #[test]
    fn runs_of_machines_that_are_quieter_or_coarser_than_stated_are_no_copies() {
        for seed in 0..4000 {
            let mut random = Generator::new(seed, 1);
            let count = 5 + random.index(60);
            let points: Vec<f64> = (0..count).map(|_| 200.0 * random.uniform()).collect();
            let step = [1e-4, 2e-4, 5e-4, 1e-3][random.index(4)];
            // As stated, up to five times as quiet, or twice as loud.
            let noise = 5e-4 * [0.2, 0.3, 0.5, 1.0, 2.0][random.index(5)] / 2.0_f64.sqrt();
            // A change of the machine moves some of the points only.
            let moved = 0.01 * random.uniform();
            let changed: Vec<f64> =
                points.iter().map(|point| if *point > 0.0 { point + moved } else { *point }).collect();
            let one = run(&mut random, &points, noise, step);
            let other = run(&mut random, if seed % 2 == 0 { &points } else { &changed }, noise, step);
            let found = copied(&other, [("one", one)].into_iter(), 5e-4);
            assert_eq!(found, None, "{seed}: {count} points, step {step}, noise {noise}");
        }
    }

    /// Twenty runs of a machine that repeats within a digit.
    #[test]
    fn runs_of_a_quiet_machine_in_coarse_digits_are_no_copies() {
        let mut agree = 0;
        for seed in 0..300 {
            let mut random = Generator::new(seed, 5);
            let count = 5 + random.index(60);
            let points: Vec<f64> = (0..count).map(|_| 200.0 * random.uniform()).collect();
            let step = [5e-4, 1e-3, 2e-3][random.index(3)];
            // Down to a seventh of what is stated.
            let noise = 5e-4 * [0.1, 0.2, 0.3][random.index(3)];
            let runs: Vec<Vec<f64>> = (0..20).map(|_| run(&mut random, &points, noise, step)).collect();
            for (index, readings) in runs.iter().enumerate() {
                agree += usize::from(runs[..index].contains(readings));
                let earlier = runs[..index].iter().map(|run| ("earlier", run.clone()));
                assert_eq!(copied(readings, earlier, 5e-4), None, "{seed}: {count} points, step {step}, noise {noise}");
            }
        }
        assert!(agree > 500, "{agree} runs are another one");
    }

    #[test]
    fn a_run_that_is_another_one_is_told() {
        for seed in 0..600 {
            let mut random = Generator::new(seed, 6);
            let step = [1e-4, 2e-4][random.index(2)];
            let count = 12 + random.index(60);
            let points: Vec<f64> = (0..count).map(|_| 200.0 * random.uniform()).collect();
            let one = run(&mut random, &points, 4e-4, step);
            let found = copied(&one, [("one", one.clone())].into_iter(), 5e-4);
            assert_eq!(found.map(|found| found.same), Some(count), "{seed}: {count} points, step {step}");
        }
    }

    #[test]
    fn copies_of_most_points_are_told() {
        for (count, kept, told) in
            [(40, 1, true), (40, 8, true), (25, 1, true), (25, 3, true), (40, 36, false), (40, 40, false)]
        {
            for seed in 0..200 {
                let mut random = Generator::new(seed, 2);
                let points: Vec<f64> = (0..count).map(|_| 200.0 * random.uniform()).collect();
                let [one, mut other] = [0, 1].map(|_| run(&mut random, &points, 4e-4, 1e-4));
                other[kept..].copy_from_slice(&one[kept..]);
                let found = copied(&other, [("b", one.clone())].into_iter(), 5e-4);
                // One reading that is a step off, or the same by chance.
                let is_other = (0..kept).all(|point| (one[point] - other[point]).abs() > 1.5e-4);
                assert!(found.is_some() == told || (told && !is_other), "{count} {kept} {seed}: {found:?}");
            }
        }
    }

    #[test]
    fn blocks_of_a_third_of_the_points_are_told() {
        for (count, block) in [(25, 9), (25, 17), (40, 11)] {
            for seed in 0..300 {
                let mut random = Generator::new(seed, 3);
                let points: Vec<f64> = (0..count).map(|_| 200.0 * random.uniform()).collect();
                let [one, mut other] = [0, 1].map(|_| run(&mut random, &points, 4e-4, 1e-4));
                other.iter_mut().for_each(|reading| *reading += 0.01);
                let first = random.index(count - block + 1);
                other[first..first + block].copy_from_slice(&one[first..first + block]);
                let found = copied(&other, [("the baseline", one)].into_iter(), 5e-4);
                assert!(found.is_some(), "{count} {block} {seed}");
            }
        }
    }

    /// The points that a change moves stand side by side, as those of one facet do, and the others agree as healthy runs do.
    #[test]
    fn points_side_by_side_that_a_change_does_not_move_are_no_copies() {
        let mut told = 0;
        for seed in 0..4000 {
            let mut random = Generator::new(seed, 4);
            let count = 8 + random.index(60);
            let points: Vec<f64> = (0..count).map(|_| 200.0 * random.uniform()).collect();
            let step = [1e-4, 2e-4, 5e-4, 1e-3][random.index(4)];
            let noise = 5e-4 * [0.5, 0.7, 1.0, 2.0][random.index(4)] / 2.0_f64.sqrt();
            let from = random.index(count);
            let changed: Vec<f64> = points
                .iter()
                .enumerate()
                .map(|(place, point)| point + if place > from { 0.012 } else { 0.0 })
                .collect();
            let one = run(&mut random, &points, noise, step);
            let other = run(&mut random, &changed, noise, step);
            let found = copied(&other, [("one", one)].into_iter(), 5e-4);
            told += usize::from(found.is_some_and(|found| found.same < found.all));
        }
        assert_eq!(told, 0);
    }

    /// Noise-free runs agree where a change moves nothing.
    #[test]
    fn exact_runs_are_told_only_where_all_agree() {
        let one: Vec<f64> = (0..30).map(|point| (1e9 * (200.0 * f64::from(point).sin())).round() * 1e-9).collect();
        let mut other = one.clone();
        assert_eq!(copied(&other, [("b", one.clone())].into_iter(), 5e-4).map(|found| found.same), Some(30));
        other[3] += 0.01;
        assert_eq!(copied(&other, [("b", one)].into_iter(), 5e-4), None);
    }
}
