//! Those who repeat an estimate whose rows are read in batches find what they find of rows that are held.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Calibration, Figure, SimulatedParameter, Verdict};
use serde_json::{Value, json};

use super::{calibration, run, with_gross_errors};
use crate::fleet::shards::of_parts;
use crate::support::{Variant, as_typed, read, temporary};

pub fn with(mut recipe: Variant, stages: Value) -> Variant {
    for (name, stage) in stages.as_object().expect("stages") {
        recipe.0["stages"][name] = stage.clone();
    }
    recipe
}

pub fn verdicts(at: &Path, out: &str) -> Vec<Verdict> {
    Verdict::list_from_json(&read(&at.join(out).join("recipe/verdicts.json"))).expect("verdicts")
}

/// Whether both have the same figures, limits and remarks; numbers may be apart by a part of themselves.
pub fn same(what: &str, found: &[Verdict], expected: &[Verdict], apart: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!((&found.stage, found.pass), (&expected.stage, expected.pass), "{what}");
        // The rows of data sets that are held come with the first batch: labels appear in another order.
        let figures = |of: &Verdict| -> BTreeMap<String, Option<f64>> {
            let name = |own: &Figure| format!("{:?} {} {}", own.of, own.name, own.unit);
            of.figures.iter().map(|own| (name(own), own.value)).collect()
        };
        let (found_figures, expected_figures) = (figures(found), figures(expected));
        assert!(found_figures.keys().eq(expected_figures.keys()), "{what}");
        for ((name, one), other) in found_figures.iter().zip(expected_figures.values()) {
            assert_eq!(one.is_some(), other.is_some(), "{what}: {name}");
            if let (Some(one), Some(other)) = (one, other) {
                assert!((one - other).abs() <= apart * other.abs(), "{what}: {name} {one} and {other}");
            }
        }
        // So do names of unknowns.
        let words = |of: &Verdict| -> Vec<Vec<String>> {
            let sorted = |remark: &String| {
                let mut words: Vec<String> = remark.replace(',', " ").split_whitespace().map(str::to_owned).collect();
                words.sort();
                words
            };
            of.remarks.iter().map(sorted).collect()
        };
        assert_eq!(words(found), words(expected), "{what}");
    }
}

#[test]
fn predictions_and_residuals_are_those_of_rows_that_are_held() {
    let judged = json!({
        "left": { "validate": "residuals", "of": "fit-S2", "limits": { "max_um": 1e3 } },
        "thirds": { "validate": "hold-out", "of": "fit-S2", "rows": "table", "folds": 3, "limits": { "rms_um": 1e3 } },
        // Facets that no other rows touch are not predicted.
        "groups": { "validate": "hold-out", "of": "fit-S2", "rows": "table", "folds": [[5, 8], [16]] },
        "facets": { "validate": "hold-out", "of": "fit-S2", "rows": "table", "column": "feature", "folds": 5 },
    });
    let folder = temporary();
    let at = folder.path();
    let recipe = with(of_parts("tango-hu40t", "fit-S2"), judged);
    recipe.write(at);
    let printed = run(at, "whole");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let expected = verdicts(at, "whole");
    assert!(expected.iter().any(|verdict| verdict.remarks.iter().any(|remark| remark.contains("were not predicted"))));
    for rows in [1_000_000, 97, 20] {
        Variant(recipe.0.clone()).set("touches", "batch_rows", json!(rows)).write(at);
        let printed = run(at, "batches");
        assert_eq!(printed.status, 0, "{rows}: {}", printed.stderr);
        // Drifts are tested on rows that are chosen at random: here all.
        same(&format!("{rows} rows a batch"), &verdicts(at, "batches"), &expected, 1e-6);
    }
}

