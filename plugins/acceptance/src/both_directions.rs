//! What readings of both directions tell of each other: that one direction has another unit, or its signs turned.

use std::collections::BTreeSet;
use std::f64::consts::TAU;

use abbe_numerics::correlation_by_chance;

/// Fewest readings of a direction that is compared with the other.
const COMPARED: usize = 8;

/// Part of the other direction below which readings are in another unit. Inches are 25.4 times as large as millimetres.
const SMALLER: f64 = 0.1;

/// A reading, with the place at which it was read.
type Reading = (usize, f64);

/// Parts of a turn that are one place, and where the first begins, rad: not at an angle that people choose.
const PLACES: f64 = 36.0;
const FIRST: f64 = 0.03;

/// The place of an angle, rad, on a circle.
pub fn place_of_angle(angle: f64) -> usize {
    ((angle + FIRST).rem_euclid(TAU) * PLACES / TAU) as usize
}

/// A sentence on readings of one direction that are far smaller than those of the other, at places that have both. Columns of readings,
/// whether a row is in the positive direction, the place of a row, and the unit.
///
/// Compared are ranges, and what is left of readings when they follow a smooth curve: an axis may err in one direction alone, but noise
/// does not know the direction. The digits of readings are added to the smaller ones: what they hide may be there.
pub fn smaller_direction(columns: &[&[f64]], ways: &[bool], places: &[usize], unit: &str) -> Option<String> {
    let visited = |way: bool| -> BTreeSet<usize> {
        places.iter().zip(ways).filter(|(_, own)| **own == way).map(|(place, _)| *place).collect()
    };
    let both = &visited(true) & &visited(false);
    let rows = |way: bool| (0..ways.len()).filter(move |row| ways[*row] == way);
    let of = |column: &[f64], way: bool| -> Vec<Reading> {
        rows(way).filter(|row| both.contains(&places[*row])).map(|row| (places[row], column[row])).collect()
    };
    let split: Vec<[Vec<Reading>; 2]> = columns.iter().map(|column| [false, true].map(|way| of(column, way))).collect();
    if split.iter().flatten().any(|readings| readings.len() < COMPARED) {
        return None;
    }
    let digits = split.iter().map(|[one, other]| least_step(one, other)).fold(0.0, f64::max);
    let largest = |size: fn(&[Reading]) -> f64| {
        [0, 1].map(|way: usize| split.iter().map(|own| size(&own[way])).fold(0.0, f64::max))
    };
    let (ranges, noises) = (largest(range), largest(roughness));
    let is_smaller = |sizes: [f64; 2], way: usize| sizes[way] + digits < SMALLER * sizes[1 - way];
    let way = [0, 1].into_iter().find(|way| is_smaller(ranges, *way) && is_smaller(noises, *way))?;
    let name = ["-1", "1"];
    Some(format!(
        "readings of direction {} are within {:.3} {unit}, and those of direction {} within {:.3} {unit}: is one direction in another \
         unit?",
        name[way],
        ranges[way],
        name[1 - way],
        ranges[1 - way]
    ))
}

fn range(readings: &[Reading]) -> f64 {
    let ends =
        readings.iter().fold((f64::MAX, f64::MIN), |(low, high), (_, value)| (low.min(*value), high.max(*value)));
    (ends.1 - ends.0).max(0.0)
}

/// The median of what three neighbours do not foretell of a reading. One reading that is far off does not move it. Where a run begins
/// again at its first place there are no neighbours.
fn roughness(readings: &[Reading]) -> f64 {
    let is_one_way =
        |own: &&[Reading]| own.is_sorted_by(|one, two| one.0 <= two.0) || own.is_sorted_by(|one, two| one.0 >= two.0);
    let third = |own: &[Reading]| (own[3].1 - 3.0 * own[2].1 + 3.0 * own[1].1 - own[0].1).abs();
    let mut all: Vec<f64> = readings.windows(4).filter(is_one_way).map(third).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(0.0)
}

