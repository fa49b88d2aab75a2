//! Ties: several parameters of the machine that are one unknown, each times a factor: a common scale, mirrored errors.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::considered::candidates;
use super::{Owner, Problem, Unknown};
use crate::model::KinematicModel;
use abbe_results::Calibration;
use abbe_settings::{Error, PathItem, Result, Unit, matches};

/// What is declared of a tie: `EXX[1]: scale`, or `EYY[1]: { to: scale, factor: -1 }`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DeclaredTie {
    /// The tied parameters: a name, or a pattern.
    pub pattern: String,
    /// The name of the unknown.
    pub to: String,
    /// What of it each of these parameters is.
    pub factor: f64,
}

/// An unknown that several parameters of the machine are, each times a factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Tie {
    /// Its name.
    pub name: String,
    /// Its unit, which is that of all members.
    pub unit: Unit,
    /// Index among the parameters of the machine, and factor.
    pub members: Vec<(usize, f64)>,
}

/// The ties that are declared, with the parameters of the machine that they tie.
///
/// Fails for patterns that match no parameter, parameters that are tied twice, other units, factors that are no numbers, and a tie of
/// one parameter alone.
pub(crate) fn ties(declared: &[DeclaredTie], candidates: &[Unknown]) -> Result<Vec<Tie>> {
    let mut ties: Vec<Tie> = Vec::new();
    let wrong = |declared: &DeclaredTie, message: String| {
        let mut error = Error::usage(message);
        error.setting = ["tie", &declared.pattern].map(|key| PathItem::Key(key.to_owned())).into();
        error
    };
    let of_machine = || candidates.iter().filter(|candidate| candidate.owner == Owner::Machine);
    let machine = |name: &str| of_machine().find(|candidate| candidate.name == name);
    for tie in declared {
        if !tie.factor.is_finite() || tie.factor == 0.0 {
            return Err(wrong(tie, "a finite factor that is not 0 was expected".to_owned()));
        }
        if let Some(own) = candidates.iter().find(|it| it.name == tie.to && it.owner != Owner::Machine) {
            return Err(of_artefact(wrong, tie, &own.name));
        }
        let mut found: Vec<(&Unknown, f64)> = of_machine()
            .filter(|candidate| matches(&tie.pattern, &candidate.name))
            .map(|it| (it, tie.factor))
            .collect();
        if tie.factor != 1.0 && matches(&tie.pattern, &tie.to) {
            return Err(wrong(tie, format!("`{}` would be {} times itself", tie.to, tie.factor)));
        }
        if found.is_empty()
            && let Some(own) = candidates.iter().find(|candidate| matches(&tie.pattern, &candidate.name))
        {
            return Err(of_artefact(wrong, tie, &own.name));
        }
        if found.is_empty() {
            let error = wrong(tie, format!("`{}` matches no parameter of the machine", tie.pattern));
            let names = of_machine().map(|candidate| candidate.name.as_str());
            return Err(error
                .help("a machine parameter exists only if the model's `errors` list it")
                .suggest(&tie.pattern, names));
        }
        // An unknown that has the name of a parameter is that parameter, too.
        found.extend(machine(&tie.to).filter(|own| !matches(&tie.pattern, &own.name)).map(|own| (own, 1.0)));
        for (member, factor) in found {
            let known = ties.iter().find(|other| other.members.iter().any(|(index, _)| *index == member.index));
            if let Some(known) = known {
                if known.name == tie.to && member.name == tie.to {
                    continue;
                }
                return Err(wrong(tie, format!("`{}` is tied to `{}` already", member.name, known.name)));
            }
            match ties.iter_mut().find(|other| other.name == tie.to) {
                Some(other) if other.unit != member.unit => {
                    let message = format!(
                        "`{}` is in {}, `{}` in {}: they cannot be one number",
                        member.name, member.unit, tie.to, other.unit
                    );
                    return Err(wrong(tie, message));
                }
                Some(other) => other.members.push((member.index, factor)),
                None => {
                    ties.push(Tie { name: tie.to.clone(), unit: member.unit, members: vec![(member.index, factor)] })
                }
            }
        }
    }
    if let Some(alone) = ties.iter().find(|tie| tie.members.len() < 2)
        && let Some(declared) = declared.iter().find(|declared| declared.to == alone.name)
    {
        return Err(wrong(declared, format!("nothing else is tied to `{}`", alone.name)));
    }
    Ok(ties)
}

