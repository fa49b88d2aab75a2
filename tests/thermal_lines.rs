//! What lines `thermal` of a machine can be: slopes of angles, gains at positions, logs by series; which sensors predictions need; a
//! machine that is simulated with its sensors; bad logs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_core::Calibration;
use abbe_engine::prepare;
use abbe_numerics::Generator;
use abbe_simulation::{Noise, Truth, measure};
use serde_json::{Value, json};

use crate::controls::law::seeds;
use crate::support::{Variant, abbe, fit, json_file, read, recipes, registry, root, temporary, write};

/// The TANGO test on a machine that warms up: its touches from -255 mm to 255 mm along X.
fn tango() -> Variant {
    Variant::of(&recipes()["tango-warming"]).only(&["fit"])
}

/// The true values of that data set.
fn values() -> BTreeMap<String, f64> {
    let truth = json_file(&root().join("tests/truth/tango-warming.json"));
    let parameters = truth["parameters"].as_object().expect("parameters");
    parameters.iter().map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect()
}

/// With slopes of an angle and of a rotary axis, and a straightness that has gains at positions of X.
fn with_lines(positions: &Value) -> Variant {
    let mut variant = tango();
    let errors = variant.stage("hu40t")["errors"].as_array_mut().expect("lines");
    errors.push(json!({ "thermal": ["EBZ", "ECC"], "at_once": ["T_scale"], "slope": true, "reference_until_s": 0 }));
    errors.push(
        json!({ "thermal": ["EZX"], "inputs": ["T_column"], "time_constants_s": [1000], "positions_mm": positions,
        "reference_until_s": 0 }),
    );
    let parameters = variant.stage("fit")["parameters"].as_array_mut().expect("parameters");
    parameters.extend([json!("EBZ[1*T_scale]"), json!("ECC[1*T_scale]"), json!("EZX[at*")]);
    variant
}

fn refused(variant: &Variant) -> String {
    let folder = temporary();
    let prepared = prepare(&variant.write(folder.path()), &registry());
    let error =
        prepared.and_then(|prepared| prepared.run(&abbe_core::Monitor::default()).map(drop)).expect_err("refused");
    format!("{error} {}", error.help.clone().unwrap_or_default())
}

/// The error of each estimate of the machine that the truth has, over a unit that its kind calls tiny: 10 pm at 500 mm and 10 K.
fn far_off(calibration: &Calibration, truth: &BTreeMap<String, f64>) -> Vec<String> {
    let of = |parameter: &abbe_core::Estimated| {
        let error = (parameter.value - truth.get(&parameter.name).copied().unwrap_or(0.0)).abs();
        let most = match parameter.unit.as_str() {
            "s" => 1e-2,
            "mm" => 1e-7,
            "mm/K" => 1e-8,
            "rad/(mm K)" => 1e-13,
            _ => 1e-10,
        };
        (error > most).then(|| format!("{} is off by {error:e} {}", parameter.name, parameter.unit))
    };
    calibration.parameters.iter().filter_map(of).collect()
}

#[test]
fn slopes_of_angles_and_gains_at_positions_come_back() {
    let outcome = with_lines(&json!([-260, -40, 120, 260])).run();
    let planned = fit(&outcome, "fit");
    for seed in seeds(12) {
        let mut random = Generator::new(171, seed);
        let mut truth = values();
        truth.insert("time_constant[1]_s".to_owned(), 1000.0 * (0.4 * random.normal()).exp());
        truth.insert("EBZ[1*T_scale]".to_owned(), 1e-8 * random.normal());
        truth.insert("ECC[1*T_scale]".to_owned(), 3e-6 * random.normal());
        for place in 0..4 {
            truth.insert(format!("EZX[at{place}*T_column:1]"), 1e-3 * random.normal());
        }
        let measured = measure(&planned.problem, &Truth { parameters: truth.clone(), noise: Noise::default() }, seed);
        let problem = measured.unwrap_or_else(|error| panic!("{error}"));
        let calibration = planned.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{seed}: {error}"));
        let units = |name: &str| calibration.get(name).expect("a parameter").unit.clone();
        assert_eq!(units("EBZ[1*T_scale]"), "rad/(mm K)");
        assert_eq!(
            (units("ECC[1*T_scale]"), units("EZX[at2*T_column:1]")),
            ("rad/(rad K)".to_owned(), "mm/K".to_owned())
        );
        let off = far_off(&calibration, &truth);
        assert!(off.is_empty(), "seed {seed}: {off:?}");
        assert_eq!(Calibration::from_json(&calibration.to_json().expect("JSON")).expect("a calibration"), calibration);
    }
}

