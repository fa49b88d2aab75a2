//! Two fits of the same rows, of which one has something corrected: whether that is what was wrong.

use std::sync::Arc;

use abbe_core::{KinematicModel, Problem};
use abbe_numerics::{Factor, LeastSquares, Options, solve_from};

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

/// Probability, of all corrections that are tried together, below which readings are not likelier corrected by chance. It is far below
/// one in a thousand, because residuals are not quite independent.
const BY_CHANCE: f64 = 1e-6;

/// The scatter of residuals, over what is stated, that exact data do not have, and how many times smaller it becomes where a model lacks
/// errors and a correction is right.
const INEXACT: f64 = 0.2;
const FALLS: f64 = 3.0;

/// What an exchange may leave of what chi-squared was larger than expected, as a part of it and in standard deviations. Of 24 simulated
/// machines whose model lacks a little (scatters of 1.1 to 1.24) one of several hundred exchanges left a third, two standard deviations,
/// of six.
const PART_LEFT: f64 = 0.1;
const LITTLE: f64 = 1.0;

/// A correction of readings that explains them.
#[derive(Debug)]
pub(crate) struct Explained {
    /// Sum of squares of the residuals with it, in standard uncertainties.
    pub squares: f64,
    pub words: String,
}

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
        Self::from_start(problem, &Weighted::new(problem).ok()?, None)
    }

    /// The same after one step, which is most of it.
    pub fn after_a_step(problem: &Problem) -> Option<Self> {
        let weighted = Weighted::new(problem).ok()?;
        let factor = weighted.factor(&problem.start(), None).ok()?;
        Self::new(factor.remaining_cost(), &weighted)
    }

    /// The fit from the start where residuals scatter by more than chance makes of what is stated; none where they do not, which those
    /// at an `estimate` from these rows and others, or a step, tell mostly.
    pub fn beyond_chance(problem: &Problem, estimate: Option<&[f64]>) -> Option<Self> {
        if Self::scatter_at(problem, estimate).is_some_and(|at| !at.is_beyond_chance()) {
            return None;
        }
        let weighted = Weighted::new(problem).ok()?;
        let factor = weighted.factor(&problem.start(), None).ok()?;
        let is_doubtful = Self::new(factor.remaining_cost(), &weighted)?.is_beyond_chance();
        let fitted = is_doubtful.then(|| Self::from_start(problem, &weighted, Some(factor))).flatten();
        fitted.filter(Self::is_beyond_chance)
    }

    /// How residuals at values of the unknowns scatter: the best fit of these rows scatters no more. None without values.
    pub fn scatter_at(problem: &Problem, values: Option<&[f64]>) -> Option<Self> {
        let residuals = problem.residuals(values?).ok()?;
        let weighted = Weighted::new(problem).ok()?;
        let squares = weighted.in_uncertainties(residuals).iter().map(|residual| residual * residual).sum();
        Self::new(squares, &weighted)
    }

    fn from_start(problem: &Problem, weighted: &Weighted<'_>, factor: Option<Factor>) -> Option<Self> {
        let options = Options { iterations: ITERATIONS, tolerance: 1e-3, ..Options::USUAL };
        let solution = solve_from(weighted, &problem.start(), factor, &options).ok()?;
        let residuals = weighted.in_uncertainties(problem.residuals(&solution.x).ok()?);
        Self::new(residuals.iter().map(|residual| residual * residual).sum(), weighted)
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

    /// The same of an exchange of columns that was looked for among many. One of many makes up for a part of what a model lacks, and then
    /// more is left than where columns were exchanged.
    pub fn is_explained_by_exchange(&self, exchanged: &Self) -> bool {
        let deviations = |fitted: &Self| (fitted.squares - fitted.free) / (2.0 * fitted.free).sqrt();
        let left = (PART_LEFT * deviations(self)).max(LITTLE);
        self.is_explained_by(exchanged) && deviations(exchanged) < left
    }

    /// Whether readings in another order or with other signs, the best of so many ways, are what was measured.
    ///
    /// Such a correction keeps all distances, and the equations are the same. So the likelihoods of both, with all unknowns and the size
    /// of the noise left open, are in the proportion of the sums of squares to the power of half of what is free, and the mean of this
    /// proportion over right readings is one: it is larger than k with a probability of at most 1/k (Wald 1947, section 3.4), whatever
    /// was measured.
    pub fn is_far_less_likely_than(&self, corrected: &Self, ways: usize) -> bool {
        let log_ratio = 0.5 * self.free * (self.squares / corrected.squares).ln();
        let is_better = log_ratio > (ways.max(1) as f64 / BY_CHANCE).ln();
        let fits = corrected.squares < corrected.limit(WITHIN) || self.scatter() > FALLS * corrected.scatter();
        self.scatter() > INEXACT && is_better && fits
    }
}

/// Most rows of a set that machines are tried on, unless there are many unknowns.
const ROWS: usize = 500;

