//! Mistakes that readings, columns or plain physics contradict although every limit is kept.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::misread::changed;
use crate::support::{Variant, abbe, read, recipes, registry, temporary, write};

/// Remarks and failures of a run, those of verdicts included, or its error, in one text.
pub(crate) fn said(recipe: &Variant) -> String {
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

/// A copy of a file with two columns exchanged, in `folder`.
pub(crate) fn exchanged(file: &Path, folder: &Path, one: &str, other: &str) -> PathBuf {
    let text = read(file);
    let header = text.lines().find(|line| !line.starts_with('#')).expect("a header");
    let place = |name: &str| header.split(',').position(|own| own == name).expect("a column");
    let (one, other) = (place(one), place(other));
    let line = |line: &str| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if !line.starts_with('#') && line != header {
            cells.swap(one, other);
        }
        cells.join(",")
    };
    let path = folder.join("exchanged.csv");
    write(&path, &(text.lines().map(line).collect::<Vec<_>>().join("\n") + "\n"));
    path
}

#[test]
fn a_channel_in_another_unit_is_told() {
    let recipe = Variant::of(&recipes()["standards-rtest"]);
    let words = "is the unit of this channel right";
    assert!(!said(&recipe).contains(words));
    for (stage, column) in [("a-turns", "meas_z_um"), ("a-turns", "meas_y_um"), ("c-turns", "meas_x_um")] {
        for factor in [1.0 / 25.4, 1e-3] {
            let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["standards-rtest"]));
            let file = recipe.path(stage, "path");
            recipe.stage(stage)["path"] = json!(changed(&file, folder.path(), column, times(factor)));
            let said = said(&recipe);
            let is_told = said.contains(words) && said.contains(&format!("`{}`", column.trim_end_matches("_um")));
            assert!(is_told, "{stage} {column} {factor}: {said}");
        }
    }
    // Two of three: the one that is left says what is usual. What couples it with one of them hides that one.
    let mut told = 0;
    for stage in ["a-turns", "c-turns"] {
        for pair in [["meas_x_um", "meas_y_um"], ["meas_y_um", "meas_z_um"], ["meas_x_um", "meas_z_um"]] {
            for factor in [1.0 / 25.4, 1e-3] {
                let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["standards-rtest"]));
                let mut file = recipe.path(stage, "path");
                for column in pair {
                    file = changed(&file, folder.path(), column, times(factor));
                }
                recipe.stage(stage)["path"] = json!(file);
                let said = said(&recipe);
                let is_named = |column: &&str| said.contains(&format!("`{}` of", column.trim_end_matches("_um")));
                let named = ["meas_x_um", "meas_y_um", "meas_z_um"].into_iter().filter(&is_named);
                assert!(named.clone().all(|column| pair.contains(&column)), "{stage} {pair:?} {factor}: {said}");
                told += usize::from(named.count() > 0);
            }
        }
    }
    assert!(told >= 10, "{told} of 12");
    // A warm-up has no model that tells; its noise does.
    let mut recipe = Variant::of(&recipes()["spindle-motion"]);
    let file = recipe.path("half-hour", "path");
    for column in ["drift_x_um", "drift_y_um", "drift_z_um"] {
        let folder = temporary();
        recipe.stage("half-hour")["path"] = json!(changed(&file, folder.path(), column, times(1.0 / 25.4)));
        assert!(said(&recipe).contains(&format!("{} scatters", column.trim_end_matches("_um"))), "{column}");
    }
}

#[test]
fn exchanged_sensors_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["spindle-motion"]);
    let words = |recipe: &Variant| said(recipe).contains("exchanged?");
    assert!(!words(&recipe));
    let file = recipe.path("half-hour", "path");
    for (one, other) in [("T01_degC", "T02_degC"), ("T03_degC", "T04_degC")] {
        recipe.stage("half-hour")["path"] = json!(exchanged(&file, folder.path(), one, other));
        assert!(words(&recipe), "{one} {other}");
    }
    let mut recipe = Variant::of(&recipes()["mill-warming"]).only(&["fit"]);
    let both = |recipe: &Variant| said(recipe).contains("C11 and C31 exchanged");
    assert!(!said(&recipe).contains("are these two sensors exchanged"));
    recipe.stage("sensors")["path"] =
        json!(exchanged(&recipe.path("sensors", "path"), folder.path(), "C11_degC", "C31_degC"));
    assert!(both(&recipe), "{}", said(&recipe));
}

