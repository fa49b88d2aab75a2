//! What runs say of their own sensors and encoder: signals that are lost, other units, an encoder that slips a little in every turn.

use std::f64::consts::{PI, TAU};

use abbe_numerics::{Ends, resolution};

use crate::run::{Run, Step};

/// Range of the readings of a radial sensor, in standard deviations of its noise, that noise alone hardly has. It sees the eccentricity and
/// the form of the artefact at least.
const OF_NOISE: f64 = 10.0;

/// The same of an axial sensor, below which not even noise is there: an axial motion may be smaller than the noise.
const WITHOUT_NOISE: f64 = 2.0;

/// How a sensor stands to the axis of the spindle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    Radial,
    Axial,
}

/// Tells of a sensor that moves by no more than its noise, or an axial one by less; `uncertainty` is that of a reading, mm.
pub fn tell_silent(run: &Run, (sensor, name): (Sensor, &str), ends: &Ends, uncertainty: f64) {
    let [low, high] = ends.range().unwrap_or_default();
    if let Some(words) = silent(sensor, high - low, uncertainty) {
        tracing::warn!("run `{}`: {name} {words}: does it see the artefact?", run.label);
    }
}

/// Condition above which angles hardly tell harmonics apart.
const HARDLY_APART: f64 = 10.0;

/// Tells of more harmonics than a turn has readings for, where the angles of many turns hardly tell them apart: order K looks nearly like
/// order n - K of n readings a turn.
pub fn tell_aliased(run: &Run, highest: usize, condition: f64) {
    let readings = run.count as f64 / run.turns;
    if (2 * highest + 1) as f64 > readings && condition > HARDLY_APART {
        tracing::warn!(
            "run `{}`: {readings:.0} readings a turn hardly tell {highest} harmonics apart (condition {condition:.0}): order K looks nearly \
             like order {readings:.0} - K. Their uncertainties come from the scatter of single turns, and are too small then: `harmonics` of \
             {:.0} at most",
            run.label,
            ((readings - 1.0) / 2.0).floor()
        );
    }
}

/// What is wrong with a range of readings, mm.
fn silent(sensor: Sensor, range: f64, uncertainty: f64) -> Option<String> {
    let (of_noise, words) = match sensor {
        Sensor::Radial => (OF_NOISE, "which is what its noise"),
        Sensor::Axial => (WITHOUT_NOISE, "which is less than its noise"),
    };
    (range < of_noise * uncertainty)
        .then(|| format!("moves by {:.3} um, {words} of {:.3} um does", range * 1e3, uncertainty * 1e3))
}

/// Fewest readings whose digits tell, and how many times what is stated the standard uncertainty of their rounding alone has to be.
const READINGS: usize = 100;
const COARSE: f64 = 2.0;

/// Tells of a sensor whose last digit is far coarser than the standard uncertainty of a reading that is stated, mm. `place` is where its
/// readings stand in a step.
pub fn tell_coarse(run: &Run, (place, name): (usize, &str), uncertainty: f64) {
    let readings: Vec<f64> = run.steps.iter().map(|(_, step)| step.readings[place]).collect();
    if let Some(step) = coarse(&readings, uncertainty) {
        tracing::warn!(
            "run `{}`: {name} reads in steps of {:.3} um, and {:.3} um are stated as the uncertainty of a reading: are digits missing?",
            run.label,
            step * 1e3,
            uncertainty * 1e3
        );
    }
}

/// The step of readings, mm, where it is too coarse: what is rounded to steps of q has the standard uncertainty q / sqrt(12) (GUM F.2.2.1).
fn coarse(readings: &[f64], uncertainty: f64) -> Option<f64> {
    let step = resolution(readings).filter(|_| readings.len() >= READINGS)?;
    (step / 12_f64.sqrt() > COARSE * uncertainty).then_some(step)
}

/// Fewest turns of a part of a run, and its angle and size that tell.
const TURNS: usize = 2;
const CREPT: f64 = 3.0 * PI / 180.0;
const CLEAR: f64 = 3.0;

