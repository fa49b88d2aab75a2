//! Estimator plugin `sequential`: few new rows update what an earlier calibration knows.
//!
//! The states z are the unknowns, and what is considered of the earlier estimate. Their earlier values m are off by noise of the
//! covariance R, and by `S u` with the errors u of known inputs. New rows r(z) are added:
//!
//! `z = argmin (z - m)^T R^-1 (z - m) + r(z)^T W r(z)`
//!
//! As in every estimate inputs determine no weights; they are propagated, each once, with its sensitivities in m and in the
//! rows. For linear problems this is the estimate from old and new rows at once. Considered states keep their values: the
//! gain of the unknowns is that of Schmidt (1966).

mod innovation;
mod knowledge;
mod settings;
mod stack;

use std::collections::BTreeMap;

use abbe_core::{
    Calibration, Context, Error, Estimate, FitReport, Identifiability, Problem, Quantity, Result, SetIndex,
    SettingsError, Termination,
};
use abbe_estimation::{Judgement, Weighted, calibration, confounded, identifiability, radial_rms, separated};
use abbe_numerics::{Accumulator, End, Factor, Options, Solution, solve_from};
use nalgebra::DMatrix;
use serde_json::{Value, json};

use innovation::Innovation;
use knowledge::{Knowledge, States};
use settings::{OnDisagreement, Settings};
use stack::Stack;

abbe_core::register!(
    Estimate,
    "sequential",
    "few new rows update what an earlier calibration knows, and say whether it still holds",
    Settings,
    example,
    build,
    "../reference/estimate-sequential.md",
);

fn example() -> Value {
    json!({ "significance": 0.01, "on_disagreement": "warn" })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    settings.check()?;
    Ok(Box::new(Sequential { settings }))
}

/// The estimator.
struct Sequential {
    settings: Settings,
}

/// Probability of a chi-squared below the one found under which the new rows agree too well, and the part of what is stated below which
/// data are exact.
const TOO_WELL: f64 = 1e-5;
const EXACT: f64 = 1e-6;

impl Sequential {
    /// What the rows of a problem tell, with what is known, before anything is solved; unknowns are the wanted ones alone.
    fn judge(&self, stack: &Stack<'_>) -> Result<Identifiability> {
        let (states, more) = (&stack.states.problem, stack.states.considered.len());
        let judged = Judgement::new(states, None)?;
        let factor = stack.with_known(judged.factor());
        let mut found = identifiability(states, &factor, self.settings.rank_tolerance);
        found.observations = judged.factor().rows();
        found.rank = found.rank.saturating_sub(more);
        found.unknowns -= more;
        Ok(found)
    }

    fn solve(&self, stack: &Stack<'_>) -> Result<Solution> {
        let solution = solve_from(stack, &stack.states.problem.start(), None, &Options::USUAL)?;
        match solution.end {
            End::Converged => Ok(solution),
            _ => Err(Error::data(format!(
                "the iteration does not converge after {} steps; the next one is of {:.1e} standard uncertainties of all rows",
                solution.iterations, solution.last_step
            ))
                .help("the new rows may be far from what is known: estimate them by `gauss-newton` alone first")),
        }
    }

    fn judge_innovation(&self, problem: &Problem, innovation: &Innovation) -> Result<()> {
        let found = &innovation.agreement;
        if found.probability >= self.settings.significance {
            // Uncertainties that are far too large hide any disagreement.
            let scatter = (found.chi_squared / found.degrees_of_freedom.max(1) as f64).sqrt();
            if found.degrees_of_freedom > 0 && 1.0 - found.probability < TOO_WELL && scatter > EXACT {
                tracing::warn!(
                    "{}: the new rows are off what is known by {scatter:.1e} of what their uncertainties say (chi-squared {:.1e} with {} \
                     degrees of freedom): are these uncertainties in the unit of their keys? They would hide any change",
                    problem.name,
                    found.chi_squared,
                    found.degrees_of_freedom
                );
            }
            return Ok(());
        }
        let mut message = format!(
            "the new rows do not agree with what is known: chi-squared {:.1} with {} degrees of freedom, probability {:.1e}",
            found.chi_squared, found.degrees_of_freedom, found.probability
        );
        if let Some(suspect) = &innovation.suspect {
            let freedom = found.degrees_of_freedom.saturating_sub(1);
            let what = if suspect.is_known { "had changed" } else { "were wrong" };
            message += &format!("; if {} alone {what}, it were {:.1} with {freedom}", suspect.name, suspect.without);
        }
        match self.settings.on_disagreement {
            OnDisagreement::Error => Err(Error::data(message).help(
                "the model of then no longer holds, or a row is wrong: measure the whole machine again, say by `changed` what \
                 may have changed since, or write `on_disagreement: warn`",
            )),
            OnDisagreement::Warn => {
                tracing::warn!("{}: {message}", problem.name);
                Ok(())
            }
        }
    }

