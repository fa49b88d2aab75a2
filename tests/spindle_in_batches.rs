//! Spindle samples that are read in batches: what is told of samples that are held, to the last byte, in memory that does not grow.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;

use crate::batches::core;
use crate::support::{Printed, Random, Variant, as_typed, json_file, read, recipes, skipped, temporary, tree, write};

/// The ingest stages of the recipes that can be read in batches.
const RUNS: [&str; 5] = ["run-600", "run-3000", "run-9000", "before", "after"];

/// A recipe whose runs are read in batches of so many rows; none: they are held.
fn recipe(data: &str, rows: Option<usize>) -> Variant {
    let name = if data == "exact" { "spindle-motion-exact" } else { "spindle-motion" };
    let recipe = Variant::of(&recipes()[name]);
    match rows {
        Some(rows) => RUNS.iter().fold(recipe, |recipe, stage| recipe.set(stage, "batch_rows", json!(rows))),
        None => recipe,
    }
}

fn run(at: &Path, out: &str) -> Printed {
    as_typed(at, &["run", "recipe.yaml", "--out", out])
}

/// All results of a run but the record with its times, and the page.
fn results(at: &Path, out: &str) -> Vec<(PathBuf, String)> {
    let at = at.join(out);
    let is_result = |name: &PathBuf| name.extension().is_some_and(|own| own == "json" || own == "csv");
    let found = tree(&at).into_iter().filter(|name| is_result(name) && !name.ends_with("run.json"));
    found.map(|name| (name.clone(), read(&at.join(&name)))).collect()
}

#[test]
fn results_do_not_depend_on_batches() {
    for data in ["exact", "realistic"] {
        let folder = temporary();
        let at = folder.path();
        recipe(data, None).write(at);
        let held = run(at, "held");
        assert_eq!(held.status, 0, "{}", held.stderr);
        let expected = results(at, "held");
        assert!(expected.len() > 8, "{expected:?}");
        for rows in [1_000_000, 500, 61] {
            recipe(data, Some(rows)).write(at);
            let found = run(at, "batches");
            assert_eq!(
                (found.status, found.stdout.replace("batches", "held")),
                (0, held.stdout.clone()),
                "{data}, {rows}"
            );
            for (one, other) in results(at, "batches").iter().zip(&expected) {
                assert!(one == other, "{data}, {rows} rows: {}", one.0.display());
            }
            assert_eq!(results(at, "batches").len(), expected.len());
            std::fs::remove_dir_all(at.join("batches")).expect("results");
            assert_eq!(as_typed(at, &["check", "recipe.yaml"]).status, 0, "{data}, {rows}");
        }
    }
}

#[cfg(target_os = "linux")]
#[test]
fn one_core_gives_the_same_bytes() {
    if Command::new("taskset").arg("--version").output().is_err() {
        return skipped("one_core_gives_the_same_bytes", "there is no taskset");
    }
    let folder = temporary();
    let at = folder.path();
    recipe("realistic", Some(100)).write(at);
    assert_eq!(run(at, "many").status, 0);
    let program = crate::support::program(at, &["run", "recipe.yaml", "--out", "one"]);
    let alone = Command::new("taskset")
        .args(["-c", &core()])
        .arg(program.get_program())
        .args(program.get_args())
        .current_dir(at)
        .output()
        .expect("taskset starts");
    assert!(alone.status.success(), "{}", String::from_utf8_lossy(&alone.stderr));
    assert!(results(at, "one") == results(at, "many"));
}

#[test]
fn rows_are_named_where_they_stand() {
    for (command, rows) in [("run", None), ("run", Some(90)), ("check", Some(90))] {
        let folder = temporary();
        let at = folder.path();
        let recipe = recipe("realistic", rows).only(&["motion"]);
        let mut lines: Vec<String> = read(&recipe.path("run-3000", "path")).lines().map(str::to_owned).collect();
        // An encoder that slips by a step, in the fourth batch.
        lines.drain(300..301);
        for line in &mut lines[300..] {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            let angle: f64 = cells[1].parse().expect("an angle");
            cells[1] = format!("{:.2}", angle + 2.8);
            *line = cells.join(",");
        }
        write(&at.join("slipped.csv"), &(lines.join("\n") + "\n"));
        recipe.set("run-3000", "path", json!("slipped.csv")).write(at);
        let arguments =
            if command == "run" { vec!["run", "recipe.yaml", "--out", "out"] } else { vec![command, "recipe.yaml"] };
        let printed = as_typed(at, &arguments);
        assert!(printed.status != 0, "{command}, {rows:?}");
        let said = "slipped.csv:301";
        assert!(
            printed.stderr.contains(said) && printed.stderr.contains("the angle of the spindle goes on by"),
            "{}",
            printed.stderr
        );
    }
}

