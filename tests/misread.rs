//! Numbers that would be read as others, and instruments that say nothing.

use std::fs;
use std::path::{Path, PathBuf};

use abbe_core::Error;
use abbe_engine::{Planned, prepare};
use serde_json::json;

use crate::support::{Variant, abbe, read, recipes, registry, temporary};

fn checked(recipe: &Variant, folder: &Path) -> Result<Vec<Planned>, Error> {
    prepare(&recipe.write(folder), &registry())?.check()
}

/// A copy of a CSV file in a folder with a change of the cells of a column.
fn changed(file: &Path, folder: &Path, column: &str, change: impl Fn(usize, &str) -> String) -> PathBuf {
    let text = read(file);
    let (mut place, mut row) = (None, 0);
    let lines = text.lines().map(|line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if !line.starts_with('#') {
            match place {
                None => place = Some(cells.iter().position(|cell| cell == column).expect("the column")),
                Some(place) => {
                    cells[place] = change(row, &cells[place]);
                    row += 1;
                }
            }
        }
        cells.join(",") + "\n"
    });
    let copy = folder.join(file.file_name().expect("a name"));
    fs::write(&copy, lines.collect::<String>()).expect("a file");
    copy
}

/// With a decimal comma a list gets longer; what is too much is not forgotten.
#[test]
fn lists_that_are_too_long_are_refused() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles"]);
    let machine = recipe.stage("mill");
    machine["styli"] = json!({ "2": { "tip_mm": [0, -35, 0, -130, 0] } });
    let error = checked(&recipe, folder.path()).expect_err("it is refused");
    let said = format!("{} {}", error.message, error.help.unwrap_or_default());
    assert!(said.contains("a list of 5 items") && said.contains("decimals are written with a point"), "{said}");
    for (stage, setting, value) in [
        ("c600u", "tool", json!({ "probe_offset_mm": [0, 0, 1, 2] })),
        ("c600u", "axes", json!({ "A": { "point_mm": [0, 0, 25, 0] } })),
        ("c600u", "axes", json!({ "X": { "range_mm": [0, 500, 1] } })),
        ("c600u", "axes", json!({ "X": { "range_mm": [0, 500, "x"] } })),
    ] {
        let mut recipe = Variant::of(&recipes()["ballbar-c600u"]);
        match setting {
            "tool" => recipe.stage(stage)["probe_offset_mm"] = value["probe_offset_mm"].clone(),
            _ => recipe.stage(stage)[setting] = value.clone(),
        }
        let error = checked(&recipe, folder.path()).err().unwrap_or_else(|| panic!("{value} passes"));
        assert!(error.message.contains("items"), "{value}: {}", error.message);
    }
}

/// A ball bar that was not connected, and one file of a laser.
#[test]
fn an_instrument_that_says_nothing_is_told() {
    for (name, stage, at, column) in
        [("ballbar-c600u", "samples", "tests", "reading_um"), ("mill-direct", "length-files", "path", "reading_um")]
    {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()[name]);
        let remarks = |recipe: &Variant| -> Vec<String> {
            let planned = checked(recipe, folder.path()).expect("a plan");
            planned.into_iter().flat_map(|planned| planned.identifiability.remarks).collect()
        };
        let is_told =
            |remarks: &[String]| remarks.iter().any(|remark| remark.contains("was the instrument connected?"));
        assert!(!is_told(&remarks(&recipe)));
        let list = recipe.stage(stage)[at].as_array().expect("a list").clone();
        let place = list
            .iter()
            .position(|one| {
                one.as_str()
                    .or(one["file"].as_str())
                    .is_some_and(|file| file.ends_with("EXY.csv") || file.ends_with("ballbar-a.csv"))
            })
            .expect("the file");
        let file = list[place].as_str().or(list[place]["file"].as_str()).expect("a path");
        let silent = changed(Path::new(file), folder.path(), column, |_, _| "0.0".to_owned());
        match list[place].is_string() {
            true => recipe.stage(stage)[at][place] = json!(silent),
            false => recipe.stage(stage)[at][place]["file"] = json!(silent),
        }
        let remarks = remarks(&recipe);
        assert!(is_told(&remarks), "{name}: {remarks:?}");
    }
}

/// Loads are weights.
#[test]
fn negative_loads_are_refused() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles"]);
    let file = recipe.path("table-files", "path");
    let negative = changed(
        &file,
        folder.path(),
        "load_N",
        |row, cell| if row == 1 { format!("-{cell}") } else { cell.to_owned() },
    );
    recipe.stage("table-files")["path"] = json!(negative);
    let error = checked(&recipe, folder.path()).expect_err("it is refused");
    assert!(error.to_string().contains("a load of -1750 N"), "{error}");
}

fn warming() -> Variant {
    Variant::of(&recipes()["tango-warming"]).only(&["fit"])
}

#[test]
fn temperatures_in_kelvin_and_those_of_two_places_are_refused() {
    let folder = temporary();
    let mut recipe = warming();
    recipe.stage("hu40t")["errors"][5] =
        json!({ "thermal": ["EA0B"], "at_once": ["T_column"], "reference_degC": 293.15 });
    let error = checked(&recipe, folder.path()).expect_err("it is refused");
    assert!(error.message.contains("from -100 to 200 °C"), "{error}");
    // Touches that have the column of the log.
    let mut recipe = warming();
    let text = read(&recipe.path("touches", "path"));
    let mut is_head = true;
    let rows = text.lines().map(|line| match (line.starts_with('#'), std::mem::take(&mut is_head)) {
        (true, head) => {
            is_head = head;
            format!("{line}\n")
        }
        (false, true) => format!("{line},T_column_degC\n"),
        (false, false) => format!("{line},25.0\n"),
    });
    let touches = folder.path().join("touches.csv");
    fs::write(&touches, rows.collect::<String>()).expect("a file");
    recipe.stage("touches")["path"] = json!(touches);
    let error = checked(&recipe, folder.path()).expect_err("it is refused");
    assert!(error.message.contains("`T_column` of their own, and so has the log"), "{error}");
}

#[test]
fn sensors_with_faults_are_told() {
    type Change = fn(usize, &str) -> String;
    let spike: Change = |row, cell| if row == 5 { "85.0".to_owned() } else { cell.to_owned() };
    let stuck: Change = |row, cell| if row > 20 { "21.0".to_owned() } else { cell.to_owned() };
    let right: Change = |_, cell| cell.to_owned();
    for (change, expected) in [(spike, "jumps by"), (stuck, "was it stuck?"), (right, "")] {
        let folder = temporary();
        let mut recipe = warming();
        let log = changed(&recipe.path("sensors", "path"), folder.path(), "T_column_degC", change);
        recipe.stage("sensors")["path"] = json!(log);
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
        match expected {
            "" => assert!(!printed.stderr.contains("T_column"), "{}", printed.stderr),
            _ => assert!(printed.stderr.contains(expected), "{expected}: {}", printed.stderr),
        }
    }
}
