//! The machines of a recipe, for people who look at them before they measure: geometry, errors, independent location errors.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{Error, Identifiability, Kind, KinematicModel, PathItem, Plugin, Registry, Result};
use abbe_estimation::{LocationErrors, Standing, location_errors};
use abbe_recipe::{Recipe, Stage};
use serde_json::{Value, json};

use crate::prepare::{Prepared, prepared};

/// A machine.
pub struct Described {
    /// Name of the model stage.
    pub stage: String,
    /// Its plugin.
    pub plugin: String,
    /// The machine with the errors that the recipe lists.
    pub model: Arc<dyn KinematicModel>,
    /// All location errors of its chain, listed or not; none for a model that lists no errors line by line.
    pub locations: Option<LocationErrors>,
}

/// A machine by itself: the text is a recipe of a model stage alone, with paths relative to the folder of `path`.
///
/// Fails with what is wrong with the machine.
pub fn prepare_text(path: &Path, text: &str, registry: &Registry) -> Result<Prepared> {
    prepared(Recipe::parse(path, text, registry)?, registry)
}

impl Prepared {
    /// The machines of all model stages.
    pub fn described(&self) -> Result<Vec<Described>> {
        let mut all = Vec::new();
        for stage in self.stages(Kind::Model) {
            let model = self.located(stage, self.models[&stage.name].build(&[]))?;
            let locations = self.located(stage, self.location_errors(&stage.name))?;
            all.push(Described { stage: stage.name.clone(), plugin: stage.plugin.clone(), model, locations });
        }
        Ok(all)
    }

    /// All location errors of the chain of a machine; none for a model that does not list errors.
    fn location_errors(&self, machine: &str) -> Result<Option<LocationErrors>> {
        let all = self.with_locations.get(machine).map(|all| all.build(&[])).transpose()?;
        all.map(|all| location_errors(all.as_ref())).transpose()
    }

    /// What stands on this chain in the place of location errors that the data of an estimate cannot tell: sentences.
    pub(crate) fn substitutes(&self, estimate: &Stage, found: &Identifiability) -> Vec<String> {
        let lost: BTreeSet<&str> = (found.null_space.iter())
            .flat_map(|vector| vector.combination.iter().map(|part| part.name.as_str()))
            .collect();
        if lost.is_empty() {
            return Vec::new();
        }
        let machine = self.machine_stage(estimate).map(|stage| stage.name.as_str()).unwrap_or_default();
        let Ok(Some(locations)) = self.location_errors(machine) else { return Vec::new() };
        lost.into_iter().filter_map(|name| substitute(&locations, name)).collect()
    }

    /// An error about a location error that is not listed, with what it is on this chain.
    pub(crate) fn with_substitute(&self, estimate: &Stage, error: Error) -> Error {
        let [PathItem::Key(key), PathItem::Index(index)] = error.setting.as_slice() else { return error };
        let Some(pattern) = estimate.parameters.get(*index).filter(|_| key == "parameters") else { return error };
        let machine = self.machine_stage(estimate).map(|stage| stage.name.as_str()).unwrap_or_default();
        let Ok(Some(locations)) = self.location_errors(machine) else { return error };
        let help = match (locations.get(pattern), substitute(&locations, pattern)) {
            (Some(_), Some(substitute)) => substitute,
            (Some(_), None) => format!("`{pattern}` is an error of this chain: list it under `errors` of the machine"),
            (None, _) => return error,
        };
        error.help(help)
    }
}

/// What does the same as a location error on this chain: a sentence; none for one that is independent.
fn substitute(locations: &LocationErrors, name: &str) -> Option<String> {
    match &locations.get(name)?.standing {
        Standing::Independent { .. } => None,
        Standing::SetUp => Some(format!(
            "on this chain `{name}` does what offsets and turns of workpiece and tool do: leave it out (`abbe model` lists the independent ones)"
        )),
        Standing::Dependent(of) => {
            let names: Vec<String> = of.iter().map(|(name, _)| format!("`{name}`")).collect();
            Some(format!(
                "on this chain `{name}` does what {} with the set-up: estimate {} in its place (`abbe model` lists the independent ones)",
                if names.len() == 1 { format!("{} does", names[0]) } else { format!("{} do", names.join(" and ")) },
                if names.len() == 1 { "that one" } else { "those" }
            ))
        }
    }
}

/// Settings of a machine that has all location errors of its chain and no others; none for a model without a list of errors.
pub(crate) fn with_all_locations(plugin: &Plugin, settings: &Value) -> Option<Value> {
    let schema = plugin.schema.get();
    schema.get("properties")?.get("errors")?;
    let mut all = settings.clone();
    let own = all.as_object_mut()?;
    own.insert("errors".to_owned(), json!([{ "location": ["E?0*"] }]));
    own.shift_remove("bodies");
    Some(all)
}
