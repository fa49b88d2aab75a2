//! Estimator plugin `gauss-newton`: weighted least squares on all observations at once, robust on request.
//!
//! Every equation counts with 1/u of its standard uncertainty. What the data can determine is judged at the contact points
//! of the start values, before anything is solved, and again at the solution; a direction that they cannot determine is an
//! error, unless `on_confounded` says what to do with it.

mod select;

use abbe_core::{
    Calibration, Context, Convergence, Error, Estimate, Identifiability, Owner, PathItem, Problem, Result,
    SettingsError, Status, Termination, Unknown,
};
use abbe_estimation::{
    Components, Solved, UncertaintyEvaluation, Weighted, components, confounded, identifiability,
    is_judged_as_recorded, judged_factor, separated,
};
use abbe_numerics::{End, Factor, Loss, Options, Robust, Solution, solve_from};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use select::{Select, reduced};

abbe_core::register!(
    Estimate,
    "gauss-newton",
    "weighted least squares on all observations at once, robust on request",
    Settings,
    example,
    build,
    "../reference/estimate-gauss-newton.md",
);

/// Settings of the estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// What to do when the data cannot separate the chosen parameters.
    #[serde(default)]
    on_confounded: OnConfounded,
    /// Singular values below this part of the largest count as zero; columns have norm 1.
    #[serde(default = "default_tolerance")]
    rank_tolerance: f64,
    /// Parameters that are left out where chance alone explains them.
    #[serde(default)]
    select: Option<Select>,
    /// Weights that keep gross errors from the estimate.
    #[serde(default)]
    robust: Option<RobustSetting>,
    /// Take the stated standard uncertainties as they are, without the a-posteriori factor of the residuals.
    #[serde(default)]
    trust_uncertainties: bool,
    /// Whether all readings scatter by one factor more than stated, or those of every artefact by their own.
    #[serde(default)]
    variance: Variance,
    /// Probability that expanded uncertainties cover.
    #[serde(default = "default_probability")]
    coverage_probability: f64,
    /// Most iterations.
    #[serde(default = "default_iterations")]
    iterations: usize,
    /// What the estimate may be off by when the iteration ends, in standard uncertainties of all rows together.
    #[serde(default = "default_convergence")]
    tolerance: f64,
}

/// Robust weights that change by less than this have settled.
const SETTLED: f64 = 1e-4;

/// The same for an estimate that is one of thousands.
const NEARLY_SETTLED: f64 = 1e-3;

fn default_convergence() -> f64 {
    1e-9
}

fn default_probability() -> f64 {
    0.95
}

fn default_tolerance() -> f64 {
    // Contact is solved to 1e-11 mm in 1e2 mm: what is lost shows at 1e-14, the weakest that one can use at 1e-7.
    1e-10
}

fn default_iterations() -> usize {
    200
}

/// What to do with confounded parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum OnConfounded {
    /// Stop and name them.
    #[default]
    Error,
    /// Leave as many at their start values as are lost, and mark them.
    Drop,
    /// Take the solution with the smallest effect of the unknowns, and mark those that take part.
    MinimumNorm,
}

/// How readings scatter compared with what was stated of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Variance {
    /// All by one factor.
    #[default]
    Common,
    /// Those of every artefact stage by a factor of their own, which weighs them, too.
    PerStage,
}

/// Robust weights: the name of a loss, or a loss with its tuning.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
enum RobustSetting {
    /// A loss with 95 % efficiency on normal noise.
    Name(LossName),
    /// A loss with its tuning.
    Tuned(Tuned),
}

/// A loss with its tuning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Tuned {
    /// The loss.
    loss: LossName,
    /// Cutoff in units of the residuals' scale.
    #[serde(default)]
    cutoff: Option<f64>,
    /// Studentised residual from which a row is listed as an outlier.
    #[serde(default)]
    outlier_at: Option<f64>,
}

/// The losses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum LossName {
    /// Large residuals keep a bounded influence.
    Huber,
    /// Large residuals have none.
    Tukey,
}

