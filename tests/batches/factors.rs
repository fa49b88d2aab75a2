//! Factors on the uncertainties of stages are those of rows that are held.

use abbe_core::{Calibration, SimulatedParameter};
use serde_json::{Value, json};

use super::again::{same, verdicts, with};
use super::{ESTIMATES, calibration, run};
use crate::fleet::shards::of_parts;
use crate::support::{Variant, temporary};

fn per_stage(name: &str, estimate: &str) -> Variant {
    of_parts(name, estimate).set(estimate, "variance", json!("per-stage"))
}

/// Whether both have the same factors, values and uncertainties, these to 1e-7 standard uncertainties.
fn same_factors(what: &str, found: &Calibration, expected: &Calibration) {
    assert!(!expected.fit.variance.is_empty(), "{what}: no factors");
    assert_eq!(found.fit.variance.len(), expected.fit.variance.len(), "{what}");
    for one in &expected.fit.variance {
        let other = found.fit.variance.iter().find(|other| other.stage == one.stage).expect("the same stages");
        assert!((other.factor / one.factor - 1.0).abs() < 1e-8, "{what}: {one:?} {other:?}");
        match (one.degrees_of_freedom, other.degrees_of_freedom) {
            (Some(one), Some(other)) => assert!((other / one - 1.0).abs() < 1e-7, "{what}: {one} {other}"),
            (one, other) => assert_eq!(one, other, "{what}"),
        }
    }
    let fit = |of: &Calibration| (of.fit.observations, of.fit.unknowns, of.fit.rank, of.fit.degrees_of_freedom);
    assert_eq!(fit(found), fit(expected), "{what}");
    assert!((found.fit.sigma / expected.fit.sigma - 1.0).abs() < 1e-8, "{what}");
    for one in expected.parameters.iter().chain(&expected.artefacts) {
        let other = found.get(&one.name).unwrap_or_else(|| panic!("{what}: {} is missing", one.name));
        let u = one.standard_uncertainty;
        let apart = (one.value - other.value).abs().max((u - other.standard_uncertainty).abs());
        assert!(other.status == one.status && apart <= 1e-7 * u, "{what}: {} is off by {:e} u", one.name, apart / u);
    }
    let budget = |of: &Calibration| of.uncertainty.clone().expect("a budget").parameters;
    for one in budget(expected) {
        let other = budget(found).into_iter().find(|other| other.name == one.name).expect("the same parameters");
        let inputs = |of: &abbe_core::ParameterBudget| -> Vec<String> {
            let mut inputs: Vec<String> = of.contributions.iter().map(|part| part.input.clone()).collect();
            inputs.sort();
            inputs
        };
        assert_eq!(inputs(&one), inputs(&other), "{what}: {}", one.name);
        match (one.degrees_of_freedom, other.degrees_of_freedom) {
            (Some(one_is), Some(other_is)) => assert!((other_is / one_is - 1.0).abs() < 1e-6, "{what}: {}", one.name),
            (one, other) => assert_eq!(one, other, "{what}"),
        }
    }
}

/// The touches of a recipe in two data sets and two artefact stages, the second of which states another uncertainty.
fn in_two_stages(stated_um: f64) -> Variant {
    let mut recipe = of_parts("tango-hu40t", "fit-S3");
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    let (touches, table) = (stages["touches"].clone(), stages["table"].clone());
    for (name, first, stated) in [("even", 2, 1.6), ("odd", 1, stated_um)] {
        let (mut ingest, mut table) = (touches.clone(), table.clone());
        ingest["keep"] = json!({ "group": (first..=28).step_by(2).collect::<Vec<u32>>() });
        table["from"] = json!(format!("touches-{name}"));
        table["standard_uncertainty_um"] = json!(stated);
        stages.insert(format!("touches-{name}"), ingest);
        stages.insert(name.to_owned(), table);
    }
    let parameters: Vec<Value> = ["@S3", "even.*", "odd.*"].map(|it| json!(it)).to_vec();
    stages["fit-S3"]["observations"] = json!(["even", "odd", "bar"]);
    stages["fit-S3"]["parameters"] = json!(parameters);
    stages["fit-S3"]["variance"] = json!("per-stage");
    recipe
}

