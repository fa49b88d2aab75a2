//! The truth: the true values of the machine, the artefacts and the known inputs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{Error, PathItem, Problem, Result, SettingsError, from_json, from_settings, nearest};
use serde_json::{Map, Value};

use crate::names::NotSimulated;
use crate::noise::{Noise, finite};

/// The true values behind simulated measurements.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Truth {
    /// Values by name, in mm and rad: parameters of the machine; own unknowns of artefacts (`facet[3].d`, or
    /// `table.facet[3].d` for those of one stage alone); known inputs (`stylus_radius`, `bar.reference_error`).
    ///
    /// A value that is not named is zero. Inputs, and unknowns whose start value is not zero, are then nominal.
    pub parameters: BTreeMap<String, f64>,
    /// How the measurement differs from the truth.
    pub noise: Noise,
}

impl Truth {
    /// Reads the text of a truth file: JSON with `parameters` and, if there is any, `noise`. Other keys are notes.
    ///
    /// Fails, with the place, for text that is no JSON, for values that are not finite and for negative sizes. Keys of
    /// `noise` that are not simulated give warnings.
    pub fn parse(file: &Path, text: &str) -> Result<Self> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let content: Value = from_json(text).map_err(|error| {
            let message = error.to_string();
            let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(message, _)| message);
            let wrong = match error.is_data() {
                true => Error::usage(message).help("keep the one that is right"),
                false => Error::usage(format!("this is no JSON: {message}")),
            };
            wrong.at(file, error.line(), Some(error.column().max(1)))
        })?;
        Self::from_json(&content).and_then(|truth| truth.check().map(|()| truth)).map_err(|error| error.in_file(file))
    }

    fn from_json(content: &Value) -> Result<Self> {
        let missing = || {
            Error::usage("`parameters` is missing: a map of names and values in mm and rad was expected")
                .help("for example { \"parameters\": { \"EA0B\": 1e-5 }, \"noise\": {} }")
        };
        let parameters = content.get("parameters").ok_or_else(missing)?;
        warn_of_others(content);
        let parameters = from_settings(parameters).map_err(|error| wrong(error.under([key("parameters")])))?;
        let noise = match content.get("noise") {
            None | Some(Value::Null) => Noise::default(),
            Some(Value::Object(noise)) => {
                Noise::from_json(noise).map_err(|error| wrong(error.under([key("noise")])))?
            }
            Some(_) => return Err(Error::usage("noise: a map was expected")),
        };
        Ok(Self { parameters, noise })
    }

    /// Refuses values that are not finite, and negative sizes.
    pub fn check(&self) -> Result<()> {
        for (name, value) in &self.parameters {
            finite(name, *value).map_err(|error| wrong(error.under([key("parameters")])))?;
        }
        self.noise.check().map_err(|error| wrong(error.under([key("noise")])))
    }

    /// The problem with the true values of machine, artefacts and inputs instead of its own.
    pub fn of(&self, problem: &Problem) -> Problem {
        self.applied(problem).0
    }

    /// Values that are not zero and that the problem does not have: they are not simulated.
    ///
    /// Fails for names that look misspelt, and for those that neither a machine nor an artefact could have.
    pub fn left_out(&self, problem: &Problem) -> Result<NotSimulated> {
        let (_, used) = self.applied(problem);
        let unknown = |(name, value): &(&String, &f64)| **value != 0.0 && !used.contains(name.as_str());
        NotSimulated::of(self.parameters.iter().filter(unknown).map(|(name, _)| name), problem)
    }

    /// The problem with the true values, and the names that it takes.
    fn applied(&self, problem: &Problem) -> (Problem, BTreeSet<&str>) {
        let mut truth = problem.clone();
        let mut used = BTreeSet::new();
        for tie in &problem.ties {
            if let Some((name, known)) = self.parameters.get_key_value(&tie.name) {
                used.insert(name.as_str());
                tie.members.iter().for_each(|(index, factor)| truth.machine_values[*index] = factor * known);
            }
        }
        let mut take = |full: &str, own: &str, value: &mut f64| {
            for name in [own, full] {
                if let Some((name, known)) = self.parameters.get_key_value(name) {
                    used.insert(name.as_str());
                    *value = *known;
                }
            }
        };
        for (parameter, value) in problem.model.info().parameters.iter().zip(&mut truth.machine_values) {
            take(&parameter.name, &parameter.name, value);
        }
        for set in &mut truth.sets {
            let (observations, prefix) = (set.observations.clone(), set.name.clone());
            let own = observations.info().unknowns.iter().zip(&mut set.own);
            let inputs = observations.info().inputs.iter().map(|input| &input.parameter).zip(&mut set.inputs);
            for (parameter, value) in own.chain(inputs) {
                take(&format!("{prefix}.{}", parameter.name), &parameter.name, value);
            }
        }
        (truth, used)
    }

    /// Summary: numbers of values that differ from nominal, of the machine and of every stage, then what is left out, then
    /// the noise.
    pub fn summary(&self, problem: &Problem) -> Vec<String> {
        let truth = self.of(problem);
        let machine = truth.machine_values.iter().filter(|value| **value != 0.0).count();
        let mut lines = vec![format!("machine: {machine} of {} parameters are not zero", truth.machine_values.len())];
        let mut told = BTreeSet::new();
        for set in truth.sets.iter().filter(|set| told.insert(&set.name)) {
            // A stage has several sets if its rows are repeated.
            let (mut unknowns, mut inputs) = (BTreeMap::new(), BTreeMap::new());
            for set in truth.sets.iter().filter(|other| other.name == set.name) {
                let (observations, start) = (&set.observations, set.info().start.clone());
                let own = observations.info().unknowns.iter().zip(set.own.iter().zip(start));
                unknowns.extend(own.map(|(parameter, (value, start))| (&parameter.name, *value != start)));
                let own = observations.info().inputs.iter().zip(&set.inputs);
                inputs.extend(own.map(|(input, value)| (&input.parameter.name, *value != input.value)));
            }
            let varied = |values: &BTreeMap<&String, bool>| values.values().filter(|varied| **varied).count();
            lines.push(format!(
                "{}: {} of {} unknowns and {} of {} inputs are not nominal",
                set.name,
                varied(&unknowns),
                unknowns.len(),
                varied(&inputs),
                inputs.len()
            ));
        }
        lines.extend(self.left_out(problem).unwrap_or_default().summary());
        lines.extend(self.noise.summary());
        lines
    }
}

