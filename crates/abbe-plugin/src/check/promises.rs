//! Tests that apply to every plugin of a library.

use std::sync::Arc;

use abbe_core::{
    Build, Context, KinematicModel, Plugin, Poses, Registry, Result, SettingsError, Variable, in_parallel,
};
use abbe_estimation::laws::{self, samples};
use serde_json::Value;

use super::Findings;
use crate::float_control;
use crate::loader::Library;

/// A stage of any kind, which is kept and not used.
pub(super) trait Kept {}

impl<T> Kept for T {}

/// Builds a stage.
pub(super) fn built(plugin: &Plugin, settings: &Value) -> Result<Box<dyn Kept>, SettingsError> {
    fn kept<T: 'static>(stage: T) -> Box<dyn Kept> {
        Box::new(stage)
    }
    let context = Context { base: std::env::temp_dir() };
    match &plugin.build {
        Build::Ingest(constructor) => constructor.build(settings, &context).map(kept),
        Build::Artefact(constructor) => constructor.build(settings, &context).map(kept),
        Build::Model(constructor) => constructor.build(settings, &context).map(kept),
        Build::Estimate(constructor) => constructor.build(settings, &context).map(kept),
        Build::Validate(constructor) => constructor.build(settings, &context).map(kept),
        Build::Export(constructor) => constructor.build(settings, &context).map(kept),
    }
}

/// Builds a stage and drops it.
fn build(plugin: &Plugin, settings: &Value) -> Result<(), SettingsError> {
    built(plugin, settings).map(drop)
}

/// The machines of the library's models, built from their examples and without data.
pub(super) fn machines(library: &Library, findings: &mut Findings) -> Vec<(String, Arc<dyn KinematicModel>)> {
    let mut machines = Vec::new();
    for plugin in &library.plugins {
        let Build::Model(constructor) = &plugin.build else {
            findings.skip(format!("`{}`: needs data; a recipe that uses it has them (`--recipe`)", plugin.name));
            continue;
        };
        let context = Context { base: std::env::temp_dir() };
        let stage = constructor.build(plugin.example.get(), &context).map_err(|error| error.to_string());
        match stage.and_then(|stage| stage.build(&[]).map_err(|error| error.to_string())) {
            Ok(machine) => machines.push((plugin.name.to_string(), machine)),
            Err(error) => findings.wrong(format!("`{}` cannot be built from its example: {error}", plugin.name)),
        }
    }
    machines
}

/// All variables to which a machine has derivatives.
fn variables(machine: &dyn KinematicModel) -> Vec<Variable> {
    let parameters = (0..machine.info().parameters.len()).map(Variable::Parameter);
    parameters.chain((0..machine.info().axes.len()).map(Variable::Command)).collect()
}

pub(super) fn derivatives(library: &Library, findings: &mut Findings) {
    for (name, machine) in machines(library, findings) {
        let (statuses, values) = samples(machine.as_ref(), 1);
        match machine.poses(&statuses, &values, &[], true, &mut Poses::default()) {
            // A machine may refuse orientations. A fatal error is no refusal; the laws report it
            // too.
            Err(error) if !error.fatal => findings.skip(format!("orientations of `{name}`: {error}")),
            _ => {}
        }
        laws::check_model(machine.as_ref()).iter().for_each(|law| findings.wrong(format!("`{name}`: {law}")));
    }
}

pub(super) fn estimators(library: &Library, findings: &mut Findings) {
    for plugin in &library.plugins {
        let Build::Estimate(constructor) = &plugin.build else { continue };
        // The test of settings reports an example that cannot be built.
        let Ok(stage) = constructor.build(plugin.example.get(), &Context { base: std::env::temp_dir() }) else {
            continue;
        };
        match laws::check_estimator(stage.as_ref()) {
            Ok(broken) => broken.iter().for_each(|law| findings.wrong(format!("`{}`: {law}", plugin.name))),
            Err(error) => findings.skip(format!("`{}`: {error}", plugin.name)),
        }
    }
}