/// Gains at positions say nothing beyond them: neither touches nor corrections.
#[test]
fn beyond_positions_nothing_is_said() {
    let said = refused(&with_lines(&json!([-200, 0, 260])));
    assert!(said.contains("EZX is needed with X at -240.1 mm, beyond its range of -200 to 260 mm"), "{said}");
    // The axis goes from -400 mm to 400 mm; set-points are corrected between the positions alone.
    let folder = temporary();
    let outcome = with_lines(&json!([-260, 0, 260])).run();
    let file = folder.path().join("fit.calibration.json");
    write(&file, &fit(&outcome, "fit").calibration.to_json().expect("JSON"));
    let log = tango().path("sensors", "path");
    let compensated = |x: f64| {
        write(&folder.path().join("points.csv"), &format!("X_mm,Y_mm,Z_mm,B_deg,C_deg\n{x},0,400,0,0\n"));
        let (log, out) = (log.to_str().expect("text"), format!("out{x}.csv"));
        let arguments =
            ["compensate", "fit.calibration.json", "points.csv", "--log", log, "--at", "6000", "--out", &out];
        abbe(folder.path(), &arguments)
    };
    let inside = compensated(100.0);
    assert_eq!(inside.status, 0, "{}", inside.stderr);
    let outside = compensated(350.0);
    assert_ne!(outside.status, 0, "{}", outside.stdout);
    assert!(outside.stderr.contains("beyond its range of -260 to 260 mm"), "{}", outside.stderr);
}

/// Lengths along an axis whose scale follows a temperature, over several days with a log each.
struct Days {
    folder: tempfile::TempDir,
    /// Gain at rest, 1/K, and time constant, s.
    gain: f64,
    time_constant: f64,
}

const SIGMA: f64 = 3e-4;

