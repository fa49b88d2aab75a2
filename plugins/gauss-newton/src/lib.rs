//! Estimator plugin `gauss-newton`: weighted least squares on all observations at once, robust on request.
//!
//! Every equation counts with 1/u of its standard uncertainty. What the data can determine is judged for the nominal machine, before
//! anything is solved; a direction that they cannot determine is an error, unless `on_confounded` says what to do with it.

mod convergence;
mod eliminated;
mod parts;
mod prediction;
mod select;
mod settings;
mod shared;
mod trials;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use abbe_core::{
    Calibration, Context, Error, Estimate, Identifiability, Owner, Parts, PathItem, Problem, Result, SettingsError,
    Unknown, ValuesOf, both,
};
use abbe_estimation::{
    EstimatorSolution, Judgement, RankDeficiency, RowsAtHand, UncertaintyEvaluation, VarianceComponents, Weighted,
    check_preferences, components, confounded, identifiability, in_order_of_preference, is_judged_as_recorded,
    rival_wavelengths, separated, wavelengths,
};
use abbe_numerics::{
    Directions, Factor, LeastSquares, Options, RestrictedProblem, Robust, Solution, solve_by_gradients, solve_from,
};
use serde_json::{Value, json};

use convergence::{converged, ill};
use select::SelectBy;
use settings::{OnConfounded, RobustSetting, Settings, Variance};

abbe_core::register!(
    Estimate,
    "gauss-newton",
    "weighted least squares on all observations at once, robust on request",
    Settings,
    example,
    build,
    "../reference/estimate-gauss-newton.md",
);

/// Robust weights that change by less than this have settled.
const SETTLED: f64 = 1e-4;

/// The same limit for one of thousands of estimates, as in trials.
const NEARLY_SETTLED: f64 = 1e-3;

/// Tolerance of these estimates.
const TRIAL_TOLERANCE: f64 = 1e-6;

fn example() -> Value {
    json!({ "robust": "tukey", "on_confounded": "error" })
}

fn build(settings: Settings, _: &Context) -> Result<Box<dyn Estimate>, SettingsError> {
    if !(settings.rank_tolerance > 0.0 && settings.rank_tolerance < 1.0) {
        return Err(SettingsError::new("rank_tolerance", "a number between 0 and 1 was expected"));
    }
    if !(settings.coverage_probability > 0.0 && settings.coverage_probability < 1.0) {
        return Err(SettingsError::new("coverage_probability", "a number between 0 and 1 was expected"));
    }
    if !(settings.tolerance > 0.0 && settings.tolerance <= 1e-3) {
        return Err(SettingsError::new("tolerance", "a number above 0, at most 0.001, was expected"));
    }
    if let Some(select) = &settings.select {
        select.check().map_err(|error| error.under([PathItem::Key("select".to_owned())]))?;
    }
    if let Some(robust) = settings.robust.as_ref().map(RobustSetting::robust)
        && !(robust.cutoff > 0.0 && robust.outlier_at > 0.0)
    {
        return Err(SettingsError::new("robust", "cutoff and outlier_at have to be positive"));
    }
    if !settings.prefer.is_empty() && settings.on_confounded != OnConfounded::Drop {
        let message = "nothing is dropped, so that nothing can be preferred";
        return Err(SettingsError::new("prefer", message).help("set `on_confounded: drop`, or leave out `prefer`"));
    }
    if settings.variance == Variance::PerStage && settings.trust_uncertainties {
        let message = "stated uncertainties that are trusted leave no factors to estimate";
        return Err(SettingsError::new("variance", message).help("leave out `variance`, or `trust_uncertainties`"));
    }
    Ok(Box::new(GaussNewton { settings }))
}

/// A problem as it is judged before it is solved.
struct Judged {
    /// The problem with better start values, if they make more unknowns have an effect.
    started: Option<Problem>,
    /// What its rows tell.
    judgement: Judgement,
    /// What people should know.
    remarks: Vec<String>,
}

/// What is known of the rows of a problem before it is solved.
enum Known<'a> {
    Nothing,
    /// The factor of rows near the start values, and whether it is theirs.
    Near(&'a Factor, bool),
    /// Its solution from the start values, or why there is none.
    Solution(Box<Result<Solution>>),
}

