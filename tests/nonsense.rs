//! Absurd calibrations do not pass: signs, columns, units and lengths that are wrong, on a recipe that is right.

use std::fs;
use std::path::Path;

use abbe_core::{Error, Monitor};
use abbe_engine::{Outcome, Planned, prepare};
use serde_json::{Value, json};

use crate::misread::changed;
use crate::support::{SMALL, Small, Variant, abbe, read, recipes, registry, temporary};

/// The first steps with other touches and another machine.
fn first_steps(change: impl Fn(&str, f64) -> f64, machine: &[(&str, Value)]) -> Result<Outcome, Error> {
    first_steps_with(change, machine, &json!({}))
}

fn first_steps_with(
    change: impl Fn(&str, f64) -> f64,
    machine: &[(&str, Value)],
    plausible: &Value,
) -> Result<Outcome, Error> {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let text = read(&recipe.path("touches", "path"));
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let mut written = header.join(",");
    for line in lines {
        let cells = line.split(',').zip(&header).map(|(cell, name)| match name.rsplit_once('_') {
            Some((_, "mm" | "deg")) => format!("{}", change(name, cell.parse().expect("a number"))),
            _ => cell.to_owned(),
        });
        written.push('\n');
        written.push_str(&cells.collect::<Vec<_>>().join(","));
    }
    fs::write(folder.path().join("changed.csv"), written + "\n").expect("a file");
    recipe.stage("touches")["path"] = json!(folder.path().join("changed.csv"));
    for (setting, value) in machine {
        recipe.stage("machine")[*setting] = value.clone();
    }
    recipe.stage("fit")["plausible"] = plausible.clone();
    let path = recipe.write(folder.path());
    prepare(&path, &registry())?.run(&Monitor::default())
}

/// Message and help of the estimate that no machine can have.
fn refused(change: impl Fn(&str, f64) -> f64, machine: &[(&str, Value)]) -> (String, String) {
    let error = match first_steps(change, machine) {
        Err(error) => error,
        Ok(outcome) => {
            let failure = outcome.failures.first().expect("it fails").clone();
            // It is written and marked all the same.
            let fit = outcome.fits.iter().find(|fit| fit.name == failure.stage).expect("the estimate is there");
            assert!(!fit.calibration.fit.implausible.is_empty());
            assert!(!outcome.passes() && outcome.verdicts.len() == 1);
            failure.error
        }
    };
    (error.message, error.help.unwrap_or_default())
}

fn checked(recipe: &Variant, folder: &Path) -> Result<Vec<Planned>, Error> {
    prepare(&recipe.write(folder), &registry())?.check()
}

fn ran(recipe: &Variant, folder: &Path) -> Result<Outcome, Error> {
    prepare(&recipe.write(folder), &registry())?.run(&Monitor::default())
}

#[test]
fn the_right_recipe_passes() {
    let outcome = first_steps(|_, value| value, &[]).expect("it runs");
    assert!(outcome.passes());
    assert!(outcome.fits[0].calibration.fit.implausible.is_empty());
}

#[test]
fn wrong_signs_columns_and_units_are_found() {
    type Change = fn(&str, f64) -> f64;
    let cases: [(Change, &str); 9] = [
        (|name, value| if name == "X_mm" { -value } else { value }, "with X negated"),
        (|name, value| if name == "Y_mm" { -value } else { value }, "with Y negated"),
        (|name, value| if name == "B_deg" { -value } else { value }, "with B negated"),
        (|name, value| if name == "C_deg" { -value } else { value }, "with C negated"),
        (|name, value| if name.ends_with("mm") { value / 25.4 } else { value }, "read as in inches"),
        (|name, value| if name.ends_with("mm") { value * 25.4 } else { value }, "read as in mm and not in inches"),
        (|name, value| if name.ends_with("mm") { value / 1000.0 } else { value }, "read as in metres"),
        (|name, value| if name.ends_with("deg") { value.to_radians() } else { value }, "read as in radians"),
        (|name, value| if name == "B_deg" { value.to_radians() } else { value }, "with B read as in radians"),
    ];
    for (change, expected) in cases {
        let (message, help) = refused(change, &[]);
        assert!(help.starts_with("with ") && help.contains(expected), "{expected}: {message}; {help}");
        // The likeliest mistake comes first.
        assert!(help.find(expected) < help.find(';'), "{expected}: {help}");
    }
}

#[test]
fn swapped_columns_are_found() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let text = read(&recipe.path("touches", "path")).replace("X_mm,Y_mm", "Y_mm,X_mm");
    fs::write(folder.path().join("changed.csv"), text).expect("a file");
    recipe.stage("touches")["path"] = json!(folder.path().join("changed.csv"));
    let outcome = ran(&recipe, folder.path());
    let failure = outcome.expect("it runs").failures.remove(0);
    assert!(failure.error.message.starts_with("no machine has such errors: "), "{}", failure.error.message);
    assert!(failure.error.help.expect("help").starts_with("with X and Y swapped"));
}

