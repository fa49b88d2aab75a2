//! Everything but the fits: what the data of a recipe could determine.

use std::collections::BTreeMap;

use abbe_core::{Identifiability, Kind, Monitor, Problem, Result};
use abbe_estimation::{dead_channels, remarks};
use abbe_recipe::Stage;

use crate::batches::InBatches;
use crate::groups::GroupProblem;
use crate::prepare::Prepared;
use crate::problems::Taken;
use crate::record::input_records;
use crate::run::{digests, has_rows};

/// Identifiability of a planned fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Name of the estimate.
    pub estimate: String,
    /// Its identifiability.
    pub identifiability: Identifiability,
    /// Whether its estimator accepts this identifiability.
    pub accepted: bool,
    /// The machine parameters that it estimates.
    pub machine: Vec<String>,
}

impl Prepared {
    /// Everything but the fits: data, problems, and the identifiability of the fits at nominal contact.
    pub fn check(&self) -> Result<Vec<Planned>> {
        self.check_until(&Monitor::default())
    }

    /// The same, which the user may end on the way.
    pub fn check_until(&self, monitor: &Monitor) -> Result<Vec<Planned>> {
        let inputs = input_records(&self.files)?;
        let sources = self.sources_read_once()?;
        let data = self.read_with(monitor, &sources)?;
        let inputs = self.with_given(inputs, &data)?;
        let mut taken = Taken::default();
        let problems = self.problems_of(&data, &mut taken, |stage| !self.has_batches(stage))?;
        let batches = InBatches::new(self, sources, &data, &inputs, monitor, &mut taken)?;
        self.evidence(&problems, &batches, &data, &digests(&inputs))?;
        let groups = self.group_problems(&data)?;
        let (mut planned, mut found) = (Vec::new(), BTreeMap::new());
        for stage in self.stages(Kind::Estimate).filter(has_rows) {
            if let Some(identifiability) = batches.identify(stage, monitor)? {
                found.insert(stage.name.clone(), identifiability.clone());
                if let Some(problem) = batches.problem(&stage.name) {
                    planned.push(self.planned(stage, problem, identifiability)?);
                }
                continue;
            }
            let Some(problem) = problems.get(&stage.name) else { continue };
            monitor.check().map_err(|error| error.stage(&stage.name))?;
            let estimator = &self.estimators[&stage.name];
            let mut identifiability = self.located(stage, estimator.identify(problem))?;
            found.insert(stage.name.clone(), identifiability.clone());
            identifiability
                .remarks
                .extend([remarks(problem), self.comparisons(stage, (problem, None), &data)].concat());
            identifiability.remarks.extend(dead_channels(problem));
            identifiability.remarks.extend(self.substitutes(stage, problem, &identifiability));
            planned.push(self.planned(stage, problem, identifiability)?);
            for group in groups.get(&stage.name).into_iter().flatten() {
                planned.extend(self.planned_group(stage, group)?);
            }
        }
        let unseen = self.predicted(&problems, &batches, &data, &mut taken)?;
        self.nothing_left_over(&data, &taken)?;
        self.rehearse(true, (&problems, &groups, &batches), &found, &unseen, &data)?;
        Ok(planned)
    }

    /// What an estimate determines, and whether its estimator takes it.
    fn planned(&self, stage: &Stage, problem: &Problem, identifiability: Identifiability) -> Result<Planned> {
        let accepted = self.located(stage, self.estimators[&stage.name].accepts(&identifiability))?;
        let own = problem.unknowns.iter().filter(|unknown| unknown.is_of_machine());
        let machine = own.map(|unknown| unknown.name.clone()).collect();
        Ok(Planned { estimate: stage.name.clone(), identifiability, accepted, machine })
    }

    /// The problems of the estimates that are solved from measurements, by their names: model, observations and unknowns, for an
    /// estimator outside this program. Nothing is solved, so values that an estimate takes from another one (`known`, `start`) are the
    /// nominal ones.
    pub fn posed(&self, monitor: &Monitor) -> Result<BTreeMap<String, Problem>> {
        let inputs = input_records(&self.files)?;
        let data = self.read(monitor, None)?;
        self.with_given(inputs, &data)?;
        let mut problems = self.problems(&data, &mut Taken::default())?;
        problems.retain(|_, problem| !problem.sets.is_empty());
        Ok(problems)
    }

    /// What a group determines, if that is less than all groups together: nothing is told of the others.
    fn planned_group(&self, stage: &Stage, group: &GroupProblem) -> Result<Option<Planned>> {
        let estimator = &self.estimators[&stage.name];
        let identifiability = self.located(stage, estimator.identify(&group.problem))?;
        let accepted = self.located(stage, estimator.accepts(&identifiability))?;
        let own = group.problem.unknowns.iter().filter(|unknown| unknown.is_of_machine());
        let machine = own.map(|unknown| unknown.name.clone()).collect();
        let planned = Planned { estimate: group.name.clone(), identifiability, accepted, machine };
        Ok((!planned.accepted).then_some(planned))
    }
}
