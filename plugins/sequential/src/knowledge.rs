//! What an earlier estimate knows, as rows of unit variance.

use abbe_core::{Error, PathItem, Prior, Problem, Result, Unknown, matches};
use nalgebra::DMatrix;

use crate::settings::Changed;

/// Prior knowledge of some states of a problem. The states are its unknowns, then what is considered of the earlier estimate.
///
/// The earlier values are off by noise of the covariance R, and by S times the errors of known inputs. `L^-1 (z - m)` with
/// `R = L L^T` are rows of unit variance.
pub struct Knowledge {
    /// The known states, by their places among the states.
    pub places: Vec<usize>,
    /// Their names.
    pub names: Vec<String>,
    /// Their earlier values.
    pub values: Vec<f64>,
    /// `L^-1`.
    pub root: DMatrix<f64>,
    /// The derivatives of the rows to the inputs, `-L^-1 S`, in the order of the inputs.
    pub by_input: DMatrix<f64>,
}

/// A problem whose unknowns are all states, with its considered inputs: unknown, standard uncertainty.
pub struct States {
    /// The problem of all states.
    pub problem: Problem,
    /// How many of them the caller wants to know; the others are considered.
    pub wanted: usize,
    /// For each state that is considered its place in the list of what is considered.
    pub considered: Vec<usize>,
    /// The inputs: place in the list of what is considered, standard uncertainty.
    pub inputs: Vec<(usize, f64)>,
}

impl States {
    /// The states of a problem.
    pub fn new(problem: &Problem) -> Self {
        let all = &problem.considered;
        let is_input = |place: usize| all.identities.get(place).is_some_and(Option::is_some);
        let (inputs, considered): (Vec<usize>, Vec<usize>) =
            (0..all.unknowns.len()).partition(|&place| is_input(place));
        let inputs = inputs.into_iter().map(|place| (place, all.covariance[place][place].sqrt())).collect();
        let mut states = problem.clone();
        states.unknowns.extend(considered.iter().map(|&place| all.unknowns[place].clone()));
        Self { problem: states, wanted: problem.unknowns.len(), considered, inputs }
    }
}

fn same(one: &Unknown, other: &Unknown) -> bool {
    (one.owner, one.index) == (other.owner, other.index)
}

impl Knowledge {
    /// What the prior of a problem tells of its states, and what is considered of other estimates; nothing if that is nothing.
    ///
    /// Fails if several earlier estimates know unknowns, if one of these was confounded or is exact there, and if the
    /// covariance is singular without the inputs.
    pub fn new(states: &States, changed: &[Changed]) -> Result<Option<Self>> {
        let joint = Joint { states, prior: prior(states)? };
        let estimate = joint.prior.map_or("known", |prior| prior.estimate.as_str());
        let problem = &states.problem;
        let start = problem.start();
        let mut known = Vec::new();
        for (place, state) in problem.unknowns.iter().enumerate() {
            let Some(value) = joint.value(state, start[place]) else { continue };
            if joint.covariance(state, state) <= 0.0 {
                let message = format!("`{}` is exact in `{estimate}`: no row can change it", state.name);
                return Err(Error::data(message).help("leave it out by `parameters`").setting("known"));
            }
            known.push((place, state, value));
        }
        let places: Vec<usize> = known.iter().map(|known| known.0).collect();
        let grown = variances(states, &places, changed)?;
        if known.is_empty() {
            return Ok(None);
        }
        let size = known.len();
        let mut noise = DMatrix::from_fn(size, size, |row, column| joint.covariance(known[row].1, known[column].1));
        let mut sensitivities = DMatrix::zeros(size, states.inputs.len());
        for (input, &(place, uncertainty)) in states.inputs.iter().enumerate() {
            let own = &problem.considered.unknowns[place];
            for row in 0..size {
                sensitivities[(row, input)] = joint.covariance(known[row].1, own) / uncertainty.powi(2);
            }
            let sensitivity = sensitivities.column(input).into_owned();
            noise -= &sensitivity * sensitivity.transpose() * uncertainty.powi(2);
        }
        grown.into_iter().enumerate().for_each(|(row, variance)| noise[(row, row)] += variance);
        let root = inverse_root(&noise).ok_or_else(|| {
            let message = format!("the covariance of `{estimate}` is singular without the inputs that it considers");
            let help = "leave out by `parameters` what its measurements do not tell by themselves";
            Error::data(message).help(help).setting("known")
        })?;
        let by_input = -&root * sensitivities;
        let names = known.iter().map(|known| known.1.name.clone()).collect();
        let values = known.iter().map(|known| known.2).collect();
        Ok(Some(Self { places, names, values, root, by_input }))
    }
}

