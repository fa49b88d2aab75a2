//! Gauss-Newton iteration with step control, optionally robust.

use crate::factor::{Accumulator, Factor};
use crate::robust::{Loss, Robust, RobustReport, scale, studentise};

/// Takes rows: index of the first, residuals, derivatives row by row.
pub type Sink<'a> = &'a mut dyn FnMut(usize, &[f64], &[f64]);

/// A least squares problem in weighted residuals. Rows come in blocks, always in the same order.
pub trait LeastSquares {
    /// What can go wrong in an evaluation.
    type Error;

    /// Number of unknowns.
    fn unknowns(&self) -> usize;

    /// Number of rows.
    fn rows(&self) -> usize;

    /// Calls `sink` with (first row, residuals, derivatives row by row) for all rows, both divided by the standard
    /// uncertainty of the row.
    fn linearise(&self, x: &[f64], sink: Sink<'_>) -> Result<(), Self::Error>;

    /// The residuals alone, divided by the standard uncertainty of the row.
    fn residuals(&self, x: &[f64]) -> Result<Vec<f64>, Self::Error>;
}

/// How to iterate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Most iterations.
    pub iterations: usize,
    /// Converged when no unknown's step moves the rows by more than this many standard uncertainties.
    pub tolerance: f64,
    /// Number of directions to move in: the rank.
    pub rank: usize,
    /// Robust weights.
    pub robust: Option<Robust>,
}

/// How the iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// The last step was below the tolerance, or below what rounding lets through.
    Converged,
    /// No step along the direction of descent made the residuals smaller.
    NoProgress,
    /// Out of iterations.
    IterationLimit,
}

/// The last iterate, whatever the end.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The unknowns.
    pub x: Vec<f64>,
    /// Iterations done.
    pub iterations: usize,
    /// How it ended.
    pub end: End,
    /// Weights and studentised residuals of a robust estimate.
    pub robust: Option<RobustReport>,
}

/// Factorises the problem at x with statistical weights (all 1 if there are none).
pub(crate) fn factorise<P: LeastSquares + ?Sized>(
    problem: &P,
    x: &[f64],
    weights: Option<&[f64]>,
) -> Result<Factor, P::Error> {
    let unknowns = problem.unknowns();
    let mut accumulator = Accumulator::new(unknowns, problem.rows());
    problem.linearise(x, &mut |first, residuals, derivatives| {
        for (row, residual) in residuals.iter().enumerate() {
            let weight = weights.map_or(1.0, |weights| weights[first + row].sqrt());
            accumulator.push(&derivatives[row * unknowns..(row + 1) * unknowns], *residual, weight);
        }
    })?;
    Ok(accumulator.finish())
}

/// Minimises the sum of squares from `start`; see [`Options`].
///
/// Every step is that of the linearised problem, columns scaled, within its first `rank` singular directions, and is
/// halved while it does not make the sum of squares smaller.
pub fn solve<P: LeastSquares + ?Sized>(problem: &P, start: &[f64], options: &Options) -> Result<Solution, P::Error> {
    let (mut x, mut end, mut iterations) = minimise(problem, start.to_vec(), None, options)?;
    let Some(robust) = options.robust else { return Ok(Solution { x, iterations, end, robust: None }) };
    // Huber's loss has one minimum and takes the estimate near enough for Tukey's, which has many.
    let phases: &[Robust] = match robust.loss {
        Loss::Huber => &[robust],
        Loss::Tukey => &[Robust::HUBER, robust],
    };
    let mut weights = vec![1.0; problem.rows()];
    let mut studentised = Vec::new();
    'phases: for phase in phases {
        end = End::IterationLimit;
        for _ in 0..options.iterations {
            let factor = factorise(problem, &x, Some(&weights))?;
            studentised = studentised_residuals(problem, &x, &weights, &factor, options.rank)?;
            let spread = scale(&studentised);
            let before = std::mem::take(&mut weights);
            weights = studentised.iter().map(|size| phase.weight(size / spread)).collect();
            let changed = weights.iter().zip(&before).map(|(now, before)| (now - before).abs()).fold(0.0, f64::max);
            // With step control and to the end: where the rows hardly determine a direction, single steps go astray.
            let (settled, ended, used) = minimise(problem, x, Some(&weights), options)?;
            x = settled;
            iterations += used;
            if ended != End::Converged {
                end = ended;
                break 'phases;
            }
            if changed < SETTLED {
                end = End::Converged;
                break;
            }
        }
    }
    let spread = scale(&studentised);
    studentised.iter_mut().for_each(|size| *size /= spread);
    Ok(Solution { x, iterations, end, robust: Some(RobustReport { weights, studentised }) })
}