#[test]
fn diagonals_of_another_sign_are_told() {
    let recipe = || Variant::of(&recipes()["standards-diagonals"]);
    let is_told = |recipe: &Variant, words: &str| said(recipe).contains(words);
    let [of_file, of_rows] = ["its lost motion is", "is the sign of a part of the rows wrong"];
    assert!(!is_told(&recipe(), of_file) && !is_told(&recipe(), of_rows));
    let mut found = 0;
    for stage in ["ppp", "npp", "pnp", "nnp", "xy-pp", "xy-np", "yz-pp", "yz-np", "zx-pp", "zx-np"] {
        let (folder, mut recipe) = (temporary(), recipe());
        let file = recipe.path(stage, "path");
        recipe.stage(stage)["path"] = json!(changed(&file, folder.path(), "reading_um", times(-1.0)));
        // Along faces the lost motion of this machine is small.
        assert!(stage.contains('-') || is_told(&recipe, of_file), "{stage}");
        let rows = read(&file).lines().filter(|line| !line.starts_with('#')).count() - 1;
        let half = |row: usize, cell: &str| if 2 * row < rows { cell.to_owned() } else { times(-1.0)(row, cell) };
        recipe.stage(stage)["path"] = json!(changed(&file, folder.path(), "reading_um", half));
        found += usize::from(is_told(&recipe, of_rows));
    }
    // Where errors are hardly larger than they scatter, nothing tells.
    assert!(found >= 8, "{found} of 10");
}

/// An indexation of the spindle that a file gets wrong shows in its rows alone, and robust weights hide them.
#[test]
fn wrong_positions_of_an_axis_are_told_where_their_rows_stand_apart() {
    let file = Variant::of(&recipes()["first-steps"]).path("touches", "path");
    let words = "is the column of S right";
    assert!(!said(&Variant::of(&recipes()["first-steps"])).contains(words));
    let number = |cell: &str| cell.parse::<f64>().expect("a number");
    for case in 0..2 {
        let change = |row: usize, cell: &str| match (case, number(cell)) {
            (0, 0.0) => cell.to_owned(),
            (0, s) => format!("{}", s + 10.0),
            (_, s) => format!("{}", s + if row > 200 { 90.0 } else { 0.0 }),
        };
        let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["first-steps"]));
        recipe.stage("touches")["path"] = json!(changed(&file, folder.path(), "S_deg", change));
        assert!(said(&recipe).contains(words), "{case}: {}", said(&recipe));
    }
}

#[test]
fn copied_poses_are_told_whatever_their_label() {
    let recipe = Variant::of(&recipes()["positioner"]);
    let words = "have the numbers of earlier ones to the last digit";
    assert!(!said(&recipe).contains(words));
    let file = recipe.path("seen", "path");
    let text = read(&file);
    for label in ["week", "run", "group", "series"] {
        let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["positioner"]));
        let rows = |number: usize| text.lines().skip(1).map(move |line| format!("{line},{number}"));
        let header = format!("{},{label}", text.lines().next().expect("a header"));
        let all: Vec<String> = std::iter::once(header).chain(rows(1)).chain(rows(2)).collect();
        let copy = folder.path().join("copied.csv");
        write(&copy, &(all.join("\n") + "\n"));
        recipe.stage("seen")["path"] = json!(copy);
        assert!(said(&recipe).contains(words), "{label}: {}", said(&recipe));
    }
}

