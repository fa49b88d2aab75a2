//! Readings that are copies, or contradict what is beside them, and results that say so.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::misread::changed;
use crate::support::{Random, Variant, abbe, read, recipes, temporary, write};

/// What a run says in its JSON, and its status.
fn summary(recipe: &Variant, folder: &Path) -> (i32, Value) {
    let file = recipe.write(folder);
    let out = folder.join("out");
    let printed =
        abbe(folder, &["run".as_ref(), file.as_os_str(), "--json".as_ref(), "--out".as_ref(), out.as_os_str()]);
    assert!(printed.stdout.contains("\"remarks\""), "{}{}", printed.stdout, printed.stderr);
    (printed.status, serde_json::from_str(&printed.stdout).expect("JSON"))
}

fn texts(remarks: &Value) -> Vec<&str> {
    remarks.as_array().expect("remarks").iter().map(|remark| remark["text"].as_str().expect("a text")).collect()
}

/// A copy of a table with more rows: `more` makes them of the cells of its rows, by the names of their columns.
fn with_more(file: &Path, folder: &Path, more: impl Fn(usize, &str, &str) -> String) -> PathBuf {
    let text = read(file);
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let mut copy = text.trim_end().to_owned() + "\n";
    for (row, line) in lines.enumerate() {
        let cells = names.iter().zip(line.split(',')).map(|(name, cell)| more(row, name, cell));
        copy.push_str(&(cells.collect::<Vec<_>>().join(",") + "\n"));
    }
    let file = folder.join("copied.csv");
    write(&file, &copy);
    file
}

#[test]
fn rows_that_are_copied_with_other_times_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let (_, as_it_was) = summary(&recipe, folder.path());
    assert!(!texts(&as_it_was["remarks"]).iter().any(|text| text.contains("copies")), "{as_it_was}");
    let later = |row: usize, name: &str, cell: &str| match name {
        "time_s" => format!("{}", cell.parse::<f64>().expect("a time") + 9000.0),
        "touch" => format!("{}", 1000 + row),
        _ => cell.to_owned(),
    };
    recipe.stage("touches")["path"] = json!(with_more(&recipe.path("touches", "path"), folder.path(), later));
    let (status, found) = summary(&recipe, folder.path());
    let said = texts(&found["remarks"]);
    assert_eq!(status, 0, "{found}");
    assert!(said.iter().any(|text| text.contains("are those of earlier ones to the last digit")), "{said:?}");
    // A row that is measured again reads a little different.
    let measured = |row: usize, name: &str, cell: &str| match name {
        "X_mm" | "Y_mm" | "Z_mm" => format!("{}", cell.parse::<f64>().expect("a position") + 1e-4 * (row % 3) as f64),
        _ => later(row, name, cell),
    };
    let mut again = Variant::of(&recipes()["first-steps"]);
    again.stage("touches")["path"] = json!(with_more(&again.path("touches", "path"), folder.path(), measured));
    let (_, found) = summary(&again, folder.path());
    assert!(!texts(&found["remarks"]).iter().any(|text| text.contains("copies")), "{found}");
}

#[test]
fn repetitions_without_scatter_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["tango-uncertainty"]).only(&["by-cycle"]);
    for stage in ["all-touches", "all-lengths"] {
        // One cycle, twenty times.
        let text = read(&recipe.path(stage, "path"));
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let header = lines.next().expect("a header");
        let names: Vec<&str> = header.split(',').collect();
        let place = |wanted: &str| names.iter().position(|name| *name == wanted).expect("the column");
        let (day, cycle) = (place("day"), place("cycle"));
        let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
        let one = rows.iter().filter(|cells| (cells[day], cells[cycle]) == ("3", "3"));
        let mut copy = header.to_owned() + "\n";
        for number in 0..20 {
            for cells in one.clone() {
                let [in_day, in_cycle] = [(number / 4 + 1).to_string(), (number % 4 + 1).to_string()];
                let mut cells = cells.clone();
                (cells[day], cells[cycle]) = (&in_day, &in_cycle);
                copy.push_str(&(cells.join(",") + "\n"));
            }
        }
        let file = folder.path().join(format!("{stage}.csv"));
        write(&file, &copy);
        recipe.stage(stage)["path"] = json!(file);
    }
    let (_, found) = summary(&recipe, folder.path());
    let said = texts(&found["remarks"]);
    assert_eq!(said.iter().filter(|text| text.contains("their scatter tells no uncertainty")).count(), 2, "{said:?}");
}

