//! Own unknowns of artefacts that are eliminated: the same values and standard uncertainties, and who needs their covariances says so.

use std::path::Path;

use abbe_core::{Calibration, Status};
use serde_json::{Value, json};

use crate::fleet::shards::of_parts;
use crate::plugins::valid;
use crate::support::{Variant, as_typed, json_file, read, root, temporary, write};

fn with(mut recipe: Variant, name: &str, stage: Value) -> Variant {
    recipe.0["stages"][name] = stage;
    recipe
}

fn run(recipe: &Variant, at: &Path, estimate: &str) -> Calibration {
    recipe.write(at);
    let printed = as_typed(at, &["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let file = at.join(format!("out/recipe/{estimate}.calibration.json"));
    let schema = json_file(&root().join("docs/schemas/calibration.schema.json"));
    valid(estimate, &schema, &json_file(&file));
    Calibration::from_json(&read(&file)).unwrap_or_else(|error| panic!("{error}"))
}

/// Whether values, uncertainties and the covariance that is left are those of one triangle, to a part of the uncertainties.
fn agree(what: &str, found: &Calibration, whole: &Calibration) {
    let own = |of: &Calibration| of.artefacts.iter().filter(|own| own.status == Status::Estimated).count();
    assert_eq!((found.fit.eliminated, whole.fit.eliminated), (own(whole), 0), "{what}");
    assert_eq!(found.covariance.order.len(), whole.covariance.order.len() - own(whole), "{what}");
    // Parts of the rows meet artefacts in another order.
    for other in whole.parameters.iter().chain(&whole.artefacts) {
        let one = found.get(&other.name).unwrap_or_else(|| panic!("{what}: {} is gone", other.name));
        assert_eq!(one.status, other.status, "{what}: {}", one.name);
        let allowed = 1e-7 * other.standard_uncertainty;
        assert!((one.value - other.value).abs() <= allowed, "{what}: {}", one.name);
        assert!((one.standard_uncertainty - other.standard_uncertainty).abs() <= allowed, "{what}: u of {}", one.name);
    }
    for one in &found.covariance.order {
        for other in &found.covariance.order {
            let [here, there] = [found, whole].map(|of| of.covariance.block(&[one, other])[(0, 1)]);
            let of = |name: &str| whole.covariance.variance(name).expect("a variance").sqrt();
            assert!((here - there).abs() <= 1e-7 * of(one) * of(other), "{what}: {one} and {other}");
        }
    }
    assert_eq!(found.fit.degrees_of_freedom, whole.fit.degrees_of_freedom, "{what}");
    assert!((found.fit.sigma / whole.fit.sigma - 1.0).abs() < 1e-9, "{what}");
}

#[test]
fn values_and_uncertainties_are_those_of_one_triangle() {
    for (name, estimate, from) in
        [("tango-hu40t", "fit-S2", "touches"), ("tango-hu40t", "fit-S3", "touches"), ("first-steps", "fit", "touches")]
    {
        let folder = temporary();
        let at = folder.path();
        let whole = run(&of_parts(name, estimate), at, estimate);
        let recipe = of_parts(name, estimate).set(estimate, "own_covariances", json!(0));
        agree(name, &run(&recipe, at, estimate), &whole);
        for rows in [97, 20] {
            let recipe = Variant(recipe.0.clone()).set(from, "batch_rows", json!(rows));
            agree(&format!("{name}, {rows} rows a batch"), &run(&recipe, at, estimate), &whole);
        }
    }
}

/// Few enough unknowns have one triangle where something needs it, whatever is asked.
#[test]
fn what_needs_one_triangle_has_it() {
    let folder = temporary();
    for (setting, value) in
        [("robust", json!("tukey")), ("on_confounded", json!("drop")), ("variance", json!("per-stage"))]
    {
        let recipe = of_parts("tango-hu40t", "fit-S2").set("fit-S2", "own_covariances", json!(0));
        let found = run(&recipe.set("fit-S2", setting, value), folder.path(), "fit-S2");
        assert_eq!(found.fit.eliminated, 0, "{setting}");
    }
}

#[test]
fn who_needs_covariances_says_so() {
    let recipe = |later: &[(&str, Value)]| {
        let recipe = of_parts("tango-hu40t", "fit-S2").set("fit-S2", "own_covariances", json!(0));
        later.iter().fold(recipe, |recipe, (name, stage)| with(recipe, name, stage.clone()))
    };
    let own = "has a standard uncertainty in `fit-S2` and no covariance: it was eliminated";
    let again = json!({
        "estimate": "gauss-newton", "machine": "hu40t", "observations": ["table"], "parameters": ["dxt"],
        "known": "fit-S2", "shared_rows": "accepted"
    });
    let trials = json!({ "estimate": "monte-carlo", "of": "fit-S2", "trials": 2000 });
    for (name, stage) in [("again", again), ("trials", trials)] {
        let folder = temporary();
        recipe(&[(name, stage)]).write(folder.path());
        let printed = as_typed(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
        let words = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        assert!(printed.status == 1 && words.contains(own), "{name}: {}", printed.stderr);
        assert!(words.contains("own_covariances") && words.contains("recipe.yaml:"), "{name}: {}", printed.stderr);
    }
    // What asks for the machine alone works.
    let folder = temporary();
    let at = folder.path();
    let known = json!({
        "estimate": "gauss-newton", "machine": "hu40t", "observations": ["bar"], "parameters": ["EZZ[1]"],
        "known": "fit-S2", "shared_rows": "accepted"
    });
    let table = json!({ "export": "uncertainty", "of": "fit-S2" });
    let errors = json!({ "export": "error-table", "of": "fit-S2", "step_mm": 100, "step_deg": 45 });
    let recipe = recipe(&[("known", known), ("table-of-values", table), ("errors", errors)]);
    recipe.write(at);
    let printed = as_typed(at, &["run", "recipe.yaml", "--out", "out"]);
    assert!([0, 1].contains(&printed.status), "{}", printed.stderr);
    assert!(!printed.stderr.contains("eliminated"), "{}", printed.stderr);
    let printed = as_typed(at, &["check", "recipe.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
}

/// A calibration whose covariance lacks more than was eliminated is none.
#[test]
fn a_wrong_number_of_eliminated_values_is_refused() {
    let folder = temporary();
    let at = folder.path();
    let recipe = of_parts("first-steps", "fit").set("fit", "own_covariances", json!(0));
    let found = run(&recipe, at, "fit");
    for eliminated in [0, found.fit.eliminated - 1, found.fit.eliminated + 1] {
        let mut other = found.clone();
        other.fit.eliminated = eliminated;
        let file = at.join("other.json");
        write(&file, &other.to_json().expect("a calibration is JSON"));
        let error = Calibration::from_json(&read(&file)).expect_err("it contradicts itself");
        assert!(error.message.contains("covariance"), "{error}");
    }
}