#[test]
fn folds_with_gross_errors_are_those_of_rows_that_are_held() {
    let folder = temporary();
    let at = folder.path();
    let recipe = of_parts("first-steps", "fit").set("fit", "robust", json!("tukey"));
    let recipe = with(
        with_gross_errors(recipe, at, 2),
        json!({ "half": { "validate": "hold-out", "of": "fit", "rows": "table", "folds": 2 } }),
    );
    recipe.write(at);
    let printed = run(at, "whole");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let expected = verdicts(at, "whole");
    let outliers = expected[0].figures.iter().find(|figure| figure.name == "outliers").expect("outliers");
    assert!(outliers.value.is_some_and(|count| count > 10.0), "{outliers:?}");
    Variant(recipe.0.clone()).set("touches", "batch_rows", json!(97)).write(at);
    let printed = run(at, "batches");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    same("robust", &verdicts(at, "batches"), &expected, 1e-3);
}

/// What is wrong with folds is told as it is of rows that are held.
#[test]
fn folds_that_make_no_sense_are_refused_in_batches() {
    for folds in [json!([[5, 99]]), json!(1000)] {
        let stage = json!({ "validate": "hold-out", "of": "fit-S2", "rows": "table", "folds": folds });
        let recipe = with(of_parts("tango-hu40t", "fit-S2"), json!({ "unseen": stage }));
        let told = |rows: usize| {
            let folder = temporary();
            let recipe = Variant(recipe.0.clone());
            if rows > 0 { recipe.set("touches", "batch_rows", json!(rows)) } else { recipe }.write(folder.path());
            let printed = run(folder.path(), "out");
            assert_eq!(printed.status, 1, "{}", printed.stderr);
            let told = printed.stderr.lines().find(|line| line.contains("stage `unseen`"));
            told.map(str::to_owned).unwrap_or_else(|| panic!("{}", printed.stderr))
        };
        assert_eq!(told(97), told(0));
    }
}

/// Trials in batches draw other numbers than those of rows that are held, of the same distributions; they do not depend on how large the
/// batches are, but for rounding.
#[test]
fn trials_have_the_distributions_of_rows_that_are_held() {
    let trials = 400.0_f64;
    let stage = json!({
        "estimate": "monte-carlo", "of": "fit-S2", "trials": trials, "coverage_probability": 0.5, "seed": 3,
        "vary": [{ "parameters": ["EYX[2]", "EZX[2]"], "distribution": "uniform", "at_end_of_travel_um": 3 }],
        "lobing": [{ "artefact": "table", "amplitude_um": 1.0 }],
    });
    let folder = temporary();
    let at = folder.path();
    let recipe = with(of_parts("tango-hu40t", "fit-S2"), json!({ "trials": stage }));
    recipe.write(at);
    let printed = run(at, "whole");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let held = calibration(at, "whole", "trials");
    let in_batches = |rows: usize| {
        Variant(recipe.0.clone()).set("touches", "batch_rows", json!(rows)).write(at);
        let printed = as_typed(at, &["run", "recipe.yaml", "--out", "batches"]);
        assert_eq!(printed.status, 0, "{rows}: {}", printed.stderr);
        calibration(at, "batches", "trials")
    };
    let [one, other] = [97, 200].map(in_batches);
    let known = |of: &Calibration| of.monte_carlo.clone().expect("trials");
    assert_eq!(known(&one).inputs, known(&held).inputs);
    let (mut ratios, mut count) = (0.0, 0.0);
    // Parts of the rows meet artefacts in another order.
    let of = |all: &Calibration, name: &str| -> SimulatedParameter {
        known(all).parameters.into_iter().find(|own| own.name == name).expect("the same parameters")
    };
    for held in &known(&held).parameters {
        let [one, other] = [&one, &other].map(|all| of(all, &held.name));
        let u = held.standard_uncertainty;
        assert!(
            (one.mean - other.mean).abs() < 1e-6 * u
                && (one.standard_uncertainty / other.standard_uncertainty - 1.0).abs() < 1e-6
        );
        // Five standard uncertainties of what so many trials tell.
        let ratio = one.standard_uncertainty / u;
        assert!((ratio - 1.0).abs() < 5.0 / trials.sqrt(), "{}: {ratio}", one.name);
        assert!((one.mean - held.mean).abs() < 5.0 * u * (2.0 / trials).sqrt(), "{}", one.name);
        ratios += ratio;
        count += 1.0;
    }
    assert!((ratios / count - 1.0_f64).abs() < 0.03, "{}", ratios / count);
}
