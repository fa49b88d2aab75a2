//! Terms are selected of rows in batches as they are of rows that are held.

use std::path::Path;

use abbe_core::{Calibration, SimulatedParameter, Status};
use serde_json::{Value, json};

use super::again::{same, verdicts, with};
use super::{ESTIMATES, calibration, run};
use crate::fleet::shards::of_parts;
use crate::support::{Variant, as_typed, temporary};

/// Whether both selected the same terms, and have the same values and uncertainties to 1e-7 standard uncertainties.
fn same_selection(what: &str, found: &Calibration, expected: &Calibration) {
    let selection = |of: &Calibration| of.fit.selection.clone().unwrap_or_else(|| panic!("{what}: no selection"));
    let (one, other) = (selection(expected), selection(found));
    assert_eq!((&other.kept, &other.left_out), (&one.kept, &one.left_out), "{what}");
    assert_eq!(other.steps.len(), one.steps.len(), "{what}");
    for (one, other) in one.steps.iter().zip(&other.steps) {
        assert_eq!((&other.parameter, other.entered), (&one.parameter, one.entered), "{what}");
        assert!((other.probability - one.probability).abs() <= 1e-5 * one.probability + 1e-12, "{what}: {other:?}");
    }
    let fit = |of: &Calibration| (of.fit.observations, of.fit.unknowns, of.fit.rank, of.fit.degrees_of_freedom);
    assert_eq!(fit(found), fit(expected), "{what}");
    assert!((found.fit.sigma / expected.fit.sigma - 1.0).abs() < 1e-9, "{what}");
    assert_eq!((found.parameters.len(), found.artefacts.len()), (expected.parameters.len(), expected.artefacts.len()));
    for one in expected.parameters.iter().chain(&expected.artefacts) {
        let other = found.get(&one.name).unwrap_or_else(|| panic!("{what}: {} is missing", one.name));
        assert_eq!(other.status, one.status, "{what}: {}", one.name);
        let u = one.standard_uncertainty;
        let apart = (one.value - other.value).abs().max((u - other.standard_uncertainty).abs());
        assert!(apart <= 1e-7 * u, "{what}: {} is off by {:e} u", one.name, apart / u);
    }
}

/// Runs a recipe of a data set that is held, and in batches of these sizes.
fn held_and_in_batches(at: &Path, recipe: &Variant, from: &str, sizes: &[usize], look: &dyn Fn(&str)) {
    recipe.write(at);
    let printed = run(at, "held");
    assert!([0, 3].contains(&printed.status), "{}", printed.stderr);
    for rows in sizes {
        Variant(recipe.0.clone()).set(from, "batch_rows", json!(rows)).write(at);
        let in_batches = run(at, "batches");
        assert_eq!(in_batches.status, printed.status, "{rows}: {}", in_batches.stderr);
        look(&format!("{rows} rows a batch"));
    }
}

#[test]
fn the_terms_of_rows_that_are_held_are_selected() {
    let mut told = (0, 0);
    let directions = [("backward", 0.05), ("forward", 0.1), ("both", 0.05)];
    for ((name, estimate, from), (direction, level)) in ESTIMATES.into_iter().zip(directions.into_iter().cycle()) {
        let folder = temporary();
        let at = folder.path();
        let select = json!({ "candidates": ["E*"], "level": level, "direction": direction });
        let recipe = of_parts(name, estimate).set(estimate, "select", select);
        held_and_in_batches(at, &recipe, from, &[97, 20], &|size| {
            let [found, expected] = ["batches", "held"].map(|out| calibration(at, out, estimate));
            same_selection(&format!("{name}, {estimate}, {direction}, {size}"), &found, &expected);
        });
        let selection = calibration(at, "held", estimate).fit.selection.expect("a selection");
        println!("{name}, {estimate}, {direction}: kept {:?}, left out {:?}", selection.kept, selection.left_out);
        told = (told.0 + selection.kept.len(), told.1 + selection.left_out.len());
    }
    assert!(told.0 > 10 && told.1 > 10, "{told:?} kept and left out");
}

/// Without a term that is left nothing is estimated, and nothing fails.
#[test]
fn where_all_is_left_out_nothing_is_estimated() {
    let folder = temporary();
    let at = folder.path();
    let select = json!({ "candidates": ["EXX[1]"], "level": 1e-200 });
    let recipe = of_parts("tango-hu40t", "fit-S2").set("fit-S2", "select", select);
    let recipe = recipe.set("fit-S2", "parameters", json!(["EXX[1]"]));
    held_and_in_batches(at, &recipe, "touches", &[1_000_000, 97, 20], &|size| {
        let [found, expected] = ["batches", "held"].map(|out| calibration(at, out, "fit-S2"));
        same_selection(size, &found, &expected);
        assert_eq!((found.fit.unknowns, found.fit.iterations, found.fit.last_step), (0, 0, None));
        assert_eq!(found.fit.iterations, expected.fit.iterations);
        assert!(found.parameters.iter().all(|known| known.status != Status::Estimated), "{:?}", found.parameters);
    });
}