#[test]
fn wrong_lengths_of_the_set_up_are_found() {
    let same = |_: &str, value: f64| value;
    let (message, help) = refused(same, &[("tool_length_mm", json!(-326.674))]);
    assert!(message.contains("dzt = -654 mm"), "{message}");
    assert!(help.contains("twice, as with a wrong sign of, `tool_length_mm` (-326.674 mm)"), "{help}");
    let (message, _) = refused(same, &[("tool_length_mm", json!(8000))]);
    assert!(message.contains("dzt = 7670 mm"), "{message}");
    let (message, _) = refused(same, &[("tool_length_mm", json!(371.674))]);
    assert!(message.contains("dzt = 44.8 mm; 20 mm is plausible at most"), "{message}");
    // The recipe may say that the tool is not measured.
    let wide = json!({ "mm": { "d?t": 100 } });
    let outcome = first_steps_with(same, &[("tool_length_mm", json!(371.674))], &wide).expect("it runs");
    assert!(outcome.passes(), "{:?}", outcome.failures);
}

/// A place in another unit moves features and no error of the machine; where the artefact really stands there, the recipe says so.
#[test]
fn features_far_from_their_nominal_places_fail_unless_the_recipe_expects_them_there() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["rapid-verify-three-axis"]).only(&["calibrated"]);
    let text = read(&recipe.path("artefact", "nominal"));
    assert!(text.contains(",-205.000,"), "{text}");
    fs::write(folder.path().join("points.csv"), text.replace(",-205.000,", ",995.000,")).expect("a file");
    recipe.stage("artefact")["nominal"] = json!(folder.path().join("points.csv"));
    let outcome = ran(&recipe, folder.path()).expect("it runs");
    let error = &outcome.failures.first().expect("it fails").error;
    let said = "is found 1200 mm from its nominal place; 1000 mm is plausible at most";
    assert!(error.message.contains(said) && error.message.contains("`artefact."), "{error}");
    assert!(error.help.as_ref().is_some_and(|help| help.contains("`plausible: { mm: { \"artefact.")), "{error:?}");
    recipe.stage("calibrated")["plausible"] = json!({ "mm": { "artefact.*": 2000 } });
    let outcome = ran(&recipe, folder.path()).expect("it runs");
    assert!(outcome.passes(), "{:?}", outcome.failures);
    recipe.stage("calibrated")["plausible"] = json!({ "mm": { "artefact.*": 1100 } });
    assert!(!ran(&recipe, folder.path()).expect("it runs").failures.is_empty());
    recipe.stage("calibrated")["plausible"] = json!({ "mm": { "table.*": 2000 } });
    let error = ran(&recipe, folder.path()).err().expect("it is refused");
    assert!(error.message.contains("`table.*` matches no parameter of the machine and no feature"), "{error}");
}

/// A wrong place of an axis shows in the rows that it turns: the median of all is that of a good set-up.
#[test]
fn contact_that_a_part_of_the_rows_misses_is_told() {
    let remarks = |off: f64, every: usize| {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["first-steps"]);
        let text = read(&recipe.path("touches", "path"));
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let header = lines.next().expect("a header");
        let x = header.split(',').position(|name| name == "X_mm").expect("a column");
        let moved = lines.enumerate().map(|(row, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            for cell in cells[x..x + 3].iter_mut().filter(|_| row % every == 0) {
                *cell = format!("{}", cell.parse::<f64>().expect("a number") + off);
            }
            cells.join(",")
        });
        let written: Vec<String> = std::iter::once(header.to_owned()).chain(moved).collect();
        fs::write(folder.path().join("changed.csv"), written.join("\n") + "\n").expect("a file");
        recipe.stage("touches")["path"] = json!(folder.path().join("changed.csv"));
        let planned = checked(&recipe, folder.path());
        planned.expect("a plan").remove(0).identifiability.remarks
    };
    let told = |remarks: &[String]| remarks.iter().any(|remark| remark.contains("mm away from contact (median; "));
    let some = remarks(18.0, 6);
    assert!(told(&some), "{some:?}");
    for good in [remarks(0.0, 6), remarks(18.0, 40)] {
        assert!(!told(&good), "{good:?}");
    }
}

#[test]
fn what_is_plausible_is_said_of_parameters_that_exist() {
    let same = |_: &str, value: f64| value;
    for (plausible, expected) in [
        (json!({ "mm": { "EX0Q": 1 } }), "`EX0Q` matches no parameter of the machine"),
        (json!({ "mm": { "EX0C": -1 } }), "a positive number was expected"),
        (json!({ "mrad": { "EX0C": 1 } }), "`EX0C` is no error in mrad"),
        (json!({ "inch": {} }), "inch"),
    ] {
        let error = first_steps_with(same, &[], &plausible).err().expect("it is refused");
        assert!(error.message.contains(expected), "{error}");
        assert!(error.place.is_some_and(|place| place.line.is_some()));
    }
}

