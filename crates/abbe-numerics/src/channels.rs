//! What readings say of the instrument that made them: channels that are dead, that have the readings of another channel or their own
//! earlier ones, that are cut off at the end of a range, or that stand for a while.
//!
//! Commands repeat by plan, and coarse digits repeat by chance: these functions are for what was measured, and they look at the digits.

use crate::repeated_channel::repeated;

/// The readings of one channel of an instrument, in the order in which they were made.
#[derive(Debug, Clone, Copy)]
pub struct Channel<'a> {
    /// Its name, for sentences.
    pub name: &'a str,
    /// What it read.
    pub readings: &'a [f64],
}

/// A fault that readings of channels tell. Channels are counted as they were given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InstrumentFault {
    /// It reads the same in all rows, and others do not.
    Still {
        /// The channel.
        channel: usize,
        /// What it reads.
        value: f64,
    },
    /// It has the readings of another one to the last digit, in rows that follow each other.
    Copy {
        /// The channel.
        channel: usize,
        /// The other one.
        of: usize,
        /// How many rows.
        rows: usize,
    },
    /// Its largest or smallest reading is there far more often than those next to it.
    Clipped {
        /// The channel.
        channel: usize,
        /// The end.
        end: ClippedEnd,
    },
    /// It reads the same for long, and moves in other rows.
    Stuck {
        /// The channel.
        channel: usize,
        /// What it reads.
        value: f64,
        /// The first of these rows, from 0.
        first: usize,
        /// How many.
        rows: usize,
    },
    /// It reads what it read before to the last digit, in rows that follow each other or in the opposite order, and others do not.
    Repeated {
        /// The channel.
        channel: usize,
        /// The first of these rows, from 0.
        first: usize,
        /// How many.
        rows: usize,
    },
}

/// An end at which readings are cut off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClippedEnd {
    /// The extreme reading.
    pub value: f64,
    /// Whether it is the largest one, not the smallest.
    pub is_largest: bool,
    /// How often it is there.
    pub count: usize,
    /// The most that one of the values next to it is there.
    pub nearby: usize,
}

impl InstrumentFault {
    /// Whether no instrument reads so that was connected.
    pub fn is_certain(&self) -> bool {
        matches!(self, Self::Still { .. } | Self::Copy { .. })
    }