fn selecting() -> Variant {
    let select = json!({ "candidates": ["E*"], "level": 0.1 });
    of_parts("tango-hu40t", "fit-S2").set("fit-S2", "select", select)
}

#[test]
fn predictions_and_residuals_of_selected_terms_are_those_of_rows_that_are_held() {
    let folder = temporary();
    let at = folder.path();
    let judged = json!({
        "left": { "validate": "residuals", "of": "fit-S2", "limits": { "max_um": 1e3 } },
        "thirds": { "validate": "hold-out", "of": "fit-S2", "rows": "table", "folds": 3, "limits": { "rms_um": 1e3 } },
        "groups": { "validate": "hold-out", "of": "fit-S2", "rows": "table", "folds": [[5, 8], [16]] },
    });
    let recipe = with(selecting(), judged);
    held_and_in_batches(at, &recipe, "touches", &[1_000_000, 97, 20], &|size| {
        same(size, &verdicts(at, "batches"), &verdicts(at, "held"), 1e-6);
    });
}

/// Trials select anew, as those of rows that are held do.
#[test]
fn trials_of_selected_terms_have_the_distributions_of_rows_that_are_held() {
    let trials = 200.0_f64;
    let folder = temporary();
    let at = folder.path();
    let stage =
        json!({ "estimate": "monte-carlo", "of": "fit-S2", "trials": trials, "coverage_probability": 0.5, "seed": 3 });
    let recipe = with(selecting(), json!({ "trials": stage }));
    let found: std::cell::RefCell<Vec<Calibration>> = Default::default();
    held_and_in_batches(at, &recipe, "touches", &[200, 97], &|_| {
        found.borrow_mut().push(calibration(at, "batches", "trials"));
    });
    let (held, found) = (calibration(at, "held", "trials"), found.into_inner());
    let of = |all: &Calibration, name: &str| -> SimulatedParameter {
        let known = all.monte_carlo.clone().expect("trials");
        known.parameters.into_iter().find(|own| own.name == name).expect("the same parameters")
    };
    for held in &held.monte_carlo.clone().expect("trials").parameters {
        let [one, other] = [0, 1].map(|index| of(&found[index], &held.name));
        let u = held.standard_uncertainty;
        assert!((one.mean - other.mean).abs() <= 1e-6 * u, "{}: {one:?} {other:?}", held.name);
        assert!((one.standard_uncertainty - other.standard_uncertainty).abs() <= 1e-6 * u, "{}", held.name);
        assert_eq!(one.gum.is_some(), held.gum.is_some(), "{}", held.name);
        assert!((one.mean - held.mean).abs() <= 5.0 * u * (2.0 / trials).sqrt(), "{}: {one:?} {held:?}", held.name);
        if u > 0.0 {
            // Terms that are left out of some trials and kept in others have no normal distribution.
            let ratio = one.standard_uncertainty / u;
            assert!((ratio - 1.0).abs() < 8.0 / trials.sqrt(), "{}: {ratio}", held.name);
        }
    }
}

/// Where a run selects, checking tells what the rows determine, and both refuse alike.
#[test]
fn checking_says_what_running_says() {
    let folder = temporary();
    let at = folder.path();
    let say = |select: Value, rows: usize, command: &[&str]| {
        let recipe = selecting().set("fit-S2", "select", select);
        if rows > 0 { recipe.set("touches", "batch_rows", json!(rows)) } else { recipe }.write(at);
        let printed = as_typed(at, command);
        let _ = std::fs::remove_dir_all(at.join("out"));
        printed
    };
    let (check, run) = (["check", "recipe.yaml", "--json"], ["run", "recipe.yaml", "--out", "out"]);
    let good = json!({ "candidates": ["E*"], "level": 0.1 });
    let planned = |rows: usize| {
        let printed = say(good.clone(), rows, &check);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let found: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        let planned = found["estimates"][0]["planned"].clone();
        assert!(planned["rank"].is_u64(), "{planned}");
        (planned["rank"].clone(), planned["unknowns"].clone(), planned["observations"].clone())
    };
    assert_eq!(planned(97), planned(0));
    assert_eq!(say(good, 97, &run).status, 0);
    for command in [&check[..2], &run] {
        let wrong = json!({ "candidates": ["E*", "EXX[7]"] });
        let [held, batched] = [0, 97].map(|rows| say(wrong.clone(), rows, command));
        assert_eq!(batched.status, held.status);
        let told = "`EXX[7]` matches no parameter of the machine that is estimated";
        for printed in [held, batched] {
            assert!(printed.stderr.contains(told) && printed.stderr.contains("recipe.yaml:"), "{}", printed.stderr);
        }
    }
}