#[test]
fn commands_beyond_the_travel_have_their_line() {
    let far = |name: &str, value: f64| if name == "C_deg" && value > 50.0 { 2_147_483_648.0 } else { value };
    let error = first_steps(far, &[]).err().expect("it is refused");
    assert!(error.message.contains("C stands at 2147483648°, beyond its travel"), "{error}");
    assert!(error.place.as_ref().is_some_and(|place| place.line.is_some()), "{error}");
    let axes = json!({ "X": { "range_mm": [-100, 100] } });
    let error = first_steps(|_, value| value, &[("axes", axes)]).err().expect("it is refused");
    assert!(error.message.contains("beyond its travel of -100 mm to 100 mm"), "{error}");
    // An axis that turns around gets everywhere, whichever way the control counts its turns (the touches have -270°); but not by
    // thousands of turns.
    let around = json!({ "C": { "range_deg": [-180, 180] } });
    let one = |turns: f64| move |name: &str, value: f64| if name == "C_deg" { value + turns * 360.0 } else { value };
    let outcome = first_steps(one(0.0), &[("axes", around.clone())]).expect("it runs");
    assert!(outcome.passes(), "{:?}", outcome.failures);
    assert!(first_steps(one(1.0), &[("axes", around)]).is_err());
    // Whole turns more are the same place, where an axis turns without an end.
    let turns = |name: &str, value: f64| if name == "C_deg" { value + 36_000.0 * 360.0 } else { value };
    assert!(first_steps(turns, &[]).is_err());
    let outcome = first_steps(turns, &[("axes", json!({ "C": { "endless": true } }))]).expect("it runs");
    assert!(outcome.passes(), "{:?}", outcome.failures);
}

#[test]
fn rows_that_are_there_twice_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let text = read(&recipe.path("touches", "path"));
    let line = text.lines().nth(5).expect("a row");
    fs::write(folder.path().join("changed.csv"), format!("{text}{line}\n")).expect("a file");
    recipe.stage("touches")["path"] = json!(folder.path().join("changed.csv"));
    let planned = checked(&recipe, folder.path());
    let remarks = planned.expect("a plan").remove(0).identifiability.remarks;
    assert!(
        remarks.iter().any(|remark| remark.contains("1 row is in the data twice") && remark.contains("lines 6 and ")),
        "{remarks:?}"
    );
}

/// Rows that are copied before means are made of them.
#[test]
fn rows_that_are_there_twice_in_means_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["mfb-ucp710"]);
    let pattern = recipe.path("centres-once", "path");
    let data = pattern.parent().expect("a folder");
    for entry in fs::read_dir(data).expect("a folder").map(|entry| entry.expect("a file")) {
        let name = entry.file_name().into_string().expect("a name");
        if name.starts_with("sphere-") {
            let text = read(&entry.path());
            let last = text.lines().last().expect("a row");
            let again = if name == "sphere-8.csv" { format!("{last}\n") } else { String::new() };
            fs::write(folder.path().join(name), format!("{text}{again}")).expect("a file");
        }
    }
    recipe.stage("centres-once")["path"] = json!(folder.path().join("sphere-*.csv"));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    assert!(printed.stderr.contains("1 row is in the data twice"), "{}", printed.stderr);
    assert!(printed.stderr.contains("sphere-8.csv`); each counts in the means"), "{}", printed.stderr);
}

/// Rows that are copied in a file that a validator alone reads.
#[test]
fn rows_that_are_there_twice_for_a_validator_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["sphere-hu40t"]);
    let text = read(&recipe.path("strategy-2", "path"));
    let last = text.lines().last().expect("a row");
    fs::write(folder.path().join("again.csv"), format!("{text}{last}\n")).expect("a file");
    recipe.stage("strategy-2")["path"] = json!(folder.path().join("again.csv"));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(said.matches("strategy-2: 1 row is in the data twice").count(), 1, "{said}");
}

/// A clock that runs backwards.
#[test]
fn times_that_fall_are_told() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["samba"]);
    let pattern = recipe.path("touches", "path");
    let text = read(&pattern);
    let header = text.lines().find(|line| !line.starts_with('#')).expect("a header").to_owned();
    let time = header.split(',').position(|name| name == "time_s").expect("times");
    let turned = |is_turned: bool| {
        let mut rows = Vec::new();
        for line in text.lines().filter(|line| !line.starts_with('#')).skip(1) {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if is_turned {
                cells[time] = format!("{}", 20_000.0 - cells[time].parse::<f64>().expect("a number"));
            }
            rows.push(cells.join(",") + "\n");
        }
        fs::write(folder.path().join("touches.csv"), format!("{header}\n{}", rows.concat())).expect("a file");
        let mut recipe = recipe.clone();
        recipe.stage("touches")["path"] = json!(folder.path().join("touches.csv"));
        let remarks: Vec<String> = checked(&recipe, folder.path())
            .expect("a plan")
            .into_iter()
            .flat_map(|planned| planned.identifiability.remarks)
            .collect();
        remarks.iter().any(|remark| remark.contains("the time falls from row to row"))
    };
    assert!(turned(true) && !turned(false));
}

/// One file of many in another unit.
#[test]
fn a_file_far_from_contact_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles", "fit-lengths"]);
    let mut files = recipe.stage("length-files")["path"].clone();
    let wrong = (files.as_array_mut().expect("files").iter_mut())
        .find(|file| file.as_str().is_some_and(|file| file.ends_with("EXY.csv")))
        .expect("the file");
    let text = read(Path::new(wrong.as_str().expect("a path")));
    let row = |line: &str| match line.rsplit_once(',').and_then(|(rest, last)| Some((rest, last.parse::<f64>().ok()?)))
    {
        Some((rest, value)) if !line.starts_with('#') => format!("{rest},{}\n", value * 1e4),
        _ => format!("{line}\n"),
    };
    let file = folder.path().join("direct-EXY.csv");
    fs::write(&file, text.lines().map(row).collect::<String>()).expect("a file");
    *wrong = json!(file);
    recipe.stage("length-files")["path"] = files;
    let planned = checked(&recipe, folder.path()).expect("a plan");
    let remarks: Vec<&String> = planned.iter().flat_map(|planned| &planned.identifiability.remarks).collect();
    let told: Vec<_> = remarks.iter().filter(|remark| remark.contains("away from contact")).collect();
    assert!(told.len() == 1 && told[0].contains("direct-EXY.csv`: at the recorded positions"), "{remarks:?}");
}