    /// A sentence; `factor` turns readings into the unit of people.
    pub fn describe(&self, channels: &[Channel<'_>], (factor, unit): (f64, &str)) -> String {
        let name = |channel: usize| channels[channel].name;
        // No long tails of binary fractions, and no negative zero.
        let number = |value: f64| (value * factor * 1e6).round() / 1e6 + 0.0;
        match *self {
            Self::Still { channel, value } => format!(
                "`{}` reads {} {unit} in all {} rows, and others move: was it connected?",
                name(channel),
                number(value),
                channels[channel].readings.len()
            ),
            Self::Copy { channel, of, rows } => format!(
                "`{}` has the readings of `{}` to the last digit in {rows} rows one after the other: was a column copied, or is one \
                 transducer read twice?",
                name(channel),
                name(of)
            ),
            Self::Clipped { channel, end } => format!(
                "`{}` reads its {} value, {} {unit}, {} times, and the values next to it {} times at most: was it at the end of its range?",
                name(channel),
                if end.is_largest { "largest" } else { "smallest" },
                number(end.value),
                end.count,
                end.nearby
            ),
            Self::Stuck { channel, value, first, rows } => format!(
                "`{}` reads {} {unit} in {rows} rows one after the other, from row {} on, and moves in others: was a beam lost, or did it \
                 stick?",
                name(channel),
                number(value),
                first + 1
            ),
            Self::Repeated { channel, first, rows } => format!(
                "`{}` has its own earlier readings to the last digit in {rows} rows one after the other, from row {} on, in the same or in \
                 the opposite order, and the channels beside it read anew: are they copies?",
                name(channel),
                first + 1
            ),
        }
    }
}

/// Fewest rows in which a channel is told that reads the same, or what another one reads.
const SEVERAL: usize = 10;

/// Fewest values of what moves.
pub(crate) const VALUES: usize = 5;

/// Largest step of the digits of readings, over their standard uncertainty, with which readings do not agree by chance.
const FINE: f64 = 0.5;

/// Steps of the digits over which readings range, from which on a working channel beside does not stand; where no uncertainty is stated.
const STEPS: f64 = 50.0;

/// The faults of channels that were read in the same rows, and lie in the same unit. `uncertainty` is the standard uncertainty of a
/// reading, where it is stated.
pub fn instrument_faults(channels: &[Channel<'_>], uncertainty: Option<f64>) -> Vec<InstrumentFault> {
    let is_fine = is_fine(channels, uncertainty);
    let moves = |channel: &Channel<'_>| levels(channel.readings).len() >= VALUES;
    let mut faults = Vec::new();
    for (place, channel) in channels.iter().enumerate() {
        let readings = channel.readings;
        let others = || channels.iter().enumerate().filter(move |(other, _)| *other != place);
        if is_fine && readings.len() >= SEVERAL && is_still(readings) && others().any(|(_, other)| moves(other)) {
            faults.push(InstrumentFault::Still { channel: place, value: readings[0] });
            continue;
        }
        let copied = |(of, other): (usize, &Channel<'_>)| Some((of, common(readings, other.readings)?));
        if let Some((of, rows)) = channels[..place].iter().enumerate().filter_map(copied).next().filter(|_| is_fine) {
            faults.push(InstrumentFault::Copy { channel: place, of, rows });
            continue;
        }
        let clipped = clipped_ends(readings);
        if let (true, Some((value, first, rows))) = (clipped.is_empty(), stuck(readings)) {
            faults.push(InstrumentFault::Stuck { channel: place, value, first, rows });
        } else if let Some((first, rows)) = repeated(channels, place, uncertainty).filter(|_| is_fine) {
            faults.push(InstrumentFault::Repeated { channel: place, first, rows });
        }
        faults.extend(clipped.into_iter().map(|end| InstrumentFault::Clipped { channel: place, end }));
    }
    faults
}

/// Whether the digits are so fine that readings do not agree by chance.
fn is_fine(channels: &[Channel<'_>], uncertainty: Option<f64>) -> bool {
    let levels = channels.iter().map(|channel| levels(channel.readings)).collect::<Vec<_>>();
    let steps = levels.iter().flat_map(|levels| levels.windows(2).map(|pair| pair[1].0 - pair[0].0));
    let step = steps.fold(f64::INFINITY, f64::min).min(digit(channels).unwrap_or(f64::INFINITY));
    let ranges = levels.iter().filter_map(|levels| Some(levels.last()?.0 - levels.first()?.0));
    match uncertainty.filter(|uncertainty| *uncertainty > 0.0) {
        Some(uncertainty) => step < FINE * uncertainty,
        None => ranges.fold(0.0, f64::max) > STEPS * step,
    }
}

/// The last digit of the readings of all channels.
fn digit(channels: &[Channel<'_>]) -> Option<f64> {
    resolution(&channels.iter().flat_map(|channel| channel.readings).copied().collect::<Vec<f64>>())
}

/// The step of the digits of readings: the largest of 1, 2 and 5 times a power of ten of which all are whole multiples; none if they have
/// no such digits. What is no finite number is left out.
///
/// ```
/// assert_eq!(abbe_numerics::resolution(&[12.5, 7.0, 3.5, 101.0, -4.5]), Some(0.5));
/// ```
pub fn resolution(readings: &[f64]) -> Option<f64> {
    let readings = || readings.iter().filter(|reading| reading.is_finite());
    let largest = readings().fold(0.0_f64, |largest, reading| largest.max(reading.abs()));
    let of_all = |step: &f64| {
        readings().all(|reading| {
            let steps = reading / step;
            (steps - steps.round()).abs() < 1e-5
        })
    };
    let steps = (-12..6).rev().flat_map(|power| [5.0, 2.0, 1.0].map(|step| step * 10_f64.powi(power)));
    steps.filter(|step| *step <= largest && largest / step < 1e9).find(of_all)
}

fn is_still(readings: &[f64]) -> bool {
    readings.iter().all(|reading| *reading == readings[0])
}

/// The number of rows in which two channels read the same, one after the other at least so many that no chance makes; none else.
fn common(one: &[f64], other: &[f64]) -> Option<usize> {
    let is_same = |row: &usize| one[*row] == other[*row];
    let rows: Vec<usize> = (0..one.len().min(other.len())).collect();
    let stretches = rows.chunk_by(|before, row| is_same(before) == is_same(row)).filter(|rows| is_same(&rows[0]));
    let longest = stretches.max_by_key(|rows| rows.len()).filter(|rows| rows.len() >= SEVERAL)?;
    let values: Vec<f64> = longest.iter().map(|row| one[*row]).collect();
    (levels(&values).len() >= VALUES).then_some(longest.len())
}

/// The values of readings in their order, each with how often it is there.
fn levels(readings: &[f64]) -> Vec<(f64, usize)> {
    let mut sorted: Vec<f64> = readings.iter().copied().filter(|reading| reading.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.chunk_by(|one, other| one == other).map(|same| (same[0], same.len())).collect()
}

/// Fewest equal extremes that are told, how many times as often they are there as values next to them, and how many of these count.
/// A smooth signal reads its extreme at most 2.4 times as often as the values beside it, in any steps.
pub(crate) const EQUAL: usize = 5;
pub(crate) const AS_OFTEN: f64 = 5.0;
pub(crate) const NEXT: usize = 3;

/// The ends at which readings are cut off: the largest or smallest reading is there far more often than those next to it and than a
/// usual one. An end at exactly zero is none: instruments are set to zero where a run begins, and may read nothing below it.
///
/// ```
/// use abbe_numerics::clipped_ends;
///
/// let sine = |row: usize| (0.11 * row as f64).sin();
/// let clipped: Vec<f64> = (0..200).map(|row| sine(row).min(0.7)).collect();
/// let ends = clipped_ends(&clipped);
/// assert!(ends.len() == 1 && ends[0].is_largest && ends[0].value == 0.7 && ends[0].count > 30);
/// assert!(clipped_ends(&(0..200).map(sine).collect::<Vec<_>>()).is_empty());
/// ```
pub fn clipped_ends(readings: &[f64]) -> Vec<ClippedEnd> {
    let levels = levels(readings);
    if levels.len() < VALUES {
        return Vec::new();
    }
    let inner = &levels[1..levels.len() - 1];
    let usual = inner.iter().map(|level| level.1).sum::<usize>() as f64 / inner.len() as f64;
    let end = |is_largest: bool| {
        let ordered: Vec<(f64, usize)> =
            if is_largest { levels.iter().rev().copied().collect() } else { levels.clone() };
        let (value, count) = ordered[0];
        let nearby = ordered[1..].iter().take(NEXT).map(|level| level.1).max().unwrap_or(0);
        let most = AS_OFTEN * usual.max(nearby as f64);
        let is_clipped = count >= EQUAL && count as f64 >= most && value != 0.0;
        is_clipped.then_some(ClippedEnd { value, is_largest, count, nearby })
    };
    [true, false].into_iter().filter_map(end).collect()
}

/// Fewest equal rows one after the other that are told, and how many times as many they are as those of another value. A smooth signal
/// stands 4.8 times as long at its extreme as at the values beside it.
const STANDS: usize = 8;
const AS_LONG: usize = 6;

/// Probability below which readings do not stand by chance.
const BY_CHANCE: f64 = 1e-6;

/// The value at which readings stand for long while they move in other rows, the first of these rows, and how many.
fn stuck(readings: &[f64]) -> Option<(f64, usize, usize)> {
    if levels(readings).len() < VALUES {
        return None;
    }
    let mut stretches: Vec<(f64, usize, usize)> = Vec::new();
    let mut first = 0;
    for same in readings.chunk_by(|one, other| one == other) {
        stretches.push((same[0], first, same.len()));
        first += same.len();
    }
    let longest = *stretches.iter().max_by_key(|stretch| stretch.2).filter(|stretch| stretch.2 >= STANDS)?;
    // A lost beam reads the same again in the next run.
    let others: Vec<usize> =
        stretches.iter().filter(|stretch| stretch.0 != longest.0).map(|stretch| stretch.2).collect();
    let rows: usize = others.iter().sum();
    let still = (rows - others.len() + 1) as f64 / (rows + 2) as f64;
    let by_chance = still.powf((longest.2 - 1) as f64) * readings.len() as f64;
    let is_stuck = longest.2 >= AS_LONG * others.iter().copied().max()? && by_chance < BY_CHANCE;
    is_stuck.then_some(longest)
}

/// Fewest groups of repeats that tell, and the part of them that has to have no scatter.
const GROUPS: usize = 5;
const MOST: f64 = 0.9;

/// Whether repeats are copies: nearly all groups of at least two have no scatter at all, and the groups differ by many more steps of the
/// digits than there are groups. With coarse digits repeats of a good instrument agree, but then groups do, too.
///
/// ```
/// use abbe_numerics::repeats_are_copies;
///
/// let errors = [0.31, -0.12, 0.77, 0.46, -0.58, 0.23];
/// let copied: Vec<Vec<f64>> = errors.iter().map(|error| vec![*error; 3]).collect();
/// assert!(repeats_are_copies(&copied));
/// let coarse: Vec<Vec<f64>> = errors.iter().map(|error| vec![error.round(); 3]).collect();
/// assert!(!repeats_are_copies(&coarse));
/// ```
pub fn repeats_are_copies(groups: &[Vec<f64>]) -> bool {
    let several: Vec<&Vec<f64>> = groups.iter().filter(|group| group.len() > 1).collect();
    let same: Vec<f64> = several.iter().filter(|group| is_still(group)).map(|group| group[0]).collect();
    let different = levels(&same).len();
    same.len() >= GROUPS && same.len() as f64 >= MOST * several.len() as f64 && 3 * different >= 2 * same.len()
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, Normal};

    use super::*;

    /// A slow motion with noise, in steps.
    fn readings(seed: u64, rows: usize, [size, noise, step]: [f64; 3]) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(0.0, noise.max(1e-300)).unwrap();
        let slow = |row: usize| size * (0.37 + seed as f64 + 6.3 * row as f64 / rows as f64).sin();
        (0..rows).map(|row| ((slow(row) + normal.sample(&mut random)) / step).round() * step).collect()
    }

    fn of(columns: &[Vec<f64>], uncertainty: Option<f64>) -> Vec<InstrumentFault> {
        let channels: Vec<Channel<'_>> = columns.iter().map(|readings| Channel { name: "x", readings }).collect();
        instrument_faults(&channels, uncertainty)
    }

    /// Sizes, noise and digits of good instruments, coarse ones and smooth traces without noise among them.
    const GOOD: [[f64; 3]; 8] = [
        [7.0, 0.3, 0.1],
        [0.4, 0.3, 0.1],
        [7.0, 0.3, 0.01],
        [7.0, 0.1, 1.0],
        [0.7, 0.1, 1.0],
        [20.0, 0.0, 0.1],
        [3.0, 0.0, 1e-6],
        [20.0, 0.05, 0.1],
    ];

    #[test]
    fn good_readings_have_no_faults() {
        for seed in 0..60 {
            for shape in GOOD {
                for rows in [12, 50, 110, if seed < 2 { 1500 } else { 30 }] {
                    let columns: Vec<Vec<f64>> = (0..3).map(|k| readings(3 * seed + k, rows, shape)).collect();
                    let uncertainty = Some(shape[1]).filter(|u| *u > 0.0);
                    for stated in [uncertainty, None] {
                        let found = of(&columns, stated);
                        assert!(found.is_empty(), "{shape:?}, seed {seed}, {rows} rows: {found:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn faults_are_found() {
        for seed in 0..100 {
            let good = |k: u64| readings(7 * seed + k, 50, [7.0, 0.3, 0.1]);
            let (x, y, z) = (good(0), good(1), good(2));
            let dead = of(&[x.clone(), vec![0.0; 50], z.clone()], Some(0.3));
            assert_eq!(dead, [InstrumentFault::Still { channel: 1, value: 0.0 }]);
            let two = of(&[vec![3.0; 50], vec![-0.0; 50], z.clone()], None);
            assert_eq!(two.len(), 2, "{two:?}");
            let copy = of(&[x.clone(), y.clone(), x.clone()], Some(0.3));
            assert_eq!(copy, [InstrumentFault::Copy { channel: 2, of: 0, rows: 50 }]);
            assert!(dead[0].is_certain() && copy[0].is_certain());
            let mut stuck = x.clone();
            stuck[15..].fill(0.0);
            let found = of(&[stuck, y.clone(), z.clone()], Some(0.3));
            // The row before may read the same.
            let is_told =
                matches!(found[..], [InstrumentFault::Stuck { channel: 0, first: 13..=15, rows: 35..=37, .. }]);
            assert!(is_told && !found[0].is_certain(), "{found:?}");
            let wide = readings(seed, 400, [20.0, 0.3, 0.1]);
            let clipped: Vec<f64> = wide.iter().map(|value| value.clamp(-5.0, 5.0)).collect();
            let found = of(&[clipped], None);
            assert!(
                matches!(found[..], [InstrumentFault::Clipped { .. }, InstrumentFault::Clipped { .. }]),
                "{found:?}"
            );
        }
    }

    /// A channel that is set to zero where each run begins, and its error grows from there.
    #[test]
    fn what_is_set_to_zero_is_not_clipped() {
        let rows: Vec<f64> =
            (0..110).map(|row| 0.31 * f64::from(row % 11) + 0.01 * f64::from(row / 11 * (row % 11))).collect();
        assert_eq!(of(&[rows], Some(0.3)), []);
    }

    #[test]
    fn digits_are_found() {
        for seed in 0..500 {
            let mut generator = crate::Generator::new(seed, 0);
            let step = [1.0, 2.0, 5.0][seed as usize % 3] * 10_f64.powi(-(seed as i32 % 6));
            let readings: Vec<f64> = (0..60).map(|_| (200.0 * generator.normal() / step).round() * step).collect();
            let found = resolution(&readings).expect("digits");
            assert!((found / step - 1.0).abs() < 1e-9, "{seed}: {found} {step}");
            let rough: Vec<f64> = (0..60).map(|_| generator.normal()).collect();
            assert_eq!(resolution(&rough), None);
        }
    }
}
