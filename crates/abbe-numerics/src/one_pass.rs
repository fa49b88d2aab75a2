//! What is kept of many numbers that are seen once, one after another, in memory that does not grow with them.

use std::collections::BTreeSet;

use crate::channels::{AS_OFTEN, ClippedEnd, EQUAL, NEXT, VALUES};
use crate::sampling::mixed;

/// Some of many items, chosen at random by their number alone: all while there are no more than wanted, then as many as wanted. The
/// same items are chosen of the same numbers, whatever the items are.
///
/// ```
/// use abbe_numerics::Chosen;
///
/// let mut chosen = Chosen::new(100);
/// (0..10_000).for_each(|number| chosen.push(number, || number * 2));
/// let items = chosen.items();
/// assert_eq!(items.len(), 100);
/// assert!(items.iter().all(|(number, item)| *item == number * 2));
/// ```
#[derive(Debug, Clone)]
pub struct Chosen<T> {
    wanted: usize,
    /// Hash, number and item; those with the smallest hashes are chosen.
    kept: Vec<(u64, u64, T)>,
    /// Larger hashes are not chosen.
    limit: u64,
}

impl<T> Chosen<T> {
    /// None yet, and at most so many.
    pub fn new(wanted: usize) -> Self {
        Self { wanted: wanted.max(1), kept: Vec::new(), limit: u64::MAX }
    }

    /// Looks at an item. Each number is there once.
    pub fn push(&mut self, number: u64, item: impl FnOnce() -> T) {
        let hash = mixed(number);
        if hash > self.limit {
            return;
        }
        self.kept.push((hash, number, item()));
        if self.kept.len() >= 2 * self.wanted {
            self.cut();
        }
    }

    fn cut(&mut self) {
        if self.kept.len() > self.wanted {
            let (_, last, _) = self.kept.select_nth_unstable_by_key(self.wanted - 1, |(hash, ..)| *hash);
            self.limit = last.0;
            self.kept.truncate(self.wanted);
        }
    }

    /// The chosen items with their numbers, in the order of these.
    pub fn items(mut self) -> Vec<(u64, T)> {
        self.cut();
        self.kept.sort_unstable_by_key(|(_, number, _)| *number);
        self.kept.into_iter().map(|(_, number, item)| (number, item)).collect()
    }
}

/// How many different hashes are kept to count values.
const HASHES: usize = 4096;

/// The number of different values: exact up to 4096, with a standard deviation of 1.6 % beyond (the smallest hashes tell how dense all
/// are: Bar-Yossef et al. 2002, RANDOM).
#[derive(Debug, Clone, Default)]
struct Different(BTreeSet<u64>);

impl Different {
    fn push(&mut self, value: f64) {
        // Both zeros are one value.
        let hash = mixed((value + 0.0).to_bits());
        if self.0.len() < HASHES {
            self.0.insert(hash);
        } else if self.0.last().is_some_and(|last| hash < *last) && self.0.insert(hash) {
            self.0.pop_last();
        }
    }

    fn count(&self) -> f64 {
        match self.0.last().filter(|_| self.0.len() >= HASHES) {
            Some(last) => (HASHES - 1) as f64 * (u64::MAX as f64 / *last as f64),
            None => self.0.len() as f64,
        }
    }
}

/// A value, how often it is there, and where first.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Level {
    value: f64,
    count: usize,
    first: u64,
}

/// Extremes of readings and the values next to them, with how often each is there: what [`clipped_ends`](crate::clipped_ends) tells, of
/// readings that are seen once. Readings are finite.
///
/// ```
/// use abbe_numerics::Ends;
///
/// let mut ends = Ends::default();
/// (0..200).for_each(|row| ends.push(row, (0.11 * row as f64).sin().min(0.7)));
/// let (clipped, first) = ends.clipped()[0];
/// assert!(clipped.is_largest && clipped.value == 0.7 && first == 8);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Ends {
    /// The largest values, the largest one first.
    high: Vec<Level>,
    /// The smallest values with the other sign, so.
    low: Vec<Level>,
    different: Different,
    count: usize,
}

impl Ends {
    /// Looks at a reading; `number` says where it stands.
    pub fn push(&mut self, number: u64, reading: f64) {
        self.count += 1;
        self.different.push(reading);
        push_level(&mut self.high, reading, number);
        push_level(&mut self.low, -reading, number);
    }

