//! Which stages a stage refers to, and the order that follows from it.

use std::collections::{BTreeMap, BTreeSet};

use abbe_core::{Error, EstimateSource, Kind, Plugin};

use crate::Head;
use crate::document::{At, Node};

/// A key of a stage that names other stages.
pub(crate) struct Reference {
    pub key: &'static str,
    /// The kind of stage that it takes.
    pub kind: Kind,
    /// Another kind that it takes as well.
    pub or: Option<Kind>,
    pub required: bool,
    /// More than one stage can be named.
    pub many: bool,
}

const fn reference(key: &'static str, kind: Kind, required: bool, many: bool) -> Reference {
    Reference { key, kind, or: None, required, many }
}

/// A machine: a model, or the one that an estimate has.
const fn machine(required: bool) -> Reference {
    Reference { key: "machine", kind: Kind::Model, or: Some(Kind::Estimate), required, many: false }
}

/// The reference keys of the stages of a plugin.
pub(crate) fn references(plugin: &Plugin) -> &'static [Reference] {
    const ARTEFACT: &[Reference] =
        &[reference("from", Kind::Ingest, true, false), reference("repeats", Kind::Ingest, false, false)];
    const MODEL: &[Reference] =
        &[reference("machine", Kind::Estimate, false, false), reference("logs", Kind::Ingest, false, true)];
    const STATEMENT: &[Reference] = &[machine(true)];
    const ESTIMATES: &[Reference] = &[reference("of", Kind::Estimate, true, true), machine(false)];
    const ESTIMATE: &[Reference] = &[
        machine(true),
        reference("observations", Kind::Artefact, true, true),
        reference("known", Kind::Estimate, false, false),
        reference("start", Kind::Estimate, false, false),
        reference("of", Kind::Estimate, false, false),
    ];
    const READINGS: &[Reference] = &[reference("from", Kind::Ingest, true, true)];
    const ANALYSIS: &[Reference] = &[reference(ANALYSED, Kind::Estimate, true, false)];
    const VALIDATE: &[Reference] = &[
        reference("of", Kind::Estimate, true, true),
        reference("from", Kind::Ingest, false, true),
        reference("observations", Kind::Artefact, false, true),
        reference("exports", Kind::Export, false, true),
    ];
    const VALIDATE_READINGS: &[Reference] =
        &[reference("of", Kind::Estimate, false, true), reference("from", Kind::Ingest, true, true)];
    const EXPORT: &[Reference] = &[reference("of", Kind::Estimate, true, false)];
    match plugin.kind() {
        Kind::Ingest => &[],
        Kind::Model => MODEL,
        Kind::Artefact => ARTEFACT,
        Kind::Estimate => match plugin.estimate_source {
            EstimateSource::Measurements => ESTIMATE,
            EstimateSource::Analysis => ANALYSIS,
            EstimateSource::Statement => STATEMENT,
            EstimateSource::Calibration => &[],
            EstimateSource::Combination => ESTIMATES,
            EstimateSource::Readings => READINGS,
        },
        Kind::Validate if plugin.estimate_source == EstimateSource::Readings => VALIDATE_READINGS,
        Kind::Validate => VALIDATE,
        Kind::Export => EXPORT,
    }
}

/// The key of an estimate that analyses another one, and takes machine, observations and parameters from it.
pub(crate) const ANALYSED: &str = "of";

/// Whether a stage analyses another estimate.
pub(crate) fn is_analysis(stage: &Head<'_>) -> bool {
    stage.plugin.kind() == Kind::Estimate
        && stage.plugin.estimate_source.may_analyse()
        && stage.node.get(ANALYSED).is_some()
}

impl Reference {
    fn takes(&self) -> String {
        let Self { key, kind, or, many, .. } = self;
        let kind = or.map_or(kind.to_string(), |or| format!("{kind} or {or}"));
        format!(
            "`{key}` takes {} {kind} stage{}",
            if *many { "one or more" } else { "one" },
            if *many { "s" } else { "" }
        )
    }

    /// The names that `stage` gives under this key.
    pub fn read<'a>(&self, stage: &Head<'a>, heads: &[Head<'a>]) -> Result<Vec<Node<'a>>, Error> {
        let Some(node) = stage.node.get(self.key) else {
            let missing = || stage.node.missing(&[self.key], format!("`{}` is missing: {}", self.key, self.takes()));
            let inherits = is_analysis(stage);
            return if self.required && !inherits { Err(missing()) } else { Ok(Vec::new()) };
        };
        let names = if node.value.is_array() { node.list()? } else { vec![node.clone()] };
        if names.is_empty() && self.required || names.len() > 1 && !self.many {
            return Err(node.error(At::Value, format!("{}, not {}", self.takes(), names.len())));
        }
        let mut seen = BTreeSet::new();
        for node in &names {
            let name = node.text()?;
            match heads.iter().find(|head| head.name == name) {
                None => {
                    let fitting = heads.iter().filter(|head| head.plugin.kind() == self.kind).map(|head| head.name);
                    return Err(node.error(At::Value, format!("there is no stage `{name}`")).suggest(name, fitting));
                }
                Some(other) if ![Some(self.kind), self.or].contains(&Some(other.plugin.kind())) => {
                    let kind = other.plugin.kind();
                    let article = if matches!(kind, Kind::Model | Kind::Validate) { "a" } else { "an" };
                    let message = format!("{}; `{name}` is {article} {kind} stage", self.takes());
                    return Err(node.error(At::Value, message));
                }
                Some(_) if !seen.insert(name) => {
                    return Err(node.error(At::Value, format!("`{}` names `{name}` a second time", self.key)));
                }
                Some(_) => {}
            }
        }
        Ok(names)
    }
}

/// The stages, each after those that it refers to, otherwise as in the file.
pub(crate) fn order(heads: &[Head<'_>], references: &[Vec<Node<'_>>]) -> Result<Vec<usize>, Error> {
    let index: BTreeMap<&str, usize> = heads.iter().enumerate().map(|(i, head)| (head.name, i)).collect();
    let target = |node: &Node<'_>| node.value.as_str().and_then(|name| index.get(name)).copied();
    let mut waits: Vec<usize> = references.iter().map(Vec::len).collect();
    let mut used_by = vec![Vec::new(); heads.len()];
    for (user, nodes) in references.iter().enumerate() {
        nodes.iter().filter_map(target).for_each(|used| used_by[used].push(user));
    }
    let mut ready: BTreeSet<usize> = (0..heads.len()).filter(|&stage| waits[stage] == 0).collect();
    let mut order = Vec::new();
    while let Some(stage) = ready.pop_first() {
        order.push(stage);
        for &user in &used_by[stage] {
            waits[user] -= 1;
            if waits[user] == 0 {
                ready.insert(user);
            }
        }
    }
    // Every stage that waits refers to another stage that waits: following these references leads to the cycle.
    let Some(mut stage) = waits.iter().position(|&count| count > 0) else { return Ok(order) };
    let mut way: Vec<(usize, &Node<'_>)> = Vec::new();
    loop {
        let next =
            references[stage].iter().find_map(|node| Some((target(node)?, node)).filter(|next| waits[next.0] > 0));
        let Some((next, node)) = next else { return Ok(order) };
        way.push((stage, node));
        if let Some(start) = way.iter().position(|(stage, _)| *stage == next) {
            let names: Vec<&str> =
                way[start..].iter().map(|(stage, _)| heads[*stage].name).chain([heads[next].name]).collect();
            let circle = names.join(" -> ");
            return Err(way[start].1.error(At::Value, format!("the stages refer to each other in a circle: {circle}")));
        }
        stage = next;
    }
}