impl<'de> Deserialize<'de> for RobustSetting {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // Told apart here, because an untagged enum could not say what is wrong in either form.
        match Value::deserialize(deserializer)? {
            map @ Value::Object(_) => abbe_core::from_settings(&map).map(Self::Tuned),
            other => abbe_core::from_settings(&other).map(Self::Name),
        }
        .map_err(serde::de::Error::custom)
    }
}

impl RobustSetting {
    fn robust(&self) -> Robust {
        let (loss, cutoff, outlier_at) = match self {
            Self::Name(loss) => (*loss, None, None),
            Self::Tuned(tuned) => (tuned.loss, tuned.cutoff, tuned.outlier_at),
        };
        let usual = match loss {
            LossName::Huber => Robust::HUBER,
            LossName::Tukey => Robust::TUKEY,
        };
        Robust {
            loss: if loss == LossName::Huber { Loss::Huber } else { Loss::Tukey },
            cutoff: cutoff.unwrap_or(usual.cutoff),
            outlier_at: outlier_at.unwrap_or(usual.outlier_at),
        }
    }
}

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
    if settings.iterations == 0 {
        return Err(SettingsError::new("iterations", "at least one iteration is needed"));
    }
    if let Some(select) = &settings.select {
        select.check().map_err(|error| error.under([PathItem::Key("select".to_owned())]))?;
    }
    if let Some(robust) = settings.robust.as_ref().map(RobustSetting::robust)
        && !(robust.cutoff > 0.0 && robust.outlier_at > 0.0)
    {
        return Err(SettingsError::new("robust", "cutoff and outlier_at have to be positive"));
    }
    if settings.variance == Variance::PerStage && settings.trust_uncertainties {
        let message = "stated uncertainties that are trusted leave no factors to estimate";
        return Err(SettingsError::new("variance", message).help("leave out `variance`, or `trust_uncertainties`"));
    }
    Ok(Box::new(GaussNewton { settings }))
}

/// The estimator.
struct GaussNewton {
    settings: Settings,
}

impl GaussNewton {
    fn robust(&self) -> Option<Robust> {
        self.settings.robust.as_ref().map(RobustSetting::robust)
    }

    /// Refuses what cannot be solved at all.
    fn check(problem: &Problem) -> Result<()> {
        let (equations, unknowns) = (problem.equations(), problem.unknowns.len());
        if unknowns == 0 {
            return Err(Error::usage("there is nothing to estimate").setting("parameters"));
        }
        if equations < unknowns {
            return Err(Error::data(format!(
                "{equations} equations cannot determine {unknowns} unknowns: there are too few touches"
            ))
            .help("measure more, or choose fewer parameters"));
        }
        Ok(())
    }

    fn options(&self, rank: usize, tolerance: f64, near: bool) -> Options {
        let settled = if near { NEARLY_SETTLED } else { SETTLED };
        let (iterations, robust) = (self.settings.iterations, self.robust());
        Options { iterations, tolerance, settled, robust, near, ..Options::new(rank) }
    }

