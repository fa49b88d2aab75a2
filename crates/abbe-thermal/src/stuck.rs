//! Sensors that stand still: in all rows, or for long while they move before and after. Readings that have settled stand still as well, where
//! the digits are coarser than what is left of the motion.

use std::ops::Range;

/// Rows in which no sensor that works reads the same.
pub(crate) const LONG: usize = 20;

/// Steps of the digits by which a reading may differ from the next one in a motion that goes on, with what rounding adds.
const A_DIGIT: f64 = 1.5;

/// Part of the rows nearby that have to go on smoothly, and how much: bends up to so many digits, and this part of the larger step.
const SMOOTH: f64 = 0.8;
const BEND: f64 = 2.25;
const OF_STEP: f64 = 0.5;

/// Distances from rest, digits, each half of the one before. A motion that settles takes as long for each half, or longer; one that
/// stops takes half as long.
const HALVES: [f64; 5] = [16.0, 8.0, 4.0, 2.0, 1.0];

/// The part of that time that is enough, and the part of a row that counting in whole rows may lack.
const AS_LONG: f64 = 0.8;
const OF_ROW: f64 = 0.5;

/// Whether readings are all the same, in so many rows that no sensor that works reads so.
pub fn is_dead(values: &[f64]) -> bool {
    values.len() >= LONG && values.iter().all(|value| *value == values[0])
}

/// A sensor that stands still for long while it moves in other rows ([`stuck_part`]), in words; `first` is the number of its first row.
pub fn stuck(name: &str, values: &[f64], first: usize) -> Option<String> {
    let (row, count) = stuck_part(values)?;
    let (from, to) = (first + row, first + row + count - 1);
    Some(format!("{name} reads the same from row {from} to row {to}, and moves in others: was it stuck?"))
}

/// Where readings stand still for long while they move in most rows before and after: the first row, and how many. They may stand at
/// the beginning, while a machine rests, and where they have settled to less than a digit.
///
/// ```
/// use abbe_thermal::stuck_part;
///
/// // A drift of 40 um with digits of 1 um that settles, and the same with a sensor that stops at row 10.
/// let mut drift: Vec<f64> = (0..80).map(|row| (40.0 * (1.0 - (-f64::from(row) / 12.0).exp())).round()).collect();
/// assert_eq!(stuck_part(&drift), None);
/// let last = drift[10];
/// drift[10..].fill(last);
/// assert_eq!(stuck_part(&drift), Some((10, 70)));
/// ```
pub fn stuck_part(values: &[f64]) -> Option<(usize, usize)> {
    let mut first = 0;
    let stands = values.chunk_by(|one, next| one == next).map(|same| {
        first += same.len();
        first - same.len()..first
    });
    let stuck = stands.filter(|stand| is_beyond_chance(values, stand) && !has_settled(values, stand));
    stuck.max_by_key(Range::len).map(|stand| (stand.start, stand.len()))
}

/// As many rows before and after a time as it has itself, without the steps within it; the last so many rows of a log are left out.
fn nearby(values: &[f64], stand: &Range<usize>, last: usize) -> Vec<usize> {
    let near = stand.start.saturating_sub(stand.len()) + 1..(stand.end + stand.len()).min(values.len() - last);
    near.filter(|row| !(stand.start + 1..stand.end - last).contains(row)).collect()
}

/// Whether readings stand for longer than those nearby do by chance, which happens once in a thousand logs or less.
fn is_beyond_chance(values: &[f64], stand: &Range<usize>) -> bool {
    if stand.start == 0 || stand.len() <= LONG {
        return false;
    }
    let others = nearby(values, stand, 0);
    let still = others.iter().filter(|&&row| values[row] == values[row - 1]).count() + 1;
    let still = still as f64 / (others.len() + 2) as f64;
    still.powf((stand.len() - 1) as f64) * (values.len() as f64) < 1e-3
}

