//! Trials of an estimate whose rows lie in parts that are read again and again, none of which has all.
//!
//! Each row draws from random numbers of its own, found by the file and the line that it was read from: results depend neither on how
//! rows are divided, nor on the number of threads. They are not those of rows that are held, which draw one after another.

use abbe_core::{Fit, Owner, Parts, Problem, Result, RowIndex, SetIndex, Unknown};
use abbe_estimation::{ChangedParts, looked_at};
use abbe_numerics::{Generator, mixed};

use crate::draws::{at_estimate, described, scale};
use crate::lobing::Pretravel;
use crate::neglected::largest_factor;
use crate::rows::RowErrors;
use crate::settings::Settings;
use crate::shared::Shared;

/// The column that tells the files of a data set apart.
const FILE: &str = "file";

/// Where numbers of rows begin.
const SEED: u64 = 20;

/// The distributions of all inputs of an estimate from rows in parts.
pub struct DrawsOfParts<'a> {
    fit: &'a Fit,
    parts: &'a dyn Parts,
    settings: &'a Settings,
    /// The problem at the estimate, without rows.
    problem: Problem,
    shared: Shared,
}

impl<'a> DrawsOfParts<'a> {
    /// The inputs of a fit as the settings vary them.
    pub fn new(settings: &'a Settings, fit: &'a Fit, parts: &'a dyn Parts) -> Result<Self> {
        let problem = at_estimate(fit);
        let largest = |parameter: usize| {
            let own = |part: &Problem| largest_factor(parameter, &part.with_values(&part.values_of(&fit.calibration)));
            let found = looked_at(parts, &own, &|largest, own| *largest = own.max(*largest))?;
            Ok(found.unwrap_or(0.0))
        };
        let shared = Shared::new(settings, &problem, &largest)?;
        Ok(Self { fit, parts, settings, problem, shared })
    }

    /// Number of quantities of a trial: the unknowns and the considered parameters.
    pub fn quantities(&self) -> usize {
        self.problem.unknowns.len() + self.shared.count()
    }

    /// What varies, in words.
    pub fn described(&self) -> Result<Vec<String>> {
        let rows = RowErrors::new(self.settings.rows, self.fit, &self.problem, scale(self.fit))?;
        Ok(described(self.settings, &self.problem, &rows, &self.shared))
    }

    /// The estimate of one trial, followed by its considered parameters.
    pub fn trial(&self, trial: u64) -> Result<Vec<f64>> {
        let Self { fit, parts, settings, problem: at_estimate, .. } = self;
        let seed = settings.seed;
        let mut generator = Generator::new(seed, trial);
        let lobing: Vec<_> = settings.lobing.iter().map(|setting| setting.draw(&mut generator)).collect();
        let drawn = self.shared.draw(&self.problem, &mut generator);
        let change = |_: usize, part: &Problem| {
            let part = part.with_values(&part.values_of(&fit.calibration));
            let rows = RowErrors::new(settings.rows, fit, &part, scale(fit))?;
            let mut errors = rows.draw_by_row(|set, row| Generator::at(seed, trial, place(&part, set, row)));
            for (index, (setting, lobing)) in settings.lobing.iter().zip(&lobing).enumerate() {
                // A part need not have touches of that artefact.
                if part.set_named(&setting.artefact).is_some_and(|set| !part.sets[set].rows.is_empty()) {
                    Pretravel::new(index, setting, &part)?.add(lobing, &mut errors);
                }
            }
            let mut part = part.disturbed(&errors);
            for (unknown, change) in &drawn.changes {
                if let Some(own) = counterpart(at_estimate, unknown, &part) {
                    part.shift(&own, *change);
                }
            }
            Ok(part)
        };
        let mut problem = at_estimate.clone();
        drawn.changes.iter().for_each(|(unknown, change)| problem.shift(unknown, *change));
        let values = fit.estimator.values_of_parts(&problem, &ChangedParts::new(*parts, &change))?;
        Ok([values, drawn.considered].concat())
    }
}

/// What a part calls an unknown of the whole problem; none if its rows do not have it.
fn counterpart(whole: &Problem, unknown: &Unknown, part: &Problem) -> Option<Unknown> {
    match unknown.owner {
        Owner::Machine | Owner::Tie => Some(unknown.clone()),
        Owner::Set(set) => {
            let set = part.set_named(&whole.sets[set].name)?;
            let own = &part.sets[set].info().unknowns;
            let prefix = format!("{}.", part.sets[set].name);
            let name = unknown.name.strip_prefix(&prefix)?;
            let index = own.iter().position(|own| own.name == name)?;
            Some(Unknown { owner: Owner::Set(set), index, ..unknown.clone() })
        }
        Owner::Input => {
            let identity = &whole.inputs[unknown.index].identity;
            let index = part.inputs.iter().position(|input| input.identity == *identity)?;
            Some(Unknown { index, ..unknown.clone() })
        }
    }
}

/// A number for a row, by the stage, the file and the line that it is of: the same however rows are divided, and wherever files lie.
fn place(part: &Problem, set: SetIndex, row: RowIndex) -> u64 {
    let layout = &part.sets[set].info().layout;
    let (labels, data_row) = (layout.data.labels(FILE), layout.rows[row].data_row);
    let label = labels.zip(data_row).map_or("", |(labels, data_row)| labels[data_row].as_str());
    let line = part.origin(set, row).map_or(row.0, |(_, origin)| origin.row);
    let all = part.sets[set].name.bytes().chain([0]).chain(label.bytes()).chain([0]);
    mixed(all.fold(SEED, |hash, byte| mixed(hash ^ u64::from(byte))) ^ mixed(line as u64))
}
