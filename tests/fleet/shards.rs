//! Shards: one estimate, however its files are dealt out, and whatever happens to jobs.

use std::fs;
use std::path::Path;

use abbe_core::{Calibration, Estimated};
use serde_json::{Value, json};

use super::plant::{bounded, lines, ok, quiet, sabotaged, start};
use super::{contents, same};
use crate::plugins::valid;
use crate::support::{Random, Variant, json_file, read, recipes, root, temporary, values, write};

/// Estimates of recipes of this repository whose rows are independent of each other: recipe, estimate, ingest stage.
const ESTIMATES: [(&str, &str, &str); 5] = [
    ("first-steps", "fit", "touches"),
    ("cylinder-kx8", "fit-both", "touches-s2"),
    ("samba", "fit-without-bar", "masters"),
    ("sphere-hu40t", "fit", "strategy-1"),
    ("mfb-ucp710", "fit-bar", "bar-runs"),
];

/// Writes a recipe whose rows of an ingest stage lie in `count` files, each row in one of them by chance.
fn dealt_out(at: &Path, recipe: Variant, from: &str, count: usize, random: &mut Random) {
    let text = read(&recipe.path(from, "path"));
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header = lines.next().expect("a header").to_owned();
    let mut files = vec![vec![header]; count];
    for (row, line) in lines.enumerate() {
        // None of them is empty.
        let place = if row < count { row } else { random.below(count) };
        files[place].push(line.to_owned());
    }
    let names: Vec<String> = (0..count).map(|number| format!("data/{from}-{number}.csv")).collect();
    for (name, rows) in names.iter().zip(files) {
        write(&at.join(name), &(rows.join("\n") + "\n"));
    }
    recipe.set(from, "path", json!(names)).write(at);
}

/// A recipe with one estimate that can be made of parts: without robust weights, and with the time scale of its drift stated.
pub(crate) fn of_parts(name: &str, estimate: &str) -> Variant {
    let mut recipe = Variant::of(&recipes()[name]).only(&[estimate]);
    recipe.stage(estimate).as_object_mut().expect("settings").remove("robust");
    for stage in recipe.0["stages"].as_object_mut().expect("stages").values_mut() {
        for line in stage.get_mut("errors").and_then(Value::as_array_mut).into_iter().flatten() {
            if line.get("drift").is_some() && line.get("time_s").is_none() {
                line["time_s"] = json!({ "": [0, 20_000] });
            }
        }
    }
    recipe
}

fn fleet(at: &Path, estimate: &str, from: &str, files: usize) {
    let shards = format!("{{ stage: {estimate}, from: {from}, files: {files} }}");
    let text = format!("abbe_fleet: 1\nfamilies:\n  one: {{ recipe: recipe.yaml, shards: {shards} }}\n");
    write(&at.join("fleet.yaml"), &text);
}

/// Adds an estimate in five shards to the fleet of a plant.
pub(crate) fn added(at: &Path, random: &mut Random) {
    let (name, estimate, from) = ESTIMATES[0];
    dealt_out(&at.join("survey"), of_parts(name, estimate), from, 5, random);
    let fleet = at.join("fleet.yaml");
    let shards = format!("{{ stage: {estimate}, from: {from}, files: 1 }}");
    let family = format!(
        "  survey:\n    recipe: survey/recipe.yaml\n    shards: {shards}\n    machine: big\n    at: 1\n    unit: week\n"
    );
    write(&fleet, &(read(&fleet) + &family));
}

