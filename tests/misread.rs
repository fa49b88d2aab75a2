//! Numbers that would be read as others, and instruments that say nothing.

use std::fs;
use std::path::{Path, PathBuf};

use abbe_core::Error;
use abbe_engine::{Planned, prepare};
use serde_json::json;

use crate::support::{Small, Variant, abbe, read, recipes, registry, temporary};

fn checked(recipe: &Variant, folder: &Path) -> Result<Vec<Planned>, Error> {
    prepare(&recipe.write(folder), &registry())?.check()
}

/// A copy of a CSV file in a folder with a change of the cells of a column.
pub(crate) fn changed(file: &Path, folder: &Path, column: &str, change: impl Fn(usize, &str) -> String) -> PathBuf {
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

/// Temperatures in °F and times in minutes that are called °C and s can be read; they are told, and nothing is told of what is right.
#[test]
fn fahrenheit_and_minutes_under_other_names_are_told() {
    let fahrenheit = |cell: &str| format!("{:.3}", 32.0 + 1.8 * cell.parse::<f64>().expect("a temperature"));
    let minutes = |cell: &str| format!("{:.4}", cell.parse::<f64>().expect("a time") / 60.0);
    let told = |change: &dyn Fn(&mut Variant, &Path)| {
        let folder = temporary();
        let mut recipe = warming();
        change(&mut recipe, folder.path());
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        printed.stderr
    };
    let sensors = |columns: &'static [&'static str]| {
        move |recipe: &mut Variant, folder: &Path| {
            for column in columns {
                let log = changed(&recipe.path("sensors", "path"), folder, column, |_, cell| fahrenheit(cell));
                let kept = folder.join(format!("{column}.csv"));
                fs::rename(log, &kept).expect("moved");
                recipe.stage("sensors")["path"] = json!(kept);
            }
        }
    };
    let all = told(&sensors(&["T_scale_degC", "T_column_degC"]));
    assert!(all.contains("sensors: all temperatures begin from 68.0 to 68.0"), "{all}");
    assert!(all.contains("68.0 °F are 20.0 °C"), "{all}");
    let one = told(&sensors(&["T_column_degC"]));
    assert!(one.contains("sensors: T_column begins at 68.0 °C, and the other temperatures at 20.0 °C"), "{one}");
    let in_minutes = told(&|recipe: &mut Variant, folder: &Path| {
        let touches = changed(&recipe.path("touches", "path"), folder, "time_s", |_, cell| minutes(cell));
        recipe.stage("touches")["path"] = json!(touches);
    });
    assert!(
        in_minutes.contains("touches: the times of its rows, 0.7 s to 165.7 s, lie in the first minutes"),
        "{in_minutes}"
    );
    let right = told(&|_: &mut Variant, _: &Path| ());
    assert!(!right.contains("°F") && !right.contains("minutes"), "{right}");
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

/// A drift sensor that is not connected moves by nothing, and keeps every limit.
#[test]
fn drift_sensors_that_stand_still_are_told() {
    let folder = temporary();
    let source = crate::support::root().join("pipelines/data/spindle-motion/realistic/thermal-warmup.csv");
    let judged = |log: &Path, readings: [&str; 2], judge: bool| {
        let mut stages = json!({ "log": { "ingest": "csv", "path": log } });
        match judge {
            true => {
                stages["warm-up"] = json!({ "estimate": "spindle-warm-up", "from": "log", "drift": readings });
                stages["spindle"] =
                    json!({ "validate": "spindle", "of": "warm-up", "limits": { "warm_up_range_um": 40 } });
            }
            false => {
                stages["iso"] = json!({ "validate": "thermal", "from": "log", "drift": { "readings": readings, "limits": { "range_um": 40 } } });
            }
        }
        let recipe = Variant(json!({ "abbe": 1, "name": "warm-up", "stages": stages }));
        let file = recipe.write(folder.path());
        let out = folder.path().join("out");
        abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()])
    };
    for (column, value) in [("drift_x_um", "0"), ("drift_z_um", "12.125"), ("drift_x_um", "1e-310")] {
        let dead = changed(&source, folder.path(), column, |_, _| value.to_owned());
        for judge in [true, false] {
            let printed = judged(&dead, ["drift_x", "drift_z"], judge);
            assert!(printed.stderr.contains("is the sensor connected"), "{column} = {value}: {}", printed.stderr);
            assert_ne!(printed.status, 0, "{}", printed.stdout);
        }
    }
    let stuck = changed(
        &source,
        folder.path(),
        "drift_z_um",
        |row, cell| if row > 8 { "1.2".to_owned() } else { cell.to_owned() },
    );
    for judge in [true, false] {
        let printed = judged(&stuck, ["drift_x", "drift_z"], judge);
        assert!((printed.stdout.clone() + &printed.stderr).contains("was it stuck?"), "{}", printed.stderr);
        let printed = judged(&source, ["drift_x", "drift_z"], judge);
        assert!(!(printed.stdout + &printed.stderr).contains("was it stuck?"));
    }
}