#[test]
fn copied_rows_of_a_simulation_are_told_with_their_readers() {
    let folder = temporary();
    let recipe = recipes()["standards-ball-bar"].clone();
    let truth = folder.path().join("truth.json");
    write(&truth, r#"{ "parameters": {}, "noise": { "probing_sigma_mm": 0.0006 } }"#);
    let out = folder.path().join("simulated");
    let options = ["--seed".as_ref(), "1".as_ref(), "--out".as_ref(), out.as_os_str()];
    let arguments = ["simulate".as_ref(), recipe.as_os_str(), "--truth".as_ref(), truth.as_os_str()];
    let printed = abbe(folder.path(), &[&arguments[..], &options].concat());
    assert!(printed.stdout.contains("as they were") && printed.stdout.contains("figures"), "{}", printed.stdout);
}

/// What is said of an estimate before it is made.
fn remarks(recipe: &Variant) -> Vec<String> {
    let folder = temporary();
    let planned = abbe_engine::prepare(&recipe.write(folder.path()), &registry()).and_then(|prepared| prepared.check());
    let planned = planned.unwrap_or_else(|error| panic!("{error}"));
    planned.into_iter().flat_map(|planned| planned.identifiability.remarks).collect()
}

/// Positions of a plan that nobody has replaced by measured ones say that a machine has no errors. A plan as a whole, and data without
/// noise, get no word.
#[test]
fn rows_that_were_planned_and_not_measured_are_told() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["first-steps"]);
    let simulated = |truth: serde_json::Value, name: &str| {
        let (own, file, out) = (folder.path(), recipe.write(folder.path()), folder.path().join(name));
        let path = own.join("truth.json");
        write(&path, &truth.to_string());
        let arguments = ["simulate".as_ref(), file.as_os_str(), "--truth".as_ref(), path.as_os_str()];
        let more = ["--seed".as_ref(), "1".as_ref(), "--out".as_ref(), out.as_os_str()];
        let printed = abbe(own, &[&arguments[..], &more[..]].concat());
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        Variant::of(&out.join("recipe.yaml"))
    };
    let planned = simulated(json!({ "parameters": {} }), "planned");
    let lines = |recipe: &Variant| -> Vec<String> {
        let text = read(&recipe.path("touches", "path"));
        text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect()
    };
    let (measured, of_plan) = (lines(&recipe), lines(&planned));
    assert_eq!(measured.len(), of_plan.len());
    let word = "or are they positions of a plan?";
    let with = |part: f64| {
        // Some of the rows, evenly spread.
        let taken = |row: usize| (row as f64 * part).floor() < ((row + 1) as f64 * part).floor();
        let rows = (0..measured.len()).map(|row| if taken(row) { of_plan[row].clone() } else { measured[row].clone() });
        let file = folder.path().join("touches.csv");
        write(&file, &(rows.collect::<Vec<_>>().join("\n") + "\n"));
        recipe.clone().set("touches", "path", json!(file))
    };
    for part in [0.0, 0.1, 0.2, 0.7, 1.0] {
        let told = remarks(&with(part));
        let is_told = told.iter().any(|remark| remark.contains(word));
        assert_eq!(is_told, part > 0.0 && part < 1.0, "{part}: {told:?}");
    }
    assert!(said(&with(0.2)).contains(word));
    // A machine on which one error alone acts on some rows.
    let partly = simulated(json!({ "parameters": { "facet[7].d": 0.1, "facet[9].d": -0.2 } }), "partly");
    let told = remarks(&partly);
    assert!(!told.iter().any(|remark| remark.contains(word)), "{told:?}");
}

