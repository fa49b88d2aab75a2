//! Considered quantities of a problem: known inputs, and results of an earlier estimate. They are not estimated, but their
//! uncertainty is propagated.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::index::SetIndex;
use crate::model::{KinematicModel, ModelInfo, Poses};
use crate::observations::Equations;
use crate::parameter::Parameter;
use crate::problem::{ObservationSet, Owner, Problem, Tie, Unknown, tie};
use abbe_results::Certificate;
use abbe_results::{Calibration, ConsideredInput, Status};
use abbe_settings::Unit;
use abbe_settings::{Error, Result};

/// A known input of a problem, with the sets that use it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Input {
    /// Name in results: `bar.reference_error`, or `stylus_radius` where it is the machine's.
    pub name: String,
    /// Its identity: inputs with the same identity are one quantity, in all estimates. Empty if it has no uncertainty.
    #[serde(default)]
    pub identity: String,
    /// Unit of its value.
    #[serde(default = "length")]
    pub unit: Unit,
    /// Its value if no set of this problem uses it.
    #[serde(default)]
    pub stated: f64,
    /// Its standard uncertainty, in the unit of its value.
    pub standard_uncertainty: f64,
    /// The sets that use it: (set, index among the known inputs of its observations). Empty if only an earlier estimate
    /// depends on it.
    pub users: Vec<(SetIndex, usize)>,
}

fn length() -> Unit {
    Unit::MM
}

impl Input {
    /// Its value.
    pub fn value(&self, sets: &[ObservationSet]) -> f64 {
        self.users.first().map_or(self.stated, |&(set, input)| sets[set].inputs[input])
    }
}

/// Quantities that are not estimated but whose uncertainty is propagated: known inputs, and results of an earlier
/// calibration.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Considered {
    /// The parameters.
    pub unknowns: Vec<Unknown>,
    /// Their covariance, in their units.
    pub covariance: Vec<Vec<f64>>,
    /// For each quantity the name of its contribution in budgets: its own name, or the name of the earlier estimate.
    pub sources: Vec<String>,
    /// For each quantity its identity if it is an input; inputs are independent of each other. None for results of an earlier
    /// estimate.
    #[serde(default)]
    pub identities: Vec<Option<String>>,
}

/// What an earlier estimate knows of unknowns of a problem, together with what it knows of what is considered there.
///
/// The problem starts from these values as well; whether they count as knowledge is the estimator's affair.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Prior {
    /// Name of the earlier estimate.
    pub estimate: String,
    /// The unknowns of the problem that it has estimated, then what is considered of its results.
    pub unknowns: Vec<Unknown>,
    /// Its values of the unknowns of the problem, the first in `unknowns`, in their units. What is considered has the value
    /// that stands in the problem.
    pub values: Vec<f64>,
    /// The covariance of all, in their units.
    pub covariance: Vec<Vec<f64>>,
    /// Unknowns of the problem that its data could not separate from others.
    #[serde(default)]
    pub confounded: Vec<String>,
}

impl Considered {
    /// Removes the quantities for which `taken` is true. Only quantities that come from this problem itself are removed;
    /// these are independent of all others.
    fn take(&mut self, taken: impl Fn(&Unknown) -> bool) {
        let stays: Vec<usize> = (0..self.unknowns.len())
            .filter(|&index| self.sources[index] != self.unknowns[index].name || !taken(&self.unknowns[index]))
            .collect();
        *self = Self {
            unknowns: stays.iter().map(|&index| self.unknowns[index].clone()).collect(),
            covariance: stays
                .iter()
                .map(|&row| stays.iter().map(|&column| self.covariance[row][column]).collect())
                .collect(),
            sources: stays.iter().map(|&index| self.sources[index].clone()).collect(),
            identities: stays.iter().map(|&index| self.identities.get(index).cloned().flatten()).collect(),
        };
    }

    /// Adds an input, which is not correlated with the quantities that are there.
    fn push_input(&mut self, unknown: Unknown, identity: String, standard_uncertainty: f64) {
        let source = unknown.name.clone();
        self.extend(vec![(unknown, Some(identity))], &[vec![standard_uncertainty.powi(2)]], &source);
    }

    /// Adds parameters that are correlated with each other, but not with those that are there.
    fn extend(&mut self, more: Vec<(Unknown, Option<String>)>, covariance: &[Vec<f64>], source: &str) {
        let (before, count) = (self.unknowns.len(), more.len());
        self.covariance.iter_mut().for_each(|row| row.extend(std::iter::repeat_n(0.0, count)));
        for row in covariance {
            self.covariance.push([&vec![0.0; before], row.as_slice()].concat());
        }
        self.sources.extend(std::iter::repeat_n(source.to_owned(), count));
        let (unknowns, identities): (Vec<_>, Vec<_>) = more.into_iter().unzip();
        self.unknowns.extend(unknowns);
        self.identities.extend(identities);
    }
}

