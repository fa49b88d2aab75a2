//! A rehearsal: validators and exporters are asked before anything is estimated, so that a setting that names something which is
//! not there does not cost a long run.
//!
//! They get estimates of the nominal machine with the uncertainties that are to be expected, and an estimator that solves nothing.
//! What they find means nothing and is forgotten; what they refuse because of a setting stands. A check also makes the estimates of
//! readings that need no iteration, so that what is said of them is what a run says.

use std::collections::BTreeMap;
use std::sync::Arc;

use abbe_core::{
    Calibration, Class, Dataset, Error, Estimate, EstimateSource, Fit, FitReport, Identifiability, Kind, Owner, Parts,
    Problem, Result, UncertaintyBudget, Unknown,
};
use abbe_estimation::{MOST_AT_ONCE, calibration};
use abbe_recipe::Stage;

use crate::batches::InBatches;
use crate::groups::{GroupProblem, is_of};
use crate::prediction::{Predicted, prediction_fit};
use crate::prepare::Prepared;
use crate::readings::has_readings;
use crate::run::{Datasets, has_rows, named};
use crate::saved::fit_without_rows;
use crate::travel::in_travel;

/// An estimator that solves nothing.
struct Unsolved {
    /// The uncertainties that are to be expected, if they are known.
    budget: Option<UncertaintyBudget>,
}

impl Unsolved {
    /// The estimate that is to be expected: start values, and the uncertainties that were told, or none.
    fn expected(&self, problem: &Problem) -> Calibration {
        let budget = self.budget.as_ref();
        // Own unknowns of so many have no covariance.
        let is_eliminated = |unknown: &Unknown| matches!(unknown.owner, Owner::Set(_));
        let reduced = (problem.unknowns.len() > MOST_AT_ONCE).then(|| problem.without_unknowns(is_eliminated));
        let problem = reduced.as_ref().unwrap_or(problem);
        let standard_uncertainty = |unknown: &Unknown| {
            let told = budget.and_then(|budget| budget.parameters.iter().find(|other| other.name == unknown.name));
            told.map_or(0.0, |told| told.standard_uncertainty)
        };
        let unknowns: Vec<&Unknown> = problem.unknowns.iter().chain(&problem.considered.unknowns).collect();
        let mut covariance = vec![vec![0.0; unknowns.len()]; unknowns.len()];
        for (index, unknown) in unknowns.iter().enumerate() {
            covariance[index][index] = standard_uncertainty(unknown).powi(2);
        }
        let (own, considered) = (problem.unknowns.len(), &problem.considered.covariance);
        for (row, line) in considered.iter().enumerate() {
            covariance[own + row][own..].copy_from_slice(line);
        }
        let equations = problem.equations();
        let fit = FitReport {
            observations: equations,
            degrees_of_freedom: equations.saturating_sub(own),
            ..FitReport::without_rows(own)
        };
        let mut expected = calibration(problem, &problem.start(), covariance, Vec::new(), fit);
        expected.uncertainty = self.budget.clone();
        expected
    }
}

impl Estimate for Unsolved {
    fn estimate(&self, problem: &Problem) -> Result<Calibration> {
        Ok(self.expected(problem))
    }

    fn estimate_parts(&self, problem: &Problem, _: &dyn Parts) -> Result<Calibration> {
        Ok(self.expected(problem))
    }

    fn identify(&self, problem: &Problem) -> Result<Identifiability> {
        Err(Error::data(format!("{} is not solved in a rehearsal", problem.name)))
    }
}

