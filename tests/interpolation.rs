//! Interpolation tests of five axes: programmes that the nominal machine follows, readings of machines with known errors, and what they
//! tell.

use std::collections::BTreeMap;

use abbe_core::{Monitor, Status};
use abbe_engine::{Outcome, prepare};
use nalgebra::{Rotation3, Vector3};
use serde_json::{Value, json};

use crate::support::{Variant, fit, json_file, read, recipes, registry, root, temporary, values, write};

/// The recipe without what reads single tests, whose file need not be there.
fn planned() -> Variant {
    let mut recipe = Variant::of(&recipes()["standards-interpolation"]).only(&["fit"]);
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    ["bk1", "bk2", "bk4"].iter().for_each(|name| drop(stages.remove(*name)));
    recipe
}

fn candidates(recipe: &Variant) -> Result<String, String> {
    let folder = temporary();
    let text = prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.candidates());
    text.map_err(|error| error.to_string())
}

/// Rows by the names of their columns.
fn rows(text: &str) -> Vec<BTreeMap<String, String>> {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let of =
        |line: &str| header.iter().map(|name| (*name).to_owned()).zip(line.split(',').map(str::to_owned)).collect();
    lines.map(of).collect()
}

fn number(row: &BTreeMap<String, String>, name: &str) -> f64 {
    row[name].parse().unwrap_or_else(|_| panic!("{name} of {row:?}"))
}

/// Where the linear axes have to be so that the tip is at a point of the table, on `w C' A' b Y X Z t`: by the definition alone. Axes below
/// the workpiece turn it against their command.
fn follows(point: Vector3<f64>, a: f64, c: f64) -> Vector3<f64> {
    let line_of_a = Vector3::new(0.0, 0.0, -20.0);
    let on_c = Rotation3::from_axis_angle(&Vector3::z_axis(), -c.to_radians()) * point;
    let place = line_of_a + Rotation3::from_axis_angle(&Vector3::x_axis(), -a.to_radians()) * (on_c - line_of_a);
    place + Vector3::new(0.0, 0.0, 150.0)
}

#[test]
fn the_tip_stays_at_the_ball_while_the_table_turns() {
    let text = candidates(&planned()).expect("candidates");
    let balls: BTreeMap<&str, Vector3<f64>> =
        [("a", [0.0, 0.0, 120.0]), ("c", [110.0, 0.0, 60.0]), ("k", [80.0, 0.0, 60.0])]
            .map(|(name, at)| (name, Vector3::from(at)))
            .into();
    let all = rows(&text);
    let count = |test: &str| all.iter().filter(|row| row["test"] == test).count();
    assert_eq!([count("BK1"), count("BK2"), count("BK4"), all.len()], [26, 50, 50, 126]);
    let mut before: Option<&BTreeMap<String, String>> = None;
    for row in &all {
        let expected = follows(balls[row["ball"].as_str()], number(row, "A_deg"), number(row, "C_deg"));
        let found = Vector3::new(number(row, "X_mm"), number(row, "Y_mm"), number(row, "Z_mm"));
        assert!((found - expected).norm() < 2e-6, "{row:?}: {expected}");
        // A row of one way comes from the row before.
        if let Some(before) = before.filter(|own| own["test"] == row["test"] && own["direction"] == row["direction"]) {
            for axis in ["X_mm", "Y_mm", "Z_mm", "A_deg", "C_deg"] {
                let moved = number(row, axis) - number(before, axis);
                let side = number(row, &format!("dir_{}", &axis[..1]));
                assert!(moved.abs() < 1e-5 || moved.signum() == side, "{axis} of {row:?}");
            }
            let turning = if row["test"] == "BK1" { "A_deg" } else { "C_deg" };
            assert_eq!((number(row, turning) - number(before, turning)).signum(), number(row, "direction"));
        }
        before = Some(row);
    }
    // Five axes move at once.
    let of_both: Vec<_> = all.iter().filter(|row| row["test"] == "BK4").collect();
    for axis in ["X_mm", "Y_mm", "Z_mm", "A_deg", "C_deg"] {
        let values = || of_both.iter().map(|row| number(row, axis));
        assert!(values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min) > 20.0, "{axis} stands");
    }
}

