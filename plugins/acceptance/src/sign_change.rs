//! A sign that changes within the rows of a test: readings repeat those before with the sign turned.

/// A change of sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignChange {
    /// The first row with the other sign.
    pub row: usize,
    /// Root mean square of what readings of a group are apart from their mean, in their unit.
    pub as_read: f64,
    /// The same with the signs from that row on turned.
    pub turned: f64,
}

/// How many times smaller what readings are apart has to become.
const FALLS: f64 = 4.0;

/// How many times better than a shift from that row on a change of the sign has to explain the readings: a set-up that was lost shifts
/// them.
const THAN_A_SHIFT: f64 = 2.0;

/// Fewest readings on each side.
const COMPARED: usize = 5;

/// The row from which on the signs of readings are turned; none if readings repeat as well as they are, or a shift explains as much.
/// Readings with the same group were made of the same thing. What is below `rounding` is no difference.
pub fn sign_change(readings: &[f64], groups: &[usize], rounding: f64) -> Option<SignChange> {
    let count = groups.iter().max()? + 1;
    let mut sizes = vec![0.0; count];
    let mut sums = vec![0.0; count];
    for (reading, group) in readings.iter().zip(groups) {
        sizes[*group] += 1.0;
        sums[*group] += reading;
    }
    let squares: f64 = readings.iter().map(|reading| reading * reading).sum();
    // Readings less the means of their groups leave as many squares as there are readings, less one for each group.
    let free = readings.len() as f64 - sizes.iter().filter(|size| **size > 0.0).count() as f64;
    let of_means = |sums: &[f64]| {
        sums.iter().zip(&sizes).filter(|(_, size)| **size > 0.0).map(|(sum, size)| sum * sum / size).sum::<f64>()
    };
    let apart = |of_means: f64| ((squares - of_means).max(0.0) / free).sqrt();
    let as_read = apart(of_means(&sums));
    let mut turned = sums.clone();
    let mut best: Option<(usize, f64)> = None;
    // From the last row on, one more at a time.
    let mut explained = of_means(&turned);
    for row in (COMPARED.max(1)..readings.len()).rev() {
        let group = groups[row];
        let before = turned[group];
        turned[group] -= 2.0 * readings[row];
        explained += (turned[group].powi(2) - before.powi(2)) / sizes[group];
        if readings.len() - row >= COMPARED && best.is_none_or(|(_, most)| explained > most) {
            best = Some((row, explained));
        }
    }
    let (row, explained) = best.filter(|_| free >= COMPARED as f64)?;
    let found = SignChange { row, as_read, turned: apart(explained) };
    let shifted = shifted(readings, groups, &sizes, row) / free;
    let is_better = shifted.max(0.0).sqrt() > THAN_A_SHIFT * found.turned.max(rounding);
    (found.as_read > FALLS * found.turned.max(rounding) && is_better).then_some(found)
}

/// What is left of the squares of readings about the means of their groups if those from a row on are shifted by a number.
fn shifted(readings: &[f64], groups: &[usize], sizes: &[f64], row: usize) -> f64 {
    let mut means = vec![[0.0; 2]; sizes.len()];
    for (place, (reading, group)) in readings.iter().zip(groups).enumerate() {
        let is_after = f64::from(u8::from(place >= row));
        means[*group][0] += reading / sizes[*group];
        means[*group][1] += is_after / sizes[*group];
    }
    let (mut own, mut with, mut of_shift) = (0.0, 0.0, 0.0);
    for (place, (reading, group)) in readings.iter().zip(groups).enumerate() {
        let [mean, part] = means[*group];
        let (off, shift) = (reading - mean, f64::from(u8::from(place >= row)) - part);
        own += off * off;
        with += off * shift;
        of_shift += shift * shift;
    }
    if of_shift > 0.0 { own - with * with / of_shift } else { own }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings of an axis in both directions, several runs.
    struct Test {
        readings: Vec<f64>,
        groups: Vec<usize>,
    }

    /// Errors of all kinds; runs drift, and the whole is shifted once.
    fn test(seed: u64, drift: f64, shift: f64) -> Test {
        let mut generator = abbe_numerics::Generator::new(seed, 0);
        let mut next = || generator.normal();
        let (runs, targets) = (2 + seed as usize % 4, 5 + seed as usize % 17);
        let size = 10_f64.powf(next().clamp(-1.0, 1.0));
        let (slope, wave, lost, start) = (size * next(), size * next(), size * next(), size * next());
        let noise = 0.05 * size * 10_f64.powf(next().clamp(-1.0, 1.0));
        let (mut readings, mut groups) = (Vec::new(), Vec::new());
        for run in 0..runs {
            for way in [true, false] {
                for place in 0..targets {
                    let at = place as f64 / targets as f64;
                    let since = if 2 * run >= runs { shift * size } else { 0.0 };
                    let error = start + slope * at + wave * (9.0 * at).sin() + if way { 0.0 } else { lost };
                    readings.push(error + since + drift * size * run as f64 + noise * next());
                    groups.push(2 * place + usize::from(way));
                }
            }
        }
        Test { readings, groups }
    }

    #[test]
    fn readings_of_one_sign_get_no_word() {
        for seed in 0..20_000 {
            let mut generator = abbe_numerics::Generator::new(seed, 1);
            let (drift, shift) = (generator.normal(), 3.0 * generator.normal());
            for (drift, shift) in [(0.0, 0.0), (drift, 0.0), (0.0, shift)] {
                let Test { readings, groups } = test(seed, drift, shift);
                assert_eq!(sign_change(&readings, &groups, 1e-3), None, "{seed} {drift} {shift}");
            }
        }
    }

    #[test]
    fn signs_that_change_are_found() {
        let mut found = 0;
        for seed in 0..2_000 {
            let Test { mut readings, groups } = test(seed, 0.0, 0.0);
            let half = readings.len() / 2;
            readings[half..].iter_mut().for_each(|reading| *reading = -*reading);
            found +=
                usize::from(sign_change(&readings, &groups, 1e-3).is_some_and(|change| change.row.abs_diff(half) <= 2));
        }
        // Where the noise is as large as the errors nothing tells.
        assert!(found > 1_500, "{found} of 2000");
    }
}
