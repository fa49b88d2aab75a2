//! Readings that are no geometry: thermal states from sensors, predictions of other runs, drift in the manner of ISO 230-3.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use abbe_core::{Calibration, Verdict};
use abbe_engine::Outcome;
use abbe_numerics::Generator;
use serde_json::{Value, json};

use crate::controls::law::seeds;
use crate::support::{Printed, Variant, abbe, fit, json_file, read, recipes, root, temporary, write};

/// A folder of its own.
struct Sandbox(tempfile::TempDir);

impl Sandbox {
    fn new() -> Self {
        Self(temporary())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        write(&self.path(name), text);
    }

    fn abbe(&self, arguments: &[&str]) -> Printed {
        abbe(self.0.path(), arguments)
    }
}

fn truth(kind: &str) -> BTreeMap<String, f64> {
    let truth = json_file(&root().join(format!("tests/truth/thermal-spindle-{kind}.json")));
    let parameters = truth["parameters"].as_object().expect("parameters");
    parameters.iter().map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect()
}

fn verdict<'a>(outcome: &'a Outcome, stage: &str) -> &'a Verdict {
    outcome.verdicts.iter().find(|verdict| verdict.stage == stage).expect("a verdict")
}

fn figure(outcome: &Outcome, stage: &str, name: &str, unit: &str) -> f64 {
    let figures = &verdict(outcome, stage).figures;
    let found = figures.iter().find(|figure| figure.name == name && figure.unit == unit);
    found.and_then(|figure| figure.value).unwrap_or_else(|| panic!("{stage} has no {name} in {unit}"))
}

fn value(calibration: &Calibration, name: &str) -> (f64, f64) {
    let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
    (found.value, found.standard_uncertainty)
}

#[test]
fn exact_readings_give_210_unknowns_back() {
    let outcome = Variant::of(&recipes()["thermal-spindle-exact"]).run();
    let calibration = &fit(&outcome, "spindle").calibration;
    let truth = truth("exact");
    assert_eq!((calibration.fit.observations, calibration.fit.unknowns), (19_573, 210));
    assert_eq!(calibration.parameters.len(), 210);
    for parameter in &calibration.parameters {
        let expected = truth[&parameter.name];
        let off = (parameter.value - expected).abs();
        match parameter.unit.as_str() {
            "s" => assert!(off < 2e-9 * expected, "{}: {off:e} s", parameter.name),
            "1" => assert!(off < 5e-8, "{}: {off:e} K/K", parameter.name),
            "mm/K" => assert!(off < 5e-11, "{}: {off:e} mm/K", parameter.name),
            other => panic!("{other}"),
        }
    }
    for unit in ["um", "K"] {
        assert!(figure(&outcome, "unseen", "max", unit) < 5e-9);
    }
}

#[test]
fn realistic_readings_predict_other_runs() {
    let outcome = Variant::of(&recipes()["thermal-spindle"]).run();
    let truth = truth("realistic");
    let [blocks, ordinary] = ["spindle", "spindle-ordinary"].map(|name| &fit(&outcome, name).calibration);
    for (name, expected) in &truth {
        let (found, u) = value(blocks, name);
        let most = if name.starts_with("time_constant") { 3.0 } else { 6.0 };
        assert!((found - expected).abs() < most * u, "{name}: {found} ± {u}, {expected}");
        // The same values, and uncertainties that know residuals that follow each other.
        assert!((value(ordinary, name).0 - found).abs() <= 1e-12 * found.abs());
    }
    let mean = |of: &Calibration| {
        of.parameters.iter().map(|one| one.standard_uncertainty.ln()).sum::<f64>() / of.parameters.len() as f64
    };
    assert!(mean(blocks) > mean(ordinary) + 0.05, "{} {}", mean(blocks), mean(ordinary));
    assert!(verdict(&outcome, "unseen").pass);
    assert!(figure(&outcome, "unseen", "max", "um") < 5.0 && figure(&outcome, "unseen", "max", "K") < 0.7);
    assert!(figure(&outcome, "unseen", "rms", "K") < 0.15);
    for run in ["thermal-din8602", "thermal-mixed"] {
        for axis in ["x", "y", "z"] {
            let rms = figure(&outcome, "unseen", &format!("rms[drift_{axis}, {run}]"), "um");
            assert!(rms < 1.25, "{run} {axis}: {rms}");
        }
    }
}

