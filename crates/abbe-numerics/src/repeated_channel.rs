//! A channel of an instrument whose readings are its own earlier ones, while other channels beside it read anew.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;
use std::hash::{DefaultHasher, Hash, Hasher};

use crate::channels::{Channel, resolution};

/// Readings in turn that are looked for among earlier ones, and how many of these have to differ: coarse digits repeat in a slow motion.
const WINDOW: usize = 5;
const DISTINCT: usize = 3;

/// Fewest readings that are told.
const FEWEST: usize = 10;

/// Ways from readings to earlier ones that are looked at: those that most windows show.
const WAYS: usize = 8;

/// Noise that is taken for granted, as a part of what is stated, of what the channel shows, and of what others show.
const PART: f64 = 0.5;

/// Probability below which readings do not repeat by chance.
const BY_CHANCE: f64 = 1e-5;

/// From a row to an earlier one that it repeats: so many rows before it, or so that both have this sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Repeats {
    /// The same order.
    Forwards(usize),
    /// The opposite order.
    Backwards(usize),
}

impl Repeats {
    /// The row that this one repeats, if there is one.
    pub fn earlier(self, row: usize) -> Option<usize> {
        match self {
            Self::Forwards(apart) => row.checked_sub(apart),
            Self::Backwards(sum) => sum.checked_sub(row).filter(|other| *other < row),
        }
    }
}