/// Limits, times and settings that no tool and no control has.
#[test]
fn absurd_settings_are_refused() {
    let folder = temporary();
    let told = |recipe: &Variant| match checked(recipe, folder.path()) {
        Ok(_) => {
            let file = recipe.write(folder.path());
            let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()]);
            printed.stderr
        }
        Err(error) => error.to_string(),
    };
    let tools = || Variant::of(&recipes()["tool-check"]);
    let stage = {
        let recipe = tools();
        let stages = recipe.0["stages"].as_object().expect("stages");
        stages
            .iter()
            .find(|(_, stage)| stage.get("limits").is_some_and(|limits| limits.get("breakage_um").is_some()))
            .expect("a stage")
            .0
            .clone()
    };
    for (path, value, expected) in [
        (vec!["limits", "breakage_um"], json!(5e5), " to 10000 was"),
        (vec!["limits", "chip_um"], json!(25000), " to 10000 was"),
        (vec!["limits", "match_um"], json!(1e6), " to 10000 was"),
        (vec!["master_limit_um"], json!(1e6), " to 1000 was"),
        (vec!["temperature_limit_K"], json!(1e3), " to 100 was"),
        (vec!["coverage_factor"], json!(1e-300), "from 1 to 10"),
        (vec!["master", "standard_uncertainty_um"], json!(1e300), "from 1e-6 to 1e6"),
    ] {
        let mut recipe = tools();
        let mut at = recipe.stage(&stage);
        for key in &path {
            at = &mut at[*key];
        }
        *at = value.clone();
        let told = told(&recipe);
        assert!(told.contains(expected), "{path:?} = {value}: {told}");
    }
    // A tool that is broken when it is worn.
    for (limit, is_told) in [("499", false), ("500", true), ("40000", true)] {
        let mut recipe = tools();
        let table = recipe.path(&stage, "table");
        recipe.stage(&stage)["table"] =
            json!(changed(&table, folder.path(), "wear_limit_length_um", |_, _| limit.to_owned()));
        assert_eq!(told(&recipe).contains("such a tool would never be worn"), is_told, "{limit}");
    }
    let mut recipe = Variant::of(&recipes()["tango-hu40t"]).only(&["fit-S1"]);
    recipe.stage("table")["standard_uncertainty_um"] = json!(1e9);
    assert!(told(&recipe).contains("from 1e-6 to 1e6"));
    let mut recipe = Variant::of(&recipes()["tango-hu40t"]).only(&["fit-S1"]);
    recipe.stage("table")["stylus_radius_standard_uncertainty_um"] = json!(1e300);
    assert!(told(&recipe).contains("from 0 to 1e6"));
}

/// Results of tests take the place of results of tests only.
#[test]
fn results_of_tests_replace_nobodys_files() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["design-2d"]);
    let file = recipe.write(folder.path());
    let notes = folder.path().join("notes.md");
    fs::write(&notes, "mine\n").expect("a file");
    let test = |option: &str, to: &Path| {
        abbe(folder.path(), &["test".as_ref(), file.as_os_str(), option.as_ref(), to.as_os_str()])
    };
    for (option, to) in [("--junit", &file), ("--markdown", &notes), ("--junit", &notes), ("--markdown", &file)] {
        let before = read(to);
        let printed = test(option, to);
        assert!(printed.stderr.contains("is not replaced"), "{}", printed.stderr);
        assert_eq!(printed.status, 2);
        assert_eq!(read(to), before);
    }
    let own = folder.path().join("results.xml");
    fs::write(&own, "").expect("a file");
    test("--junit", &own);
    let first = read(&own);
    assert!(first.contains("<testsuite"));
    assert!(!test("--junit", &own).stderr.contains("is not replaced"));
    // What somebody wrote into it stays.
    let noted = read(&own).replacen("</testsuite>", "<!-- as in May -->\n</testsuite>", 1);
    fs::write(&own, &noted).expect("a file");
    assert!(test("--junit", &own).stderr.contains("is not replaced"));
    assert_eq!(read(&own), noted);
    fs::write(&own, first).expect("a file");
    assert!(test("--markdown", &own).stderr.contains("is not replaced"));
    #[cfg(unix)]
    {
        let link = folder.path().join("link.xml");
        std::os::unix::fs::symlink(&file, &link).expect("a link");
        let before = read(&file);
        assert!(test("--junit", &link).stderr.contains("is not replaced"));
        assert_eq!(read(&file), before);
    }
}

