//! A run that stands in the data once more under another number.

use crate::displaced::OfRun;

/// Fewest runs: with fewer than two beside the copy and what it is of, runs that differ are the exception.
const RUNS: usize = 4;

/// Fewest readings of a run.
const READINGS: usize = 5;

/// Probability below which two runs do not agree in all readings by chance, all pairs together.
const BY_CHANCE: f64 = 1e-5;

/// Differences that are no farther apart than this are the same, µm or µrad.
const ROUNDING: f64 = 1e-6;

/// Two runs, by their places, whose readings are the same to the last digit, where no other two are. Readings have steps of `digit`, or none.
///
/// How often readings agree by chance is seen of the other two runs that agree most, as they are or with a shift: machines that settle, and
/// coarse digits, agree often. Exact instruments, whose runs are all the same, tell nothing.
pub fn copied_run(runs: &[&OfRun], digit: f64) -> Option<[usize; 2]> {
    let count = runs.first()?.len();
    if runs.len() < RUNS || count < READINGS || runs.iter().any(|run| !run.keys().eq(runs[0].keys())) {
        return None;
    }
    let (mut copied, mut most) = (Vec::new(), 0);
    for (one, of_one) in runs.iter().enumerate() {
        for (other, of_other) in runs.iter().enumerate().skip(one + 1) {
            let apart: Vec<f64> = of_one.values().zip(of_other.values()).map(|(one, other)| one - other).collect();
            if apart.iter().all(|apart| *apart == 0.0) {
                copied.push([one, other]);
            } else {
                most = most.max(alike(apart, digit));
            }
        }
    }
    let [pair] = copied[..] else { return None };
    let chance = (most as f64 + 1.0) / (count as f64 + 1.0);
    let pairs = (runs.len() * (runs.len() - 1) / 2) as f64;
    (pairs * chance.powf(count as f64) < BY_CHANCE).then_some(pair)
}

/// Most differences that are within one digit of each other: a shift by a part of a digit makes two of one.
fn alike(mut apart: Vec<f64>, digit: f64) -> usize {
    apart.sort_by(f64::total_cmp);
    let within =
        |first: usize| apart[first..].iter().take_while(|own| **own <= apart[first] + digit + ROUNDING).count();
    (0..apart.len()).map(within).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// Runs up and down with noise, drift that settles, and digits of a step, µm.
    fn runs(random: &mut Generator, noise: f64, step: f64) -> Vec<OfRun> {
        let (targets, count) = (3 + random.index(20), 2 + random.index(9));
        let drift = [0.0, 5.0 * random.uniform()][random.index(2)];
        let errors: Vec<f64> = (0..2 * targets).map(|_| 10.0 * random.uniform()).collect();
        let both_ways = random.index(4) > 0;
        let run = |run: usize| {
            let keys = (0..targets).flat_map(|target| [(target, true), (target, false)]);
            let shift = drift * (-(run as f64)).exp();
            let reading = |random: &mut Generator, (target, up): (usize, bool)| {
                let error = errors[2 * target + usize::from(up)] + shift + noise * random.normal();
                if step > 0.0 { (error / step).round() * step } else { error }
            };
            keys.filter(|(_, up)| *up || both_ways).map(|key| (key, reading(random, key))).collect()
        };
        (0..count).map(run).collect()
    }

    #[test]
    fn good_runs_are_no_copies() {
        for seed in 0..5000 {
            let mut random = Generator::new(seed, 1);
            // Exact ones, and digits far coarser than the noise.
            let noise = [0.0, 0.02, 0.05, 0.1, 0.2, 0.5][random.index(6)];
            let step = [0.0, 0.01, 0.1, 0.2, 0.5, 1.0][random.index(6)];
            let mut all = runs(&mut random, noise, step);
            // One of them off as a whole.
            if seed % 3 == 0 {
                let off = random.index(all.len());
                all[off].values_mut().for_each(|reading| *reading += 3.0);
            }
            let all: Vec<&OfRun> = all.iter().collect();
            assert_eq!(copied_run(&all, step), None, "{seed}: noise {noise}, step {step}");
        }
    }

    #[test]
    fn a_run_under_a_new_number_is_told() {
        let mut counts = [0; 2];
        for seed in 0..600 {
            let mut random = Generator::new(seed, 2);
            let mut all = runs(&mut random, 0.5, 0.1);
            if all.len() < 3 || all[0].len() < 14 {
                continue;
            }
            let of = random.index(all.len());
            all.push(all[of].clone());
            let all: Vec<&OfRun> = all.iter().collect();
            counts[0] += 1;
            counts[1] += usize::from(copied_run(&all, 0.1) == Some([of, all.len() - 1]));
        }
        assert!(counts[0] > 200 && 10 * counts[1] > 9 * counts[0], "{counts:?}");
    }
}
