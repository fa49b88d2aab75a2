//! Gauss-Newton iteration with step control, optionally robust.

use crate::accumulate::Accumulator;
use crate::descent::{Descent, Steps};
use crate::factor::Factor;
use crate::reweighting::solve_robust;
use crate::robust::{Robust, RobustReport};

/// Function that receives rows: index of the first row, residuals, derivatives row by row.
pub type Sink<'a> = &'a mut dyn FnMut(usize, &[f64], &[f64]);

/// A least squares problem in weighted residuals. Rows come in blocks, each row once, always in the same order.
pub trait LeastSquares {
    /// Error of an evaluation.
    type Error;

    /// Whether no evaluation is possible after this error. Any other error means that these values cannot be evaluated, such
    /// as a mechanism that does not close; a step to such values is shortened.
    fn is_final(&self, _: &Self::Error) -> bool {
        false
    }

    /// Whether this error says that the time is over: the iteration then ends with its last iterate ([`End::TimeLimit`]).
    fn is_out_of_time(&self, _: &Self::Error) -> bool {
        false
    }

    /// Whether a row keeps its weight for any residual and is left out of the scale of the residuals: a constraint, which is
    /// known and not measured.
    fn keeps_weight(&self, _row: usize) -> bool {
        false
    }

    /// Called when an iteration has taken its `iteration`-th step. `size` is the change of all rows together, in standard
    /// uncertainties.
    fn has_stepped(&self, _iteration: usize, _size: f64) {}

    /// Number of unknowns.
    fn unknowns(&self) -> usize;

    /// Number of rows.
    fn rows(&self) -> usize;

    /// Calls `sink` with (first row, residuals, derivatives row by row) for all rows, both divided by the standard
    /// uncertainty of the row.
    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), Self::Error>;

    /// The gradient `J^T r` of all rows at x.
    fn gradient(&self, x: &[f64]) -> Result<Vec<f64>, Self::Error> {
        let unknowns = self.unknowns();
        let mut gradient = vec![0.0; unknowns];
        self.linearise(x, &mut |_, residuals, derivatives| {
            for (line, residual) in derivatives.chunks_exact(unknowns.max(1)).zip(residuals) {
                gradient.iter_mut().zip(line).for_each(|(sum, derivative)| *sum += derivative * residual);
            }
        })?;
        Ok(gradient)
    }

    /// The factor of all rows at x, which lies next to the place of a factor that is known: its triangle, with the gradient and the cost
    /// at x ([`Factor::with_gradient`]). None where this takes as long as [`factor`](Self::factor).
    fn factor_near(&self, _x: &[f64], _known: &Factor) -> Result<Option<Factor>, Self::Error> {
        Ok(None)
    }

    /// The factor of all rows at x with these statistical weights (all 1 if there are none).
    ///
    /// A problem whose rows depend on few of its unknowns may be faster than [`linearise`](Self::linearise) is: it gives them to
    /// [`Accumulator::push_some`].
    fn factor(&self, x: &[f64], weights: Option<&[f64]>) -> Result<Factor, Self::Error> {
        let unknowns = self.unknowns();
        let mut accumulator = Accumulator::new(unknowns, self.rows());
        self.linearise(x, &mut |first, residuals, derivatives| {
            for (row, residual) in residuals.iter().enumerate() {
                let weight = weights.map_or(1.0, |weights| weights[first + row].sqrt());
                accumulator.push(&derivatives[row * unknowns..(row + 1) * unknowns], *residual, weight);
            }
        })?;
        Ok(accumulator.finish())
    }
}

