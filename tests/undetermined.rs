//! What measurements do not determine is not corrected, whatever way it takes: known values, tables, single points, other times.

use std::fs;
use std::path::Path;

use abbe_core::Status;
use serde_json::{Value, json};

use crate::support::{Printed, Small, abbe, json_file, temporary};

/// A line of X that was not measured at 300 mm, where a knot of its spline is; and one of Y, which takes the errors of X as known.
fn recipe(folder: &Path, more: &Value) -> Value {
    let row = |run: usize, position: usize, reading: f64| format!("{run},1,{position},{reading:.3}\n");
    let header = "run,direction,position_mm,reading_um\n";
    let x = (1..=3).flat_map(|run| {
        let noise = [0.2, -0.1, -0.1][run - 1];
        [(0, 0.0), (100, 12.1), (200, 5.0), (400, -20.2)].map(|(place, reading)| row(run, place, reading + noise))
    });
    let y = [(0, 0.0), (100, 1.1), (200, 2.2), (300, 2.9), (400, 4.1)].map(|(place, reading)| row(1, place, reading));
    fs::write(folder.join("direct-EXX.csv"), header.to_owned() + &x.collect::<String>()).expect("a file");
    fs::write(folder.join("direct-EYY.csv"), header.to_owned() + &y.concat()).expect("a file");
    fs::write(folder.join("path.csv"), "X_mm,Y_mm,Z_mm\n10,0,0\n300,10,10\n320,10,10\n").expect("a file");
    let at = |moves: &str, others: Value| json!({ "kind": "displacement", "moves": moves, "at_mm": others });
    let mut stages = json!({
        "x": { "ingest": "csv", "path": "direct-EXX.csv" }, "y": { "ingest": "csv", "path": "direct-EYY.csv" },
        "along-x": { "artefact": "direct", "from": "x", "standard_uncertainty_um": 0.2,
            "measurements": { "direct-EXX": at("X", json!({ "Y": 0, "Z": 0 })) } },
        "along-y": { "artefact": "direct", "from": "y", "standard_uncertainty_um": 0.2,
            "measurements": { "direct-EYY": at("Y", json!({ "X": 0, "Z": 0 })) } },
        "mill": { "model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 0, "stylus_radius_mm": 0,
            "axes": { "X": { "range_mm": [0, 400] }, "Y": { "range_mm": [0, 400] }, "Z": { "range_mm": [0, 400] } },
            "errors": [
                { "polynomial": ["EYY"], "degrees": [1] }, { "backlash": ["EXX"] },
                { "spline": ["EXX"], "knots_mm": { "from": 0, "to": 400, "step": 100 }, "zero": ["EXX[spl0]"] },
            ] },
        "fit-x": { "estimate": "gauss-newton", "machine": "mill", "observations": ["along-x"],
            "parameters": ["EXX[spl*]", "along-x.*"], "on_confounded": "minimum-norm" },
        "fit-y": { "estimate": "gauss-newton", "machine": "mill", "observations": ["along-y"],
            "parameters": ["EYY[1]", "along-y.*"], "known": "fit-x" },
    });
    for (name, stage) in more.as_object().expect("stages") {
        stages[name] = stage.clone();
    }
    json!({ "abbe": 1, "name": "A line with a hole", "stages": stages })
}

fn run(folder: &Path, more: &Value) -> Printed {
    fs::write(folder.join("hole.yaml"), recipe(folder, more).to_string()).expect("a file");
    abbe(folder, &["run", "hole.yaml", "--out", "out"])
}