fn in_batches(recipe: &Variant, rows: [usize; 2]) -> Variant {
    let recipe = Variant(recipe.0.clone());
    recipe.set("touches-even", "batch_rows", json!(rows[0])).set("touches-odd", "batch_rows", json!(rows[1]))
}

#[test]
fn factors_are_those_of_rows_that_are_held() {
    for (name, estimate, from) in ESTIMATES {
        let folder = temporary();
        let at = folder.path();
        per_stage(name, estimate).write(at);
        let printed = run(at, "held");
        assert!([0, 1, 3].contains(&printed.status), "{name}: {}", printed.stderr);
        for rows in [97, 20] {
            per_stage(name, estimate).set(from, "batch_rows", json!(rows)).write(at);
            let printed_in_batches = run(at, "batches");
            assert_eq!(printed_in_batches.status, printed.status, "{name}: {}", printed_in_batches.stderr);
            let [found, expected] = ["batches", "held"].map(|out| calibration(at, out, estimate));
            same_factors(&format!("{name}, {estimate}, {rows} rows a batch"), &found, &expected);
        }
    }
}

/// Both data sets in batches, or one of them, with factors of 1 to 8.
#[test]
fn factors_of_several_stages_are_those_of_rows_that_are_held() {
    for stated in [0.3, 1.6, 12.0] {
        let folder = temporary();
        let at = folder.path();
        let recipe = in_two_stages(stated);
        recipe.write(at);
        let printed = run(at, "held");
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let expected = calibration(at, "held", "fit-S3");
        for rows in [[1_000_000, 1_000_000], [97, 20], [20, 150]] {
            in_batches(&recipe, rows).write(at);
            let printed = run(at, "batches");
            assert_eq!(printed.status, 0, "{}", printed.stderr);
            same_factors(&format!("{stated} um, {rows:?}"), &calibration(at, "batches", "fit-S3"), &expected);
        }
        Variant(recipe.0.clone()).set("touches-even", "batch_rows", json!(60)).write(at);
        let printed = run(at, "batches");
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        same_factors(&format!("{stated} um, one held"), &calibration(at, "batches", "fit-S3"), &expected);
    }
}

/// Those who repeat an estimate get its rows with the uncertainties that it used, and so do tables of residuals.
#[test]
fn who_repeats_the_estimate_gets_its_uncertainties() {
    let folder = temporary();
    let at = folder.path();
    let trials = 200.0_f64;
    let judged = json!({
        "left": { "validate": "residuals", "of": "fit-S3", "limits": { "max_um": 1e3 } },
        "thirds": { "validate": "hold-out", "of": "fit-S3", "rows": "odd", "folds": 3, "limits": { "rms_um": 1e3 } },
        "trials": { "estimate": "monte-carlo", "of": "fit-S3", "trials": trials, "coverage_probability": 0.5, "seed": 3 },
    });
    let recipe = with(in_two_stages(12.0), judged);
    recipe.write(at);
    let printed = run(at, "held");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    in_batches(&recipe, [97, 40]).write(at);
    let printed = run(at, "batches");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    same("per-stage", &verdicts(at, "batches"), &verdicts(at, "held"), 1e-6);
    let known = |out: &str| calibration(at, out, "trials").monte_carlo.expect("trials");
    let (held, found) = (known("held"), known("batches"));
    let (mut ratios, mut count) = (0.0, 0.0);
    for one in &held.parameters {
        let other: &SimulatedParameter =
            found.parameters.iter().find(|other| other.name == one.name).expect("the same parameters");
        let ratio = other.standard_uncertainty / one.standard_uncertainty;
        assert!((ratio - 1.0).abs() < 5.0 / trials.sqrt(), "{}: {ratio}", one.name);
        ratios += ratio;
        count += 1.0;
    }
    // Rows with their stated uncertainties would tell several times as much; the mean scatters by 3 %.
    assert!((ratios / count - 1.0_f64).abs() < 0.15, "{}", ratios / count);
    let residuals = |out: &str| -> std::collections::BTreeSet<String> {
        let text = crate::support::read(&at.join(out).join("recipe/fit-S3.residuals.csv"));
        text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect()
    };
    assert_eq!(residuals("batches").len(), residuals("held").len());
}