/// Settings of the iteration, and the rule of convergence.
///
/// The size of a step is `|J dx|`, the change of all rows together in standard uncertainties. A step is the last one if
///
/// 1. its size is at most `tolerance`, and the estimate of the next item does not show a larger remaining error; or
/// 2. it is below `rounding` and the estimated remaining error after it is at most `tolerance`. The estimate is
///    `size q / (1 - q)`: steps go on shrinking as the last full steps did, where q is the larger of the last two ratios of
///    successive sizes. There is none for the first two steps; or
/// 3. it is below `rounding` and not smaller than the smallest before it, or no part of it makes the sum of squares smaller:
///    the step is only rounding. Steps of a slow iteration still shrink; or
/// 4. it is below 1e-6, and steps have been cut again and again: the sum of squares bends more than the linearised problem says, so
///    that steps go too far and less than the last one is left; or
/// 5. it is the last one that is allowed and below 1e-6, and so is the estimated remaining error after it, or the step was cut:
///    the iteration is slow, and what is left is nothing to the uncertainty.
///
/// Robust weights have settled when none changes by more than `settled`. Until then the tolerance is `rounding`, if that is
/// larger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Most iterations.
    pub iterations: usize,
    /// Largest remaining error of the estimate when the iteration ends, in standard uncertainties of all rows together.
    pub tolerance: f64,
    /// Steps above this are never treated as rounding, and rule 2 does not end the iteration after them.
    pub rounding: f64,
    /// Largest change of robust weights that have settled. A further round changes an estimate by about this part of its
    /// uncertainty at most.
    pub settled: f64,
    /// Most rounds of robust weights: they settle slowly where a row is about to be left out.
    pub rounds: usize,
    /// Robust weights.
    pub robust: Option<Robust>,
    /// The start is almost the solution: robust weights are computed from there at once, without the first phases for a
    /// distant start.
    pub near: bool,
}

impl Options {
    /// As is right for most problems: 200 iterations to 1e-9 standard uncertainties, without robust weights.
    pub const USUAL: Self = Self {
        iterations: 200,
        tolerance: 1e-9,
        rounding: 1e-3,
        settled: 1e-4,
        rounds: 200,
        robust: None,
        near: false,
    };
}

/// How the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// A step was the last one by the rule of [`Options`].
    Converged,
    /// No step along the direction of descent made the residuals smaller.
    NoProgress,
    /// Steps hardly shrank, and would not have been small at the limit of iterations.
    Standing,
    /// The limit of iterations was reached.
    IterationLimit,
    /// The limit of rounds of robust weights was reached, and the weights still change.
    RoundLimit,
    /// The time was over ([`LeastSquares::is_out_of_time`]).
    TimeLimit,
}

/// The last iterate, for any kind of end.
#[derive(Debug, Clone)]
pub struct Solution<F = Factor> {
    /// The unknowns.
    pub x: Vec<f64>,
    /// Iterations done.
    pub iterations: usize,
    /// How it ended.
    pub end: End,
    /// Size of the last step; if the iteration has not converged, of the next step.
    pub last_step: f64,
    /// Largest cosine of the angle between the residuals and a column of the derivatives, where the last step was computed.
    pub gradient_cosine: f64,
    /// Weights and studentised residuals of a robust estimate.
    pub robust: Option<RobustReport>,
    /// The factor of the weighted rows at x, or one small step before it.
    pub factor: F,
}

/// Minimises the sum of squares from `start`; see [`Options`].
///
/// Every step is that of the linearised problem, columns scaled, and is halved while it does not make the sum of squares smaller, or leads
/// to where nothing can be evaluated. Where the sum changes by less than its rounding, what is left has to become smaller. Steps after one below 1e-5 take the triangle from before it where that is faster.
///
/// Fails if the start cannot be evaluated. Fails with the last error if no part of a step can be evaluated, and at once with
/// an error that is final ([`LeastSquares::is_final`]), unless the time is over and there is an iterate.
pub fn solve<P: LeastSquares + ?Sized>(problem: &P, start: &[f64], options: &Options) -> Result<Solution, P::Error> {
    solve_from(problem, start, None, options)
}

/// Like [`solve`], with the factor of the rows at the start (all with weight 1) if it is known already.
pub fn solve_from<P: LeastSquares + ?Sized>(
    problem: &P,
    start: &[f64],
    factor: Option<Factor>,
    options: &Options,
) -> Result<Solution, P::Error> {
    solve_after(problem, start, factor, Before::default(), options)
}

