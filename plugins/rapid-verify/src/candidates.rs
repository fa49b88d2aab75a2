//! What may have changed: parameters of the machine, alone or together, and the artefact.

use std::collections::BTreeMap;

use abbe_core::{AxisKind, Error, KinematicModel, ParameterRole, PathItem, Quantity, Result, Unit, matches};
use schemars::JsonSchema;
use serde::Deserialize;

use crate::diagnosis::Pattern;
use crate::points::Touch;

/// The parameters that may have changed.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Names(pub Vec<String>);

impl Default for Names {
    fn default() -> Self {
        Self(vec!["*".to_owned()])
    }
}

/// Parameters that change by the same amount, by the name of what they are together.
pub type ParameterGroups = BTreeMap<String, Vec<String>>;

/// What may have changed, as the settings `candidates` and `together` have it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Candidates {
    /// Patterns of single parameters.
    pub names: Names,
    /// Parameters that change together.
    pub together: ParameterGroups,
    /// Patterns mean the places of linear axes, too.
    pub places: bool,
}

impl Candidates {
    /// The candidates and what can happen to the artefact, without their effects. What is among `together` under its own name
    /// is no candidate by itself.
    pub fn of(&self, model: &dyn KinematicModel) -> Result<Vec<Pattern>> {
        let parameters = &model.info().parameters;
        let mut chosen = vec![false; parameters.len()];
        for (index, pattern) in self.names.0.iter().enumerate() {
            let found = found(model, pattern).map_err(|error| at(error, "candidates", PathItem::Index(index)))?;
            let named = |parameter: &usize| {
                self.places || parameters[*parameter].name == *pattern || !is_zero(model, *parameter)
            };
            found.into_iter().filter(named).for_each(|parameter| chosen[parameter] = true);
        }
        let single = parameters.iter().enumerate().filter(|(index, _)| chosen[*index]);
        let single = single.filter(|(_, parameter)| !self.together.contains_key(&parameter.name));
        let mut patterns: Vec<Pattern> = single
            .map(|(index, parameter)| Pattern {
                name: parameter.name.clone(),
                unit: parameter.unit,
                effect: Vec::new(),
                parameters: vec![index],
            })
            .collect();
        for (name, members) in &self.together {
            let of_group = |error| at(error, "together", PathItem::Key(name.clone()));
            let mut group: Vec<usize> = Vec::new();
            for member in members {
                group.extend(found(model, member).map_err(of_group)?);
            }
            group.sort_unstable();
            group.dedup();
            let units: Vec<Unit> = group.iter().map(|&index| parameters[index].unit).collect();
            let Some(&unit) = units.first() else {
                return Err(of_group(Error::usage("at least one parameter was expected")));
            };
            if units.iter().any(|other| *other != unit) {
                return Err(of_group(Error::usage("parameters that change together have to be of one unit")));
            }
            patterns.push(Pattern { name: name.clone(), unit, effect: Vec::new(), parameters: group });
        }
        patterns.extend(of_the_artefact());
        Ok(patterns)
    }
}

/// The parameters that a pattern matches.
pub fn found(model: &dyn KinematicModel, pattern: &str) -> Result<Vec<usize>> {
    let parameters = &model.info().parameters;
    let found: Vec<usize> = (0..parameters.len()).filter(|&index| matches(pattern, &parameters[index].name)).collect();
    if found.is_empty() {
        let names = parameters.iter().map(|parameter| parameter.name.as_str());
        return Err(Error::usage(format!("`{pattern}` matches no parameter of the machine"))
            .help("a parameter exists only if the model's `errors` list it")
            .suggest(pattern, names));
    }
    Ok(found)
}

/// Whether a parameter is the place of a linear axis, which only says where the machine counts from: a linear axis has a direction
/// alone (ISO 230-1). A pattern does not mean it; its name does.
fn is_zero(model: &dyn KinematicModel, parameter: usize) -> bool {
    let info = model.info();
    match info.parameters[parameter].role {
        ParameterRole::Location { axis, component } => component < 3 && info.axes[axis].kind == AxisKind::Linear,
        _ => false,
    }
}

/// The error at a place of a setting.
fn at(error: Error, setting: &str, item: PathItem) -> Error {
    let mut error = error.setting(setting);
    error.setting.push(item);
    error
}

/// Adds the effects of patterns on the reading of one more touch, at these values of the parameters.
pub fn add_effects(patterns: &mut [Pattern], touch: &Touch<'_>, values: &[f64]) -> Result<()> {
    let wanted: Vec<usize> = patterns.iter().flat_map(|pattern| pattern.parameters.iter().copied()).collect();
    let (by_parameter, by_artefact) = touch.sensitivities(values, &wanted)?;
    let (mut by_parameter, mut by_artefact) = (by_parameter.into_iter(), by_artefact.into_iter());
    for pattern in patterns {
        let effect = match pattern.parameters.len() {
            0 => by_artefact.next().unwrap_or_default(),
            count => by_parameter.by_ref().take(count).sum(),
        };
        pattern.effect.push(effect);
    }
    Ok(())
}

/// The possible changes of the artefact, in the order of [`Touch::sensitivities`].
fn of_the_artefact() -> impl Iterator<Item = Pattern> {
    let names = [
        ("shift of the artefact along x", Unit::MM),
        ("shift of the artefact along y", Unit::MM),
        ("shift of the artefact along z", Unit::MM),
        ("turn of the artefact about x", Unit::RAD),
        ("turn of the artefact about y", Unit::RAD),
        ("turn of the artefact about z", Unit::RAD),
        ("expansion of the artefact", Unit::per(Quantity::Length, Quantity::Length, 1)),
    ];
    names.into_iter().map(|(name, unit)| Pattern {
        name: name.to_owned(),
        unit,
        effect: Vec::new(),
        parameters: Vec::new(),
    })
}
