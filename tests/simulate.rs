//! The virtual machine: what it measures gives the truth back, and differs from it by the stated noise and nothing else.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use abbe_core::{Problem, RowIndex, SetIndex};
use abbe_engine::prepare;
use abbe_simulation::{Drift, Noise, Outliers, RandomOutliers, StandardDeviation, Truth, measure};
use abbe_simulation::{Lobing, contact_directions};
use serde_json::{Value, json};

use crate::support::{
    Printed, Small, Variant, abbe, effect, fit, json_file, read, recipes, registry, root, temporary, tree, write,
};

/// The truth behind `pipelines/data/tango-hu40t/<data>`, as its file has it.
fn truth_file(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/tango-hu40t-{data}.json")))
}

/// The truth without noise.
fn truth() -> Truth {
    let file = truth_file("exact");
    let parameters = file["parameters"].as_object().expect("parameters").iter();
    Truth {
        parameters: parameters.map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect(),
        noise: Noise::default(),
    }
}

fn with(noise: Noise) -> Truth {
    Truth { noise, ..truth() }
}

/// The touches of the TANGO test and its bar, as a problem with the true values as its own.
fn tango() -> &'static Problem {
    static PROBLEM: OnceLock<Problem> = OnceLock::new();
    PROBLEM.get_or_init(|| {
        let outcome = Variant::tango("exact").only(&["fit-S1"]).run();
        at_truth(&fit(&outcome, "fit-S1").problem)
    })
}

fn at_truth(problem: &Arc<Problem>) -> Problem {
    let (mut at, truth) = (problem.as_ref().clone(), truth().parameters);
    let value = |name: &str| truth.get(name).copied().unwrap_or(0.0);
    for (parameter, own) in problem.model.info().parameters.iter().zip(&mut at.machine_values) {
        *own = value(&parameter.name);
    }
    for set in &mut at.sets {
        let names = set.observations.clone();
        names.info().unknowns.iter().zip(&mut set.own).for_each(|(parameter, own)| *own = value(&parameter.name));
    }
    at
}

/// The residuals at the true values.
fn residuals(problem: &Problem) -> Vec<f64> {
    problem.without_unknowns(|_| true).residuals(&[]).expect("residuals")
}

fn simulated(truth: &Truth, seed: u64) -> Problem {
    measure(tango(), truth, seed).unwrap_or_else(|error| panic!("{error}"))
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()))
}

/// A truth file in a folder.
fn truth_in(folder: &Path, truth: &Value) -> String {
    let file = folder.join("the-truth.json");
    write(&file, &truth.to_string());
    file.to_str().expect("paths are UTF-8").to_owned()
}