/// Of several machines the one with which residuals scatter best, and as stated, and how many times as much as stated they do with the
/// machine as it is and with that one; none where they scatter as stated as it is, and where they do with none. Machines are not asked
/// for then, or are made one by one. An `estimate`, values of the unknowns, tells sooner that they do.
///
/// ```
/// # use std::sync::Arc;
/// # use abbe_core::{KinematicModel, Problem};
/// fn told(problem: &Problem, exchanged: Arc<dyn KinematicModel>) -> Option<String> {
///     let (name, [before, after]) = abbe_estimation::explaining_machine(problem, None, [("exchanged", exchanged)])?;
///     Some(format!("{name}: {before:.2} times as much as stated, and {after:.2} times"))
/// }
/// ```
pub fn explaining_machine<T>(
    problem: &Problem,
    estimate: Option<&[f64]>,
    machines: impl IntoIterator<Item = (T, Arc<dyn KinematicModel>)>,
) -> Option<(T, [f64; 2])> {
    let few = spread(problem, ROWS);
    let now = Fitted::beyond_chance(&few, estimate)?;
    let mut best: Option<(T, Fitted)> = None;
    for (name, model) in machines {
        problem.monitor.check().ok()?;
        let other = Problem { model, ..few.clone() };
        let is_best = |after: &Fitted| best.as_ref().is_none_or(|(_, least)| after.squares < least.squares);
        let after = Fitted::after_a_step(&other).filter(|after| now.is_explained_by_exchange(after) && is_best(after));
        if let Some(after) = after.and_then(|_| Fitted::of(&other)).filter(|after| now.is_explained_by_exchange(after))
        {
            best = Some((name, after));
        }
    }
    best.map(|(name, after)| (name, [now.scatter(), after.scatter()]))
}

#[cfg(test)]
mod tests {
    use abbe_numerics::Generator;
    use nalgebra::{DMatrix, DVector};

    use super::*;

    /// What two channels of a ball read that an axis turns by these angles: a shift, an eccentricity, a scale and lost motion of each.
    /// Sums of squares as they are and exchanged.
    fn two_channels(random: &mut Generator, are_exchanged: bool) -> [Fitted; 2] {
        let mut below =
            |count: usize| ((random.uniform() / 3.0_f64.sqrt() + 1.0) * 0.5 * count as f64) as usize % count;
        let rows = 12 + below(25);
        let step = [5.0_f64, 7.5, 10.0, 15.0, 22.5][below(5)].to_radians();
        let (digits, noise) = ([0.01, 0.1, 1.0][below(3)], [0.4, 0.7, 1.0, 1.4][below(4)]);
        let line = |equation: usize| {
            let (angle, back) = (step * (equation / 2) as f64, f64::from(equation / 2 >= rows / 2));
            let (sin, cos) = angle.sin_cos();
            match equation % 2 {
                0 => vec![1.0, 0.0, cos, -sin, cos, 0.0, back, 0.0],
                _ => vec![0.0, 1.0, sin, cos, 0.0, sin, 0.0, back],
            }
        };
        let matrix = DMatrix::from_fn(2 * rows, 8, |equation, unknown| line(equation)[unknown]);
        let size = 10_f64.powf(random.uniform());
        let truth = DVector::from_fn(8, |_, _| size * random.uniform());
        let read = (&matrix * truth).map(|value| ((value + noise * random.normal()) / digits).round() * digits);
        let other = DVector::from_fn(2 * rows, |equation, _| read[equation ^ 1]);
        let (now, other) = if are_exchanged { (other, read) } else { (read, other) };
        let qr = matrix.qr().q();
        [now, other].map(|own| {
            let rest = &own - &qr * (qr.transpose() * &own);
            Fitted { squares: rest.norm_squared(), free: (2 * rows - 8) as f64 }
        })
    }

    #[test]
    fn channels_in_their_order_get_no_word() {
        let told = (0..20_000).filter(|seed| {
            let [now, other] = two_channels(&mut Generator::new(*seed, 21), false);
            now.is_far_less_likely_than(&other, 1)
        });
        assert_eq!(told.count(), 0);
    }

    #[test]
    fn exchanged_channels_are_told_where_they_contradict() {
        let (mut told, mut all) = (0, 0);
        for seed in 0..2000 {
            let [now, other] = two_channels(&mut Generator::new(seed, 22), true);
            all += usize::from(now.scatter() > 2.0 * other.scatter());
            told += usize::from(now.scatter() > 2.0 * other.scatter() && now.is_far_less_likely_than(&other, 1));
        }
        assert!(all > 200 && 10 * told > 9 * all, "{told} of {all}");
    }

    #[test]
    fn what_explains_scatters_as_stated() {
        let fitted = |squares: f64| Fitted { squares, free: 136.0 };
        assert!(fitted(221.0).is_explained_by(&fitted(145.0)));
        for (before, after) in [(221.0, 190.0), (221.0, 0.0), (200.0, 145.0), (145.0, 221.0)] {
            assert!(!fitted(before).is_explained_by(&fitted(after)), "{before} {after}");
        }
    }

    #[test]
    fn an_exchange_leaves_nothing_of_what_the_residuals_were_too_large_by() {
        let fitted = |scatter: f64| Fitted { squares: scatter * scatter * 370.0, free: 370.0 };
        for (before, after, is_told) in [
            (1.20, 1.07, false),
            (1.24, 1.07, false),
            (1.20, 1.02, true),
            (1.20, 0.95, true),
            (2.0, 1.07, true),
            (2.0, 1.1, false),
        ] {
            assert_eq!(fitted(before).is_explained_by_exchange(&fitted(after)), is_told, "{before} {after}");
        }
    }
}