/// Like [`solve_from`], after some steps that led to the start.
pub(crate) fn solve_after<P: LeastSquares + ?Sized>(
    problem: &P,
    start: &[f64],
    factor: Option<Factor>,
    before: Before,
    options: &Options,
) -> Result<Solution, P::Error> {
    let factor = match factor {
        Some(factor) => factor,
        None => problem.factor(start, None)?,
    };
    let minimum = match (options.robust, options.near) {
        (Some(_), true) => Minimum { x: start.to_vec(), end: End::Converged, iterations: 0, last_step: 0.0, factor },
        _ => minimise_after(problem, start.to_vec(), factor, before, (None, options))?,
    };
    match options.robust {
        None => Ok(minimum.solution(None)),
        Some(robust) => solve_robust(problem, minimum, robust, options),
    }
}

/// Smallest part of a step that is tried.
const LEAST_PART: f64 = 1e-6;

/// Where an iteration ended, with the factor of its rows.
#[derive(Debug, Clone)]
pub(crate) struct Minimum<F = Factor> {
    /// The unknowns.
    pub x: Vec<f64>,
    /// How it ended.
    pub end: End,
    /// Iterations done.
    pub iterations: usize,
    /// Size of the last step; if the iteration has not converged, of the next step.
    pub last_step: f64,
    /// The factor at x, or one small step before it.
    pub factor: F,
}

impl<F: Steps> Minimum<F> {
    pub(crate) fn solution(self, robust: Option<RobustReport>) -> Solution<F> {
        Solution {
            x: self.x,
            iterations: self.iterations,
            end: self.end,
            last_step: self.last_step,
            gradient_cosine: self.factor.gradient_cosine(),
            robust,
            factor: self.factor,
        }
    }
}

/// The step of the linearised problem, and by how many standard uncertainties it moves all rows together; None if it has none.
pub(crate) fn step_of(factor: &impl Steps) -> Option<(Vec<f64>, f64)> {
    let step = factor.step()?;
    let size = factor.row_norm(&step);
    size.is_finite().then_some((step, size))
}

/// Size of a step, in standard uncertainties of all rows together, that changes nothing of what their triangle tells: steps after it take
/// the triangle from before it.
pub(crate) const SAME_TRIANGLE: f64 = 1e-5;

/// The steps before an iteration.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Before {
    /// Size of the last one if it was a full one.
    pub last: Option<f64>,
    /// Its ratio to the one before.
    pub ratio: Option<f64>,
}

pub(crate) fn minimise<P: Descent + ?Sized>(
    problem: &P,
    x: Vec<f64>,
    factor: P::Factor,
    weights: Option<&[f64]>,
    options: &Options,
) -> Result<Minimum<P::Factor>, P::Error> {
    minimise_after(problem, x, factor, Before::default(), (weights, options))
}

