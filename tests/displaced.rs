//! Readings and points that are all in another unit, mirrored, or beside their place: told where others of the same test contradict them.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::misread::changed;
use crate::support::{Printed, Variant, abbe, read, recipes, temporary, write};

/// What is done to the rows of a file, given its header.
type Change<'a> = &'a dyn Fn(&[String], &mut Vec<Vec<String>>);

/// What a run says: warnings, remarks, those of verdicts and failures, in one line.
fn run(recipe: &Variant) -> (Printed, String) {
    let folder = temporary();
    let file = recipe.write(folder.path());
    let arguments = ["run".as_ref(), file.as_os_str(), "--json".as_ref(), "--out".as_ref(), "out".as_ref()];
    let printed = abbe(folder.path(), &arguments);
    let found: Value = serde_json::from_str(&printed.stdout).unwrap_or_default();
    let remarks = found["verdicts"].as_array().into_iter().flatten().map(|verdict| verdict["remarks"].to_string());
    let all = ["remarks", "failures", "error"].map(|key| found[key].to_string());
    let all: Vec<String> = all.into_iter().chain(remarks).chain([printed.stderr.replace('│', " ")]).collect();
    let said = all.join(" ").split_whitespace().collect::<Vec<_>>().join(" ");
    (printed, said)
}

fn times(factor: f64) -> impl Fn(usize, &str) -> String {
    move |_, cell| format!("{}", factor * cell.parse::<f64>().expect("a number"))
}

/// A copy of a table with other rows.
fn with_rows(file: &Path, folder: &Path, change: Change<'_>) -> PathBuf {
    let text = read(file);
    let is_head = |line: &&str| line.starts_with('#');
    let mut lines = text.lines().skip_while(is_head);
    let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<String>>();
    let header = cells(lines.next().expect("a header"));
    let mut rows: Vec<Vec<String>> = lines.map(cells).collect();
    change(&header, &mut rows);
    let all: Vec<String> = std::iter::once(&header).chain(&rows).map(|row| row.join(",")).collect();
    let path = folder.join(file.file_name().expect("a name"));
    write(&path, &(all.join("\n") + "\n"));
    path
}

fn place(header: &[String], name: &str) -> usize {
    header.iter().position(|own| own == name).unwrap_or_else(|| panic!("no column {name}"))
}

fn add(cell: &mut String, by: f64) {
    *cell = format!("{:.6}", cell.parse::<f64>().expect("a number") + by);
}

#[test]
fn a_channel_of_an_acceptance_test_in_another_unit_is_named() {
    let words = "is the unit of this channel right?";
    for (name, stages) in [
        ("standards-rotary-interpolation", &["read-c", "read-a"][..]),
        ("standards-interpolation", &["bk1", "bk2", "bk4"]),
    ] {
        let recipe = Variant::of(&recipes()[name]);
        assert!(!run(&recipe).1.contains(words), "{name}");
        for stage in stages {
            let mut told = 0;
            for column in ["meas_x_um", "meas_y_um", "meas_z_um"] {
                for factor in [1.0 / 25.4, 1e-3, 1e3] {
                    let (folder, mut recipe) = (temporary(), recipe.clone());
                    let file = recipe.path(stage, "path");
                    recipe.stage(stage)["path"] = json!(changed(&file, folder.path(), column, times(factor)));
                    let said = run(&recipe).1;
                    let found = said.contains(words);
                    assert!(
                        !found || said.contains(&format!("`{}` scatters", column.trim_end_matches("_um"))),
                        "{said}"
                    );
                    told += usize::from(found);
                }
            }
            assert!(told >= 6, "{name} {stage}: {told} of 9");
        }
    }
}

#[test]
fn a_spindle_with_one_sensor_in_inches_gets_a_hint() {
    let words = "is the unit or the sensitivity of one of them right?";
    let recipe = Variant::of(&recipes()["spindle-motion"]);
    assert!(!run(&recipe).1.contains(words));
    for column in ["r1_um", "r2_um"] {
        for factor in [1.0 / 25.4, 25.4] {
            let (folder, mut recipe) = (temporary(), recipe.clone());
            let file = recipe.path("run-600", "path");
            recipe.stage("run-600")["path"] = json!(changed(&file, folder.path(), column, times(factor)));
            let said = run(&recipe).1;
            assert!(said.contains(words) && said.contains("a factor near 25.4"), "{column} {factor}: {said}");
        }
    }
}

