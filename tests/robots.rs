//! Robots seen by a tracker: simulated data by an independent program, other robots by Denavit-Hartenberg matrices of their own,
//! and how many errors positions can tell.

use abbe_core::{Calibration, Status};
use nalgebra::{Matrix4, Rotation3, Vector3, Vector4};
use serde_json::{Value, json};

use crate::support::{Variant, fit, json_file, recipes, root, temporary, values, write};

fn recipe(data: &str) -> Variant {
    let file = root().join(format!("pipelines/data/robot-ur5/{data}/poses.csv"));
    Variant::of(&recipes()["robot-ur5"]).set("poses", "path", json!(file))
}

fn of(recipe: &Variant, name: &str) -> Calibration {
    fit(&recipe.run(), name).calibration.clone()
}

/// Error and standard uncertainty of all errors that are estimated.
fn errors(found: &Calibration) -> Vec<(String, f64, f64)> {
    let truth = json_file(&root().join("tests/truth/robot-ur5.json"))["parameters"].clone();
    let estimated =
        values(found).filter(|value| value.status == Status::Estimated && !value.name.starts_with("tracker"));
    estimated
        .map(|value| {
            (value.name.clone(), value.value - truth[&value.name].as_f64().unwrap(), value.standard_uncertainty)
        })
        .collect()
}

#[test]
fn exact_positions_give_the_truth_back() {
    let found = of(&recipe("exact"), "gear");
    assert_eq!((found.fit.unknowns, found.fit.rank), (29, 29));
    let errors = errors(&found);
    assert_eq!(errors.len(), 23);
    for (name, off, _) in errors {
        assert!(off.abs() < 1e-8, "{name} is off by {off:e}");
    }
}

/// The distance of points beside the residual of a coordinate, wherever a fit of positions is told.
#[test]
fn the_radial_rms_stands_beside_that_of_a_coordinate() {
    let recipe = recipe("realistic").only(&["lines"]);
    let outcome = recipe.run();
    let found = fit(&outcome, "lines");
    let (each, radial) = (found.calibration.fit.residual_rms_um, found.calibration.fit.residual_radial_rms_um);
    let radial = radial.expect("positions have distances");
    // All rows have three coordinates.
    assert!((radial / each - 3f64.sqrt()).abs() < 1e-9, "{each} and {radial}");
    let folder = temporary();
    let file = recipe.write(folder.path());
    let printed = crate::support::as_typed(folder.path(), &["run", file.to_str().expect("UTF-8"), "--out", "results"]);
    assert!(printed.stdout.contains(" µm a coordinate, "), "{}{}", printed.stdout, printed.stderr);
    assert!(printed.stdout.contains(" µm radial"), "{}", printed.stdout);
    let results = folder.path().join("results");
    let files = crate::support::tree(&results);
    let page = files.iter().find(|file| file.ends_with("report.html")).expect("the page");
    assert!(crate::support::read(&results.join(page)).contains("radial RMS µm"));
}

#[test]
fn noisy_positions_hold_the_truth_within_their_uncertainty() {
    let found = of(&recipe("realistic"), "gear");
    assert!((found.fit.sigma - 1.0).abs() < 0.12, "{}", found.fit.sigma);
    for (name, off, uncertainty) in errors(&found) {
        assert!(off.abs() < 4.0 * uncertainty, "{name} is off by {off:e}, {uncertainty:e} was stated");
    }
    // The gear error is there: without it there is more than noise.
    assert!(of(&recipe("realistic"), "lines").fit.sigma > 1.2);
}

/// The recipe with all locations, tool and tracker unknown.
#[test]
fn positions_tell_27_of_48() {
    let mut recipe = recipe("exact").only(&["lines"]);
    recipe.stage("lines")["parameters"] = json!(["E?0??", "dxt", "dyt", "dzt", "dat", "dbt", "dct", "tracker.*"]);
    let folder = temporary();
    let printed = crate::support::abbe(folder.path(), &["check", recipe.write(folder.path()).to_str().expect("UTF-8")]);
    let told = printed.stdout + &printed.stderr;
    let words: Vec<&str> = told.split_whitespace().collect();
    assert!(words.windows(4).any(|words| words == ["lines", "180", "48", "27"]), "{told}");
}

fn turn(axis: Vector3<f64>, degrees: f64) -> Matrix4<f64> {
    Rotation3::from_scaled_axis(axis * degrees.to_radians()).to_homogeneous()
}

fn shift(x: f64, y: f64, z: f64) -> Matrix4<f64> {
    Matrix4::new_translation(&Vector3::new(x, y, z))
}

