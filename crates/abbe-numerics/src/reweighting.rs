//! The rounds of robust weights: MM estimation by weighted least squares, again and again.

use crate::gauss_newton::{End, LeastSquares, Minimum, Options, Solution, add, minimise};
use crate::robust::{Robust, RobustReport, RowLoss, deviations, m_scale, prediction_variances, scale, studentised};

/// Rounds of Huber's weights after which their scale is near enough to be held.
const SCALE_ROUNDS: usize = 10;

/// Huber's weights that change by less than this tell a scale that is near enough.
const SCALE_SETTLED: f64 = 1e-2;

/// The second half of MM estimation (Yohai 1987), from a minimum where all rows count alike.
///
/// Huber's loss, which has one minimum, tells what a residual is compared with: its studentised size over one scale of all of
/// them. Both are then held. So every later round lowers one and the same objective, and weights cannot cycle.
pub(crate) fn solve_robust<P: LeastSquares + ?Sized>(
    problem: &P,
    mut minimum: Minimum,
    robust: Robust,
    options: &Options,
) -> Result<Solution, P::Error> {
    let mut rounds = Rounds { problem, options, weights: vec![1.0; problem.rows()], iterations: minimum.iterations };
    let mut settled = false;
    // Where least squares find no minimum, weights have nothing to start from.
    for _ in 0..if minimum.end == End::Converged { SCALE_ROUNDS } else { 0 } {
        let Some(Compared { residuals, deviations, .. }) = in_time(problem, rounds.compared(&minimum))? else {
            return Ok(rounds.out_of_time(minimum));
        };
        let studentised = studentised(&residuals, &deviations);
        let spread = scale(&rounds.measured(&studentised));
        let changed = rounds.reweigh(Robust::HUBER, &studentised, spread);
        minimum = rounds.minimise(minimum, false)?;
        settled = changed < SCALE_SETTLED;
        if settled || minimum.end != End::Converged {
            break;
        }
    }
    let Some(Compared { residuals, deviations, predictions }) = in_time(problem, rounds.compared(&minimum))? else {
        return Ok(rounds.out_of_time(minimum));
    };
    let spread = m_scale(&rounds.measured(&studentised(&residuals, &deviations)));
    let held = Held { robust, spread, predictions };
    let mut residuals = residuals;
    let mut sizes = held.sizes(&residuals);
    if minimum.end == End::Converged {
        settled = false;
        let mut last = None;
        for _ in 0..options.rounds {
            sizes = held.sizes(&residuals);
            settled = rounds.reweigh(robust, &sizes, 1.0) < options.settled;
            let mut step: Vec<f64> = minimum.x.iter().map(|value| -value).collect();
            minimum = rounds.minimise(minimum, settled)?;
            if settled || matches!(minimum.end, End::NoProgress | End::Standing | End::IterationLimit | End::TimeLimit)
            {
                break;
            }
            let Some(there) = in_time(problem, rounds.residuals(&minimum.x))? else {
                return Ok(rounds.out_of_time(minimum));
            };
            residuals = there;
            add(&mut step, &minimum.x, 1.0);
            let size = minimum.factor.row_norm(&step);
            let further = rounds.further(&minimum.x, &step, last.map_or(0.0, |last| size / last));
            last = Some(size);
            if let Some(x) = further {
                let ahead = match rounds.residuals(&x) {
                    Ok(ahead) => ahead,
                    Err(error) if problem.is_out_of_time(&error) => return Ok(rounds.out_of_time(minimum)),
                    Err(error) if problem.is_final(&error) => return Err(error),
                    // Too far ahead: one step at a time.
                    Err(_) => continue,
                };
                if held.objective(&ahead) < held.objective(&residuals) {
                    (minimum.x, residuals, last) = (x, ahead, None);
                }
            }
        }
    }
    if !settled && minimum.end == End::Converged {
        minimum.end = End::RoundLimit;
    }
    let slopes = held.slopes(&sizes);
    minimum.iterations = rounds.iterations;
    Ok(minimum.solution(Some(RobustReport { weights: rounds.weights, studentised: sizes, slopes })))
}

/// Residuals and what they are compared with; none where the fit follows a row whatever it says.
struct Compared {
    residuals: Vec<f64>,
    /// Their standard deviations in units of the noise.
    deviations: Vec<Option<f64>>,
    /// Variances of what the other rows say, in units of the noise.
    predictions: Vec<Option<f64>>,
}

/// What is held while robust weights settle.
struct Held {
    robust: Robust,
    spread: f64,
    predictions: Vec<Option<f64>>,
}

impl Held {
    fn row_loss(&self, prediction: Option<f64>) -> Option<RowLoss> {
        prediction.map(|prediction| RowLoss { robust: self.robust, prediction })
    }

    /// The studentised deleted residuals in units of the scale; 0 for rows that the fit follows.
    fn sizes(&self, residuals: &[f64]) -> Vec<f64> {
        let rows = residuals.iter().zip(&self.predictions);
        rows.map(|(residual, prediction)| {
            self.row_loss(*prediction).map_or(0.0, |row| row.size(residual / self.spread))
        })
        .collect()
    }

    fn slopes(&self, sizes: &[f64]) -> Vec<f64> {
        let rows = sizes.iter().zip(&self.predictions);
        rows.map(|(size, prediction)| self.row_loss(*prediction).map_or(1.0, |row| row.slope(*size))).collect()
    }