/// Readings of a probing run in inches are no error of a machine.
#[test]
fn a_run_in_another_unit_is_no_error_of_the_machine() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["rapid-verify-three-axis"]);
    let text = read(&recipe.path("today", "path"));
    let rows = text.lines().map(|line| match line.rsplit_once(',') {
        // The position of the approach axis is the same quantity.
        Some((_, last)) if line.starts_with('P') => {
            let inches = format!("{}", last.parse::<f64>().expect("a number") / 25.4);
            line.split(',').map(|cell| if cell == last { inches.as_str() } else { cell }).collect::<Vec<_>>().join(",")
                + "\n"
        }
        _ => format!("{line}\n"),
    });
    fs::write(folder.path().join("inches.csv"), rows.collect::<String>()).expect("a file");
    recipe.stage("today")["path"] = json!(folder.path().join("inches.csv"));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    let said = printed.stdout.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("which no error of a machine makes: look for another unit"), "{said}");
}

/// Lengths alone do not tell how long the tool is, and it moves what is said far from the axes.
#[test]
fn a_tool_that_is_far_longer_than_the_travel_or_below_zero_is_asked_about() {
    let (long, negative) = ("times the longest travel of a linear axis", "is its sign right?");
    let wanted =
        [(8000.0, Some(long)), (-8000.0, Some(negative)), (-150.0, Some(negative)), (150.0, None), (450.0, None)];
    for (length, told) in wanted {
        let mut recipe = Variant::of(&recipes()["cmm-brute-force"]).only(&["fit"]);
        let machine = recipe.0["stages"].as_object_mut().expect("stages").values_mut();
        let machine = machine.into_iter().find(|stage| stage.get("model").is_some()).expect("a machine");
        machine["tool_length_mm"] = json!(length);
        let folder = temporary();
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &[Path::new("run"), &file, Path::new("--out"), Path::new("out")]);
        for words in [long, negative] {
            assert_eq!(printed.stderr.contains(words), told == Some(words), "{length}: {}", printed.stderr);
        }
    }
}

/// So are offsets of the probe and tips of styli.
#[test]
fn a_probe_that_is_far_from_the_tool_is_asked_about() {
    for (offset, is_told) in [([0.0, -25_000.0, 0.0], true), ([0.0, -25.0, 0.0], false)] {
        let mut recipe = Variant::of(&recipes()["cmm-brute-force"]).only(&["fit"]);
        let machine = recipe.0["stages"].as_object_mut().expect("stages").values_mut();
        let machine = machine.into_iter().find(|stage| stage.get("model").is_some()).expect("a machine");
        machine["probe_offset_mm"] = json!(offset);
        let folder = temporary();
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &[Path::new("run"), &file, Path::new("--out"), Path::new("out")]);
        let words = "`probe_offset_mm` is 25000";
        assert_eq!(printed.stderr.contains(words), is_told, "{offset:?}: {}", printed.stderr);
    }
}

/// No tool and no stylus is a kilometre long.
#[test]
fn lengths_beyond_measure_are_refused() {
    for setting in ["tool_length_mm", "stylus_radius_mm"] {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["first-steps"]);
        recipe.stage("machine")[setting] = json!(1e308);
        let error = prepare(&recipe.write(folder.path()), &registry()).err().expect("it is refused");
        assert!(error.to_string().contains("1e308: a number from "), "{error}");
    }
}

#[test]
fn copies_of_files_and_of_numbered_rows_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let text = read(&recipe.path("touches", "path"));
    let copies = ["touches.csv", "touches (1).csv"].map(|name| folder.path().join(name));
    copies.iter().for_each(|copy| fs::write(copy, &text).expect("a file"));
    recipe.stage("touches")["path"] = json!(copies);
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    assert!(printed.stderr.contains("touches (1).csv have the same content"), "{}", printed.stderr);

    // A running number makes no row another one.
    let (header, rows) = text.split_once('\n').expect("a header");
    let rows: Vec<&str> = rows.lines().collect();
    let numbered = rows.iter().chain(&rows[..7]).enumerate().map(|(number, row)| format!("{row},n{number}\n"));
    fs::write(&copies[0], format!("{header},number\n{}", numbered.collect::<String>())).expect("a file");
    recipe.stage("touches")["path"] = json!(copies[0]);
    let planned = checked(&recipe, folder.path());
    let remarks = planned.expect("a plan").remove(0).identifiability.remarks;
    assert!(remarks.iter().any(|remark| remark.contains("rows are in the data twice")), "{remarks:?}");
}

