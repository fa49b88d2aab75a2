//! Which inputs, and how many time constants: what predicts best what was left out.

use abbe_core::{Error, Result};

use crate::fit::{Output, Readings, Structure, fit};
use crate::fitted::Terms;
use crate::log::SensorLog;

/// A structure that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// The structure.
    pub structure: Structure,
    /// Root mean square of what it predicts wrong of readings that it was not fitted to, in units of the scatter of the largest
    /// structure.
    pub error: f64,
}

/// Parts of a single run that are left out in turn.
pub const PARTS: usize = 4;

/// Tries structures from one time constant up to those of `most`, and leaves out inputs as long as predictions do not get worse by
/// more than this part. Gives the smallest structure whose predictions are as good as the best ones up to this part, and all that
/// were tried.
///
/// What is predicted is a whole run, where there are several and states begin at zero, else a quarter of each run.
/// Fails as the fit of every structure does.
pub fn select(logs: &[SensorLog], outputs: &[Output], most: &Structure, part: f64) -> Result<(Structure, Vec<Tried>)> {
    let whole = fit(logs, outputs, most);
    let scale = |output: usize| -> f64 {
        let known = whole.as_ref().map(|whole| whole.scatter[output]).ok().filter(|scatter| *scatter > 0.0);
        known.unwrap_or(1.0)
    };
    let scales: Vec<f64> = (0..outputs.len()).map(scale).collect();
    let (mut tried, mut told): (Vec<Tried>, Option<Error>) = (Vec::new(), None);
    for time_constants in 1..=most.time_constants.max(1) {
        let mut structure = Structure { time_constants: time_constants.min(most.time_constants), ..most.clone() };
        structure.guess = None;
        let mut now = match error(logs, outputs, &structure, &scales) {
            Ok(error) => Tried { structure: structure.clone(), error },
            Err(error) => {
                told = Some(error);
                continue;
            }
        };
        tried.push(now.clone());
        while now.structure.inputs.len() > 1 {
            let without = (0..now.structure.inputs.len()).filter_map(|place| {
                let mut structure = now.structure.clone();
                structure.inputs.remove(place);
                let error = error(logs, outputs, &structure, &scales).ok()?;
                Some(Tried { structure, error })
            });
            let Some(best) = without.min_by(|one, other| one.error.total_cmp(&other.error)) else { break };
            tried.push(best.clone());
            if best.error > now.error * (1.0 + part) {
                break;
            }
            now = best;
        }
    }
    let best = tried.iter().map(|tried| tried.error).fold(f64::INFINITY, f64::min);
    let as_good = tried.iter().filter(|tried| tried.error <= best * (1.0 + part));
    let smallest = as_good.min_by_key(|tried| tried.structure.of_any_run()).map(|tried| tried.structure.clone());
    let none = || told.unwrap_or_else(|| Error::data("no structure predicts these readings"));
    Ok((smallest.ok_or_else(none)?, tried))
}

/// What a structure predicts wrong of readings that were left out.
fn error(logs: &[SensorLog], outputs: &[Output], structure: &Structure, scales: &[f64]) -> Result<f64> {
    let by_run = logs.len() > 1 && !structure.starts_warm;
    let (mut squares, mut count) = (0.0, 0);
    for fold in 0..if by_run { logs.len() } else { PARTS } {
        let is_left_out = |run: usize, time: f64| match by_run {
            true => run == fold,
            false => {
                let times = logs[run].times();
                let share = (time - times[0]) / (times[times.len() - 1] - times[0]);
                ((share * PARTS as f64) as usize).min(PARTS - 1) == fold
            }
        };
        let part = |left_out: bool| -> Vec<Output> {
            let of = |(run, readings): (usize, &Readings)| {
                let pairs = readings.times.iter().copied().zip(readings.values.iter().copied());
                let (times, values) = pairs.filter(|(time, _)| is_left_out(run, *time) == left_out).unzip();
                Readings { times, values }
            };
            let runs = |output: &Output| output.runs.iter().enumerate().map(of).collect();
            outputs.iter().map(|output| Output { runs: runs(output), ..output.clone() }).collect()
        };
        let found = fit(logs, &part(false), structure)?;
        for (place, output) in part(true).iter().enumerate() {
            for (run, (log, readings)) in logs.iter().zip(&output.runs).enumerate() {
                let terms = Terms::new(log, structure, &found.time_constants, &readings.times)?;
                let mut predicted = terms.output(&found.gains[place][..structure.of_any_run()]);
                found.add_beginnings(log, place, run, &readings.times, &mut predicted);
                for (predicted, value) in predicted.iter().zip(&readings.values) {
                    squares += ((predicted - value) / scales[place]).powi(2);
                    count += 1;
                }
            }
        }
    }
    Ok((squares / f64::from(count.max(1))).sqrt())
}
