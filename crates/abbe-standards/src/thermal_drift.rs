//! Thermal drift in the manner of ISO 230-3: environment, warm-up of a spindle, movement of axes.
//!
//! The text of the standard was not at hand. Ranges over windows and the values at their ends are those that its reports have as far
//! as is published; the time to a part of the drift follows DIN 8602 and is a choice of this project.
//!
//! Times increase, s; readings are in any unit, and as many as times.

/// The edition that the figures follow.
pub const EDITION: &str = "ISO 230-3:2020, in its manner";

/// What a range is taken over.
fn between<'a>(times: &[f64], readings: &'a [f64], from: f64, until: f64) -> &'a [f64] {
    let first = times.partition_point(|time| *time < from);
    let last = times.partition_point(|time| *time <= until);
    readings.get(first..last.min(readings.len())).unwrap_or_default()
}

/// Largest reading minus smallest one.
fn spread(readings: &[f64]) -> Option<f64> {
    let largest = readings.iter().copied().reduce(f64::max)?;
    let smallest = readings.iter().copied().reduce(f64::min)?;
    Some(largest - smallest)
}

/// The range of the readings from one time to another, both included; none if there is no reading.
///
/// ```
/// use abbe_standards::thermal_drift::range;
///
/// assert_eq!(range(&[0.0, 60.0, 120.0], &[1.0, 4.0, 2.0], 60.0, 120.0), Some(2.0));
/// ```
pub fn range(times: &[f64], readings: &[f64], from: f64, until: f64) -> Option<f64> {
    spread(between(times, readings, from, until))
}

/// The largest range within any window of this length (s); none if the readings do not last so long.
pub fn largest_range(times: &[f64], readings: &[f64], window: f64) -> Option<f64> {
    let end = *times.last()?;
    if !(window > 0.0 && end - times[0] >= window * (1.0 - 1e-9)) {
        return None;
    }
    // Monotone queues of the places of the largest and of the smallest readings: each place comes and goes once.
    let (mut high, mut low) = (std::collections::VecDeque::new(), std::collections::VecDeque::new());
    let mut largest: Option<f64> = None;
    for (place, (time, reading)) in times.iter().zip(readings).enumerate() {
        while high.back().is_some_and(|&other: &usize| readings[other] <= *reading) {
            high.pop_back();
        }
        while low.back().is_some_and(|&other: &usize| readings[other] >= *reading) {
            low.pop_back();
        }
        high.push_back(place);
        low.push_back(place);
        let begin = time - window * (1.0 + 1e-12);
        [&mut high, &mut low].into_iter().for_each(|queue| {
            while queue.front().is_some_and(|&other| times[other] < begin) {
                queue.pop_front();
            }
        });
        if let (Some(&top), Some(&bottom)) = (high.front(), low.front()) {
            let found = readings[top] - readings[bottom];
            largest = Some(largest.map_or(found, |so_far| so_far.max(found)));
        }
    }
    largest
}

/// The slope of a straight line by least squares through the readings of the last `window` seconds, readings per s; none for fewer
/// than two readings.
pub fn slope_at_end(times: &[f64], readings: &[f64], window: f64) -> Option<f64> {
    let end = *times.last()?;
    let from = times.partition_point(|time| *time < end - window * (1.0 + 1e-12));
    let (times, readings) = (&times[from..], readings.get(from..times.len())?);
    let count = times.len() as f64;
    let mean = |list: &[f64]| list.iter().sum::<f64>() / count;
    let (time, reading) = (mean(times), mean(readings));
    let pairs = || times.iter().map(|own| own - time).zip(readings.iter().map(|own| own - reading));
    let spread: f64 = pairs().map(|(time, _)| time * time).sum();
    (spread > 0.0).then(|| pairs().map(|(time, reading)| time * reading).sum::<f64>() / spread)
}