#[test]
fn readings_that_are_half_of_what_they_were_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["ballbar-c600u"]).only(&["fit"]);
    let test = &mut recipe.stage("samples")["tests"][0]["file"];
    let file = PathBuf::from(test.as_str().expect("a path"));
    let half = changed(&file, folder.path(), "reading_um", |_, cell| {
        format!("{}", 0.5 * cell.parse::<f64>().expect("a reading"))
    });
    *test = json!(half);
    let (_, found) = summary(&recipe, folder.path());
    let said = texts(&found["remarks"]);
    assert!(said.iter().any(|text| text.contains("about half of those of other files")), "{said:?}");
}

#[test]
fn bodies_that_shrink_as_they_warm_fail() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["warming-days"]).only(&["month"]);
    recipe.stage("month").as_object_mut().expect("settings").remove("select");
    recipe.stage("month")["parameters"] = json!(["EXX[1*T_nut:1]", "time_constant[1]_s", "body[scale].factor"]);
    recipe.stage("axis")["bodies"]["scale"]["expansion_per_K"] = json!(-8.0e-6);
    let (status, found) = summary(&recipe, folder.path());
    assert_eq!(status, 1, "{found}");
    assert!(found["failures"].to_string().contains("would act the other way round"), "{}", found["failures"]);
}

#[test]
fn a_cmm_in_another_unit_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["tango-hu40t"]).only(&["fit-S3", "artefact", "tips"]);
    let file = recipe.path("artefact", "cmm");
    for (times, is_told) in [(1.0, false), (-1.0, true), (1000.0, true)] {
        let own = folder.path().join(format!("{times}"));
        fs::create_dir(&own).expect("a folder");
        let other =
            changed(&file, &own, "d_um", |_, cell| format!("{}", times * cell.parse::<f64>().expect("a number")));
        for stage in ["artefact", "tips"] {
            recipe.stage(stage)["cmm"] = json!(other);
        }
        let (_, found) = summary(&recipe, &own);
        let verdicts = found["verdicts"].to_string();
        let words = if times < 0.0 { "with the other sign" } else { "divided by 1000" };
        let told = verdicts.matches(&format!("with the offsets of the CMM file {words}")).count();
        assert_eq!(told, if is_told { 2 } else { 0 }, "{times}: {verdicts}");
    }
}

#[test]
fn a_verification_of_the_baseline_with_itself_is_told() {
    let mut recipe = Variant::of(&recipes()["before-the-cut"]).only(&["calibrated", "verify"]);
    let told = |recipe: &Variant| {
        let remarks = recipe.run().verdicts.into_iter().flat_map(|verdict| verdict.remarks);
        remarks.filter(|text| text.contains("is it a copy of that file")).count()
    };
    assert_eq!(told(&recipe), 0);
    recipe.stage("today")["path"] = json!(recipe.path("baseline", "path"));
    assert_eq!(told(&recipe), 1);
    // One reading that differs by the resolution is a measurement.
    let folder = temporary();
    let other = |row: usize, cell: &str| match row {
        0 => format!("{:.4}", cell.parse::<f64>().expect("a reading") + 1e-4),
        _ => cell.to_owned(),
    };
    recipe.stage("today")["path"] =
        json!(changed(&recipe.path("baseline", "path"), folder.path(), "measured_mm", other));
    assert_eq!(told(&recipe), 0);
}

#[test]
fn a_history_whose_tests_are_all_rejected_fails() {
    let mut recipe = Variant::of(&recipes()["history"]);
    recipe.stage("bar")["standard_uncertainty_um"] = json!(0.07);
    let outcome = recipe.run();
    assert!(!outcome.passes());
    let remarks: Vec<String> = outcome.verdicts.into_iter().flat_map(|verdict| verdict.remarks).collect();
    assert!(remarks.iter().any(|text| text.contains("nothing is known of the machine")), "{remarks:?}");
}