fn calibration(path: &Path) -> Calibration {
    Calibration::from_json(&read(path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Whether two estimates are the same to 1e-9 of their uncertainties.
pub(crate) fn agree(what: &str, of_shards: &Calibration, single: &Calibration) {
    assert_eq!(values(of_shards).count(), values(single).count(), "{what}");
    for one in values(single) {
        let Estimated { value, standard_uncertainty, status, unit, .. } =
            of_shards.get(&one.name).unwrap_or_else(|| panic!("{what}: {} is gone", one.name));
        assert_eq!((status, unit), (&one.status, &one.unit), "{what}: {}", one.name);
        let allowed = 1e-9 * one.standard_uncertainty;
        assert!((value - one.value).abs() <= allowed, "{what}: {}: {value} and {}", one.name, one.value);
        let apart = (standard_uncertainty - one.standard_uncertainty).abs();
        assert!(apart <= allowed, "{what}: {}: u = {standard_uncertainty} and {}", one.name, one.standard_uncertainty);
    }
    let u = |name: &str| single.get(name).map_or(0.0, |known| known.standard_uncertainty);
    let [all, others] = [single, of_shards].map(|calibration| &calibration.covariance);
    for (row, one) in all.order.iter().enumerate() {
        for (column, other) in all.order.iter().enumerate() {
            let [at, to] = [one, other].map(|name| others.index(name).expect("the same quantities"));
            let apart = (others.rows[at][to] - all.rows[row][column]).abs();
            assert!(
                apart <= 1e-8 * u(one) * u(other),
                "{what}: the covariance of {one} and {other} is off by {apart:e}"
            );
        }
    }
    let [fit, other] = [single, of_shards].map(|calibration| &calibration.fit);
    assert_eq!(
        (fit.observations, fit.unknowns, fit.rank, fit.degrees_of_freedom),
        (other.observations, other.unknowns, other.rank, other.degrees_of_freedom),
        "{what}"
    );
    let figures = |calibration: &Calibration| {
        let fit = &calibration.fit;
        [fit.sigma, fit.residual_max_um, fit.residual_mean_abs_um, fit.residual_rms_um, fit.condition]
    };
    for (one, other) in figures(single).into_iter().zip(figures(of_shards)) {
        assert!((one - other).abs() <= 1e-7 * one.abs(), "{what}: {one} and {other}");
    }
    assert_eq!(fit.statuses, other.statuses, "{what}");
    let budget = |calibration: &Calibration| calibration.uncertainty.clone().expect("a budget");
    let (one, other) = (budget(single), budget(of_shards));
    assert!((one.joint.rectangle_factor - other.joint.rectangle_factor).abs() < 1e-9, "{what}");
    for parameter in &one.parameters {
        let same = other.parameters.iter().find(|same| same.name == parameter.name).expect("the same quantities");
        let apart = (same.expanded_uncertainty - parameter.expanded_uncertainty).abs();
        assert!(apart <= 1e-8 * parameter.expanded_uncertainty, "{what}: {}", parameter.name);
        let inputs = |budget: &abbe_core::ParameterBudget| {
            budget.contributions.iter().map(|part| part.input.clone()).collect::<Vec<_>>()
        };
        assert_eq!(inputs(same), inputs(parameter), "{what}: {}", parameter.name);
    }
    let rows = |calibration: &Calibration| {
        let mut all: Vec<Value> = calibration.data.iter().map(|record| json!(record)).collect();
        all.sort_by_key(Value::to_string);
        all
    };
    assert_eq!(rows(of_shards), rows(single), "{what}");
}

#[test]
fn shards_are_one_estimate() {
    let mut random = Random::new(41);
    for (name, estimate, from) in ESTIMATES {
        let folder = temporary();
        let at = folder.path();
        let recipe = of_parts(name, estimate);
        let is_of_many = recipe.0["stages"][from]["path"].as_str().is_some_and(|path| path.contains('*'));
        let count = 2 + random.below(6);
        match is_of_many {
            true => drop(recipe.write(at)),
            false => dealt_out(at, recipe, from, count, &mut random),
        }
        let printed = quiet(at, &["run", "recipe.yaml", "--out", "single"]);
        assert!([0, 3].contains(&printed.status), "{name}: {}", printed.stderr);
        let single = calibration(&at.join(format!("single/recipe/{estimate}.calibration.json")));
        for files in [1, 1 + random.below(count), 1000] {
            fleet(at, estimate, from, files);
            ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
            ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
            ok(&quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]));
            let found = calibration(&at.join(format!("fleet.merged/calibrations/one.{estimate}.calibration.json")));
            agree(&format!("{name}, {estimate}, {files} files a shard"), &found, &single);
        }
        let schema = json_file(&root().join("docs/schemas/manifest.schema.json"));
        for line in lines(&at.join("fleet.manifest.jsonl")) {
            valid("a line of a manifest", &schema, &line);
        }
    }
}

/// Rounds by hand, as engines deal them out; answers of any round lost or damaged, jobs done twice at a time.
#[test]
fn lost_and_doubled_shards_change_nothing() {
    let (name, estimate, from) = ESTIMATES[0];
    for seed in 0..3 {
        let mut random = Random::new(500 + seed);
        let folder = temporary();
        let at = folder.path();
        dealt_out(at, of_parts(name, estimate), from, 5, &mut random);
        fleet(at, estimate, from, 1 + random.below(2));
        ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
        ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "1"]));
        ok(&quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]));
        let expected = contents(at);
        for name in ["fleet.results", "fleet.merged"] {
            fs::remove_dir_all(at.join(name)).expect("results");
        }
        ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
        let manifest = at.join("fleet.manifest.jsonl");
        for round in 0.. {
            assert!(round < 40, "seed {seed}: the rounds do not end");
            let all = ["fleet", "job", "fleet.manifest.jsonl", "--index", "0", "--count", "9"];
            for process in [start(at, &all), start(at, &all)] {
                ok(&bounded(process, std::time::Duration::from_secs(600)));
            }
            if round < 8 {
                sabotaged(&at.join("fleet.results"), &mut random);
            }
            let printed = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]);
            let next = quiet(at, &["fleet", "next", "fleet.manifest.jsonl"]);
            ok(&next);
            if next.stdout.contains(" 1 are done") {
                break;
            }
            // As long as it is not done, nothing is merged.
            let said = printed.stdout + &printed.stderr;
            assert_eq!(printed.status, 1, "{said}");
            assert!(["another round", "are open", "have no result"].iter().any(|word| said.contains(word)), "{said}");
        }
        ok(&quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]));
        same(&contents(at), &expected, &format!("seed {seed}"));
        // A plan that is made again goes on where it was.
        let before = read(&manifest);
        ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
        assert!(quiet(at, &["fleet", "status", "fleet.manifest.jsonl"]).stdout.contains(" 0 open"), "{before}");
    }
}