/// Equations times unknowns of a problem that takes so little time that more threads do not help its evaluation.
const SMALL: usize = 200_000;

/// The estimator.
struct GaussNewton {
    settings: Settings,
}

impl GaussNewton {
    fn robust(&self) -> Option<Robust> {
        self.settings.robust.as_ref().map(RobustSetting::robust)
    }

    /// Refuses problems that no settings can solve.
    fn check(problem: &Problem) -> Result<()> {
        let (equations, unknowns) = (problem.equations(), problem.unknowns.len());
        if equations < unknowns {
            return Err(Error::data(format!(
                "{equations} equations cannot determine {unknowns} unknowns: there are too few touches"
            ))
            .help("measure more, or choose fewer parameters"));
        }
        Ok(())
    }

    fn options(&self, tolerance: f64, near: bool) -> Options {
        let settled = if near { NEARLY_SETTLED } else { SETTLED };
        let (iterations, robust) = (self.settings.iterations.get(), self.robust());
        Options { iterations, tolerance, settled, robust, near, ..Options::USUAL }
    }

    /// The solution from a start, within the directions that are determined, if not all are; along others the unknowns stay where
    /// they start. Fails where the iteration does not converge.
    fn iterate_within(
        &self,
        weighted: &Weighted<'_>,
        start: &[f64],
        determined: Option<&Directions>,
        options: &Options,
    ) -> Result<Solution> {
        let Some(directions) = determined else { return self.iterate(weighted, start, None, options) };
        let within = RestrictedProblem { problem: weighted, origin: start, directions };
        let solution = self.iterate(&within, &vec![0.0; directions.count()], None, options)?;
        Ok(Solution { x: within.place(&solution.x), ..solution })
    }

    /// The solution of rows from a start; fails where the iteration does not converge.
    fn iterate(
        &self,
        weighted: &impl LeastSquares<Error = Error>,
        start: &[f64],
        factor: Option<Factor>,
        options: &Options,
    ) -> Result<Solution> {
        converged(solve_from(weighted, start, factor, options)?, options)
    }

    /// Solves a problem.
    fn solve(
        &self,
        problem: &Problem,
        known: Known<'_>,
        lost: Option<RankDeficiency>,
        explained: bool,
    ) -> Result<Calibration> {
        let determined = lost.as_ref().map(|lost| &lost.determined);
        let components = match self.settings.variance {
            Variance::Common => None,
            Variance::PerStage => Some(self.components(problem, determined)?),
        };
        let scaled =
            components.as_ref().map(|found| problem.with_variance_factors(&found.factors).with_values(&found.x));
        let (problem, known) = match &scaled {
            Some(scaled) => (scaled, Known::Nothing),
            None => (problem, known),
        };
        let weighted = self.weighted(problem)?;
        let options = self.options(self.settings.tolerance, false);
        let (weighted, start) = (&weighted, problem.start());
        let solution = match (determined, known) {
            (Some(_), _) => self.iterate_within(weighted, &start, determined, &options),
            (None, Known::Near(factor, at_start)) if !weighted.is_correlated() => {
                converged(solve_by_gradients(weighted, &start, (factor, at_start), &options)?, &options)
            }
            (None, Known::Near(factor, true)) => self.iterate(weighted, &start, Some(factor.clone()), &options),
            (None, Known::Solution(solution)) => *solution,
            (None, Known::Near(_, false) | Known::Nothing) => self.iterate(weighted, &start, None, &options),
        };
        let Solution { x, iterations, robust, last_step, gradient_cosine, factor, .. } = solution?;
        let solved = EstimatorSolution {
            x,
            factor: Some(factor).filter(|_| robust.is_none() && lost.is_none()),
            robust: robust.zip(self.robust()),
            iterations,
            last_step: Some(last_step),
            gradient_cosine: Some(gradient_cosine),
        };
        self.evaluation(explained).calibration(problem, solved, lost, components.as_ref())
    }

    fn evaluation(&self, explained: bool) -> UncertaintyEvaluation {
        let Settings { rank_tolerance, trust_uncertainties, coverage_probability, .. } = self.settings;
        UncertaintyEvaluation { rank_tolerance, trust_uncertainties, coverage_probability, explained }
    }

