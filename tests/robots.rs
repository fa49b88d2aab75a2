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