impl Prepared {
    /// Asks validators and exporters for what they would say of the estimates that are to be expected; `found` is what these
    /// determine, as far as that is known. Fails with the first setting that is refused.
    ///
    /// A check (`checks`) also asks plugins of libraries, and stands by what validators say of rows: a run goes on without them.
    pub(crate) fn rehearse(
        &self,
        checks: bool,
        (problems, groups, batches): (&BTreeMap<String, Problem>, &BTreeMap<String, Vec<GroupProblem>>, &InBatches<'_>),
        found: &BTreeMap<String, Identifiability>,
        unseen: &Predicted,
        data: &Datasets,
    ) -> Result<()> {
        let mut fits: Vec<Fit> = Vec::new();
        for stage in self.stages(Kind::Estimate) {
            match groups.get(&stage.name) {
                Some(groups) => fits.extend(groups.iter().map(expected_of_group)),
                None if checks && self.is_made_at_once(stage) => {
                    fits.push(self.of_readings(stage, data, batches)?);
                }
                None => {
                    let problem = problems.get(&stage.name).or_else(|| batches.problem(&stage.name));
                    fits.extend(self.expected(stage, problem, found, &fits)?);
                }
            }
        }
        let is_asked = |stage: &Stage| {
            let mut plugins = self.plugins.iter();
            let plugin = plugins.find(|plugin| plugin.kind == stage.kind && plugin.name == stage.plugin);
            checks || plugin.is_none_or(|plugin| plugin.sha256.is_none())
        };
        let has_all = |stage: &Stage| stage.reference("of").iter().all(|name| fits.iter().any(|fit| is_of(fit, name)));
        for stage in self.stages(Kind::Validate).filter(|stage| has_all(stage) && is_asked(stage)) {
            let of = named(stage.reference("of"), &fits);
            let validator = self.validators[&stage.name].as_ref();
            let other = |fit: &&Fit| {
                let problem = unseen.get(&(stage.name.as_str(), fit.name.as_str()))?;
                Some(prediction_fit(fit, problem, validator))
            };
            let others: Vec<Fit> =
                of.iter().filter_map(other).collect::<Result<_>>().or_else(|error| self.located(stage, Err(error)))?;
            let judged: Vec<&Fit> = if others.is_empty() { of } else { others.iter().collect() };
            // A rehearsal before a run does not read all batches only to forget what is said of them.
            let is_of_parts = validator.accepts_rows_in_parts() && judged.iter().any(|fit| batches.has(&fit.name));
            if !checks && (self.has_passes(stage) || is_of_parts) {
                continue;
            }
            // Rows beyond the travel end a run before it begins.
            if !self.has_passes(stage) {
                let evidence: Vec<_> = stage.reference("from").iter().map(|name| data[name].as_ref()).collect();
                self.located(stage, in_travel(&judged, &evidence))?;
            }
            let plain = batches.without_rows(&judged)?;
            let said = match is_of_parts {
                true => self.said_of_parts(stage, &judged, data, batches).map(drop),
                false => self.refused(stage, &plain.iter().collect::<Vec<_>>(), data, batches),
            };
            let is_known = |name: &String| {
                self.saved.contains_key(name) || self.recipe_stage(name).is_ok_and(|of| self.is_made_at_once(of))
            };
            let said = match stage.reference("of").iter().all(is_known) {
                true if checks => said,
                _ => unless_by_value(said, checks),
            };
            self.located(stage, said)?;
        }
        for stage in self.stages(Kind::Export).filter(|stage| is_asked(stage)) {
            for fit in &batches.without_rows(&named(stage.reference("of"), &fits))? {
                let said = self.exporters[&stage.name].export(&fit.calibration, fit.problem.model.as_ref()).map(drop);
                self.located(stage, unless_by_value(said, false))?;
            }
        }
        Ok(())
    }

    /// Fails where a validator would refuse these fits.
    fn refused(&self, stage: &Stage, fits: &[&Fit], data: &Datasets, batches: &InBatches<'_>) -> Result<()> {
        if self.has_passes(stage) || !stage.reference("exports").is_empty() {
            return self.said_of(stage, fits, data, batches).map(drop);
        }
        let data: Vec<&Dataset> = stage.reference("from").iter().map(|name| data[name].as_ref()).collect();
        self.validators[&stage.name].rehearse(fits, &data)
    }

    /// Whether a check makes this estimate.
    fn is_made_at_once(&self, stage: &Stage) -> bool {
        has_readings(stage) && self.estimators.get(&stage.name).is_some_and(|own| own.estimates_readings_at_once())
    }

    /// The estimate that is to be expected of a stage; none where nothing can be said before.
    fn expected(
        &self,
        stage: &Stage,
        problem: Option<&Problem>,
        found: &BTreeMap<String, Identifiability>,
        fits: &[Fit],
    ) -> Result<Option<Fit>> {
        let Some(problem) = problem else { return Ok(self.of_other(stage, fits)) };
        let estimator = self.estimators[&stage.name].clone();
        if let Some(saved) = self.saved.get(&stage.name) {
            return Ok(fit_without_rows(saved.calibration.clone(), problem.model.clone(), estimator).ok());
        }
        if stage.estimate_source == EstimateSource::Statement {
            // What is stated does not wait for anything.
            let stated = self.located(stage, estimator.explain(problem))?;
            return Ok(fit_without_rows(stated, problem.model.clone(), estimator).ok());
        }
        if !has_rows(&stage) {
            return Ok(None);
        }
        let budget = found.get(&stage.name).and_then(|found| found.uncertainty.clone());
        let estimator = Unsolved { budget };
        let calibration = estimator.expected(problem);
        let (name, problem) = (stage.name.clone(), Arc::new(problem.clone()));
        Ok(Some(Fit { name, problem, estimator: Arc::new(estimator), calibration }))
    }

    /// A new look at another estimate, which is that estimate as far as anybody knows.
    fn of_other(&self, stage: &Stage, fits: &[Fit]) -> Option<Fit> {
        let of = self.own_estimate(&stage.name).ok().filter(|of| of.name != stage.name)?;
        let fit = fits.iter().find(|fit| fit.name == of.name)?;
        let (problem, estimator) = (fit.problem.clone(), fit.estimator.clone());
        let mut calibration = fit.calibration.clone();
        calibration.estimate.clone_from(&stage.name);
        Some(Fit { name: stage.name.clone(), problem, estimator, calibration })
    }
}

/// The estimate that is to be expected of a group.
fn expected_of_group(group: &GroupProblem) -> Fit {
    let estimator = Unsolved { budget: None };
    let mut calibration = estimator.expected(&group.problem);
    calibration.group = Some(group.group.clone());
    let problem = Arc::new(group.problem.clone());
    Fit { name: group.name.clone(), problem, estimator: Arc::new(estimator), calibration }
}

/// What is wrong with a setting stands, and what is wrong with the rows that a setting names if `by_rows` says so; what is wrong with
/// values that nobody has estimated does not, nor does what another process could not do with them.
fn unless_by_value(said: Result<()>, by_rows: bool) -> Result<()> {
    said.or_else(|error: Error| {
        let stands = match error.class {
            Class::Interrupted => true,
            Class::Use => !error.fatal,
            Class::Data => by_rows && !error.fatal && !error.setting.is_empty(),
        };
        if stands { Err(error) } else { Ok(()) }
    })
}