pub(super) fn names(library: &Library, findings: &mut Findings) {
    if library.version.is_empty() || library.name.is_empty() {
        findings.wrong("the library has no name or no version");
    }
    let registry = match Registry::built_in() {
        Ok(registry) => registry,
        Err(error) => return findings.wrong(error.to_string()),
    };
    let mut names: Vec<(_, &str)> =
        library.plugins.iter().map(|plugin| (plugin.kind(), plugin.name.as_ref())).collect();
    for (kind, name) in &names {
        if registry.find(*kind, name).is_ok() {
            findings.wrong(format!("the {kind} plugin `{name}` has the name of a built-in one"));
        }
    }
    names.sort_unstable();
    if names.windows(2).any(|pair| pair[0] == pair[1]) {
        findings.wrong("two plugins have the same name");
    }
    for plugin in &library.plugins {
        if plugin.about.ends_with('.') {
            findings.wrong(format!("`{}`: the line that says what it does ends with a full stop", plugin.name));
        }
    }
}

pub(super) fn settings(library: &Library, findings: &mut Findings) {
    for plugin in &library.plugins {
        let name = &plugin.name;
        let (schema, example) = (plugin.schema.get(), plugin.example.get());
        if schema["type"] != "object" || !schema["properties"].is_object() {
            findings.wrong(format!("`{name}`: the schema is not that of a map with properties"));
        }
        let Some(map) = example.as_object() else {
            findings.wrong(format!("`{name}`: the example is no map of settings"));
            continue;
        };
        for key in map.keys().filter(|key| schema["properties"].get(key).is_none()) {
            findings.wrong(format!("`{name}`: the example has `{key}`, which the schema does not know"));
        }
        if let Err(error) = build(plugin, example) {
            findings.wrong(format!("`{name}` cannot be built from its example: {error}"));
            continue;
        }
        let mut unknown = example.clone();
        unknown["frobnicate"] = Value::from(1);
        match build(plugin, &unknown) {
            Ok(()) => findings.wrong(format!("`{name}` takes a setting `frobnicate`, which it does not know")),
            Err(error) if !error.to_string().contains("frobnicate") => {
                findings.wrong(format!("`{name}`: the error does not name the unknown setting: {error}"));
            }
            Err(_) => {}
        }
        for wrong in [Value::Null, Value::from(1), Value::from("x"), Value::Array(Vec::new())] {
            if build(plugin, &wrong).is_ok() {
                findings.wrong(format!("`{name}` takes {wrong} for its settings"));
            }
        }
        for key in map.keys() {
            for wrong in [Value::from("\u{fffd}\"\\"), Value::from(-1e308), serde_json::json!([{ "a": null }])] {
                let mut changed = example.clone();
                changed[key] = wrong;
                message(name, build(plugin, &changed), findings);
            }
        }
    }
}

/// Reports an error without a message, with text that is not UTF-8, or from a panic.
fn message(name: &str, result: Result<(), SettingsError>, findings: &mut Findings) {
    if let Err(error) = result
        && (error.message.trim().is_empty()
            || error.message.contains("not UTF-8")
            || error.message.contains("panicked"))
    {
        findings.wrong(format!("`{name}`: {error}"));
    }
}

pub(super) fn not_a_number(library: &Library, findings: &mut Findings) {
    for (_, machine) in machines(library, findings) {
        let (mut statuses, mut values) = samples(machine.as_ref(), 3);
        let wanted = variables(machine.as_ref());
        let mut out = Poses::default();
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308] {
            let kept = statuses.clone();
            statuses.fill(bad);
            // An error and numbers are both accepted. Anything else ends this process, which the result of the test shows.
            let _ = machine.poses(&statuses, &values, &wanted, false, &mut out);
            statuses = kept;
            let kept = values.clone();
            values.fill(bad);
            let _ = machine.poses(&statuses, &values, &wanted, false, &mut out);
            values = kept;
        }
    }
}

