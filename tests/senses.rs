//! Senses, zeros and ranges that fit as well as the truth, or that nobody can mean.

use std::path::Path;

use serde_json::{Value, json};

use crate::misread::changed;
use crate::support::{Printed, Variant, abbe, recipes, temporary};

fn run(recipe: &Variant, folder: &Path) -> Printed {
    let file = recipe.write(folder);
    abbe(folder, &["run".as_ref(), file.as_os_str(), "--out".as_ref(), folder.join("out").as_os_str()])
}

/// What a recipe says with other settings: of a stage, by a pointer.
fn said(name: &str, stage: &str, pointer: &str, value: Value) -> (i32, String) {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()[name]);
    let (map, key) = pointer.rsplit_once('/').expect("a pointer");
    recipe.stage(stage).pointer_mut(map).expect("the map")[key] = value;
    let printed = run(&recipe, folder.path());
    (printed.status, printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" "))
}

/// The same with another column in the file of an ingest stage.
fn measured(name: &str, stage: &str, columns: &[&str], change: impl Fn(usize, f64) -> f64) -> (i32, String) {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()[name]);
    let mut file = recipe.path(stage, "path");
    for (index, column) in columns.iter().enumerate() {
        let own = folder.path().join(format!("{index}"));
        std::fs::create_dir(&own).expect("a folder");
        file = changed(&file, &own, column, |row, cell| format!("{}", change(row, cell.parse().expect("a number"))));
    }
    recipe.stage(stage)["path"] = json!(file);
    let printed = run(&recipe, folder.path());
    (printed.status, printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" "))
}

#[test]
fn both_set_ups_of_a_reversal_turn_in_one_sense() {
    let (status, text) = measured("spindle-motion", "after", &["S_deg"], |_, angle| -angle);
    assert_eq!(status, 1, "{text}");
    assert!(text.contains("the angle of the spindle falls in one set-up and grows in the other"), "{text}");
}

#[test]
fn a_temperature_that_stops_in_a_warm_up_is_told() {
    let stop = |row: usize, value: f64| if row > 80 { 35.0 } else { value };
    let (_, text) = measured("spindle-motion", "half-hour", &["T02_degC"], stop);
    assert!(text.contains("T02 reads the same from row 82 to row 181"), "{text}");
}

#[test]
fn feeds_that_no_touch_has_are_refused() {
    for (factor, found) in [(-1.0, "a feed of -30 mm/min"), (0.0, "a feed of 0 mm/min"), (1e6, "a feed of 3")] {
        let (status, text) = measured("probe-lobing", "sphere-touches", &["feed_mm_per_min"], |_, feed| factor * feed);
        assert_eq!(status, 1, "{text}");
        assert!(text.contains(found) && text.contains("touches-lobing.csv:2:1"), "{text}");
    }
    for (value, expected) in [(json!([1e12]), "to 100000 was expected"), (json!([30, 30]), "30 is there twice")] {
        let (status, text) = said("probe-lobing", "radii", "/feeds_mm_per_min", value);
        assert!(status == 2 && text.contains(expected), "{text}");
    }
}

#[test]
fn a_ring_into_which_the_stylus_does_not_go_is_refused() {
    for diameter in ["5", "6"] {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["probe-lobing"]);
        let file = recipe.path("ring", "nominal");
        recipe.stage("ring")["nominal"] =
            json!(changed(&file, folder.path(), "diameter_mm", |_, _| diameter.to_owned()));
        let printed = run(&recipe, folder.path());
        assert!(printed.status == 1 && printed.stderr.contains("it does not go in"), "{}", printed.stderr);
        assert!(printed.stderr.contains("rings.csv:2:1"), "{}", printed.stderr);
    }
}

#[test]
fn directions_that_are_all_turned_are_told() {
    let all = ["dir_X", "dir_Y", "dir_Z", "dir_B", "dir_C"];
    for (columns, is_told) in [(&all[..], true), (&all[..1], true), (&[][..], false)] {
        let (_, text) = measured("first-steps", "touches", columns, |_, direction| -direction);
        assert_eq!(text.contains("touches lead away from the surface by `dir_X`"), is_told, "{text}");
    }
}

#[test]
fn a_rotary_axis_that_is_off_by_an_angle_is_told() {
    for (degrees, words) in [
        (-1.0, "with C at +1.0"),
        (2.0, "with C at -1.9"),
        (1.0, "with C at -0.9"),
        (-0.5, "with C at +0.5"),
        (0.5, "with C at -0.4"),
        (0.0, ""),
    ] {
        let (_, text) = measured("first-steps", "touches", &["C_deg"], |_, angle| angle + degrees);
        assert_eq!(text.contains("from where it is said to stand"), degrees != 0.0, "{degrees}: {text}");
        assert!(text.contains(words), "{text}");
    }
}

#[test]
fn numbers_that_nobody_means_are_refused() {
    for (recipe, stage, pointer, value, expected) in [
        ("tool-check", "tools", "/spoiled_factor", json!(1e9), "a number from 1 to 100"),
        ("tool-check", "tools", "/consistency_factor", json!(1e-300), "a number from 1 to 100"),
        ("thermal-spindle", "spindle", "/draws", json!(1_000_000_000), "a whole number from 50 to 100000"),
        ("thermal-spindle", "spindle", "/draws", json!(1), "a whole number from 50 to 100000"),
        ("thermal-spindle", "unseen", "/prediction/limits/max_um", json!(5e9), "a number from -1e6 to 1e6"),
        ("spindle-motion", "spindle", "/limits/synchronous_rotating_um", json!(1e9), "a number from -1e6 to 1e6"),
        ("probe-lobing", "probing", "/limits/corrected_form_um", json!({ "limit": 1e9 }), "a number from -1e6 to 1e6"),
    ] {
        let (status, text) = said(recipe, stage, pointer, value);
        assert!(status == 2 && text.contains(expected), "{stage}{pointer}: {status} {text}");
    }
}

#[test]
fn numbers_that_a_control_does_not_have_are_refused() {
    for (control, number) in [("linuxcnc", 100_000), ("fanuc", 1000), ("siemens", 32_001), ("heidenhain", 32_768)] {
        let (status, text) = said("tool-check", control, "/numbers", json!({ "1": number }));
        assert!(status != 0 && text.contains(&format!("tool `1`: {number}; the control has numbers")), "{text}");
        let (status, text) = said("tool-check", control, "/numbers", json!({ "1": number - 1 }));
        assert_eq!(status, 0, "{text}");
    }
}

#[test]
fn offsets_beyond_the_range_of_a_control_are_refused() {
    for control in ["fanuc", "heidenhain", "siemens"] {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["tool-check"]);
        let table = recipe.path("tools", "table");
        // Tools that are longer than their preset have no lock.
        let shorter = |_: usize, length: &str| format!("{}", length.parse::<f64>().expect("a length") * 0.3);
        recipe.stage("tools")["table"] = json!(changed(&table, folder.path(), "length_mm", shorter));
        let printed = run(&recipe.only(&["log", "tools", control]), folder.path());
        let text = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        let is_refused = text.contains("wear of the length of 106.") && text.contains("less than 100 mm");
        assert_eq!(is_refused, control != "siemens", "{control}: {text}");
    }
}

#[test]
fn a_log_of_tools_whose_temperature_or_minutes_never_change_is_told() {
    for (column, words) in [("spindle_degC", "was the sensor connected?"), ("cutting_min", "no rate of wear follows")] {
        let (_, text) = measured("tool-check", "log", &[column], |_, _| 20.0);
        assert!(text.contains(words), "{text}");
    }
}
