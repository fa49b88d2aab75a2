//! Validators of estimates: circles of a ball bar, repeats, uncertainties, spindles, tools, and what a correction leaves.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use abbe_compensation::{Compensator, SetPoints, Settings, Travel, Trials, remaining};
use abbe_core::{Build, Calibration, Context, Decision, Figure, Fit, Kind, RowIndex, machine_values};
use abbe_simulation::{Noise, StandardDeviation, Truth, measure};
use serde_json::{Value, json};

use super::{Counted, MACHINES, Written, guarded, machines, simple};
use crate::support::{Random, SMALL, Small, Variant, fit, recipes, registry, temporary, write};

/// The figures with a limit that a validator finds of a fit.
fn limited(validator: &str, settings: &Value, base: &Path, fit: &Fit) -> Vec<Figure> {
    let registry = registry();
    let plugin = registry.find(Kind::Validate, validator).expect("a validator");
    let Build::Validate(constructor) = &plugin.build else { panic!("{validator} is no validator") };
    let built = constructor.build(settings, &Context { base: base.to_owned() });
    let built = built.unwrap_or_else(|error| panic!("{validator}: {error}"));
    let found = built.validate(&[fit], &[]).unwrap_or_else(|error| panic!("{validator}: {error}"));
    found.figures.into_iter().filter(|figure| figure.limit.is_some()).collect()
}

fn all_pass(figures: &[Figure]) -> bool {
    assert!(!figures.is_empty(), "nothing has a limit");
    figures.iter().all(|figure| figure.decide() == Some(Decision::Pass))
}

fn largest(figures: &[Figure]) -> f64 {
    figures.iter().filter_map(|figure| figure.value).fold(0.0, f64::max)
}

fn noise(sigma: f64) -> Noise {
    Noise { probing_sigma_mm: StandardDeviation::All(sigma), ..Noise::default() }
}

/// The same fit of a measurement with these true values.
fn measured(planned: &Fit, parameters: &BTreeMap<String, f64>, noise: Noise, seed: u64) -> Fit {
    let truth = Truth { parameters: parameters.clone(), noise };
    let problem = measure(&planned.problem, &truth, seed).unwrap_or_else(|error| panic!("{error}"));
    let calibration = planned.estimator.estimate(&problem).unwrap_or_else(|error| panic!("{error}"));
    let (name, estimator) = (planned.name.clone(), Arc::clone(&planned.estimator));
    Fit { name, problem: Arc::new(problem), estimator, calibration }
}

/// The error of a machine that does most to its circles, with the error of a bar that all readings share.
#[test]
fn circles_of_a_ball_bar() {
    let mut outcome = Variant::of(&recipes()["standards-ball-bar"]).only(&["fit"]).run();
    let mut planned = outcome.fits.remove(0);
    // One row in seven tells the same.
    let mut problem = planned.problem.as_ref().clone();
    for set in &mut problem.sets {
        let kept: Vec<RowIndex> = set.rows.iter().copied().step_by(7).collect();
        set.rows = kept;
    }
    planned.problem = Arc::new(problem);
    let sizes = [
        ("EXX[1]", 3e-5),
        ("EYY[1]", 3e-5),
        ("EC0X", 3e-5),
        ("EXX[b]", 4e-3),
        ("EYY[b]", 4e-3),
        ("EYX[b]", 2e-3),
        ("EXY[b]", 2e-3),
        ("EXX[lag]", 4e-4),
        ("EXX[cyc10:cos1]", 5e-4),
        ("EYY[cyc12:sin1]", 5e-4),
    ];
    let (mut counted, mut by_chance) = (Counted::default(), Counted::default());
    for seed in 0..machines(100) as u64 {
        let random = &mut Random::new(300 + seed);
        let mut truth: BTreeMap<String, f64> =
            sizes.iter().map(|(name, size)| ((*name).to_owned(), random.within(-size, *size))).collect();
        let exact = measured(&planned, &truth, Noise::default(), 0);
        truth.insert("bar.bar[150].length".to_owned(), 150.0 + 0.7e-3 * random.normal());
        let noisy = measured(&planned, &truth, noise(0.25e-3), seed);
        let judged = |fit: &Fit, limit: Value| {
            let settings = json!({ "limits": { "contribution_um": limit } });
            limited("circular-diagnosis", &settings, Path::new(""), fit)
        };
        let limit = largest(&judged(&exact, json!(1e6)));
        counted.add("circular-diagnosis", all_pass(&judged(&noisy, guarded(limit))));
        by_chance.add("circular-diagnosis", all_pass(&judged(&noisy, simple(limit))));
    }
    counted.hold();
    let share = by_chance.share("circular-diagnosis");
    assert!((0.3..0.65).contains(&share), "{share}");
}