impl Days {
    /// Days with temperatures of their own: T1 drives the scale, T2 goes its own way, T3 is always 1.7 times as warm as T1.
    fn new(seed: u64, days: usize) -> Self {
        let folder = temporary();
        let mut random = Generator::new(4711, seed);
        let (gain, time_constant) = (11.5e-6 * (0.2 * random.normal()).exp(), 900.0 * (0.2 * random.normal()).exp());
        let mut log = "day,time_s,T1_degC,T2_degC,T3_degC\n".to_owned();
        let mut lengths = "length,day,X1_mm,X2_mm,reference_mm,time_s\n".to_owned();
        for day in 1..=days {
            // The clock of each day begins somewhere.
            let begin = (1e4 * random.uniform()).round();
            let waves: Vec<[f64; 3]> = (0..4)
                .map(|_| [1.5 * random.normal(), 5000.0 + 4000.0 * random.uniform().abs(), 3.0 * random.uniform()])
                .collect();
            let wave = |of: &[[f64; 3]], t: f64| -> f64 {
                of.iter()
                    .map(|[size, period, phase]| {
                        size * ((std::f64::consts::TAU * t / period + phase).sin() - phase.sin())
                    })
                    .sum()
            };
            // In small steps, each so short that it does not matter how the input runs within it.
            let (mut state, mut rows, step) = (0.0, Vec::new(), 1.0_f64);
            for second in 0..=10_800_u32 {
                let t = f64::from(second);
                if second % 60 == 0 {
                    let (one, two) = (wave(&waves[..2], t), wave(&waves[2..], t));
                    log +=
                        &format!("{day},{},{:.6},{:.6},{:.6}\n", begin + t, 20.0 + one, 20.0 + two, 20.0 + 1.7 * one);
                }
                // Temperatures run straight between the rows of the log.
                let row = 60.0 * (t / 60.0).floor();
                let (from, to) = (wave(&waves[..2], row), wave(&waves[..2], row + 60.0));
                let input = from + (to - from) * (t - row) / 60.0;
                if second % 300 == 150 {
                    rows.push((t, state));
                }
                state += (step / time_constant) * (input - state) * (1.0 - step / (2.0 * time_constant));
            }
            for (number, (t, state)) in rows.into_iter().enumerate() {
                let x = 100.0 + 50.0 * ((number * 7) % 9) as f64;
                let reference = x * (1.0 + 2e-5 + gain * state) + SIGMA * random.normal();
                lengths += &format!("{number},{day},0,{x},{reference:.7},{}\n", begin + t);
            }
        }
        write(&folder.path().join("log.csv"), &log);
        write(&folder.path().join("lengths.csv"), &lengths);
        Self { folder, gain, time_constant }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The recipe with these inputs and time constants.
    fn recipe(&self, inputs: &[&str], time_constants: &[f64]) -> Variant {
        Variant(json!({
            "abbe": 1,
            "name": "A scale over several days",
            "stages": {
                "sensors": { "ingest": "csv", "path": self.path("log.csv") },
                "lengths": { "ingest": "csv", "path": self.path("lengths.csv") },
                "laser": { "artefact": "length", "from": "lengths", "standard_uncertainty_um": 1e3 * SIGMA },
                "machine": { "model": "serial-chain", "chain": "w b X t", "tool_length_mm": 100, "stylus_radius_mm": 0,
                    "axes": { "X": { "range_mm": [0, 600] } }, "logs": "sensors",
                    "errors": [
                        { "polynomial": ["EXX"], "degrees": [1] },
                        { "thermal": ["EXX"], "inputs": inputs, "time_constants_s": time_constants, "slope": true,
                          "series": "day" },
                    ] },
                "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["laser"],
                    "parameters": ["EXX[*", "time_constant*"] },
            },
        }))
    }
}

/// Errors in standard uncertainties.
fn errors(calibration: &Calibration, days: &Days) -> [f64; 3] {
    [("EXX[1]", 2e-5), ("EXX[1*T1:1]", days.gain), ("time_constant[1]_s", days.time_constant)].map(|(name, truth)| {
        let found = calibration.get(name).expect("a parameter");
        (found.value - truth) / found.standard_uncertainty
    })
}

/// Each day has its own log, clock and reference; gains are those of all days.
#[test]
fn each_series_has_its_log() {
    let (mut squares, mut beyond, sets) = ([0.0; 3], 0, seeds(60));
    let count = sets.clone().count() as f64;
    for seed in sets {
        let days = Days::new(seed, 3);
        let outcome = days.recipe(&["T1"], &[500.0]).run();
        let found = errors(&fit(&outcome, "fit").calibration, &days);
        assert!(found.iter().all(|error| error.abs() < 5.0), "seed {seed}: {found:?}");
        beyond += found.iter().filter(|error| error.abs() > 1.96).count();
        squares.iter_mut().zip(found).for_each(|(sum, error)| *sum += error * error);
    }
    let rms = squares.map(|sum| (sum / count).sqrt());
    println!("rms {rms:.2?} standard uncertainties, {beyond} of {} beyond 1.96", 3.0 * count);
    assert!(rms.iter().all(|rms| (0.7..1.35).contains(rms)), "{rms:?}");
    assert!((beyond as f64) < 0.11 * 3.0 * count, "{beyond}");
}

/// Each day may begin warm, by a state of its own; these days begin at rest.
#[test]
fn each_series_has_its_beginning() {
    for seed in seeds(5) {
        let days = Days::new(seed, 3);
        let mut recipe = days.recipe(&["T1"], &[500.0]);
        recipe.stage("machine")["errors"][1]["starts_warm"] = json!(true);
        let outcome = recipe.run();
        let calibration = &fit(&outcome, "fit").calibration;
        let found = errors(calibration, &days);
        assert!(found.iter().all(|error| error.abs() < 5.0), "seed {seed}: {found:?}");
        for day in 1..=3 {
            let start = calibration.get(&format!("EXX[1*day{day}.start:1]")).expect("a beginning");
            assert_eq!(start.unit, "mm/mm");
            assert!(
                start.standard_uncertainty > 0.0 && start.value.abs() < 5.0 * start.standard_uncertainty,
                "{start:?}"
            );
        }
    }
}