pub(super) fn empty_batch(library: &Library, findings: &mut Findings) {
    for (name, machine) in machines(library, findings) {
        let (_, values) = samples(machine.as_ref(), 0);
        let mut out = Poses::default();
        for wanted in [Vec::new(), variables(machine.as_ref())] {
            match machine.poses(&[], &values, &wanted, false, &mut out) {
                Ok(()) => {}
                Err(error) => findings.wrong(format!("`{name}` refuses a batch without poses: {error}")),
            }
        }
        let (statuses, _) = samples(machine.as_ref(), 3);
        if let Err(error) = machine.poses(&statuses, &values, &[], false, &mut out) {
            findings.wrong(format!("`{name}` refuses poses without derivatives: {error}"));
        }
    }
}

pub(super) fn threads(library: &Library, findings: &mut Findings) {
    for (name, machine) in machines(library, findings) {
        let (statuses, values) = samples(machine.as_ref(), 40);
        let wanted = variables(machine.as_ref());
        let evaluate = |_: &usize| {
            let mut out = Poses::default();
            machine.poses(&statuses, &values, &wanted, false, &mut out).map(|()| out)
        };
        let expected = evaluate(&0);
        let rounds: Vec<usize> = (0..400).collect();
        let differs = in_parallel(&rounds, Some(8), |round| evaluate(round) != expected);
        match differs.iter().filter(|differs| **differs).count() {
            0 => {}
            count => findings.wrong(format!("`{name}`: {count} of 400 answers on 8 threads differ from the first one")),
        }
    }
}

/// Memory of this process, bytes; none where the system does not say.
fn memory() -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    Some(text.split(' ').nth(1)?.parse::<usize>().ok()? * 4096)
}

/// Growth of memory that is no leak, bytes: allocators keep memory. A leak of a hundred bytes in every call would give
/// twice as much.
const GROWTH: usize = 500_000;

pub(super) fn leaks(library: &Library, findings: &mut Findings) {
    if memory().is_none() {
        return findings.skip("this system does not tell how much memory a process has");
    }
    for plugin in &library.plugins {
        let example = plugin.example.get();
        let mut wrong = example.clone();
        wrong["frobnicate"] = Value::from(1);
        grows(findings, &format!("`{}`: stages that are built and let go of", plugin.name), || {
            let _ = build(plugin, example);
            let _ = build(plugin, &wrong);
        });
    }
    let mut ignored = Findings::default();
    for (name, machine) in machines(library, &mut ignored) {
        let (statuses, values) = samples(machine.as_ref(), 4);
        let wanted = variables(machine.as_ref());
        let mut out = Poses::default();
        grows(findings, &format!("`{name}`: poses"), || {
            let _ = machine.poses(&statuses, &values, &wanted, false, &mut out);
        });
    }
}

fn grows(findings: &mut Findings, what: &str, mut work: impl FnMut()) {
    (0..1000).for_each(|_| work());
    let before = memory().unwrap_or_default();
    (0..10_000).for_each(|_| work());
    let growth = memory().unwrap_or_default().saturating_sub(before);
    if growth > GROWTH {
        findings.wrong(format!("{what}: 10,000 of them leave {} kB behind", growth / 1000));
    }
}

pub(super) fn surroundings(library: &Library, findings: &mut Findings) {
    let directory = std::env::current_dir().ok();
    for (name, machine) in machines(library, findings) {
        let (statuses, values) = samples(machine.as_ref(), 3);
        let mut out = Poses::default();
        let _ = machine.poses(&statuses, &values, &variables(machine.as_ref()), false, &mut out);
        if std::env::current_dir().ok() != directory {
            findings.wrong(format!("`{name}` changes the working directory"));
        }
    }
    if float_control::changed() {
        findings.wrong("the floating-point state of the thread was changed: is the library linked with -ffast-math?");
    }
}