    /// The values of the unknowns; fails where the iteration does not converge.
    fn iterate(
        &self,
        weighted: &Weighted<'_>,
        start: &[f64],
        factor: Option<Factor>,
        options: &Options,
    ) -> Result<Solution> {
        let solution = solve_from(weighted, start, factor, options)?;
        let (termination, failed) = match solution.end {
            End::Converged => return Ok(solution),
            End::NoProgress => (Termination::NoProgress, "no step makes the residuals smaller".to_owned()),
            End::IterationLimit => (
                Termination::IterationLimit,
                format!("it still moves at the limit of {} iterations", options.iterations),
            ),
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
        let error = Error::data(format!("the iteration does not converge: {failed}{far}")).help(
            "check units, signs and features of the data, choose fewer parameters, `start` from a calibration, or allow more `iterations`",
        );
        Err(error.convergence(convergence))
    }

    /// Solves a problem; `at_start` is its factor at the contact points of the start values.
    fn solve(
        &self,
        problem: &Problem,
        at_start: Option<&Factor>,
        lost: Option<Identifiability>,
        explained: bool,
    ) -> Result<Calibration> {
        let rank = lost.as_ref().map_or(problem.unknowns.len(), |lost| lost.rank);
        let components = match self.settings.variance {
            Variance::Common => None,
            Variance::PerStage => Some(self.components(problem, rank)?),
        };
        let scaled = components.as_ref().map(|found| problem.with_variance_factors(&found.factors).at(&found.x));
        let (problem, at_start) = scaled.as_ref().map_or((problem, at_start), |scaled| (scaled, None));
        let at_start = at_start.filter(|_| is_judged_as_recorded(problem)).cloned();
        let weighted = self.weighted(problem)?;
        let options = self.options(rank, self.settings.tolerance, false);
        let Solution { x, iterations, robust, last_step, gradient_cosine, factor, .. } =
            self.iterate(&weighted, &problem.start(), at_start, &options)?;
        let solved = Solved {
            x,
            factor: Some(factor).filter(|_| robust.is_none()),
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
    fn components(&self, problem: &Problem, rank: usize) -> Result<Components> {
        let solve = |problem: &Problem| {
            let options = self.options(rank, self.settings.tolerance, false);
            self.iterate(&self.weighted(problem)?, &problem.start(), None, &options)
        };
        let found = components(problem, (rank, self.robust()), solve)?;
        found.warn(problem);
        Ok(found)
    }

    /// The rows of a problem; robust weights need rows that stand for themselves.
    fn weighted<'a>(&self, problem: &'a Problem) -> Result<Weighted<'a>> {
        let weighted = Weighted::new(problem)?;
        if weighted.is_correlated() && self.settings.robust.is_some() {
            let error = Error::usage("robust weights need rows that are independent, and these are given a covariance");
            return Err(error.help("leave out `robust`, or the covariance under `uncertainty` of the artefacts"));
        }
        Ok(weighted)
    }

    /// The problem with start values from which more unknowns have an effect than from its own, with its factor; None if
    /// there are none.
    ///
    /// A wavelength has no effect as long as the amplitudes that go with it are zero: those come first, without it. It is known by its
    /// nominal value, which is not zero; any other unknown without effect is one that the data do not see.
    fn started(&self, problem: &Problem, factor: &Factor) -> Result<Option<(Problem, Factor)>> {
        let nominal = &problem.model.info().nominal;
        let idle = |factor: &Factor| -> Vec<String> {
            let shapes = |unknown: &Unknown| unknown.owner == Owner::Machine && nominal[unknown.index] != 0.0;
            let idle = problem.unknowns.iter().zip(factor.norms()).filter(|(_, norm)| **norm == 0.0);
            idle.filter(|(unknown, _)| shapes(unknown)).map(|(unknown, _)| unknown.name.clone()).collect()
        };
        let first = idle(factor);
        let reduced = problem.without(|unknown| first.contains(&unknown.name));
        if first.is_empty() || reduced.unknowns.is_empty() {
            return Ok(None);
        }
        let of_reduced = factor.without(|unknown| first.contains(&problem.unknowns[unknown].name));
        let rank = match of_reduced.is_surely_full_rank(self.settings.rank_tolerance) {
            true => reduced.unknowns.len(),
            false => of_reduced.singular_values().rank(self.settings.rank_tolerance),
        };
        let options = self.options(rank, 1e-3, false);
        let at_start = Some(of_reduced).filter(|_| is_judged_as_recorded(&reduced));
        let solution = match self.iterate(&self.weighted(&reduced)?, &reduced.start(), at_start, &options) {
            Ok(solution) => solution,
            Err(error) if error.fault => return Err(error),
            Err(_) => return Ok(None),
        };
        let started = Problem { unknowns: problem.unknowns.clone(), ..reduced.at(&solution.x) };
        let factor = judged_factor(&started, &started.start())?;
        Ok((idle(&factor).len() < first.len()).then_some((started, factor)))
    }

    fn estimate(&self, problem: &Problem, explained: bool) -> Result<Calibration> {
        match &self.settings.select {
            None => self.estimate_all(problem, explained),
            Some(select) => self.estimate_selected(problem, select, explained),
        }
    }

    /// The estimate of all unknowns, and from there that of those which are significant.
    fn estimate_selected(&self, problem: &Problem, select: &Select, explained: bool) -> Result<Calibration> {
        let candidates = select.candidates(problem)?;
        let all = self.estimate_all(problem, false)?;
        let x = problem.values_of(&all);
        let weighted = self.weighted(problem)?;
        let weights = match self.settings.robust {
            Some(_) => self.iterate(&weighted, &x, None, &self.options(x.len(), 1e-6, true))?.robust,
            None => None,
        };
        let factor = weighted.factor(&x, weights.as_ref().map(|report| report.weights.as_slice()))?;
        let selection = select.select(problem, &candidates, (&factor, &x), all.fit.degrees_of_freedom)?;
        let mut calibration = self.estimate_all(&reduced(&problem.at(&x), &selection), explained)?;
        calibration.fit.selection = Some(selection);
        Ok(calibration)
    }

    fn estimate_all(&self, problem: &Problem, explained: bool) -> Result<Calibration> {
        Self::check(problem)?;
        let factor = judged_factor(problem, &problem.start())?;
        let started = self.started(problem, &factor)?;
        let (problem, factor) = started.as_ref().map_or((problem, &factor), |(problem, factor)| (problem, factor));
        if factor.is_surely_full_rank(self.settings.rank_tolerance) {
            return self.solve(problem, Some(factor), None, explained);
        }
        let found = identifiability(problem, factor, self.settings.rank_tolerance);
        if found.rank == found.unknowns {
            return self.solve(problem, Some(factor), None, explained);
        }
        let wanted = explained || self.settings.on_confounded == OnConfounded::Error;
        let found = if wanted { separated(problem, &problem.start(), found) } else { found };
        match self.settings.on_confounded {
            OnConfounded::Error => Err(confounded(&found)),
            OnConfounded::MinimumNorm => self.solve(problem, Some(factor), Some(found), explained),
            OnConfounded::Drop => {
                let dropped = factor.spectrum().dependent(found.rank);
                let names: Vec<&str> = dropped.iter().map(|&index| problem.unknowns[index].name.as_str()).collect();
                tracing::warn!("{}: left at their start values: {}", problem.name, names.join(", "));
                let reduced = problem.without(|unknown| names.contains(&unknown.name.as_str()));
                let mut calibration = self.solve(&reduced, None, None, explained)?;
                // Parameters that share a lost direction have a value only as long as those left out have theirs.
                let parts = found.null_space.iter().flat_map(|vector| &vector.combination);
                let shared: Vec<&str> = parts.map(|part| part.name.as_str()).collect();
                for estimated in calibration.parameters.iter_mut().chain(&mut calibration.artefacts) {
                    if shared.contains(&estimated.name.as_str()) || names.contains(&estimated.name.as_str()) {
                        estimated.status = Status::Confounded;
                    }
                }
                calibration.fit.unknowns = found.unknowns;
                calibration.fit.null_space = found.null_space;
                Ok(calibration)
            }
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

    fn values(&self, problem: &Problem) -> Result<Vec<f64>> {
        if self.settings.select.is_some() {
            // Other data may well select others.
            return Ok(problem.values_of(&self.estimate(problem, false)?));
        }
        // Near the solution: what is left after this step is its square.
        let options = self.options(problem.unknowns.len(), 1e-6, true);
        Ok(self.iterate(&self.weighted(problem)?, &problem.start(), None, &options)?.x)
    }

    fn accepts(&self, found: &Identifiability) -> Result<bool> {
        Ok(found.rank == found.unknowns || self.settings.on_confounded != OnConfounded::Error)
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        let factor = judged_factor(problem, &problem.start())?;
        let started = self.started(problem, &factor)?;
        let (problem, factor) = started.as_ref().map_or((problem, &factor), |(problem, factor)| (problem, factor));
        self.evaluation(true).identify(problem, factor)
    }
}
