//! Two fits of the same rows, of which one has something corrected: whether that is what was wrong.

use std::sync::Arc;

use abbe_core::{KinematicModel, Problem};
use abbe_numerics::{LeastSquares, Options, solve_from};

use crate::mistakes::spread;
use crate::weighted::Weighted;

/// Standard deviations of chi-squared beyond which residuals do not scatter as stated, and within which they do.
const BEYOND: f64 = 5.0;
const WITHIN: f64 = 2.0;

/// Part of chi-squared that is expected, below which residuals do not scatter as stated, either.
const LEAST: f64 = 0.25;

/// Least fall of chi-squared: as many units as no chance makes.
const FALL: f64 = 40.0;

/// Iterations of a fit.
const ITERATIONS: usize = 15;

/// How well a problem fits, by plain least squares.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fitted {
    /// Sum of squares of the residuals in standard uncertainties.
    pub squares: f64,
    /// Equations that are more than unknowns.
    pub free: f64,
}

impl Fitted {
    /// The fit from the start; none if there is none, or nothing is left to judge it by.
    pub fn of(problem: &Problem) -> Option<Self> {
        let weighted = Weighted::new(problem).ok()?;
        let options = Options { iterations: ITERATIONS, tolerance: 1e-3, ..Options::USUAL };
        let solution = solve_from(&weighted, &problem.start(), None, &options).ok()?;
        let residuals = weighted.in_uncertainties(problem.residuals(&solution.x).ok()?);
        Self::new(residuals.iter().map(|residual| residual * residual).sum(), &weighted)
    }

    /// The same after one step, which is most of it.
    pub fn after_a_step(problem: &Problem) -> Option<Self> {
        let weighted = Weighted::new(problem).ok()?;
        let factor = weighted.factor(&problem.start(), None).ok()?;
        Self::new(factor.remaining_cost(), &weighted)
    }

    fn new(squares: f64, weighted: &Weighted<'_>) -> Option<Self> {
        let free = weighted.rows().checked_sub(weighted.unknowns()).filter(|free| *free > 0)? as f64;
        squares.is_finite().then_some(Self { squares, free })
    }

    /// The scatter of its residuals, over what is stated.
    pub fn scatter(&self) -> f64 {
        (self.squares / self.free).sqrt()
    }

    fn limit(&self, deviations: f64) -> f64 {
        self.free + deviations * (2.0 * self.free).sqrt()
    }

    /// Whether residuals scatter by more than chance makes of what is stated.
    pub fn is_beyond_chance(&self) -> bool {
        self.squares > self.limit(BEYOND)
    }

    /// Whether residuals scatter as stated with a correction, and do not without.
    pub fn is_explained_by(&self, corrected: &Self) -> bool {
        let as_stated = (LEAST * self.free..self.limit(WITHIN)).contains(&corrected.squares);
        self.is_beyond_chance() && as_stated && self.squares - corrected.squares > FALL
    }
}

/// Most rows of a set that machines are tried on, unless there are many unknowns.
const ROWS: usize = 500;

/// Of several machines the one with which residuals scatter best, and as stated, and how many times as much as stated they do with the
/// machine as it is and with that one; none where they scatter as stated as it is, and where they do with none. Machines are not asked
/// for then, or are made one by one.
///
/// ```
/// # use std::sync::Arc;
/// # use abbe_core::{KinematicModel, Problem};
/// fn told(problem: &Problem, exchanged: Arc<dyn KinematicModel>) -> Option<String> {
///     let (name, [before, after]) = abbe_estimation::explaining_machine(problem, [("exchanged", exchanged)])?;
///     Some(format!("{name}: {before:.2} times as much as stated, and {after:.2} times"))
/// }
/// ```
pub fn explaining_machine<T>(
    problem: &Problem,
    machines: impl IntoIterator<Item = (T, Arc<dyn KinematicModel>)>,
) -> Option<(T, [f64; 2])> {
    let few = spread(problem, ROWS);
    let now = Fitted::after_a_step(&few).filter(Fitted::is_beyond_chance).and_then(|_| Fitted::of(&few))?;
    if !now.is_beyond_chance() {
        return None;
    }
    let mut best: Option<(T, Fitted)> = None;
    for (name, model) in machines {
        problem.monitor.check().ok()?;
        let other = Problem { model, ..few.clone() };
        let is_best = |after: &Fitted| best.as_ref().is_none_or(|(_, least)| after.squares < least.squares);
        let after = Fitted::after_a_step(&other).filter(|after| now.is_explained_by(after) && is_best(after));
        if let Some(after) = after.and_then(|_| Fitted::of(&other)).filter(|after| now.is_explained_by(after)) {
            best = Some((name, after));
        }
    }
    best.map(|(name, after)| (name, [now.scatter(), after.scatter()]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_explains_scatters_as_stated() {
        let fitted = |squares: f64| Fitted { squares, free: 136.0 };
        assert!(fitted(221.0).is_explained_by(&fitted(145.0)));
        for (before, after) in [(221.0, 190.0), (221.0, 0.0), (200.0, 145.0), (145.0, 221.0)] {
            assert!(!fitted(before).is_explained_by(&fitted(after)), "{before} {after}");
        }
    }
}