/// The drift of the constant run by hand.
#[test]
fn drift_is_that_of_the_readings() {
    let outcome = Variant::of(&recipes()["thermal-spindle"]).only(&["warm-up"]).run();
    let text = read(&root().join("pipelines/data/thermal-spindle/realistic/thermal-const.csv"));
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let head: Vec<&str> = lines.next().expect("a head").split(',').collect();
    let column = |name: &str| head.iter().position(|own| *own == name).expect("a column");
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect()).collect();
    for axis in ["x", "y", "z"] {
        let place = column(&format!("drift_{axis}_um"));
        let judged: Vec<f64> = rows.iter().filter(|row| row[0] <= 22_200.0).map(|row| row[place]).collect();
        let spread = |values: &[f64]| {
            values.iter().copied().fold(f64::MIN, f64::max) - values.iter().copied().fold(f64::MAX, f64::min)
        };
        let of = |name: &str| figure(&outcome, "warm-up", &format!("{name}[drift_{axis}, thermal-const]"), "um");
        assert!((of("range") - spread(&judged)).abs() < 1e-9);
        // An hour has 60 rows and the first.
        assert!((of("first range") - spread(&judged[..61])).abs() < 1e-9);
        let windows = judged.windows(61).map(spread).fold(0.0, f64::max);
        assert!((of("largest range in a window") - windows).abs() < 1e-9);
        assert!((of("end") - (judged[judged.len() - 1] - judged[0])).abs() < 1e-9);
    }
}

/// A part of the log in which the spindle stands, or nothing moves, is no warm-up.
#[test]
fn a_drift_that_is_judged_elsewhere_is_told() {
    let recipe = || Variant::of(&recipes()["thermal-spindle"]).only(&["warm-up"]);
    for (from, until, at_rest, beside) in [
        (0.0, Some(22_200.0), false, false),
        (0.0, None, false, false),
        (700.0, Some(22_200.0), false, false),
        (0.0, Some(222.0), true, true),
        (0.0, Some(370.0), true, true),
        (22_200.0, Some(22_300.0), true, true),
    ] {
        let mut recipe = recipe();
        let drift = &mut recipe.stage("warm-up")["drift"];
        drift["from_s"] = json!(from);
        drift["until_s"] = json!(until);
        let outcome = recipe.run();
        let remarks = verdict(&outcome, "warm-up").remarks.join("\n");
        assert_eq!(remarks.contains("the spindle stands in all rows that are judged"), at_rest, "{until:?}: {remarks}");
        assert_eq!(remarks.contains("are `from_s` and `until_s` what is meant"), beside, "{until:?}: {remarks}");
    }
}