impl ObservationSet {
    /// The identity of a known input: from its declared `id`, or from the content of its certificate.
    pub fn identity(&self, input: usize) -> String {
        let certificate = self.observations.info().inputs[input].certificate();
        match self.ids.get(input).and_then(Option::as_deref) {
            Some(id) => certificate.declared_identity(id),
            None => certificate.identity(),
        }
    }
}

/// The known inputs of some sets, and those of them that are uncertain.
///
/// Inputs with the same identity are one quantity. Inputs of the machine with the same name are one quantity, too, unless
/// different ids are declared for them.
pub(crate) fn inputs(sets: &[ObservationSet]) -> Result<(Vec<Input>, Considered)> {
    let mut inputs: Vec<Input> = Vec::new();
    let mut shared: Vec<Option<&str>> = Vec::new();
    for (set, observations) in SetIndex::enumerate(sets) {
        let own = observations.observations.info().inputs.iter().enumerate();
        for (index, input) in own.filter(|(_, input)| input.of_model.is_none()) {
            let own = input.parameter.name.as_str();
            // An exact input has no error to share.
            let identity = match input.standard_uncertainty > 0.0 {
                true => observations.identity(index),
                false => String::new(),
            };
            let declared = observations.ids.get(index).is_some_and(Option::is_some);
            let same = |(place, other): (usize, &Input)| {
                let one = input.standard_uncertainty > 0.0 && other.identity == identity;
                let (user, of_user) = other.users[0];
                let another =
                    declared && sets[user].ids.get(of_user).is_some_and(Option::is_some) && other.identity != identity;
                one || (input.shared && shared[place] == Some(own) && !another)
            };
            if let Some(place) = inputs.iter().enumerate().position(same) {
                let other = &mut inputs[place];
                agree(other, observations.inputs[index], input.standard_uncertainty, sets, observations)?;
                other.users.push((set, index));
                if declared {
                    other.identity = identity;
                }
                continue;
            }
            let taken = |name: &str| inputs.iter().any(|other| other.name == name);
            let name = match input.shared && !taken(own) {
                true => own.to_owned(),
                false => format!("{}.{own}", observations.name),
            };
            shared.push(input.shared.then_some(own));
            inputs.push(Input {
                name,
                identity,
                unit: input.parameter.unit,
                stated: input.value,
                standard_uncertainty: input.standard_uncertainty,
                users: vec![(set, index)],
            });
        }
    }
    let mut considered = Considered::default();
    for (index, input) in inputs.iter().enumerate().filter(|(_, input)| input.standard_uncertainty > 0.0) {
        let unknown = Unknown { name: input.name.clone(), unit: input.unit, owner: Owner::Input, index };
        considered.push_input(unknown, input.identity.clone(), input.standard_uncertainty);
    }
    Ok((inputs, considered))
}

/// Refuses one quantity with two values, or two standard uncertainties.
fn agree(known: &Input, value: f64, uncertainty: f64, sets: &[ObservationSet], of: &ObservationSet) -> Result<()> {
    let (user, _) = known.users[0];
    let what = match (known.standard_uncertainty == uncertainty, known.value(sets) == value) {
        (true, true) => return Ok(()),
        (false, _) => "standard uncertainties",
        (true, false) => "values",
    };
    Err(Error::usage(format!(
        "`{}` is one quantity ({}), but `{}` and `{}` give it different {what}",
        known.name, known.identity, sets[user].name, of.name
    ))
    .help("state the same one in both, or give what are two things an `id` each"))
}

/// Adds the parameters of a model that have a nominal uncertainty and are not estimated.
pub(crate) fn consider_parameters(
    considered: &mut Considered,
    model: &dyn KinematicModel,
    chosen: &[Unknown],
    ties: &[Tie],
) {
    let ModelInfo { parameters, nominal, nominal_uncertainties, .. } = model.info();
    let all = parameters.iter().zip(nominal_uncertainties).zip(nominal).enumerate();
    for (index, ((Parameter { name, unit, .. }, &uncertainty), value)) in all {
        let is_chosen = chosen.iter().any(|unknown| match unknown.owner {
            Owner::Machine => unknown.index == index,
            Owner::Tie => ties[unknown.index].has(index),
            Owner::Set(_) | Owner::Input => false,
        });
        if uncertainty > 0.0 && !is_chosen {
            let unknown = Unknown { name: name.clone(), unit: *unit, owner: Owner::Machine, index };
            let content = format!("{name} = {value:e} {unit}, u = {uncertainty:e} {unit}");
            considered.push_input(unknown, Certificate::new(name, content).identity(), uncertainty);
        }
    }
}

