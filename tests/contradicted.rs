//! Labels, times, styli and rows that other columns or files contradict.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::misread::changed;
use crate::support::{Variant, abbe, read, recipes, temporary};
use crate::told::said;

/// The time of a row from its number and what stands there.
type TimeOfRow<'a> = &'a dyn Fn(usize, &str) -> f64;

/// The cells of a column of a file.
fn cells(file: &Path, column: &str) -> Vec<String> {
    let found = RefCell::new(Vec::new());
    let folder = temporary();
    changed(file, folder.path(), column, |_, cell| {
        found.borrow_mut().push(cell.to_owned());
        cell.to_owned()
    });
    found.into_inner()
}

/// A change that exchanges two labels.
fn exchanging(one: &'static str, other: &'static str) -> impl Fn(usize, &str) -> String {
    move |_, cell| match cell {
        cell if cell == one => other.to_owned(),
        cell if cell == other => one.to_owned(),
        cell => cell.to_owned(),
    }
}

const MACHINES: [&str; 2] = ["three-axis", "five-axis"];

fn before_the_cut(machine: &str) -> Variant {
    Variant::of(&recipes()[&format!("rapid-verify-{machine}")]).only(&["calibrated", "before-the-cut"])
}

/// Rows of the baseline in a verify run: of all points but one, but three, and of one in eight.
#[test]
fn rows_of_the_baseline_in_a_verify_run_are_told() {
    for machine in MACHINES {
        let baseline = before_the_cut(machine).path("baseline", "path");
        for (kept, told) in [(Some(1), true), (Some(3), true), (Some(1000), false), (None, false)] {
            let (folder, mut recipe) = (temporary(), before_the_cut(machine));
            let mut file = recipe.path("today", "path");
            // The axis of approach stands where the touch was measured: all columns are copied.
            for column in ["X_mm", "Y_mm", "Z_mm", "measured_mm"] {
                let copied = cells(&baseline, column);
                let change = |row: usize, cell: &str| {
                    let is_copied = kept.map_or(row.is_multiple_of(8), |kept| row >= kept);
                    if is_copied { copied[row].clone() } else { cell.to_owned() }
                };
                let own = folder.path().join(column);
                std::fs::create_dir(&own).expect("a folder");
                file = changed(&file, &own, column, change);
            }
            recipe.stage("today")["path"] = json!(file);
            let words = said(&recipe);
            let sentence = "are those of the baseline to the last digit";
            assert_eq!(words.contains(sentence), told, "{machine} {kept:?}: {words}");
        }
    }
}

/// A nominal file that has another stylus, another approach or another place of a rotary axis than the baseline was touched with.
#[test]
fn a_nominal_file_that_the_baseline_contradicts_is_refused() {
    let refused = |machine: &str, column: &str, to: &str| {
        let (folder, mut recipe) = (temporary(), before_the_cut(machine));
        let nominal = recipe.path("artefact", "nominal");
        let other = changed(
            &nominal,
            folder.path(),
            column,
            |row, cell| {
                if row == 3 { to.to_owned() } else { cell.to_owned() }
            },
        );
        for stage in ["artefact", "before-the-cut"] {
            recipe.stage(stage)["nominal"] = json!(other);
        }
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
        let words = printed.stderr;
        assert!(printed.status != 0 && words.contains("points.csv:6"), "{machine} {column}: {words}");
        words
    };
    for machine in MACHINES {
        assert!(refused(machine, "stylus", "2").contains("has stylus 2 here, and was touched with 1"));
    }
    assert!(refused("five-axis", "A_deg", "-30.0").contains("has A at -30.0000 deg here"));
}

#[test]
fn exchanged_labels_of_two_facets_are_told() {
    let word = "labels exchanged? What is found of each then belongs to the other one";
    let recipe = || Variant::of(&recipes()["first-steps"]);
    assert!(!said(&recipe()).contains(word));
    for (one, other) in [("5", "9"), ("12", "13"), ("20", "7")] {
        for (stage, setting) in [("touches", "path"), ("table", "nominal")] {
            let (folder, mut recipe) = (temporary(), recipe());
            let file = recipe.path(stage, setting);
            recipe.stage(stage)[setting] = json!(changed(&file, folder.path(), "feature", exchanging(one, other)));
            let words = said(&recipe);
            // Facets that look elsewhere fail before.
            let is_told = words.contains(word) && [one, other].iter().all(|label| words.contains(&format!("{label} ")));
            assert!(is_told || words.contains("away from contact"), "{one} {other} {stage}: {words}");
        }
    }
}

