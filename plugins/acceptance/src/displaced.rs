//! Readings beside their place: a run that is off as a whole, and rows that stand beside those of their positions.

use std::collections::BTreeMap;

/// Readings of a run by target and direction (up or not).
pub type OfRun = BTreeMap<(usize, bool), f64>;

/// Fewest readings of a run, and fewest other runs, that tell.
const COMPARED: usize = 5;
const OTHERS: usize = 4;

/// How many times farther a run is off than the others are from each other, and than readings are apart beside that.
const FAR: f64 = 20.0;

/// Distances below this are rounding, µm or µrad.
const ROUNDING: f64 = 1e-3;

/// A run that is off as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Off {
    /// Its place among the runs.
    pub run: usize,
    /// The direction (up or not) that is off alone; none if all of the run is.
    pub way: Option<bool>,
    /// What it is off, and what the others are from each other at most, µm or µrad.
    pub by: f64,
    pub usual: f64,
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or_default()
}

/// What a run is off the medians of the others, and what its readings scatter about that: half of them are within.
fn off(runs: &[&OfRun], run: usize) -> Option<(f64, f64)> {
    let apart = runs[run].iter().filter_map(|(key, reading)| {
        let others = runs.iter().enumerate().filter(|(other, _)| *other != run);
        let others: Vec<f64> = others.filter_map(|(_, readings)| readings.get(key).copied()).collect();
        (others.len() >= OTHERS).then(|| reading - median(others))
    });
    let apart: Vec<f64> = apart.collect();
    if apart.len() < COMPARED {
        return None;
    }
    let shift = median(apart.clone());
    Some((shift, median(apart.iter().map(|own| (own - shift).abs()).collect())))
}

/// A run, or one direction of it, that is off by a number, the same at all targets, far more than the others are: its zero was lost. A
/// machine that warms up is off more and more, also within a run. Readings in steps of `digit` tell nothing below.
pub fn run_off(runs: &[&OfRun], digit: f64) -> Option<Off> {
    let of_one_way = |way: bool| {
        let kept = |run: &&OfRun| {
            run.iter().filter(|((_, up), _)| *up == way).map(|(key, reading)| (*key, *reading)).collect()
        };
        let kept: Vec<OfRun> = runs.iter().map(kept).collect();
        let off = off_alike(&kept.iter().collect::<Vec<_>>(), digit)?;
        Some(Off { way: Some(way), ..off })
    };
    off_alike(runs, digit).or_else(|| [true, false].into_iter().find_map(of_one_way))
}

/// A run all of whose readings are off by the same.
fn off_alike(runs: &[&OfRun], digit: f64) -> Option<Off> {
    if runs.len() < OTHERS + 1 {
        return None;
    }
    let all: Vec<(f64, f64)> = (0..runs.len()).map(|run| off(runs, run)).collect::<Option<_>>()?;
    (0..runs.len()).find_map(|run| {
        let others = || all.iter().enumerate().filter(move |(other, _)| *other != run).map(|(_, own)| *own);
        let (low, high) = others().fold((f64::MAX, f64::MIN), |(low, high), (by, _)| (low.min(by), high.max(by)));
        let scatter = others().map(|(_, scatter)| scatter).fold(all[run].1, f64::max);
        let (by, usual) = (all[run].0, (high - low).max(scatter).max(digit).max(ROUNDING));
        (by.abs() > FAR * usual).then_some(Off { run, way: None, by, usual })
    })
}

/// Fewest targets that tell rows beside their positions, and how many times better both directions then agree: more where there are few.
const TARGETS: usize = 5;
const BETTER: f64 = 4.0;
const FEW: f64 = 3.5;

/// Readings in the order of their rows, each with its target and direction (up or not).
pub struct InOrder<'a> {
    pub readings: &'a [f64],
    pub places: &'a [usize],
    pub ways: &'a [bool],
}

