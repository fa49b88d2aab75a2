//! Checks the laws of all models, artefacts and estimators of a recipe, on data of a virtual machine.

use std::collections::BTreeSet;

use abbe_core::{Class, Kind, ObservationSet, Problem, Result, SetIndex, StatusRole};
use abbe_estimation::laws;
use abbe_simulation::{Noise, Truth, measure};

use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::run::has_rows;
use crate::units::ends;

/// Scale of the largest effect of the errors of the virtual machine on any equation, mm or rad. It is so small that an
/// estimator which linearises only once finds the errors to the nanometre, too.
const SIZE: f64 = 2e-3;

/// Results of the check of the laws.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Laws {
    /// Broken laws, with the stage.
    pub broken: Vec<String>,
    /// What was not checked, with the stage and the reason.
    pub skipped: Vec<String>,
    /// What was checked: stage and plugin.
    pub seen: BTreeSet<(String, String)>,
}

impl Prepared {
    /// Checks whether the models, artefacts and estimators of the recipe's estimates keep the laws
    /// ([`abbe_estimation::laws`]).
    ///
    /// Every estimate is made from simulated measurements of its programme (the rows of the recipe's data) on a machine with
    /// errors of a few micrometres in all unknowns. Fails if a run would fail before its first fit.
    pub fn laws(&self) -> Result<Laws> {
        let data = self.read(&abbe_core::Monitor::default(), None)?;
        let problems = self.problems(&data, &mut Taken::default())?;
        let mut found = Laws::default();
        for stage in self.stages(Kind::Estimate).filter(has_rows) {
            let Some(problem) = problems.get(&stage.name).filter(|problem| !problem.sets.is_empty()) else { continue };
            let machine = self.machine_stage(stage)?;
            if found.seen.insert((machine.name.clone(), machine.plugin.clone())) {
                let broken = laws::check_model_within(problem.model.as_ref(), times(problem));
                found.broken.extend(broken.into_iter().map(|law| format!("{}: {law}", machine.name)));
            }
            let (measured, solution, made) = match self.located(stage, virtual_measurement(problem)) {
                Ok((measured, solution)) => (measured, solution, true),
                Err(error) if error.fatal => {
                    found.broken.push(format!("{}: {error}", stage.name));
                    continue;
                }
                // The laws of artefacts are then looked at on the recorded data.
                Err(error) => {
                    found.skipped.push(format!("{}: a virtual machine makes no data: {}", stage.name, error.message));
                    (problem.clone(), problem.start(), false)
                }
            };
            let at = measured.with_values(&solution);
            let broken = laws::check_gradient(&at).unwrap_or_else(|error| vec![error.to_string()]);
            found.broken.extend(broken.into_iter().map(|law| format!("{}: {law}", stage.name)));
            for (index, set) in SetIndex::enumerate(&at.sets) {
                let artefact = self.recipe.stages.iter().find(|stage| stage.name == set.name);
                let plugin = artefact.map_or_else(String::new, |stage| stage.plugin.clone());
                found.seen.insert((set.name.clone(), plugin));
                let broken = laws::check_observations(&at, index).unwrap_or_else(|error| vec![error.to_string()]);
                found.broken.extend(broken.into_iter().map(|law| format!("{}, {}: {law}", stage.name, set.name)));
                let (ingest, artefact) = self.artefact(&set.name)?;
                let alone = laws::check_independence(artefact, &data[ingest], &problem.model);
                let broken = alone.unwrap_or_else(|error| vec![format!("it fails with half of its rows: {error}")]);
                found.broken.extend(broken.into_iter().map(|law| format!("{}: {law}", set.name)));
            }
            if !made {
                continue;
            }
            let estimator = self.estimators[&stage.name].as_ref();
            let identified = match estimator.identify(&measured) {
                Ok(identified) => identified,
                Err(error) => {
                    found.broken.push(format!("{}: {error}", stage.name));
                    continue;
                }
            };
            if identified.rank < identified.unknowns {
                let (rank, unknowns) = (identified.rank, identified.unknowns);
                found.skipped.push(format!("{}: its data determine {rank} of {unknowns} unknowns", stage.name));
                continue;
            }
            match laws::check_estimate(estimator, &measured, &solution) {
                Ok(broken) => found.broken.extend(broken.into_iter().map(|law| format!("{}: {law}", stage.name))),
                Err(error) if error.class == Class::Use => {
                    found.skipped.push(format!("{}: {}", stage.name, error.message));
                    continue;
                }
                Err(error) => found.broken.push(format!("{}: it fails: {error}", stage.name)),
            }
            found.seen.insert((stage.name.clone(), stage.plugin.clone()));
        }
        Ok(found)
    }
}

/// The exact measurements of the rows of a problem on a machine with errors in all unknowns, and the values of these
/// unknowns.
fn virtual_measurement(problem: &Problem) -> Result<(Problem, Vec<f64>)> {
    let start = problem.start();
    let largest = laws::largest_derivatives(problem, &start)?;
    let error = |(index, largest): (usize, &f64)| {
        let sign = if index % 2 == 0 { 1.0 } else { -1.0 };
        // A parameter that has no effect on any row stays at its start value.
        if *largest > 0.0 { sign * SIZE * (0.5 + 0.1 * (index % 6) as f64) / largest } else { 0.0 }
    };
    let errors = largest.iter().enumerate().map(error);
    let solution: Vec<f64> = start.iter().zip(errors).map(|(start, error)| start + error).collect();
    let named = problem.unknowns.iter().zip(&solution).map(|(unknown, value)| (unknown.name.clone(), *value));
    let truth = Truth { parameters: named.collect(), noise: Noise::default() };
    let measured = measure(problem, &truth, 1)?;
    // Constraints are shifted so that the certificate states the true value of this artefact.
    let residuals = measured.residuals(&solution)?;
    let constraints = measured.constraints().into_iter().zip(residuals);
    let stated: Vec<f64> = constraints.map(|(stated, residual)| if stated { -residual } else { 0.0 }).collect();
    Ok((measured.disturbed(&stated), solution))
}

/// First and last time of the rows of a problem, s: of the first series, whose clock it is.
fn times(problem: &Problem) -> [f64; 2] {
    let info = problem.model.info();
    let Some(column) = info.status_index(&StatusRole::Time) else { return [0.0, 1.0] };
    let series = info.status_index(&StatusRole::Series);
    let of_set = |set: &ObservationSet| -> Vec<f64> {
        let statuses = set.poses_of(&set.rows).map(|pose| set.poses().row(pose));
        let is_first = |status: &&[f64]| series.is_none_or(|series| status[series] == 0.0);
        statuses.filter(is_first).map(|status| status[column]).collect()
    };
    let all: Vec<f64> = problem.sets.iter().flat_map(of_set).collect();
    ends(&all).unwrap_or([0.0, 1.0])
}