#[test]
fn statements_that_the_data_contradict_are_told_or_fail() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["warming-days"]).only(&["month"]);
    // Right; steel for glass; a digit too many.
    for (expansion, status, is_told) in [(8.0e-6, 0, false), (11.5e-6, 0, true), (8.0e-5, 1, false)] {
        recipe.stage("axis")["bodies"]["scale"]["expansion_per_K"] = json!(expansion);
        let (found, said) = summary(&recipe, folder.path());
        assert_eq!(found, status, "{expansion}: {said}");
        let told = texts(&said["remarks"]).iter().any(|text| text.contains("is the statement right?"));
        assert_eq!(told, is_told, "{expansion}: {said}");
        assert_eq!(said["failures"].to_string().contains("one of two must be wrong"), status == 1, "{said}");
    }
}

#[test]
fn a_sphere_whose_radius_is_stated_as_its_diameter_is_told() {
    let mut recipe = Variant::of(&recipes()["sphere-hu40t"]);
    for (diameter, is_told) in [(19.05, false), (9.525, true), (38.1, true)] {
        recipe.stage("validation-set")["diameter_mm"] = json!(diameter);
        let remarks: Vec<String> = recipe.run().verdicts.into_iter().flat_map(|verdict| verdict.remarks).collect();
        assert_eq!(
            remarks.iter().any(|text| text.contains("is the radius stated") || text.contains("is the diameter stated")),
            is_told,
            "{remarks:?}"
        );
    }
}

/// Another bar makes other scales, which the CMM that measured the same table contradicts.
#[test]
fn a_certificate_that_a_cmm_contradicts_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["tango-hu40t"]).only(&["fit-S3", "artefact"]);
    let told = |recipe: &Variant| {
        let remarks = recipe.run().verdicts.into_iter().flat_map(|verdict| verdict.remarks);
        remarks.filter(|text| text.contains("belong to another artefact")).count()
    };
    assert_eq!(told(&recipe), 0);
    let shorter = |_: usize, cell: &str| format!("{}", cell.parse::<f64>().expect("a length") - 0.1);
    let other = changed(&recipe.path("bar-runs", "path"), folder.path(), "reference_mm", shorter);
    recipe.stage("bar-runs")["path"] = json!(other);
    assert_eq!(told(&recipe), 1);
}

/// What was touched at one indexation in the place of another: the hold-out would predict what was fitted.
#[test]
fn runs_that_are_copied_under_other_labels_are_told() {
    let folder = temporary();
    let told = |recipe: &Variant, folder: &Path| {
        let (_, found) = summary(recipe, folder);
        texts(&found["remarks"]).iter().filter(|text| text.contains("under other labels")).count()
    };
    let mut recipe = Variant::of(&recipes()["samba"]).only(&["fit-all"]);
    assert_eq!(told(&recipe, folder.path()), 0);
    let file = recipe.path("touches", "path");
    let text = read(&file);
    let header = text.lines().find(|line| !line.starts_with('#')).expect("a header");
    let place = |wanted: &str| header.split(',').position(|name| name == wanted).expect("the column");
    let of_group = |group: &str| -> Vec<Vec<String>> {
        let rows = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        rows.filter(|cells| cells.get(place("group")).is_some_and(|own| own == group)).collect()
    };
    let (from, into) = (of_group("3"), of_group("9"));
    let mut copy = String::new();
    for line in text.lines() {
        let cells: Vec<&str> = line.split(',').collect();
        let row = into.iter().position(|other| other.iter().map(String::as_str).eq(cells.iter().copied()));
        match row.and_then(|row| from.get(row)) {
            Some(other) => {
                let mut other = other.clone();
                for kept in ["touch", "time_s", "group"] {
                    other[place(kept)] = cells[place(kept)].to_owned();
                }
                copy.push_str(&(other.join(",") + "\n"));
            }
            None => copy.push_str(&(line.to_owned() + "\n")),
        }
    }
    let other = folder.path().join("touches.csv");
    write(&other, &copy);
    recipe.stage("touches")["path"] = json!(other);
    assert_eq!(told(&recipe, folder.path()), 1);
}

