//! A problem: model + observations + chosen unknowns + selected rows.
//!
//! Any estimator can solve a problem again: on other rows (hold-out), with other inputs (Monte Carlo) or from other start
//! values.

mod considered;
mod evaluation;
mod first_order;
mod gradient;
mod in_parts;
mod linearise;
mod rows;
mod tie;

use std::collections::BTreeMap;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::index::{IndexRange, RowIndex, SetIndex};
use crate::model::KinematicModel;
use abbe_results::{Calibration, ModelRecord};
use abbe_settings::{Error, Monitor, Result, Unit, matches};

use considered::{candidates, check_constraints, consider_parameters, inputs};

pub use considered::{Considered, Input, Prior};
pub use evaluation::Evaluation;
pub use in_parts::{Chunk, PartOfRows};
pub use linearise::{Block, CHUNK, CompactBlock};
pub use rows::{ObservationSet, RepeatedTogether};
pub use tie::{DeclaredTie, Tie};

/// What an unknown belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Owner {
    /// A parameter of the model.
    Machine,
    /// Several parameters of the model that are one number: [`Problem::ties`].
    Tie,
    /// An own unknown of this observation set.
    Set(SetIndex),
    /// A known input of the problem ([`Problem::inputs`]); never estimated.
    Input,
}

/// Something to be estimated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Unknown {
    /// Name in results: `EXX[1]`, `table.facet[7].d`.
    pub name: String,
    /// Unit of its value.
    pub unit: Unit,
    /// What it belongs to.
    pub owner: Owner,
    /// Its index among the parameters of its owner.
    pub index: usize,
}

/// Model, observations, unknowns and rows: what an estimator solves.
#[derive(Clone)]
pub struct Problem {
    /// Name of the estimate.
    pub name: String,
    /// The model.
    pub model: Arc<dyn KinematicModel>,
    /// Its plugin.
    pub model_plugin: String,
    /// The observations.
    pub sets: Vec<ObservationSet>,
    /// What is estimated: machine parameters in the model's order, then the sets' own unknowns.
    pub unknowns: Vec<Unknown>,
    /// Unknowns that are several parameters of the machine.
    pub ties: Vec<Tie>,
    /// Start or fixed value of every model parameter.
    pub machine_values: Vec<f64>,
    /// The known inputs of all sets. An input that several sets share is listed once.
    pub inputs: Vec<Input>,
    /// Quantities that are not estimated, but whose uncertainty is propagated.
    pub considered: Considered,
    /// What earlier estimates know of the unknowns. Only an estimator that says so counts it.
    pub priors: Vec<Prior>,
    /// Monitor of the work on this problem.
    pub monitor: Monitor,
}

impl Problem {
    /// A problem over all rows. Machine parameters start from their nominal values, own unknowns from the start values of
    /// their observations.
    ///
    /// `patterns` choose the unknowns by name. A pattern that matches nothing is an error; the error has the index of the
    /// pattern in the setting `parameters`. Also fails if one known input has different values or uncertainties, and if a
    /// constraint depends on no uncertain known input.
    pub fn new(
        name: &str,
        model_plugin: &str,
        model: Arc<dyn KinematicModel>,
        sets: Vec<ObservationSet>,
        patterns: &[String],
    ) -> Result<Self> {
        Self::with_ties(name, model_plugin, model, sets, (patterns, &[]))
    }

    /// The same where parameters of the machine are tied: a pattern chooses a tied unknown by its name or by that of a member.
    pub fn with_ties(
        name: &str,
        model_plugin: &str,
        model: Arc<dyn KinematicModel>,
        sets: Vec<ObservationSet>,
        (patterns, declared): (&[String], &[DeclaredTie]),
    ) -> Result<Self> {
        check_lengths(model.as_ref(), &sets)?;
        let candidates = candidates(model.as_ref(), &sets);
        let ties = tie::ties(declared, &candidates)?;
        let mut candidates = tie::tied(candidates, &ties);
        let parameters = &model.info().parameters;
        let is_meant = |pattern: &str, candidate: &Unknown| {
            let members = if candidate.owner == Owner::Tie { ties[candidate.index].members.as_slice() } else { &[] };
            matches(pattern, &candidate.name)
                || members.iter().any(|(index, _)| matches(pattern, &parameters[*index].name))
        };
        let mut chosen = vec![false; candidates.len()];
        for (index, pattern) in patterns.iter().enumerate() {
            let mut found = false;
            for (chosen, candidate) in chosen.iter_mut().zip(&candidates) {
                if is_meant(pattern, candidate) {
                    (*chosen, found) = (true, true);
                }
            }
            if !found {
                let names = candidates.iter().map(|candidate| candidate.name.as_str());
                let mut error = Error::usage(format!(
                    "`{pattern}` matches no parameter of the machine and none of the observed artefacts"
                ))
                .help("a machine parameter exists only if the model's `errors` (or `probe`) list it")
                .suggest(pattern, names);
                error.setting =
                    vec![abbe_settings::PathItem::Key("parameters".to_owned()), abbe_settings::PathItem::Index(index)];
                return Err(error);
            }
        }
        let mut chosen = chosen.into_iter();
        candidates.retain(|_| chosen.next() == Some(true));
        let machine_values = model.info().nominal.clone();
        let (inputs, mut considered) = inputs(&sets)?;
        consider_parameters(&mut considered, model.as_ref(), &candidates, &ties);
        sets.iter().try_for_each(check_constraints)?;
        Ok(Self {
            name: name.to_owned(),
            model,
            model_plugin: model_plugin.to_owned(),
            sets,
            unknowns: candidates,
            ties,
            machine_values,
            inputs,
            considered,
            priors: Vec::new(),
            monitor: Monitor::default(),
        })
    }

