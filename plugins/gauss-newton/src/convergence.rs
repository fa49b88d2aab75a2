//! What is told of an iteration that does not converge.

use std::cmp::Ordering;

use abbe_core::{Convergence, Error, Problem, Result, Termination};
use abbe_estimation::ill_conditioned;
use abbe_numerics::{End, Factor, Options, Solution};

/// The solution if the iteration has converged.
pub fn converged<F>(solution: Solution<F>, options: &Options) -> Result<Solution<F>> {
    if solution.end == End::Converged { Ok(solution) } else { Err(not_converged(&solution, options)) }
}

/// The error of an iteration that ended somewhere else than at a minimum.
fn not_converged<F>(solution: &Solution<F>, options: &Options) -> Error {
    let (termination, failed) = match solution.end {
        End::Converged | End::NoProgress => {
            (Termination::NoProgress, format!("no step makes the residuals smaller{}", left_out(solution)))
        }
        End::Standing => {
            let after = format!("after {} iterations its steps no longer shrink", solution.iterations);
            (Termination::NoProgress, format!("{after}{}", left_out(solution)))
        }
        End::IterationLimit => {
            let limit = match solution.iterations.cmp(&options.iterations) {
                Ordering::Less => {
                    format!("after {} iterations, whose steps have to be cut again and again", solution.iterations)
                }
                Ordering::Equal => format!("at the limit of {} iterations", options.iterations),
                Ordering::Greater => {
                    format!("after {} iterations in all rounds of robust weights", solution.iterations)
                }
            };
            (Termination::IterationLimit, format!("it still moves {limit}"))
        }
        End::TimeLimit => {
            let after = match solution.iterations {
                1 => "after one iteration".to_owned(),
                count => format!("after {count} iterations"),
            };
            let unsettled = if solution.last_step.is_nan() { ", before robust weights had settled" } else { "" };
            (Termination::NoProgress, format!("the time limit is over {after}{unsettled}"))
        }
        End::RoundLimit => {
            (Termination::RoundLimit, format!("robust weights still change after {} rounds", options.rounds))
        }
    };
    let finite = |value: f64| value.is_finite().then_some(value);
    let convergence = Convergence {
        termination,
        iterations: solution.iterations,
        last_step: finite(solution.last_step),
        tolerance: options.tolerance,
        gradient_cosine: finite(solution.gradient_cosine),
    };
    let far = convergence.last_step.map_or_else(String::new, |step| {
        let (tolerance, cosine) = (options.tolerance, solution.gradient_cosine);
        format!(
            "; the next step would move all rows together by {step:.1e} standard uncertainties ({tolerance:.0e} is asked), the largest \
             gradient cosine is {cosine:.1e}"
        )
    });
    if solution.end == End::TimeLimit && solution.iterations == 0 {
        return Error::out_of_time("the time limit is over");
    }
    if solution.end == End::TimeLimit {
        return Error::out_of_time(format!("the iteration has not converged: {failed}{far}"));
    }
    let error = Error::data(format!("the iteration does not converge: {failed}{far}")).help(
        "check units, signs and features of the data, choose fewer parameters, `start` from a calibration, or allow more `iterations`",
    );
    error.convergence(convergence)
}

/// The condition from which what the data hardly tell may be why a fit does not converge: it moves where products of errors count.
const SUSPECT: f64 = 1e4;

/// The error of a fit that did not converge, with what the data hardly tell before the rest of its help; `factor` is where rank is
/// judged.
pub fn ill(problem: &Problem, factor: &Factor, rank_tolerance: f64, error: Error) -> Error {
    if error.convergence.is_none() {
        return error;
    }
    let Some(remark) = ill_conditioned(problem, factor, rank_tolerance, SUSPECT) else { return error };
    let help = error.help.clone().map_or(remark.clone(), |help| format!("{remark}\nelse {help}"));
    error.help(help)
}

/// How many rows robust weights have left out, where that may be why the others determine too little.
fn left_out<F>(solution: &Solution<F>) -> String {
    let weights = solution.robust.as_ref().map_or(&[][..], |report| &report.weights);
    match weights.iter().filter(|weight| **weight == 0.0).count() {
        0 => String::new(),
        count => format!(" while robust weights leave out {count} of {} equations", weights.len()),
    }
}
