//! From the solution of an estimator to a calibration: rank, scatter, uncertainty, advice.

use std::collections::BTreeMap;

use abbe_core::{
    Calibration, EquivalentMotionError, Error, FitReport, Identifiability, Problem, Result, Termination,
    VarianceFactor, both,
};
use abbe_numerics::{Directions, Factor, Robust, RobustReport, counted_scatter_factor};

use crate::as_recorded::told_by_nominal_places;
use crate::calibration::calibration;
use crate::contact::{is_judged_as_recorded, rank_point};
use crate::equivalent_motion_errors::equivalent_motion_errors;
use crate::judgement::Judgement;
use crate::parts::{RowsInParts, SolutionOfParts};
use crate::propagation::{AposterioriFactors, Linearisation, Propagation, RowsOfSets};
use crate::rank::{
    ILL_CONDITIONED, confounded, explained_identifiability, identifiability, ill_conditioned, separated, weakest,
};
use crate::residuals::{Constraints, ResidualStatistics, outliers, radial_rms};
use crate::variance::VarianceComponents;
use crate::weighted::Weighted;

/// Solution that an estimator found by its own iteration.
pub struct EstimatorSolution {
    /// The values of the unknowns.
    pub x: Vec<f64>,
    /// The factor of all rows at x, each with weight 1, if the iteration has it.
    pub factor: Option<Factor>,
    /// Robust weights, and the loss that they follow from.
    pub robust: Option<(RobustReport, Robust)>,
    /// Number of iterations.
    pub iterations: usize,
    /// Size of the last step, in standard uncertainties of all rows together; none where nothing was iterated.
    pub last_step: Option<f64>,
    /// Largest cosine of the angle between the weighted residuals and a column of the derivatives.
    pub gradient_cosine: Option<f64>,
}

/// What the data cannot determine of a problem that was solved in spite of it.
pub struct RankDeficiency {
    /// The lost directions, with names.
    pub found: Identifiability,
    /// The directions that were estimated; along others the unknowns stay where they started.
    pub determined: Directions,
}

/// What is asked of a calibration; the same for all estimators.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UncertaintyEvaluation {
    /// Singular values below this part of the largest count as zero; columns have norm 1.
    pub rank_tolerance: f64,
    /// Take the stated standard uncertainties as they are, without the a-posteriori factor of the residuals.
    pub trust_uncertainties: bool,
    /// Probability that expanded uncertainties cover.
    pub coverage_probability: f64,
    /// Adds budgets, weak combinations, and motion errors with the same effect on the tip ([`equivalent_motion_errors`]).
    pub explained: bool,
}

/// The error where the rows that robust weights keep do not determine what all rows do.
fn left_out(problem: &Problem, kept: &[f64], error: &Error) -> Error {
    let mut of_set: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    for ((set, _), weight) in problem.equation_rows().into_iter().zip(kept) {
        let (out, all) = of_set.entry(problem.sets[set].name.clone()).or_default();
        *out += usize::from(*weight == 0.0);
        *all += 1;
    }
    sets_left_out(&of_set, error)
}

/// The same by how many equations of each artefact stage are left out, and how many there are.
fn sets_left_out(of_set: &BTreeMap<String, (usize, usize)>, error: &Error) -> Error {
    let sets = of_set.iter().filter(|(_, (out, _))| *out > 0);
    let named = sets.map(|(set, (out, all))| format!("{out} of {all} equations of {set}"));
    let named: Vec<String> = named.collect();
    if named.is_empty() {
        return error.clone();
    }
    let message = format!("robust weights leave out {}; of what is left {}", named.join(" and "), error.message);
    Error::data(message).help(
        "the stated uncertainties may be far too small, or a sign or a unit may be wrong: without `robust` the run says more",
    )
}

/// What a report tells beside rank and scatter.
pub(crate) struct Told {
    pub radial_rms: Option<f64>,
    pub equivalent_motion_errors: Vec<EquivalentMotionError>,
    pub variance: Vec<VarianceFactor>,
    pub remarks: Vec<String>,
}

