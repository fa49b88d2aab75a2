//! The truth: what the machine, the artefacts and the known inputs really are.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{Error, PathItem, Problem, Result, SettingsError, from_settings, nearest};
use serde_json::{Map, Value};

use crate::noise::{Noise, finite};

/// The true values behind simulated measurements.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Truth {
    /// Values by name, in mm and rad: parameters of the machine; own unknowns of artefacts (`facet[3].d`, or
    /// `table.facet[3].d` for those of one stage alone); known inputs (`stylus_radius`, `bar.reference_error`).
    ///
    /// What is not named is zero, or nominal if it is an input or starts elsewhere.
    pub parameters: BTreeMap<String, f64>,
    /// How it is measured.
    pub noise: Noise,
}

impl Truth {
    /// Reads the text of a truth file: JSON with `parameters` and, if there is any, `noise`. Other keys are notes.
    ///
    /// Fails, with the place, for text that is no JSON, for values that are no finite numbers and for sizes that are
    /// negative. Keys of `noise` that nothing here simulates are told as warnings.
    pub fn parse(file: &Path, text: &str) -> Result<Self> {
        let content: Value = serde_json::from_str(text).map_err(|error| {
            let message = error.to_string();
            let message = message.split(" at line ").next().unwrap_or_default();
            Error::usage(format!("this is no JSON: {message}")).at(file, error.line(), Some(error.column().max(1)))
        })?;
        Self::from_json(&content).and_then(|truth| truth.check().map(|()| truth)).map_err(|error| error.in_file(file))
    }

    fn from_json(content: &Value) -> Result<Self> {
        let missing = || {
            Error::usage("`parameters` is missing: a map of names and values in mm and rad was expected")
                .help("for example { \"parameters\": { \"EA0B\": 1e-5 }, \"noise\": {} }")
        };
        let parameters = content.get("parameters").ok_or_else(missing)?;
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

    /// Refuses values that are no finite numbers, and sizes that are negative.
    pub fn check(&self) -> Result<()> {
        for (name, value) in &self.parameters {
            finite(name, *value).map_err(|error| wrong(error.under([key("parameters")])))?;
        }
        self.noise.check().map_err(|error| wrong(error.under([key("noise")])))
    }

    /// The problem with the true values of machine, artefacts and inputs instead of its own.
    pub(crate) fn of(&self, problem: &Problem) -> Result<Problem> {
        let mut truth = problem.clone();
        let mut used = BTreeSet::new();
        let mut take = |full: &str, own: &str, value: &mut f64| {
            for name in [own, full] {
                if let Some((name, known)) = self.parameters.get_key_value(name) {
                    used.insert(name.as_str());
                    *value = *known;
                }
            }
        };
        for (parameter, value) in problem.model.parameters().iter().zip(&mut truth.machine) {
            take(&parameter.name, &parameter.name, value);
        }
        for set in &mut truth.sets {
            let (observations, prefix) = (set.observations.clone(), set.name.clone());
            let own = observations.unknowns().iter().zip(&mut set.own);
            let inputs = observations.inputs().iter().map(|input| &input.parameter).zip(&mut set.inputs);
            for (parameter, value) in own.chain(inputs) {
                take(&format!("{prefix}.{}", parameter.name), &parameter.name, value);
            }
        }
        let unknown = |(name, value): &(&String, &f64)| **value != 0.0 && !used.contains(name.as_str());
        match self.parameters.iter().find(unknown) {
            Some((name, _)) => Err(unknown_name(name, problem)),
            None => Ok(truth),
        }
    }

    /// What differs from nominal, for people: how many values of whom, then the noise.
    pub fn summary(&self, problem: &Problem) -> Vec<String> {
        let mut lines = Vec::new();
        let truth = self.of(problem).unwrap_or_else(|_| problem.clone());
        let count = |values: &[f64], nominal: &[f64]| values.iter().zip(nominal).filter(|(a, b)| a != b).count();
        let machine = truth.machine.iter().filter(|value| **value != 0.0).count();
        lines.push(format!("machine: {machine} of {} parameters are not zero", truth.machine.len()));
        for set in &truth.sets {
            let own = count(&set.own, &set.observations.start());
            let nominal: Vec<f64> = set.observations.inputs().iter().map(|input| input.value).collect();
            let inputs = count(&set.inputs, &nominal);
            lines.push(format!(
                "{}: {own} of {} unknowns and {inputs} of {} inputs are not nominal",
                set.name,
                set.own.len(),
                nominal.len()
            ));
        }
        lines.extend(self.noise.summary());
        lines
    }
}

fn unknown_name(name: &str, problem: &Problem) -> Error {
    let mut known: Vec<String> = problem.model.parameters().iter().map(|parameter| parameter.name.clone()).collect();
    for set in &problem.sets {
        let inputs = set.observations.inputs().iter().map(|input| &input.parameter);
        known.extend(set.observations.unknowns().iter().chain(inputs).map(|parameter| parameter.name.clone()));
    }
    let rule = "a machine parameter exists only if the model's `errors` list it (it need not be estimated), that of an \
                artefact only if the artefact is observed";
    let help = match nearest(name, known.iter().map(String::as_str)) {
        Some(near) => format!("did you mean `{near}`? Else: {rule}"),
        None => rule.to_owned(),
    };
    Error::usage(format!("parameters.{name}: neither the machine nor an artefact has a `{name}`")).help(help)
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

/// A map without the keys that `known` does not list; those are told as warnings, unless they are notes.
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
    problem.model.parameters().iter().position(|parameter| parameter.name == name)
}