/// Simulates a variant of a recipe in this process; gives the recipe that was written.
fn simulate(variant: &Variant, truth: &Value, seed: u64, out: &Path) -> PathBuf {
    let folder = temporary();
    let truth = truth_in(folder.path(), truth);
    let prepared = prepare(&variant.write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let simulated = prepared.simulate(Path::new(&truth), seed, None).unwrap_or_else(|error| panic!("{error}"));
    simulated.write(out).unwrap_or_else(|error| panic!("{error}"));
    out.join(&simulated.recipe)
}

/// Runs a recipe that was written, in this process.
fn run(recipe: &Path) -> abbe_engine::Outcome {
    let outcome = prepare(recipe, &registry()).and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
    outcome.unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn exact_simulation_gives_the_truth_back() {
    let folder = temporary();
    let mut truth = truth_file("exact");
    truth["noise"] = json!({});
    let recipe = simulate(&Variant::tango("exact").only(&["fit-S4r"]), &truth, 1, &folder.path().join("sim"));
    let outcome = run(&recipe);
    let calibration = &fit(&outcome, "fit-S4r").calibration;
    // The file has balls, too, which this recipe does not observe.
    let observed = |name: &String| !name.starts_with("ball[");
    let parameters = truth["parameters"].as_object().expect("parameters");
    for (name, value) in parameters.iter().filter(|(name, _)| observed(name)) {
        let name = if name.starts_with("facet[") { format!("table.{name}") } else { name.clone() };
        let estimated = calibration.get(&name).expect("a value");
        let (is_angle, factor) = effect(&estimated.unit);
        let off = (estimated.value - value.as_f64().expect("a number")).abs() * factor;
        assert!(off < if is_angle { 1e-10 } else { 1e-8 }, "{name} is off by {off:e}");
    }
}

#[test]
fn the_equations_hold_exactly_where_the_tip_touches() {
    assert!(largest(&residuals(&simulated(&truth(), 1))) < 2e-11);
}

#[test]
fn the_data_set_is_measured_again() {
    // It was simulated by another program, which approaches some facets from the side: there the tip may be elsewhere on
    // the plane.
    let (own, again) = (tango(), simulated(&truth(), 1));
    assert!(largest(&residuals(own)) < 3e-9);
    for (own, again) in own.sets.iter().zip(&again.sets) {
        for pose in own.poses().indices() {
            for (own, again) in own.poses().row(pose).iter().zip(again.poses().row(pose)) {
                assert!((own - again).abs() < 0.05 || own.is_nan(), "pose {pose}: {own} {again}");
            }
        }
    }
}

#[test]
fn nominal_positions_are_enough_to_start_from() {
    let mut programme = tango().clone();
    programme.machine_values = programme.model.info().nominal.clone();
    programme.sets.iter_mut().for_each(|set| set.own.fill(0.0));
    let nominal = abbe_estimation::at_contact(&programme, &[]).expect("nominal contact");
    let measured = measure(&nominal, &truth(), 1).expect("a measurement");
    assert_eq!(measured.machine_values, nominal.machine_values);
    let mut at = tango().clone();
    at.sets.iter_mut().zip(&measured.sets).for_each(|(at, measured)| at.set_poses(measured.poses().clone()));
    assert!(largest(&residuals(&at)) < 2e-11);
}

#[test]
fn residuals_at_the_truth_scatter_as_stated() {
    let noise = Noise {
        probing_sigma_mm: StandardDeviation::All(0.0006),
        surface_sigma_mm: StandardDeviation::ByStage(BTreeMap::from([("table".to_owned(), 0.0015)])),
        ..Noise::default()
    };
    let truth = with(noise);
    let (mut touches, mut bars) = (Vec::new(), Vec::new());
    for seed in 0..60 {
        let mut all = residuals(&simulated(&truth, seed));
        bars.extend(all.split_off(383));
        touches.extend(all);
    }
    for (values, sigma) in [(touches, 0.0006_f64.hypot(0.0015)), (bars, 0.0006)] {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let square = values.iter().map(|value| value * value).sum::<f64>() / count;
        let kurtosis = values.iter().map(|value| value.powi(4)).sum::<f64>() / count / square.powi(2);
        assert!(mean.abs() < 4.0 * sigma / count.sqrt(), "{mean}");
        assert!((square / sigma.powi(2) - 1.0).abs() < 4.0 * (2.0 / count).sqrt(), "{square}");
        // Those of 60 lengths scatter themselves.
        assert!(count < 1e4 || (kurtosis - 3.0).abs() < 4.0 * (24.0 / count).sqrt(), "{kurtosis}");
    }
}

#[test]
fn what_a_row_gets_does_not_depend_on_other_rows() {
    let truth = with(Noise { probing_sigma_mm: StandardDeviation::All(0.001), ..Noise::default() });
    let some = tango().with_rows(SetIndex(0), [7, 100, 250].map(RowIndex).to_vec());
    let (all, some) = (residuals(&simulated(&truth, 5)), residuals(&measure(&some, &truth, 5).expect("rows")));
    for (all, some) in [all[7], all[100], all[250], all[383]].into_iter().zip(some) {
        assert!((all - some).abs() < 2e-11, "{all} {some}");
    }
}

#[test]
fn positions_are_rounded_to_the_resolution() {
    let measured = simulated(&with(Noise { resolution_mm: 0.0005, ..Noise::default() }), 1);
    for set in &measured.sets {
        for pose in set.poses().indices() {
            for axis in measured.model.info().axes.iter().filter(|axis| axis.kind == abbe_core::AxisKind::Linear) {
                let steps = set.poses().row(pose)[axis.status] / 0.0005;
                assert!((steps - steps.round()).abs() < 1e-6, "{steps}");
            }
        }
    }
    let off = largest(&residuals(&measured));
    assert!(off > 1e-4 && off < 0.00025 * 3.0_f64.sqrt() * 2.0, "{off}");
}

#[test]
fn outliers_are_added_outwards() {
    let listed = BTreeMap::from([("114".to_owned(), 0.0392), ("331".to_owned(), -0.1094)]);
    let measured = simulated(&with(Noise { outliers: Outliers { listed, random: None }, ..Noise::default() }), 1);
    for (residual, (set, row)) in residuals(&measured).into_iter().zip(measured.equation_rows()) {
        let touch = (set == SetIndex(0)).then(|| measured.origin(set, row).expect("a row of a file").1.row);
        let expected = match touch {
            Some(114) => 0.0392,
            Some(331) => -0.1094,
            _ => 0.0,
        };
        assert!((residual - expected).abs() < 2e-11, "{touch:?}: {residual}");
    }
    let random = Some(RandomOutliers { fraction: 0.1, size_mm: 0.05 });
    let outliers = Outliers { random, ..Outliers::default() };
    let hit: Vec<f64> = residuals(&simulated(&with(Noise { outliers, ..Noise::default() }), 1));
    let (out, inside) = (hit.iter().filter(|r| **r > 0.049).count(), hit.iter().filter(|r| **r < -0.049).count());
    assert!((25..=52).contains(&(out + inside)) && out > 8 && inside > 8, "{out} {inside}");
}

#[test]
fn drift_moves_the_parameter_in_time() {
    let drift = Drift { parameter: "dzt".to_owned(), size_mm: -0.008, tau_s: 3000.0, wave: Some((7800.0, 2.6)) };
    let noise = Noise { drift: BTreeMap::from([(String::new(), drift.clone())]), ..Noise::default() };
    let measured = simulated(&with(noise.clone()), 1);
    assert_eq!(drift.at(0.0), 0.0);
    let dzt = measured.model.info().parameters.iter().position(|parameter| parameter.name == "dzt").expect("dzt");
    let layout = &measured.sets[0].observations.info().layout;
    let times = layout.data.numbers("time").expect("times");
    let mut moved = 0.0_f64;
    for row in [0, 100, 200, 382].map(RowIndex) {
        let mut at = measured.with_rows(SetIndex(0), vec![row]);
        moved = moved.max(residuals(&at)[0].abs());
        at.machine_values[dzt] += drift.at(times[layout.rows[row].data_row.expect("a data row")]);
        assert!(residuals(&at)[0].abs() < 2e-11);
    }
    assert!(moved > 1e-3, "{moved}");
    // The bar has no time.
    assert!(residuals(&measured)[383].abs() < 2e-11);
    // By file; a name that is nowhere is an error.
    let of = |file: &str| with(Noise { drift: BTreeMap::from([(file.to_owned(), drift.clone())]), ..Noise::default() });
    assert_eq!(simulated(&of("touches"), 1).sets[0].poses(), measured.sets[0].poses());
    let error = measure(tango(), &of("touches-s9"), 1).err().expect("an error").to_string();
    assert_eq!(error, "noise.drift: no row drifts (no data file with a column `time_s` is named `touches-s9`)");
}

#[test]
fn lobing_follows_the_direction_of_approach() {
    let lobing = Lobing { amplitude: 0.001, lobes: 3, phase: 0.3 };
    let measured = simulated(&with(Noise { lobing: Some(lobing), ..Noise::default() }), 1);
    let directions = contact_directions(&measured).expect("directions");
    let found = residuals(&measured);
    for (residual, direction) in found.iter().zip(&directions) {
        let expected = direction.map_or(0.0, |[x, y, z]| lobing.pretravel_variation([-x, -y, -z]));
        assert!((residual - expected).abs() < 1e-9, "{residual} {expected}");
    }
    assert!(largest(&found) > 0.0009);
}

#[test]
fn simulated_outliers_are_found_again() {
    let folder = temporary();
    let truth = truth_file("realistic");
    let recipe = simulate(&Variant::tango("realistic").only(&["fit-S4r"]), &truth, 7, &folder.path().join("sim"));
    let outcome = run(&recipe);
    let rows: Vec<usize> = fit(&outcome, "fit-S4r").calibration.outliers.iter().map(|outlier| outlier.row).collect();
    let gross = [67, 114, 288, 331];
    assert!(gross.iter().all(|row| rows.contains(row)), "{rows:?}");
    assert!(fit(&outcome, "fit-S4r").calibration.fit.sigma < 1.2);
}

#[test]
fn facets_and_balls_of_one_file_are_measured_together() {
    let data = root().join("pipelines/data/tango-hu40t/exact");
    let path = |name: &str| data.join(name).to_str().expect("paths are UTF-8").to_owned();
    let mut variant = Variant::tango("exact").only(&["fit-S3"]).set("touches", "ignore", json!({}));
    let balls =
        json!({ "artefact": "balls", "from": "touches", "nominal": path("balls.csv"), "standard_uncertainty_um": 1 });
    variant.0["stages"]["spheres"] = balls;
    let mut variant = variant.set("fit-S3", "observations", json!(["table", "spheres", "bar"]));
    variant.stage("fit-S3")["parameters"].as_array_mut().expect("patterns").push(json!("spheres.*"));
    let folder = temporary();
    // The whole file, balls and all; motion errors left out, since this fit has none.
    let mut truth = truth_file("exact");
    truth["parameters"].as_object_mut().expect("parameters").retain(|name, _| {
        !name.starts_with('E') || name.contains('0') || ["EXX[1]", "EYY[1]", "EZZ[1]"].contains(&name.as_str())
    });
    truth["noise"] = json!({});
    let recipe = simulate(&variant, &truth, 1, &folder.path().join("sim"));
    let touches = read(&tree_file(&folder.path().join("sim"), "touches.csv"));
    assert!(touches.starts_with("# simulated: the-truth.json, seed 1\n"), "{}", &touches[..60]);
    let outcome = run(&recipe);
    let calibration = &fit(&outcome, "fit-S3").calibration;
    for name in ["ball[1].x", "ball[2].y", "ball[2].z"] {
        let expected = truth["parameters"][name].as_f64().expect("a number");
        let found = calibration.get(&format!("spheres.{name}")).expect("a value").value;
        assert!((found - expected).abs() < 1e-8, "{name}: {found} {expected}");
    }
}

/// The truth behind the data of a recipe, as its file has it; a nominal one where there is none.
fn truth_behind(recipe: &Path) -> Value {
    let text = read(recipe);
    let mut parts = text.split_once(" data/").map_or("", |(_, path)| path).split('/');
    let (system, data) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    let file = root().join(format!("tests/truth/{system}-{data}.json"));
    if file.is_file() { json_file(&file) } else { json!({ "parameters": {} }) }
}

#[test]
fn every_recipe_is_simulated_with_the_truth_of_its_own_data() {
    let mut not_yet = Vec::new();
    for (name, file) in recipes() {
        let folder = temporary();
        let truth = truth_in(folder.path(), &truth_behind(&file));
        let prepared = prepare(&file, &registry()).unwrap_or_else(|error| panic!("{name}: {error}"));
        // Every day has a machine with the log of that day, and this one is that of last month; the cold mill is the
        // warm one before.
        let machine = match name.as_str() {
            "tango-warming-retrain" => Some("hu40t"),
            "mill-warming" => Some("mill"),
            "warming-days" => Some("axis"),
            // The other one is the same to first order.
            "standards-ball-bar-exact" => Some("mill"),
            // The other one has no errors: its points are corrected already.
            "qif-results" => Some("machine"),
            // That of the sphere is taken as nominal.
            "probe-lobing" | "probe-lobing-exact" => Some("hu40t"),
            _ => None,
        };
        match prepared.simulate(Path::new(&truth), 1, machine) {
            Ok(simulated) => {
                assert!(!simulated.data.is_empty(), "{name}");
                for kept in &simulated.not_simulated {
                    // Those of a CMM: its artefact is the one that was really measured. Temperatures are as they were.
                    let is_kept = ["facets-cmm.csv", "temperatures.csv", "temperature.csv"]
                        .iter()
                        .any(|own| kept.file.ends_with(own));
                    // Readings that are no geometry have no machine.
                    let mut readers = kept.read_by.iter().map(|reader| {
                        prepared.recipe.stages.iter().find(|stage| stage.name == *reader).expect("a stage")
                    });
                    let is_reading = readers.any(|stage| stage.estimate_source == abbe_core::EstimateSource::Readings);
                    let is_kept = is_kept || machine.is_some() || is_reading;
                    assert!(is_kept && !kept.read_by.is_empty(), "{name}: {kept:?}");
                }
                let stages: BTreeSet<&str> =
                    simulated.varied.iter().filter_map(|line| line.split(':').next()).collect();
                assert_eq!(stages.len(), simulated.varied.len(), "{name}: {:?}", simulated.varied);
                simulated.write(&folder.path().join("sim")).unwrap_or_else(|error| panic!("{name}: {error}"));
                let written = folder.path().join("sim").join(&simulated.recipe);
                prepare(&written, &registry()).unwrap_or_else(|error| panic!("{name}: {error}"));
            }
            Err(error) if error.to_string().contains("cannot be simulated yet") => not_yet.push(name),
            // Readings that are no geometry have no machine that could be simulated.
            Err(error) if error.to_string().contains("no estimate uses a machine") => {
                let kinds = prepared.recipe.stages.iter().map(|stage| stage.kind);
                assert!(!kinds.into_iter().any(|kind| kind == abbe_core::Kind::Model), "{name}: {error}");
            }
            // Means of series, of which nobody takes the single rows.
            Err(error) if name == "mfb-ucp710" && error.to_string().contains("combine several recorded ones") => {}
            // Rows are written into tables, and these are logs of a control, or results of others.
            Err(error)
                if (name.starts_with("linuxcnc-") || name == "qif-results")
                    && error.to_string().contains("reads lines of a log") => {}
            Err(error) => panic!("{name}: {error}"),
        }
    }
    assert!(not_yet.is_empty(), "{not_yet:?}");
}

#[test]
fn rows_that_are_also_observed_combined_come_back() {
    let folder = temporary();
    let file = &recipes()["samba-exact"];
    let mut truth = truth_behind(file);
    truth["noise"] = json!({});
    let variant = Variant::of(file).only(&["fit", "fit-centres"]);
    let outcome = run(&simulate(&variant, &truth, 1, &folder.path().join("sim")));
    for estimate in ["fit", "fit-centres"] {
        let calibration = &fit(&outcome, estimate).calibration;
        for name in ["EA0B", "EX0C", "EXX[1]", "EZZ[1]"] {
            let (expected, found) = (&truth["parameters"][name], calibration.get(name).expect("a value").value);
            // Centres that are fitted first take over a little of what the machine does wrong across the ball.
            let allowed = if estimate == "fit" { 1e-9 } else { 1e-5 };
            let off = (found - expected.as_f64().expect("a number")).abs();
            assert!(off < allowed, "{estimate}: {name}: {found} {expected}");
        }
    }
    // Without an artefact that takes the touches one by one nothing is known of these.
    let variant = Variant::of(file).only(&["fit-centres"]);
    let prepared = prepare(&variant.write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let truth = truth_in(folder.path(), &truth);
    let error = prepared.simulate(Path::new(&truth), 1, None).expect_err("it cannot be told").to_string();
    assert!(error.contains("its rows combine several recorded ones"), "{error}");
}

#[test]
fn what_a_validator_judges_is_measured_on_the_same_machine() {
    let folder = temporary();
    let file = &recipes()["sphere-hu40t-exact"];
    let mut truth = truth_behind(file);
    // Another machine than that of the recipe's data, which would show in the touches that only the validator reads.
    truth["parameters"]["EX0C"] = json!(0.05);
    truth["parameters"]["EB0C"] = json!(-4e-5);
    let path = truth_in(folder.path(), &truth);
    let prepared = prepare(file, &registry()).unwrap_or_else(|error| panic!("{error}"));
    let simulated = prepared.simulate(Path::new(&path), 1, None).unwrap_or_else(|error| panic!("{error}"));
    let files: Vec<_> = simulated.data.iter().map(|data| data.file.file_name().expect("a name")).collect();
    assert_eq!(files, ["touches-1.csv", "touches-2.csv"]);
    assert!(simulated.data.iter().all(|data| data.measured > 300 && data.copied == 0), "{:?}", simulated.data);
    assert!(simulated.varied.contains(&"resolution: 0.000001 µm".to_owned()), "{:?}", simulated.varied);
    simulated.write(&folder.path().join("sim")).unwrap_or_else(|error| panic!("{error}"));
    let outcome = run(&folder.path().join("sim").join(&simulated.recipe));
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "validation-set").expect("the verdict");
    assert!(verdict.pass, "{:?}", verdict.figures);
}

#[test]
fn data_that_stay_as_they_are_are_told() {
    let small = Small::new();
    small.write("truth.json", SMALL_TRUTH);
    small.write("data/later.csv", "feature,cycle,deviation_um\n1,1,0.1\n1,2,0.2\n1,3,0.1\n2,1,0.1\n2,2,0.1\n2,3,0.2\n");
    let stages = "  later: { ingest: csv, path: data/later.csv }\n  again: { validate: repeatability, of: fine, from: later, \
                  value: deviation, cycle: cycle, window: 2 }\n";
    small.write("recipe.yaml", &(small.read("recipe.yaml") + stages));
    let printed = simulate_small(&small, &["--seed", "1", "--out", "sim"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    assert!(printed.stdout.contains("  not simulated: data/later.csv (read by again only)\n"), "{}", printed.stdout);
    assert_eq!(small.read("sim/data/later.csv"), small.read("data/later.csv"));
}

fn tree_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(tree(folder).into_iter().find(|file| file.ends_with(name)).expect("the file"))
}

/// A truth of the small recipe.
const SMALL_TRUTH: &str = r#"{
  "parameters": { "EX0C": -0.02, "EXX[1]": 1e-5, "EXX[b]": 0.001, "facet[3].d": 0.03, "stylus_radius": 3.001 },
  "calibrated": { "bar.length": 304.6686 },
  "noise": {
    "probing_sigma_mm": 0.001, "drift": { "component": "dzt(t), tool", "range_mm": 0.002, "tau_s": 900, "formula": "..." },
    "lobing": { "amplitude_mm": 0.0002 }, "outliers": { "5": 0.03 }, "resolution_mm": 0.0001
  }
}"#;

fn simulate_small(small: &Small, more: &[&str]) -> Printed {
    small.abbe(&[&["simulate", "recipe.yaml", "--truth", "truth.json"], more].concat())
}

#[test]
fn the_folder_runs_by_itself_and_the_seed_makes_the_bytes() {
    let small = Small::new();
    small.write("truth.json", SMALL_TRUTH);
    for (seed, out) in [("1", "a"), ("1", "b"), ("2", "c")] {
        let printed = simulate_small(&small, &["--seed", seed, "--out", out]);
        assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
        if out == "a" {
            insta::assert_snapshot!("simulated", printed.stdout);
        }
    }
    let files = tree(&small.path("a"));
    assert_eq!(files, tree(&small.path("b")));
    for file in &files {
        let content = |out: &str| fs::read(small.path(out).join(file)).expect("a file");
        assert_eq!(content("a"), content("b"), "{}", file.display());
        let random = ["data/touches.csv", "data/lengths.csv"].contains(&file.to_str().expect("UTF-8"));
        assert_eq!(content("a") != content("c"), random, "{}", file.display());
    }
    assert_eq!(small.read("a/recipe.yaml"), small.read("recipe.yaml"));
    assert_eq!(small.read("a/truth.json"), SMALL_TRUTH);
    // All columns and rows but the linear axes stay, with the decimals of the resolution.
    let (before, after) = (small.read("data/touches.csv"), small.read("a/data/touches.csv"));
    let after = after.strip_prefix("# simulated: truth.json, seed 1\n").expect("the comment");
    assert_eq!(before.lines().count(), after.lines().count());
    for (before, after) in before.lines().zip(after.lines()).skip(1) {
        for (column, (before, after)) in before.split(',').zip(after.split(',')).enumerate() {
            let simulated = (2..5).contains(&column);
            assert!(simulated || before == after, "{before} {after}");
            assert!(!simulated || after.split_once('.').is_some_and(|(_, decimals)| decimals.len() == 4), "{after}");
        }
    }
    let printed = abbe(&small.path("a"), &["run", "recipe.yaml"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
}

#[test]
fn paths_that_lead_out_of_the_folder_are_taken_along() {
    let small = Small::new();
    small.write("truth.json", SMALL_TRUTH);
    let text = small.read("recipe.yaml");
    let absolute = small.path("data/lengths.csv");
    let text = text.replace("data/lengths.csv", absolute.to_str().expect("UTF-8"));
    let text = text.replace(" data/", " ../data/").replace("../data/touches.csv", "../data/../data/./touches.csv");
    small.write("deep/recipe.yaml", &text);
    let printed =
        small.abbe(&["simulate", "deep/recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "new/sim"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    assert!(!small.read("new/sim/recipe.yaml").contains(".."));
    for folder in ["data", "deep"] {
        fs::remove_dir_all(small.path(folder)).expect("the folder was there");
    }
    let printed = small.abbe(&["run", "new/sim/recipe.yaml"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
}

#[test]
fn what_is_not_simulated_is_told() {
    let small = Small::new();
    small.write(
        "truth.json",
        r#"{ "parameters": { "EA0S": 0.0, "EX0S": 0.1, "EXX[2]": 1e-9, "facet[21].d": 0.1, "ball[1].x": 0.2, "x.ball[1].y": 0.2 },
            "per_cycle": [{ "cycle": 1, "parameters": { "EX0C": 0.1 } }], "seed": 1, "noise": { "probing_sigma": 1, "servo_ripple_um": 0.9, "drift": null,
            "lobing": "0.2 um cos(3 phi)", "outliers": { "999": 1.0 }, "outliers_note": "mm", "resolution_mm": 0 } }"#,
    );
    let printed = simulate_small(&small, &["--seed", "1", "--out", "sim"]);
    assert_eq!(printed.status, 0);
    insta::assert_snapshot!("simulate_warnings", printed.stderr);
    assert!(printed.stdout.contains("  left out: 2 values of the machine and 3 of artefacts\n"), "{}", printed.stdout);
}

#[test]
fn bad_input_is_one_clear_error() {
    let two_machines = |small: &Small| {
        let text = small.read("recipe.yaml");
        let (before, after) = text.split_once("  rough:\n").expect("the estimate");
        let machine = "  other: { model: serial-chain, file: data/machine.yaml, errors: [{ location: [EA0B] }] }\n";
        let estimate =
            "  third: { estimate: gauss-newton, machine: other, observations: [table], parameters: [dxt] }\n";
        small.write("recipe.yaml", &format!("{before}{machine}{estimate}  rough:\n{after}"));
    };
    let mut told = String::new();
    let mut case = |name: &str, truth: &str, more: &[&str], status: i32, change: &dyn Fn(&Small)| {
        let small = Small::new();
        if !truth.is_empty() {
            small.write("truth.json", truth);
        }
        small.write("full/note.txt", "kept");
        change(&small);
        let arguments = if more.is_empty() { &["--seed", "1", "--out", "sim"] } else { more };
        let printed = simulate_small(&small, arguments);
        assert_eq!((printed.status, printed.stdout.as_str()), (status, ""), "{name}: {}", printed.stderr);
        assert!(!small.path("sim").exists(), "{name}: something was written");
        let left = fs::read_dir(small.folder.path()).expect("the folder").flatten();
        let partial = left.filter(|entry| entry.file_name().to_string_lossy().starts_with(".abbe")).count();
        assert_eq!((partial, small.read("full/note.txt").as_str()), (0, "kept"), "{name}");
        told.push_str(&format!("-- {name}\n{}\n", printed.stderr));
    };
    let none: &dyn Fn(&Small) = &|_| {};
    case("no truth file", "", &[], 2, none);
    case("not JSON", "{ \"parameters\": { \"EX0C\": NaN } }", &[], 2, none);
    case("too large", "{ \"parameters\": { \"EX0C\": 1e999 } }", &[], 2, none);
    case("no parameters", "{ \"noise\": {} }", &[], 2, none);
    case("text for a number", "{ \"parameters\": { \"EX0C\": \"0.1\" } }", &[], 2, none);
    case("unknown name", "{ \"parameters\": { \"EXOC\": 0.1 } }", &[], 2, none);
    case("misspelt term", "{ \"parameters\": { \"EXX[l]\": 1e-5 } }", &[], 2, none);
    case("misspelt parameter of a feature", "{ \"parameters\": { \"facet[3].f\": 0.1 } }", &[], 2, none);
    case("misspelt stage", "{ \"parameters\": { \"tabel.facet[3].d\": 0.1 } }", &[], 2, none);
    case("unknown name far from all", "{ \"parameters\": { \"length[a-b]\": 0.1 } }", &[], 2, none);
    case("negative noise", "{ \"parameters\": {}, \"noise\": { \"probing_sigma_mm\": -1 } }", &[], 2, none);
    case(
        "noise of no stage",
        "{ \"parameters\": {}, \"noise\": { \"probing_sigma_mm\": { \"tabel\": 1 } } }",
        &[],
        2,
        none,
    );
    case(
        "drift of nothing",
        "{ \"parameters\": {}, \"noise\": { \"drift\": { \"component\": \"dzt(t)\", \"tau_s\": 9 } } }",
        &[],
        2,
        none,
    );
    case(
        "drift without time constant",
        "{ \"parameters\": {}, \"noise\": { \"drift\": { \"component\": \"dzt(t)\", \"gain_mm\": 0.1, \"tau_s\": 0 } } }",
        &[],
        2,
        none,
    );
    case(
        "drift of an unknown parameter",
        "{ \"parameters\": {}, \"noise\": { \"drift\": { \"parameter\": \"dtz\", \"gain_mm\": 0.1, \"tau_s\": 9 } } }",
        &[],
        2,
        none,
    );
    case(
        "outliers by half",
        "{ \"parameters\": {}, \"noise\": { \"outliers\": { \"fraction\": 0.1 } } }",
        &[],
        2,
        none,
    );
    case("the folder is not empty", SMALL_TRUTH, &["--seed", "1", "--out", "full"], 1, none);
    case(
        "contact cannot be reached",
        "{ \"parameters\": { \"EXX[1]\": 1, \"EYY[1]\": -1, \"EZZ[1]\": -1 } }",
        &[],
        1,
        &|small| {
            let wider = "start: rough\n    plausible: { mm: { \"E??[1]\": 2000 } }";
            small.write("recipe.yaml", &small.read("recipe.yaml").replace("start: rough", wider));
        },
    );
    case("a truth that no machine has", "{ \"parameters\": { \"EX0C\": 5000, \"EA0B\": 0.5 } }", &[], 2, none);
    case("several machines", SMALL_TRUTH, &[], 2, &two_machines);
    case("no such machine", SMALL_TRUTH, &["--seed", "1", "--out", "sim", "--machine", "machin"], 2, none);
    insta::assert_snapshot!("simulate_errors", told);
}

#[test]
fn one_of_several_machines_is_chosen_by_name() {
    let small = Small::new();
    let text = small.read("recipe.yaml");
    let (before, after) = text.split_once("  rough:\n").expect("the estimate");
    let machine = "  other: { model: serial-chain, file: data/machine.yaml, errors: [{ location: [EA0B] }] }\n";
    let estimate = "  third: { estimate: gauss-newton, machine: other, observations: [table], parameters: [dxt] }\n";
    small.write("recipe.yaml", &format!("{before}{machine}{estimate}  rough:\n{after}"));
    small.write("truth.json", r#"{ "parameters": { "EA0B": 1e-5, "dzt": 0.01 } }"#);
    let printed = simulate_small(&small, &["--seed", "1", "--out", "sim", "--machine", "other"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    // The other machine alone observes the bar, whose file stays as it is.
    assert!(printed.stdout.contains("  not simulated: data/lengths.csv (read by bar only)\n"), "{}", printed.stdout);
    assert_eq!(small.read("sim/data/lengths.csv"), small.read("data/lengths.csv"));
    assert!(small.read("sim/data/touches.csv").starts_with("# simulated"));
}

#[test]
fn the_documented_truth_is_one() {
    let page = read(&root().join("docs/simulate.md"));
    let example = page.split("```json\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let truth = Truth::parse(Path::new("simulate.md"), example).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((truth.parameters.len(), truth.noise.drift.len(), truth.noise.outliers.listed.len()), (9, 1, 2));
    assert!(truth.noise.lobing.is_some() && truth.noise.resolution_mm == 1e-4);
}

/// True values are held against what is plausible, as estimated ones are, and widened in the same way.
#[test]
fn truths_that_no_machine_has_are_refused() {
    let small = Small::new();
    let simulate = |name: &str, value: f64| {
        let text = format!("{{ \"parameters\": {{ \"{name}\": {value:e} }} }}");
        small.write("truth.json", &text);
        let printed =
            small.abbe(&["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "simulated"]);
        let _ = fs::remove_dir_all(small.path("simulated"));
        printed
    };
    let recipe = small.read("recipe.yaml");
    for (name, absurd, real, unit) in [
        ("EX0C", 5000.0, 0.5, "mm"),
        ("EA0B", 0.5, 1e-3, "mrad"),
        ("EXX[1]", 0.5, 1e-4, "mm"),
        ("dzt", -400.0, 1.0, "mm"),
    ] {
        assert_eq!(simulate(name, real).status, 0, "{name}");
        let printed = simulate(name, absurd);
        assert_eq!(printed.status, 2, "{name}: {}", printed.stderr);
        for word in ["truth.json", "no machine has such errors", name, "is plausible at most", "plausible: {"] {
            assert!(printed.stderr.contains(word), "{name}: {word}: {}", printed.stderr);
        }
        let wider = format!("    start: rough\n    plausible: {{ {unit}: {{ \"{name}\": 10000 }} }}");
        small.write("recipe.yaml", &recipe.replace("    start: rough", &wider));
        let printed = simulate(name, absurd);
        assert!(!printed.stderr.contains("no machine has such errors"), "{name}: {}", printed.stderr);
        small.write("recipe.yaml", &recipe);
    }
}