impl UncertaintyEvaluation {
    /// Makes the calibration from a solution.
    ///
    /// `lost` is the identifiability at the start if the estimator solved although directions are lost. Without it, a lost
    /// direction at the solution is an error. With `components`, the uncertainties of the problem already contain their
    /// factors. Fails if the scatter is to be estimated from the residuals and no degrees of freedom are left.
    pub fn calibration(
        &self,
        problem: &Problem,
        solved: EstimatorSolution,
        lost: Option<RankDeficiency>,
        components: Option<&VarianceComponents>,
    ) -> Result<Calibration> {
        let EstimatorSolution { x, factor, robust, iterations, last_step, gradient_cosine } = solved;
        let (report, loss) = robust.unzip();
        let judged = rank_point(problem, &x)?;
        // Rows with weight zero give no information. Rows with a reduced weight still do.
        let kept: Option<Vec<f64>> =
            (report.as_ref()).map(|report| report.weights.iter().map(|weight| f64::from(*weight > 0.0)).collect());
        let kept = kept.as_deref();
        let of_sets = if self.explained { RowsOfSets::new(&judged, &x, kept)? } else { None };
        let is_recorded = is_judged_as_recorded(problem);
        let (factor, recorded) = match (&of_sets, factor) {
            (Some(of_sets), recorded) => (of_sets.without_considered(problem), recorded),
            (None, Some(factor)) if is_recorded && kept.is_none() => (factor, None),
            (None, recorded) => (Weighted::new(&judged)?.factor(&x, kept)?, recorded),
        };
        let rank = lost.as_ref().map_or(problem.unknowns.len(), |lost| lost.determined.count());
        let root_of = |factor: &Factor| match &lost {
            Some(lost) => lost.determined.covariance_root(factor),
            None => factor.covariance_root(rank),
        };
        let of_rows = || -> Result<_> {
            let (weighted, root, residuals) = (Weighted::new(problem)?, root_of(&factor), problem.residuals(&x)?);
            let mut remarks = Vec::new();
            if self.explained && !is_recorded {
                let recorded = recorded.clone().map_or_else(|| weighted.factor(&x, kept), Ok)?;
                remarks.extend(told_by_nominal_places(problem, &root, &root_of(&recorded)));
            }
            let in_uncertainties = weighted.in_uncertainties(residuals.clone());
            let constraints = Constraints::new(&judged, &x, &root)?;
            let counted = (rank, &constraints);
            let quantities = problem.quantities();
            let statistics =
                ResidualStatistics::new(&residuals, &quantities, &in_uncertainties, report.as_ref(), counted);
            let scales = self.scales(&statistics, components);
            let propagation = match &of_sets {
                Some(rows) => Propagation::of_factors(problem, &root, (&rows.of_sets, &rows.extended), scales),
                None => {
                    let place = Linearisation { problem: &judged, x: &x, kept, root };
                    Propagation::new(&place, scales, self.explained)?
                }
            };
            Ok((residuals, statistics, propagation, remarks))
        };
        let (found, of_rows) = both(|| self.determined(problem, &factor, lost.as_ref(), kept), of_rows);
        let found = found?;
        let (residuals, statistics, propagation, remarks) = of_rows?;
        self.check_redundancy(&statistics, rank, &propagation)?;
        let outliers = match (&report, loss) {
            (Some(report), Some(loss)) => outliers(problem, &residuals, report, loss),
            _ => Vec::new(),
        };
        let is_used = |equation| report.as_ref().is_none_or(|report| report.weights[equation] > 0.0);
        let told = Told {
            radial_rms: radial_rms(problem, &residuals, is_used),
            equivalent_motion_errors: if self.explained { equivalent_motion_errors(problem)? } else { Vec::new() },
            variance: components.map_or_else(Vec::new, |found| found.named(problem)),
            remarks,
        };
        let fit = self.report(problem, found, &statistics, (iterations, last_step, gradient_cosine), told);
        let mut calibration = calibration(problem, &x, propagation.covariance(problem), outliers, fit);
        calibration.uncertainty = self.explained.then(|| propagation.budget(problem, self.coverage_probability));
        Ok(calibration)
    }

    /// What the rows determine at the solution, those that are kept.
    ///
    /// Fails where they determine less than was estimated.
    fn determined(
        &self,
        problem: &Problem,
        factor: &Factor,
        lost: Option<&RankDeficiency>,
        kept: Option<&[f64]>,
    ) -> Result<Identifiability> {
        let refused = |error: Error| Err(kept.map_or_else(|| error.clone(), |kept| left_out(problem, kept, &error)));
        let Some(RankDeficiency { found, determined }) = lost else {
            let rank = problem.unknowns.len();
            let mut found = self.identifiability(problem, factor);
            if let Some(kept) = kept.filter(|kept| found.rank == rank && kept.contains(&0.0)) {
                let judged = Judgement::new(problem, Some(kept))?;
                let without = identifiability(problem, judged.factor(), self.rank_tolerance);
                found = if without.rank < rank { without } else { found };
            }
            return if found.rank < rank { refused(confounded(&separated(problem, found))) } else { Ok(found) };
        };
        // Rows that weigh nothing may have told more.
        let rank = determined.count();
        if determined.factor(factor).singular_values().rank(self.rank_tolerance) < rank {
            return refused(confounded(found));
        }
        let condition = factor.singular_values().condition(rank);
        let weakest = if self.explained { weakest(problem, &factor.spectrum(), found.rank) } else { Vec::new() };
        Ok(Identifiability { observations: factor.rows(), condition, weakest, ..found.clone() })
    }

