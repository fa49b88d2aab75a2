//! Robust weights of rows that nobody holds: each pass over the rows weighs them where it linearises them (MM estimation: Huber
//! 1964; Yohai 1987).
//!
//! The objective is that of [`solve_from`](crate::solve_from) with [`Options::robust`]. What it keeps of every row (the variance of
//! what the others say) follows here from the row itself and from the factor at the minimum of Huber's loss, which has the size of
//! the unknowns.

use crate::accumulate::Accumulator;
use crate::factor::{CovarianceRoot, Factor};
use crate::gauss_newton::{End, Options, Solution, add};
use crate::robust::{Robust, RowLoss, counted_m_scale, counted_scale, deviation, prediction_variance};

/// Where rows are weighed by Huber's loss, and what a residual is compared with there.
#[derive(Debug, Clone)]
pub struct HuberPoint {
    /// The unknowns.
    pub x: Vec<f64>,
    /// The root of their covariance; none before it is known: then rows count as if they had no leverage.
    pub root: Option<CovarianceRoot>,
    /// The scale of studentised residuals; infinite before it is known: then all rows count alike.
    pub scale: f64,
}

/// How the rows of a pass are weighed.
#[derive(Debug, Clone)]
pub enum Weighing {
    /// By Huber's loss, towards its minimum.
    Huber(HuberPoint),
    /// By the loss of the estimate, with what was found at the minimum of Huber's loss.
    Held {
        /// That minimum.
        at: HuberPoint,
        /// The scale of the residuals that is held.
        spread: f64,
        /// The loss.
        robust: Robust,
    },
}

/// What a row counts for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowWeight {
    /// Its statistical weight, 0 to 1.
    pub weight: f64,
    /// Its studentised size: over the scale, if that is held.
    pub size: f64,
    /// Derivative of its influence to its residual.
    pub slope: f64,
    /// What it adds to the objective.
    pub loss: f64,
}

impl Weighing {
    /// Where rows are compared with their scale.
    pub fn huber(&self) -> &HuberPoint {
        match self {
            Self::Huber(at) | Self::Held { at, .. } => at,
        }
    }

    /// The weights of rows at x: residuals, derivatives row by row, and which of them keep their weight.
    pub fn rows(&self, x: &[f64], residuals: &[f64], derivatives: &[f64], keeps: &[bool]) -> Vec<RowWeight> {
        let HuberPoint { x: there, root, .. } = self.huber();
        let leverages = root.as_ref().map_or_else(Vec::new, |root| root.leverages(derivatives));
        let back: Vec<f64> = there.iter().zip(x).map(|(there, here)| there - here).collect();
        let lines = derivatives.chunks_exact(x.len().max(1));
        let rows = residuals.iter().zip(lines).zip(keeps).enumerate();
        rows.map(|(row, ((residual, line), keeps))| {
            let leverage = leverages.get(row).copied().unwrap_or(0.0);
            // So near the residual there is that of the linearised row.
            let before = residual + line.iter().zip(&back).map(|(slope, back)| slope * back).sum::<f64>();
            self.row(*residual, before, leverage, *keeps)
        })
        .collect()
    }

    fn row(&self, residual: f64, before: f64, leverage: f64, keeps: bool) -> RowWeight {
        match self {
            Self::Huber(at) => at.row(residual, leverage, keeps),
            Self::Held { at, spread, robust } => {
                let kept = || (!keeps).then(|| prediction_variance(at.row(before, leverage, keeps).weight, leverage));
                let relative = residual / spread;
                let Some(prediction) = kept().flatten() else {
                    return RowWeight { weight: 1.0, size: 0.0, slope: 1.0, loss: relative * relative / 2.0 };
                };
                let row = RowLoss { robust: *robust, prediction };
                let size = row.size(relative);
                RowWeight { weight: robust.weight(size), size, slope: row.slope(size), loss: row.loss(size) }
            }
        }
    }
}

/// Rounds until the weight of a row agrees with the deviation that follows from it: a row has little leverage, or few rows tell anything.
const OWN_ROUNDS: usize = 4;

impl HuberPoint {
    fn row(&self, residual: f64, leverage: f64, keeps: bool) -> RowWeight {
        let (mut weight, mut size) = (1.0, 0.0);
        if keeps {
            return RowWeight { weight, size, slope: 1.0, loss: 0.0 };
        }
        for _ in 0..if leverage > 0.0 { OWN_ROUNDS } else { 1 } {
            size = deviation(weight, leverage).map_or(0.0, |deviation| residual / deviation);
            weight = Robust::HUBER.weight(size / self.scale);
        }
        RowWeight { weight, size, slope: Robust::HUBER.influence_slope(size / self.scale), loss: 0.0 }
    }
}