/// Warns of entries that describe other machines than that of `parameters`, and of misspelt keys.
fn warn_of_others(content: &Value) {
    const KEYS: [&str; 2] = ["parameters", "noise"];
    let has_parameters = |value: &Value| value.get("parameters").is_some();
    for (name, value) in content.as_object().into_iter().flatten() {
        if let Some(meant) = nearest(name, KEYS).filter(|_| !KEYS.contains(&name.as_str())) {
            tracing::warn!("`{name}` is a note and not simulated: did you mean `{meant}`?");
        }
        let described = has_parameters(value) || value.as_array().is_some_and(|all| all.iter().any(has_parameters));
        if described {
            tracing::warn!(
                "`{name}` is not simulated, though it has `parameters` of its own: every row, repeated or not, is measured on \
                 the one machine of `parameters`"
            );
        }
    }
}

pub(crate) fn key(name: &str) -> PathItem {
    PathItem::Key(name.to_owned())
}

fn wrong(error: SettingsError) -> Error {
    let (help, class) = (error.help.clone(), error.class);
    let error = Error { class, ..Error::usage(SettingsError { help: None, ..error }.to_string()) };
    match help {
        Some(help) => error.help(help),
        None => error,
    }
}

/// A map with the keys in `known` only. Other keys give warnings, unless they are notes.
pub(crate) fn known_only(place: &str, settings: &Map<String, Value>, known: &[&str], notes: &[&str]) -> Value {
    let mut kept = settings.clone();
    kept.retain(|name, _| {
        let is_known = known.contains(&name.as_str());
        if !is_known && !notes.contains(&name.as_str()) && !name.ends_with("_note") {
            match nearest(name, known.iter().copied()) {
                Some(near) => tracing::warn!("{place}: `{name}` is not simulated; did you mean `{near}`?"),
                None => tracing::warn!("{place}: `{name}` is not simulated"),
            }
        }
        is_known
    });
    Value::Object(kept)
}

/// Whether a problem has a parameter of the machine of this name: its index.
pub(crate) fn machine_parameter(problem: &Problem, name: &str) -> Option<usize> {
    problem.model.info().parameters.iter().position(|parameter| parameter.name == name)
}