    /// Makes the calibration from a solution of rows in parts, and from what they tell there. With `components`, the uncertainties of the
    /// rows already contain their factors. Parts tell no motion errors with the same effect on the tip.
    ///
    /// Fails for a direction that is lost at the solution, and where no degrees of
    /// freedom are left, as for rows at once.
    pub fn calibration_of_parts(
        &self,
        rows: &RowsInParts<'_>,
        solved: EstimatorSolution,
        told: SolutionOfParts,
        components: Option<&VarianceComponents>,
    ) -> Result<Calibration> {
        let EstimatorSolution { x, iterations, last_step, gradient_cosine, .. } = solved;
        let problem = rows.problem();
        let SolutionOfParts { of_sets, extended, residuals, kept } = told;
        let own = |factor: &Factor| factor.without_unknowns(|column| column >= problem.unknowns.len());
        let (factor, of_sets) = (own(&extended), of_sets.iter().map(own).collect::<Vec<Factor>>());
        let mut found = self.identifiability(problem, &factor);
        let left_out = kept.as_ref().filter(|kept| kept.sums.left_out.values().any(|(out, _)| *out > 0));
        if let Some(kept) = left_out.filter(|_| found.rank == problem.unknowns.len()) {
            let without = identifiability(problem, &kept.nominal, self.rank_tolerance);
            if without.rank < found.rank {
                found = without;
            }
        }
        let rank = found.rank;
        if rank < problem.unknowns.len() {
            let error = confounded(&found);
            return Err(left_out.map_or_else(|| error.clone(), |kept| sets_left_out(&kept.sums.left_out, &error)));
        }
        let mut statistics = ResidualStatistics::from((&residuals, rank));
        let is_weighed = kept.is_some();
        let sums = kept.map(|kept| kept.sums).unwrap_or_default();
        if is_weighed {
            statistics.sigma *= counted_scatter_factor(&sums.used_slopes.counted(), rank as f64);
        }
        if sums.found > sums.outliers.len() {
            let (listed, all) = (sums.outliers.len(), sums.found);
            tracing::warn!(
                "{}: there are {all} outliers; the {listed} with the largest residuals are listed",
                problem.name
            );
        }
        let scales = self.scales(&statistics, components);
        let propagation =
            Propagation::of_factors(problem, &factor.covariance_root(rank), (&of_sets, &extended), scales);
        self.check_redundancy(&statistics, rank, &propagation)?;
        let told = Told {
            radial_rms: residuals.radial_rms(),
            equivalent_motion_errors: Vec::new(),
            variance: components.map_or_else(Vec::new, |found| found.named(problem)),
            remarks: Vec::new(),
        };
        let fit = self.report(problem, found, &statistics, (iterations, last_step, gradient_cosine), told);
        let mut calibration = calibration(problem, &x, propagation.covariance(problem), sums.outliers, fit);
        calibration.uncertainty = self.explained.then(|| propagation.budget(problem, self.coverage_probability));
        Ok(calibration)
    }

    /// Fails if the scatter of the residuals is needed, and says nothing.
    pub(crate) fn check_redundancy(
        &self,
        statistics: &ResidualStatistics,
        rank: usize,
        propagation: &Propagation,
    ) -> Result<()> {
        // A repeated estimate without some rows needs only values and predictions. It may leave no degrees of freedom.
        let told = self.explained && !self.trust_uncertainties;
        if statistics.redundancy > 0.0 || !told || !propagation.is_scaled() {
            return Ok(());
        }
        Err(Error::data(format!(
            "the data leave no degrees of freedom ({} equations for {rank} unknowns): the scatter of the residuals says nothing",
            statistics.used
        ))
        .help("set `trust_uncertainties: true` to take the stated uncertainties, or measure more")
        .setting("trust_uncertainties"))
    }

    /// What the data determine, with the weakest combinations where these are told.
    fn identifiability(&self, problem: &Problem, factor: &Factor) -> Identifiability {
        match self.explained {
            true => explained_identifiability(problem, factor, self.rank_tolerance),
            false => identifiability(problem, factor, self.rank_tolerance),
        }
    }