fn minimise_after<P: Descent + ?Sized>(
    problem: &P,
    mut x: Vec<f64>,
    mut factor: P::Factor,
    Before { mut last, ratio: mut last_ratio }: Before,
    (weights, options): (Option<&[f64]>, &Options),
) -> Result<Minimum<P::Factor>, P::Error> {
    let mut smallest = f64::INFINITY;
    let (mut trials, mut standing) = (0, Standing { before: last, count: 0 });
    for iterations in 1..=options.iterations {
        let Some((step, size)) = step_of(&factor) else {
            return Ok(Minimum { x, end: End::NoProgress, iterations, last_step: f64::NAN, factor });
        };
        let small = size < options.rounding;
        let ratio = last.map(|last: f64| size / last);
        // A ratio can be small by chance, or because of one fast direction. So the larger of two ratios is used.
        let slower = ratio.zip(last_ratio).map(|(one, other): (f64, f64)| one.max(other));
        let left = slower.filter(|ratio| *ratio < 1.0).map(|ratio| remaining(size, ratio));
        let (near, far) =
            (left.is_some_and(|left| left <= options.tolerance), left.is_some_and(|left| left > options.tolerance));
        if (size <= options.tolerance && !far) || (small && (near || size >= smallest)) {
            add(&mut x, &step, 1.0);
            return Ok(Minimum { x, end: End::Converged, iterations, last_step: size, factor });
        }
        smallest = smallest.min(size);
        let keeps = weights.is_none() && size <= SAME_TRIANGLE;
        let lower = match downhill(problem, (&x, &step, size, smallest), (&factor, keeps), weights) {
            Err(error) if problem.is_late(&error) => {
                return Ok(Minimum { x, end: End::TimeLimit, iterations: iterations - 1, last_step: size, factor });
            }
            lower => lower?,
        };
        match lower {
            Some(lower) => {
                problem.stepped(iterations, size * lower.part);
                trials += lower.trials;
                if trials > TRIALS * options.iterations {
                    // Steps that are cut go too far: less than the last one is left.
                    let end = if size <= CUT { End::Converged } else { End::IterationLimit };
                    return Ok(Minimum { x: lower.x, end, iterations, last_step: size, factor: lower.factor });
                }
                let whole = lower.part == 1.0;
                let gained = factor.cost() - lower.factor.cost();
                if standing.after((size, whole), gained, (options.iterations - iterations, options.tolerance)) {
                    let end = if size <= CUT { End::Converged } else { End::Standing };
                    return Ok(Minimum { x: lower.x, end, iterations, last_step: size, factor: lower.factor });
                }
                (x, factor) = (lower.x, lower.factor);
                last = whole.then_some(size);
                last_ratio = ratio.filter(|_| whole);
            }
            None => {
                // No part of the step makes the sum smaller: the minimum within rounding, or the model is not smooth here.
                let end = if small { End::Converged } else { End::NoProgress };
                return Ok(Minimum { x, end, iterations, last_step: size, factor });
            }
        }
    }
    let next = step_of(&factor).map_or(f64::NAN, |(_, size)| size);
    let left = match (last, last_ratio) {
        (None, _) => next,
        (Some(last), Some(other)) => remaining(next, other.max(next / last)),
        (Some(_), None) => f64::INFINITY,
    };
    let end = if next <= CUT && left <= CUT { End::Converged } else { End::IterationLimit };
    Ok(Minimum { x, end, iterations: options.iterations, last_step: next, factor })
}

/// So many steps, one after the other, that shrink by less than a hundredth each lead nowhere: rounding, or what the rows hardly tell, makes
/// each of them anew, whether it is cut or not.
const STANDING: usize = 5;
const HARDLY: f64 = 0.99;

/// Steps of more than a standard uncertainty may yet find a way if they lower the sum of squares by this part of what whole ones promise:
/// whole ones, and those that are cut.
const KEPT: f64 = 0.5;
const KEPT_OF_CUT: f64 = 1e-4;

/// Steps that hardly shrink.
struct Standing {
    before: Option<f64>,
    count: usize,
}

impl Standing {
    /// Whether steps stand after one of this size, cut or whole, that lowered the sum of squares by `gained`: they hardly shrink, and
    /// would not be within the tolerance after the iterations that are left.
    fn after(&mut self, (size, whole): (f64, bool), gained: f64, (left, tolerance): (usize, f64)) -> bool {
        let kept = if whole { KEPT } else { KEPT_OF_CUT };
        let may_lead = size > 1.0 && gained >= kept * size * size;
        let ratio = self.before.replace(size).map(|before| size / before).filter(|_| !may_lead);
        let stands = ratio.is_some_and(|ratio| ratio > HARDLY && size * ratio.powi(left as i32) > tolerance);
        self.count = if stands { self.count + 1 } else { 0 };
        self.count == STANDING
    }
}