/// Sums over the readings of a sensor in some turns, for their fundamental.
#[derive(Debug, Clone, Default)]
struct Part {
    turns: std::ops::Range<usize>,
    count: f64,
    readings: f64,
    /// Sums of cosine and sine, and of these times readings.
    plain: [f64; 2],
    read: [f64; 2],
}

impl Part {
    fn push(&mut self, reading: f64, [cos, sin]: [f64; 2]) {
        self.count += 1.0;
        self.readings += reading;
        self.plain = [self.plain[0] + cos, self.plain[1] + sin];
        self.read = [self.read[0] + reading * cos, self.read[1] + reading * sin];
    }

    /// Cosine and sine of the fundamental.
    fn fundamental(&self) -> [f64; 2] {
        let mean = self.readings / self.count.max(1.0);
        [0, 1].map(|part| 2.0 * (self.read[part] - mean * self.plain[part]) / self.count.max(1.0))
    }
}

/// The fundamental of a sensor in the first and in the last quarter of a run.
#[derive(Debug, Clone)]
pub struct Creeping([Part; 2]);

impl Creeping {
    /// Of a run of so many whole turns.
    pub fn new(whole: usize) -> Self {
        let quarter = whole / 4;
        Self([0..quarter, whole - quarter..whole].map(|turns| Part { turns, ..Part::default() }))
    }

    /// Adds a reading, from the first one on (mm); `turned` is the angle from the first one, and the cosine and sine are those of its own.
    pub fn push(&mut self, turned: f64, reading: f64, angle: [f64; 2]) {
        let turn = (turned / TAU) as usize;
        let parts = self.0.iter_mut().filter(|part| part.turns.contains(&turn));
        parts.for_each(|part| part.push(reading, angle));
    }

    /// Tells of a fundamental that turns while the run lasts: the artefact does not turn in the spindle, the encoder slips. `rest` is the
    /// RMS of what harmonics leave, mm.
    pub fn tell(&self, run: &Run, name: &str, rest: f64) {
        if self.0[0].turns.len() < TURNS {
            return;
        }
        let [first, last] = [0, 1].map(|part| self.0[part].fundamental());
        let [before, after] = [first, last].map(|[cos, sin]| sin.atan2(cos));
        let crept = (after - before + PI).rem_euclid(TAU) - PI;
        let size = first[0].hypot(first[1]).min(last[0].hypot(last[1]));
        if crept.abs() > CREPT && size > CLEAR * rest {
            tracing::warn!(
                "run `{}`: the fundamental of {name} turns by {:.1} deg from the first quarter of the run to the last one: does the encoder \
                 slip a little in every turn?",
                run.label,
                crept.to_degrees()
            );
        }
    }
}

/// Most that a size of one run may be larger or smaller than the median of others.
const ALIKE: f64 = 6.0;

/// Tells of runs whose values of one kind are far from those of the others; `what` are they, by the names of runs, mm.
pub fn tell_unlike(what: &str, values: &[(String, f64)]) {
    for (place, (run, value)) in values.iter().enumerate() {
        let others = values.iter().enumerate().filter(|(other, _)| *other != place);
        let mut others: Vec<f64> = others.map(|(_, (_, value))| *value).collect();
        others.sort_by(f64::total_cmp);
        let Some(median) = others.get(others.len() / 2).filter(|_| others.len() >= 2) else { continue };
        let ratio = value / median;
        if *median > 0.0 && !(1.0 / ALIKE..ALIKE).contains(&ratio) {
            tracing::warn!(
                "run `{run}`: {what} is {:.4} um, and {:.4} um in other runs: has a sensor another range or unit here?",
                value * 1e3,
                median * 1e3
            );
        }
    }
}

/// Part of a mean within which means of the same sensor are alike: its gap was set once.
const SAME_GAP: f64 = 0.05;

/// Fewest sensors of a run that tell of turned signs: the mean of one alone may be opposite by chance.
const SENSORS: usize = 2;