    /// The report of a fit.
    pub(crate) fn report(
        &self,
        problem: &Problem,
        found: Identifiability,
        statistics: &ResidualStatistics,
        (iterations, last_step, gradient_cosine): (usize, Option<f64>, Option<f64>),
        told: Told,
    ) -> FitReport {
        let angles = Some(&statistics.angles).filter(|angles| angles.count > 0);
        FitReport {
            observations: statistics.used,
            unknowns: problem.unknowns.len(),
            rank: found.rank,
            condition: found.condition,
            degrees_of_freedom: statistics.degrees_of_freedom,
            sigma: statistics.sigma,
            iterations,
            termination: Termination::Converged,
            last_step,
            gradient_cosine,
            residual_max_um: statistics.lengths.max * 1e3,
            residual_mean_abs_um: statistics.lengths.mean_abs * 1e3,
            residual_rms_um: statistics.lengths.rms * 1e3,
            residual_radial_rms_um: told.radial_rms.map(|rms| rms * 1e3),
            residual_max_urad: angles.map(|angles| angles.max * 1e6),
            residual_mean_abs_urad: angles.map(|angles| angles.mean_abs * 1e6),
            residual_rms_urad: angles.map(|angles| angles.rms * 1e6),
            rank_tolerance: Some(self.rank_tolerance),
            null_space: found.null_space,
            dropped: Vec::new(),
            weakest: found.weakest,
            selection: None,
            selection_by_prediction: None,
            ordinary_covariance: None,
            implausible: Vec::new(),
            eliminated: 0,
            equivalent_motion_errors: told.equivalent_motion_errors,
            variance: told.variance,
            agreement: None,
            statuses: BTreeMap::new(),
            known_degrees_of_freedom: BTreeMap::new(),
            remarks: told.remarks,
        }
    }

    /// What the data determine of a problem, before anything is solved.
    ///
    /// With the uncertainties that follow from what is stated, if all unknowns are determined.
    pub fn identify(&self, problem: &Problem, judged: &Judgement) -> Result<Identifiability> {
        let factor = judged.factor();
        let mut found = separated(problem, explained_identifiability(problem, factor, self.rank_tolerance));
        found.equivalent_motion_errors = equivalent_motion_errors(problem)?;
        found.remarks.extend(ill_conditioned(problem, factor, self.rank_tolerance, ILL_CONDITIONED));
        if found.rank == found.unknowns {
            let (problem, root) = (judged.problem(), factor.covariance_root(found.rank));
            let (start, scales) = (problem.start(), AposterioriFactors::Common(1.0, f64::INFINITY));
            let propagation = match RowsOfSets::new(problem, &start, None)? {
                Some(rows) => Propagation::of_factors(problem, &root, (&rows.of_sets, &rows.extended), scales),
                None => Propagation::new(&Linearisation { problem, x: &start, kept: None, root }, scales, true)?,
            };
            if found.observations <= found.rank && !self.trust_uncertainties && propagation.is_scaled() {
                found.remarks.push(
                    "no degrees of freedom are left, so that the scatter of the residuals will say nothing: set \
                     `trust_uncertainties: true`, or measure more"
                        .to_owned(),
                );
            }
            found.uncertainty = Some(propagation.budget(problem, self.coverage_probability));
        }
        Ok(found)
    }

    /// The same of rows in parts, whose budget is that of the rows as they were recorded. Parts tell no motion errors with the same effect
    /// on the tip, and nothing of what would tell lost directions apart.
    pub fn identify_parts(&self, rows: &RowsInParts<'_>) -> Result<Identifiability> {
        let (problem, factor) = (rows.problem(), rows.at_nominal_geometry()?);
        let mut found = identifiability(problem, &factor, self.rank_tolerance);
        found.weakest = weakest(problem, &factor.spectrum(), found.rank);
        found.remarks.extend(ill_conditioned(problem, &factor, self.rank_tolerance, ILL_CONDITIONED));
        if found.rank == found.unknowns {
            let SolutionOfParts { of_sets, extended, .. } = rows.at_solution(&problem.start(), None)?;
            let own = |factor: &Factor| factor.without_unknowns(|column| column >= problem.unknowns.len());
            let of_sets: Vec<Factor> = of_sets.iter().map(own).collect();
            let (root, scale) = (factor.covariance_root(found.rank), AposterioriFactors::Common(1.0, f64::INFINITY));
            let propagation = Propagation::of_factors(problem, &root, (&of_sets, &extended), scale);
            found.uncertainty = Some(propagation.budget(problem, self.coverage_probability));
        }
        Ok(found)
    }

    /// The a-posteriori factors on stated uncertainties, and their degrees of freedom.
    pub(crate) fn scales(
        &self,
        statistics: &ResidualStatistics,
        components: Option<&VarianceComponents>,
    ) -> AposterioriFactors {
        match components {
            Some(found) => AposterioriFactors::PerSet(
                found.factors.iter().copied().zip(found.degrees_of_freedom.iter().copied()).collect(),
            ),
            None if self.trust_uncertainties || statistics.redundancy == 0.0 => {
                AposterioriFactors::Common(1.0, f64::INFINITY)
            }
            None => AposterioriFactors::Common(statistics.sigma, statistics.redundancy),
        }
    }
}