/// All runs of a laser are its first one; then with a reading whose digits are coarser than it scatters.
#[test]
fn runs_of_a_laser_that_are_copied_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&["fit-angles", "fit-lengths"]);
    let list = recipe.stage("length-files")["path"].as_array().expect("a list").clone();
    let place =
        list.iter().position(|file| file.as_str().is_some_and(|file| file.ends_with("EZZ.csv"))).expect("a file");
    let file = PathBuf::from(list[place].as_str().expect("a path"));
    let mut told = |digits: usize, copied: bool| {
        let first = std::cell::RefCell::new(Vec::new());
        let rows = read(&file).lines().filter(|line| line.starts_with("1,")).count();
        let other = changed(&file, folder.path(), "reading_um", |row, cell| {
            let reading = format!("{:.digits$}", cell.parse::<f64>().expect("a reading"));
            let mut first = first.borrow_mut();
            if row < rows {
                first.push(reading.clone());
            }
            if copied { first[row % rows].clone() } else { reading }
        });
        recipe.stage("length-files")["path"][place] = json!(other);
        let (_, found) = summary(&recipe, folder.path());
        texts(&found["remarks"]).iter().filter(|text| text.contains("under other labels")).count()
    };
    assert_eq!(told(4, false), 0);
    assert_eq!(told(4, true), 1);
    assert_eq!(told(0, false), 0);
}

/// Touches in two files that two stages read: apart, and with rows of the first in the second.
#[test]
fn rows_that_are_copied_into_the_file_of_another_stage_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["first-steps"]);
    let text = read(&recipe.path("touches", "path"));
    let mut lines: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
    let header = lines.remove(0);
    let (first, second) = lines.split_at(lines.len() / 2);
    let file = |name: &str, rows: &[&str]| {
        let file = folder.path().join(name);
        write(&file, &format!("{header}\n{}\n", rows.join("\n")));
        json!(file)
    };
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    let [mut touches, mut table] = ["touches", "table"].map(|name| stages[name].clone());
    touches["path"] = file("second.csv", second);
    table["from"] = json!("again");
    stages.insert("again".to_owned(), touches);
    stages.insert("table-again".to_owned(), table);
    recipe.stage("touches")["path"] = file("first.csv", first);
    recipe.stage("fit")["observations"] = json!(["table", "table-again"]);
    recipe.stage("fit")["parameters"].as_array_mut().expect("a list").push(json!("table-again.*"));
    let told = |recipe: &Variant| {
        let (_, found) = summary(recipe, folder.path());
        let told = |text: &&&str| text.contains("table and table-again: 30 rows have the same numbers");
        texts(&found["remarks"]).iter().filter(told).count()
    };
    assert_eq!(told(&recipe), 0);
    recipe.stage("again")["path"] = file("copied.csv", &[&second[..20], &first[40..70], &second[50..]].concat());
    assert_eq!(told(&recipe), 1);
}

/// Copies within the file of one stage are not told as those of another stage, which reads a file with the same columns.
#[test]
fn rows_that_are_copied_within_the_file_of_one_of_two_stages_are_told() {
    let recipe = Variant::of(&recipes()["cylinder-kx8"]).only(&["fit-both"]);
    for seed in 0..4 {
        let mut random = Random::new(seed);
        let folder = temporary();
        let stage = ["touches-s1", "touches-s2"][seed as usize % 2];
        let text = read(&recipe.path(stage, "path"));
        let rows: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).skip(1).collect();
        let count = 10 + random.below(30);
        let first = random.below(rows.len() - count);
        let block = rows[first..first + count].join("\n");
        write(&folder.path().join("copied.csv"), &format!("{}\n{block}\n", text.trim_end()));
        let recipe = recipe.clone().set(stage, "path", json!(folder.path().join("copied.csv")));
        let (_, found) = summary(&recipe, folder.path());
        let said = texts(&found["remarks"]);
        let rows = format!("{count} rows are in the data twice");
        assert!(said.iter().any(|text| text.contains(&rows)), "{seed}: {count} rows of {stage}: {said:?}");
        assert!(!said.iter().any(|text| text.contains("s1 and s2")), "{seed}: {said:?}");
    }
}