/// The least step between two different readings: their digits, or less.
fn least_step(one: &[Reading], other: &[Reading]) -> f64 {
    let mut all: Vec<f64> = one.iter().chain(other).map(|(_, reading)| *reading).collect();
    all.sort_by(f64::total_cmp);
    let steps = all.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0);
    steps.reduce(f64::min).unwrap_or(0.0)
}

/// How many times more the difference of both directions has to vary along the travel than their sum.
const TURNED: f64 = 4.0;

/// Spreads below this are rounding, µm or µrad.
const ROUNDING: f64 = 1e-3;

/// Probability with which chance may make errors of both directions that are so opposite.
const CHANCE: f64 = 1e-4;

/// Lost motion keeps its sign along the travel, and its largest is hardly more than this number of times its smallest.
const LOST_MOTION: f64 = 5.0;

/// Fewest targets whose short waves are looked at, and the probability with which chance may make what both directions have in common.
const SHORT_WAVES: usize = 10;
const COMMON: f64 = 0.05;

/// A sentence on errors of one direction that are those of the other with the sign turned: mean readings up and down, target by target.
///
/// Errors of an axis are mostly the same in both directions, so that their difference, the lost motion, varies less along the travel than
/// their sum. Where it varies far more, and both are opposite beyond chance, a sign is wrong; unless the difference may be lost motion
/// (it keeps its sign and its size), or short waves (of a screw, a scale or gears) are the same in both directions.
pub fn mirrored(means: &[[f64; 2]], unit: &str) -> Option<String> {
    let along = |of: fn(&[f64; 2]) -> f64| means.iter().map(of).collect::<Vec<f64>>();
    let (up, down) = (along(|own| own[0]), along(|own| own[1]));
    let (sums, differences) = (along(|own| own[0] + own[1]), along(|own| own[0] - own[1]));
    let (sum, difference) = (spread(&sums), spread(&differences));
    let opposite = correlation(&up, &down);
    let is_chance = opposite > 0.0 || 0.5 * correlation_by_chance(opposite, means.len()) > CHANCE;
    if difference <= TURNED * sum.max(ROUNDING) || is_chance || may_be_lost_motion(&differences) {
        return None;
    }
    let (up, down) = (second_differences(&up), second_differences(&down));
    let common = correlation(&up, &down);
    let is_common = common > 0.0 && 0.5 * correlation_by_chance(common, up.len()) < COMMON;
    (means.len() < SHORT_WAVES || !is_common).then(|| {
        format!(
            "readings of one direction are those of the other with the sign turned: the means of both are {difference:.2} {unit} apart along \
             the travel, and {sum:.2} {unit} with the signs of one direction turned (root mean square about their mean): is the sign of \
             rows with `direction` 1 wrong, or of those with -1?"
        )
    })
}