/// Tells of a run in which the means of some sensors, or of all, are those of the other runs with the other sign, and the rest are as in
/// the other runs; `means` are those of the sensors with these names by the names of runs, mm.
pub fn tell_turned(names: &[&str], means: &[(String, Vec<f64>)]) {
    for (run, (label, own)) in means.iter().enumerate() {
        let turned = turned(means, run);
        let named: Vec<&str> = turned.iter().filter_map(|sensor| names.get(*sensor).copied()).collect();
        match turned.len() {
            0 => {}
            count if count == own.len() => tracing::warn!(
                "run `{label}`: the mean readings are those of the other runs with the other sign: are its signs turned?"
            ),
            _ => tracing::warn!(
                "run `{label}`: the mean of {} is that of the other runs with the other sign, and those of the other sensors are as there: is \
                 the sign turned?",
                named.join(" and ")
            ),
        }
    }
}

/// The sensors of a run whose means are those of all other runs with the other sign; none if another sensor has another mean than there.
fn turned(means: &[(String, Vec<f64>)], run: usize) -> Vec<usize> {
    let (own, others) = (&means[run].1, || means.iter().enumerate().filter(|(other, _)| *other != run));
    let is_mean_of_others = |sensor: usize, sign: f64| {
        let is_alike = |(_, (_, other)): (usize, &(String, Vec<f64>))| {
            other.get(sensor).is_some_and(|other| (sign * other - own[sensor]).abs() < SAME_GAP * own[sensor].abs())
        };
        others().all(is_alike)
    };
    let turned: Vec<usize> = (0..own.len()).filter(|&sensor| is_mean_of_others(sensor, -1.0)).collect();
    let others_agree = (0..own.len()).all(|sensor| turned.contains(&sensor) || is_mean_of_others(sensor, 1.0));
    if others().count() >= 2 && own.len() >= SENSORS && others_agree { turned } else { Vec::new() }
}

/// Fewest readings of each sensor, at the same places of two runs, that two runs do not have in common by chance.
const COPIED: usize = 300;

/// Tells of a run whose sensors read what they read in an earlier one; `runs` are their labels, and some of their steps. Readings have
/// noise, and digits that show it: all of so many agree only where one run was copied.
pub fn tell_copied(runs: &[(String, Vec<(u64, Step)>)]) {
    for (place, (run, own)) in runs.iter().enumerate() {
        if let Some((other, _)) = runs[..place].iter().find(|(_, other)| is_copied(own, other)) {
            tracing::warn!(
                "run `{run}`: the sensors read what they read in run `{other}`, to the last digit: is one a copy of the other?"
            );
        }
    }
}