#[test]
fn exchanged_labels_of_two_weeks_are_told_by_their_times() {
    let word = "do not stand in the order of these labels";
    let recipe = || Variant::of(&recipes()["history"]).only(&["weekly", "baseline", "trend"]);
    assert!(!said(&recipe()).contains(word));
    for stage in ["touches", "temperature"] {
        let (folder, mut recipe) = (temporary(), recipe());
        let file = recipe.path(stage, "path");
        recipe.stage(stage)["path"] = json!(changed(&file, folder.path(), "week", exchanging("7", "19")));
        let words = said(&recipe);
        assert!(words.contains("the rows of week 7 and 19 do not stand"), "{stage}: {words}");
    }
}

/// One time that is wrong, and a clock that is set back while touches go on.
#[test]
fn times_that_fall_amid_others_are_told() {
    for (name, stage, only) in [
        ("samba", "early", &["fit-centres"][..]),
        ("tango-hu40t", "touches", &["fit-S3"]),
        ("mill-warming", "touches", &["fit"]),
        // Rows that a validator alone reads.
        ("sphere-hu40t", "strategy-2", &["fit", "validation-set"]),
    ] {
        let recipe = || Variant::of(&recipes()[name]).only(only);
        let told = |file: Option<&PathBuf>| {
            let (folder, mut recipe) = (temporary(), recipe());
            if let Some(file) = file {
                recipe.stage(stage)["path"] = json!(file);
            }
            let file = recipe.write(folder.path());
            let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
            [printed.stdout, printed.stderr].concat().split_whitespace().collect::<Vec<_>>().join(" ")
        };
        assert!(!told(None).contains("the time falls"), "{name}");
        let file = recipe().path(stage, "path");
        let rows = read(&file).lines().filter(|line| !line.starts_with('#')).count() - 1;
        let time = |cell: &str| cell.parse::<f64>().expect("a time");
        let of_row = |row: usize, cell: &str| if row == rows / 2 + 3 { 0.5 * time(cell) } else { time(cell) };
        let set_back = |row: usize, cell: &str| time(cell) - if row > rows / 2 + 3 { 3600.0 } else { 0.0 };
        let changes: [TimeOfRow<'_>; 2] = [&of_row, &set_back];
        for (case, change) in changes.into_iter().enumerate() {
            let folder = temporary();
            let other = changed(&file, folder.path(), "time_s", |row, cell| change(row, cell).to_string());
            let words = told(Some(&other));
            assert!(
                words.contains("the time falls from") || words.contains("before the log"),
                "{name} {case}: {words}"
            );
        }
    }
}

/// Machines that are built again, to see whether two of 31 sensors are exchanged, say nothing that was said of the right one.
#[test]
fn a_sensor_that_stands_is_told_once() {
    let recipe = || Variant::of(&recipes()["mill-warming"]).only(&["fit"]);
    let word = "was it stuck?";
    assert!(!said(&recipe()).contains(word));
    let (folder, mut recipe) = (temporary(), recipe());
    let file = recipe.path("sensors", "path");
    let first = RefCell::new(String::new());
    let other = changed(&file, folder.path(), "H1_degC", |row, cell| {
        if row == 50 {
            first.replace(cell.to_owned());
        }
        if (50..150).contains(&row) { first.borrow().clone() } else { cell.to_owned() }
    });
    recipe.stage("sensors")["path"] = json!(other);
    let words = said(&recipe);
    assert_eq!(words.matches(word).count(), 1, "{words}");
}

/// What all weeks have in common is one sentence.
#[test]
fn remarks_of_many_groups_are_one() {
    let recipe = || Variant::of(&recipes()["history"]).only(&["weekly"]);
    let (folder, mut recipe) = (temporary(), recipe());
    let file = recipe.path("touches", "path");
    // All touches of a ball with the sign of X turned: the nominal machine is nowhere near it.
    let other = changed(&file, folder.path(), "dir_X", |_, cell| match cell.strip_prefix('-') {
        Some(positive) => positive.to_owned(),
        None => format!("-{cell}"),
    });
    recipe.stage("touches")["path"] = json!(other);
    let words = said(&recipe);
    let of_weeks = words.lines().filter(|line| line.contains("weekly.week-") && line.contains("`dir_X`")).count();
    assert_eq!(of_weeks, 1, "{words}");
    assert!(
        words.contains("(the first of 39 such warnings)") || words.contains("(the first of 40 such warnings)"),
        "{words}"
    );
}