/// A channel of an R-test, and one of two files of a ball bar on one circle, whose signs are turned.
#[test]
fn signs_of_some_readings_that_are_turned_are_told() {
    let word = "is the sign of these readings right?";
    let is_told = |recipe: &Variant, which: &str| {
        let told = remarks(recipe);
        let about: Vec<&String> = told.iter().filter(|remark| remark.contains(word)).collect();
        match which {
            "" => assert!(about.is_empty(), "{about:?}"),
            _ => assert!(about.iter().any(|remark| remark.contains(which)), "{which}: {told:?}"),
        }
    };
    for name in ["standards-rtest", "standards-rtest-exact"] {
        let recipe = Variant::of(&recipes()[name]);
        is_told(&recipe, "");
        // The fewer readings of A tell where they are exact.
        let sets = [("c-turns", "at-c"), ("a-turns", "at-a")];
        for (stage, set) in sets.into_iter().take(if name.ends_with("exact") { 2 } else { 1 }) {
            for column in ["meas_x", "meas_y", "meas_z"] {
                // The axis that turns moves nothing along itself: zero has no sign.
                if (stage, column) == ("c-turns", "meas_z") || (stage, column) == ("a-turns", "meas_x") {
                    continue;
                }
                let folder = temporary();
                let mut recipe = recipe.clone();
                let path = recipe.path(stage, "path");
                recipe.stage(stage)["path"] =
                    json!(changed(&path, folder.path(), &format!("{column}_um"), times(-1.0)));
                // Where C turns, x and y tell no more than that one of them is.
                is_told(&recipe, &format!("{set}: with the signs of "));
                is_told(&recipe, &format!("of `{column}`"));
            }
        }
    }
    let recipe = Variant::of(&recipes()["standards-ball-bar"]).only(&["fit"]);
    is_told(&recipe, "");
    for place in 0..2 {
        let (folder, mut recipe) = (temporary(), recipe.clone());
        let path = PathBuf::from(recipe.stage("circles")["path"][place].as_str().expect("a path"));
        let file = changed(&path, folder.path(), "reading_um", times(-1.0));
        recipe.stage("circles")["path"][place] = json!(file);
        is_told(&recipe, &format!("readings in `{}`", file.display()));
    }
}

/// Two axes of a CMM whose columns are exchanged at both ends of all lengths.
#[test]
fn columns_of_two_axes_that_are_exchanged_are_told() {
    let word = "are these two columns exchanged?";
    for name in ["cmm-brute-force", "mill-hole-plate", "mill-hole-plate-exact"] {
        let told = remarks(&Variant::of(&recipes()[name]));
        assert!(!told.iter().any(|remark| remark.contains(word)), "{name}: {told:?}");
    }
    let recipe = Variant::of(&recipes()["cmm-brute-force"]).only(&["fit"]);
    for [one, other] in [["X", "Y"], ["Y", "Z"]] {
        let folder = temporary();
        let exchanged = read(&recipe.path("beams", "path"));
        let name = |axis: &str, end: usize| format!("{axis}{end}_mm");
        let swapped = [1, 2].into_iter().fold(exchanged, |text, end| {
            let (first, second) = (name(one, end), name(other, end));
            text.replacen(&first, "@", 1).replacen(&second, &first, 1).replacen('@', &second, 1)
        });
        let file = folder.path().join("lengths.csv");
        write(&file, &swapped);
        let mut recipe = recipe.clone().set("beams", "path", json!(file));
        // The travels of the axes differ: without them nothing else tells.
        recipe.stage("cmm")["axes"] = json!({ "X": { "range_mm": [-2000, 2000] }, "Y": { "range_mm": [-2000, 2000] }, "Z": { "range_mm": [-2000, 2000] } });
        let told = remarks(&recipe);
        let expected = [[one, other], [other, one]]
            .map(|[one, other]| format!("with the positions of {one} and {other} exchanged"));
        let is_told = told.iter().any(|remark| expected.iter().any(|expected| remark.contains(expected)));
        assert!(is_told, "{one} {other}: {told:?}");
    }
}

/// What a fit of changed rows is told of.
fn told_of(recipe: &str, stage: &str, change: impl Fn(&Path, &Path) -> PathBuf) -> String {
    let (folder, mut recipe) = (temporary(), Variant::of(&recipes()[recipe]));
    let file = recipe.path(stage, "path");
    recipe.stage(stage)["path"] = json!(change(&file, folder.path()));
    said(&recipe)
}