#[test]
fn logs_by_series_are_checked() {
    let days = Days::new(1, 2);
    let log = read(&days.path("log.csv"));
    let with = |log: &str, change: &dyn Fn(&mut Variant)| {
        write(&days.path("log.csv"), log);
        let mut recipe = days.recipe(&["T1"], &[500.0]);
        change(&mut recipe);
        refused(&recipe)
    };
    let same = |_: &mut Variant| {};
    let without = |start: &str| {
        log.lines().filter(|line| !line.starts_with(start)).map(|line| format!("{line}\n")).collect::<String>()
    };
    let said = with(&without("2,"), &same);
    assert!(said.contains("no log has rows with day 2"), "{said}");
    let said = with(&log.replace("day,", "run,"), &same);
    assert!(said.contains("the log has no column of labels `day`"), "{said}");
    let said = with(&log.replace("T1_degC", "T4_degC"), &same);
    assert!(said.contains("the log has no column of numbers `T1`"), "{said}");
    // Days exchanged: their clocks do not fit.
    let exchanged = log.replace("\n1,", "\n9,").replace("\n2,", "\n1,").replace("\n9,", "\n2,");
    let said = with(&exchanged, &same);
    assert!(said.contains("is outside the log of temperatures"), "{said}");
    let rows: Vec<&str> = log.lines().collect();
    let gap: String =
        rows.iter().enumerate().filter(|(row, _)| !(30..40).contains(row)).map(|(_, row)| format!("{row}\n")).collect();
    let said = with(&gap, &same);
    assert!(said.contains("day 1: the log has a gap of 660 s"), "{said}");
    let lengths = read(&days.path("lengths.csv"));
    write(&days.path("lengths.csv"), &lengths.replace("day,", "group,"));
    let said = with(&log, &same);
    assert!(said.contains("have no column of labels `day`"), "{said}");
    write(&days.path("lengths.csv"), &lengths);
    // Two stages with one day each are as good as one with both.
    let whole = with_two_logs(&days, &log, false);
    let split = with_two_logs(&days, &log, true);
    assert_eq!(whole, split);
}

/// The gain from one file with both days, or from a file for each.
fn with_two_logs(days: &Days, log: &str, split: bool) -> f64 {
    write(&days.path("log.csv"), log);
    let mut recipe = days.recipe(&["T1"], &[500.0]);
    if split {
        for day in ["1", "2"] {
            let own: Vec<&str> =
                log.lines().filter(|line| line.starts_with("day") || line.starts_with(&format!("{day},"))).collect();
            write(&days.path(&format!("log-{day}.csv")), &(own.join("\n") + "\n"));
            recipe.0["stages"][format!("sensors-{day}")] =
                json!({ "ingest": "csv", "path": days.path(&format!("log-{day}.csv")) });
        }
        recipe.0["stages"].as_object_mut().expect("stages").remove("sensors");
        recipe.stage("machine")["logs"] = json!(["sensors-1", "sensors-2"]);
    }
    fit(&recipe.run(), "fit").calibration.get("EXX[1*T1:1]").expect("a gain").value
}

