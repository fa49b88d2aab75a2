//! Mistakes that readings, columns or plain physics contradict although every limit is kept.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::misread::changed;
use crate::support::{Variant, abbe, recipes, temporary};

/// Remarks and failures of a run, those of verdicts included, or its error, in one text.
fn said(recipe: &Variant) -> String {
    let folder = temporary();
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--json".as_ref()]);
    let found: serde_json::Value = serde_json::from_str(&printed.stdout).unwrap_or_default();
    let verdicts = found["verdicts"].as_array().into_iter().flatten().map(|verdict| verdict["remarks"].to_string());
    let all = ["remarks", "failures", "error"].map(|key| found[key].to_string());
    all.into_iter().chain([printed.stderr]).chain(verdicts).collect::<Vec<_>>().join("\n")
}

fn times(factor: f64) -> impl Fn(usize, &str) -> String {
    move |_, cell| format!("{}", factor * cell.parse::<f64>().expect("a number"))
}

#[test]
fn circles_whose_angles_run_against_their_direction_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["standards-circular"]);
    let is_told = |recipe: &Variant| said(recipe).contains("are cw and ccw exchanged");
    assert!(!is_told(&recipe));
    recipe.stage("slow")["path"] =
        json!(changed(&recipe.path("slow", "path"), folder.path(), "direction", times(-1.0)));
    assert!(is_told(&recipe));
}

#[test]
fn lines_of_a_cmm_whose_ends_are_elsewhere_are_told() {
    let mut recipe = Variant::of(&recipes()["standards-cmm"]);
    let is_told = |recipe: &Variant| said(recipe).contains("are columns or rows exchanged");
    assert!(!is_told(&recipe));
    let file = recipe.path("lengths", "path");
    for (column, factor) in [("X2_mm", -1.0), ("Z1_mm", 0.1)] {
        let folder = temporary();
        recipe.stage("lengths")["path"] = json!(changed(&file, folder.path(), column, times(factor)));
        assert!(is_told(&recipe), "{column}");
    }
}

#[test]
fn a_lag_that_no_axis_has_fails() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["standards-ball-bar"]).only(&["fit"]);
    let is_told = |recipe: &Variant| said(recipe).contains("EXX[lag]");
    assert!(!is_told(&recipe));
    for place in 0..2 {
        let file = PathBuf::from(recipe.stage("circles")["path"][place].as_str().expect("a path"));
        recipe.stage("circles")["path"][place] = json!(changed(&file, folder.path(), "time_s", times(1000.0)));
    }
    assert!(is_told(&recipe), "{}", said(&recipe));
}

/// Seconds of arc for microradians make the noise of one file a fifth.
#[test]
fn a_file_in_seconds_of_arc_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles"]);
    let list = recipe.stage("angle-files")["path"].as_array().expect("a list").clone();
    let place = list.iter().position(|file| file.as_str().is_some_and(|file| file.ends_with("EBX.csv"))).expect("it");
    let file = list[place].as_str().expect("a path");
    let is_told = |recipe: &Variant| said(recipe).contains("is the unit of its readings right?");
    assert!(!is_told(&recipe));
    let seconds = times(180.0 * 3600.0 / std::f64::consts::PI * 1e-6);
    recipe.stage("angle-files")["path"][place] =
        json!(changed(Path::new(file), folder.path(), "reading_urad", seconds));
    assert!(is_told(&recipe), "{}", said(&recipe));
}

#[test]
fn balls_that_are_not_touched_are_not_told_as_touches_that_are_missing_alone() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["samba"]).only(&["fit-centres"]);
    let negated = changed(&recipe.path("early", "path"), folder.path(), "X_mm", times(-1.0));
    recipe.stage("early")["path"] = json!(negated);
    let words = said(&recipe);
    assert!(words.contains("the recorded positions do not lie around this ball"), "{words}");
}