#[test]
fn a_run_of_a_diagonal_or_an_axis_that_is_off_is_named() {
    let words = "was the zero of the instrument lost";
    for (name, stage, reading) in
        [("standards-diagonals", "ppp", "reading_um"), ("standards-positioning", "linear", "reading_um")]
    {
        let recipe = Variant::of(&recipes()[name]);
        assert!(!run(&recipe).1.contains(words), "{name}");
        for (number, way) in [("1", None), ("3", Some("1")), ("5", None), ("2", Some("-1"))] {
            let (folder, mut recipe) = (temporary(), recipe.clone());
            let off = |header: &[String], rows: &mut Vec<Vec<String>>| {
                let [of_run, direction, reading] = ["run", "direction", reading].map(|name| place(header, name));
                let is_off =
                    |row: &&mut Vec<String>| row[of_run] == number && way.is_none_or(|way| row[direction] == way);
                rows.iter_mut().filter(is_off).for_each(|row| add(&mut row[reading], 40.0));
            };
            let file = with_rows(&recipe.path(stage, "path"), folder.path(), &off);
            recipe.stage(stage)["path"] = json!(file);
            let said = run(&recipe).1;
            assert!(said.contains(words) && said.contains(&format!("run {number} is ")), "{name} {number}: {said}");
            let where_it_is =
                way.map_or("at all targets, and".to_owned(), |way| format!("with `direction` {way}, and"));
            assert!(said.contains(&where_it_is), "{name} {number}: {said}");
        }
    }
}

#[test]
fn readings_a_row_beside_their_positions_are_told() {
    let words = "do readings stand a row beside their positions?";
    for (name, stage, reading) in
        [("standards-diagonals", "ppp", "reading_um"), ("standards-positioning", "linear", "reading_um")]
    {
        let recipe = Variant::of(&recipes()[name]);
        assert!(!run(&recipe).1.contains(words), "{name}");
        let mut told = 0;
        for late in [true, false] {
            let (folder, mut recipe) = (temporary(), recipe.clone());
            let moved = |header: &[String], rows: &mut Vec<Vec<String>>| {
                let reading = place(header, reading);
                let mut all: Vec<String> = rows.iter().map(|row| row[reading].clone()).collect();
                if late {
                    all.rotate_right(1)
                } else {
                    all.rotate_left(1)
                }
                rows.iter_mut().zip(all).for_each(|(row, cell)| row[reading] = cell);
            };
            let file = with_rows(&recipe.path(stage, "path"), folder.path(), &moved);
            recipe.stage(stage)["path"] = json!(file);
            told += usize::from(run(&recipe).1.contains(words));
        }
        // What rows make of this axis is less than five times as large as its lost motion varies: it gets no word.
        let least = usize::from(name == "standards-diagonals");
        assert!(told >= least, "{name}: {told} of 2");
    }
}

#[test]
fn diagonals_of_other_boxes_are_told() {
    let words = "ISO 230-6 compares diagonals of one box";
    let recipe = Variant::of(&recipes()["standards-diagonals"]);
    assert!(!run(&recipe).1.contains(words));
    for stage in ["npp", "xy-pp"] {
        let (folder, mut recipe) = (temporary(), recipe.clone());
        let longer = |header: &[String], rows: &mut Vec<Vec<String>>| {
            for name in ["position_mm", "X_mm", "Y_mm", "Z_mm"] {
                let place = place(header, name);
                for row in rows.iter_mut() {
                    row[place] = format!("{}", 0.8 * row[place].parse::<f64>().expect("a number"));
                }
            }
        };
        let file = with_rows(&recipe.path(stage, "path"), folder.path(), &longer);
        recipe.stage(stage)["path"] = json!(file);
        let said = run(&recipe).1;
        assert!(said.contains(words) && said.contains(&format!("direct-diagonal-{stage}: it goes over")), "{said}");
    }
}