/// Facets that are touched `touches` times each, with labels of repeats.
fn facets(touches: usize, sigma: f64, judge: Value, random: &mut Random) -> Vec<Figure> {
    let folder = temporary();
    let mut nominal = "feature,x_mm,y_mm,z_mm,nx,ny,nz\n".to_owned();
    let mut rows = "feature,group,X_mm,Y_mm,Z_mm\n".to_owned();
    for (label, x, y) in [("a", 100, 100), ("b", -100, 100), ("c", -100, -100)] {
        let _ = writeln!(nominal, "{label},{x},{y},50,0,0,1");
        for group in 0..touches {
            let _ = writeln!(rows, "{label},{group},{x},{y},{:.9}", 153.0 + sigma * random.normal());
        }
    }
    write(&folder.path().join("facets.csv"), &nominal);
    write(&folder.path().join("touches.csv"), &rows);
    let recipe = Variant(json!({ "abbe": 1, "name": "repeats", "stages": {
        "touches": { "ingest": "csv", "path": folder.path().join("touches.csv") },
        "table": { "artefact": "facets", "from": "touches", "nominal": folder.path().join("facets.csv"),
            "standard_uncertainty_um": 1e3 * sigma },
        "machine": { "model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 100, "stylus_radius_mm": 3 },
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["table"], "parameters": ["table.*"] },
        "judge": judge,
    }}));
    let outcome = recipe.run();
    let failures: Vec<String> = outcome.failures.iter().map(|failure| failure.error.to_string()).collect();
    assert!(failures.is_empty(), "{failures:?}");
    outcome.verdicts[0].figures.iter().filter(|figure| figure.limit.is_some() && !figure.detail).cloned().collect()
}

/// The scatter of few repeats comes out small by chance: its uncertainty at the limit has to be that of a scatter as large as the limit.
#[test]
fn scatters_of_repeats() {
    let sigma = 2e-3;
    let mut counted = Counted::default();
    for repeats in [3, 5, 12] {
        for seed in 0..machines(MACHINES) as u64 {
            let judge = json!({ "validate": "repeats", "of": "fit", "by": "group", "parameters": ["table.facet[a].d"],
                "limits": { "standard_deviation_um": guarded(1e3 * sigma) } });
            let found = facets(repeats, sigma, judge, &mut Random::new(500 + seed));
            counted.add(&format!("repeats, {repeats}"), all_pass(&found));
        }
    }
    counted.hold();
}

/// An uncertainty from the scatter of few rows.
#[test]
fn uncertainties_of_parameters() {
    let sigma = 2e-3;
    let mut counted = Counted::default();
    for touches in [2, 4, 10] {
        for seed in 0..machines(MACHINES) as u64 {
            let limit = 1e3 * sigma / (touches as f64).sqrt();
            let judge = json!({ "validate": "uncertainty", "of": "fit",
                "parameters": [{ "names": ["table.facet[a].d"], "standard_uncertainty_um": guarded(limit) }] });
            let found = facets(touches, sigma, judge, &mut Random::new(900 + seed));
            counted.add(&format!("uncertainty, {touches} touches"), all_pass(&found));
        }
    }
    counted.hold();
}

/// Readings of two sensors at a spindle: form and motion that repeat, and motion that does not.
fn spindle(random: &mut Random) -> [String; 2] {
    let mut texts = ["S_deg,time_s,r1_um,r2_um\n".to_owned(), "S_deg,time_s,r1_um,r2_um\n".to_owned()];
    let orders: Vec<(f64, [f64; 4])> = [1.0, 2.0, 3.0, 5.0, 0.37, 1.61]
        .iter()
        .zip([8.0, 0.6, 0.4, 0.2, 0.15, 0.1])
        .map(|(order, size)| (*order, [0; 4].map(|_| random.within(-size, size))))
        .collect();
    for sample in 0..1200 {
        let degrees = 13.7 * f64::from(sample);
        let angle = degrees.to_radians();
        let mut values = [0.0; 2];
        for (order, [a, b, c, d]) in &orders {
            let (sin, cos) = (order * angle).sin_cos();
            values[0] += a * cos + b * sin;
            values[1] += if *order == 1.0 { a * sin - b * cos } else { c * cos + d * sin };
        }
        let time = degrees / 3600.0;
        let _ = writeln!(texts[0], "{degrees:.4},{time:.8},{:.7},{:.7}", values[0], values[1]);
        let noisy = values.map(|value| value + 0.05 * random.normal());
        let _ = writeln!(texts[1], "{degrees:.4},{time:.8},{:.7},{:.7}", noisy[0], noisy[1]);
    }
    texts
}

