//! The machines of a recipe, for people who look at them before they measure: geometry, errors, independent location errors.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{Error, Identifiability, Kind, KinematicModel, PathItem, Plugin, Problem, Registry, Result, matches};
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

    /// What is to be done about location errors of the chain that do what others of the same estimate do: sentences.
    pub(crate) fn substitutes(&self, estimate: &Stage, problem: &Problem, found: &Identifiability) -> Vec<String> {
        let lost: BTreeSet<&str> = (found.null_space.iter())
            .flat_map(|vector| vector.combination.iter().map(|part| part.name.as_str()))
            .collect();
        if lost.is_empty() {
            return Vec::new();
        }
        let machine = self.machine_stage(estimate).map(|stage| stage.name.as_str()).unwrap_or_default();
        let Ok(Some(locations)) = self.location_errors(machine) else { return Vec::new() };
        let estimated: Vec<&str> = problem.unknowns.iter().map(|unknown| unknown.name.as_str()).collect();
        superfluous(&locations, &estimated).into_iter().filter(|(name, _)| lost.contains(name)).map(told).collect()
    }

    /// An error about a location error that is not listed, with what it is on this chain.
    pub(crate) fn with_substitute(&self, estimate: &Stage, model: &dyn KinematicModel, error: Error) -> Error {
        let [PathItem::Key(key), PathItem::Index(index)] = error.setting.as_slice() else { return error };
        let Some(pattern) = estimate.parameters.get(*index).filter(|_| key == "parameters") else { return error };
        let machine = self.machine_stage(estimate).map(|stage| stage.name.as_str()).unwrap_or_default();
        let Ok(Some(locations)) = self.location_errors(machine) else { return error };
        let listed: Vec<&str> = model.info().parameters.iter().map(|parameter| parameter.name.as_str()).collect();
        let is_estimated = |name: &&str| estimate.parameters.iter().any(|pattern| matches(pattern, name));
        let estimated: Vec<&str> = listed.iter().copied().filter(is_estimated).collect();
        match instead(&locations, pattern, &estimated, &listed) {
            Some(help) => error.help(help),
            None => error,
        }
    }
}

/// The location errors of an estimate that do what set-up or others of the estimate do, which stay: those rather that are
/// independent by convention. Each with the others; none for what set-up does.
fn superfluous<'a>(locations: &LocationErrors, estimated: &[&'a str]) -> Vec<(&'a str, Vec<String>)> {
    let is_independent =
        |name: &&str| locations.get(name).is_some_and(|error| matches!(error.standing, Standing::Independent { .. }));
    let (mut kept, others): (Vec<&str>, Vec<&str>) = estimated.iter().copied().partition(is_independent);
    let mut found = Vec::new();
    for name in others {
        match locations.same_as(name, &kept) {
            Some(same) => found.push((name, same)),
            None => kept.push(name),
        }
    }
    found
}

/// What to do about a superfluous location error: a sentence.
fn told((name, same): (&str, Vec<String>)) -> String {
    match same.as_slice() {
        [] => format!(
            "on this chain `{name}` does what offsets and turns of workpiece and tool do: leave it out (`abbe model` lists the independent ones)"
        ),
        _ => format!(
            "on this chain `{name}` does what {} with the set-up, and that is estimated already: leave `{name}` out",
            does(&same)
        ),
    }
}

/// `EC0X` does, `EC0X` and `EA0Y` do.
fn does(names: &[String]) -> String {
    format!("{} {}", and(names), if names.len() == 1 { "does" } else { "do" })
}

fn and(names: &[String]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    quoted.join(" and ")
}

/// What to do about a location error that is to be estimated and that the machine does not list: a sentence; none for what is no
/// location error of the chain. Errors that are estimated or listed are named before others.
fn instead(locations: &LocationErrors, name: &str, estimated: &[&str], listed: &[&str]) -> Option<String> {
    locations.get(name)?;
    if let Some(same) = locations.same_as(name, estimated) {
        return Some(told((name, same)));
    }
    let independent: Vec<&str> =
        locations.independent().map(|error| error.name.as_str()).filter(|own| *own != name).collect();
    let Some(same) = locations.same_as(name, &[estimated, listed, &independent].concat()) else {
        return Some(format!("`{name}` is an error of this chain: list it under `errors` of the machine"));
    };
    let of = |is_wanted: &dyn Fn(&str) -> bool| -> Vec<String> {
        same.iter().filter(|name| is_wanted(name)).cloned().collect()
    };
    let there = of(&|name| estimated.contains(&name));
    let rest = of(&|name| !estimated.contains(&name));
    let unlisted = of(&|name| !listed.contains(&name));
    let mut help = format!(
        "on this chain `{name}` does what {} with the set-up: estimate {} in its place",
        does(&same),
        and(&rest)
    );
    if !there.is_empty() {
        help.push_str(&format!("; {} estimated already", is(&there)));
    }
    if !unlisted.is_empty() {
        help.push_str(&format!("; {} to be listed under `errors` of the machine", has(&unlisted)));
    }
    Some(help)
}

fn is(names: &[String]) -> String {
    format!("{} {}", and(names), if names.len() == 1 { "is" } else { "are" })
}

fn has(names: &[String]) -> String {
    format!("{} {}", and(names), if names.len() == 1 { "has" } else { "have" })
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