/// Files that were exchanged, and a certificate of another sphere, where the residuals of all rows stay near what is stated.
#[test]
fn files_whose_residuals_stand_out_are_told() {
    let folder = temporary();
    let told = |recipe: &Variant| -> Vec<String> {
        let (_, found) = summary(recipe, folder.path());
        let said: Vec<String> = texts(&found["remarks"]).into_iter().map(str::to_owned).collect();
        said.into_iter().filter(|text| text.contains("is it the right file")).collect()
    };
    for (only, stage, pair) in
        [("fit-angles", "angle-files", ["EBX.csv", "ECX.csv"]), ("fit", "length-files", ["EYX.csv", "EZX.csv"])]
    {
        let mut recipe = Variant::of(&recipes()["mill-direct"]).only(&[only]);
        assert_eq!(told(&recipe), Vec::<String>::new());
        let list = recipe.stage(stage)["path"].as_array().expect("a list").clone();
        let [one, other] = pair.map(|name| {
            let file = list.iter().filter_map(Value::as_str).find(|file| file.ends_with(name));
            PathBuf::from(file.expect("the file"))
        });
        for (of, from) in [(&one, &other), (&other, &one)] {
            let copy = folder.path().join(of.file_name().expect("a name"));
            fs::copy(from, &copy).expect("a copy");
            let place = list.iter().position(|file| file.as_str() == of.to_str()).expect("its place");
            recipe.stage(stage)["path"][place] = json!(copy);
        }
        let said = told(&recipe);
        assert!(said.iter().any(|text| pair.iter().any(|name| text.contains(name))), "{said:?}");
    }
    let mut recipe = Variant::of(&recipes()["probe-lobing"]).only(&["joint"]);
    assert_eq!(told(&recipe), Vec::<String>::new());
    let certificate = changed(&recipe.path("sphere", "nominal"), folder.path(), "diameter_mm", |_, cell| match cell {
        "24.998630" => "24.988630".to_owned(),
        _ => cell.to_owned(),
    });
    recipe.stage("sphere")["nominal"] = json!(certificate);
    let said = told(&recipe);
    assert!(said.iter().any(|text| text.contains("residuals of bar in")), "{said:?}");
}

#[test]
fn poses_in_centimetres_are_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["positioner"]);
    let told = |recipe: &Variant| {
        let (_, found) = summary(recipe, folder.path());
        texts(&found["remarks"]).iter().any(|text| text.contains("is the unit of the lengths right?"))
    };
    assert!(!told(&recipe));
    for column in ["x_mm", "y_mm", "z_mm"] {
        let tenth = |_: usize, cell: &str| format!("{}", 0.1 * cell.parse::<f64>().expect("a number"));
        let other = changed(&recipe.path("seen", "path"), folder.path(), column, tenth);
        recipe.stage("seen")["path"] = json!(other);
    }
    assert!(told(&recipe));
}

#[test]
fn results_that_were_changed_are_neither_shown_nor_kept() {
    let folder = temporary();
    let recipe = Variant::of(&recipes()["first-steps"]);
    let (_, _) = summary(&recipe, folder.path());
    let results =
        fs::read_dir(folder.path().join("out")).expect("results").next().expect("a folder").expect("it").path();
    let calibration = fs::read_dir(&results)
        .expect("results")
        .map(|entry| entry.expect("a file").path())
        .find(|file| file.to_string_lossy().ends_with(".calibration.json"))
        .expect("a calibration");
    let commands = [vec!["report", "R", "--out", "page.html"], vec!["history", "add", "h.db", "R"]];
    let say = |command: &[&str]| {
        let results = results.to_string_lossy().into_owned();
        let words: Vec<&str> = command.iter().map(|word| if *word == "R" { results.as_str() } else { word }).collect();
        let printed = abbe(folder.path(), &words);
        (printed.status, printed.stderr)
    };
    let text = read(&calibration);
    write(&calibration, &text.replacen("\"value\":", "\"value\": 1", 1));
    for command in &commands {
        let (status, said) = say(command);
        assert_eq!(status, 1, "{command:?}: {said}");
        assert!(said.contains("not as the run wrote it") && said.contains(".calibration.json"), "{said}");
    }
    assert!(!folder.path().join("page.html").exists() && !folder.path().join("h.db").exists());
    write(&calibration, &text);
    for command in &commands {
        let (status, said) = say(command);
        assert_eq!(status, 0, "{command:?}: {said}");
    }
}