#[test]
fn error_motions_of_spindles() {
    let keys = [
        "synchronous_rotating_um",
        "asynchronous_rotating_um",
        "synchronous_fixed_um",
        "asynchronous_fixed_um",
        "total_rotating_um",
        "total_fixed_um",
    ];
    let judged = |text: &str, limits: &BTreeMap<&str, Value>| -> BTreeMap<&str, Vec<Figure>> {
        let folder = temporary();
        write(&folder.path().join("run.csv"), text);
        let recipe = Variant(json!({ "abbe": 1, "name": "spindle", "stages": {
            "run": { "ingest": "csv", "path": folder.path().join("run.csv") },
            "motion": { "estimate": "spindle-motion", "from": ["run"], "speeds_rpm": [600], "harmonics": 8,
                "radial": { "r1": { "azimuth_deg": 0 }, "r2": { "azimuth_deg": 90 } }, "standard_uncertainty_um": 0.05 },
            "judge": { "validate": "spindle", "of": "motion", "from": ["run"], "limits": limits, "angles": 180 },
        }}));
        let outcome = recipe.run();
        let failures: Vec<String> = outcome.failures.iter().map(|failure| failure.error.to_string()).collect();
        assert!(failures.is_empty(), "{failures:?}");
        let figures = &outcome.verdicts[0].figures;
        let of = |key: &&'static str| {
            let name = key.trim_end_matches("_um").replace('_', " ");
            let is = |figure: &&Figure| figure.limit.is_some() && figure.name.split('[').next() == Some(name.as_str());
            (*key, figures.iter().filter(is).cloned().collect())
        };
        keys.iter().map(of).collect()
    };
    let mut counted = Counted::default();
    for seed in 0..machines(40) as u64 {
        let [exact, noisy] = spindle(&mut Random::new(700 + seed));
        let limits = judged(&exact, &keys.iter().map(|key| (*key, json!(1e6))).collect());
        let limits = limits.iter().map(|(key, figures)| (*key, guarded(largest(figures)))).collect();
        for (key, figures) in judged(&noisy, &limits) {
            counted.add(&format!("spindle, {key}"), all_pass(&figures));
        }
    }
    counted.hold();
}

/// A tool that is worn by exactly what it may be: presets, master and setter have their errors.
#[test]
fn worn_tools() {
    let judged = |limits: Value, random: &mut Random| -> Decision {
        let folder = temporary();
        let (worn, offset) = (0.040, random.within(-0.05, 0.05));
        // Lengths and radii as they are, and as they are stated.
        let (master, tool) = ([200.0124, 12.4996], [152.413, 10.0]);
        let mut log =
            "reading,session,tool,quantity,method,repeat,value_mm,time_s,spindle_degC,cutting_min\n".to_owned();
        let (mut reading, mut presets) = (0, [0.0; 2]);
        for (place, quantity) in ["length", "radius"].into_iter().enumerate() {
            let off = 0.5e-3 * random.normal();
            presets[place] = tool[place] + 1.2e-3 * random.normal();
            let wear = if place == 0 { worn } else { 0.0 };
            for (name, value) in [(0, master[place] + off), (1, tool[place] - wear)] {
                for repeat in 1..=3 {
                    reading += 1;
                    let read = value + offset + 0.7e-3 * random.normal();
                    let _ =
                        writeln!(log, "{reading},1,{name},{quantity},contact,{repeat},{read:.7},{},20,0", 9 * reading);
                }
            }
        }
        write(&folder.path().join("log.csv"), &log);
        let table = format!(
            "tool,length_mm,radius_mm,wear_limit_length_um,wear_limit_radius_um\n1,{:.7},{:.7},{},30\n",
            presets[0],
            presets[1],
            1e3 * worn
        );
        write(&folder.path().join("tools.csv"), &table);
        let recipe = Variant(json!({ "abbe": 1, "name": "tools", "stages": {
            "log": { "ingest": "csv", "path": folder.path().join("log.csv") },
            "tools": { "estimate": "tool-dimensions", "from": "log", "table": folder.path().join("tools.csv"),
                "master": { "tool": 0, "length_mm": master[0], "radius_mm": master[1], "standard_uncertainty_um": 0.5 },
                "repeatability_um": { "contact": { "length": 0.7, "radius": 0.7 } },
                "setting_standard_uncertainty_um": 1.2, "coverage_factor": 2, "limits": limits },
            "judge": { "validate": "tools", "of": "tools" },
        }}));
        let outcome = recipe.run();
        let failures: Vec<String> = outcome.failures.iter().map(|failure| failure.error.to_string()).collect();
        assert!(failures.is_empty(), "{failures:?}");
        outcome.verdicts[0].decision
    };
    let limits = json!({ "breakage_um": 500, "chip_um": 25, "match_um": 60, "wrong_um": 150 });
    let mut counted = Counted::default();
    let mut answers = [0; 3];
    for seed in 0..machines(MACHINES) as u64 {
        let decision = judged(limits.clone(), &mut Random::new(1300 + seed));
        counted.add("tools", decision == Decision::Pass);
        answers[decision as usize] += 1;
    }
    counted.hold();
    // Nearly all of them are to be measured again.
    assert!(answers.iter().filter(|count| **count > 0).count() >= 2, "{answers:?}");
}