/// All limits are kept, and the scale of Y is off by 100 standard uncertainties.
#[test]
fn channels_that_are_exchanged_are_told() {
    let words = "are these columns exchanged?";
    for recipe in ["standards-rtest", "standards-rtest-exact"] {
        assert!(!said(&Variant::of(&recipes()[recipe])).contains(words), "{recipe}");
        let told = told_of(recipe, "c-turns", |file, folder| exchanged(file, folder, "meas_x_um", "meas_y_um"));
        assert!(told.contains("with `meas_x`, `meas_y` exchanged") && told.contains(words), "{recipe}: {told}");
    }
}

#[test]
fn a_minus_that_is_lost_in_half_of_the_rows_is_told() {
    let words = "is their minus lost?";
    let abs = |from: usize| {
        move |row: usize, cell: &str| {
            if row >= from { cell.trim_start_matches('-').to_owned() } else { cell.to_owned() }
        }
    };
    assert!(!said(&Variant::of(&recipes()["standards-rtest"])).contains(words));
    let told = told_of("standards-rtest", "c-turns", |file, folder| changed(file, folder, "meas_z_um", abs(25)));
    assert!(told.contains("of `meas_z`") && told.contains(words), "{told}");
}

#[test]
fn degrees_and_minutes_for_decimal_degrees_are_told() {
    let words = "are these degrees and minutes?";
    let minutes = |_: usize, cell: &str| {
        let angle: f64 = cell.parse().expect("an angle");
        let seconds = (angle.abs() * 3600.0).floor() as u64;
        let decimal = format!("{}.{:02}{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60);
        if angle < 0.0 { format!("-{decimal}") } else { decimal }
    };
    let recipe = Variant::of(&recipes()["ballbar-c600u"]).only(&["fit"]);
    assert!(!said(&recipe).contains(words));
    for test in [0, 1] {
        let (folder, mut recipe) = (temporary(), recipe.clone());
        let file = PathBuf::from(recipe.stage("samples")["tests"][test]["file"].as_str().expect("a path"));
        recipe.stage("samples")["tests"][test]["file"] = json!(changed(&file, folder.path(), "A_deg", minutes));
        assert!(said(&recipe).contains(words), "{test}");
    }
}

/// The last cell of a file that was cut off: a position that is 0.9 mm or 320 mm off.
#[test]
fn a_row_that_was_cut_off_is_named() {
    for (kept, is_refused) in [(3, false), (1, true)] {
        let cut = |row: usize, cell: &str| if row == 149 { cell[..kept].to_owned() } else { cell.to_owned() };
        let told = told_of("robot-ur5", "poses", |file, folder| changed(file, folder, "z_mm", cut));
        assert!(told.contains("poses.csv:151 the residuals scatter"), "{told}");
        assert!(!told.contains("probe_offset_mm"), "{told}");
        assert_eq!(told.contains("no machine has such errors"), is_refused, "{told}");
    }
    assert!(!said(&Variant::of(&recipes()["robot-ur5"])).contains("times as much: is it right?"));
}

/// What an artefact is off by is no length of a stylus.
#[test]
fn a_place_with_the_other_sign_is_named() {
    let told = {
        let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["mfb-ucp710"]).only(&["fit-sphere"]));
        let file = recipe.path("sphere-once", "nominal");
        recipe.stage("sphere-once")["nominal"] = json!(changed(&file, folder.path(), "x_mm", times(-1.0)));
        said(&recipe)
    };
    assert!(!told.contains("styli.3"), "{told}");
    assert!(told.contains("twice, as with a wrong sign of, `nominal x of 1 in sphere-once` (-148 mm)"), "{told}");
}

#[test]
fn new_rows_whose_uncertainties_would_hide_any_change_are_told() {
    let is_told = |recipe: &Variant| said(recipe).contains("are off what is known by");
    let mut recipe = Variant::of(&recipes()["tango-warming-retrain"]);
    assert!(!is_told(&recipe));
    recipe.stage("ball-friday")["standard_uncertainty_um"] = json!(800);
    assert!(is_told(&recipe));
}