/// Rows of an estimate that somebody has pasted into the file that a validator judges it by.
#[test]
fn rows_of_the_fit_in_a_file_that_judges_it_are_told() {
    let words = "unseen: `fit` was estimated from rows that it is judged by here: 6 rows are the same in every column that both have";
    let said = |pasted: usize| {
        let folder = temporary();
        let mut recipe = Variant::of(&recipes()["cmm-checking-gauge"]);
        let (seen, judged) = (read(&recipe.path("along-y", "path")), read(&recipe.path("other-beams", "path")));
        let rows: Vec<&str> = seen.lines().filter(|line| !line.starts_with('#')).skip(1).take(pasted).collect();
        write(&folder.path().join("judged.csv"), &format!("{}\n{}\n", judged.trim_end(), rows.join("\n")));
        recipe.stage("other-beams")["path"] = json!(folder.path().join("judged.csv"));
        let file = recipe.write(folder.path());
        let out = folder.path().join("out");
        abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]).stderr
    };
    let told = said(6);
    let told = told.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert!(told.contains(words) && told.contains("judged.csv:"), "{told}");
    assert!(!said(0).contains("estimated from rows"));
}

/// Rows of the fit where others are to judge it: the same stage, the same file, and a part of it under another name.
#[test]
fn spheres_of_the_fit_that_judge_it_are_told() {
    let words = "was estimated from rows that it is judged by here";
    let told = |change: &dyn Fn(&mut Variant, &Path)| {
        let (folder, mut recipe) =
            (temporary(), Variant::of(&recipes()["sphere-hu40t"]).only(&["fit", "validation-set"]));
        change(&mut recipe, folder.path());
        let remarks: Vec<String> = recipe.run().verdicts.into_iter().flat_map(|verdict| verdict.remarks).collect();
        remarks.iter().filter(|text| text.contains(words)).count()
    };
    assert_eq!(told(&|_, _| ()), 0);
    assert_eq!(told(&|recipe, _| recipe.stage("validation-set")["from"] = json!("strategy-1")), 1);
    assert_eq!(told(&|recipe, _| recipe.stage("strategy-2")["path"] = json!(recipe.path("strategy-1", "path"))), 1);
    for kept in [200, 6] {
        let pasted = |recipe: &mut Variant, folder: &Path| {
            let [of_fit, own] = ["strategy-1", "strategy-2"].map(|stage| read(&recipe.path(stage, "path")));
            let from: Vec<&str> = of_fit.lines().skip(10).take(kept).collect();
            let mut lines: Vec<&str> = own.lines().collect();
            let first = 20;
            lines.splice(first..first + kept, from);
            write(&folder.join("pasted.csv"), &(lines.join("\n") + "\n"));
            recipe.stage("strategy-2")["path"] = json!(folder.join("pasted.csv"));
        };
        assert_eq!(told(&pasted), 1, "{kept}");
    }
}

/// A run of an arc in the place of the other one, row for row: digits that repeat near its ends explain nothing.
#[test]
fn a_copied_run_of_an_arc_is_told() {
    let folder = temporary();
    let mut recipe = Variant::of(&recipes()["standards-circular"]);
    let verdicts = |recipe: &Variant| {
        let folder = temporary();
        summary(recipe, folder.path()).1["verdicts"].to_string()
    };
    assert!(!verdicts(&recipe).contains("are they copies?"));
    let file = recipe.path("arc", "path");
    let text = read(&file);
    let rows: Vec<Vec<&str>> =
        text.lines().filter(|line| !line.starts_with('#')).map(|line| line.split(',').collect()).collect();
    let place = |name: &str| rows[0].iter().position(|own| *own == name).expect("a column");
    let (run, reading) = (place("run"), place("reading_um"));
    let first: Vec<&str> = rows.iter().filter(|row| row[run] == "1").map(|row| row[reading]).collect();
    let others = rows[1..].iter().position(|row| row[run] == "2").expect("a second run");
    let copy = |row: usize, cell: &str| match row.checked_sub(others) {
        Some(of) => (*first.get(of).unwrap_or(&cell)).to_owned(),
        None => cell.to_owned(),
    };
    recipe.stage("arc")["path"] = json!(changed(&file, folder.path(), "reading_um", copy));
    let said = verdicts(&recipe);
    assert!(said.contains("are they copies?"), "{said}");
}