/// What a pass over all rows tells.
#[derive(Debug, Clone)]
pub struct RobustPass {
    /// The factor of the weighed rows.
    pub factor: Factor,
    /// The sum of the losses.
    pub objective: f64,
    /// The sum of the weights of rows that were measured.
    pub weights: f64,
    /// The sum of their slopes.
    pub slopes: f64,
    /// Their absolute studentised sizes above zero, ascending, each with how many rows have it: about, to a part of a thousand.
    pub sizes: Vec<(f64, f64)>,
}

/// Rows that are gone through in passes.
pub trait InPasses {
    /// Error of a pass.
    type Error;

    /// Whether no pass is possible after this error; any other means that these values cannot be evaluated.
    fn is_final(&self, error: &Self::Error) -> bool;

    /// Called when a step was taken, with its number and its size.
    fn has_stepped(&self, _passes: usize, _size: f64) {}

    /// One pass over all rows at x.
    fn pass(&self, x: &[f64], weighing: &Weighing) -> Result<RobustPass, Self::Error>;
}

/// Passes towards the minimum of Huber's loss at most, as many as rounds of weights that are held.
const HUBER_PASSES: usize = 12;

/// A change of all rows together, over the root of their number, that moves no scale.
const SCALE_MOVED: f64 = 3e-3;

/// A change of the scale itself that is none.
const SCALE_CHANGED: f64 = 2e-3;

/// How near to the minimum a robust estimate is when its passes end, in standard uncertainties of all rows together.
const LEFT: f64 = 1e-6;

/// The robust estimate, and how its rows are weighed; from where Huber's loss may have its minimum, and with a scale that may be known.
///
/// Passes go towards the minimum of Huber's loss until its scale stands; the M-scale is that of all rows there, and is held. Then each
/// pass is a step of Gauss-Newton with the weights of the place where it begins, times what the mean slope of the influence says, and
/// mixed with the steps before it (Anderson 1965, J. ACM 12:547). A step that does not lower the objective is taken back.
pub fn solve_in_passes<P: InPasses + ?Sized>(
    problem: &P,
    start: HuberPoint,
    robust: Robust,
    options: &Options,
) -> Result<(Solution, Weighing), P::Error> {
    let (at, spread, x, mut passes) = match to_huber(problem, start)? {
        Ok(found) => found,
        Err((solution, at)) => return Ok((*solution, Weighing::Huber(at))),
    };
    let weighing = Weighing::Held { at, spread, robust };
    let mut settling = Settling { problem, weighing: &weighing, passes: &mut passes, most: options.rounds };
    let solution = settling.settle(x)?;
    Ok((solution, weighing))
}

/// Where Huber's loss has its minimum, from near it; none where a pass leaves out what determines a direction.
pub fn huber_point<P: InPasses + ?Sized>(problem: &P, start: HuberPoint) -> Result<Option<HuberPoint>, P::Error> {
    Ok(to_huber(problem, start)?.ok().map(|(at, _, x, _)| HuberPoint { x, ..at }))
}

/// The minimum of Huber's loss, the M-scale there, where the next pass begins, and passes so far.
type Huber = (HuberPoint, f64, Vec<f64>, usize);

/// Where a pass leaves out what determines a direction, and how it weighed its rows.
type Lost = (Box<Solution>, HuberPoint);

fn to_huber<P: InPasses + ?Sized>(problem: &P, mut at: HuberPoint) -> Result<Result<Huber, Lost>, P::Error> {
    let mut passes = 0;
    loop {
        passes += 1;
        let pass = problem.pass(&at.x, &Weighing::Huber(at.clone()))?;
        let rows: f64 = pass.sizes.iter().map(|(_, count)| count).sum();
        let Some(step) = pass.factor.step() else {
            return Ok(Err((Box::new(ended(at.x.clone(), End::NoProgress, passes, f64::NAN, pass.factor)), at)));
        };
        let size = pass.factor.row_norm(&step) * gain(&pass);
        problem.has_stepped(passes, size);
        let mut next = at.x.clone();
        add(&mut next, &step, gain(&pass));
        let scale = counted_scale(&pass.sizes);
        let stands = (scale / at.scale - 1.0).abs() <= SCALE_CHANGED && size <= SCALE_MOVED * rows.sqrt();
        if at.root.is_some() && (stands || passes >= HUBER_PASSES) {
            let spread = counted_m_scale(&pass.sizes);
            return Ok(Ok((at, spread, next, passes)));
        }
        let root = Some(pass.factor.covariance_root(pass.factor.unknowns()));
        at = HuberPoint { x: next, root, scale };
    }
}

/// What a step of weighed least squares lacks to one of Newton's, if slopes do not depend on derivatives.
fn gain(pass: &RobustPass) -> f64 {
    let gain = pass.weights / pass.slopes;
    if gain.is_finite() { gain.clamp(1.0, 2.0) } else { 1.0 }
}

fn ended(x: Vec<f64>, end: End, iterations: usize, last_step: f64, factor: Factor) -> Solution {
    let gradient_cosine = factor.gradient_cosine();
    Solution { x, iterations, end, last_step, gradient_cosine, robust: None, factor }
}