#[test]
fn what_needs_all_rows_is_refused() {
    for (recipe, estimate, from, set, said) in [
        ("tango-hu40t", "fit-S3", "touches", None, "`robust` needs all rows at once"),
        ("tango-hu40t", "fit-S2", "bar-runs", None, "the rows of `bar` (length) depend on each other"),
        ("tango-hu40t", "table", "touches", None, "`table` is no estimate from measurements"),
        ("cylinder-kx8", "fit-S1", "touches-s2", None, "`fit-S1` observes nothing of `touches-s2`"),
        ("samba", "fit-centres", "early", None, "the rows of `centres` (balls) depend on each other"),
        (
            "tango-hu40t",
            "fit-S2",
            "touches",
            Some(("touches", "average", json!({ "over": "file", "by": ["feature", "group"] }))),
            "rows are means of rows of several files",
        ),
        (
            "tango-hu40t",
            "fit-S2",
            "touches",
            Some(("fit-S2", "select", json!({ "candidates": ["E*"] }))),
            "`select` needs all rows at once",
        ),
        ("samba", "fit-no-scale", "masters", None, "`on_confounded` needs all rows at once"),
        ("tango-hu40t", "fit-S2", "touches", None, "the machine takes settings from its data"),
        (
            "tango-hu40t",
            "fit-S2",
            "touches",
            Some(("table", "uncertainty", json!({ "shared": [{ "by": "group", "standard_uncertainty_um": 1.0 }] }))),
            "rows share errors with others",
        ),
        (
            "tango-hu40t",
            "fit-S2",
            "touches",
            Some(("fit-S2", "parameters", json!(["dxt", "dyt", "dzt", "EZS[1]", "table.*"]))),
            "`EZS[1]` matches no parameter",
        ),
    ] {
        let folder = temporary();
        let at = folder.path();
        let variant = match set {
            Some((stage, key, value)) => of_parts(recipe, estimate).set(stage, key, value),
            None if estimate == "table" => Variant::of(&recipes()[recipe]),
            None => Variant::of(&recipes()[recipe]).only(&[estimate]),
        };
        dealt_out(at, variant, from, 3, &mut Random::new(9));
        fleet(at, estimate, from, 1);
        let planned = quiet(at, &["fleet", "plan", "fleet.yaml"]);
        let printed = match planned.status {
            0 => quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--retries", "0"]),
            _ => planned,
        };
        assert_eq!(printed.status, 1, "{estimate}: {}{}", printed.stdout, printed.stderr);
        assert!(printed.stdout.contains(said), "{estimate}: {}{}", printed.stdout, printed.stderr);
        let merged = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]);
        assert_eq!(merged.status, 1, "{estimate}: {}{}", merged.stdout, merged.stderr);
    }
}