#[test]
fn what_needs_all_rows_is_refused() {
    let warm_up = recipe("realistic", None).set("half-hour", "batch_rows", json!(100));
    let folder = temporary();
    let at = folder.path();
    warm_up.write(at);
    for command in [&["run", "recipe.yaml", "--out", "out"][..], &["check", "recipe.yaml"]] {
        let printed = as_typed(at, command);
        assert!(printed.status == 2 && !at.join("out").exists(), "{printed:?}");
        assert!(printed.stderr.contains("`warm-up` needs all rows of `half-hour` at once"), "{}", printed.stderr);
    }
}

/// Rows that are left out are told once, and the calibration names the others.
#[test]
fn rows_without_a_number_are_left_out() {
    let folder = temporary();
    let at = folder.path();
    let marked = |rows: Option<usize>| {
        let recipe = recipe("realistic", rows).only(&["motion"]);
        let text = read(&recipe.path("run-600", "path"));
        let lines = text.lines().enumerate().map(|(index, line)| match index {
            201 | 700 => line
                .split(',')
                .enumerate()
                .map(|(cell, text)| if cell == 3 { "-" } else { text })
                .collect::<Vec<_>>()
                .join(","),
            _ => line.to_owned(),
        });
        write(&at.join("marked.csv"), &(lines.collect::<Vec<_>>().join("\n") + "\n"));
        recipe.set("run-600", "path", json!("marked.csv")).set("run-600", "no_data", json!(["-"])).write(at);
        let printed = run(at, "out");
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        assert_eq!(printed.stderr.matches("2 rows hold a mark of `no_data`").count(), 1, "{}", printed.stderr);
        let found = json_file(&at.join("out/recipe/motion.calibration.json"));
        std::fs::remove_dir_all(at.join("out")).expect("results");
        found
    };
    let held = marked(None);
    assert!(held["data"].to_string().contains("[[1,200],[202,699],"), "{}", held["data"]);
    assert_eq!(marked(Some(100)), held);
}

/// Samples of a spindle at 3000 revolutions a minute, 128 a turn, with noise.
#[cfg(target_os = "linux")]
fn samples(count: usize) -> String {
    let random = &mut Random::new(7);
    let mut text = "sample,S_deg,time_s,r1_um,r2_um,z_um\n".to_owned();
    for sample in 0..count {
        let turns = sample as f64 / 128.0;
        let angle = turns * std::f64::consts::TAU;
        let mut noise = || 0.01 * random.normal();
        let r1 = 8.0 + 3.0 * angle.cos() + 0.2 * (2.0 * angle).cos() + 0.1 * (0.43 * angle).sin() + noise();
        let r2 = -6.0 + 3.0 * angle.sin() + 0.1 * (3.0 * angle).sin() + 0.1 * (0.43 * angle).cos() + noise();
        let z = 31.0 + 0.3 * (angle + 0.5).cos() + 0.2 * (0.61 * angle).sin() + noise();
        let _ = writeln!(text, "{},{:.4},{:.7},{r1:.4},{r2:.4},{z:.4}", sample + 1, 360.0 * turns, 0.02 * turns);
    }
    text
}

/// Twenty times the samples, and hardly more memory.
#[cfg(target_os = "linux")]
#[test]
fn memory_does_not_grow_with_the_samples() {
    let folder = temporary();
    let at = folder.path();
    let mut recipe = recipe("realistic", None).only(&["run-3000", "motion", "spindle"]);
    recipe.0["stages"]["motion"]["from"] = json!(["run-3000"]);
    recipe.0["stages"]["motion"]["speeds_rpm"] = json!([3000]);
    recipe.0["stages"]["spindle"]["of"] = json!(["motion"]);
    recipe.0["stages"]["spindle"]["from"] = json!(["run-3000"]);
    recipe.0["stages"]["spindle"]["limits"] = json!({ "total_rotating_um": 5.0 });
    let recipe = recipe.only(&["run-3000", "motion", "spindle"]);
    recipe.set("run-3000", "path", json!("samples.csv")).set("run-3000", "batch_rows", json!(5000)).write(at);
    let of = |count: usize| {
        write(&at.join("samples.csv"), &samples(count));
        let (peak, status) = crate::batches::peak(at);
        assert_eq!(status, Some(0), "{count} samples");
        peak
    };
    let [few, many] = [15_000, 300_000].map(of);
    assert!(few > 10_000 && many < few + few / 10, "{few} kB for 15,000 samples, {many} kB for 300,000");
    let found = json_file(&at.join("out/recipe/motion.calibration.json"));
    assert_eq!(found["fit"]["observations"], json!(900_000));
    assert_eq!(found["data"][0]["rows"], json!([[1, 300_000]]));
}