    /// Smallest and largest reading.
    pub fn range(&self) -> Option<[f64; 2]> {
        Some([-self.low.first()?.value, self.high.first()?.value])
    }

    /// The ends that are clipped, each with the number of its first reading.
    pub fn clipped(&self) -> Vec<(ClippedEnd, u64)> {
        let different = self.different.count();
        let (Some(high), Some(low)) = (self.high.first(), self.low.first()) else { return Vec::new() };
        if different < VALUES as f64 {
            return Vec::new();
        }
        let usual = self.count.saturating_sub(high.count + low.count) as f64 / (different - 2.0);
        let end = |levels: &[Level], is_largest: bool| {
            let Level { value, count, first } = *levels.first()?;
            let value = if is_largest { value } else { -value };
            let nearby = levels[1..].iter().take(NEXT).map(|level| level.count).max().unwrap_or(0);
            let is_clipped = count >= EQUAL && count as f64 >= AS_OFTEN * usual.max(nearby as f64) && value != 0.0;
            is_clipped.then_some((ClippedEnd { value, is_largest, count, nearby }, first))
        };
        [end(&self.high, true), end(&self.low, false)].into_iter().flatten().collect()
    }
}

/// Counts a value if it is among the largest ones. What is none of them now is none later.
fn push_level(levels: &mut Vec<Level>, value: f64, number: u64) {
    if levels.last().is_some_and(|last| levels.len() > NEXT && value < last.value) {
        return;
    }
    let place = levels.iter().position(|level| level.value <= value).unwrap_or(levels.len());
    match levels.get_mut(place) {
        Some(level) if level.value == value => level.count += 1,
        _ => {
            levels.insert(place, Level { value, count: 1, first: number });
            levels.truncate(NEXT + 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clipped_ends;

    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state += 1;
            (mixed(state) >> 11) as f64 / (1_u64 << 53) as f64
        }
    }

    #[test]
    fn ends_are_those_of_readings_that_are_held() {
        let mut clipped = 0;
        for seed in 0..200 {
            let mut next = random(1000 * seed);
            let (step, limit) = ([1e-3, 0.01, 0.1, 0.5][seed as usize % 4], 0.3 + next());
            let rows = 3 + (400.0 * next()) as usize;
            let reading = |_| ((6.0 * next()).sin().clamp(-1.0, limit) / step).round() * step;
            let readings: Vec<f64> = (0..rows).map(reading).collect();
            let mut ends = Ends::default();
            readings.iter().enumerate().for_each(|(row, reading)| ends.push(row as u64, *reading));
            let held = clipped_ends(&readings);
            let found = ends.clipped();
            assert_eq!(found.iter().map(|(end, _)| *end).collect::<Vec<_>>(), held, "seed {seed}");
            for (end, first) in found {
                assert_eq!(readings.iter().position(|reading| *reading == end.value), Some(first as usize));
                clipped += 1;
            }
        }
        assert!(clipped > 20, "{clipped}");
        assert!(Ends::default().clipped().is_empty() && Ends::default().range().is_none());
    }

    #[test]
    fn many_different_values_are_counted() {
        for count in [1, 4095, 4096, 50_000, 400_000] {
            let mut different = Different::default();
            for value in 0..count {
                (0..2).for_each(|_| different.push(f64::from(value) * 1e-3));
            }
            let off = different.count() / f64::from(count) - 1.0;
            assert!(if count < 4096 { off == 0.0 } else { off.abs() < 0.08 }, "{count}: {off}");
        }
    }

    #[test]
    fn items_are_chosen_all_over() {
        for count in [1_u64, 50, 199, 200, 100_000] {
            let mut chosen = Chosen::new(200);
            (0..count).for_each(|number| chosen.push(number, || number));
            let items = chosen.items();
            assert_eq!(items.len() as u64, count.min(200));
            assert!(items.is_sorted_by(|one, other| one.0 < other.0));
            let lower = items.iter().filter(|(number, _)| *number < count / 2).count();
            assert!(count < 1000 || (60..140).contains(&lower), "{lower} of {count}");
        }
    }
}