fn studentised_residuals<P: LeastSquares + ?Sized>(
    problem: &P,
    x: &[f64],
    weights: &[f64],
    factor: &Factor,
    rank: usize,
) -> Result<Vec<f64>, P::Error> {
    let unknowns = problem.unknowns();
    let spectrum = (rank < unknowns).then(|| factor.spectrum());
    let leverage = |row: &[f64]| match &spectrum {
        Some(spectrum) => spectrum.leverage(row, rank),
        None => factor.leverage(row),
    };
    let (mut residuals, mut leverages) = (Vec::new(), Vec::new());
    problem.linearise(x, &mut |_, block, derivatives| {
        residuals.extend_from_slice(block);
        leverages.extend(derivatives.chunks_exact(unknowns.max(1)).map(leverage));
    })?;
    Ok(studentise(&residuals, weights, &leverages))
}

/// Steps below this many standard uncertainties are as good as none.
const SMALL: f64 = 1e-3;

/// The step within the first `rank` singular directions, and by how many standard uncertainties it moves the rows; None
/// if there are fewer directions than that.
fn step_of(factor: &Factor, rank: usize) -> Option<(Vec<f64>, f64)> {
    let step = match factor.step().filter(|_| rank == factor.unknowns()) {
        Some(step) => step,
        None => factor.spectrum().step(rank),
    };
    let size = step.iter().zip(factor.norms()).map(|(step, norm)| (step * norm).abs()).fold(0.0, f64::max);
    step.iter().all(|value| value.is_finite()).then_some((step, size))
}

/// Robust weights that change by less than this have settled: what is left moves estimates by less than a millionth of
/// their uncertainty.
const SETTLED: f64 = 1e-6;

type Minimum = (Vec<f64>, End, usize);

fn minimise<P: LeastSquares + ?Sized>(
    problem: &P,
    mut x: Vec<f64>,
    weights: Option<&[f64]>,
    options: &Options,
) -> Result<Minimum, P::Error> {
    let mut factor = factorise(problem, &x, weights)?;
    let mut last_size = f64::INFINITY;
    for iteration in 1..=options.iterations {
        let Some((step, size)) = step_of(&factor, options.rank) else { return Ok((x, End::NoProgress, iteration)) };
        // Once steps are small they shrink fast, unless rounding is all that is left of them.
        let rounding = size < SMALL && size > 0.5 * last_size;
        if size <= options.tolerance || rounding {
            add(&mut x, &step, 1.0);
            return Ok((x, End::Converged, iteration));
        }
        last_size = size;
        let cost = factor.cost();
        let mut part = 1.0;
        loop {
            let mut trial = x.clone();
            add(&mut trial, &step, part);
            let trial_factor = factorise(problem, &trial, weights)?;
            let differentiable = trial_factor.norms().iter().all(|norm| norm.is_finite());
            if differentiable && trial_factor.cost() <= cost * (1.0 + 1e-12) + f64::MIN_POSITIVE {
                (x, factor) = (trial, trial_factor);
                break;
            }
            part *= 0.5;
            if part < 1e-6 {
                // Nothing below helps: this is as low as rounding allows, or the model is not smooth here. Where the
                // condition is bad, rounding leaves steps of large parts that together do nothing.
                let end = if size < SMALL || factor.effect(&step) < SMALL { End::Converged } else { End::NoProgress };
                return Ok((x, end, iteration));
            }
        }
    }
    Ok((x, End::IterationLimit, options.iterations))
}

fn add(x: &mut [f64], step: &[f64], part: f64) {
    x.iter_mut().zip(step).for_each(|(value, step)| *value += part * step);
}