/// Random robots by matrices of their own: what the tracker sees is explained without a residual, in both conventions.
#[test]
fn robots_by_parameters_are_where_their_matrices_say() {
    for seed in 1..=40 {
        let mut random = crate::controls::law::uniform(seed);
        let is_modified = seed % 2 == 0;
        let (tip, joints) = ([30.0 * random(), 20.0, 100.0 + 50.0 * random()], 4 + (seed % 3) as usize);
        let mut links = Vec::new();
        for joint in 0..joints {
            let twist = [0.0, 90.0, -90.0, 35.0][(4.0 * random()) as usize % 4];
            let linear = seed % 5 == 0 && joint == 2;
            links.push((400.0 * random() - 200.0, twist, 300.0 * random(), 360.0 * random() - 180.0, linear));
        }
        let declared: Vec<Value> = links
            .iter()
            .enumerate()
            .map(|(index, &(a, alpha, d, theta, linear))| {
                let letter = if linear { "Z" } else { "C" };
                json!({ "name": format!("{letter}{}", index + 1), "a_mm": a, "alpha_deg": alpha, "d_mm": d, "theta_deg": theta, "linear": linear })
            })
            .collect();
        let mut header: Vec<String> = Vec::new();
        for (index, link) in links.iter().enumerate() {
            header.push(if link.4 { format!("Z{}_mm", index + 1) } else { format!("C{}_deg", index + 1) });
        }
        let mut text = header.join(",") + ",x_mm,y_mm,z_mm\n";
        let place = turn(Vector3::new(0.2, -0.3, 1.0), 70.0) * shift(900.0, -400.0, 50.0);
        for _ in 0..30 {
            let (mut frame, mut cells) = (Matrix4::identity(), Vec::new());
            for &(a, alpha, d, theta, linear) in &links {
                let command = if linear { 200.0 * random() } else { 300.0 * random() - 150.0 };
                cells.push(command.to_string());
                let (angle, offset) = if linear { (theta, d + command) } else { (theta + command, d) };
                let joint = turn(Vector3::z(), angle) * shift(0.0, 0.0, offset);
                let twist = turn(Vector3::x(), alpha) * shift(a, 0.0, 0.0);
                frame *= if is_modified { twist * joint } else { joint * twist };
            }
            let seen = place * frame * Vector4::new(tip[0], tip[1], tip[2], 1.0);
            cells.extend(seen.iter().take(3).map(f64::to_string));
            text.push_str(&(cells.join(",") + "\n"));
        }
        let folder = temporary();
        write(&folder.path().join("poses.csv"), &text);
        let mut recipe = recipe("exact").only(&["lines"]).set("poses", "path", json!(folder.path().join("poses.csv")));
        let key = if is_modified { "modified_dh" } else { "dh" };
        let machine = recipe.stage("robot");
        machine["robot"] = json!({ key: declared, "tip_mm": tip });
        machine["errors"] = json!([]);
        machine["axes"] = json!({});
        recipe.stage("lines")["parameters"] = json!(["tracker.*"]);
        let found = of(&recipe, "lines");
        assert!(found.fit.residual_rms_um < 1e-6, "seed {seed}: {} um", found.fit.residual_rms_um);
    }
}

