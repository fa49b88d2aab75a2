//! What a trial draws for all rows together: known inputs, what an earlier estimate knows, neglected errors.

use abbe_core::{Error, PathItem, Problem, Result, Unknown};
use abbe_numerics::Generator;
use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::neglected::Varied;
use crate::settings::{Distribution, Settings};

/// What varies of a problem beside its rows.
pub struct Shared {
    /// Considered parameters, those of one source together.
    pub considered: Vec<Source>,
    /// Values of the considered parameters at the estimate.
    known: Vec<f64>,
    /// Neglected errors.
    pub neglected: Vec<Varied>,
}

/// Considered parameters that are correlated, with the root of their covariance.
pub struct Source {
    /// Their places in what is considered.
    pub members: Vec<usize>,
    /// The prior of the problem that comes from the same earlier estimate. What it knows of unknowns comes first in the root.
    pub prior: Option<usize>,
    root: DMatrix<f64>,
    /// Their distribution.
    pub distribution: Distribution,
}

/// What one trial has drawn.
pub struct DrawnShared {
    /// Values of the considered parameters, in their order.
    pub considered: Vec<f64>,
    /// By how much values change that are not estimated.
    pub changes: Vec<(Unknown, f64)>,
    /// By how much what priors know of unknowns changes: the prior, its changes in their order.
    pub priors: Vec<(usize, Vec<f64>)>,
}

impl Shared {
    /// What varies of a problem; `largest` gives the largest factor of a parameter in its motion error.
    pub fn new(settings: &Settings, problem: &Problem, largest: &dyn Fn(usize) -> Result<f64>) -> Result<Self> {
        let considered = sources(settings, problem)?;
        let known = problem.considered.unknowns.iter().map(|unknown| problem.value_of(unknown)).collect();
        let mut neglected = Vec::new();
        for (index, line) in settings.vary.iter().enumerate() {
            neglected.extend(line.parameters_of(index, problem, largest)?);
        }
        Ok(Self { considered, known, neglected })
    }

    /// Number of considered parameters.
    pub fn count(&self) -> usize {
        self.known.len()
    }

    /// One trial.
    pub fn draw(&self, problem: &Problem, generator: &mut Generator) -> DrawnShared {
        let mut drawn = DrawnShared { considered: self.known.clone(), changes: Vec::new(), priors: Vec::new() };
        for source in &self.considered {
            let numbers = DVector::from_fn(source.root.ncols(), |_, _| source.distribution.draw(generator));
            let values = &source.root * numbers;
            let mut changes = values.iter().copied();
            if let Some(prior) = source.prior {
                let known = problem.priors[prior].values.len();
                drawn.priors.push((prior, changes.by_ref().take(known).collect()));
            }
            for (&member, change) in source.members.iter().zip(changes) {
                drawn.considered[member] += change;
                drawn.changes.push((problem.considered.unknowns[member].clone(), change));
            }
        }
        for (unknown, distribution, size) in &self.neglected {
            drawn.changes.push((unknown.clone(), size * distribution.draw(generator)));
        }
        drawn
    }
}

/// The considered parameters, those of one source together.
fn sources(settings: &Settings, problem: &Problem) -> Result<Vec<Source>> {
    let considered = &problem.considered;
    let mut names: Vec<&String> = Vec::new();
    for source in considered.sources.iter().chain(problem.priors.iter().map(|prior| &prior.estimate)) {
        if !names.contains(&source) {
            names.push(source);
        }
    }
    if let Some(unknown) = settings.inputs.keys().find(|name| !names.contains(name)) {
        let message = format!("`{unknown}` is no known input with an uncertainty");
        let mut error = Error::usage(message).suggest(unknown, names.iter().map(|name| name.as_str()));
        error.setting = vec![PathItem::Key("inputs".to_owned()), PathItem::Key(unknown.clone())];
        return Err(error);
    }
    let sources = names.into_iter().map(|name| {
        let members: Vec<usize> =
            (0..considered.sources.len()).filter(|&member| considered.sources[member] == *name).collect();
        let prior = problem.priors.iter().position(|prior| prior.estimate == *name);
        let covariance = joint_covariance(problem, &members, prior);
        let distribution = settings.inputs.get(name).copied().unwrap_or_default();
        Source { root: root(&covariance), members, prior, distribution }
    });
    Ok(sources.collect())
}

/// The covariance of what a prior knows of unknowns, if there is one, and of some of what is considered.
fn joint_covariance(problem: &Problem, members: &[usize], prior: Option<usize>) -> DMatrix<f64> {
    let considered = &problem.considered;
    let prior = prior.map(|prior| &problem.priors[prior]);
    let known = prior.map_or(0, |prior| prior.values.len());
    let place = |member: usize| {
        let unknown = &considered.unknowns[members[member - known]];
        let same = |other: &Unknown| (other.owner, other.index) == (unknown.owner, unknown.index);
        prior.and_then(|prior| prior.unknowns.iter().position(same))
    };
    DMatrix::from_fn(known + members.len(), known + members.len(), |row, column| {
        if row >= known && column >= known {
            return considered.covariance[members[row - known]][members[column - known]];
        }
        let of = |index: usize| if index < known { Some(index) } else { place(index) };
        let found = prior.zip(of(row)).zip(of(column));
        found.map_or(0.0, |((prior, row), column)| prior.covariance[row][column])
    })
}

/// A matrix whose product with its transpose is the covariance, which may be singular.
pub fn root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let size = covariance.nrows();
    let scale: Vec<f64> = (0..size).map(|row| covariance[(row, row)].max(0.0).sqrt()).collect();
    let unit = |row: usize| if scale[row] > 0.0 { scale[row] } else { 1.0 };
    let correlation = DMatrix::from_fn(size, size, |row, column| covariance[(row, column)] / unit(row) / unit(column));
    let eigen = SymmetricEigen::new(correlation);
    DMatrix::from_fn(size, size, |row, k| {
        scale[row] * eigen.eigenvectors[(row, k)] * eigen.eigenvalues[k].max(0.0).sqrt()
    })
}