/// A number that is none is expected of nothing.
#[test]
fn expected_values_are_numbers() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["design-2d"]);
    let file = recipe.write(folder.path());
    let test = |more: &[&str]| {
        let arguments: Vec<&std::ffi::OsStr> =
            ["test".as_ref(), file.as_os_str()].into_iter().chain(more.iter().map(|more| more.as_ref())).collect();
        abbe(folder.path(), &arguments)
    };
    test(&["--accept"]);
    let expected = folder.path().join("recipe.expected");
    let right = read(&expected);
    assert_eq!(test(&[]).status, 0);
    let line = right.lines().find(|line| line.contains(" ± ")).expect("a value").to_owned();
    let (name, rest) = line.split_once(" = ").expect("a line");
    let (value, tail) = rest.split_once(" ± ").expect("a value");
    let (uncertainty, unit) = tail.split_once(' ').expect("a unit");
    for wrong in [("nan", "nan"), ("nan", uncertainty), (value, "nan"), ("inf", "inf"), (value, "inf")] {
        let changed = right.replace(&line, &format!("{name} = {} ± {} {unit}", wrong.0, wrong.1));
        fs::write(&expected, changed).expect("a file");
        assert_eq!(test(&[]).status, 1, "{wrong:?} is as expected");
    }
}

/// A sensor of a body in another unit than the others, seen in the idle minutes.
#[test]
fn a_sensor_that_reads_apart_from_all_others_at_rest_is_told() {
    let source = Variant::of(&recipes()["mill-warming"]);
    type Change = fn(f64) -> f64;
    let changes: [(Change, bool); 4] = [
        (|celsius| 1.8 * celsius + 32.0, true),
        (|celsius| -celsius, true),
        (|celsius| celsius / 10.0, true),
        (|celsius| celsius, false),
    ];
    for (change, is_wrong) in changes {
        let folder = temporary();
        let mut recipe = source.clone();
        let stages = recipe.0["stages"].as_object_mut().expect("stages");
        let log = stages
            .values_mut()
            .find(|stage| stage["path"].as_str().is_some_and(|path| path.ends_with("temperatures.csv")));
        let path = &mut log.expect("a log")["path"];
        let number = |cell: &str| cell.parse::<f64>().expect("a number");
        *path = json!(changed(Path::new(path.as_str().expect("a path")), folder.path(), "C31_degC", |_, cell| {
            format!("{}", change(number(cell)))
        }));
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["check".as_ref(), file.as_os_str()]);
        assert_eq!(printed.stderr.contains("C31 reads"), is_wrong, "{}", printed.stderr);
    }
}

/// One file of an instrument in mm under a column in µm.
#[test]
fn readings_in_another_unit_than_those_of_other_files_are_told() {
    let folder = temporary();
    let (mut told, mut all, mut missed) = (0, 0, Vec::new());
    for name in ["mill-direct", "mill-direct-exact"] {
        // The two fits that use the files; the others of the recipe would be judged again for each of them.
        let recipe = Variant::of(&recipes()[name]).only(&["fit-lengths", "fit-angles"]);
        let remarks = |recipe: &Variant| -> Vec<String> {
            let planned = checked(recipe, folder.path()).expect("a plan");
            planned.into_iter().flat_map(|planned| planned.identifiability.remarks).collect()
        };
        let is_told = |remarks: &[String]| remarks.iter().any(|remark| remark.contains("is their unit right?"));
        assert!(!is_told(&remarks(&recipe)), "{name}: {:?}", remarks(&recipe));
        for (stage, column) in [("length-files", "reading_um"), ("angle-files", "reading_urad")] {
            let files = recipe.0["stages"][stage]["path"].as_array().expect("a list").clone();
            for (place, file) in files.iter().enumerate().step_by(3) {
                let Some(file) = file.as_str().filter(|file| !file.contains('*')) else { continue };
                let thousandth = |_: usize, cell: &str| (cell.parse::<f64>().expect("a reading") / 1e3).to_string();
                let other = changed(Path::new(file), folder.path(), column, thousandth);
                let mut wrong = recipe.clone();
                wrong.stage(stage)["path"][place] = json!(other);
                let remarks = remarks(&wrong);
                let own = other.display().to_string();
                let of_file = |remark: &String| remark.contains(&own) && remark.contains("is their unit right?");
                // Where errors are hundreds of times as large as readings scatter, the residuals tell; in exact data there are none.
                let is_scale = ["EXX", "EYY", "EZZ"].iter().any(|symbol| own.contains(symbol));
                let in_run = || {
                    let recipe = wrong.write(folder.path());
                    let printed = abbe(folder.path(), &["--verbose".as_ref(), "run".as_ref(), recipe.as_os_str()]);
                    ["is the unit of its readings right?", "is their unit right?"]
                        .iter()
                        .any(|words| printed.stdout.contains(words))
                };
                if name == "mill-direct" || !is_scale {
                    all += 1;
                    match remarks.iter().any(of_file) || (name == "mill-direct" && in_run()) {
                        true => told += 1,
                        false => missed.push(own),
                    }
                }
            }
        }
    }
    // A thousandth of an error of hundreds of micrometres is an error of its own, if nothing else measures it.
    println!("told {told} of {all}, and not {missed:?}");
    assert!(told * 10 >= all * 8, "{missed:?}");
}