/// The same rows under two names, read by two stages, are twice in one estimate.
#[test]
fn lines_that_two_stages_read_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    for (copy, stage) in [("touches-again", "touches"), ("table-again", "table")] {
        let settings = recipe.stage(stage).clone();
        recipe.0["stages"][copy] = settings;
    }
    recipe.stage("table-again")["from"] = json!("touches-again");
    recipe.stage("fit")["observations"] = json!(["table", "table-again"]);
    let planned = checked(&recipe, folder.path());
    let remarks = planned.expect("a plan").remove(0).identifiability.remarks;
    assert!(remarks.iter().any(|remark| remark.contains("use the same 383 lines of a file")), "{remarks:?}");
}

/// Whoever takes most of what was measured for outliers is told.
#[test]
fn many_outliers_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    for (outlier_at, is_told) in [(0.05, true), (5.0, false)] {
        recipe.stage("fit")["robust"] = json!({ "loss": "tukey", "outlier_at": outlier_at });
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
        assert_eq!(printed.stdout.contains("rows are outliers: "), is_told, "{}", printed.stdout);
    }
}

/// A facet with its normal turned round, and one at another place, fit as well as the truth; they are told after the fit.
#[test]
fn a_feature_that_is_elsewhere_is_told() {
    let folder = temporary();
    for (column, change) in [(6, -1.0), (5, 0.0)] {
        let mut recipe = Variant::of(&recipes()["first-steps"]);
        let text = read(&recipe.path("table", "nominal"));
        let mut lines: Vec<Vec<String>> =
            text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect();
        let facet = lines.iter().position(|cells| cells[0] == "3").expect("a facet");
        for cell in &mut lines[facet][4..=column] {
            let value: f64 = cell.parse().expect("a number");
            *cell = if change < 0.0 { format!("{}", -value) } else { cell.clone() };
        }
        if change == 0.0 {
            // Along its normal.
            for axis in 1..=3 {
                let [place, normal] =
                    [axis, axis + 3].map(|index| lines[facet][index].parse::<f64>().expect("a number"));
                lines[facet][axis] = format!("{}", place + 5.0 * normal);
            }
        }
        let text: String = lines.iter().map(|cells| cells.join(",") + "\n").collect();
        fs::write(folder.path().join("facets.csv"), text).expect("a file");
        recipe.stage("table")["nominal"] = json!(folder.path().join("facets.csv"));
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
        let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains("`table.facet[3].d` is off by"), "{said}");
    }
}

#[test]
fn nothing_is_exported_beyond_the_travel() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.stage("machine")["axes"] = json!({ "Y": { "range_mm": [-400, 400] } });
    let export = |to: f64| {
        let turn = json!({ "from_deg": -90, "to_deg": 90 });
        let travel = json!({ "from_mm": 0, "to_mm": 400 });
        let ranges = json!({ "Y": { "from_mm": -400, "to_mm": to }, "X": travel, "Z": travel, "B": turn, "C": turn });
        json!({ "export": "error-table", "of": "fit", "ranges": ranges, "step_mm": 100, "step_deg": 90 })
    };
    let grid = |at: f64| json!({ "export": "volumetric", "of": "fit", "grid": { "poses": [{ "Y_mm": at }] } });
    let cases = [(export(430.0), false), (export(4000.0), true), (grid(430.0), false), (grid(4000.0), true)];
    for (stage, refused) in cases {
        recipe.0["stages"]["cnc"] = stage;
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
        assert_eq!(printed.stderr.contains("is beyond its travel of -400 to 400 mm"), refused, "{}", printed.stderr);
    }
}

/// Lengths in another unit than their column says, while the angles are right.
#[test]
fn residuals_of_one_quantity_that_are_too_good_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["positioner"]);
    let text = read(&recipe.path("seen", "path")).replace("x_mm,y_mm,z_mm", "x_um,y_um,z_um");
    fs::write(folder.path().join("poses.csv"), text).expect("a file");
    recipe.stage("seen")["path"] = json!(folder.path().join("poses.csv"));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    assert!(printed.stdout.contains("is the unit of the lengths right?"), "{}{}", printed.stdout, printed.stderr);
}

/// What the program prints about the first steps with another standard uncertainty, in µm.
fn told_with_uncertainty(uncertainty: f64) -> String {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.stage("table")["standard_uncertainty_um"] = json!(uncertainty);
    let file = recipe.write(folder.path());
    abbe(folder.path(), &["run".as_ref(), file.as_os_str()]).stdout
}

#[test]
fn stated_uncertainties_that_are_too_large_are_told() {
    for (uncertainty, is_told) in [(1.6, false), (4.0, false), (50.0, true), (1600.0, true)] {
        let told = told_with_uncertainty(uncertainty);
        assert_eq!(told.contains("these are too large, or nothing was measured"), is_told, "{uncertainty}: {told}");
    }
}

/// Rows of wrong uncertainty make a robust fit leave out the only length, which `check` cannot know.
#[test]
fn what_robust_weights_leave_out_is_named() {
    let folder = temporary();
    let mut recipe = Variant::tango("realistic").only(&["fit-S3"]);
    recipe.stage("table")["standard_uncertainty_um"] = json!(0.16);
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    let said = printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("robust weights leave out") && said.contains("without `robust` the run says more"), "{said}");
}