/// Fails if a constraint depends on no uncertain input: the statement of its certificate would have no uncertainty.
pub(crate) fn check_constraints(set: &ObservationSet) -> Result<()> {
    let (layout, none) = (&set.info().layout, Poses::default());
    let rows = &layout.rows;
    for row in layout.row_indices().filter(|&row| rows[row].data_row.is_none() && rows[row].poses == 0) {
        let mut equations = Equations::default();
        set.observations.evaluate(set.batch(&[row], &none, &set.inputs), &mut equations)?;
        let uncertain = |input: usize| set.info().inputs[input].standard_uncertainty > 0.0;
        let stated = |equation| equations.by_input().iter().any(|&(of, input, _)| of == equation && uncertain(input));
        if !(0..rows[row].equations).all(stated) {
            let message = "a constraint of this artefact depends on no known input that has an uncertainty";
            return Err(Error::data(message)
                .help(
                    "its plugin has to give what the certificate states as a known input with its standard uncertainty",
                )
                .stage(&set.name));
        }
    }
    Ok(())
}

impl Problem {
    /// The same problem with the results of a calibration. Its values replace those of this problem. Unknowns of this problem
    /// start from these values; all others are considered with their covariance.
    ///
    /// Inputs of the calibration stay inputs in this problem. An input that both use is counted once, with its correlation to
    /// the results of the calibration. Fails if both state it differently, and for values of the calibration that were eliminated, whose
    /// covariances are not known.
    pub fn with_prior(&self, calibration: &Calibration) -> Result<Self> {
        let mut problem = self.starting_from(calibration);
        let order = &calibration.covariance.order;
        let records = calibration.inputs.as_deref().unwrap_or_default();
        let identity = |name: &str| records.iter().find(|record| record.name == name).map(|it| it.identity.clone());
        let chosen = |name: &str| self.unknowns.iter().any(|chosen| chosen.name == name);
        let (mut known, mut places) = (Vec::new(), Vec::new());
        let parameters = self.candidates();
        calibration.check_covariance_of(parameters.iter().map(|unknown| unknown.name.as_str()))?;
        for unknown in parameters.into_iter().filter(|unknown| !chosen(&unknown.name)) {
            let Some(place) = calibration.covariance.index(&unknown.name) else { continue };
            let identity = identity(&unknown.name);
            known.push((unknown, identity));
            places.push(place);
        }
        for (place, name) in order.iter().enumerate() {
            let record = match calibration.inputs {
                Some(_) => records.iter().find(|record| record.name == *name),
                None => None,
            };
            let unknown = match record {
                // It is in the list already, or it is an unknown of this problem.
                _ if places.contains(&place) || chosen(name) => continue,
                Some(record) => problem.input_of(record, &calibration.estimate)?,
                // The file has no identities: inputs are found by name only.
                None => match self.inputs.iter().position(|input| input.name == *name) {
                    Some(index) => {
                        Unknown { name: name.clone(), unit: self.inputs[index].unit, owner: Owner::Input, index }
                    }
                    None => continue,
                },
            };
            let identity = Some(problem.inputs[unknown.index].identity.clone());
            known.push((unknown, identity));
            places.push(place);
        }
        problem.considered.take(|unknown| {
            known.iter().any(|(known, _)| (known.owner, known.index) == (unknown.owner, unknown.index))
        });
        let rows = &calibration.covariance.rows;
        let entry = |row: usize| places.iter().map(|&column| rows[row][column]).collect();
        let covariance: Vec<Vec<f64>> = places.iter().map(|&row| entry(row)).collect();
        problem.priors.extend(self.prior(calibration, &known, &places)?);
        problem.considered.extend(known, &covariance, &calibration.estimate);
        Ok(problem)
    }