/// A virtual robot with known errors, measured by the tracker with noise: the truth is inside the uncertainty, for many seeds. The
/// errors of compliance are among them.
#[test]
fn virtual_robots_hold_the_truth_within_their_uncertainty() {
    let folder = temporary();
    let mut recipe = recipe("exact").only(&["lines"]);
    recipe.stage("robot")["errors"]
        .as_array_mut()
        .expect("a list")
        .push(json!({ "gravity": ["EBB2"], "angles": ["B1+B2"] }));
    let names = [
        "EX0B?",
        "EA0B?",
        "EZ0B2",
        "EC0B2",
        "EZ0B3",
        "EC0B3",
        "EX0C2",
        "EA0C2",
        "EBB2[*",
        "dxt",
        "dyt",
        "dzt",
        "tracker.*",
    ];
    recipe.stage("lines")["parameters"] = json!(names);
    let file = recipe.write(folder.path());
    let (mut counted, mut within_two) = (0, 0);
    for seed in 1..=12u64 {
        let mut random = crate::controls::law::uniform(seed);
        let mut truth = serde_json::Map::new();
        for name in ["EX0B1", "EX0B2", "EX0B3", "EZ0B2", "EZ0B3", "EX0C2", "dxt", "dzt"] {
            truth.insert(name.to_owned(), json!(0.6 * (random() - 0.5)));
        }
        for name in ["EA0B1", "EA0B3", "EC0B2", "EC0B3", "EA0C2", "EBB2[cosB1+B2]", "EBB2[sinB1+B2]"] {
            truth.insert(name.to_owned(), json!(2e-3 * (random() - 0.5)));
        }
        let noise = json!({ "probing_sigma_mm": 0.03 });
        write(&folder.path().join("truth.json"), &json!({ "parameters": truth, "noise": noise }).to_string());
        let out = format!("virtual-{seed}");
        let arguments = [
            "simulate",
            file.to_str().expect("UTF-8"),
            "--truth",
            "truth.json",
            "--seed",
            &seed.to_string(),
            "--out",
            &out,
        ];
        let printed = crate::support::as_typed(folder.path(), &arguments);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        let out = folder.path().join(&out);
        let is_data = |file: &std::path::PathBuf| file.extension().is_some_and(|extension| extension == "csv");
        let data = crate::support::tree(&out).into_iter().find(is_data).map(|file| out.join(file)).expect("data");
        let simulated = recipe.clone().set("poses", "path", json!(data));
        let found = of(&simulated, "lines");
        assert!((found.fit.sigma - 1.0).abs() < 0.2, "seed {seed}: {}", found.fit.sigma);
        for own in values(&found).filter(|own| own.status == Status::Estimated && !own.name.starts_with("tracker")) {
            let off = own.value - truth.get(&own.name).and_then(Value::as_f64).unwrap_or(0.0);
            assert!(off.abs() < 4.5 * own.standard_uncertainty, "seed {seed}: {} is off by {off:e}", own.name);
            counted += 1;
            within_two += usize::from(off.abs() < 2.0 * own.standard_uncertainty);
        }
    }
    // 95.4 % are expected; of some 260 values 92 to 98 %.
    let part = within_two as f64 / f64::from(counted);
    assert!((0.91..0.99).contains(&part), "{within_two} of {counted}");
}

/// A calibration of a robot is accepted for its own description, and refused for that of another one.
#[test]
fn corrections_are_for_the_robot_that_was_calibrated() {
    let folder = temporary();
    let recipe = recipe("exact").only(&["lines"]);
    let outcome = recipe.run();
    outcome.write(folder.path()).expect("results");
    let calibration = crate::support::tree(folder.path())
        .into_iter()
        .find(|file| file.ends_with("lines.calibration.json"))
        .expect("a calibration");
    let described: Value = recipe.0["stages"]["robot"].clone();
    let machine = |robot: &Value| {
        json!({ "robot": robot, "axes": described["axes"], "tool_length_mm": 0, "stylus_radius_mm": 0 }).to_string()
    };
    write(&folder.path().join("own.yaml"), &machine(&described["robot"]));
    let mut other = described["robot"].clone();
    other["dh"][1]["a_mm"] = json!(-430);
    write(&folder.path().join("other.yaml"), &machine(&other));
    write(&folder.path().join("points.csv"), "C1_deg,B1_deg,B2_deg,B3_deg,C2_deg,B4_deg\n10,-60,40,20,80,5\n");
    let calibration = calibration.to_str().expect("UTF-8").to_owned();
    let compensate = |machine: &str| {
        let arguments = ["compensate", &calibration, "points.csv", "--machine", machine];
        crate::support::as_typed(folder.path(), &arguments)
    };
    let refused = compensate("other.yaml");
    assert!(
        refused.stderr.contains("this is the calibration of another machine"),
        "{}{}",
        refused.stdout,
        refused.stderr
    );
    let accepted = compensate("own.yaml");
    assert!(
        !accepted.stderr.contains("machine file") && !accepted.stderr.contains("another machine"),
        "{}{}",
        accepted.stdout,
        accepted.stderr
    );
}

/// A reflector elsewhere than the recipe says: the message names the tip, and no number of a joint that is alike by chance.
#[test]
fn a_tip_that_is_elsewhere_is_told_as_such() {
    let folder = temporary();
    for (tip, symbol) in [([65, -15, 95], "dxt"), ([20, -15, 140], "dyt"), ([20, 30, 95], "dzt")] {
        let mut recipe = recipe("realistic").only(&["lines"]);
        recipe.stage("robot")["robot"]["tip_mm"] = json!(tip);
        let file = recipe.write(folder.path());
        let printed = crate::support::abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
        let said = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        assert_eq!(printed.status, 1, "{said}");
        assert!(said.contains(symbol) && said.contains("or at `tip_mm` of a robot"), "{said}");
        assert!(!said.contains("point_mm"), "{said}");
    }
}
