//! Whether the labels of tests follow each other as the times of their rows do.

/// A test whose rows have times.
#[derive(Debug, Clone, PartialEq)]
pub struct TimedTest {
    /// Its label.
    pub label: String,
    /// First and last time of its rows, s.
    pub time_s: [f64; 2],
}

/// Probability below which tests whose clocks have nothing to do with each other do not stand in order by chance.
const BY_CHANCE: f64 = 1e-3;

/// Most tests that a sentence names.
const NAMED: usize = 4;

/// A sentence on tests whose labels stand in another order than the times of their rows, where most others stand in that order. `tests` are
/// in the order of their labels, `by` is the column of these.
///
/// None where times of tests overlap: each then has a clock of its own.
///
/// ```
/// use abbe_trend::{TimedTest, out_of_order};
///
/// let test = |week: usize| TimedTest { label: format!("{week}"), time_s: [6e5 * week as f64, 6e5 * week as f64 + 1e3] };
/// let mut tests: Vec<TimedTest> = (1..=12).map(test).collect();
/// assert_eq!(out_of_order("week", &tests), None);
/// let of_three = tests[2].time_s;
/// tests[2].time_s = tests[8].time_s;
/// tests[8].time_s = of_three;
/// assert!(out_of_order("week", &tests).unwrap().contains("3 and 9"));
/// ```
pub fn out_of_order(by: &str, tests: &[TimedTest]) -> Option<String> {
    let mut order: Vec<usize> = (0..tests.len()).collect();
    order.sort_by(|one, other| tests[*one].time_s[0].total_cmp(&tests[*other].time_s[0]));
    let is_one_clock = order.windows(2).all(|pair| tests[pair[0]].time_s[1] < tests[pair[1]].time_s[0]);
    let displaced: Vec<usize> = (0..tests.len()).filter(|place| order[*place] != *place).collect();
    if !is_one_clock || displaced.is_empty() || by_chance(tests.len(), displaced.len()) > BY_CHANCE {
        return None;
    }
    let labels: Vec<&str> = displaced.iter().map(|place| tests[*place].label.as_str()).collect();
    let listed = match labels.as_slice() {
        [named @ .., last] if labels.len() <= NAMED => format!("{} and {last}", named.join(", ")),
        _ => format!("{} and {} more", labels[..NAMED].join(", "), labels.len() - NAMED),
    };
    let exchanged = if displaced.len() == 2 { "are the two exchanged" } else { "are they right" };
    Some(format!(
        "the times of the rows of {by} {listed} do not stand in the order of these labels, and those of the {} others do: {exchanged}? A \
         trend takes the labels as times",
        tests.len() - displaced.len()
    ))
}

/// The probability that at most so many of some things in random order are not at their place: the sum of the ways to choose them times
/// that of the orders in which none of them is at its place, over all orders.
fn by_chance(all: usize, displaced: usize) -> f64 {
    // Orders of `count` things with none at its place, over those of all of them.
    let (mut none_at_its_place, mut sum, mut term) = (1.0, 0.0, 1.0);
    for count in 0..=displaced {
        if count > 0 {
            term *= -1.0 / count as f64;
            none_at_its_place += term;
        }
        // (n choose k) k! / n! = 1 / (n - k)!
        let others: f64 = (1..=all.saturating_sub(count)).map(|factor| (factor as f64).ln()).sum();
        sum += none_at_its_place * (-others).exp();
    }
    sum
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;

    fn tests(times: &[f64]) -> Vec<TimedTest> {
        let test = |(place, time): (usize, &f64)| TimedTest { label: place.to_string(), time_s: [*time, time + 1.0] };
        times.iter().enumerate().map(test).collect()
    }

    #[test]
    fn the_probability_is_that_of_all_orders() {
        // Orders of four things: 1 with all at their places, none with three, 6 with two, 8 with one.
        assert!((by_chance(4, 0) - 1.0 / 24.0).abs() < 1e-12);
        assert!((by_chance(4, 2) - 7.0 / 24.0).abs() < 1e-12);
        assert!((by_chance(4, 3) - 15.0 / 24.0).abs() < 1e-12);
        assert!((by_chance(4, 4) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn clocks_of_their_own_get_no_word() {
        let mut told = 0;
        for seed in 0..5000 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut below = |count: u32| f64::from(random.next_u32() % count);
            let count = 2 + below(38.0 as u32) as usize;
            // A clock since the machine was started, one that begins anew, one for all tests, and one that runs down.
            let times: Vec<f64> = match seed % 4 {
                0 => (0..count).map(|_| 3.0 * below(1_000_000)).collect(),
                1 => (0..count).map(|_| 0.0).collect(),
                2 => (0..count).map(|place| 1e4 * place as f64 + below(5000)).collect(),
                _ => (0..count).map(|place| -1e4 * place as f64 + below(5000)).collect(),
            };
            told += usize::from(out_of_order("week", &tests(&times)).is_some());
        }
        assert!(told <= 1, "{told} of 5000");
    }

    #[test]
    fn exchanged_labels_are_told_from_eight_tests_on() {
        for (count, is_told) in [(4, false), (8, true), (40, true)] {
            let mut times: Vec<f64> = (0..count).map(|place| 1e4 * f64::from(place)).collect();
            times.swap(1, 3);
            let told = out_of_order("week", &tests(&times));
            assert_eq!(told.is_some(), is_told, "{count}: {told:?}");
            assert!(told.is_none_or(|told| told.contains("of week 1 and 3 do not")), "{count}");
        }
    }
}