    /// The factors on the stated uncertainties of every set.
    fn components(&self, problem: &Problem, determined: Option<&Directions>) -> Result<VarianceComponents> {
        let solve = |problem: &Problem| {
            let options = self.options(self.settings.tolerance, false);
            self.iterate_within(&self.weighted(problem)?, &problem.start(), determined, &options)
        };
        let found = components(problem, determined, solve)?;
        found.warn(problem);
        Ok(found)
    }

    /// The rows of a problem. Robust weights need rows that are independent.
    fn weighted<'a>(&self, problem: &'a Problem) -> Result<Weighted<'a>> {
        let weighted = Weighted::new(problem)?;
        if weighted.is_correlated() && self.settings.robust.is_some() {
            let error = Error::usage("robust weights need rows that are independent, and these are given a covariance");
            return Err(error.help("leave out `robust`, or the covariance under `uncertainty` of the artefacts"));
        }
        Ok(weighted)
    }

    /// The judgement of a problem, the directions that are determined if not all are, and its solution if that is looked for meanwhile: a
    /// small problem is solved while it is judged, where that needs other factors.
    fn judge_and_solve(&self, problem: &Problem) -> Result<(Judged, Option<Directions>, Option<Result<Solution>>)> {
        let is_small = problem.equations() * problem.unknowns.len() <= SMALL;
        if !is_small || self.settings.variance != Variance::Common || is_judged_as_recorded(problem) {
            let judged = self.judge(problem)?;
            let determined = self.determined(judged.judgement.factor());
            return Ok((judged, determined, None));
        }
        let unwanted = Arc::new(AtomicBool::new(false));
        let watched = problem.watched_by(problem.monitor.until(unwanted.clone()));
        let judge = || {
            let judged = self.judge(problem).map(|judged| {
                let determined = self.determined(judged.judgement.factor());
                (judged, determined)
            });
            let is_wanted = matches!(&judged, Ok((Judged { started: None, .. }, None)));
            unwanted.store(!is_wanted, Ordering::Relaxed);
            judged
        };
        let solve = || {
            let options = self.options(self.settings.tolerance, false);
            self.iterate(&self.weighted(&watched)?, &watched.start(), None, &options)
        };
        let (judged, solution) = both(judge, solve);
        let (judged, determined) = judged?;
        let is_wanted = determined.is_none() && judged.started.is_none();
        Ok((judged, determined, is_wanted.then_some(solution)))
    }

    /// The judgement of a problem, and the problem with better start values, if they make more unknowns have an effect.
    ///
    /// A wavelength has no effect as long as the amplitudes that go with it are zero: those come first, without it. It is known by its
    /// nominal value, which is not zero; any other unknown without effect is one that the data do not see.
    fn judge(&self, problem: &Problem) -> Result<Judged> {
        let nominal = &problem.model.info().nominal;
        let shapes = |unknown: &Unknown| unknown.owner == Owner::Machine && nominal[unknown.index] != 0.0;
        let idle = |factor: &Factor| -> Vec<&str> {
            let idle = problem.unknowns.iter().zip(factor.norms()).filter(|(_, norm)| **norm == 0.0);
            idle.filter(|(unknown, _)| shapes(unknown)).map(|(unknown, _)| unknown.name.as_str()).collect()
        };
        let judged = Judgement::new(problem, None)?;
        let first = idle(judged.factor());
        let reduced = problem.without_unknowns(|unknown| first.contains(&unknown.name.as_str()));
        if first.is_empty() || reduced.unknowns.is_empty() {
            return Ok(Judged { started: None, judgement: judged, remarks: Vec::new() });
        }
        let factor =
            judged.factor().without_unknowns(|unknown| first.contains(&problem.unknowns[unknown].name.as_str()));
        let determined = self.determined(&factor);
        let at_start = judged.factor_at_start().map(|_| factor);
        let nominal = match self.roughly(&reduced, at_start, determined.as_ref()) {
            Ok(x) => Problem { unknowns: problem.unknowns.clone(), ..reduced.with_values(&x) },
            Err(error) if error.fatal => return Err(error),
            Err(_) => return Ok(Judged { started: None, judgement: judged, remarks: Vec::new() }),
        };
        let mut remarks = Vec::new();
        let mut found = nominal.clone();
        for unknown in problem.unknowns.iter().filter(|unknown| first.contains(&unknown.name.as_str())) {
            // The sum of squares has many minima: the iteration starts in the lowest.
            let minima = wavelengths(&found, unknown.index)?;
            remarks.extend(rival_wavelengths(unknown, &minima));
            if let Some(best) = minima.into_iter().next() {
                found.machine_values[unknown.index] = best.value;
                best.amplitudes.into_iter().for_each(|(index, value)| found.machine_values[index] = value);
            }
        }
        // A wave that has a position in every period is nothing but a constant: then the nominal one is the better start.
        let mut again = judged.again(&found)?;
        let mut started = found;
        let rank = self.rank(again.factor());
        if rank < problem.unknowns.len() {
            let by_nominal = judged.again(&nominal)?;
            if rank < self.rank(by_nominal.factor()) {
                remarks.clear();
                (started, again) = (nominal, by_nominal);
            }
        }
        let better = idle(again.factor()).len() < first.len();
        let (started, judgement) = if better { (Some(started), again) } else { (None, judged) };
        Ok(Judged { started, judgement, remarks })
    }

    /// The number of directions that some rows determine.
    fn rank(&self, factor: &Factor) -> usize {
        let tolerance = self.settings.rank_tolerance;
        match factor.is_surely_full_rank(tolerance) {
            true => factor.unknowns(),
            false => factor.singular_values().rank(tolerance),
        }
    }

    /// The directions that some rows determine; none if they determine all.
    fn determined(&self, factor: &Factor) -> Option<Directions> {
        let rank = self.rank(factor);
        (rank < factor.unknowns()).then(|| factor.spectrum().determined(rank))
    }

    fn estimate(&self, problem: &Problem, explained: bool) -> Result<Calibration> {
        match &self.settings.select {
            None => self.estimate_all(problem, explained),
            Some(select) if select.by == SelectBy::Prediction => self.estimate_predicted(problem, select, explained),
            Some(select) => self.estimate_selected(problem, select, explained),
        }
    }

    fn estimate_all(&self, problem: &Problem, explained: bool) -> Result<Calibration> {
        if self.settings.on_confounded == OnConfounded::Error {
            Self::check(problem)?;
        }
        if problem.unknowns.is_empty() {
            return self.as_it_is(problem, explained);
        }
        if let Some(rows) = self.eliminating(problem, &RowsAtHand(problem))? {
            return self.of_eliminated(&rows, explained);
        }
        let (Judged { started, judgement: judged, remarks }, determined, solution) = self.judge_and_solve(problem)?;
        if explained {
            remarks.iter().for_each(|remark| tracing::warn!("{}: {remark}", problem.name));
        }
        let (problem, factor) = (started.as_ref().unwrap_or(problem), judged.factor());
        let Some(determined) = determined else {
            let known = match solution {
                Some(solution) => Known::Solution(Box::new(solution)),
                None if !is_judged_as_recorded(problem) => Known::Nothing,
                None => Known::Near(factor, started.is_none() && judged.factor_at_start().is_some()),
            };
            return self
                .solve(problem, known, None, explained)
                .map_err(|error| ill(problem, factor, self.settings.rank_tolerance, error));
        };
        let found = identifiability(problem, factor, self.settings.rank_tolerance);
        let wanted = explained || self.settings.on_confounded == OnConfounded::Error;
        let found = if wanted { separated(problem, found) } else { found };
        let told = |error| ill(problem, factor, self.settings.rank_tolerance, error);
        match self.settings.on_confounded {
            OnConfounded::Error => Err(confounded(&found)),
            // Nothing is left to be estimated.
            _ if found.rank == 0 => Err(confounded(&found)),
            OnConfounded::MinimumNorm => {
                let solve = |problem: &Problem, explained: bool| {
                    let lost = RankDeficiency { found: found.clone(), determined: determined.clone() };
                    self.solve(problem, Known::Nothing, Some(lost), explained).map_err(told)
                };
                let mut calibration = solve(problem, explained)?;
                self.mark_shared((problem, &judged), &found, &mut calibration, explained, |problem| {
                    solve(problem, false)
                })?;
                Ok(calibration)
            }
            OnConfounded::Drop => {
                let order = in_order_of_preference(problem, &self.settings.prefer);
                let dropped = factor.spectrum().dependent(found.rank, &order);
                let names: Vec<&str> = dropped.iter().map(|&index| problem.unknowns[index].name.as_str()).collect();
                if explained {
                    tracing::warn!("{}: left at their start values: {}", problem.name, names.join(", "));
                }
                let solve = |problem: &Problem, explained: bool| {
                    let reduced = problem.without_unknowns(|unknown| names.contains(&unknown.name.as_str()));
                    self.solve(&reduced, Known::Nothing, None, explained).map_err(told)
                };
                let mut calibration = solve(problem, explained)?;
                calibration.fit.unknowns = found.unknowns;
                calibration.fit.null_space.clone_from(&found.null_space);
                calibration.fit.dropped = names.iter().map(|&name| name.to_owned()).collect();
                self.mark_shared((problem, &judged), &found, &mut calibration, explained, |problem| {
                    solve(problem, false)
                })?;
                Ok(calibration)
            }
        }
    }

    /// The machine as it is: nothing is estimated, and residuals are what it was off by.
    fn as_it_is(&self, problem: &Problem, explained: bool) -> Result<Calibration> {
        self.evaluation(explained).calibration(problem, Self::unsolved(), None, None)
    }

    /// The solution of no unknowns.
    fn unsolved() -> EstimatorSolution {
        EstimatorSolution {
            x: Vec::new(),
            factor: None,
            robust: None,
            iterations: 0,
            last_step: None,
            gradient_cosine: None,
        }
    }
}