/// The longest stretch in which a channel reads to the last digit what it read before, forwards or backwards: its first row, and how many.
///
/// A quiet channel may repeat by itself. So its noise is what is stated (`uncertainty`), what its readings show from row to row, or
/// what the channels beside it show between the same rows, whichever is least; half of that has to leave less than one in a hundred
/// thousand for chance. Where all channels repeat together nothing is told here.
pub(crate) fn repeated(channels: &[Channel<'_>], place: usize, uncertainty: Option<f64>) -> Option<(usize, usize)> {
    let readings = channels[place].readings;
    let rows = readings.len();
    let step = resolution(readings)?;
    let runs = likely_ways(readings).into_iter().filter_map(|way| Some((way, longest(readings, way)?)));
    let (way, (first, count)) = runs.max_by_key(|(_, (_, count))| *count)?;
    let run = first..first + count;
    let distinct: BTreeSet<u64> = readings[run.clone()].iter().map(|reading| reading.to_bits()).collect();
    if count < FEWEST || distinct.len() < DISTINCT {
        return None;
    }
    let others =
        channels.iter().enumerate().filter(|(other, channel)| *other != place && channel.readings.len() == rows);
    let of_others = others.map(|(_, channel)| apart(channel.readings, run.clone(), way)).reduce(f64::max)?;
    let noise = PART * uncertainty.unwrap_or(f64::INFINITY).min(of_others).min(roughness(&readings[run]));
    // Two readings of one thing: the density of the difference of two normal errors at zero, times the step.
    let agree = (step / (2.0 * PI.sqrt() * noise)).min(1.0);
    let tried = (2 * rows * rows) as f64;
    (tried * agree.powf(count as f64) < BY_CHANCE).then_some((first, count))
}

/// The ways by which windows of readings are earlier ones, those of most windows first.
fn likely_ways(readings: &[f64]) -> Vec<Repeats> {
    let digest = |window: &mut dyn Iterator<Item = &f64>| {
        let mut hasher = DefaultHasher::new();
        window.for_each(|reading| reading.to_bits().hash(&mut hasher));
        hasher.finish()
    };
    let (mut known, mut ways): (BTreeMap<u64, usize>, BTreeMap<Repeats, usize>) = Default::default();
    for (start, window) in readings.windows(WINDOW).enumerate() {
        if window.iter().map(|reading| reading.to_bits()).collect::<BTreeSet<_>>().len() < DISTINCT {
            continue;
        }
        let (own, reversed) = (digest(&mut window.iter()), digest(&mut window.iter().rev()));
        let earlier = |of: u64| known.get(&of).copied().filter(|place| place + WINDOW <= start);
        let forwards = earlier(own).map(|place| Repeats::Forwards(start - place));
        let backwards = earlier(reversed).map(|place| Repeats::Backwards(start + place + WINDOW - 1));
        for way in [forwards, backwards].into_iter().flatten() {
            *ways.entry(way).or_default() += 1;
        }
        known.entry(own).or_insert(start);
    }
    let mut ways: Vec<(Repeats, usize)> = ways.into_iter().collect();
    ways.sort_by_key(|(_, windows)| usize::MAX - windows);
    ways.into_iter().take(WAYS).map(|(way, _)| way).collect()
}

/// The first row and the length of the longest stretch that repeats by a way.
fn longest(readings: &[f64], way: Repeats) -> Option<(usize, usize)> {
    let is_same = |row: &usize| way.earlier(*row).is_some_and(|other| readings[other] == readings[*row]);
    let all: Vec<usize> = (0..readings.len()).collect();
    let stretches = all.chunk_by(|one, other| is_same(one) == is_same(other)).filter(|rows| is_same(&rows[0]));
    stretches.map(|rows| (rows[0], rows.len())).max_by_key(|(_, count)| *count)
}

/// How far readings scatter between the rows of a stretch and those that it repeats, but for an offset: of one reading.
fn apart(readings: &[f64], mut run: std::ops::Range<usize>, way: Repeats) -> f64 {
    let count = run.len() as f64;
    let apart = run.try_fold(Vec::new(), |mut all, row| {
        all.push(readings[row] - readings[way.earlier(row)?]);
        Some(all)
    });
    let apart = apart.unwrap_or_default();
    let mean = apart.iter().sum::<f64>() / count;
    (apart.iter().map(|own| (own - mean).powi(2)).sum::<f64>() / (2.0 * count)).sqrt()
}

/// What readings show from row to row: the scatter of one by fourth differences, which leave little of a curve.
fn roughness(readings: &[f64]) -> f64 {
    let differences = readings.windows(5).map(|five| five[0] - 4.0 * (five[1] + five[3]) + 6.0 * five[2] + five[4]);
    let count = differences.len().max(1) as f64;
    (differences.map(|own| own * own).sum::<f64>() / (70.0 * count)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Generator;

    /// Readings of three channels up and down along the same places, with a slow curve, lost motion, roughness of the machine that
    /// repeats, noise and digits.
    fn readings(random: &mut Generator, half: usize, [rough, noise, step]: [f64; 3]) -> Vec<Vec<f64>> {
        let mut channel = || {
            let (size, phase, lost) = (8.0 * random.uniform(), 3.0 * random.uniform(), 2.0 * random.uniform());
            let curve: Vec<f64> = (0..half)
                .map(|place| size * (phase + 5.0 * place as f64 / half as f64).sin() + rough * random.normal())
                .collect();
            let down = curve.iter().rev().map(|own| own + lost);
            let all: Vec<f64> = curve.iter().copied().chain(down).collect();
            all.iter().map(|own| ((own + noise * random.normal()) / step).round() * step).collect::<Vec<f64>>()
        };
        (0..3).map(|_| channel()).collect()
    }

    fn told(columns: &[Vec<f64>], place: usize, uncertainty: Option<f64>) -> bool {
        let channels: Vec<Channel<'_>> = columns.iter().map(|readings| Channel { name: "x", readings }).collect();
        repeated(&channels, place, uncertainty).is_some()
    }

    #[test]
    fn channels_that_read_anew_get_no_word() {
        for seed in 0..20_000 {
            let mut random = Generator::new(seed, 11);
            // Machines that repeat far better than is stated, and digits far coarser than the noise.
            let rough = [0.0, 0.3, 2.0][random.index(3)];
            let noise = [0.0, 0.01, 0.03, 0.1, 0.3][random.index(5)];
            let step = [0.01, 0.1, 0.2, 1.0][random.index(4)];
            let half = 6 + random.index(40);
            let columns = readings(&mut random, half, [rough, noise, step]);
            // Without noise in any channel a machine repeats to the last digit, and that is no copy.
            for stated in [Some(0.3), Some(noise).filter(|noise| *noise > 0.0), None] {
                for place in 0..3 {
                    assert!(!told(&columns, place, stated), "{seed}: {rough} {noise} {step} {half} {stated:?}");
                }
            }
        }
    }

    #[test]
    fn one_quiet_channel_gets_no_word() {
        for seed in 0..5_000 {
            let mut random = Generator::new(seed, 12);
            let (half, step) = (8 + random.index(30), [0.01, 0.1][random.index(2)]);
            let mut columns = readings(&mut random, half, [0.0, 0.3, step]);
            // The third one has hardly noise, and a smooth curve.
            let quiet = readings(&mut random, half, [0.0, 0.0, step]);
            columns[2].clone_from(&quiet[2]);
            columns[2].iter_mut().for_each(|own| *own = (0.2 * *own / step).round() * step);
            assert!(!told(&columns, 2, Some(0.3)), "{seed}");
        }
    }

    #[test]
    fn a_channel_that_is_a_copy_of_itself_is_told() {
        let (mut counts, mut all) = ([0; 3], 0);
        for seed in 0..1_000 {
            let mut random = Generator::new(seed, 13);
            let half = 12 + random.index(30);
            let columns = readings(&mut random, half, [0.0, 0.3, 0.1]);
            let rows = 2 * half;
            let change = |which: usize| {
                let mut columns = columns.clone();
                for row in 0..rows {
                    let of = match which {
                        0 if row >= half => rows - 1 - row,
                        1 => row % 6,
                        2 => row % 4,
                        _ => row,
                    };
                    columns[1][row] = columns[1][of];
                }
                columns
            };
            all += 1;
            for (which, count) in counts.iter_mut().enumerate() {
                let changed = change(which);
                *count += usize::from(told(&changed, 1, Some(0.3)));
                assert!(!told(&changed, 0, Some(0.3)) && !told(&changed, 2, Some(0.3)));
            }
        }
        assert!(counts.iter().all(|count| 10 * count > 9 * all), "{counts:?} of {all}");
    }
}