/// A fit that explains nothing has large uncertainties: they do not excuse large errors.
#[test]
fn large_errors_with_large_uncertainties_do_not_pass() {
    let mut number = 0_u32;
    let noisy = |name: &str, value: f64| {
        number += 1;
        // Noise of 20 mm that is no error of a machine.
        let noise = f64::from(number.wrapping_mul(2_654_435_761) >> 8) / f64::from(1_u32 << 24) - 0.5;
        match name {
            "Z_mm" => value + 40.0 * noise,
            "Y_mm" => 1.06 * value,
            _ => value,
        }
    };
    let noisy = std::cell::RefCell::new(noisy);
    let failed = first_steps(|name, value| (noisy.borrow_mut())(name, value), &[]);
    let errors: Vec<String> = match failed {
        Err(error) => vec![error.message],
        Ok(outcome) => outcome.failures.iter().map(|failure| failure.error.message.clone()).collect(),
    };
    assert!(errors.iter().any(|message| message.contains("no machine has such errors")), "{errors:?}");
}

#[test]
fn data_that_a_validator_does_not_read_are_refused() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    recipe.stage("judge")["from"] = json!("touches");
    let error = checked(&recipe, folder.path()).unwrap_err();
    assert!(error.message.contains("it reads no data of its own"), "{error}");
}

#[test]
fn data_of_validators_are_within_the_travel() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["sphere-hu40t"]);
    let text = read(&recipe.path("strategy-2", "path"));
    let (header, rows) = text.split_once('\n').expect("a header");
    let place = header.split(',').position(|name| name == "Y_mm").expect("a column");
    let moved = |row: &str| {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        cells[place] = format!("{}", cells[place].parse::<f64>().expect("a number") + 3000.0);
        cells.join(",") + "\n"
    };
    let moved: String = rows.lines().map(moved).collect();
    fs::write(folder.path().join("moved.csv"), format!("{header}\n{moved}")).expect("a file");
    recipe.stage("strategy-2")["path"] = json!(folder.path().join("moved.csv"));
    let error = ran(&recipe, folder.path()).err().expect("it is refused");
    let message = error.to_string();
    assert!(message.contains("moved.csv:2") && message.contains("beyond its travel"), "{message}");
}

#[test]
fn balls_at_the_same_place_have_no_distance() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["samba"]);
    let stages = recipe.0["stages"].as_object().expect("stages");
    let (name, balls) = stages.iter().find(|(_, stage)| stage.get("distances").is_some()).expect("distances");
    let (name, nominal) = (name.clone(), balls["nominal"].as_str().expect("a file").to_owned());
    let text = read(Path::new(&nominal));
    let one = text.lines().find(|line| line.starts_with("25,")).expect("ball 25").to_owned();
    let same = |line: &str| if line.starts_with("26,") { one.replacen("25,", "26,", 1) } else { line.to_owned() };
    let text: String = text.lines().map(|line| same(line) + "\n").collect();
    fs::write(folder.path().join("balls.csv"), text).expect("a file");
    recipe.stage(&name)["nominal"] = json!(folder.path().join("balls.csv"));
    let error = checked(&recipe, folder.path()).unwrap_err();
    assert!(error.message.contains("balls 25 and 26 have the same nominal centre"), "{error}");
}

/// A mistake in one entry of a list is told at the line of the entry, and not where the list begins.
#[test]
fn a_wrong_distance_is_told_at_its_line() {
    let folder = temporary();
    let original = &recipes()["samba"];
    let text = read(original).replace("data/", &format!("{}/data/", original.parent().expect("a folder").display()));
    let first = "[ { between: [25, 26], length_mm: 304.6686, standard_uncertainty_um: 0.1 }";
    let line = text.lines().position(|line| line.contains(first)).expect("a distance") + 2;
    for other in ["      { between: [25, 999], ", "      { between: [999, 25], "] {
        let second = format!("{first},\n{other}length_mm: 304.6686, standard_uncertainty_um: 0.1 }}");
        let file = folder.path().join("changed.yaml");
        crate::support::write(&file, &text.replacen(first, &second, 1));
        let error = prepare(&file, &registry()).and_then(|recipe| recipe.check()).expect_err("it is refused");
        assert!(error.message.contains("`distances` names ball 999"), "{error}");
        let place = error.place.expect("a place");
        let column = other.find("999").map(|before| before + 1);
        assert_eq!((place.line, place.column), (Some(line), column), "{other}");
    }
}

/// A calibration that is marked, and one that contradicts its machine, are not built upon.
#[test]
fn absurd_calibrations_are_not_read() {
    let small = Small::new();
    assert_eq!(small.abbe(&["run", "recipe.yaml", "--out", "out"]).status, 0);
    let stages = "  saved: { estimate: calibration, path: changed.json }\n  table-of-errors: { export: error-table, of: saved, step_mm: 100, step_deg: 30 }\n";
    small.write("again.yaml", &format!("abbe: 1\nname: Saved\nstages:\n{stages}"));
    let saved = crate::support::json_file(&small.path("out/recipe/fine.calibration.json"));
    type Change = fn(&mut Value);
    let cases: [(Change, &str); 4] = [
        (|_| {}, ""),
        (
            |it| it["fit"]["implausible"] = json!([{ "name": "EX0C", "size": 30.0, "plausible": 10.0 }]),
            "this calibration is marked",
        ),
        (|it| it["parameters"][0]["unit"] = json!("s"), "its unit is s"),
        (|it| it["parameters"][0]["name"] = json!("EXX[9]"), "no such parameter"),
    ];
    for (change, expected) in cases {
        let mut changed = saved.clone();
        // The first parameter that is not estimated: its uncertainty stands nowhere else.
        let fixed = changed["parameters"].as_array_mut().expect("parameters");
        fixed.sort_by_key(|one| one["status"] != json!("fixed"));
        change(&mut changed);
        small.write("changed.json", &changed.to_string());
        let printed = small.abbe(&["run", "again.yaml", "--out", "again"]);
        assert_eq!(printed.status == 0, expected.is_empty(), "{expected}: {}", printed.stderr);
        assert!(printed.stderr.contains(expected), "{expected}: {}", printed.stderr);
    }
}