/// A key that stands twice, in every kind of JSON file that people may edit.
#[test]
fn a_key_that_stands_twice_is_refused_with_its_place() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "out"]).status, 0);
    small.write("truth.json", "{ \"parameters\": {\n  \"EX0C\": 0.01,\n  \"EX0C\": 0.02 } }");
    let refused = |arguments: &[&str], words: &[&str]| {
        let printed = small.abbe(arguments);
        assert!(matches!(printed.status, 1 | 2), "{arguments:?}: {}{}", printed.stdout, printed.stderr);
        for word in words.iter().chain(&["stands here a second time"]) {
            assert!(printed.stderr.contains(word), "{arguments:?}: {word}: {}", printed.stderr);
        }
    };
    refused(
        &["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", "sim"],
        &["`EX0C`", "truth.json:3:8"],
    );
    let result = "out/recipe/fine.calibration.json";
    let text = small.read(result);
    let at = text.find("\"settings\": {").expect("the settings of the model") + "\"settings\": {".len();
    let line = text[..at].lines().count();
    small.write(result, &format!("{} \"chain\": \"t b w\",{}", &text[..at], &text[at..]));
    let twice = ["`chain`", "line "];
    refused(&["report", result, "--out", "page.html"], &twice);
    let printed = small.abbe(&["report", result, "--out", "page.html"]);
    let place = printed.stderr.split("line ").nth(1).and_then(|rest| rest.split(' ').next()?.parse().ok());
    assert!(place.is_some_and(|place: usize| place > line), "{}", printed.stderr);
    small.write("out/recipe/verdicts.json", "[{ \"stage\": \"a\", \"more\": { \"x\": 1, \"x\": 2 } }]");
    small.write(result, &text);
    // Records of early versions do not list what was written.
    let mut record: serde_json::Value = serde_json::from_str(&small.read("out/recipe/run.json")).expect("JSON");
    record.as_object_mut().expect("a record").remove("outputs");
    small.write("out/recipe/run.json", &record.to_string());
    refused(&["report", "out/recipe", "--out", "page.html"], &["`x`", "line 1 column"]);
    // The machine that a calibration is for.
    let machine = small.read("data/machine.yaml").replacen("chain:", "tool_length_mm: 1\ntool_length_mm: 2\nchain:", 1);
    small.write("machine.yaml", &machine);
    small.write("points.csv", "X_mm,Y_mm,Z_mm,B_deg,C_deg\n0,0,0,0,0\n");
    refused(&["correct", result, "points.csv", "--machine", "machine.yaml"], &["`tool_length_mm`", "machine.yaml:"]);
}

