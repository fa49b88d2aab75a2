//! Estimator plugin `monte-carlo`: propagates the distributions of the inputs through another estimate (JCGM 101:2008, JCGM
//! 102:2011).
//!
//! Every trial draws the errors of all rows, the known inputs, the values that come from an earlier estimate and, on request,
//! neglected errors. The estimator of the other estimate then solves the problem in full. Trial k draws from its own stream
//! of random numbers, so that the results do not depend on the number of threads. The memory does not grow with the number of
//! trials.

mod draws;
mod in_parts;
mod lobing;
mod neglected;
mod rows;
mod settings;
mod shared;
mod solved;

use std::sync::atomic::{AtomicBool, Ordering};

use abbe_core::{
    Calibration, Context, Error, Estimate, EstimateSource, Fit, GumComparison, Identifiability, InputFile, MonteCarlo,
    NamedCovariance, Parts, Problem, Result, Samples, SettingsError, SimulatedParameter, Whole, in_parallel,
};
use abbe_numerics::{AdaptiveProcedure, Generator, Trials, compare_with_gum, least_trials, numerical_tolerance};
use serde_json::{Value, json};

use draws::Draws;
use in_parts::DrawsOfParts;
use settings::{RowDistribution, Settings};

abbe_core::register!(
    Estimate,
    "monte-carlo",
    "propagates distributions of rows and inputs through another estimate, with full fits",
    Settings,
    example,
    build,
    "../reference/estimate-monte-carlo.md",
    EstimateSource::Analysis,
);

fn example() -> Value {
    json!({
        "trials": 10000,
        "seed": 1,
        "vary": [{ "parameters": ["E?X[2]"], "distribution": "uniform", "at_end_of_travel_um": 2 }],
        "lobing": [{ "artefact": "table", "amplitude_um": 0.3 }],
    })
}

fn build(mut settings: Settings, context: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    settings.check()?;
    settings.solved = settings.solved.map(|path| context.base.join(path));
    Ok(Box::new(Propagation { settings }))
}

/// The estimator.
struct Propagation {
    settings: Settings,
}

/// Number of trials that are solved before their results are added: small enough for the memory, large enough for all
/// threads.
const CHUNK: usize = 512;

/// Largest part of the trials that may fail; with more failures the distribution is not valid.
const MAY_FAIL: f64 = 0.01;

impl Estimate for Propagation {
    fn inputs(&self) -> Vec<InputFile> {
        self.settings.solved.iter().map(|path| InputFile { setting: "solved", path: path.clone() }).collect()
    }

    fn estimate(&self, _: &Problem) -> Result<Calibration> {
        Err(of_is_missing())
    }

    fn identify(&self, _: &Problem) -> Result<Identifiability> {
        Err(of_is_missing())
    }

    fn analyse(&self, fit: &Fit) -> Result<Calibration> {
        let draws = Draws::new(&self.settings, fit)?;
        let values = fit.estimator.values_near(draws.problem());
        let trial = |number: u64| {
            let mut generator = Generator::new(self.settings.seed, number);
            draws.trial(&mut generator, &values)
        };
        let trial = Trial::OnAnyThread(&trial);
        self.of_trials(fit, &Sampled { trial, quantities: draws.quantities() }, draws.described())
    }

    fn accepts_analysis_of_parts(&self) -> Result<()> {
        match self.settings.rows {
            RowDistribution::Resampled => {
                let error = Error::usage("errors that are drawn from the residuals need all rows at once");
                Err(error.setting("rows"))
            }
            _ => Ok(()),
        }
    }

    fn analyse_parts(&self, fit: &Fit, parts: &dyn Parts) -> Result<Calibration> {
        self.accepts_analysis_of_parts()?;
        let draws = DrawsOfParts::new(&self.settings, fit, parts)?;
        let trial = |number: u64| draws.trial(number);
        let sampled = Sampled { trial: Trial::InTurn(&trial), quantities: draws.quantities() };
        self.of_trials(fit, &sampled, draws.described()?)
    }
}

/// What a trial gives, by its number.
enum Trial<'a> {
    OnAnyThread(&'a (dyn Fn(u64) -> Result<Vec<f64>> + Sync)),
    /// One after another: all threads read the parts of a trial.
    InTurn(&'a dyn Fn(u64) -> Result<Vec<f64>>),
}

/// Trials, each of which gives so many quantities.
struct Sampled<'a> {
    trial: Trial<'a>,
    quantities: usize,
}