/// Today's log takes the place of those of all days, if all count from one temperature.
#[test]
fn a_calibration_by_series_corrects_with_the_log_of_today() {
    let days = Days::new(3, 3);
    let folder = days.folder.path();
    let calibrate = |reference: Option<f64>| {
        let mut recipe = days.recipe(&["T1"], &[500.0]);
        reference
            .iter()
            .for_each(|reference| recipe.stage("machine")["errors"][1]["reference_degC"] = json!(reference));
        let calibration = fit(&recipe.run(), "fit").calibration.to_json().expect("JSON");
        write(&folder.join("fit.calibration.json"), &calibration);
    };
    let today: String = (0..200).map(|row| format!("{},{}\n", 60 * row, 23.0)).collect();
    write(&folder.join("today.csv"), &format!("time_s,T1_degC\n0,22.999\n{}", today.split_once('\n').expect("rows").1));
    write(&folder.join("points.csv"), "X_mm\n500\n");
    let corrected = |out: &str| {
        abbe(
            folder,
            &["compensate", "fit.calibration.json", "points.csv", "--log", "today.csv", "--at", "end", "--out", out],
        )
    };
    calibrate(None);
    let told = corrected("first.csv");
    assert!(told.stderr.contains("each day of the calibration counts from a reference of its own"), "{}", told.stderr);
    calibrate(Some(20.0));
    let told = corrected("second.csv");
    assert_eq!(told.status, 0, "{}", told.stderr);
    // 3 K for hours: the state is at rest.
    let text = read(&folder.join("second.csv"));
    let row = text.lines().filter(|line| !line.starts_with('#')).nth(1).expect("a row");
    let x: f64 = row.split(',').next().expect("X").parse().expect("a number");
    let wanted = 500.0 / (1.0 + 2e-5 + 3.0 * days.gain);
    assert!((x - wanted).abs() < 1e-3, "{x}, {wanted}");
}

/// Sensors and time constants that predictions do not need are left out; the fit alone would keep them.
#[test]
fn predictions_of_other_days_choose_sensors_and_time_constants() {
    let (mut right, mut kept_needed, mut count) = (0, 0, 0);
    for seed in seeds(10) {
        let days = Days::new(seed, 4);
        let mut recipe = days.recipe(&["T1", "T2"], &[400.0, 3000.0]);
        recipe.stage("fit")["select"] =
            json!({ "by": "prediction", "candidates": ["*T1:*", "*T2:*", "*:1]", "*:2]"], "runs": "day" });
        let outcome = recipe.run();
        let calibration = &fit(&outcome, "fit").calibration;
        let selection = calibration.fit.selection_by_prediction.as_ref().expect("a selection");
        assert_eq!(selection.runs, ["1", "2", "3", "4"]);
        let kept: Vec<&str> = selection.kept.iter().map(String::as_str).collect();
        println!("seed {seed}: {kept:?} {:?} {:.3}", selection.chosen.left_out, selection.chosen.error);
        count += 1;
        kept_needed += usize::from(kept.iter().any(|name| name.starts_with("EXX[1*T1:")));
        right += usize::from(kept.len() == 1);
        // A time constant of which no state is left is no unknown, and what is left out is zero.
        for name in &selection.left_out {
            assert_eq!(calibration.get(name).expect("a parameter").value, 0.0);
        }
        for index in 1..=2 {
            let used = kept.iter().any(|name| name.ends_with(&format!(":{index}]")));
            let time = calibration.get(&format!("time_constant[{index}]_s")).expect("a time constant");
            assert_eq!(time.standard_uncertainty > 0.0, used, "{kept:?}");
        }
        assert!(selection.chosen.error < 1.3, "{}", selection.chosen.error);
    }
    println!("{right} of {count} keep one state alone");
    assert_eq!(kept_needed, count);
    assert!(10 * right >= 7 * count, "{right} of {count}");
}

#[test]
fn collinear_sensors_are_named() {
    let days = Days::new(5, 2);
    // Digits of a micro-kelvin tell them apart, on paper: the summary says that they hardly do.
    let file = days.recipe(&["T1", "T3"], &[500.0]).write(days.folder.path());
    let printed = abbe(days.folder.path(), &["run", file.to_str().expect("text"), "--out", "results"]);
    let told = printed.stdout.split("Hardly told apart").nth(1).unwrap_or_else(|| panic!("{}", printed.stdout));
    assert!(told.contains("EXX[1*T1:1]") && told.contains("EXX[1*T3:1]"), "{told}");
    let log = read(&days.path("log.csv"));
    let proportional = log.lines().enumerate().map(|(row, line)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if row > 0 {
            cells[4] = format!("{:.12}", 20.0 + 1.7 * (cells[2].parse::<f64>().expect("a number") - 20.0));
        }
        cells.join(",") + "\n"
    });
    write(&days.path("log.csv"), &proportional.collect::<String>());
    let said = refused(&days.recipe(&["T1", "T3"], &[500.0]));
    assert!(said.contains("EXX[1*T1:1]") && said.contains("EXX[1*T3:1]"), "{said}");
    let mut recipe = days.recipe(&["T1"], &[500.0]);
    recipe.stage("fit")["select"] = json!({ "by": "prediction", "candidates": ["*T1:*"], "runs": "run" });
    let said = refused(&recipe);
    assert!(said.contains("no data have several labels in a column `run`"), "{said}");
    recipe.stage("fit")["select"] = json!({ "candidates": ["*T1:*"], "runs": "day" });
    let said = refused(&recipe);
    assert!(said.contains("by: prediction"), "{said}");
}