/// Whether digits explain that readings stand: these come within a digit, go on within a digit where they go on, are smooth else, and
/// settle where they stand to the end.
fn has_settled(values: &[f64], stand: &Range<usize>) -> bool {
    let digit = digit(values);
    let off = |row: usize| (values[row] - values[stand.start]).abs() / digit;
    let is_left = stand.end < values.len();
    if off(stand.start - 1) > A_DIGIT || (is_left && off(stand.end) > A_DIGIT) {
        return false;
    }
    let rows = nearby(values, stand, 1);
    let smooth = rows.iter().filter(|&&row| {
        let [before, after] = [values[row] - values[row - 1], values[row + 1] - values[row]];
        (after - before).abs() <= BEND * digit + OF_STEP * before.abs().max(after.abs())
    });
    smooth.count() as f64 >= SMOOTH * rows.len() as f64 && (is_left || settles(stand.start, off))
}

/// Whether readings before this row, which are so many digits off, come to rest: they take as long for the last halves of the way.
fn settles(end: usize, off: impl Fn(usize) -> f64) -> bool {
    // Numbers of a file in other units are rounded.
    let last = |digits: f64| (0..end).rev().find(|row| off(*row) > digits - 0.25);
    let from = HALVES.windows(3).find_map(|halves| Some((last(halves[0])?, [halves[1], halves[2]])));
    let Some((far, [half, quarter])) = from else { return true };
    let (Some(half), Some(quarter)) = (last(half), last(quarter)) else { return true };
    quarter > half && (quarter - half) as f64 + OF_ROW >= AS_LONG * (half - far) as f64
}

/// The smallest difference of readings that differ.
fn digit(values: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let range = sorted.last().zip(sorted.first()).map_or(0.0, |(last, first)| last - first);
    let apart = sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|apart| *apart > 1e-9 * range);
    apart.fold(range, f64::min)
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;

    use super::*;

    /// A number from 0 to 1.
    fn part(random: &mut Generator) -> f64 {
        0.5 + 0.5 * random.uniform() / 3.0_f64.sqrt()
    }

    /// A drift of 3 to 150 digits that settles with one or two time constants, and its readings with noise up to half a digit.
    fn drift(random: &mut Generator) -> (Vec<f64>, Vec<f64>) {
        let size = 3.0 * 50.0_f64.powf(part(random));
        let slow = 0.03 + 0.3 * part(random);
        let fast = slow * (0.05 + 0.5 * part(random));
        let of_slow = if random.index(2) == 0 { 1.0 } else { part(random) };
        let rows = (60.0 * 16.0_f64.powf(part(random))) as usize;
        let (noise, from) = (0.5 * part(random) * part(random), part(random));
        let at = |row: usize| {
            let time = row as f64 / rows as f64;
            let left = of_slow * (-time / slow).exp() + (1.0 - of_slow) * (-time / fast).exp();
            from + size * (1.0 - left)
        };
        let truth: Vec<f64> = (0..rows).map(at).collect();
        let readings = truth.iter().map(|value| (value + noise * random.normal()).round()).collect();
        (truth, readings)
    }

    #[test]
    fn a_drift_that_settles_in_coarse_digits_is_not_stuck() {
        let told = (0..4000).filter(|seed| stuck_part(&drift(&mut Generator::new(*seed, 1)).1).is_some()).count();
        assert!(told <= 12, "{told} of 4000");
    }

    #[test]
    fn a_sensor_that_stops_before_it_settles_is_told() {
        let mut counts = [[0; 2]; 2];
        for seed in 0..4000 {
            let random = &mut Generator::new(seed, 2);
            let (truth, readings) = drift(random);
            let from = 5 + (0.6 * part(random) * truth.len() as f64) as usize;
            let back = from + 25 + random.index(30);
            for (kind, to) in [truth.len(), back].into_iter().enumerate() {
                // It would have moved by this many digits.
                let moves = (to >= from + 25 && to <= truth.len()).then(|| truth[to - 1] - truth[from]);
                if moves.is_some_and(|moves| moves > 15.0) {
                    let mut stuck = readings.clone();
                    stuck[from..to].fill(readings[from]);
                    counts[kind][0] += 1;
                    counts[kind][1] += usize::from(stuck_part(&stuck).is_some());
                }
            }
        }
        let [[to_end, told_of_end], [between, told_between]] = counts;
        // Motions that are fast at first and slow then look as if they settled, in few rows.
        assert!(to_end > 500 && told_of_end * 4 >= to_end * 3, "{counts:?}");
        assert!(between > 200 && told_between * 10 >= between * 9, "{counts:?}");
    }
}