/// Steps that are mixed.
const MIXED: usize = 5;

/// A mixed step that is longer than this many own ones goes astray.
const LONGEST: f64 = 10.0;

/// Rounding of the objective.
const ROUNDING: f64 = 1e-11;

/// Passes with a scale that is held.
struct Settling<'a, P: ?Sized> {
    problem: &'a P,
    weighing: &'a Weighing,
    passes: &'a mut usize,
    most: usize,
}

/// A step and the place from which it goes.
struct Step {
    from: Vec<f64>,
    step: Vec<f64>,
}

/// A step and the change of it that followed.
struct Followed {
    moved: Vec<f64>,
    changed: Vec<f64>,
}

impl<P: InPasses + ?Sized> Settling<'_, P> {
    fn settle(&mut self, mut x: Vec<f64>) -> Result<Solution, P::Error> {
        let mut here = self.pass(&x)?;
        let mut followed: Vec<Followed> = Vec::new();
        let mut last: Option<Step> = None;
        loop {
            let Some(plain) = here.factor.step() else {
                return Ok(ended(x, End::NoProgress, *self.passes, f64::NAN, here.factor));
            };
            let gain = gain(&here);
            let step: Vec<f64> = plain.iter().map(|part| part * gain).collect();
            let size = here.factor.row_norm(&step);
            if let Some(before) = last.take() {
                followed.push(Followed { moved: minus(&x, &before.from), changed: minus(&step, &before.step) });
                followed.drain(..followed.len().saturating_sub(MIXED));
            }
            let mixed = mixed(&here.factor, &step, &followed);
            if size <= LEFT {
                add(&mut x, &mixed, 1.0);
                return Ok(ended(x, End::Converged, *self.passes, size, here.factor));
            }
            if *self.passes >= self.most {
                return Ok(ended(x, End::RoundLimit, *self.passes, size, here.factor));
            }
            let Some((next, there, is_mixed)) = self.lower(&x, here.objective, [&mixed, &plain])? else {
                let end = if size <= 1e-4 { End::Converged } else { End::NoProgress };
                return Ok(ended(x, end, *self.passes, size, here.factor));
            };
            self.problem.has_stepped(*self.passes, size);
            if !is_mixed {
                followed.clear();
            }
            last = Some(Step { from: x, step });
            (x, here) = (next, there);
        }
    }

    fn pass(&mut self, x: &[f64]) -> Result<RobustPass, P::Error> {
        *self.passes += 1;
        self.problem.pass(x, self.weighing)
    }

    /// The end of the first step, or of a part of the second one, that does not make the objective larger.
    #[expect(clippy::type_complexity, reason = "a place, what it tells, and whether the first step led there")]
    fn lower(
        &mut self,
        x: &[f64],
        objective: f64,
        [mixed, plain]: [&[f64]; 2],
    ) -> Result<Option<(Vec<f64>, RobustPass, bool)>, P::Error> {
        let (mut part, mut step, mut refused) = (1.0, mixed, None);
        while part > 1e-3 {
            let mut trial = x.to_vec();
            add(&mut trial, step, part);
            match self.pass(&trial) {
                Ok(there) if there.objective <= objective * (1.0 + ROUNDING) => {
                    return Ok(Some((trial, there, std::ptr::eq(step, mixed))));
                }
                Ok(_) => refused = None,
                Err(error) if self.problem.is_final(&error) => return Err(error),
                Err(error) => refused = Some(error),
            }
            if std::ptr::eq(step, mixed) {
                step = plain;
            } else {
                part *= 0.5;
            }
        }
        refused.map_or(Ok(None), Err)
    }
}

fn minus(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one - other).collect()
}

/// A step, corrected by what steps before it were followed by.
fn mixed(factor: &Factor, step: &[f64], followed: &[Followed]) -> Vec<f64> {
    let mut mixed = step.to_vec();
    if followed.is_empty() || followed.len() >= step.len() {
        return mixed;
    }
    let own = factor.of_all_rows(step);
    let changes: Vec<Vec<f64>> = followed.iter().map(|known| factor.of_all_rows(&known.changed)).collect();
    let mut accumulator = Accumulator::new(changes.len(), own.len());
    for (row, residual) in own.iter().enumerate() {
        let line: Vec<f64> = changes.iter().map(|change| change[row]).collect();
        accumulator.push(&line, *residual, 1.0);
    }
    let Some(parts) = accumulator.finish().step() else { return mixed };
    for (part, known) in parts.iter().zip(followed) {
        add(&mut mixed, &known.moved, *part);
        add(&mut mixed, &known.changed, *part);
    }
    let long = factor.row_norm(&mixed) > LONGEST * factor.row_norm(step);
    if long || mixed.iter().any(|part| !part.is_finite()) { step.to_vec() } else { mixed }
}