/// Both are in the order of their numbers.
fn is_copied(one: &[(u64, Step)], other: &[(u64, Step)]) -> bool {
    let mut others = other.iter().peekable();
    let mut common = 0;
    for (number, own) in one {
        while others.next_if(|(other, _)| other < number).is_some() {}
        let Some((_, same)) = others.next_if(|(other, _)| other == number) else { continue };
        if own.readings != same.readings {
            return false;
        }
        common += 1;
    }
    common >= COPIED
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    #[test]
    fn turned_signs_of_a_run_are_told() {
        let gaps = |random: &mut Generator| -> Vec<f64> { (0..3).map(|_| 0.1 * random.normal()).collect() };
        for seed in 0..2000 {
            let mut random = Generator::new(seed, 3);
            let gap = gaps(&mut random);
            let run = |random: &mut Generator, sign: f64| -> Vec<f64> {
                gap.iter().map(|gap| sign * gap * (1.0 + 0.01 * random.uniform())).collect()
            };
            let mut means: Vec<(String, Vec<f64>)> =
                (0..3).map(|place| (place.to_string(), run(&mut random, 1.0))).collect();
            let found = |means: &[(String, Vec<f64>)]| -> [Vec<usize>; 3] { [0, 1, 2].map(|run| turned(means, run)) };
            assert!(found(&means).iter().all(Vec::is_empty), "{seed}: {means:?}");
            // One sensor, two, or all.
            let sensors: Vec<usize> = (0..3).filter(|sensor| (seed / 7 + 1) >> sensor & 1 == 1).collect();
            sensors.iter().for_each(|sensor| means[1].1[*sensor] *= -1.0);
            assert_eq!(found(&means), [vec![], sensors, vec![]], "{seed}");
            // Sensors that are set to zero before each run.
            let zeroed: Vec<(String, Vec<f64>)> = (0..3).map(|place| (place.to_string(), gaps(&mut random))).collect();
            assert!(found(&zeroed).iter().all(Vec::is_empty), "{seed}: {zeroed:?}");
        }
    }

    #[test]
    fn coarse_digits_are_told() {
        for seed in 0..1000 {
            let mut random = Generator::new(seed, 5);
            let (digit, size) = ([1e-6, 2e-5, 5e-5, 1e-3][random.index(4)], 1e-2 * (1.0 + random.uniform().abs()));
            let reading = |number: usize| size * (0.07 * number as f64).sin() + 6e-6 * random.normal();
            let exact: Vec<f64> = (0..300).map(reading).collect();
            let rounded: Vec<f64> = exact.iter().map(|reading| (reading / digit).round() * digit).collect();
            assert_eq!(coarse(&exact, 6e-6), None, "{seed}");
            let is_coarse = coarse(&rounded, 6e-6).is_some_and(|step| (step / digit - 1.0).abs() < 1e-9);
            assert_eq!(is_coarse, digit >= 5e-5, "{seed}: {digit}");
            assert_eq!(coarse(&rounded[..50], 6e-6), None);
        }
        assert_eq!(coarse(&[0.0; 300], 6e-6), None);
    }

    #[test]
    fn copied_readings_are_told() {
        let steps = |random: &mut Generator, noise: f64| -> Vec<(u64, Step)> {
            let step = |number: u64| {
                let turned = (0.05 * number as f64).sin();
                // Digits of 10 nm.
                let readings =
                    [5.0, 3.0, 0.2].map(|size| ((size * turned + noise * random.normal()) * 100.0).round() * 1e-5);
                (number, Step { angle: 0.05, time: 1e-4, readings })
            };
            (1..=400).map(step).collect()
        };
        for seed in 0..500 {
            let mut random = Generator::new(seed, 4);
            // Noise of a tenth of a digit, and more.
            let noise = 1e-3 * 30_f64.powf(random.uniform().abs());
            let (one, other) = (steps(&mut random, noise), steps(&mut random, noise));
            assert!(!is_copied(&one, &other), "{seed}: {noise}");
            let later: Vec<(u64, Step)> =
                one.iter().map(|(number, step)| (*number, Step { time: 2e-4, ..*step })).collect();
            assert!(is_copied(&later, &one), "{seed}");
            assert!(!is_copied(&later[..200], &one), "{seed}");
        }
    }

    /// The range of readings of a motion and noise, in the unit of these.
    fn range(random: &mut Generator, (motion, noise): (f64, f64)) -> f64 {
        let (count, phase) = (200 + random.index(2000), random.uniform());
        let reading = |number: usize| motion * (0.1 * number as f64 + phase).sin() + noise * random.normal();
        let readings: Vec<f64> = (0..count).map(reading).collect();
        let fold = readings.iter().fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(*value), high.max(*value)]);
        fold[1] - fold[0]
    }

    #[test]
    fn an_axial_motion_below_the_noise_is_no_silence() {
        for seed in 0..2000 {
            let mut random = Generator::new(seed, 1);
            // The noise is what is stated, or half of it.
            let noise = [1e-5, 5e-6][random.index(2)];
            let motion = noise * random.uniform().abs();
            let range = range(&mut random, (motion, noise));
            assert_eq!(silent(Sensor::Axial, range, 1e-5), None, "{seed}: {range}");
        }
    }

    #[test]
    fn sensors_without_a_signal_are_told() {
        for seed in 0..2000 {
            let mut random = Generator::new(seed, 2);
            let noise = range(&mut random, (0.0, 1e-5));
            assert!(silent(Sensor::Radial, noise, 1e-5).is_some(), "{seed}: {noise}");
            let dead = range(&mut random, (0.0, 1e-6));
            assert!(silent(Sensor::Axial, dead, 1e-5).is_some(), "{seed}: {dead}");
        }
    }
}
