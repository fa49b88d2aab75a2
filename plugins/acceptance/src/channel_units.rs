//! One channel of several in another unit: its noise from row to row is not that of the others.

use abbe_numerics::{resolution, row_noise};

/// Fewest readings that tell.
const FEWEST: usize = 24;

/// How many times the noise of a channel is that of each other one, or each other one its own, in another unit. One direction may be read
/// better than another one, and not ten times.
const TIMES: f64 = 10.0;

/// The same of a channel that is larger: an axis may shake as much as inches are larger than millimetres, and not as micrometres are.
const TIMES_LARGER: f64 = 100.0;

/// Noise over what is stated of a reading that is about as stated, and that is far from it.
const AS_STATED: std::ops::Range<f64> = 0.3..4.0;
const FAR: f64 = 5.0;

/// A sentence on a channel in another unit: columns by name, in the order of their rows, and the standard uncertainty of a reading, both
/// in `unit`. Without an uncertainty that the noise of the others keeps to nothing is said: an axis may be rough in one direction.
///
/// Smaller readings have noise that is hidden by their digits, so that these are added.
pub fn other_unit(columns: &[(&str, &[f64])], standard_uncertainty: f64, unit: &str) -> Option<String> {
    if columns.len() < 2 || standard_uncertainty <= 0.0 || columns.iter().any(|(_, own)| own.len() < FEWEST) {
        return None;
    }
    let noises: Vec<_> = columns.iter().map(|(_, own)| row_noise(own)).collect::<Option<_>>()?;
    let ranges: Vec<f64> = columns.iter().map(|(_, own)| range(own)).collect();
    (0..columns.len()).find_map(|place| {
        let (name, readings) = columns[place];
        let others = || (0..columns.len()).filter(move |other| *other != place);
        let as_stated = |other: usize| noises[other].is_white && AS_STATED.contains(&(noises[other].size / standard_uncertainty));
        if ranges[place] == 0.0 || !others().all(as_stated) {
            return None;
        }
        let of_others = || others().map(|other| noises[other].size);
        let (least, most) = (of_others().fold(f64::MAX, f64::min), of_others().fold(0.0, f64::max));
        let (own, digits) = (noises[place], resolution(readings).unwrap_or(0.0));
        let is_small = own.size + digits < (least / TIMES).min(standard_uncertainty / FAR);
        let is_large = own.is_white && own.size > TIMES_LARGER * most;
        (is_small || is_large).then(|| {
            format!(
                "`{name}` scatters from row to row by {:.4} {unit}, the other channels by {least:.3} to {most:.3} {unit}, as stated: is the \
                 unit of this channel right?",
                own.size
            )
        })
    })
}

/// Largest less smallest reading.
pub fn range(readings: &[f64]) -> f64 {
    let ends = readings.iter().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(*value), high.max(*value)));
    (ends.1 - ends.0).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings of three sensors, µm: a rotary axis turns forwards and backwards, once or more. Errors of any size and shape in each
    /// direction, lost motion, screws and gears that shake, noise that differs up to four times, digits; and what is stated of a reading.
    fn measured(seed: u64) -> (Vec<Vec<f64>>, f64) {
        let mut random = abbe_numerics::Generator::new(seed, 0);
        let mut next = move || random.normal().clamp(-2.5, 2.5);
        let (angles, runs) = (12 + seed as usize % 30, 1 + seed as usize % 3);
        let noise = 0.3;
        let digits = [0.0, 0.001, 0.01, 0.1, 1.0][seed as usize % 5];
        let stated = noise * 2_f64.powf(0.7 * next());
        let channel = |next: &mut dyn FnMut() -> f64| {
            let own = noise * 2_f64.powf(0.4 * next());
            let size = 10_f64.powf(0.7 * next());
            let shakes = if seed.is_multiple_of(3) { 10_f64.powf(0.5 * next()) } else { 0.0 };
            let (wave, second, lost, phase) = (size * next(), 0.4 * size * next(), size * next(), next());
            let mut readings = Vec::new();
            for way in 0..2 * runs {
                for step in 0..angles {
                    let step = if way % 2 == 0 { step } else { angles - 1 - step };
                    let at = std::f64::consts::TAU * step as f64 / (angles - 1) as f64;
                    let lost = if way % 2 == 0 { lost } else { -lost };
                    let short = shakes * (23.7 * at + phase).sin();
                    let value = wave * (at + phase).sin() + second * (2.0 * at).cos() + lost + short + own * next();
                    readings.push(if digits > 0.0 { (value / digits).round() * digits } else { value });
                }
            }
            readings
        };
        ((0..3).map(|_| channel(&mut next)).collect(), stated)
    }

    fn said(columns: &[Vec<f64>], stated: f64) -> Option<String> {
        let named: Vec<(&str, &[f64])> = ["x", "y", "z"].into_iter().zip(columns.iter().map(Vec::as_slice)).collect();
        other_unit(&named, stated, "um")
    }

    #[test]
    fn channels_of_one_unit_get_no_word() {
        for seed in 0..60_000 {
            let (columns, stated) = measured(seed);
            assert_eq!(said(&columns, stated), None, "{seed}");
        }
    }

    #[test]
    fn a_channel_in_another_unit_is_named() {
        for factor in [1.0 / 25.4, 1e-3, 1e3] {
            let (mut told, mut all) = (0, 0);
            for seed in 0..600 {
                let (mut columns, stated) = measured(seed);
                let place = seed as usize % 3;
                columns[place].iter_mut().for_each(|value| *value *= factor);
                let words = format!("`{}`", ["x", "y", "z"][place]);
                let found = said(&columns, stated);
                assert!(found.as_ref().is_none_or(|found| found.starts_with(&words)), "{seed} {factor}: {found:?}");
                all += 1;
                told += usize::from(found.is_some());
            }
            assert!(3 * told > all, "{factor}: {told} of {all}");
        }
    }
}