/// Made by the first run, judged by another one on runs that it did not know.
#[test]
fn a_calibration_without_a_machine_is_recalled() {
    let sandbox = Sandbox::new();
    fs::create_dir_all(sandbox.path("data")).expect("a folder");
    for name in ["thermal-const.csv", "thermal-mixed.csv"] {
        let from = root().join("pipelines/data/thermal-spindle/exact").join(name);
        fs::copy(from, sandbox.path("data").join(name)).expect("a copy");
    }
    let common =
        "inputs: [T34, T52, T01]\n    outputs: [drift_z, T11]\n    time_constants: 3\n    uncertainty: ordinary\n";
    sandbox.write(
        "first.yaml",
        &format!(
            "abbe: 1\nstages:\n  run: {{ ingest: csv, path: data/thermal-const.csv }}\n  spindle:\n    estimate: thermal-states\n    \
             from: run\n    {common}"
        ),
    );
    let printed = sandbox.abbe(&["run", "first.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let second = |judge: &str| {
        format!(
            "abbe: 1\nstages:\n  run: {{ ingest: csv, path: data/thermal-mixed.csv }}\n  spindle: {{ estimate: calibration, path: \
             out/first/spindle.calibration.json }}\n  {judge}\n"
        )
    };
    sandbox.write(
        "second.yaml",
        &second("unseen: { validate: thermal, of: spindle, from: run, prediction: { limits: { max_um: 1e-8, max_K: 1e-8 } } }"),
    );
    let printed = sandbox.abbe(&["run", "second.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    assert!(printed.stdout.contains("unseen (thermal): PASS"), "{}", printed.stdout);
    // There is no machine to judge, to export, or to take.
    for (judge, expected) in [
        ("judge: { validate: residuals, of: spindle }", "`residuals` needs a machine"),
        ("table: { export: error-table, of: spindle }", "`error-table` needs a machine"),
        ("other: { validate: thermal, of: spindle, from: run, drift: { readings: [drift_q] } }", "drift_q"),
    ] {
        sandbox.write("third.yaml", &second(judge));
        let printed = sandbox.abbe(&["run", "third.yaml", "--out", "out"]);
        assert_ne!(printed.status, 0, "{judge}");
        assert!(printed.stderr.contains(expected), "{judge}: {}", printed.stderr);
    }
}

/// A run of sensors that wander and an output that follows two of three of them with two time constants.
fn wandering(seed: u64, noise: f64) -> String {
    let mut random = Generator::new(seed, 3);
    let mut text = String::from("time_s,T1_degC,T2_degC,T3_degC,drift_um\n");
    let (mut levels, mut states) = ([20.0; 3], [[0.0; 2]; 3]);
    let times = [300.0, 3000.0];
    let gains = [[4.0, 6.0], [-5.0, 9.0], [0.0, 0.0]];
    let step = 60.0;
    for row in 0..700 {
        let before: [f64; 3] = levels;
        if row > 0 {
            for level in &mut levels {
                if random.index(25) == 0 {
                    *level = 20.0 + 4.0 * random.normal();
                }
            }
            for (sensor, states) in states.iter_mut().enumerate() {
                for (state, time) in states.iter_mut().zip(times) {
                    let (a, e) = (step / time, f64::exp(-step / time));
                    let (from, to): (f64, f64) = (before[sensor] - 20.0, levels[sensor] - 20.0);
                    *state = e * *state + (1.0 - e) * from + (1.0 - (1.0 - e) / a) * (to - from);
                }
            }
        }
        let follows =
            |sensor: usize| gains[sensor].iter().zip(states[sensor]).map(|(gain, state)| gain * state).sum::<f64>();
        // The first row is the reference of all.
        let noise = if row > 0 { noise * random.normal() } else { 0.0 };
        let drift: f64 = (0..3).map(follows).sum::<f64>() + noise;
        text.push_str(&format!(
            "{},{:.9},{:.9},{:.9},{drift:.9}\n",
            step * f64::from(row),
            levels[0],
            levels[1],
            levels[2]
        ));
    }
    text
}

/// The sensor that nothing follows, and a third time constant, are left out; what is followed is kept.
#[test]
fn selection_keeps_what_predicts() {
    let mut kept_more = 0;
    let all = seeds(3);
    let count = all.clone().count();
    for seed in all {
        let sandbox = Sandbox::new();
        for run in 0..3 {
            sandbox.write(&format!("run{run}.csv"), &wandering(10 * seed + run, 0.5));
        }
        sandbox.write(
            "r.yaml",
            "abbe: 1\nstages:\n  a: { ingest: csv, path: run0.csv }\n  b: { ingest: csv, path: run1.csv }\n  c: { ingest: csv, path: \
             run2.csv }\n  fit: { estimate: thermal-states, from: [a, b, c], inputs: [T1, T2, T3], outputs: [drift], time_constants: 3, \
             select: prediction, uncertainty: ordinary }\n",
        );
        let printed = sandbox.abbe(&["run", "r.yaml", "--out", "out"]);
        assert_eq!(printed.status, 0, "seed {seed}: {}", printed.stderr);
        let text = read(&sandbox.path("out/r/fit.calibration.json"));
        let calibration = Calibration::from_json(&text).expect("a calibration");
        let settings = &calibration.model.settings;
        assert_eq!(settings["time_constants"], json!(2), "seed {seed}: {settings}");
        let inputs: Vec<&str> =
            settings["inputs"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
        assert!(inputs.starts_with(&["T1", "T2"]), "seed {seed}: {inputs:?}");
        kept_more += usize::from(inputs.len() > 2);
        for (name, expected) in [
            ("time_constant[1]_s", 300.0),
            ("time_constant[2]_s", 3000.0),
            ("drift[T1:1]", 4e-3),
            ("drift[T2:2]", 9e-3),
        ] {
            let (found, u) = value(&calibration, name);
            assert!((found - expected).abs() < 5.0 * u, "seed {seed}: {name} {found} ± {u}");
        }
    }
    assert!(kept_more <= count / 3, "{kept_more} of {count}");
}

/// Runs to be predicted in which a sensor is missing, or two of them are exchanged.
#[test]
fn sensors_of_unseen_runs() {
    let seen = wandering(1, 0.5);
    let unseen = wandering(2, 0.5);
    let judged = |run: &str| {
        let sandbox = Sandbox::new();
        sandbox.write("seen.csv", &seen);
        sandbox.write("unseen.csv", run);
        sandbox.write(
            "r.yaml",
            "abbe: 1\nstages:\n  a: { ingest: csv, path: seen.csv }\n  b: { ingest: csv, path: unseen.csv }\n  fit: { estimate: \
             thermal-states, from: a, inputs: [T1, T2], outputs: [drift], time_constants: 2 }\n  judged: { validate: thermal, of: fit, \
             from: b, prediction: { limits: { max_um: 500 } } }\n",
        );
        let printed = sandbox.abbe(&["run", "r.yaml", "--out", "out"]);
        (printed.status, printed.stdout + &printed.stderr)
    };
    let (status, text) = judged(&unseen);
    assert_eq!(status, 0, "{text}");
    assert!(!text.contains("exchanged"), "{text}");
    let exchanged = unseen.replace("T1_degC", "T9_degC").replace("T2_degC", "T1_degC").replace("T9_degC", "T2_degC");
    let (_, text) = judged(&exchanged);
    assert!(text.contains("with T1 in the place of T2: are these sensors exchanged?"), "{text}");
    let (status, text) = judged(&unseen.replace("T2_degC", "T7_degC"));
    assert_ne!(status, 0, "{text}");
    assert!(text.contains("unseen.csv") && text.contains("there is no column `T2`"), "{text}");
}

/// Times in minutes that are called seconds: beside a run in seconds, and where a run is predicted.
#[test]
fn minutes_beside_seconds_are_told() {
    let in_minutes = |run: &str| -> String {
        let of =
            |line: &str| match line.split_once(',').and_then(|(time, rest)| Some((time.parse::<f64>().ok()?, rest))) {
                Some((time, rest)) => format!("{},{rest}\n", time / 60.0),
                None => format!("{line}\n"),
            };
        run.lines().map(of).collect()
    };
    for seed in seeds(3) {
        let runs: Vec<String> = (0..3).map(|run| wandering(40 + 3 * seed + run, 0.5)).collect();
        let told = |seen: &str, unseen: &str| {
            let sandbox = Sandbox::new();
            for (name, text) in [("first.csv", runs[0].as_str()), ("second.csv", seen), ("unseen.csv", unseen)] {
                sandbox.write(name, text);
            }
            sandbox.write(
                "r.yaml",
                "abbe: 1\nstages:\n  a: { ingest: csv, path: first.csv }\n  b: { ingest: csv, path: second.csv }\n  c: { ingest: csv, \
                 path: unseen.csv }\n  fit: { estimate: thermal-states, from: a, inputs: [T1, T2], outputs: [drift], time_constants: 2 }\n  \
                 both: { estimate: thermal-states, from: [a, b], inputs: [T1, T2], outputs: [drift], time_constants: 2 }\n  judged: { \
                 validate: thermal, of: fit, from: c, prediction: {} }\n",
            );
            let printed = sandbox.abbe(&["run", "r.yaml", "--out", "out"]);
            printed.stdout + &printed.stderr
        };
        let right = told(&runs[1], &runs[2]);
        assert!(!right.contains("minutes"), "seed {seed}: {right}");
        let said = told(&in_minutes(&runs[1]), &runs[2]);
        assert!(said.contains("rows of second are 60 times as close as those of first"), "seed {seed}: {said}");
        let said = told(&runs[1], &in_minutes(&runs[2]));
        assert!(said.contains("with times that are 60 times as long: are they in minutes"), "seed {seed}: {said}");
    }
}

/// What is predicted has both uncertainties: that of residuals drawn again in blocks, and that of an ordinary fit. What was tried by a
/// selection stands in the calibration and on the page.
#[test]
fn predictions_have_both_uncertainties() {
    let sandbox = Sandbox::new();
    for run in 0..3 {
        sandbox.write(&format!("run{run}.csv"), &wandering(70 + run, 0.5));
    }
    sandbox.write(
        "r.yaml",
        "abbe: 1\nstages:\n  a: { ingest: csv, path: run0.csv }\n  b: { ingest: csv, path: run1.csv }\n  c: { ingest: csv, path: run2.csv \
         }\n  fit: { estimate: thermal-states, from: [a, b], inputs: [T1, T2, T3], outputs: [drift], time_constants: 3, select: prediction \
         }\n  plain: { estimate: thermal-states, from: [a, b], inputs: [T1, T2], outputs: [drift], time_constants: 2, uncertainty: ordinary \
         }\n  judged: { validate: thermal, of: [fit, plain], from: c, prediction: {} }\n",
    );
    let printed = sandbox.abbe(&["run", "r.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let verdicts = json_file(&sandbox.path("out/r/verdicts.json"));
    let figures = verdicts[0]["figures"].as_array().expect("figures");
    let named = |of: &str, name: &str| {
        let found =
            figures.iter().find(|figure| figure["of"] == of && figure["name"] == name && figure["unit"] == "um");
        found.and_then(|figure| figure["value"].as_f64())
    };
    let (blocks, ordinary) =
        ("standard uncertainty of predictions", "standard uncertainty of predictions, ordinary fit");
    let drawn = named("fit", blocks).expect("a figure");
    let plain = named("fit", ordinary).expect("a figure");
    assert!(plain > 0.0 && drawn > 0.3 * plain && drawn != plain, "{drawn} {plain}");
    // Nearly the same model by an ordinary fit.
    assert!((named("plain", blocks).expect("a figure") / plain - 1.0).abs() < 0.3);
    assert_eq!(named("plain", ordinary), None);
    let text = read(&sandbox.path("out/r/fit.calibration.json"));
    let calibration = Calibration::from_json(&text).expect("a calibration");
    let selection = calibration.fit.selection_by_prediction.as_ref().expect("a selection");
    assert_eq!(selection.runs, ["run0", "run1"]);
    assert!(
        selection.left_out.contains(&"*:3".to_owned()) && selection.kept.contains(&"T1".to_owned()),
        "{selection:?}"
    );
    assert!(selection.tried.len() > 3 && selection.tried.iter().all(|tried| tried.error > 0.0), "{selection:?}");
    let page = read(&sandbox.path("out/r/report.html"));
    for part in
        ["Selected by prediction", "each of run0, run1 was predicted from the others", "without T3, *:3", "taken"]
    {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn wrong_runs_and_settings_have_one_clear_error() {
    let good = wandering(1, 0.5);
    let line = |number: usize, by: &str| -> String {
        good.lines()
            .enumerate()
            .map(|(index, line)| if index == number { format!("{by}\n") } else { format!("{line}\n") })
            .collect()
    };
    let settings = "inputs: [T1, T2], outputs: [drift], time_constants: 2";
    let cases: Vec<(String, &str, &str)> = vec![
        (line(30, "600,20,20,20,1"), settings, "did the clock jump"),
        (
            (good.lines().take(1))
                .chain(good.lines().skip(60))
                .chain(good.lines().skip(1).take(59))
                .map(|line| format!("{line}\n"))
                .collect(),
            "inputs: [T1, T2], outputs: [drift], time_constants: 2, reference_until_s: 600",
            "the time falls from",
        ),
        (
            good.lines()
                .enumerate()
                .filter(|(row, _)| !(100..130).contains(row))
                .map(|(_, line)| format!("{line}\n"))
                .collect(),
            settings,
            "has a gap",
        ),
        (good.replace("T2_degC", "T2"), settings, "T2"),
        (good.replace("time_s", "time"), settings, "time"),
        (good.clone(), "inputs: [T1, T9], outputs: [drift], time_constants: 2", "there is no column `T9`"),
        (good.clone(), "inputs: [T1, T2], outputs: [drfit], time_constants: 2", "drift"),
        (good.clone(), "inputs: [T1, T2], outputs: [T1], time_constants: 2", "is no input"),
        (good.clone(), "inputs: [T1, T1], outputs: [drift], time_constants: 2", "stands here twice"),
        (good.clone(), "inputs: [T1_degC], outputs: [drift], time_constants: 2", "without its unit"),
        (good.clone(), "inputs: [T1], outputs: [drift]", "time_constants"),
        (good.clone(), "inputs: [T1], outputs: [drift], time_constants: 9", "1 to 6"),
        (good.clone(), "inputs: [T1], outputs: [drift], time_constants_s: [-5]", "time_constants_s"),
        (good.clone(), "inputs: [T1], outputs: [drift], time_constants: 1, parameters: [x]", "parameters"),
        (good.clone(), "inputs: [T1], outputs: [drift], time_constants: 1, machine: a", "machine"),
        (good.lines().take(8).map(|line| format!("{line}\n")).collect(), settings, "cannot be told from"),
        // The same sensor twice.
        (
            good.lines()
                .map(|line| {
                    let cells: Vec<&str> = line.split(',').collect();
                    format!(
                        "{},{},{},{},{}\n",
                        cells[0],
                        cells[1],
                        if cells[1].ends_with('C') { "T2_degC" } else { cells[1] },
                        cells[3],
                        cells[4]
                    )
                })
                .collect(),
            settings,
            "cannot be told from",
        ),
    ];
    for (text, settings, expected) in cases {
        let sandbox = Sandbox::new();
        sandbox.write("run.csv", &text);
        sandbox.write(
            "r.yaml",
            &format!("abbe: 1\nstages:\n  a: {{ ingest: csv, path: run.csv }}\n  fit: {{ estimate: thermal-states, from: a, {settings} }}\n"),
        );
        let printed = sandbox.abbe(&["run", "r.yaml", "--out", "out"]);
        assert_ne!(printed.status, 0, "{settings} {expected}");
        assert!(printed.stderr.contains(expected), "{expected}: {}", printed.stderr);
        assert!(!sandbox.path("out").exists(), "{expected}");
    }
}