impl Propagation {
    /// The calibration by all trials; `inputs` says what varies.
    fn of_trials(&self, fit: &Fit, sampled: &Sampled<'_>, inputs: Vec<String>) -> Result<Calibration> {
        if let Some(lost) = fit.calibration.fit.null_space.first() {
            let message = format!("`{}` does not determine all it estimates: {}", fit.name, lost.describe());
            return Err(Error::data(message).help("propagate an estimate of what the data determine").setting("of"));
        }
        fit.calibration.check_covariance_of(fit.problem.unknowns.iter().map(|unknown| unknown.name.as_str()))?;
        self.may_keep(sampled.quantities)?;
        let mut found = Found {
            trials: Trials::new(sampled.quantities),
            failed: 0,
            stable: None,
            samples: (self.settings.keep_samples || self.settings.block.is_some()).then(Vec::new),
        };
        match (&self.settings.adaptive, &self.settings.solved) {
            (None, Some(path)) => self.read(path, sampled.quantities, &mut found)?,
            (None, None) => {
                let count = self.settings.block.map_or(self.settings.trials, |block| block.count).get();
                self.solve(sampled, fit, count, &mut found, None)?;
            }
            (Some(adaptive), _) => {
                let mut stop = AdaptiveProcedure::new(
                    adaptive.digits.get() as u32,
                    self.settings.coverage_probability,
                    adaptive.most.get(),
                );
                while !stop.finished() {
                    let mut batch = Trials::new(sampled.quantities);
                    self.solve(sampled, fit, stop.batch(), &mut found, Some(&mut batch))?;
                    stop.push_batch(&batch);
                }
                found.stable = Some(stop.stable());
                if !stop.stable() {
                    tracing::warn!("{}: not stable after {} trials", fit.name, found.trials.count());
                }
            }
        }
        let samples = found.samples.take();
        let mut calibration = self.calibration(fit, inputs, &found);
        if let Some(found) = &mut calibration.monte_carlo {
            found.samples = samples.map(|values| Samples { quantities: quantities(fit), values });
        }
        Ok(calibration)
    }
}

fn of_is_missing() -> Error {
    Error::usage("`of` is missing: the estimate whose uncertainty is to be found by trials")
        .help("write `of: fit` with the name of another estimate; machine, observations and parameters are its")
}

/// The results of the trials.
struct Found {
    trials: Trials,
    failed: usize,
    stable: Option<bool>,
    /// Trials x quantities, if they are kept.
    samples: Option<Vec<f64>>,
}

/// Most values of trials that are kept: 400 MB.
const MOST_KEPT: usize = 50_000_000;

impl Propagation {
    /// Refuses to keep more values of trials than the memory has room for.
    fn may_keep(&self, quantities: usize) -> Result<()> {
        let Settings { adaptive, block, .. } = &self.settings;
        let all = adaptive.as_ref().map_or(self.settings.trials, |adaptive| adaptive.most);
        let trials = block.map_or(all, |block| block.count).get();
        let values = trials.saturating_mul(quantities);
        if !(self.settings.keep_samples || block.is_some()) || values <= MOST_KEPT {
            return Ok(());
        }
        let message =
            format!("{trials} trials of {quantities} quantities are {values} values; {MOST_KEPT} at most are kept");
        Err(Error::usage(message).help("ask for fewer trials, or leave it out").setting("keep_samples"))
    }

    /// Adds `count` trials, in the order of their numbers; ends with the first one in which the code itself fails.
    fn solve(
        &self,
        sampled: &Sampled<'_>,
        fit: &Fit,
        count: usize,
        found: &mut Found,
        mut batch: Option<&mut Trials>,
    ) -> Result<()> {
        let before = self.settings.block.map_or(0, |block| block.first.get());
        let first = before + found.trials.count() + found.failed;
        let numbers: Vec<u64> = (first as u64..(first + count) as u64).collect();
        let mut last_failure = None;
        let ended = AtomicBool::new(false);
        for chunk in numbers.chunks(CHUNK) {
            let done = found.trials.count() + found.failed;
            let all = self.settings.adaptive.is_none().then_some(self.settings.trials.get());
            fit.problem.monitor.parts_done("trials", done, all);
            // None after a fatal error.
            let unless_ended = |trial: &dyn Fn(u64) -> Result<Vec<f64>>, number: u64| {
                if ended.load(Ordering::Relaxed) {
                    return None;
                }
                let values = trial(number);
                if values.as_ref().is_err_and(|error| error.fatal) {
                    ended.store(true, Ordering::Relaxed);
                }
                Some(values)
            };
            let threads = self.settings.threads.map(Whole::get);
            let results: Vec<Option<Result<Vec<f64>>>> = match sampled.trial {
                Trial::OnAnyThread(trial) => in_parallel(chunk, threads, |&number| unless_ended(&trial, number)),
                Trial::InTurn(trial) => chunk.iter().map(|&number| unless_ended(trial, number)).collect(),
            };
            for result in results.into_iter().flatten() {
                match result {
                    Ok(values) => {
                        found.trials.push(&values);
                        if let Some(samples) = &mut found.samples {
                            samples.extend_from_slice(&values);
                        }
                        if let Some(batch) = batch.as_deref_mut() {
                            batch.push(&values);
                        }
                    }
                    Err(error) if error.fatal => return Err(error),
                    Err(error) => {
                        found.failed += 1;
                        if let (Some(samples), Some(_)) = (&mut found.samples, self.settings.block) {
                            samples.extend(std::iter::repeat_n(f64::NAN, found.trials.quantities()));
                        }
                        last_failure = Some(error);
                    }
                }
            }
        }
        match last_failure {
            // Whether too many failed is judged when all blocks are there.
            Some(_) if self.settings.block.is_some() => Ok(()),
            Some(error) if found.failed as f64 > MAY_FAIL * (first + count) as f64 => Err(Error {
                message: format!("{} of {} trials failed, the last: {}", found.failed, first + count, error.message),
                ..error
            }),
            _ => Ok(()),
        }
    }