/// What is stated, and where a calibration is from, makes no error a real one.
#[test]
fn absurd_statements_do_not_pass() {
    let folder = temporary();
    for (name, value, unit, passes) in [
        ("EXX[1]", 8.6, "um/m", true),
        ("EXX[1]", 8.6, "mm/mm", false),
        ("EXX[1]", 1e308, "mm/mm", false),
        ("EX0C", 1e6, "mm", false),
        ("EA0C", 1.5, "rad", false),
    ] {
        let mut recipe = Variant::of(&recipes()["first-steps"]).only(&[]);
        let values = json!({ name: { "value": value, "standard_uncertainty": value * 1e-2, "unit": unit } });
        recipe.0["stages"]["report"] = json!({ "estimate": "stated", "machine": "machine", "values": values });
        for stage in ["touches", "table"] {
            recipe.0["stages"].as_object_mut().expect("stages").remove(stage);
        }
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
        assert_eq!(printed.status == 0, passes, "{name} = {value} {unit}: {}", printed.stderr);
        let told = if value > 1e9 { "a number from -1e9 to 1e9" } else { "no machine has such errors" };
        assert_eq!(printed.stderr.contains(told), !passes, "{}", printed.stderr);
    }
}

#[test]
fn uncertainties_that_nothing_has_are_refused() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    for uncertainty in [5e-324, 1e-150, 1e-8, 1e12, 1e308] {
        recipe.stage("table")["standard_uncertainty_um"] = json!(uncertainty);
        let checked = checked(&recipe, folder.path());
        let error = checked.expect_err("it is refused");
        assert!(error.message.contains("a number from 1e-6 to 1e6 was expected"), "{uncertainty}: {error}");
    }
}

#[test]
fn styli_that_the_model_does_not_have_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let text = read(&recipe.path("touches", "path"));
    let stylus = |index: usize| match index {
        0 => "stylus",
        even if even % 2 == 0 => "1",
        _ => "2",
    };
    let rows = text.lines().enumerate().map(|(index, line)| format!("{line},{}\n", stylus(index)));
    fs::write(folder.path().join("changed.csv"), rows.collect::<String>()).expect("a file");
    recipe.stage("touches")["path"] = json!(folder.path().join("changed.csv"));
    let planned = checked(&recipe, folder.path());
    let remarks = planned.expect("a plan").remove(0).identifiability.remarks;
    assert!(remarks.iter().any(|remark| remark.contains("`stylus` has 2 labels")), "{remarks:?}");
}

/// Two certificates of the same length that differ: the second one is refused, and one of another pair is told.
#[test]
fn certificates_that_contradict_each_other_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["samba"]);
    let stages = recipe.0["stages"].as_object().expect("stages");
    let named = stages.iter().filter(|(_, stage)| stage.get("distances").is_some()).map(|(name, _)| name.clone());
    let named: Vec<String> = named.collect();
    let with = |recipe: &mut Variant, more: Value| {
        for name in &named {
            recipe.stage(name)["distances"].as_array_mut().expect("a list").push(more.clone());
        }
    };
    let mut twice = recipe.clone();
    with(&mut twice, json!({ "between": [26, 25], "length_mm": 305, "standard_uncertainty_um": 0.1 }));
    let error = prepare(&twice.write(folder.path()), &registry()).err().expect("it is refused");
    assert!(error.message.contains("a second time"), "{error}");
    // Nominal places of balls are right to some hundredths.
    with(&mut recipe, json!({ "between": [1, 25], "length_mm": 150, "standard_uncertainty_um": 0.1 }));
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
    let said = format!("{}{}", printed.stdout, printed.stderr);
    assert!(printed.status != 0 || said.contains("certificates contradict each other"), "{said}");
}

/// One of six stated distances that the others contradict is told by its name; right ones get no word.
#[test]
fn a_wrong_distance_of_several_is_named() {
    let folder = temporary();
    let told = |change: Option<(usize, f64)>| -> Vec<String> {
        let mut recipe = Variant::of(&recipes()["linuxcnc-balls"]);
        if let Some((place, off)) = change {
            let length = &mut recipe.stage("balls")["distances"][place]["length_mm"];
            *length = json!(length.as_f64().expect("a length") + off);
        }
        let outcome = ran(&recipe, folder.path()).expect("a run");
        outcome.doubts.into_iter().map(|doubt| doubt.text).collect()
    };
    assert_eq!(told(None), Vec::<String>::new());
    let names = ["1-2", "1-3", "1-4", "2-3", "2-4", "3-4"];
    for (place, name) in names.iter().enumerate() {
        for off in [0.03, -0.03, 0.1] {
            let said = told(Some((place, off)));
            assert!(
                said.iter().any(|said| said.contains(&format!("without length[{name}] of balls"))),
                "{name} {off}: {said:?}"
            );
        }
    }
}

