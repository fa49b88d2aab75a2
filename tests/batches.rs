//! Data sets that are read in batches: the estimate of all rows, however large the batches are and however many threads read them, in
//! memory that does not grow with the rows.

mod absurd;
mod again;
mod factors;
mod files;
mod selected;

use std::path::Path;
use std::process::Command;

use abbe_core::Calibration;
use serde_json::{Value, json};

use crate::fleet::shards::{agree, of_parts};
use crate::support::{Printed, Random, Small, Variant, as_typed, json_file, read, root, temporary, tree, write};

/// Estimates of recipes of this repository whose rows are independent of each other: recipe, estimate, ingest stage.
const ESTIMATES: [(&str, &str, &str); 7] = [
    ("tango-hu40t", "fit-S2", "touches"),
    ("tango-hu40t", "fit-S3", "touches"),
    ("first-steps", "fit", "touches"),
    ("cylinder-kx8", "fit-both", "touches-s2"),
    ("samba", "fit-without-bar", "masters"),
    ("sphere-hu40t", "fit", "strategy-1"),
    ("mfb-ucp710", "fit-bar", "bar-runs"),
];

fn calibration(at: &Path, out: &str, estimate: &str) -> Calibration {
    let path = at.join(out).join(format!("recipe/{estimate}.calibration.json"));
    Calibration::from_json(&read(&path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn run(at: &Path, out: &str) -> Printed {
    as_typed(at, &["run", "recipe.yaml", "--out", out])
}

#[test]
fn batches_are_one_estimate() {
    for (name, estimate, from) in ESTIMATES {
        let folder = temporary();
        let at = folder.path();
        of_parts(name, estimate).write(at);
        let printed = run(at, "whole");
        // Implausible errors of data that were made so are told of both.
        assert!([0, 1, 3].contains(&printed.status), "{name}: {}", printed.stderr);
        let whole = calibration(at, "whole", estimate);
        for rows in [1_000_000, 97, 20] {
            of_parts(name, estimate).set(from, "batch_rows", json!(rows)).write(at);
            let in_batches = run(at, "batches");
            assert_eq!(in_batches.status, printed.status, "{name}: {}", in_batches.stderr);
            agree(&format!("{name}, {estimate}, {rows} rows a batch"), &calibration(at, "batches", estimate), &whole);
        }
    }
}

/// Touches over and over, each moved by noise, some by far more, as a file of their own.
fn with_gross_errors(recipe: Variant, at: &Path, copies: usize) -> Variant {
    let touches = read(&recipe.path("touches", "path"));
    let is_header = |line: &&str| line.contains("X_mm");
    let head = touches.lines().position(|line| is_header(&line)).expect("a header");
    let header: Vec<&str> = touches.lines().nth(head).expect("a header").split(',').collect();
    let axes: Vec<usize> =
        (0..header.len()).filter(|place| ["X_mm", "Y_mm", "Z_mm"].contains(&header[*place])).collect();
    let random = &mut Random::new(28);
    let mut text: Vec<String> = touches.lines().take(head + 1).map(str::to_owned).collect();
    for _ in 0..copies {
        for line in touches.lines().skip(head + 1).filter(|line| !line.is_empty() && !line.starts_with('#')) {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            for (index, place) in axes.iter().enumerate() {
                let gross = if index == 0 && random.below(12) == 0 { 0.04 } else { 0.0 };
                let value: f64 = cells[*place].parse().expect("a number");
                cells[*place] = format!("{:.6}", value + gross + 5e-4 * random.normal());
            }
            text.push(cells.join(","));
        }
    }
    write(&at.join("touches.csv"), &(text.join("\n") + "\n"));
    recipe.set("touches", "path", json!("touches.csv"))
}

/// Weights, the scale and outliers are those of a run that holds all rows, as far as weights and scale settle in both.
#[test]
fn gross_errors_are_found_in_batches() {
    for (loss, copies) in [("tukey", 1), ("tukey", 8), ("huber", 8)] {
        let folder = temporary();
        let at = folder.path();
        let recipe = of_parts("first-steps", "fit").set("fit", "robust", json!(loss));
        let recipe = with_gross_errors(recipe, at, copies);
        recipe.write(at);
        let printed = run(at, "whole");
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let whole = calibration(at, "whole", "fit");
        assert!(whole.outliers.len() > 10 * copies);
        for rows in [97, 1000] {
            Variant(recipe.0.clone()).set("touches", "batch_rows", json!(rows)).write(at);
            let printed = run(at, "batches");
            assert_eq!(printed.status, 0, "{}", printed.stderr);
            let found = calibration(at, "batches", "fit");
            for one in whole.parameters.iter().chain(&whole.artefacts) {
                let other = found.get(&one.name).expect("the same parameters");
                let (apart, allowed) = ((one.value - other.value).abs(), 5e-3 * one.standard_uncertainty);
                assert!(apart <= allowed, "{loss}, {copies}, {rows}: {} is off by {apart:e}", one.name);
                let apart = (one.standard_uncertainty - other.standard_uncertainty).abs();
                assert!(apart <= allowed, "{loss}, {copies}, {rows}: u of {} is off by {apart:e}", one.name);
            }
            let places = |found: &Calibration| found.outliers.iter().map(|row| row.place()).collect::<Vec<_>>();
            assert_eq!(places(&found), places(&whole), "{loss}, {copies}, {rows}");
            assert_eq!((found.fit.observations, found.fit.rank), (whole.fit.observations, whole.fit.rank));
        }
    }
}

/// A core that this process may use.
pub fn core() -> String {
    let status = std::fs::read_to_string("/proc/self/status").expect("the status of this process");
    let list = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).expect("its cores");
    list.trim().split([',', '-']).next().expect("a core").to_owned()
}

/// On one core and on all there are the same bytes.
#[cfg(target_os = "linux")]
#[test]
fn bytes_do_not_depend_on_threads() {
    if Command::new("taskset").arg("--version").output().is_err() {
        return crate::support::skipped("bytes_do_not_depend_on_threads", "there is no taskset");
    }
    let (name, estimate, from) = ESTIMATES[0];
    let folder = temporary();
    let at = folder.path();
    of_parts(name, estimate).set(from, "batch_rows", json!(60)).write(at);
    let printed = run(at, "many");
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let program = crate::support::program(at, &["run", "recipe.yaml", "--out", "one"]);
    let alone = Command::new("taskset")
        .args(["-c", &core()])
        .arg(program.get_program())
        .args(program.get_args())
        .current_dir(at)
        .output()
        .expect("taskset starts");
    assert!(alone.status.success(), "{}", String::from_utf8_lossy(&alone.stderr));
    let files = |out: &str| -> Vec<_> {
        let at = at.join(out);
        let found = tree(&at).into_iter().filter(|name| name.extension() == Some("json".as_ref()));
        // The record of the run has its times.
        found.filter(|name| !name.ends_with("run.json")).map(|name| (name.clone(), read(&at.join(&name)))).collect()
    };
    assert!(files("one").len() >= 2);
    assert!(files("one") == files("many"));
}

/// The small recipe with the estimate `rough` alone, whose touches are read in batches of so many rows.
fn small(rows: usize) -> (Small, Variant) {
    let small = Small::new();
    let recipe =
        small.read("recipe.yaml").replace("data/touches.csv }", &format!("data/touches.csv, batch_rows: {rows} }}"));
    small.write("recipe.yaml", &recipe);
    let variant = Variant(serde_yaml::from_str(&recipe).expect("the recipe is YAML")).only(&["rough"]);
    variant.write(small.folder.path());
    (small, variant)
}

#[test]
fn rows_are_named_where_they_stand() {
    let (small, _) = small(10);
    let touches = small.read("data/touches.csv");
    let place = 1
        + touches.lines().position(|line| line.starts_with("feature") || line.contains("_mm")).expect("a header")
        + 25;
    let changed = |change: &dyn Fn(&str) -> String| {
        let lines = touches.lines().enumerate();
        let lines = lines.map(|(index, line)| if index + 1 == place { change(line) } else { line.to_owned() });
        small.write("data/touches.csv", &(lines.collect::<Vec<_>>().join("\n") + "\n"));
        let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
        assert!(!small.path("out").exists(), "{printed:?}");
        printed.stderr
    };
    let cell = |line: &str, place: usize, text: &str| {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells[place] = text;
        cells.join(",")
    };
    // In the third batch: a cell that is no number, one cell too many, a feature that no artefact has, a row beyond the travel.
    let header: Vec<&str> = touches.lines().nth(place - 26).expect("a header").split(',').collect();
    let column = |name: &str| header.iter().position(|cell| *cell == name).expect("a column");
    for (change, said) in [
        (&(|line: &str| cell(line, column("X_mm"), "1,5x")) as &dyn Fn(&str) -> String, "cells were expected"),
        (&|line: &str| cell(line, column("X_mm"), "abc"), "`X_mm` is `abc`; a number was expected"),
        (&|line: &str| cell(line, column("feature"), "99"), "feature 99 is taken by no artefact"),
        (&|line: &str| cell(line, column("X_mm"), "1e9"), "X"),
    ] {
        let stderr = changed(change);
        let said = said.replace("cells were expected", &format!("{} were expected", header.len()));
        assert!(stderr.contains(&format!("touches.csv:{place}")) && stderr.contains(&said), "{said}: {stderr}");
    }
}

#[test]
fn what_needs_all_rows_is_refused() {
    let tango = |set: &[(&str, &str, Value)]| {
        let mut recipe = of_parts("tango-hu40t", "fit-S2").set("touches", "batch_rows", json!(100));
        for (stage, key, value) in set {
            recipe.0["stages"][stage][key] = value.clone();
        }
        recipe
    };
    let more = |mut recipe: Variant, name: &str, stage: Value| {
        recipe.0["stages"][name] = stage;
        recipe
    };
    for (recipe, said) in [
        (
            tango(&[("fit-S2", "variance", json!("per-stage")), ("fit-S2", "robust", json!("tukey"))]),
            "`variance` needs all rows at once (with `robust`",
        ),
        (tango(&[("fit-S2", "on_confounded", json!("drop"))]), "`on_confounded` needs all rows at once"),
        (
            tango(&[("fit-S2", "select", json!({ "candidates": ["E*"], "by": "prediction" }))]),
            "`select` needs all rows at once (`by: prediction` leaves out runs of rows",
        ),
        (
            tango(&[("fit-S2", "select", json!({ "candidates": ["E*"] })), ("fit-S2", "robust", json!("tukey"))]),
            "`select` needs all rows at once (with `robust`",
        ),
        (tango(&[("fit-S2", "per", json!("file"))]), "has groups (`per`)"),
        (tango(&[("fit-S2", "estimate", json!("sequential"))]), "this estimator needs all rows at once"),
        (tango(&[("table", "unseen", json!({ "group": [5] }))]), "`table` needs all rows of `touches` at once"),
        (tango(&[("table", "pooled", json!({ "by": "group" }))]), "`table` needs all rows of `touches` at once"),
        (tango(&[("bar-runs", "batch_rows", json!(10))]), "the rows of `bar` (length) depend on each other"),
        (
            tango(&[("touches", "average", json!({ "over": "file", "by": ["feature", "group"] }))]),
            "`average` needs rows of other batches",
        ),
        (tango(&[("touches", "motion", json!({ "axes": ["X"] }))]), "`motion` needs rows of other batches"),
        (tango(&[("touches", "batch_rows", json!(0))]), "batch_rows"),
        (
            tango(&[(
                "table",
                "uncertainty",
                json!({ "shared": [{ "by": "group", "standard_uncertainty_um": 1.0 }] }),
            )]),
            "rows share errors with others",
        ),
        (tango(&[("fit-S2", "parameters", json!(["dxt", "dyt", "dzt", "EZS[1]", "table.*"]))]), "`EZS[1]` matches no"),
        (
            more(tango(&[]), "next", json!({ "validate": "minimal-set", "of": "fit-S2" })),
            "asks about the rows that an estimate was made of",
        ),
        (
            more(
                tango(&[]),
                "next",
                json!({ "validate": "artefact-cmm", "of": "fit-S2", "features": "table",
                    "cmm": root().join("pipelines/data/tango-hu40t/realistic/facets-cmm.csv") }),
            ),
            "`artefact-cmm` needs all rows of `fit-S2` at once",
        ),
        (
            of_parts("tango-warming", "fit").set("touches", "batch_rows", json!(100)),
            "`time_constant[1]_s` needs all rows at once (as long as what it shapes is zero",
        ),
        (
            more(
                tango(&[]),
                "next",
                json!({ "estimate": "monte-carlo", "of": "fit-S2", "trials": 2000, "rows": "resampled" }),
            ),
            "`next` needs all rows of `touches` at once",
        ),
    ] {
        let folder = temporary();
        let at = folder.path();
        recipe.write(at);
        for command in [&["run", "recipe.yaml", "--out", "out"][..], &["check", "recipe.yaml"]] {
            let printed = as_typed(at, command);
            assert!([1, 2].contains(&printed.status) && !at.join("out").exists(), "{said}: {printed:?}");
            let words = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
            assert!(words.contains(said) && words.contains("recipe.yaml:"), "{said}: {}", printed.stderr);
        }
    }
    // A machine that takes its time scale from the data.
    let folder = temporary();
    let drifting = Variant::of(&crate::support::recipes()["tango-hu40t"]).only(&["fit-S2"]);
    drifting.set("touches", "batch_rows", json!(100)).write(folder.path());
    let printed = run(folder.path(), "out");
    assert!(printed.stderr.contains("the machine takes settings from its data"), "{}", printed.stderr);
}

/// Checking tells what the rows determine, as it does without batches; plans and simulations read all rows.
#[test]
fn other_commands_work() {
    let (batched, _) = small(10);
    let whole = Small::new();
    Variant(serde_yaml::from_str(&whole.read("recipe.yaml")).expect("YAML"))
        .only(&["rough"])
        .write(whole.folder.path());
    let checked = |small: &Small| {
        let printed = small.abbe(&["check", "recipe.yaml", "--json"]);
        assert_eq!(printed.status, 0, "{printed:?}");
        let found: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        found
    };
    let rank = |found: &Value| found["estimates"][0]["planned"]["rank"].as_u64();
    let (one, other) = (checked(&batched), checked(&whole));
    assert!(rank(&one).is_some() && rank(&one) == rank(&other), "{one} {other}");
    assert_eq!(batched.abbe(&["data", "recipe.yaml"]).status, 0);
    batched.write("truth.json", r#"{ "parameters": { "dxt": 0.001 } }"#);
    let simulated =
        batched.abbe(&["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "virtual"]);
    assert_eq!(simulated.status, 0, "{simulated:?}");
}

/// Remarks on rows that are left out are those of a run that holds all.
#[test]
fn rows_without_a_number_are_counted_once() {
    let (small, variant) = small(10);
    let touches = small.read("data/touches.csv");
    let marked: String = touches
        .lines()
        .enumerate()
        .map(|(index, line)| match index {
            20 | 40 => {
                line.split(',').map(|cell| if cell.contains('.') { "-" } else { cell }).collect::<Vec<_>>().join(",")
                    + "\n"
            }
            _ => format!("{line}\n"),
        })
        .collect();
    small.write("data/touches.csv", &marked);
    variant.set("touches", "no_data", json!(["-"])).write(small.folder.path());
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{printed:?}");
    assert_eq!(printed.stderr.matches("2 rows hold a mark of `no_data`").count(), 1, "{}", printed.stderr);
    let found = json_file(&small.path("out/recipe/rough.calibration.json"));
    assert_eq!(found["data"][1]["rows"].as_array().map(Vec::len), Some(3), "{}", found["data"]);
}

/// The largest memory of a run, KiB, and its status.
#[cfg(target_os = "linux")]
pub fn peak(at: &Path) -> (u64, Option<i32>) {
    let mut run = crate::support::program(at, &["run", "recipe.yaml", "--out", "out"]);
    let run = run.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    let mut child = run.spawn().expect("the program starts");
    let mut peak = 0;
    let status = loop {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let now = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let now = now.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok());
        peak = now.map_or(peak, |now: u64| now.max(peak));
        if let Some(status) = child.try_wait().expect("a child") {
            break status;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    };
    (peak, status.code())
}

/// Twenty times the rows, and hardly more memory.
#[cfg(target_os = "linux")]
#[test]
fn memory_does_not_grow_with_the_rows() {
    let folder = temporary();
    let at = folder.path();
    let recipe = of_parts("tango-hu40t", "fit-S2").set("touches", "batch_rows", json!(2000));
    let touches = read(&recipe.path("touches", "path"));
    let (header, rows) = touches.split_once('\n').expect("a header");
    let rows: Vec<&str> = rows.lines().collect();
    let recipe = recipe.set("touches", "path", json!("touches.csv"));
    recipe.write(at);
    let of = |count: usize| {
        let text: Vec<&str> = std::iter::once(header).chain(rows.iter().copied().cycle().take(count)).collect();
        write(&at.join("touches.csv"), &(text.join("\n") + "\n"));
        let (peak, status) = peak(at);
        assert_eq!(status, Some(0), "{count} rows");
        peak
    };
    let [few, many] = [6_000, 120_000].map(of);
    assert!(few > 10_000 && many < few + few / 10, "{few} kB for 6,000 rows, {many} kB for 120,000");
    // What is shown of them is a sample, and says so.
    let residuals = read(&at.join("out/recipe/fit-S2.residuals.csv"));
    let shown = residuals.lines().filter(|line| !line.starts_with('#')).count();
    assert!((4_700..5_300).contains(&shown), "{shown}");
    let record = json_file(&at.join("out/recipe/run.json"));
    let said = record["remarks"].to_string();
    assert!(said.contains(" rows of `touches`, chosen at random (seed 20)"), "{said}");
}