/// What is left after a step of this size if steps go on shrinking by this ratio.
fn remaining(size: f64, ratio: f64) -> f64 {
    if ratio < 1.0 { size * ratio / (1.0 - ratio) } else { f64::INFINITY }
}

/// End point of a part of a step that does not make the sum of squares larger.
struct Lower<F> {
    x: Vec<f64>,
    factor: F,
    /// The part of the step.
    part: f64,
    /// How many parts were tried.
    trials: usize,
}

/// Parts of steps that are tried for each iteration that is allowed, on average: a step that has to be cut again and again leads nowhere.
const TRIALS: usize = 3;

/// Size of steps, in standard uncertainties of all rows together, below which it does not matter that they have to be cut or
/// that the iteration is slow.
const CUT: f64 = 1e-6;

/// Part of a sum of squares by which its rounding may raise it: positions of metres in units of a tenth of a micrometre have seven digits
/// before the point, and residuals nine behind it.
const ROUNDING_OF_COST: f64 = 1e-9;

/// Whether a place with this factor is lower than one with this sum of squares. Small steps change the sum by less than its rounding:
/// there it is lower if less than half of the smallest step so far is left, so that no steps lead round in a circle or hardly shrink.
fn is_lower(factor: &impl Steps, cost: f64, smallest: f64) -> bool {
    let left_is_smaller = || step_of(factor).is_some_and(|(_, left)| left < 0.5 * smallest);
    factor.cost() - cost <= 1e-12 * cost + f64::MIN_POSITIVE || (is_same(factor, cost) && left_is_smaller())
}

/// Whether the sums of squares of two places differ by no more than rounding, or are nothing: of exact data they are all rounding.
fn is_same(factor: &impl Steps, cost: f64) -> bool {
    factor.cost() - cost <= ROUNDING_OF_COST * cost + CUT * CUT
}

/// The first of a step of some size from x, its half, its quarter and so on that leads to a place that [`is_lower`], with the factor
/// there and the part that it is; None if no part does. With `keeps`, the whole step may keep the triangle of `factor`.
fn downhill<P: Descent + ?Sized>(
    problem: &P,
    (x, step, size, smallest): (&[f64], &[f64], f64, f64),
    (factor, keeps): (&P::Factor, bool),
    weights: Option<&[f64]>,
) -> Result<Option<Lower<P::Factor>>, P::Error> {
    let (mut evaluated, mut refused, mut part, mut trials) = (false, None, 1.0, 0);
    let cost = factor.cost();
    if keeps {
        let mut whole = x.to_vec();
        add(&mut whole, step, part);
        match problem.near(&whole, factor) {
            Ok(Some(near)) if is_lower(&near, cost, smallest) => {
                return Ok(Some(Lower { x: whole, factor: near, part, trials: 1 }));
            }
            // Nothing is left but rounding.
            Ok(Some(near)) if size <= CUT && is_same(&near, cost) => return Ok(None),
            Err(error) if problem.has_no_more(&error) => return Err(error),
            Ok(_) | Err(_) => {}
        }
    }
    while part >= LEAST_PART {
        let mut trial = x.to_vec();
        trials += 1;
        add(&mut trial, step, part);
        match problem.factor_at(&trial, weights) {
            Ok(factor) => {
                evaluated = true;
                let differentiable = factor.norms().iter().all(|norm| norm.is_finite());
                if differentiable && is_lower(&factor, cost, smallest) {
                    return Ok(Some(Lower { x: trial, factor, part, trials }));
                }
                // Nothing is left but rounding: no part of the step is better.
                if differentiable && size <= CUT && is_same(&factor, cost) {
                    return Ok(None);
                }
            }
            Err(error) if problem.has_no_more(&error) => return Err(error),
            Err(error) => refused = Some(error),
        }
        part *= 0.5;
    }
    refused.filter(|_| !evaluated).map_or(Ok(None), Err)
}

pub(crate) fn add(x: &mut [f64], step: &[f64], part: f64) {
    x.iter_mut().zip(step).for_each(|(value, step)| *value += part * step);
}