/// Plans the programme, measures it on a machine of these errors and runs the recipe there.
fn measured(recipe: &Variant, truth: &Value, seed: u64) -> Outcome {
    let folder = temporary();
    let mut recipe = recipe.clone();
    write(&folder.path().join("programme.csv"), &candidates(&recipe).expect("candidates"));
    recipe.0.as_object_mut().expect("a recipe").remove("plan");
    recipe.stage("tests")["path"] = json!(folder.path().join("programme.csv"));
    write(&folder.path().join("truth-of-it.json"), &truth.to_string());
    let out = folder.path().join("simulated");
    let prepared = prepare(&recipe.write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
    let simulated = prepared.simulate(&folder.path().join("truth-of-it.json"), seed, None);
    simulated.and_then(|simulated| simulated.write(&out)).unwrap_or_else(|error| panic!("{error}"));
    let run = prepare(&out.join("recipe.yaml"), &registry()).and_then(|prepared| prepared.run(&Monitor::default()));
    run.unwrap_or_else(|error| panic!("{error}"))
}

fn truth() -> Value {
    json_file(&root().join("tests/truth/standards-interpolation.json"))
}

#[test]
fn a_planned_test_on_a_simulated_machine_gives_its_errors_back() {
    let mut exact = truth();
    exact["noise"] = json!({});
    let outcome = measured(&planned(), &exact, 1);
    let calibration = &fit(&outcome, "fit").calibration;
    let estimated: Vec<_> = calibration.parameters.iter().filter(|own| own.status == Status::Estimated).collect();
    assert!(estimated.len() >= 12, "{estimated:?}");
    for own in estimated {
        let expected = exact["parameters"].get(&own.name).and_then(Value::as_f64).unwrap_or(0.0);
        assert!((own.value - expected).abs() < 1e-7, "{}: {} instead of {expected}", own.name, own.value);
    }
    // With a sign turned it is another machine.
    exact["parameters"]["EA0C"] = json!(-exact["parameters"]["EA0C"].as_f64().expect("EA0C"));
    let other = measured(&planned(), &exact, 1);
    let [found, turned] = [&outcome, &other].map(|run| fit(run, "fit").calibration.get("EA0C").expect("EA0C").value);
    assert!((found + turned).abs() < 1e-7 && found.abs() > 1e-6, "{found} {turned}");
}

/// The recipe's own data are those of the programme on that machine.
#[test]
fn the_readings_of_the_recipe_hold_the_truth() {
    let outcome = Variant::of(&recipes()["standards-interpolation"]).run();
    let calibration = &fit(&outcome, "fit").calibration;
    let (truth, mut squares, mut count) = (truth(), 0.0, 0);
    for own in values(calibration).filter(|own| own.status == Status::Estimated && own.name.starts_with('E')) {
        let expected = truth["parameters"].get(&own.name).and_then(Value::as_f64).unwrap_or(0.0);
        let error = (own.value - expected) / own.standard_uncertainty;
        assert!(error.abs() < 3.5, "{}: {} instead of {expected}, {error}", own.name, own.value);
        squares += error * error;
        count += 1;
    }
    assert!((0.3..2.2).contains(&(squares / f64::from(count))), "{squares} of {count}");
    let programme = rows(&candidates(&planned()).expect("candidates"));
    let kept = rows(&read(&root().join("pipelines/data/standards/interpolation/tests.csv")));
    assert_eq!(programme.len(), kept.len());
    for (planned, kept) in programme.iter().zip(&kept) {
        for name in ["test", "ball", "direction"] {
            assert_eq!(planned[name], kept[name]);
        }
        for name in ["X_mm", "Y_mm", "Z_mm", "A_deg", "C_deg", "dir_X", "dir_Y", "dir_C"] {
            assert!((number(planned, name) - number(kept, name)).abs() < 1e-6, "{name}");
        }
    }
}

/// One ball bar along the radius, along the axis or across both turns with the table: radial, axial and tangential readings.
#[test]
fn a_ball_bar_turns_with_the_table() {
    let folder = temporary();
    write(&folder.path().join("balls.csv"), "feature,x_mm,y_mm,z_mm\n1,60,0,40\n");
    for (name, beside) in
        [("radial", [100.0, 0.0, 0.0]), ("tangential", [0.0, 100.0, 0.0]), ("axial", [0.0, 0.0, 100.0])]
    {
        let recipe = Variant(json!({ "abbe": 1, "name": "bar", "stages": {
            "tests": { "ingest": "csv", "path": "not-there.csv" },
            "bar": { "artefact": "ball-bar", "from": "tests", "nominal": folder.path().join("balls.csv"),
                "bars_mm": { "100": 100 }, "standard_uncertainty_um": 0.3 },
            "mill": { "model": "serial-chain", "file": root().join("pipelines/data/standards/interpolation/machine.yaml"),
                "errors": [{ "location": ["E?0C"] }] },
            "fit": { "estimate": "gauss-newton", "machine": "mill", "observations": ["bar"], "parameters": ["EX0C"] },
        }, "plan": { "estimate": "fit", "candidates": "bar", "by": "test", "number": 1, "generate": {
            "interpolations": [{ "test": name, "ball": "1", "beside_mm": beside, "both_ways": false,
                "turns_deg": { "A": [-20], "C": { "from": 0, "to": 360, "step": 30 } } }],
            "columns": { "reading_um": 0 } } } }));
        let all = rows(&candidates(&recipe).expect("candidates"));
        assert_eq!(all.len(), 13);
        for row in &all {
            let tip = Vector3::new(60.0, 0.0, 40.0) + Vector3::from(beside);
            let expected = follows(tip, -20.0, number(row, "C_deg"));
            let found = Vector3::new(number(row, "X_mm"), number(row, "Y_mm"), number(row, "Z_mm"));
            assert!((found - expected).norm() < 2e-6 && number(row, "A_deg") == -20.0, "{name}: {row:?}");
        }
    }
}

/// A change of a test.
type Change<'a> = &'a dyn Fn(&mut Value);

#[test]
fn tests_that_cannot_be_followed_are_refused() {
    let wrong = |change: Change<'_>| {
        let mut recipe = planned();
        change(&mut recipe.0["plan"]["generate"]["interpolations"][0]);
        candidates(&recipe).err().unwrap_or_default()
    };
    let cases: [(Change<'_>, &str); 8] = [
        (&|test| test["ball"] = json!("q"), "the artefact has no ball q that the tip follows"),
        (&|test| test["turns_deg"] = json!({ "B": [0, 10] }), "the machine has no rotary axis B"),
        (&|test| test["turns_deg"] = json!({ "A": [0, 50] }), "A does not reach 50 deg: BK1"),
        (&|test| test["turns_deg"] = json!({ "A": [0, 5], "C": [0, 5, 10] }), "as many as of the other axis"),
        (&|test| test["turns_deg"] = json!({ "A": [0] }), "an axis with two positions or more was expected"),
        (&|test| test["beside_mm"] = json!([900, 0, 0]), "the linear axes do not follow the ball at step 1 of BK1"),
        (&|test| test["test"] = json!("a,b"), "a text without commas"),
        (&|test| test["turns"] = json!(1), "unknown"),
    ];
    for (change, expected) in cases {
        let error = wrong(change);
        assert!(error.to_lowercase().contains(&expected.to_lowercase()), "{expected}: {error}");
    }
    let mut recipe = planned();
    recipe.0["plan"]["generate"]["indexations_deg"] = json!({ "C": [0, 90] });
    let error = candidates(&recipe).err().unwrap_or_default();
    assert!(error.contains("`interpolations` have their own positions"), "{error}");
}