/// Truths that nobody can mean are refused, wherever they stand.
#[test]
fn absurd_truths_of_artefacts_and_noise_are_refused() {
    let folder = temporary();
    let recipe = recipes()["tango-hu40t-exact"].clone();
    let simulate = |truth: &str, out: &str| {
        let file = folder.path().join("truth.json");
        fs::write(&file, truth).expect("a file");
        let [recipe, file] = [&recipe, &file].map(|path| path.to_string_lossy().into_owned());
        abbe(folder.path(), &["simulate", &recipe, "--truth", &file, "--seed", "1", "--out", out])
    };
    for (truth, said) in [
        (r#"{ "parameters": { "stylus_radius": 1e6 } }"#, "stylus_radius"),
        (r#"{ "parameters": { "stylus_radius": -30 } }"#, "stylus_radius"),
        (r#"{ "parameters": { "stylus_radius": -2 } }"#, "a number above 0"),
        (r#"{ "parameters": { "facet[3].d": 1e4 } }"#, "facet[3].d"),
        (r#"{ "parameters": {}, "noise": { "outliers": { "1": 1e9 } } }"#, "outliers"),
        (r#"{ "parameters": {}, "noise": { "outliers": { "fraction": 0.1, "size_mm": 1e9 } } }"#, "size_mm"),
        (
            r#"{ "parameters": {}, "noise": { "drift": { "component": "dzt", "gain_mm": 0.01, "tau_s": 9, "sign": 1e9 } } }"#,
            "at most 100 mm",
        ),
    ] {
        let found = simulate(truth, "refused");
        assert_eq!(found.status, 2, "{truth}: {}", found.stderr);
        assert!(found.stderr.contains(said) && found.stderr.contains("truth.json"), "{truth}: {}", found.stderr);
        assert!(!folder.path().join("refused").exists());
    }
    // A mark of the byte order in front is no part of the text.
    let found = simulate("\u{feff}{ \"parameters\": { \"EA0B\": 1e-5 } }", "taken");
    assert_eq!(found.status, 0, "{}", found.stderr);
}

/// Temperatures in another unit make coefficients that no material has.
#[test]
fn coefficients_of_temperature_beyond_any_material_fail() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["tango-warming"]).only(&["fit"]);
    let log = recipe.path("sensors", "path");
    let of = |cell: &str| cell.parse::<f64>().expect("a number");
    let other = changed(&log, folder.path(), "T_scale_degC", |_, cell| format!("{}", 20.0 + (of(cell) - 20.0) / 100.0));
    recipe.stage("sensors")["path"] = json!(other);
    let run = recipe.run();
    let said: Vec<String> = run.failures.iter().map(|failure| failure.error.message.clone()).collect();
    assert!(
        said.iter().any(|said| said.contains("no machine has such errors") && said.contains("T_scale")),
        "{said:?}"
    );
}

/// What is asked with a wrong word says what is expected.
#[test]
fn messages_of_wrong_words_say_what_to_do() {
    let folder = temporary();
    fs::write(folder.path().join("touches.csv"), "X_mm,Y_mm\n1,2\n").expect("a file");
    let found = abbe(folder.path(), &["model", "touches.csv"]);
    assert!(found.status == 2 && found.stderr.contains("abbe data"), "{}", found.stderr);
    fs::write(folder.path().join("r.yaml"), "abbe: 1\nname: x\nstages:\n  a: { ingest: text, path: b }\n")
        .expect("a file");
    let found = abbe(folder.path(), &["check", "r.yaml"]);
    assert!(found.status == 2 && found.stderr.contains("abbe plugins"), "{}", found.stderr);
    let found = abbe(folder.path(), &["compensate", "a.json", "--correct", "9"]);
    assert!(found.status == 2 && found.stderr.contains("names of linear axes"), "{}", found.stderr);
}

/// A misspelt key of a truth is a note; whoever wrote it meant something else.
#[test]
fn misspelt_keys_of_a_truth_are_told() {
    let small = Small::new();
    for (key, told) in [("noises", true), ("nois", true), ("source", false), ("noise", false)] {
        small.write("truth.json", &json!({ "parameters": {}, key: {} }).to_string());
        let made = small.abbe(&["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out", key]);
        assert_eq!(made.status, 0, "{}", made.stderr);
        assert_eq!(made.stderr.contains("did you mean `noise`"), told, "{key}: {}", made.stderr);
    }
}

/// A spindle that set-points do not mention is taken to stand at 0 degrees, which matters where errors turn with it.
#[test]
fn an_axis_that_set_points_do_not_have_is_told() {
    let folder = temporary();
    let mut outcome = Variant::of(&recipes()["first-steps"]).only(&["fit"]).run();
    let calibration = outcome.fits.remove(0).calibration;
    fs::write(folder.path().join("c.json"), calibration.to_json().expect("JSON")).expect("a file");
    for (path, told) in [
        ("X_mm,Y_mm,Z_mm,B_deg,C_deg\n10,20,300,5,6\n", true),
        ("X_mm,Y_mm,Z_mm,B_deg,C_deg,S_deg\n10,20,300,5,6,0\n", false),
    ] {
        fs::write(folder.path().join("path.csv"), path).expect("a file");
        for command in ["compensate", "correct"] {
            let found = abbe(folder.path(), &[command, "c.json", "path.csv"]);
            assert_eq!(found.stderr.contains("S is taken to stand at 0\u{b0}"), told, "{command}: {}", found.stderr);
        }
    }
}