/// The time (s, from the first reading) after which readings stay within the last `1 - part` of the way from the first to the last
/// one, straight between readings: with 0.95 the time to 95 % of the drift. None for a drift of zero.
pub fn time_to_part(times: &[f64], readings: &[f64], part: f64) -> Option<f64> {
    let (first, last) = (*readings.first()?, *readings.get(times.len().checked_sub(1)?)?);
    let way = last - first;
    if way == 0.0 {
        return None;
    }
    // How far from the end, as a part of the way: 1 at the beginning, 0 at the end.
    let left = |place: usize| ((last - readings[place]) / way).abs();
    let outside = (0..times.len()).rev().find(|&place| left(place) > 1.0 - part)?;
    let (here, next) = (left(outside), (last - readings[outside + 1]) / way);
    let limit = 1.0 - part;
    // The way back in may be from either side.
    let here = here * ((last - readings[outside]) / way).signum();
    let border = limit * here.signum();
    let share = (here - border) / (here - next);
    Some(times[outside] + share * (times[outside + 1] - times[outside]) - times[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// T = 600 s, end value 10 (1 - exp(-3600/600)).
    fn warm_up() -> (Vec<f64>, Vec<f64>) {
        let times: Vec<f64> = (0..=360).map(|row| 10.0 * f64::from(row)).collect();
        let readings = times.iter().map(|time| 10.0 * (1.0 - (-time / 600.0_f64).exp())).collect();
        (times, readings)
    }

    #[test]
    fn closed_forms_of_a_warm_up() {
        let (times, readings) = warm_up();
        let end = 10.0 * (1.0 - (-6.0_f64).exp());
        assert!((range(&times, &readings, 0.0, 1e9).expect("a range") - end).abs() < 1e-12);
        let hour = range(&times, &readings, 0.0, 600.0).expect("a range");
        assert!((hour - 10.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-12);
        // The steepest ten minutes are the first ones.
        assert!((largest_range(&times, &readings, 600.0).expect("a range") - hour).abs() < 1e-12);
        assert_eq!(largest_range(&times, &readings, 3601.0), None);
        // 0.05 of the end value is left at -600 ln(1 - 0.95 (1 - exp(-6))) s.
        let expected = -600.0 * (1.0 - 0.95 * (1.0 - (-6.0_f64).exp())).ln();
        assert!((time_to_part(&times, &readings, 0.95).expect("a time") - expected).abs() < 0.05);
        let sunk: Vec<f64> = readings.iter().map(|reading| 3.0 - reading).collect();
        assert!((time_to_part(&times, &sunk, 0.95).expect("a time") - expected).abs() < 0.05);
        let straight: Vec<f64> = times.iter().map(|time| 1.0 - 0.002 * time).collect();
        assert!((slope_at_end(&times, &straight, 300.0).expect("a slope") + 0.002).abs() < 1e-15);
        assert_eq!(slope_at_end(&times, &straight, 5.0), None);
    }

    #[test]
    fn what_swings_over_comes_back_from_the_other_side() {
        // Beyond the end by a fifth, and back: 5 % above the end is reached half way between 20 and 30 s.
        let (times, readings) = ([0.0, 10.0, 20.0, 30.0, 40.0], [0.0, 1.2, 1.1, 1.0, 1.0]);
        assert!((time_to_part(&times, &readings, 0.95).expect("a time") - 25.0).abs() < 1e-12);
        assert_eq!(time_to_part(&times, &[2.0; 5], 0.95), None);
        assert_eq!(time_to_part(&[], &[], 0.95), None);
    }

    #[test]
    fn windows_agree_with_trying_all() {
        // A walk without a law: each window tried by itself.
        let mut state = 7_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / f64::from(1 << 24)
        };
        for _ in 0..200 {
            let mut times = vec![0.0];
            (0..40).for_each(|_| times.push(times[times.len() - 1] + 1.0 + 20.0 * next()));
            let readings: Vec<f64> = times.iter().map(|_| next()).collect();
            let window = 0.5 * times[40] * next();
            let each = times.iter().filter_map(|end| range(&times, &readings, end - window, *end));
            let expected = each.fold(0.0_f64, f64::max);
            assert_eq!(largest_range(&times, &readings, window), Some(expected));
        }
    }
}