/// Points of a part, in QIF: what no part is, is refused; a run beside the other is told.
#[test]
fn points_of_qif_results_that_are_scaled_or_mirrored_are_refused() {
    let recipe = Variant::of(&recipes()["qif-results"]).only(&["fit", "holes"]);
    let exported = |runs: &[&str], columns: &[&str], change: &dyn Fn(f64) -> f64| {
        let (folder, mut recipe) = (temporary(), recipe.clone());
        let edit = |header: &[String], rows: &mut Vec<Vec<String>>| {
            let of_run = place(header, "run");
            for row in rows.iter_mut().filter(|row| runs.contains(&row[of_run].as_str())) {
                for column in columns {
                    let cell = &mut row[place(header, column)];
                    *cell = format!("{:.7}", change(cell.parse().expect("a number")));
                }
            }
        };
        let file = with_rows(&recipe.path("holes", "path"), folder.path(), &edit);
        recipe.stage("holes")["path"] = json!(file);
        run(&recipe)
    };
    let nominal = ["x_mm", "y_mm", "z_mm"];
    let both = &["1", "2"][..];
    for (columns, factor, what) in [
        (&nominal[..], 25.4, "1/25.4 as far from each other, as in another unit"),
        (&nominal, 1e-3, "1000 times as far from each other, as in another unit"),
        (&nominal[1..2], 1.0 / 25.4, "25.4 times as far from each other along y"),
        (&nominal[..1], -1.0, "mirrored along x"),
        (&nominal[1..2], -1.0, "mirrored along y"),
    ] {
        let (printed, said) = exported(both, columns, &|value| factor * value);
        assert!(printed.status != 0 && said.contains(what) && said.contains("workpiece.csv"), "{what}: {said}");
    }
    // One of two runs alone.
    let (printed, said) = exported(&["2"], &["X_mm"], &|value| 340.0 - value);
    assert!(printed.status != 0 && said.contains("of run `2` are mirrored along x"), "{said}");
    let words = "was the part moved, or a work offset?";
    let (printed, said) = exported(&["2"], &["X_mm"], &|value| value + 1.5);
    assert!(printed.status == 0 && said.contains(words) && said.contains("(1.5"), "{said}");
    // The whole part elsewhere, both runs alike, and a warm part are results.
    for (columns, change) in [
        (&["X_mm"][..], &(|value: f64| value + 1.5) as &dyn Fn(f64) -> f64),
        (&["x_mm"], &|value| value - 200.0),
        (&["X_mm", "Y_mm"], &|value| 1.0002 * value),
        (&[], &|value| value),
    ] {
        let (printed, said) = exported(both, columns, change);
        assert!(printed.status == 0 && !said.contains(words), "{columns:?}: {said}");
    }
}

/// A point that one run found elsewhere than the other, and rows that are there twice.
#[test]
fn points_of_qif_results_that_runs_do_not_share_are_told() {
    let recipe = Variant::of(&recipes()["qif-results"]).only(&["fit", "holes"]);
    let exported = |edit: Change<'_>| {
        let (folder, mut recipe) = (temporary(), recipe.clone());
        let file = with_rows(&recipe.path("holes", "path"), folder.path(), edit);
        recipe.stage("holes")["path"] = json!(file);
        run(&recipe)
    };
    let (elsewhere, twice) = ("is its position right?", "is the row there twice?");
    // A rehearsal says it before the run, because another stage reads these results.
    let told = |said: &str, words: &str| said.matches(words).count() / 2;
    for (rows, by) in [(vec![3], 45.0), (vec![0], 0.05), (vec![1, 2, 4, 6], 45.0)] {
        let (printed, said) = exported(&|header, all| {
            for row in &rows {
                let cell = &mut all[*row][place(header, "X_mm")];
                *cell = format!("{:.7}", cell.parse::<f64>().expect("a number") + by);
            }
        });
        assert_eq!(printed.status, 0, "{said}");
        assert!(told(&said, elsewhere) == rows.len() && !said.contains(twice), "{rows:?}: {said}");
    }
    let (_, said) = exported(&|_, all| all.extend(all[all.len() - 3..].to_vec()));
    assert!(told(&said, twice) == 3 && !said.contains(elsewhere), "{said}");
    let (_, said) = exported(&|_, _| {});
    assert!(!said.contains(twice) && !said.contains(elsewhere), "{said}");
}

/// Readings in another unit explain errors that no machine has: the hint says which readings.
#[test]
fn readings_in_another_unit_are_named_where_errors_are_implausible() {
    let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["mill-direct"]).only(&["fit-angles"]));
    let list = recipe.stage("angle-files")["path"].as_array().expect("a list").clone();
    let place = list.iter().position(|file| file.as_str().is_some_and(|file| file.ends_with("EBX.csv"))).expect("it");
    let file = list[place].as_str().expect("a path");
    recipe.stage("angle-files")["path"][place] =
        json!(changed(Path::new(file), folder.path(), "reading_urad", times(1e3)));
    let said = run(&recipe).1;
    assert!(said.contains("no machine has such errors") && said.contains("EBX.csv` divided by 1000"), "{said}");
}

/// A plane facet fits as well wherever it is touched, and the range of the machine is that of its rows.
#[test]
fn touches_far_from_their_facets_are_told() {
    let words = "far from the nominal place of the feature, the first in";
    for (row, z, is_told) in [(322, "12107.5196", true), (200, "5431.6740", true), (200, "", false)] {
        let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["first-steps"]));
        let file = recipe.path("touches", "path");
        let moved = |own: usize, cell: &str| if own == row && !z.is_empty() { z.to_owned() } else { cell.to_owned() };
        recipe.stage("touches")["path"] = json!(changed(&file, folder.path(), "Z_mm", moved));
        let said = run(&recipe).1;
        assert_eq!(said.contains(words), is_told, "{row}: {said}");
    }
}