impl Estimate for GaussNewton {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        self.estimate(problem, false)
    }

    fn explain(&self, problem: &Problem) -> Result<Calibration> {
        self.estimate(problem, true)
    }

    fn accepts_parts(&self) -> Result<()> {
        self.check_settings_for_parts()
    }

    fn accepts_batches(&self) -> Result<()> {
        self.check_settings_for_batches()
    }

    fn estimate_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Calibration> {
        self.of_parts(problem, parts, true)
    }

    fn values_of_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Vec<f64>> {
        self.values_in_parts(problem, parts)
    }

    fn identify_parts(&self, problem: &Problem, parts: &dyn Parts) -> Result<Identifiability> {
        self.identified_parts(problem, parts)
    }

    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        if problem.unknowns.is_empty() {
            return Ok(Vec::new());
        }
        if self.settings.select.is_some() {
            // Other data may select other terms.
            return Ok(problem.values_of(&self.estimate(problem, false)?));
        }
        if self.settings.on_confounded != OnConfounded::Error {
            // What these rows determine may well be less than all.
            return Ok(problem.values_of(&self.estimate_all(problem, false)?));
        }
        if let Some(rows) = self.eliminating(problem, &RowsAtHand(problem))? {
            return Ok(rows.solve(&problem.start(), &self.options(1e-6, true))?.x);
        }
        // Near the solution: what is left after this step is its square.
        let options = self.options(TRIAL_TOLERANCE, true);
        Ok(self.iterate(&self.weighted(problem)?, &problem.start(), None, &options)?.x)
    }

    fn values_near<'a>(&'a self, problem: &Problem) -> Box<ValuesOf<'a>> {
        self.of_trials(problem)
    }

    fn accepts(&self, found: &Identifiability) -> Result<bool> {
        Ok(found.rank == found.unknowns || (found.rank > 0 && self.settings.on_confounded != OnConfounded::Error))
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        check_preferences(problem, &self.settings.prefer)?;
        self.weighted(problem)?;
        if let Some(select) = &self.settings.select {
            select.candidates(problem)?;
        }
        if let Some(rows) = self.eliminating(problem, &RowsAtHand(problem))? {
            return self.evaluation(true).identify_eliminated(&rows);
        }
        let Judged { started, judgement, remarks } = self.judge(problem)?;
        let mut found = self.evaluation(true).identify(started.as_ref().unwrap_or(problem), &judgement)?;
        found.remarks.extend(remarks);
        Ok(found)
    }
}