/// Words of an output, line ends and frames left out.
fn said(printed: &Printed) -> String {
    printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

#[test]
fn what_is_known_from_a_confounded_estimate_stays_confounded() {
    let folder = temporary();
    let printed = run(folder.path(), &json!({}));
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let file = folder.path().join("out/hole/fit-y.calibration.json");
    let text = fs::read_to_string(&file).expect("a calibration");
    let calibration = abbe_core::Calibration::from_json(&text).expect("a calibration");
    assert_eq!(calibration.get("EXX[spl3]").map(|known| known.status), Some(Status::Confounded));
    for command in ["compensate", "correct"] {
        let printed = abbe(folder.path(), &[command, "out/hole/fit-y.calibration.json", "path.csv"]);
        assert_eq!(printed.status, 1, "{command}: {}", printed.stdout);
        assert!(said(&printed).contains("what the measurements do not determine: EXX[spl3]"), "{}", printed.stderr);
    }
}

#[test]
fn tables_of_what_is_confounded_are_refused() {
    let settings = [
        json!({ "export": "linuxcnc", "step_mm": 50 }),
        json!({ "export": "linuxcnc", "step_mm": 100 }),
        json!({ "export": "linuxcnc-kinematics", "component": "mykins", "form": "table", "step_mm": 100 }),
        json!({ "export": "linuxcnc-kinematics", "component": "mykins" }),
        json!({ "export": "isg-volumetric", "axis_numbers": { "X": 1, "Y": 2, "Z": 3 }, "step_mm": 100 }),
        json!({ "export": "heidenhain-kinematics", "tool_length_mm": 100, "values": "added", "step_mm": 100 }),
        json!({ "validate": "compensated", "grid": { "points": 3 }, "trials": 1000 }),
    ];
    for setting in settings {
        let folder = temporary();
        let mut stage = setting.clone();
        stage["of"] = json!("fit-x");
        let printed = run(folder.path(), &json!({ "written": stage }));
        assert_eq!(printed.status, 1, "{setting}: {} {}", printed.stdout, printed.stderr);
        let said = said(&printed);
        assert!(said.contains("what the measurements do not determine: EXX[spl3]"), "{setting}: {said}");
        assert!(!folder.path().join("out/hole/written").exists());
    }
}

/// Half of the reversal that no reading tells, because all came from one side.
#[test]
fn reversal_that_was_not_measured_is_not_written() {
    for setting in [
        json!({ "export": "linuxcnc", "step_mm": 50 }),
        json!({ "export": "linuxcnc-kinematics", "component": "mykins" }),
    ] {
        let folder = temporary();
        let mut stage = setting.clone();
        stage["of"] = json!("fit-x");
        let parameters = json!(["EXX[spl1]", "EXX[spl2]", "EXX[spl4]", "EXX[b]", "along-x.*"]);
        let fit = json!({ "estimate": "gauss-newton", "machine": "mill", "observations": ["along-x"],
            "parameters": parameters, "on_confounded": "minimum-norm" });
        let printed = run(folder.path(), &json!({ "fit-x": fit, "written": stage }));
        assert_eq!(printed.status, 1, "{setting}: {} {}", printed.stdout, printed.stderr);
        assert!(said(&printed).contains("EXX[b]"), "{setting}: {}", printed.stderr);
    }
}

/// The limit of what remains is as wide with known values as with those of the estimate itself.
#[test]
fn few_degrees_of_freedom_stay_few_where_values_are_known() {
    let folder = temporary();
    let fit = json!({ "estimate": "gauss-newton", "machine": "mill", "observations": ["along-x"],
        "parameters": ["EXX[spl1]", "EXX[spl2]", "EXX[spl4]", "along-x.*"] });
    let judged = |of: &str| json!({ "validate": "compensated", "of": of, "grid": { "points": 5 }, "trials": 4000 });
    let more = json!({ "fit-x": fit, "one": judged("fit-x"), "two": judged("fit-y") });
    let printed = run(folder.path(), &more);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let verdicts = json_file(&folder.path().join("out/hole/verdicts.json"));
    let text = verdicts.to_string();
    let upper = |stage: &str| {
        let all = verdicts["verdicts"].as_array().or_else(|| verdicts.as_array()).expect("verdicts");
        let verdict = all.iter().find(|verdict| verdict["stage"] == stage).unwrap_or_else(|| panic!("{text}"));
        let figures = verdict["figures"].as_array().expect("figures");
        let figure = figures
            .iter()
            .find(|figure| figure["name"].as_str().is_some_and(|name| name.starts_with("tip upper[exact]")));
        figure.unwrap_or_else(|| panic!("{text}"))["value"].as_f64().expect("a number")
    };
    let (one, two) = (upper("one"), upper("two"));
    assert!(two > 0.9 * one, "{one} with the estimate itself, {two} with known values");
}

#[test]
fn positions_beyond_the_travel_are_not_corrected() {
    let folder = temporary();
    run(folder.path(), &json!({}));
    fs::write(folder.path().join("far.csv"), "X_mm,Y_mm,Z_mm\n10,0,0\n10,5000,10\n").expect("a file");
    let printed = abbe(folder.path(), &["correct", "out/hole/fit-y.calibration.json", "far.csv"]);
    assert_eq!(printed.status, 1);
    let said = said(&printed);
    assert!(
        said.contains("Y stands at 5000.000000 mm, beyond its travel of 0 to 400 mm") && said.contains("far.csv:3"),
        "{said}"
    );
}

/// Nobody believes a correction of kilometres.
#[test]
fn corrections_of_positions_have_a_limit() {
    let folder = temporary();
    run(folder.path(), &json!({}));
    fs::write(folder.path().join("near.csv"), "X_mm,Y_mm,Z_mm\n0,0,0\n0,400,0\n").expect("a file");
    let file = "out/hole/fit-y.calibration.json";
    let printed = abbe(folder.path(), &["correct", file, "near.csv", "--largest-correction-mm", "0.001"]);
    assert_eq!(printed.status, 1);
    let said = said(&printed);
    assert!(said.contains("mm; at most 0.001 mm are allowed") && said.contains("near.csv:"), "{said}");
    for wrong in ["0", "-1", "nan", "much"] {
        let printed = abbe(folder.path(), &["correct", file, "near.csv", "--largest-correction-mm", wrong]);
        assert_eq!(printed.status, 2, "{wrong}");
    }
}

/// A calibration beside the record of another run, and a machine whose axes are elsewhere.
#[test]
fn calibrations_that_do_not_belong_are_refused() {
    let folder = temporary();
    run(folder.path(), &json!({}));
    let file = "out/hole/fit-y.calibration.json";
    fs::write(folder.path().join("near.csv"), "X_mm,Y_mm,Z_mm\n10,0,0\n").expect("a file");
    let text = fs::read_to_string(folder.path().join(file)).expect("a calibration");
    fs::write(folder.path().join("out/hole/other.calibration.json"), text + "\n").expect("a file");
    let own = abbe(folder.path(), &["correct", file, "near.csv", "--max-age-days", "1"]);
    assert!(!said(&own).contains("is not of the run"), "{}", own.stderr);
    let other = abbe(folder.path(), &["correct", "out/hole/other.calibration.json", "near.csv", "--max-age-days", "1"]);
    assert_eq!(other.status, 1);
    assert!(said(&other).contains("is not of the run that wrote this file as it is now"), "{}", other.stderr);
    // The result of the run itself, changed by hand.
    let at = folder.path().join(file);
    let text = fs::read_to_string(&at).expect("a calibration");
    let place = text.find("\"value\": ").expect("a value") + "\"value\": ".len();
    let end = place + text[place..].find(',').expect("a comma");
    fs::write(&at, format!("{}0.01{}", &text[..place], &text[end..])).expect("a file");
    for command in [["correct", file, "near.csv"], ["compensate", file, "near.csv"]] {
        let changed = abbe(folder.path(), &command);
        assert_eq!(changed.status, 1, "{command:?}");
        assert!(said(&changed).contains("not as the run wrote it"), "{command:?}: {}", changed.stderr);
    }
}

/// Directions as tables of other programs write them; then positions without the columns of their directions, where X has backlash.
#[test]
fn the_side_from_which_an_axis_came_is_not_guessed_without_a_word() {
    let folder = temporary();
    let mut recipe = recipe(folder.path(), &json!({}));
    let mut rows = "run,direction,position_mm,reading_um\n".to_owned();
    for (direction, offset) in [("1.0", 5.0), ("-1.0", -5.0), ("+1", 5.0), ("-1", -5.0)] {
        for (number, place) in [0, 100, 200, 300, 400].into_iter().enumerate() {
            let reading = offset + 0.1 * (number % 2) as f64;
            rows.push_str(&format!("1,{direction},{place},{reading:.3}\n"));
        }
    }
    fs::write(folder.path().join("direct-EXX.csv"), &rows).expect("a file");
    recipe["stages"]["fit-x"]["parameters"] = json!(["EXX[spl*]", "EXX[b]", "along-x.*"]);
    for stage in ["y", "along-y", "fit-y"] {
        recipe["stages"].as_object_mut().expect("stages").remove(stage);
    }
    fs::write(folder.path().join("hole.yaml"), recipe.to_string()).expect("a file");
    let printed = abbe(folder.path(), &["run", "hole.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let correct = |points: &str| {
        fs::write(folder.path().join("points.csv"), points).expect("a file");
        said(&abbe(folder.path(), &["correct", "out/hole/fit-x.calibration.json", "points.csv"]))
    };
    let guessed = correct("X_mm,Y_mm,Z_mm\n100,0,0\n50,0,0\n");
    assert!(guessed.contains("there is no column `dir_X`") && guessed.contains("10"), "{guessed}");
    assert!(!guessed.contains("`dir_Y`"), "{guessed}");
    let stated = correct("X_mm,Y_mm,Z_mm,dir_X\n100,0,0,1\n50,0,0,-1\n");
    assert!(!stated.contains("there is no column"), "{stated}");
    // A third direction is refused.
    fs::write(folder.path().join("direct-EXX.csv"), rows.replace("1.0,", "2,")).expect("a file");
    let printed = abbe(folder.path(), &["run", "hole.yaml", "--out", "other"]);
    assert!(said(&printed).contains("`direction` is 2; 1, -1 or 0 was expected"), "{}", printed.stderr);
}

/// A wrong machine file may look like unknowns that the data do not determine: how far the machine is from contact is told before, once,
/// whether the rows are held or read in batches.
#[test]
fn a_wrong_machine_file_is_told_before_what_is_not_determined() {
    let words = "rough: table: at the recorded positions the nominal machine is";
    for batches in ["", ", batch_rows: 20"] {
        let small = Small::new();
        // An estimate of batches starts at no other one.
        let recipe = small.read("recipe.yaml").replace("    start: rough\n", "");
        let recipe = recipe.replace("touches.csv }", &format!("touches.csv{batches} }}"));
        small.write("recipe.yaml", &recipe);
        let right = small.abbe(&["run", "recipe.yaml", "--out", "right"]);
        assert!(right.status == 0 && !right.stderr.contains(words), "{batches}: {}", right.stderr);
        let machine = small.read("data/machine.yaml");
        let wrong = machine.replacen("direction: [0, 1, 0]", "direction: [0, 0, 1]", 1);
        assert_ne!(wrong, machine);
        small.write("data/machine.yaml", &wrong);
        let said = said(&small.abbe(&["run", "recipe.yaml", "--out", "out"]));
        let (before, error) = said.split_once("the data determine 10 of 11 unknowns").expect("the error");
        assert_eq!((before.matches(words).count(), error.matches(words).count()), (1, 0), "{batches}: {said}");
    }
}