/// Simulates a recipe, and runs what was written.
fn simulated(variant: &Variant, truth: &Value, seed: u64, out: &Path) -> abbe_engine::Outcome {
    let folder = temporary();
    write(&folder.path().join("truth.json"), &truth.to_string());
    let prepared = prepare(&variant.write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let made =
        prepared.simulate(&folder.path().join("truth.json"), seed, None).unwrap_or_else(|error| panic!("{error}"));
    made.write(out).unwrap_or_else(|error| panic!("{error}"));
    let outcome =
        prepare(&out.join(&made.recipe), &registry()).and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
    outcome.unwrap_or_else(|error| panic!("{error}"))
}

/// A machine and its sensors: touches are those of the true temperatures, the log is that of the sensors.
#[test]
fn sensors_are_simulated_too() {
    let out = temporary();
    let variant = tango();
    let original = read(&variant.path("sensors", "path"));
    let mut truth = json_file(&root().join("tests/truth/tango-warming.json"));
    truth["noise"] = json!({ "sensors": { "sigma_K": { "T_scale": 0.05 }, "resolution_K": 0.01 } });
    let outcome = simulated(&variant, &truth, 5, &out.path().join("sim"));
    let logs: Vec<PathBuf> = crate::support::tree(&out.path().join("sim"));
    let log = logs.iter().find(|path| path.ends_with("temperatures.csv")).expect("a log");
    let columns = |text: &str| -> Vec<[f64; 3]> {
        let rows = text.lines().filter(|line| line.starts_with(|first: char| first == '-' || first.is_ascii_digit()));
        let row = |line: &str| {
            let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
            [cells[0], cells[1], cells[2]]
        };
        rows.map(row).collect()
    };
    let (before, after) = (columns(&original), columns(&read(&out.path().join("sim").join(log))));
    assert_eq!(before.len(), after.len());
    let (mut squares, mut rounded) = (0.0, 0.0_f64);
    for (was, is) in before.iter().zip(&after) {
        assert_eq!(was[0], is[0]);
        squares += (was[1] - is[1]).powi(2);
        rounded = rounded.max((was[2] - is[2]).abs());
    }
    let scatter = (squares / before.len() as f64).sqrt();
    assert!((scatter / 0.05 - 1.0).abs() < 0.2, "{scatter}");
    assert!(rounded <= 0.005 + 1e-9, "{rounded}");
    // The machine itself is exact: what is left is what the noise of the sensor does.
    let residuals = fit(&outcome, "fit").calibration.fit.residual_rms_um;
    assert!((1e-3..0.5).contains(&residuals), "{residuals}");
    truth["noise"] = json!({});
    let exact = simulated(&tango(), &truth, 5, &out.path().join("exact"));
    assert!(fit(&exact, "fit").calibration.fit.residual_rms_um < 1e-4);
    truth["noise"] = json!({ "sensors": { "sigma_K": { "T_scal": 0.05 } } });
    let folder = temporary();
    write(&folder.path().join("truth.json"), &truth.to_string());
    let prepared = prepare(&tango().write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let said = prepared.simulate(&folder.path().join("truth.json"), 1, None).expect_err("refused").to_string();
    assert!(said.contains("no data have the temperature `T_scal` (did you mean `T_scale`?)"), "{said}");
}

/// With noisy sensors the covariance of the fit promises too much: errors are larger than stated, and gains are small. It is told.
#[test]
fn noise_of_sensors_makes_the_covariance_optimistic() {
    let rms = |sigma: f64| {
        let (mut squares, mut gains, mut told, mut count) = (0.0, 0.0, 0, 0.0);
        for seed in seeds(12) {
            let days = Days::new(seed, 2);
            let log = read(&days.path("log.csv"));
            let mut random = Generator::new(99, seed);
            let noisy: String = (log.lines().enumerate())
                .map(|(row, line)| {
                    let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
                    if row > 0 {
                        let read = cells[2].parse::<f64>().expect("a number") + sigma * random.normal();
                        cells[2] = format!("{read:.6}");
                    }
                    cells.join(",") + "\n"
                })
                .collect();
            write(&days.path("log.csv"), &noisy);
            let mut recipe = days.recipe(&["T1"], &[500.0]);
            // What follows at once suffers most.
            recipe.stage("machine")["errors"][1] = json!({ "thermal": ["EXX"], "at_once": ["T1"], "slope": true, "series": "day", "reference_degC": 20.0 });
            recipe.stage("fit")["parameters"] = json!(["EXX[*"]);
            at_once(&days, &log);
            let outcome = recipe.run();
            let found = fit(&outcome, "fit").calibration.get("EXX[1*T1]").expect("a gain").clone();
            squares += ((found.value - days.gain) / found.standard_uncertainty).powi(2);
            gains += found.value / days.gain;
            let folder = temporary();
            let file = recipe.write(folder.path());
            let printed = abbe(folder.path(), &["run", file.to_str().expect("text"), "--out", "results"]);
            told += usize::from(printed.stderr.contains("gains of what follows it come out too small"));
            count += 1.0;
        }
        ((squares / count).sqrt(), gains / count, told as f64 / count)
    };
    let (quiet, _, told) = rms(0.0);
    assert!((0.5..1.6).contains(&quiet) && told == 0.0, "{quiet} {told}");
    let (noisy, gain, told) = rms(0.6);
    println!(
        "without noise {quiet:.2}, with noise {noisy:.2} standard uncertainties, gain {gain:.3} of the truth, told {told:.2}"
    );
    assert!(noisy > 1.5 && gain < 0.98, "{noisy} {gain}");
    assert_eq!(told, 1.0);
}

/// Lengths of a scale that follows T1 at once, by the log that is true.
fn at_once(days: &Days, log: &str) {
    let mut temperatures: BTreeMap<String, Vec<(f64, f64)>> = BTreeMap::new();
    for line in log.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |cell: usize| cells[cell].parse::<f64>().expect("a number");
        temperatures.entry(cells[0].to_owned()).or_default().push((number(1), number(2)));
    }
    let mut random = Generator::new(55, days.gain.to_bits());
    let lengths = read(&days.path("lengths.csv"));
    let rows = lengths.lines().enumerate().map(|(row, line)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if row > 0 {
            let (x, time): (f64, f64) = (cells[3].parse().expect("X"), cells[5].parse().expect("a time"));
            let log = &temperatures[&cells[1]];
            let after = log.partition_point(|(own, _)| *own <= time);
            let ((t0, from), (t1, to)) = (log[after - 1], log[after]);
            let warm = from + (to - from) * (time - t0) / (t1 - t0) - 20.0;
            cells[4] = format!("{:.7}", x * (1.0 + 2e-5 + days.gain * warm) + SIGMA * random.normal());
        }
        cells.join(",") + "\n"
    });
    write(&days.path("lengths.csv"), &rows.collect::<String>());
}