    /// What a calibration knows of the unknowns, with what is considered of it and the places of that in its covariance. None
    /// if it has estimated none of the unknowns. Fails if one of them has another unit there.
    fn prior(
        &self,
        calibration: &Calibration,
        considered: &[(Unknown, Option<String>)],
        places: &[usize],
    ) -> Result<Option<Prior>> {
        let own = |unknown: &Unknown| Some((unknown.clone(), calibration.covariance.index(&unknown.name)?));
        let (mut unknowns, mut all): (Vec<Unknown>, Vec<usize>) = self.unknowns.iter().filter_map(own).unzip();
        let found = |unknown: &Unknown| calibration.get(&unknown.name);
        let values: Vec<f64> = unknowns.iter().filter_map(|unknown| Some(found(unknown)?.value)).collect();
        if unknowns.is_empty() || values.len() < unknowns.len() {
            return Ok(None);
        }
        let of_unit = |unknown: &&Unknown| found(unknown).is_some_and(|found| found.unit != unknown.unit.to_string());
        if let Some(unknown) = unknowns.iter().find(of_unit) {
            let message = format!(
                "`{}` is in {} here and has another unit in `{}`: the models differ",
                unknown.name, unknown.unit, calibration.estimate
            );
            return Err(Error::data(message).setting("known"));
        }
        let lost = |unknown: &&Unknown| found(unknown).is_some_and(|found| found.status == Status::Confounded);
        let confounded = unknowns.iter().filter(lost).map(|unknown| unknown.name.clone()).collect();
        unknowns.extend(considered.iter().map(|(unknown, _)| unknown.clone()));
        all.extend(places);
        let rows = &calibration.covariance.rows;
        let covariance = all.iter().map(|&row| all.iter().map(|&column| rows[row][column]).collect()).collect();
        Ok(Some(Prior { estimate: calibration.estimate.clone(), unknowns, values, covariance, confounded }))
    }

    /// Considers an input of another estimate. If its name is taken, `estimate` becomes a prefix of the name.
    pub fn consider(&mut self, record: &ConsideredInput, estimate: &str) -> Result<()> {
        let unknown = self.input_of(record, estimate)?;
        self.considered.take(|other| (other.owner, other.index) == (unknown.owner, unknown.index));
        self.considered.push_input(unknown, record.identity.clone(), record.standard_uncertainty);
        Ok(())
    }

    /// Everything that could be estimated here.
    fn candidates(&self) -> Vec<Unknown> {
        tie::tied(candidates(self.model.as_ref(), &self.sets), &self.ties)
    }

    /// The input of an earlier estimate: an input of this problem, or a new one that no set of this problem uses.
    fn input_of(&mut self, record: &ConsideredInput, estimate: &str) -> Result<Unknown> {
        let uncertain = |input: &&Input| input.standard_uncertainty > 0.0 && input.identity == record.identity;
        if let Some(input) = self.inputs.iter().find(uncertain) {
            let own = ConsideredInput {
                name: input.name.clone(),
                identity: input.identity.clone(),
                value: input.value(&self.sets),
                unit: input.unit.to_string(),
                standard_uncertainty: input.standard_uncertainty,
                sensitivities: Vec::new(),
            };
            own.agrees_with(record)?;
            let index = self.inputs.iter().position(|other| other.name == input.name).unwrap_or_default();
            return Ok(Unknown { name: input.name.clone(), unit: input.unit, owner: Owner::Input, index });
        }
        let taken = |name: &str| {
            let names = self.candidates().into_iter().map(|unknown| unknown.name);
            names.chain(self.inputs.iter().map(|input| input.name.clone())).any(|other| other == name)
        };
        let name = match taken(&record.name) {
            true => format!("{estimate}:{}", record.name),
            false => record.name.clone(),
        };
        let unit = record.unit.parse().map_err(|error| Error::data(format!("`{name}`: {error}")))?;
        let index = self.inputs.len();
        self.inputs.push(Input {
            name: name.clone(),
            identity: record.identity.clone(),
            unit,
            stated: record.value,
            standard_uncertainty: record.standard_uncertainty,
            users: Vec::new(),
        });
        Ok(Unknown { name, unit, owner: Owner::Input, index })
    }
}

/// The parameters of a model and the own unknowns of some sets, in this order.
pub(crate) fn candidates(model: &dyn KinematicModel, sets: &[ObservationSet]) -> Vec<Unknown> {
    let machine = model.info().parameters.iter().enumerate();
    let mut candidates: Vec<Unknown> = machine
        .map(|(index, Parameter { name, unit, .. })| Unknown {
            name: name.clone(),
            unit: *unit,
            owner: Owner::Machine,
            index,
        })
        .collect();
    for (set, observations) in SetIndex::enumerate(sets) {
        let own = observations.observations.info().unknowns.iter().enumerate();
        candidates.extend(own.map(|(index, parameter)| Unknown {
            name: format!("{}.{}", observations.name, parameter.name),
            unit: parameter.unit,
            owner: Owner::Set(set),
            index,
        }));
    }
    candidates
}