/// The one prior that knows unknowns of a problem.
fn prior(states: &States) -> Result<Option<&Prior>> {
    let problem = &states.problem;
    let wanted = &problem.unknowns[..states.wanted];
    let is_wanted = |unknown: &Unknown| wanted.iter().any(|wanted| same(wanted, unknown));
    let mut priors = problem.priors.iter().filter(|prior| prior.unknowns[..prior.values.len()].iter().any(is_wanted));
    let Some(prior) = priors.next() else { return Ok(None) };
    if let Some(other) = priors.next() {
        let message = format!("`{}` and `{}` both know what is estimated here", prior.estimate, other.estimate);
        return Err(Error::usage(message).help("make one of them by `estimate: combine`").setting("known"));
    }
    if let Some(name) = prior.confounded.iter().find(|name| wanted.iter().any(|own| own.name == **name)) {
        let message = format!("the data of `{}` cannot separate `{name}` from others", prior.estimate);
        let help = "let that estimate determine all that it tells, or leave it out by `parameters`";
        return Err(Error::data(message).help(help).setting("known"));
    }
    Ok(Some(prior))
}

/// The joint covariance of what is known: of unknowns by a prior, of all that is considered by the problem.
struct Joint<'a> {
    states: &'a States,
    prior: Option<&'a Prior>,
}

impl Joint<'_> {
    fn considered(&self, unknown: &Unknown) -> Option<usize> {
        self.states.problem.considered.unknowns.iter().position(|other| same(other, unknown))
    }

    fn in_prior(&self, unknown: &Unknown) -> Option<usize> {
        self.prior?.unknowns.iter().position(|other| same(other, unknown))
    }

    /// The known value of a state; what is considered has the value that stands in the problem.
    fn value(&self, state: &Unknown, start: f64) -> Option<f64> {
        if self.considered(state).is_some() {
            return Some(start);
        }
        self.prior?.values.get(self.in_prior(state)?).copied()
    }

    fn covariance(&self, one: &Unknown, other: &Unknown) -> f64 {
        if let (Some(one), Some(other)) = (self.considered(one), self.considered(other)) {
            return self.states.problem.considered.covariance[one][other];
        }
        match (self.prior, self.in_prior(one), self.in_prior(other)) {
            (Some(prior), Some(one), Some(other)) => prior.covariance[one][other],
            _ => 0.0,
        }
    }
}

/// What the variances of known states grow by.
fn variances(states: &States, places: &[usize], changed: &[Changed]) -> Result<Vec<f64>> {
    let (problem, wanted) = (&states.problem, states.wanted);
    let mut variances = vec![0.0; places.len()];
    for (line, change) in changed.iter().enumerate() {
        for (index, pattern) in change.parameters.iter().enumerate() {
            let name = |place: usize| &problem.unknowns[place].name;
            let known =
                places.iter().enumerate().filter(|(_, place)| **place < wanted && matches(pattern, name(**place)));
            let known: Vec<usize> = known.map(|(row, _)| row).collect();
            if known.is_empty() {
                let all = places.iter().filter(|place| **place < wanted).map(|&place| name(place).as_str());
                let message = format!("`{pattern}` matches nothing that is estimated here and known from before");
                let mut error = Error::usage(message).suggest(pattern, all);
                let key = |key: &str| PathItem::Key(key.to_owned());
                error.setting = vec![key("changed"), PathItem::Index(line), key("parameters"), PathItem::Index(index)];
                return Err(error);
            }
            known.into_iter().for_each(|row| variances[row] += change.standard_uncertainty.powi(2));
        }
    }
    Ok(variances)
}

/// `L^-1` of a covariance `L L^T`, which is scaled to unit diagonal on the way; None if it is not positive definite.
fn inverse_root(covariance: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let size = covariance.nrows();
    let scale: Vec<f64> = (0..size).map(|row| covariance[(row, row)].sqrt()).collect();
    if scale.iter().any(|scale| !(*scale > 0.0 && scale.is_finite())) {
        return None;
    }
    let scaled = DMatrix::from_fn(size, size, |row, column| covariance[(row, column)] / scale[row] / scale[column]);
    let inverse = scaled.cholesky()?.l().solve_lower_triangular(&DMatrix::identity(size, size))?;
    Some(DMatrix::from_fn(size, size, |row, column| inverse[(row, column)] / scale[column]))
}
