//! What runs say of their own sensors and encoder: signals that are lost, other units, an encoder that slips a little in every turn.

use std::f64::consts::{PI, TAU};

use crate::readings::Run;

/// Ranges of readings that noise alone has, in its standard deviations.
const OF_NOISE: f64 = 10.0;

/// Tells of a sensor that moves by no more than its noise; `uncertainty` is that of a reading, mm.
pub fn tell_silent(run: &Run<'_>, name: &str, readings: &[f64], uncertainty: f64) {
    let [low, high] =
        readings.iter().fold([f64::MAX, f64::MIN], |[low, high], &value| [low.min(value), high.max(value)]);
    if high - low < OF_NOISE * uncertainty {
        tracing::warn!(
            "run `{}`: {name} moves by {:.3} um, which is what its noise of {:.3} um does: does it see the artefact?",
            run.label,
            (high - low) * 1e3,
            uncertainty * 1e3
        );
    }
}

/// Fewest turns of a part of a run, and its angle and size that tell.
const TURNS: usize = 2;
const CREPT: f64 = 3.0 * PI / 180.0;
const CLEAR: f64 = 3.0;

/// The fundamental of readings over whole turns, as cosine and sine of the angle.
fn fundamental(run: &Run<'_>, readings: &[f64], turns: std::ops::Range<usize>) -> [f64; 2] {
    let angle = |index: usize| (run.angles[index] - run.angles[0]).abs();
    let rows = (0..readings.len()).filter(|&index| (turns.start..turns.end).contains(&((angle(index) / TAU) as usize)));
    let rows: Vec<usize> = rows.collect();
    let mean = rows.iter().map(|&index| readings[index]).sum::<f64>() / rows.len().max(1) as f64;
    let part = |of: fn(f64) -> f64| {
        let sum: f64 = rows.iter().map(|&index| (readings[index] - mean) * of(run.angles[index])).sum();
        2.0 * sum / rows.len().max(1) as f64
    };
    [part(f64::cos), part(f64::sin)]
}

/// Tells of a fundamental that turns while the run lasts: the artefact does not turn in the spindle, the encoder slips. `rest` is the
/// RMS of what harmonics leave, mm.
pub fn tell_creeping(run: &Run<'_>, name: &str, readings: &[f64], rest: f64) {
    let quarter = run.whole_turns() / 4;
    if quarter < TURNS {
        return;
    }
    let whole = run.whole_turns();
    let [first, last] = [0..quarter, whole - quarter..whole].map(|turns| fundamental(run, readings, turns));
    let [before, after] = [first, last].map(|[cos, sin]| sin.atan2(cos));
    let crept = (after - before + PI).rem_euclid(TAU) - PI;
    let size = first[0].hypot(first[1]).min(last[0].hypot(last[1]));
    if crept.abs() > CREPT && size > CLEAR * rest {
        tracing::warn!(
            "run `{}`: the fundamental of {name} turns by {:.1} deg from the first quarter of the run to the last one: does the encoder \
             slip a little in every turn?",
            run.label,
            crept.to_degrees()
        );
    }
}

/// Most that a size of one run may be larger or smaller than the median of others.
const ALIKE: f64 = 6.0;

/// Tells of runs whose values of one kind are far from those of the others; `what` are they, by the names of runs, mm.
pub fn tell_unlike(what: &str, values: &[(String, f64)]) {
    for (place, (run, value)) in values.iter().enumerate() {
        let others = values.iter().enumerate().filter(|(other, _)| *other != place);
        let mut others: Vec<f64> = others.map(|(_, (_, value))| *value).collect();
        others.sort_by(f64::total_cmp);
        let Some(median) = others.get(others.len() / 2).filter(|_| others.len() >= 2) else { continue };
        let ratio = value / median;
        if *median > 0.0 && !(1.0 / ALIKE..ALIKE).contains(&ratio) {
            tracing::warn!(
                "run `{run}`: {what} is {:.4} um, and {:.4} um in other runs: has a sensor another range or unit here?",
                value * 1e3,
                median * 1e3
            );
        }
    }
}