    fn update(&self, problem: &Problem) -> Result<Calibration> {
        refuse_repeats(problem)?;
        let states = States::new(problem);
        let knowledge = Knowledge::new(&states, &self.settings.changed)?;
        let stack = Stack::new(&states, knowledge.as_ref())?;
        let found = self.judge(&stack)?;
        if found.rank < found.unknowns {
            return Err(confounded(&separated(problem, found)));
        }
        let solution = self.solve(&stack)?;
        let innovation = Innovation::new(&stack, &solution.x)?;
        self.judge_innovation(problem, &innovation)?;
        let x = &solution.x[..states.wanted];
        let covariance = covariance(&stack, &solution.x)?;
        let report = self.report(problem, &solution, innovation, found.condition)?;
        Ok(calibration(problem, x, covariance, Vec::new(), report))
    }

    fn report(
        &self,
        problem: &Problem,
        solution: &Solution,
        innovation: Innovation,
        condition: f64,
    ) -> Result<FitReport> {
        let residuals = problem.residuals(&solution.x[..problem.unknowns.len()])?;
        let rows = residuals.iter().zip(problem.quantities()).zip(problem.constraints());
        let measured: Vec<(f64, Quantity)> =
            rows.filter(|(_, constraint)| !constraint).map(|((residual, quantity), _)| (*residual, quantity)).collect();
        let of = |angles: bool| -> Vec<f64> {
            measured.iter().filter(|row| (row.1 == Quantity::Angle) == angles).map(|row| row.0.abs() * 1e3).collect()
        };
        let max = |all: &[f64]| all.iter().copied().fold(0.0, f64::max);
        let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len().max(1) as f64;
        let rms = |all: &[f64]| mean(&all.iter().map(|value| value * value).collect::<Vec<_>>()).sqrt();
        let (lengths, angles) = (of(false), of(true).iter().map(|value| value * 1e3).collect::<Vec<_>>());
        let told = |value: f64| (!angles.is_empty()).then_some(value);
        let agreement = innovation.agreement;
        let freedom = agreement.degrees_of_freedom;
        Ok(FitReport {
            observations: residuals.len(),
            condition,
            degrees_of_freedom: freedom,
            sigma: if freedom > 0 { (agreement.chi_squared / freedom as f64).sqrt() } else { 1.0 },
            iterations: solution.iterations,
            termination: Termination::Converged,
            last_step: Some(solution.last_step),
            gradient_cosine: Some(solution.gradient_cosine),
            residual_max_um: max(&lengths),
            residual_mean_abs_um: mean(&lengths),
            residual_rms_um: rms(&lengths),
            residual_radial_rms_um: radial_rms(problem, &residuals, |_| true).map(|rms| rms * 1e3),
            residual_max_urad: told(max(&angles)),
            residual_mean_abs_urad: told(mean(&angles)),
            residual_rms_urad: told(rms(&angles)),
            rank_tolerance: Some(self.settings.rank_tolerance),
            agreement: Some(agreement),
            known_degrees_of_freedom: BTreeMap::new(),
            remarks: Vec::new(),
            ..FitReport::without_rows(problem.unknowns.len())
        })
    }
}