    /// The indices of all sets.
    pub fn set_indices(&self) -> IndexRange<SetIndex> {
        SetIndex::first(self.sets.len())
    }

    /// The set of this name.
    pub fn set_named(&self, name: &str) -> Option<SetIndex> {
        self.sets.iter().position(|set| set.name == name).map(SetIndex)
    }

    /// The model with the settings that the fit used.
    pub fn model_record(&self) -> ModelRecord {
        ModelRecord { plugin: self.model_plugin.clone(), settings: self.model.info().settings.clone() }
    }

    /// The same problem, watched by another monitor.
    pub fn watched_by(&self, monitor: Monitor) -> Self {
        Self { monitor, ..self.clone() }
    }

    /// The same problem on other rows of one set.
    pub fn with_rows(&self, set: SetIndex, rows: Vec<RowIndex>) -> Self {
        let mut problem = self.clone();
        problem.sets[set].rows = rows;
        problem
    }

    /// The same problem without some of its unknowns, which stay at their start values.
    pub fn without_unknowns(&self, dropped: impl Fn(&Unknown) -> bool) -> Self {
        let mut problem = self.clone();
        problem.unknowns.retain(|unknown| !dropped(unknown));
        problem
    }

    /// The same problem with the values of a calibration as start values, and as fixed values of parameters that are not
    /// estimated.
    pub fn starting_from(&self, calibration: &Calibration) -> Self {
        let (mut problem, known) = (self.clone(), calibration.by_name());
        for (value, parameter) in problem.machine_values.iter_mut().zip(&problem.model.info().parameters) {
            if let Some(known) = known.get(parameter.name.as_str()) {
                *value = known.value;
            }
        }
        for set in &mut problem.sets {
            for (value, parameter) in set.own.iter_mut().zip(&set.observations.info().unknowns) {
                if let Some(known) = known.get(format!("{}.{}", set.name, parameter.name).as_str()) {
                    *value = known.value;
                }
            }
        }
        problem
    }

    /// Adds `change` to the value of a quantity that is not estimated.
    pub fn shift(&mut self, unknown: &Unknown, change: f64) {
        let value = self.value_of(unknown);
        self.set(unknown, value + change);
    }

    /// The start or fixed value of an unknown.
    pub fn value_of(&self, unknown: &Unknown) -> f64 {
        match unknown.owner {
            Owner::Machine => self.machine_values[unknown.index],
            Owner::Tie => {
                let (index, factor) = self.ties[unknown.index].members[0];
                self.machine_values[index] / factor
            }
            Owner::Set(set) => self.sets[set].own[unknown.index],
            Owner::Input => self.inputs[unknown.index].value(&self.sets),
        }
    }

    fn set(&mut self, unknown: &Unknown, value: f64) {
        match unknown.owner {
            Owner::Machine => self.machine_values[unknown.index] = value,
            Owner::Tie => {
                for &(index, factor) in &self.ties[unknown.index].members {
                    self.machine_values[index] = value * factor;
                }
            }
            Owner::Set(set) => self.sets[set].own[unknown.index] = value,
            Owner::Input => {
                for &(set, input) in &self.inputs[unknown.index].users {
                    self.sets[set].inputs[input] = value;
                }
            }
        }
    }

    /// The start value of every unknown.
    pub fn start(&self) -> Vec<f64> {
        self.unknowns.iter().map(|unknown| self.value_of(unknown)).collect()
    }

    /// The problem with the unknowns' start values replaced by `x`.
    pub fn with_values(&self, x: &[f64]) -> Self {
        let mut problem = self.clone();
        for (unknown, &value) in self.unknowns.iter().zip(x) {
            problem.set(unknown, value);
        }
        problem
    }

    /// The estimated values of a calibration in the order of this problem's unknowns; start values where it has none.
    pub fn values_of(&self, calibration: &Calibration) -> Vec<f64> {
        let known = calibration.by_name();
        let unknowns = self.unknowns.iter().zip(self.start());
        unknowns.map(|(unknown, start)| known.get(unknown.name.as_str()).map_or(start, |known| known.value)).collect()
    }

    /// The values of the unknowns by their names; those without one are at their start.
    pub fn values_at(&self, at: &BTreeMap<String, f64>) -> Vec<f64> {
        let unknowns = self.unknowns.iter().zip(self.start());
        unknowns.map(|(unknown, start)| at.get(&unknown.name).copied().unwrap_or(start)).collect()
    }
}

/// Refuses models and observations that do not give one value for each of their parameters.
fn check_lengths(model: &dyn KinematicModel, sets: &[ObservationSet]) -> Result<()> {
    let info = model.info();
    if [info.nominal.len(), info.nominal_uncertainties.len()] != [info.parameters.len(); 2] {
        return Err(Error::data("the model has not one nominal value, and one uncertainty of it, a parameter").fatal());
    }
    let beyond = |set: &&ObservationSet| {
        set.info().inputs.iter().any(|input| input.of_model.is_some_and(|index| index >= info.parameters.len()))
    };
    if let Some(set) = sets.iter().find(beyond) {
        let message = "an input of the artefact is a parameter that the model does not have";
        return Err(Error::data(message).fatal().stage(&set.name));
    }
    match sets.iter().find(|set| set.info().start.len() != set.info().unknowns.len()) {
        Some(set) => Err(Error::data("the artefact has not one start value an unknown").fatal().stage(&set.name)),
        None => Ok(()),
    }
}
