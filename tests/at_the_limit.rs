//! Machines that stand exactly at their limit: the guarded rule of decision accepts at most one in twenty of them, whatever is judged.
//!
//! A machine and its instrument are drawn at random. Its limit is what the validator finds in readings without measurement errors; then
//! the same machine is measured with the errors that the settings state, and the validator decides by ISO 14253-1 with the probability
//! 0.95. What has no uncertainty proves nothing: it must not be accepted at all.
//!
//! `cargo xtask campaign limits 10000` has 10,000 machines of each kind.

mod fits;
mod readings;

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Build, Context, Dataset, Decision, Figure, Kind, Registry, Verdict};
use abbe_numerics::binomial_band;
use serde_json::{Value, json};

use crate::support::{Random, registry};

/// Machines of each kind, unless more are asked for.
const MACHINES: usize = 150;

/// How many machines of each kind there are: `usual`, or as many as are asked for.
fn machines(usual: usize) -> usize {
    std::env::var("ABBE_LIMIT_MACHINES").ok().and_then(|asked| asked.parse().ok()).unwrap_or(usual)
}

/// The rule that accepts what conforms with a probability of 95 %.
fn guarded(limit: f64) -> Value {
    json!({ "limit": limit, "decision": { "rule": "iso-14253-1-2017", "probability": 0.95 } })
}

/// The rule without a guard band.
fn simple(limit: f64) -> Value {
    json!({ "limit": limit, "decision": "simple" })
}

/// How limits are written: of a value.
type Written = fn(f64) -> Value;

/// A machine as it is, and as it is measured: the tables of a test by name.
struct Scene {
    settings: Value,
    exact: Vec<(String, String)>,
    measured: Vec<(String, String)>,
}

/// Draws a machine and its measurement.
type Draw = fn(&mut Random) -> Scene;

fn datasets(tables: &[(String, String)]) -> Vec<Dataset> {
    let read = |(name, text): &(String, String)| abbe_table::parse(Path::new(name), text.as_bytes()).expect("a table");
    tables.iter().map(read).collect()
}

/// The figures of a validator of readings that have a limit.
fn limited(registry: &Registry, validator: &str, settings: &Value, tables: &[(String, String)]) -> Vec<Figure> {
    let plugin = registry.find(Kind::Validate, validator).expect("a validator");
    let Build::Validate(constructor) = &plugin.build else { panic!("{validator} is no validator") };
    let built = constructor.build(settings, &Context { base: std::env::temp_dir() });
    let built = built.unwrap_or_else(|error| panic!("{validator}: {error}"));
    let data = datasets(tables);
    let found = built.validate(&[], &data.iter().collect::<Vec<_>>()).unwrap_or_else(|error| panic!("{error}"));
    found.figures.into_iter().filter(|figure| figure.limit.is_some()).collect()
}

/// Whether a machine whose largest figure of a key is the limit is accepted; none where the figure is no number to stand at.
fn is_accepted(registry: &Registry, validator: &str, key: &str, scene: &Scene, written: Written) -> Option<bool> {
    let with = |limit: Value| {
        let mut settings = scene.settings.clone();
        let mut at = &mut settings;
        for part in key.split('.') {
            at = &mut at[part];
        }
        *at = limit;
        settings
    };
    let exact = limited(registry, validator, &with(json!(1e6)), &scene.exact);
    let limit = exact.iter().filter_map(|figure| figure.value).fold(0.0, f64::max);
    if limit < 1e-6 {
        return None;
    }
    let found = limited(registry, validator, &with(written(limit)), &scene.measured);
    assert!(!found.is_empty(), "{validator}: no figure of {key}");
    Some(found.iter().all(|figure| figure.decide() == Some(Decision::Pass)))
}

/// Accepted machines of all, by what is judged.
#[derive(Default)]
struct Counted(BTreeMap<String, [usize; 2]>);

impl Counted {
    fn add(&mut self, what: &str, accepted: bool) {
        let [count, all] = self.0.entry(what.to_owned()).or_default();
        *count += usize::from(accepted);
        *all += 1;
    }

    /// At most one in twenty is accepted: no more than 99 % of such tests count.
    fn hold(&self) {
        // A campaign tells what it found.
        if std::env::var_os("ABBE_LIMIT_MACHINES").is_some() {
            self.0.iter().for_each(|(what, [accepted, all])| println!("{what}: {accepted} of {all}"));
        }
        for (what, [accepted, all]) in &self.0 {
            let (_, most) = binomial_band(*all, 0.05, 0.98);
            assert!(*accepted <= most, "{what}: {accepted} of {all} machines at their limit are accepted");
        }
        assert!(!self.0.is_empty());
    }

    /// The share of machines that are accepted.
    fn share(&self, what: &str) -> f64 {
        let [accepted, all] = self.0[what];
        accepted as f64 / all as f64
    }
}

/// Counts over machines of one kind.
fn count(validator: &str, kind: &str, keys: &[&str], draw: Draw, written: Written, number: usize) -> Counted {
    let registry = registry();
    let mut counted = Counted::default();
    for seed in 0..number as u64 {
        let scene = draw(&mut Random::new(1 + seed));
        for key in keys {
            if let Some(accepted) = is_accepted(&registry, validator, key, &scene, written) {
                counted.add(&format!("{validator}, {kind}: {key}"), accepted);
            }
        }
    }
    counted
}

/// Validators whose figures with a limit have an uncertainty, and where their machines are drawn.
const UNCERTAIN: [&str; 13] = [
    // `readings`
    "circular",
    "cmm-lengths",
    "cmm-probing",
    "diagonals",
    "positioning",
    "rotary-interpolation",
    "thermal",
    // `fits`
    "circular-diagnosis",
    "compensated",
    "repeats",
    "spindle",
    // By a rule of its own, with the guard bands of its settings.
    "tools",
    "uncertainty",
];

/// Whose figures take no limit.
const WITHOUT_LIMITS: [&str; 1] = ["trend"];

/// No validator is left out: the figures of one that is not drawn have no uncertainty in any recipe.
pub fn only_what_is_drawn_is_uncertain(recipe: &str, verdicts: &[Verdict]) {
    let is_drawn = |name: &str| UNCERTAIN.contains(&name) || WITHOUT_LIMITS.contains(&name);
    for verdict in verdicts.iter().filter(|verdict| !is_drawn(&verdict.plugin)) {
        let uncertain = verdict.figures.iter().find(|figure| figure.standard_uncertainty.is_some());
        assert!(
            uncertain.is_none(),
            "{recipe}: `{}` of `{}` has an uncertainty: draw machines that stand at its limit (`tests/at_the_limit.rs`)",
            uncertain.map_or("", |figure| &figure.name),
            verdict.plugin
        );
    }
}

/// What has no uncertainty proves nothing, however far below its limit it is.
#[test]
fn what_has_no_uncertainty_is_never_accepted() {
    let limit: abbe_core::Limit = serde_json::from_value(guarded(1e6)).expect("a limit");
    for value in [0.0, 1.0, 1e6] {
        let figure = Figure::new("fit", "max", value, "um").limited(limit);
        assert_eq!(figure.decide(), Some(Decision::Inconclusive));
    }
    let registry = registry();
    for name in UNCERTAIN {
        assert!(registry.find(Kind::Validate, name).is_ok(), "there is no validator {name}");
    }
}