/// Two columns of the log that changed places between the calibration and today.
#[test]
fn exchanged_sensors_are_told_where_it_can_be_seen() {
    let days = Days::new(2, 2);
    let folder = days.folder.path();
    let mut recipe = days.recipe(&["T1", "T2"], &[500.0]);
    recipe.stage("machine")["errors"][1]["reference_degC"] = json!(20.0);
    // T2 stands by a motor: it is 12 K warmer.
    let warmer = |text: &str, column: usize| -> String {
        let of = |(row, line): (usize, &str)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if row > 0 {
                cells[column] = format!("{:.6}", cells[column].parse::<f64>().expect("a number") + 12.0);
            }
            cells.join(",") + "\n"
        };
        text.lines().enumerate().map(of).collect()
    };
    let log = warmer(&read(&days.path("log.csv")), 3);
    write(&days.path("log.csv"), &log);
    recipe.stage("machine")["errors"][1].as_object_mut().expect("a line").remove("series");
    // One day, one log.
    let first: String = log
        .lines()
        .filter(|line| line.starts_with("day") || line.starts_with("1,"))
        .map(|line| format!("{line}\n"))
        .collect();
    write(&days.path("log.csv"), &first);
    let lengths = read(&days.path("lengths.csv"));
    let own: String = lengths
        .lines()
        .filter(|line| line.contains("day") || line.split(',').nth(1) == Some("1"))
        .map(|line| format!("{line}\n"))
        .collect();
    write(&days.path("lengths.csv"), &own);
    write(&folder.join("fit.calibration.json"), &fit(&recipe.run(), "fit").calibration.to_json().expect("JSON"));
    write(&folder.join("points.csv"), "X_mm\n500\n");
    let corrected = |today: &str, out: &str| {
        write(&folder.join("today.csv"), today);
        abbe(
            folder,
            &["compensate", "fit.calibration.json", "points.csv", "--log", "today.csv", "--at", "end", "--out", out],
        )
    };
    let right = corrected(&first, "right.csv");
    assert_eq!(right.status, 0, "{}", right.stderr);
    assert!(!right.stderr.contains("exchanged"), "{}", right.stderr);
    let exchanged = first.replace("T1_degC", "T9_degC").replace("T2_degC", "T1_degC").replace("T9_degC", "T2_degC");
    let told = corrected(&exchanged, "wrong.csv");
    assert!(told.stderr.contains("are T1 and T2 exchanged?"), "{}", told.stderr);
    let lost = corrected(&first.replace("T2_degC", "T4_degC"), "lost.csv");
    assert_ne!(lost.status, 0);
    assert!(lost.stderr.contains("the log has no column of numbers `T2`"), "{}", lost.stderr);
}