/// One of two balls that is not where its nominal file says.
#[test]
fn one_of_few_features_that_is_elsewhere_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["ballbar-c600u"]).only(&["fit"]);
    let stages = recipe.0["stages"].as_object().expect("stages");
    let (name, bar) = stages.iter().find(|(_, stage)| stage["artefact"] == json!("ball-bar")).expect("a ball bar");
    let (name, setting) = (name.clone(), bar.as_object().expect("a map").clone());
    let (key, nominal) = setting
        .iter()
        .find(|(_, value)| value.as_str().is_some_and(|text| text.ends_with("balls.csv")))
        .expect("a file of balls");
    let text = read(Path::new(nominal.as_str().expect("a path")));
    assert!(text.contains("\n1,130.0000,"));
    for (x, is_told) in [("130.0000", false), ("-130.0000", true)] {
        fs::write(folder.path().join("balls.csv"), text.replace("\n1,130.0000,", &format!("\n1,{x},")))
            .expect("a file");
        recipe.stage(&name)[key] = json!(folder.path().join("balls.csv"));
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str()]);
        assert_eq!(printed.stderr.contains("`bar.ball[1].x` is off by"), is_told, "{}", printed.stderr);
    }
}

/// Rows of an estimate test no prediction of it, whether they come from the same stage or are read once more.
#[test]
fn rows_that_an_estimate_has_seen_are_told_where_they_judge_it() {
    let judged = |stages: &str| {
        let small = Small::new();
        small.write("recipe.yaml", &(SMALL.to_owned() + stages));
        let printed = small.abbe(&["run", "recipe.yaml"]);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        printed.stderr.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let seen = "again: `fine` was estimated from rows that it is judged by here; of these nothing is predicted: data/lengths.csv rows 1";
    let same = judged("  again: { validate: residuals, of: fine, observations: bar, limits: { max_um: 1000 } }\n");
    assert!(same.contains(seen), "{same}");
    let once_more = "  more: { ingest: csv, path: data/lengths.csv }
  copy: { artefact: length, from: more, standard_uncertainty_um: 0.9 }
  again: { validate: residuals, of: fine, observations: copy, limits: { max_um: 1000 } }
";
    let read_again = judged(once_more);
    assert!(read_again.contains(seen), "{read_again}");
    assert_eq!(judged(""), "");
    // Rows that the artefact keeps apart are judged, and get no word.
    let apart =
        SMALL.replace("standard_uncertainty_um: 1.6 }", "standard_uncertainty_um: 1.6, unseen: { group: [3] } }");
    assert_ne!(apart, SMALL);
    let apart = apart.replace("folds: [[2], [3]]", "folds: [[2]]");
    let small = Small::new();
    small.write(
        "recipe.yaml",
        &(apart + "  again: { validate: residuals, of: fine, observations: table, limits: { max_um: 1000 } }\n"),
    );
    let printed = small.abbe(&["run", "recipe.yaml"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""), "{}", printed.stdout);
}

/// Thousands of trials of an estimate that no machine has say nothing, and nobody waits for them.
#[test]
fn no_trials_are_made_of_an_absurd_estimate() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["cylinder-uncertainty"]).only(&["fit-S2", "fit-both", "trials"]);
    let file = recipe.path("touches-s2", "path");
    let negated = |_: usize, cell: &str| format!("{}", -cell.parse::<f64>().expect("a number"));
    recipe.stage("touches-s2")["path"] = json!(changed(&file, folder.path(), "Y_mm", negated));
    recipe.stage("trials")["trials"] = json!(10_000_000);
    let outcome = ran(&recipe, folder.path()).expect("results that are marked");
    let told: Vec<(&str, &str)> =
        outcome.failures.iter().map(|failure| (failure.stage.as_str(), failure.error.message.as_str())).collect();
    assert!(told.contains(&("trials", "it needs `fit-both`, which failed: no machine has its errors")), "{told:?}");
    assert!(
        told.iter().any(|(stage, words)| *stage == "fit-both" && words.starts_with("no machine has such")),
        "{told:?}"
    );
}

/// The row of a file to blame is unknown where rows are means of several files: the message says so.
#[test]
fn a_mean_beyond_the_travel_says_that_it_is_one() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["mfb-ucp710"]).only(&["fit-bar", "fit-sphere-drift"]);
    let data = recipe.path("centres", "path").parent().expect("a folder").to_owned();
    for number in 1..=10 {
        let name = format!("sphere-{number}.csv");
        let text = read(&data.join(&name));
        let wrong = if number == 6 { text.replacen(",304.0137,", ",3040.137,", 1) } else { text.clone() };
        assert_eq!(wrong == text, number != 6, "{name}");
        crate::support::write(&folder.path().join(name), &wrong);
    }
    recipe.set("centres", "path", json!("sphere-*.csv")).write(folder.path());
    let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
    let told = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert_eq!(printed.status, 1, "{told}");
    for words in ["beyond its travel of 0 mm to 500 mm in the mean of several rows", "sphere-1.csv:34"] {
        assert!(told.contains(words), "{words}: {told}");
    }
}