/// Why an unknown of an artefact is not tied.
fn of_artefact(wrong: impl Fn(&DeclaredTie, String) -> Error, tie: &DeclaredTie, name: &str) -> Error {
    let message = format!(
        "`{name}` is an unknown of an artefact, and parameters of the machine are tied: what is unknown of an artefact belongs to its \
         observations, which are judged and repeated without those of other stages"
    );
    wrong(tie, message).help(
        "for one unknown of several files read them by one `ingest` stage (`path: [a.csv, b.csv]`) and observe that",
    )
}

/// Candidates with the tied parameters replaced by the unknowns that they are, each in the place of its first member.
pub(crate) fn tied(candidates: Vec<Unknown>, ties: &[Tie]) -> Vec<Unknown> {
    let mut all = Vec::with_capacity(candidates.len());
    for candidate in candidates {
        let of = ties.iter().position(|tie| candidate.owner == Owner::Machine && tie.has(candidate.index));
        match of {
            None => all.push(candidate),
            Some(index) if ties[index].members[0].0 == candidate.index => {
                let Tie { name, unit, .. } = ties[index].clone();
                all.push(Unknown { name, unit, owner: Owner::Tie, index });
            }
            Some(_) => {}
        }
    }
    all
}

impl Tie {
    /// The ties that are declared for a machine.
    pub fn declared(model: &dyn KinematicModel, declared: &[DeclaredTie]) -> Result<Vec<Self>> {
        ties(declared, &candidates(model, &[]))
    }

    /// Whether a parameter of the machine is a member.
    pub fn has(&self, parameter: usize) -> bool {
        self.members.iter().any(|(index, _)| *index == parameter)
    }
}

impl Unknown {
    /// Whether it is a parameter of the model, or several of them.
    pub fn is_of_machine(&self) -> bool {
        matches!(self.owner, Owner::Machine | Owner::Tie)
    }
}

impl Problem {
    /// The parameters of the machine that an unknown is, by their indices, each with its factor.
    pub fn members_of(&self, unknown: &Unknown) -> &[(usize, f64)] {
        const ITSELF: &[(usize, f64)] = &[];
        match unknown.owner {
            Owner::Tie => self.ties.get(unknown.index).map_or(ITSELF, |tie| &tie.members),
            Owner::Machine | Owner::Set(_) | Owner::Input => ITSELF,
        }
    }

    /// The parameters of the machine that are estimated, those that are tied one by one.
    pub fn machine_unknowns(&self) -> Vec<Unknown> {
        let parameters = &self.model.info().parameters;
        let of = |unknown: &Unknown| -> Vec<Unknown> {
            let member = |&(index, _): &(usize, f64)| Unknown {
                name: parameters[index].name.clone(),
                unit: parameters[index].unit,
                owner: Owner::Machine,
                index,
            };
            match unknown.owner {
                Owner::Machine => vec![unknown.clone()],
                _ => self.members_of(unknown).iter().map(member).collect(),
            }
        };
        self.unknowns.iter().flat_map(of).collect()
    }

    /// Where a parameter of the machine is among some unknowns, itself or tied: its index there and its factor.
    pub fn place_among(&self, parameter: usize, unknowns: &[Unknown]) -> Option<(usize, f64)> {
        unknowns.iter().enumerate().find_map(|(place, unknown)| match unknown.owner {
            Owner::Machine if unknown.index == parameter => Some((place, 1.0)),
            _ => {
                let mut members = self.members_of(unknown).iter();
                members.find(|(index, _)| *index == parameter).map(|(_, factor)| (place, *factor))
            }
        })
    }

    /// Gives the members of tied unknowns their values, uncertainties and covariances in a calibration that has those of the tied
    /// unknowns.
    pub fn untie(&self, calibration: &mut Calibration) {
        let parameters = &self.model.info().parameters;
        for unknown in
            self.unknowns.iter().chain(&self.considered.unknowns).filter(|unknown| unknown.owner == Owner::Tie)
        {
            let Some((value, standard_uncertainty)) =
                calibration.get(&unknown.name).map(|found| (found.value, found.standard_uncertainty))
            else {
                continue;
            };
            for &(index, factor) in self.members_of(unknown) {
                let name = &parameters[index].name;
                calibration.covariance.add_multiple(&unknown.name, name, factor);
                for member in calibration.parameters.iter_mut().filter(|member| member.name == *name) {
                    member.value = value * factor;
                    member.standard_uncertainty = standard_uncertainty * factor.abs();
                }
            }
        }
    }
}