/// Time in minutes, temperatures in kelvin or Fahrenheit that say so are converted; those that do not say it are refused.
#[test]
fn units_of_logs() {
    let days = Days::new(6, 2);
    let log = read(&days.path("log.csv"));
    let gain = |text: &str| {
        write(&days.path("log.csv"), text);
        fit(&days.recipe(&["T1"], &[500.0]).run(), "fit").calibration.get("EXX[1*T1:1]").expect("a gain").value
    };
    let right = gain(&log);
    let with = |text: &str, column: usize, of: &dyn Fn(f64) -> f64| -> String {
        let of = |(row, line): (usize, &str)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if row > 0 {
                cells[column] = format!("{:.9}", of(cells[column].parse().expect("a number")));
            }
            cells.join(",") + "\n"
        };
        text.lines().enumerate().map(of).collect()
    };
    let minutes = with(&log, 1, &|seconds| seconds / 60.0).replace("time_s", "time_min");
    assert!((gain(&minutes) / right - 1.0).abs() < 1e-6);
    let kelvin = with(&log, 2, &|celsius| celsius + 273.15);
    write(&days.path("log.csv"), &kelvin);
    let said = refused(&days.recipe(&["T1"], &[500.0]));
    assert!(said.contains("a temperature from -100 to 200 °C was expected"), "{said}");
    // Seconds that are minutes: the measurements are outside.
    write(&days.path("log.csv"), &with(&log, 1, &|seconds| seconds / 60.0));
    let said = refused(&days.recipe(&["T1"], &[500.0]));
    assert!(said.contains("is outside the log of temperatures"), "{said}");
    // A clock that was put back by an hour.
    let put_back = |line: &str| -> String {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        cells[1] = format!("{}", cells[1].parse::<f64>().expect("a number") - 3600.0);
        cells.join(",")
    };
    let jumped = log.lines().enumerate().map(|(row, line)| match row > 90 && line.starts_with("1,") {
        true => put_back(line) + "\n",
        false => format!("{line}\n"),
    });
    write(&days.path("log.csv"), &jumped.collect::<String>());
    let said = refused(&days.recipe(&["T1"], &[500.0]));
    assert!(said.contains("did the clock jump"), "{said}");
}