fn may_be_lost_motion(differences: &[f64]) -> bool {
    let keeps_sign = differences.iter().all(|own| *own > 0.0) || differences.iter().all(|own| *own < 0.0);
    let sizes = || differences.iter().map(|own| own.abs());
    keeps_sign && sizes().fold(0.0, f64::max) <= LOST_MOTION * sizes().fold(f64::MAX, f64::min)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Root mean square about the mean.
fn spread(values: &[f64]) -> f64 {
    let mean = mean(values);
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Pearson's coefficient of correlation; zero where one does not vary.
fn correlation(one: &[f64], other: &[f64]) -> f64 {
    let (of_one, of_other) = (mean(one), mean(other));
    let products = one.iter().zip(other).map(|(one, other)| (one - of_one) * (other - of_other));
    let found = products.sum::<f64>() / (one.len() as f64 * spread(one) * spread(other));
    if found.is_finite() { found.clamp(-1.0, 1.0) } else { 0.0 }
}

fn second_differences(values: &[f64]) -> Vec<f64> {
    values.windows(3).map(|own| own[2] - 2.0 * own[1] + own[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reproducible normal numbers.
    fn normal(seed: u64) -> impl FnMut() -> f64 {
        let mut generator = abbe_numerics::Generator::new(seed, 0);
        move || generator.normal()
    }

    /// Axes with errors of all kinds, measured as they are: no word on a unit, whatever noise, digits and lost motion are.
    #[test]
    fn directions_of_one_unit_get_no_word() {
        let mut told = 0;
        for seed in 0..20_000 {
            let mut next = normal(seed);
            let runs = 1 + seed as usize % 5;
            let targets = 5 + seed as usize % 17;
            let size = 10_f64.powf(next().clamp(-2.0, 1.0));
            let (slope, wave, backlash, growing) = (size * next(), size * next(), size * next(), size * next());
            let noise = 10_f64.powf(next().clamp(-2.0, 1.0));
            let digits = [0.001, 0.1, 1.0, 5.0][seed as usize % 4];
            // The positive direction may be corrected, so that it has no error left.
            let own = if seed % 3 == 0 { 0.0 } else { 1.0 };
            let (mut readings, mut ways, mut places) = (Vec::new(), Vec::new(), Vec::new());
            for _ in 0..runs {
                for way in [true, false] {
                    for place in 0..targets {
                        let at = place as f64 / targets as f64;
                        let lost = if way { 0.0 } else { backlash + growing * at };
                        let error = own * (slope * at + wave * (9.0 * at).sin()) + lost + noise * next();
                        readings.push((error / digits).round() * digits);
                        ways.push(way);
                        places.push(place);
                    }
                }
            }
            told += usize::from(smaller_direction(&[&readings], &ways, &places, "um").is_some());
        }
        assert_eq!(told, 0);
    }

    #[test]
    fn a_direction_in_another_unit_is_told_with_what_it_is() {
        for (factor, least) in [(1e-3, 300), (1.0 / 25.4, 150), (1e3, 300)] {
            for turned in [true, false] {
                let mut told = 0;
                for seed in 0..300 {
                    let mut next = normal(seed);
                    let ways: Vec<bool> = (0..100).map(|row| row / 10 % 2 == 0).collect();
                    let places: Vec<usize> = (0..100).map(|row| row % 10).collect();
                    let noise = 0.1 + next().abs();
                    let error = |row: usize| 8.0 * (places[row] as f64 / 3.0).sin();
                    let readings: Vec<f64> = (0..100)
                        .map(|row| (error(row) + noise * next()) * if ways[row] == turned { factor } else { 1.0 })
                        .collect();
                    let said = smaller_direction(&[&readings], &ways, &places, "um");
                    let small = turned == (factor < 1.0);
                    let name = if small { "direction 1 are within" } else { "direction -1 are within" };
                    assert!(said.as_ref().is_none_or(|said| said.contains(name)), "{said:?}");
                    told += usize::from(said.is_some());
                }
                assert!(told >= least, "{factor} {turned}: {told}");
            }
        }
    }

    /// One far reading, few readings, and places that only one direction visits make no other unit.
    #[test]
    fn what_cannot_be_compared_gets_no_word() {
        let mut next = normal(1);
        let ways: Vec<bool> = (0..40).map(|row| row < 20).collect();
        let places: Vec<usize> = (0..40).map(|row| row % 20).collect();
        let noise: Vec<f64> = (0..40).map(|_| next()).collect();
        let far: Vec<f64> = noise.iter().enumerate().map(|(row, own)| if row == 5 { 1e4 } else { *own }).collect();
        assert_eq!(smaller_direction(&[&far], &ways, &places, "um"), None);
        let small: Vec<f64> = noise.iter().zip(&ways).map(|(own, way)| if *way { 1e-3 * own } else { *own }).collect();
        assert!(smaller_direction(&[&small], &ways, &places, "um").is_some());
        let apart: Vec<usize> = (0..40).map(|row| if row < 20 { row } else { row + 13 - 20 }).collect();
        assert_eq!(smaller_direction(&[&small], &ways, &apart, "um"), None);
        // A second transducer is small in one direction where the first is not.
        assert_eq!(smaller_direction(&[&small, &noise], &ways, &places, "um"), None);
        assert_eq!(place_of_angle(-1e-12), place_of_angle(TAU));
        assert!((0..1000).all(|k| place_of_angle(0.1 * f64::from(k) - 50.0) < 36));
    }

    /// The means of a random axis by target: errors that both directions have, lost motion, noise of the means.
    fn axis(
        next: &mut impl FnMut() -> f64,
        targets: usize,
        lost: impl Fn(f64) -> f64,
        size: f64,
        noise: f64,
    ) -> Vec<[f64; 2]> {
        let (slope, bow, wave, phase) = (next(), next(), next(), next());
        let mean = |at: f64| size * (3.0 * slope * at + 2.0 * bow * at * at + wave * (15.0 * at + phase).sin());
        let at = |target: usize| target as f64 / targets as f64;
        let own =
            |target: usize| [1.0, -1.0].map(|way| mean(at(target)) + way * 0.5 * lost(at(target)) + noise * next());
        (0..targets).map(own).collect()
    }

    #[test]
    fn axes_with_right_signs_get_no_word() {
        let mut told = 0;
        for seed in 0..50_000 {
            let mut next = normal(seed);
            let targets = 5 + seed as usize % 17;
            let (first, last) = (1.0 + next().abs(), 1.0 + next().abs());
            let size = [0.0, 0.1, 1.0, 5.0][seed as usize % 4];
            let noise = [0.01, 0.3, 2.0][seed as usize % 3];
            let means = axis(&mut next, targets, |at| first + (last - first) * at, size, noise);
            told += usize::from(mirrored(&means, "um").is_some());
        }
        // Noise alone: chance makes such a correlation five times, and lost motion keeps its sign in most of them.
        assert!(told <= 6, "{told}");
    }

    /// Lost motion that grows, or is worn in the middle of the travel, of an axis without other errors: it has one sign.
    #[test]
    fn lost_motion_that_differs_along_the_travel_gets_no_word() {
        let (mut told, mut worn) = (0, 0);
        for seed in 0..20_000 {
            let mut next = normal(seed);
            let targets = 5 + seed as usize % 17;
            let (least, more) = (1.0 + next().abs(), 3.0 * next().abs().min(1.0));
            let shape = seed % 2 == 0;
            let lost = |at: f64| least * (1.0 + more * if shape { at } else { (3.0 * at).sin() });
            let means = axis(&mut next, targets, lost, 0.0, 0.05);
            let (sum, difference) =
                (spread(&means.iter().map(|own| own[0] + own[1]).collect::<Vec<_>>()), more * least);
            worn += usize::from(difference > 8.0 * sum);
            told += usize::from(mirrored(&means, "um").is_some());
        }
        assert!(worn > 5_000, "{worn}");
        assert!(told <= 6, "{told}");
        // It is compensated by its mean, so that it has both signs; the pitch of the screw tells.
        let mut told = 0;
        for seed in 0..2_000 {
            let mut next = normal(seed);
            let means: Vec<[f64; 2]> = (0..21)
                .map(|target| {
                    let (at, pitch) = (f64::from(target) / 20.0, 0.5 * next());
                    [1.0, -1.0].map(|way| pitch + way * 8.0 * (at - 0.5) + 0.1 * next())
                })
                .collect();
            told += usize::from(mirrored(&means, "um").is_some());
        }
        assert_eq!(told, 0);
    }

    #[test]
    fn a_direction_with_turned_signs_is_told() {
        for way in [0, 1] {
            let (mut told, mut all) = (0, 0);
            for seed in 0..5_000 {
                let mut next = normal(seed);
                let lost = next().abs();
                let mut means = axis(&mut next, 6 + seed as usize % 15, |_| lost, 4.0, 0.1);
                let is_large = spread(&means.iter().map(|own| own[0]).collect::<Vec<_>>()) > 3.0;
                means.iter_mut().for_each(|own| own[way] = -own[way]);
                all += usize::from(is_large);
                told += usize::from(is_large && mirrored(&means, "um").is_some());
            }
            assert!(all > 3_000 && 10 * told > 9 * all, "{told} of {all}");
        }
    }
}