impl InOrder<'_> {
    /// What lost motion differs from target to target, root mean square, if each row has the reading of the one so many rows behind it.
    fn apart(&self, rows: isize) -> Option<f64> {
        let mut sums = vec![[[0.0; 2]; 2]; self.places.iter().max()? + 1];
        for (row, (place, way)) in self.places.iter().zip(self.ways).enumerate() {
            let other = row.checked_add_signed(rows).and_then(|other| self.readings.get(other));
            let [count, sum] = &mut sums[*place][usize::from(*way)];
            (*count, *sum) = other.map_or((*count, *sum), |reading| (*count + 1.0, *sum + reading));
        }
        let both = sums.iter().filter(|own| own.iter().all(|[count, _]| *count > 0.0));
        let lost: Vec<f64> = both.map(|[down, up]| up[1] / up[0] - down[1] / down[0]).collect();
        let mean = lost.iter().sum::<f64>() / lost.len() as f64;
        let squares: f64 = lost.iter().map(|own| (own - mean).powi(2)).sum();
        (lost.len() >= TARGETS).then(|| (squares / (lost.len() - 1) as f64).sqrt())
    }

    /// By how many rows readings stand beside their positions (1: a row late, -1: early), and what lost motion differs along the travel:
    /// as they are, and with that.
    ///
    /// Rows run forwards and backwards. Readings that stand a row late are those of the target before in one direction, of the target
    /// behind in the other one, and of the same one where it turns; errors of the travel are in what looks like lost motion then.
    /// Readings in steps of `digit` tell nothing below.
    pub fn rows_off(&self, digit: f64) -> Option<(isize, f64, f64)> {
        let as_they_are = self.apart(0)?;
        let tried = [1, -1].into_iter().filter_map(|by| Some((by, self.apart(by)?)));
        let (by, with) = tried.min_by(|one, other| one.1.total_cmp(&other.1))?;
        let targets = self.places.iter().max()? + 1;
        let better = BETTER * (1.0 + (FEW / (targets - 1) as f64).powi(2));
        (as_they_are > better * with.max(0.5 * digit).max(ROUNDING)).then_some((by, as_they_are, with))
    }
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    fn digits(seed: u64) -> f64 {
        [0.001, 0.1, 1.0][seed as usize % 3]
    }

    /// An axis in both directions, several runs: errors of all kinds, a machine that warms up, and a laser that drifts.
    fn axis(seed: u64) -> (Vec<OfRun>, usize, Generator) {
        let mut random = Generator::new(seed, 0);
        let (runs, targets) = (2 + seed as usize % 6, 5 + seed as usize % 17);
        let size = 10_f64.powf(random.normal().clamp(-1.0, 1.0));
        let scatter = 0.1 * size * 10_f64.powf(random.normal().clamp(-1.0, 1.0));
        let [slope, bow, wave, lost, growing] = std::array::from_fn(|_| size * random.normal());
        let short = if seed.is_multiple_of(3) { size * random.normal() } else { 0.0 };
        let warm = if seed.is_multiple_of(2) { 10.0 * size * random.normal() } else { 0.0 };
        // Within a part of a run up to many of them.
        let constant = 3_f64.powf(random.normal().clamp(-2.0, 3.0));
        let walk = if seed % 4 == 1 { 5.0 * scatter * random.normal() } else { 0.0 };
        let digits = digits(seed);
        let (mut all, mut drifted) = (Vec::new(), 0.0);
        for run in 0..runs {
            let mut readings = OfRun::new();
            drifted += walk * random.normal();
            for way in [true, false] {
                for step in 0..targets {
                    let place = if way { step } else { targets - 1 - step };
                    let at = place as f64 / targets as f64;
                    let row = if way { step } else { targets + step };
                    let time = run as f64 + row as f64 / (2 * targets) as f64;
                    let drift = warm * (1.0 - (-time / constant).exp()) + drifted;
                    let lost = if way { 0.0 } else { lost + growing * at };
                    let error = slope * at + bow * at * at + wave * (9.0 * at).sin() + short * (40.0 * at).sin() + lost;
                    let reading = error + drift + scatter * random.normal();
                    readings.insert((place, way), (reading / digits).round() * digits);
                }
            }
            all.push(readings);
        }
        (all, targets, random)
    }

    /// Readings in the order of their rows, with run, target and direction.
    fn in_order(runs: &[OfRun], targets: usize) -> (Vec<f64>, Vec<usize>, Vec<bool>) {
        let up = (0..targets).map(|place| (place, true));
        let keys: Vec<(usize, bool)> = up.chain((0..targets).rev().map(|place| (place, false))).collect();
        let readings = runs.iter().flat_map(|run| keys.iter().map(|key| run[key])).collect();
        let all = || runs.iter().flat_map(|_| keys.iter().copied());
        (readings, all().map(|key| key.0).collect(), all().map(|key| key.1).collect())
    }

    fn rows_off(runs: &[OfRun], targets: usize, late: isize, digit: f64) -> Option<(isize, f64, f64)> {
        let (mut readings, places, ways) = in_order(runs, targets);
        match late {
            1 => readings.rotate_right(1),
            -1 => readings.rotate_left(1),
            _ => {}
        }
        InOrder { readings: &readings, places: &places, ways: &ways }.rows_off(digit)
    }

    #[test]
    fn good_readings_get_no_word() {
        let (mut off, mut rows) = (0, 0);
        for seed in 0..60_000 {
            let (runs, targets, _) = axis(seed);
            let (told_off, told_rows) =
                (run_off(&runs.iter().collect::<Vec<_>>(), digits(seed)), rows_off(&runs, targets, 0, digits(seed)));
            off += usize::from(told_off.is_some());
            rows += usize::from(told_rows.is_some());
        }
        assert_eq!((off, rows), (0, 0));
    }

    #[test]
    fn a_run_that_is_off_is_found() {
        let (mut found, mut all) = (0, 0);
        for seed in 0..2_000 {
            let (mut runs, _, mut random) = axis(seed);
            let wrong = seed as usize % runs.len();
            let by = 30.0 * random.normal();
            runs[wrong].values_mut().for_each(|reading| *reading += by);
            let told = run_off(&runs.iter().collect::<Vec<_>>(), digits(seed));
            assert!(told.as_ref().is_none_or(|told| told.run == wrong), "{seed}: {told:?}");
            all += usize::from(runs.len() > OTHERS);
            found += usize::from(told.is_some());
        }
        assert!(3 * found > all, "{found} of {all}");
    }

    #[test]
    fn a_direction_of_a_run_that_is_off_is_found() {
        let (mut found, mut all) = (0, 0);
        for seed in 0..2_000 {
            let (mut runs, _, mut random) = axis(seed);
            let (wrong, way) = (seed as usize % runs.len(), seed % 4 < 2);
            let by = 30.0 * random.normal();
            let of_way = runs[wrong].iter_mut().filter(|((_, up), _)| *up == way);
            of_way.for_each(|(_, reading)| *reading += by);
            let told = run_off(&runs.iter().collect::<Vec<_>>(), digits(seed));
            assert!(told.as_ref().is_none_or(|told| (told.run, told.way) == (wrong, Some(way))), "{seed}: {told:?}");
            all += usize::from(runs.len() > OTHERS);
            found += usize::from(told.is_some());
        }
        assert!(3 * found > all, "{found} of {all}");
    }

    #[test]
    fn rows_beside_their_positions_are_found() {
        let (mut found, mut all) = (0, 0);
        for seed in 0..4_000 {
            let (runs, targets, _) = axis(seed);
            let late = if seed.is_multiple_of(2) { 1 } else { -1 };
            let told = rows_off(&runs, targets, late, digits(seed));
            assert!(told.is_none_or(|told| told.0 == late), "{seed}: {told:?}");
            all += 1;
            found += usize::from(told.is_some());
        }
        // Where the scatter is as large as the errors nothing tells.
        assert!(8 * found > all, "{found} of {all}");
    }
}