/// Touches of one facet with the places of another one are not those of its own.
#[test]
fn a_facet_with_the_touches_of_another_one_is_told() {
    let (copied, onto) = ("26", "24");
    let (folder, mut recipe) = (temporary(), Variant::of(&recipes()["first-steps"]));
    let file = with_rows(&recipe.path("touches", "path"), folder.path(), &|header, rows| {
        let feature = place(header, "feature");
        let mut others: Vec<Vec<String>> = rows.iter().filter(|row| row[feature] == copied).cloned().collect();
        others.reverse();
        for row in rows.iter_mut().filter(|row| row[feature] == onto) {
            let Some(other) = others.pop() else { break };
            for column in (0..header.len()).filter(|column| !["touch", "time_s"].contains(&header[*column].as_str())) {
                row[column].clone_from(&other[column]);
            }
            row[feature] = onto.to_owned();
        }
    });
    recipe.stage("touches")["path"] = json!(file);
    let said = run(&recipe).1;
    assert!(said.contains(&format!("feature {onto} was touched at the nominal place of {copied}")), "{said}");
}

/// What touches do not tell is not told by nominal heights that are off.
#[test]
fn values_that_only_wrong_nominal_places_tell_are_named() {
    let words = "The nominal places may be wrong, and these values are not to be trusted";
    let recipe = Variant::of(&recipes()["cylinder-kx8"]).only(&["fit-section"]);
    let nominal = recipe.path("section", "nominal");
    assert!(!run(&recipe).1.contains(words));
    for (column, change) in [
        ("z_mm", (|row: usize, z: f64| z + 0.3 * (row as f64 * 2.4).sin()) as fn(usize, f64) -> f64),
        ("z_mm", |row, z| if row % 5 == 0 { z + 0.9 } else { z }),
    ] {
        let (folder, mut wrong) = (temporary(), recipe.clone());
        let moved = |row: usize, cell: &str| format!("{:.6}", change(row, cell.parse().expect("a number")));
        wrong.stage("section")["nominal"] = json!(changed(&nominal, folder.path(), column, moved));
        let said = run(&wrong).1;
        assert!(said.contains(words) && said.contains("EA0C"), "{said}");
    }
}

#[test]
fn offsets_of_a_cmm_with_another_sign_or_unit_are_told() {
    let words = "with the offsets of the CMM file";
    let recipe = Variant::of(&recipes()["tango-hu40t"]).only(&["fit-S4", "fit-S4r", "artefact", "tips"]);
    let file = recipe.path("artefact", "cmm");
    assert!(!run(&recipe).1.contains(words));
    for (factor, told) in
        [(-1.0, "with the other sign"), (1.0 / 25.4, "times 25.4"), (25.4, "divided by 25.4"), (1e-3, "times 1000")]
    {
        let (folder, mut wrong) = (temporary(), recipe.clone());
        let file = changed(&file, folder.path(), "d_um", times(factor));
        for stage in ["artefact", "tips"] {
            wrong.stage(stage)["cmm"] = json!(file);
        }
        let said = run(&wrong).1;
        assert!(said.matches(&format!("{words} {told}")).count() >= 4, "{factor}: {said}");
    }
}

#[test]
fn a_bar_that_contradicts_itself_is_told() {
    let recipe = Variant::of(&recipes()["tango-uncertainty"]).only(&["all"]);
    let words = ["one length has no two", "was it measured?", "the residuals of bar-all"];
    let said = run(&recipe).1;
    assert!(words.iter().all(|words| !said.contains(words)), "{said}");
    let file = recipe.path("all-lengths", "path");
    let with = |column: &str, change: &dyn Fn(usize, &str) -> String| {
        let (folder, mut recipe) = (temporary(), recipe.clone());
        recipe.stage("all-lengths")["path"] = json!(changed(&file, folder.path(), column, change));
        run(&recipe).1
    };
    let of_a_day = |row: usize, cell: &str| match row / 4 == 2 {
        true => format!("{:.4}", cell.parse::<f64>().expect("a number") + 0.1),
        false => cell.to_owned(),
    };
    let said = with("reference_mm", &of_a_day);
    assert!(said.contains(words[0]) && said.contains(words[2]), "{said}");
    assert!(with("X1_mm", &of_a_day).contains(words[2]));
    for column in ["X1_mm", "X2_mm"] {
        let said = with(column, &|_, _| "-152.16654".to_owned());
        assert!(said.contains(words[1]), "{column}: {said}");
    }
}

