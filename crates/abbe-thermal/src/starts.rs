//! First guesses of time constants.

use crate::log::SensorLog;

/// Sets of time constants, s, spread over what the longest log can tell, shortest first: between its sampling and its length.
pub(crate) fn starts(logs: &[SensorLog], count: usize) -> Vec<Vec<f64>> {
    let length = |log: &&SensorLog| log.times()[log.times().len() - 1] - log.times()[0];
    let longest = logs.iter().max_by(|one, other| length(one).total_cmp(&length(other)));
    let times = longest.map_or(&[0.0, 1.0][..], SensorLog::times);
    let span = times[times.len() - 1] - times[0];
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let sampling = steps[steps.len() / 2];
    let ends = [(2.0 * sampling, span / 3.0), (5.0 * sampling, span / 10.0), (sampling, span)];
    let spread = |(from, to): (f64, f64)| -> Vec<f64> {
        let to = to.max(2.0 * from);
        let part = |index: usize| (index as f64 + 0.5) / count as f64;
        (0..count).map(|index| from * (to / from).powf(part(index))).collect()
    };
    ends.into_iter().map(spread).collect()
}