    /// What every round of weights lowers: the sum of the losses of these residuals.
    fn objective(&self, residuals: &[f64]) -> f64 {
        let loss = |((residual, size), prediction): ((&f64, f64), &Option<f64>)| match self.row_loss(*prediction) {
            Some(row) => row.loss(size),
            None => (residual / self.spread).powi(2) / 2.0,
        };
        residuals.iter().zip(self.sizes(residuals)).zip(&self.predictions).map(loss).sum()
    }
}

/// Ratio of the sizes of successive steps from which rounds are slow.
const SLOW: f64 = 0.5;

/// Ratio from which no more is looked ahead: twenty steps.
const FARTHEST: f64 = 0.95;

/// Iterations of all rounds of robust weights together, as a multiple of those that one minimum may take.
const ALL_ROUNDS: usize = 5;

/// Rounds of robust weights.
struct Rounds<'a, P: ?Sized> {
    problem: &'a P,
    options: &'a Options,
    weights: Vec<f64>,
    iterations: usize,
}

impl<P: LeastSquares + ?Sized> Rounds<'_, P> {
    /// Residuals at a minimum with what they are compared with.
    fn compared(&self, minimum: &Minimum) -> Result<Compared, P::Error> {
        let covariance_root = minimum.factor.covariance_root(minimum.factor.unknowns());
        let mut residuals = vec![0.0; self.problem.rows()];
        let mut leverages = vec![0.0; self.problem.rows()];
        self.problem.linearise(&minimum.x, &mut |first, block, derivatives| {
            let rows = first..first + block.len();
            residuals[rows.clone()].copy_from_slice(block);
            // Without unknowns a fit follows no row.
            for (own, leverage) in leverages[rows].iter_mut().zip(covariance_root.leverages(derivatives)) {
                *own = leverage;
            }
        })?;
        let mut deviations = deviations(&self.weights, &leverages);
        let mut predictions = prediction_variances(&self.weights, &leverages);
        for row in (0..deviations.len()).filter(|&row| self.problem.keeps_weight(row)) {
            (deviations[row], predictions[row]) = (None, None);
        }
        Ok(Compared { residuals, deviations, predictions })
    }

    /// The solution where the time was over before weights were settled. There is no next step: they come first.
    fn out_of_time(&self, minimum: Minimum) -> Solution {
        let (iterations, end, last_step) = (self.iterations, End::TimeLimit, f64::NAN);
        Minimum { end, iterations, last_step, ..minimum }.solution(None)
    }

    /// Where steps that shrink by this ratio lead to in the end; none unless rounds are slow.
    fn further(&self, x: &[f64], step: &[f64], ratio: f64) -> Option<Vec<f64>> {
        let slow = ratio < 1.0;
        let (mut further, ratio) = (x.to_vec(), ratio.min(FARTHEST));
        add(&mut further, step, ratio / (1.0 - ratio));
        (slow && ratio >= SLOW).then_some(further)
    }

    fn residuals(&self, x: &[f64]) -> Result<Vec<f64>, P::Error> {
        let mut residuals = vec![0.0; self.problem.rows()];
        self.problem
            .linearise(x, &mut |first, block, _| residuals[first..first + block.len()].copy_from_slice(block))?;
        Ok(residuals)
    }

    /// The studentised residuals of rows that were measured.
    fn measured(&self, studentised: &[f64]) -> Vec<f64> {
        let rows = studentised.iter().enumerate().filter(|(row, _)| !self.problem.keeps_weight(*row));
        rows.map(|(_, size)| *size).collect()
    }

    /// Weighs every row by its size; gives the largest change of a weight.
    fn reweigh(&mut self, robust: Robust, studentised: &[f64], spread: f64) -> f64 {
        let mut changed = 0.0_f64;
        for (row, (weight, size)) in self.weights.iter_mut().zip(studentised).enumerate() {
            let now = if self.problem.keeps_weight(row) { 1.0 } else { robust.weight(size / spread) };
            changed = changed.max((now - *weight).abs());
            *weight = now;
        }
        changed
    }

    /// The minimum with the weights as they are; with step control, for where rows hardly determine a direction, bare steps go
    /// astray.
    fn minimise(&mut self, from: Minimum, settled: bool) -> Result<Minimum, P::Error> {
        let Options { tolerance, rounding, .. } = *self.options;
        let options = Options { tolerance: if settled { tolerance } else { tolerance.max(rounding) }, ..*self.options };
        if self.iterations >= ALL_ROUNDS * self.options.iterations {
            return Ok(Minimum { end: End::IterationLimit, ..from });
        }
        let factor = match in_time(self.problem, self.problem.factor(&from.x, Some(&self.weights)))? {
            Some(factor) => factor,
            None => return Ok(Minimum { end: End::TimeLimit, iterations: 0, last_step: f64::NAN, ..from }),
        };
        let minimum = minimise(self.problem, from.x, factor, Some(&self.weights), &options)?;
        self.iterations += minimum.iterations;
        Ok(minimum)
    }
}

/// A value, or none if there was no more time for it.
fn in_time<P: LeastSquares + ?Sized, T>(problem: &P, result: Result<T, P::Error>) -> Result<Option<T>, P::Error> {
    match result {
        Err(error) if problem.is_out_of_time(&error) => Ok(None),
        result => result.map(Some),
    }
}
