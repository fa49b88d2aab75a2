//! Fleets: whatever happens to jobs, the merged results are those of one process, and the values are those of single runs.

mod at_once;
mod manifests;
pub(crate) mod plant;
pub(crate) mod shards;
#[cfg(unix)]
mod signals;
mod trials;
mod wrong;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::Calibration;
use serde_json::Value;

use crate::plugins::valid;
use crate::support::{Printed, Random, json_file, read, root, temporary, tree, write};
use plant::{Plant, bounded, lines, ok, quiet, sabotaged};

/// What a merge wrote, with the history.
pub(crate) fn merged(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    ok(&quiet(folder, &["fleet", "merge", "fleet.manifest.jsonl", "--calibrations"]));
    contents(folder)
}

/// The content of what is merged, by names.
pub(crate) fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let at = folder.join("fleet.merged");
    // A merge that was ended before it wrote anything leaves no folder.
    let names = if at.exists() { tree(&at) } else { Vec::new() };
    let mut found: BTreeMap<PathBuf, Vec<u8>> = names
        .into_iter()
        .filter(|name| !name.ends_with("written.jsonl"))
        .map(|name| (name.clone(), fs::read(at.join(&name)).expect("a file")))
        .collect();
    if let Ok(history) = fs::read(folder.join("plant.sqlite")) {
        found.insert("plant.sqlite".into(), history);
    }
    found
}

/// Plans, does and merges a plant in one process at a time.
fn reference(plant: &Plant) -> BTreeMap<PathBuf, Vec<u8>> {
    let folder = temporary();
    plant.write(folder.path());
    ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(folder.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "1"]));
    merged(folder.path())
}

pub(crate) fn same(found: &BTreeMap<PathBuf, Vec<u8>>, expected: &BTreeMap<PathBuf, Vec<u8>>, what: &str) {
    let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(found), names(expected), "{what}");
    for (name, content) in expected {
        assert!(found[name] == *content, "{what}: {} differs", name.display());
    }
}

#[test]
fn the_values_are_those_of_single_runs() {
    let plant = Plant::random(&mut Random::new(1));
    let folder = temporary();
    plant.write(folder.path());
    ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
    let printed = quiet(folder.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]);
    ok(&printed);
    assert_eq!(printed.stdout, format!("{} jobs done\n", plant.jobs()));
    merged(folder.path());
    for (machine, week) in plant.each() {
        let recipe = plant.recipe().replace("lengths.csv", &format!("data/{machine}/w{week}.csv"));
        write(&folder.path().join("single.yaml"), &recipe);
        let printed = quiet(folder.path(), &["run", "single.yaml", "--out", "single"]);
        assert!([0, 3].contains(&printed.status), "{}", printed.stderr);
        let calibration = |path: &Path| Calibration::from_json(&read(path)).unwrap_or_else(|error| panic!("{error}"));
        let single = calibration(&folder.path().join("single/single/fit.calibration.json"));
        let of_fleet =
            folder.path().join(format!("fleet.merged/calibrations/weekly-{machine}-{week}.fit.calibration.json"));
        let of_fleet = calibration(&of_fleet);
        assert_eq!(single.parameters.len(), of_fleet.parameters.len());
        for (one, other) in single.parameters.iter().zip(&of_fleet.parameters) {
            assert_eq!(one.name, other.name);
            assert!((one.value - other.value).abs() <= 1e-9 * one.standard_uncertainty, "{machine} {}", one.name);
            let apart = (one.standard_uncertainty - other.standard_uncertainty).abs();
            assert!(apart <= 1e-9 * one.standard_uncertainty, "{machine} {}", one.name);
        }
        // The table has all of it, with all digits.
        let table = read(&folder.path().join("fleet.merged/parameters.csv"));
        for parameter in &of_fleet.parameters {
            let value = Value::from(parameter.value);
            let row = format!("weekly/{machine}/{week},{machine},{week},{week},week,fit,{},{value},", parameter.name);
            // A whole number of weeks is written as one with a point.
            let row = row.replacen(&format!(",{week},{week},"), &format!(",{week},{week}.0,"), 1);
            assert!(table.contains(&row), "{row}\n{table}");
        }
    }
    let listed = quiet(folder.path(), &["history", "list", "plant.sqlite"]);
    ok(&listed);
    for machine in &plant.machines {
        assert!(listed.stdout.contains(&format!("{machine}: {} calibrations", plant.weeks.len())), "{}", listed.stdout);
    }
    // Everything is there: nothing is done or added again.
    let again = quiet(folder.path(), &["fleet", "run", "fleet.manifest.jsonl"]);
    assert_eq!(again.stdout, format!("0 jobs done, {} were done before\n", plant.jobs()));
    let before = contents(folder.path());
    same(&merged(folder.path()), &before, "merged again");
}