/// What a correction leaves: the machine is what it is, and commands are corrected by what was estimated of it.
#[test]
fn errors_that_a_correction_leaves() {
    let small = Small::new();
    assert!(SMALL.contains("fine:"));
    let points = "X_mm,Y_mm,Z_mm,B_deg,C_deg,dir_X\n0,0,400,0,0,1\n-150,80,440,30,0,1\n120,-90,460,-45,90,-1\n60,140,380,60,180,1\n";
    small.write("points.csv", points);
    let recipe =
        abbe_engine::prepare(&small.path("recipe.yaml"), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let outcome = recipe.run(&abbe_core::Monitor::default()).unwrap_or_else(|error| panic!("{error}"));
    let planned = fit(&outcome, "fine");
    let model = planned.problem.model.as_ref();
    let programmed = SetPoints::read(&small.path("points.csv"), model).unwrap_or_else(|error| panic!("{error}"));
    let settings = Settings { travel: Travel::Allow, ..Settings::default() };
    let mut counted = Counted::default();
    for seed in 0..machines(60) as u64 {
        let random = &mut Random::new(1100 + seed);
        let truth: BTreeMap<String, f64> = [("EX0C", 0.05), ("EXX[1]", 3e-5), ("dxt", 0.1), ("dyt", 0.1), ("dzt", 0.1)]
            .iter()
            .map(|(name, size)| ((*name).to_owned(), random.within(-size, *size)))
            .collect();
        // As the recipe states them.
        let stated = [("table", 1.6e-3), ("bar", 0.9e-3)].map(|(stage, sigma)| (stage.to_owned(), sigma));
        let by_stage = StandardDeviation::ByStage(BTreeMap::from(stated));
        let noise = Noise { probing_sigma_mm: by_stage, ..Noise::default() };
        let found = measured(planned, &truth, noise, seed);
        let estimate = machine_values(model, &found.calibration);
        let corrected = Compensator::new(model, &estimate, &settings).and_then(|it| it.correct(programmed.statuses()));
        let (driven, _) = corrected.unwrap_or_else(|error| panic!("{error}"));
        let machine = with_values(&found.calibration, &truth);
        let trials = Trials { number: 200, seed: 1, probability: 0.95 };
        let left = remaining(model, &machine, programmed.statuses(), &[driven.as_slice()], &trials);
        let left = left.unwrap_or_else(|error| panic!("{error}"))[0];
        for (key, limit, written) in [
            ("tip_max_um", left.tip_max.estimate, guarded as Written),
            ("tip_rms_um", left.tip_rms.estimate, guarded as Written),
            // The upper limit has its guard band in it.
            ("tip_upper_um", left.tip_max.estimate, simple as Written),
        ] {
            let settings = json!({ "path": "points.csv", "trials": 400, "limits": { key: written(1e3 * limit) } });
            let figures = limited("compensated", &settings, small.folder.path(), &found);
            counted.add(&format!("compensated, {key}"), all_pass(&figures));
        }
    }
    counted.hold();
}

/// A calibration with other values.
fn with_values(calibration: &Calibration, values: &BTreeMap<String, f64>) -> Calibration {
    let mut other = calibration.clone();
    for own in &mut other.parameters {
        own.value = values.get(&own.name).copied().unwrap_or(0.0);
    }
    other
}