/// Rows whose scatter is that of repeats have no weights of their own.
fn refuse_repeats(problem: &Problem) -> Result<()> {
    match problem.repeated_together().iter().flat_map(|together| &together.sets).next() {
        None => Ok(()),
        Some(&SetIndex(set)) => {
            let message = format!(
                "`{}` takes its scatter from repeats, which is not known to this estimator",
                problem.sets[set].name
            );
            Err(Error::usage(message).help("state the uncertainty of its rows, and leave out `pooled`"))
        }
    }
}

/// The covariance of the wanted states, then of all that is considered.
///
/// Noise: `N^-1 A^T A N^-1` with the rows A that scatter. Inputs: `G = -N^-1 J^T K` of all rows. The noise of a considered state,
/// which keeps its earlier value, is that of the earlier estimate; its covariance with the wanted states is that of `N^-1`.
fn covariance(stack: &Stack<'_>, z: &[f64]) -> Result<Vec<Vec<f64>>> {
    let (count, States { wanted, considered, inputs, problem }) = (z.len(), stack.states);
    let wanted = *wanted;
    let width = count + inputs.len();
    let (mut all, mut scattering) = (Accumulator::new(width, 0), Accumulator::new(count, 0));
    stack.each_row(z, |residual, line, scatters| {
        all.push(line, residual, 1.0);
        scattering.push(&line[..count], 0.0, f64::from(scatters));
    })?;
    let extended: Factor = all.finish();
    let root = extended.without_unknowns(|unknown| unknown >= count).covariance_root(count);
    let (noise, whole) = (root.part(&scattering.finish()), root.covariance());
    let answers = if inputs.is_empty() { vec![Vec::new(); count] } else { root.sensitivities(&extended) };
    let known = &problem.considered.covariance;
    let size = wanted + known.len();
    let mut covariance = DMatrix::from_fn(size, size, |row, column| match (row < wanted, column < wanted) {
        (true, true) => noise[row][column],
        (false, false) => known[row - wanted][column - wanted],
        _ => 0.0,
    });
    for (input, &(place, uncertainty)) in inputs.iter().enumerate() {
        let variance = uncertainty.powi(2);
        for row in 0..wanted {
            for column in 0..wanted {
                covariance[(row, column)] += answers[row][input] * variance * answers[column][input];
            }
            // What is considered depends on inputs by itself: by its covariance with them.
            for (other, line) in known.iter().enumerate() {
                covariance[(row, wanted + other)] += answers[row][input] * line[place];
            }
        }
    }
    for (state, &place) in considered.iter().enumerate() {
        for row in 0..wanted {
            covariance[(row, wanted + place)] += whole[row][wanted + state];
        }
    }
    let entry = |row: usize, column: usize| covariance[(row.min(column), row.max(column))];
    Ok((0..size).map(|row| (0..size).map(|column| entry(row, column)).collect()).collect())
}

impl Estimate for Sequential {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        self.update(problem)
    }

    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        let states = States::new(problem);
        let knowledge = Knowledge::new(&states, &self.settings.changed)?;
        let mut x = self.solve(&Stack::new(&states, knowledge.as_ref())?)?.x;
        x.truncate(states.wanted);
        Ok(x)
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        refuse_repeats(problem)?;
        Weighted::new(problem)?;
        let states = States::new(problem);
        let knowledge = Knowledge::new(&states, &self.settings.changed)?;
        let mut found = self.judge(&Stack::new(&states, knowledge.as_ref())?)?;
        if knowledge.is_none() {
            // What these rows cannot tell apart by themselves is long, and no fault.
            found.null_space.clear();
            found.remarks.push(
                "that is what the new rows tell by themselves; what `known` tells is added when the recipe runs"
                    .to_owned(),
            );
        }
        Ok(found)
    }

    fn counts_priors(&self) -> bool {
        true
    }

    /// Whether the new rows alone determine all says little: what is known is not there before the recipe runs.
    fn accepts(&self, _: &Identifiability) -> Result<bool> {
        Ok(true)
    }
}

#[cfg(test)]
mod tests;