/// Jobs in any order and in batches of any size, some of them twice at a time, some of their results lost or damaged.
#[test]
fn lost_doubled_and_damaged_jobs_change_nothing() {
    for seed in 0..6 {
        let mut random = Random::new(100 + seed);
        let plant = Plant::random(&mut random);
        let expected = reference(&plant);
        let folder = temporary();
        plant.write(folder.path());
        ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
        let store = folder.path().join("fleet.results");
        for _ in 0..3 {
            let first = random.below(plant.jobs());
            let count = 1 + random.below(plant.jobs());
            let (first, count) = (first.to_string(), count.to_string());
            let job = ["fleet", "job", "fleet.manifest.jsonl", "--index", &first, "--count", &count];
            // Twice at the same time.
            let one = plant::start(folder.path(), &job);
            let other = plant::start(folder.path(), &job);
            for process in [one, other] {
                ok(&bounded(process, Duration::from_secs(600)));
            }
            sabotaged(&store, &mut random);
        }
        // A merge of what is there is none of everything, as long as something is open.
        let printed = quiet(folder.path(), &["fleet", "status", "fleet.manifest.jsonl", "--json"]);
        let status: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        let open = status["open"].as_array().expect("a list").len();
        assert_eq!(status["done"].as_u64().expect("a number") as usize + open, plant.jobs(), "{status}");
        ok(&quiet(folder.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
        same(&merged(folder.path()), &expected, &format!("seed {seed}"));
    }
}

/// The same fleet planned elsewhere, with the manifest in another folder, has the same jobs.
#[test]
fn a_manifest_knows_no_place() {
    let plant = Plant::random(&mut Random::new(7));
    let jobs = |printed: &Printed, manifest: &Path| {
        ok(printed);
        lines(manifest).into_iter().skip(1).collect::<Vec<_>>()
    };
    let (one, other) = (temporary(), temporary());
    for folder in [&one, &other] {
        plant.write(folder.path());
    }
    let first = jobs(&quiet(one.path(), &["fleet", "plan", "fleet.yaml"]), &one.path().join("fleet.manifest.jsonl"));
    fs::create_dir_all(other.path().join("elsewhere/deep")).expect("a folder");
    let manifest = "elsewhere/deep/fleet.manifest.jsonl";
    let second =
        jobs(&quiet(other.path(), &["fleet", "plan", "fleet.yaml", "--out", manifest]), &other.path().join(manifest));
    assert_eq!(first, second);
    ok(&quiet(&other.path().join("elsewhere"), &["fleet", "run", "deep/fleet.manifest.jsonl"]));
    ok(&quiet(one.path(), &["fleet", "run", "fleet.manifest.jsonl"]));
    let results = |folder: &Path| {
        let files = tree(folder).into_iter().filter(|name| name.extension() == Some("result".as_ref()));
        files.map(|name| (name.clone(), fs::read(folder.join(&name)).expect("a file"))).collect::<BTreeMap<_, _>>()
    };
    let found = results(&one.path().join("fleet.results"));
    assert_eq!(found.len(), plant.jobs());
    same(&results(&other.path().join("elsewhere/deep/fleet.results")), &found, "another place");
    // What one has done is done for the other.
    let id = first[0]["job"].as_str().expect("a hash");
    assert!(found.contains_key(Path::new(&format!("{}/{id}.result", &id[..2]))));
    let schema = json_file(&root().join("docs/schemas/manifest.schema.json"));
    for line in lines(&one.path().join("fleet.manifest.jsonl")) {
        valid("a line of a manifest", &schema, &line);
    }
}

/// What changes a result changes the job, and nothing else does.
#[test]
fn a_job_is_known_by_what_its_result_depends_on() {
    let plant = Plant::random(&mut Random::new(11));
    let folder = temporary();
    plant.write(folder.path());
    let ids = || {
        ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
        let jobs = lines(&folder.path().join("fleet.manifest.jsonl"));
        jobs.into_iter().skip(1).map(|job| job["job"].as_str().expect("a hash").to_owned()).collect::<Vec<_>>()
    };
    let before = ids();
    let (machine, week) = plant.each()[0].clone();
    let data = folder.path().join(format!("data/{machine}/w{week}.csv"));
    write(&data, &(read(&data) + "# a note\n"));
    let after = ids();
    assert_ne!(before[0], after[0]);
    assert_eq!(before[1..], after[1..]);
    let fleet = folder.path().join("fleet.yaml");
    write(&fleet, &read(&fleet).replace("label: \"{week}\"", "label: \"W{week}\""));
    assert_eq!(ids(), after, "a label changes no result");
    let recipe = folder.path().join("recipe.yaml");
    write(&recipe, &read(&recipe).replace("standard_uncertainty_um: 1", "standard_uncertainty_um: 2"));
    let changed = ids();
    assert!(changed.iter().zip(&after).all(|(one, other)| one != other));
}

/// What a merge without files of calibrations has made.
#[cfg(target_os = "linux")]
pub(crate) fn contents_without_calibrations(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = contents(folder);
    found.retain(|name, _| !name.starts_with("calibrations"));
    found
}