#[test]
fn ends_of_repeated_lengths_that_are_elsewhere_are_told() {
    let words = "are columns or rows exchanged?";
    let recipe = Variant::of(&recipes()["standards-cmm"]);
    assert!(!run(&recipe).1.contains(words));
    let (folder, mut wrong) = (temporary(), recipe.clone());
    let file = recipe.path("repeats", "path");
    let off = |_: usize, cell: &str| format!("{}", cell.parse::<f64>().expect("a number") + 40.0);
    wrong.stage("repeats")["path"] = json!(changed(&file, folder.path(), "X1_mm", off));
    assert!(run(&wrong).1.contains(words));
}

/// A ball whose radius or whose stylus is another one is missed by the same everywhere.
#[test]
fn a_stylus_of_twice_the_radius_is_asked_about() {
    let recipe = Variant::of(&recipes()["sphere-hu40t"]);
    let words = "as with another radius of the stylus";
    assert!(!run(&recipe).1.contains(words));
    let (folder, mut wrong) = (temporary(), recipe.clone());
    let file = recipe.path("hu40t", "file");
    let text = read(&file);
    let copy = folder.path().join("machine.yaml");
    write(&copy, &text.replace("stylus_radius_mm: 3", "stylus_radius_mm: 6"));
    assert_ne!(read(&copy), text);
    wrong.stage("hu40t")["file"] = json!(copy);
    assert!(run(&wrong).1.contains(words), "{}", run(&wrong).1);
}

/// A laser that reads from the other end, turned directions and times that run backwards in one of many files of an estimate.
#[test]
fn a_line_that_runs_the_other_way_round_is_told() {
    let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles", "fit-lengths"]);
    let words = ["the axes move against `dir_Y`", "the time falls from row to row"];
    let said = run(&recipe).1;
    assert!(words.iter().all(|words| !said.contains(words)), "{said}");
    let files = recipe.stage("length-files")["path"].as_array().expect("a list").clone();
    let at = files.iter().position(|file| file.as_str().is_some_and(|file| file.ends_with("EYY.csv"))).expect("it");
    let file = PathBuf::from(files[at].as_str().expect("a path"));
    let with = |column: &str, change: &dyn Fn(f64) -> f64| {
        let (folder, mut wrong) = (temporary(), recipe.clone());
        let change = |_: usize, cell: &str| format!("{}", change(cell.parse().expect("a number")));
        wrong.stage("length-files")["path"][at] = json!(changed(&file, folder.path(), column, change));
        run(&wrong).1
    };
    let said = with("position_mm", &|position| 500.0 - position);
    assert!(said.contains(words[0]) && said.contains("direct-EYY.csv"), "{said}");
    assert!(with("direction", &|direction| -direction).contains(words[0]));
    assert!(with("time_s", &|time| -time).contains(words[1]));
}

#[test]
fn a_copied_run_of_qif_points_and_a_contradicting_unit_are_told() {
    let recipe = Variant::of(&recipes()["qif-results"]);
    let words = "to the last digit: was it copied?";
    assert!(!run(&recipe).1.contains(words));
    let (folder, mut wrong) = (temporary(), recipe.clone());
    let copied = |header: &[String], rows: &mut Vec<Vec<String>>| {
        let [run, feature] = ["run", "feature"].map(|name| place(header, name));
        let first: Vec<Vec<String>> = rows.iter().filter(|row| row[run] == "1").cloned().collect();
        for row in rows.iter_mut().filter(|row| row[run] == "2") {
            if let Some(of) = first.iter().find(|of| of[feature] == row[feature]) {
                ["X_mm", "Y_mm", "Z_mm"]
                    .map(|name| place(header, name))
                    .into_iter()
                    .for_each(|at| row[at].clone_from(&of[at]));
            }
        }
    };
    wrong.stage("holes")["path"] = json!(with_rows(&recipe.path("holes", "path"), folder.path(), &copied));
    assert!(run(&wrong).1.contains(words), "{}", run(&wrong).1);
    let (folder, mut wrong) = (temporary(), recipe.clone());
    let text = read(&recipe.path("read-back", "path")).replace("<UnitName>mm<", "<UnitName>inch<");
    let file = folder.path().join("results.qif");
    write(&file, &text);
    wrong.stage("read-back")["path"] = json!(file);
    let (printed, said) = run(&wrong);
    assert!(printed.status != 0 && said.contains("the UnitName is inch"), "{said}");
}