    fn calibration(&self, fit: &Fit, inputs: Vec<String>, found: &Found) -> Calibration {
        let trials = &found.trials;
        let probability = self.settings.coverage_probability;
        let (mean, covariance) = (trials.mean(), trials.covariance());
        let mut calibration = fit.calibration.clone();
        let unknowns = &fit.problem.unknowns;
        let order: Vec<String> =
            unknowns.iter().chain(&fit.problem.considered.unknowns).map(|unknown| unknown.name.clone()).collect();
        for (index, name) in order.iter().enumerate().take(unknowns.len()) {
            let values = calibration.parameters.iter_mut().chain(&mut calibration.artefacts);
            values
                .filter(|estimated| estimated.name == *name)
                .for_each(|estimated| estimated.standard_uncertainty = covariance[index][index].sqrt());
        }
        let parameters = unknowns.iter().enumerate().map(|(index, unknown)| {
            let estimate = calibration.get(&unknown.name).map_or(f64::NAN, |estimated| estimated.value);
            let symmetric = trials.symmetric_interval(index, probability);
            let shortest = trials.shortest_interval(index, probability);
            let standard_uncertainty = covariance[index][index].sqrt();
            let budget = fit.calibration.uncertainty.as_ref();
            let budget = budget.and_then(|budget| budget.parameters.iter().find(|part| part.name == unknown.name));
            let degrees_of_freedom = budget.and_then(|budget| budget.degrees_of_freedom);
            let gum = budget.map(|budget| {
                let expanded = budget.expanded_uncertainty;
                let tolerance = numerical_tolerance(standard_uncertainty, self.settings.digits.get() as u32);
                let agreement = compare_with_gum(estimate, expanded, symmetric, tolerance);
                GumComparison {
                    interval: [estimate - expanded, estimate + expanded],
                    differences: [agreement.low_difference, agreement.high_difference],
                    tolerance,
                    validated: agreement.agrees,
                }
            });
            SimulatedParameter {
                name: unknown.name.clone(),
                unit: unknown.unit.to_string(),
                mean: mean[index],
                standard_uncertainty,
                degrees_of_freedom,
                symmetric_interval: [symmetric.low, symmetric.high],
                shortest_interval: [shortest.low, shortest.high],
                gum,
            }
        });
        calibration.monte_carlo = Some(MonteCarlo {
            trials: trials.count(),
            seed: self.settings.seed,
            stable: found.stable,
            failed: found.failed,
            coverage_probability: probability,
            inputs,
            parameters: parameters.collect(),
            samples: None,
        });
        let before = std::mem::replace(&mut calibration.covariance, NamedCovariance { order, rows: covariance });
        fit.problem.untie(&mut calibration);
        for input in calibration.inputs.iter_mut().flatten() {
            let place = |name: &String| before.order.iter().position(|other| other == name);
            let of_name = |name: &String| place(name).map_or(0.0, |place| input.sensitivities[place]);
            input.sensitivities = calibration.covariance.order.iter().map(of_name).collect();
        }
        calibration.uncertainty = None;
        calibration
    }
}

/// Names and units of what a trial gives, in its order.
fn quantities(fit: &Fit) -> Vec<(String, String)> {
    let all = fit.problem.unknowns.iter().chain(&fit.problem.considered.unknowns);
    all.map(|unknown| (unknown.name.clone(), unknown.unit.to_string())).collect()
}

/// Refuses a number of trials that cannot tell an interval of that probability.
fn enough(trials: usize, probability: f64) -> Result<(), String> {
    let least = least_trials(probability);
    if trials >= least {
        return Ok(());
    }
    Err(format!(
        "{trials} trials are too few for intervals of probability {probability}: at least {least} are needed (JCGM 101, 7.9.4)"
    ))
}

#[cfg(test)]
mod tests;
