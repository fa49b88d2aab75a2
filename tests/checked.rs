//! A check says what a run would say: names that only data know, columns that are missing, settings that nothing reads.

use serde_json::json;

use crate::support::{Printed, SMALL, Small, Variant, abbe, read, recipes, temporary, write};

/// What a program says, without the frames and breaks of its lines.
fn said(printed: &Printed) -> String {
    let text = format!("{} {}", printed.stdout, printed.stderr).replace(['│', '╰', '─', '╭'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A recipe that a run refuses, and what it says of it.
fn both_say(case: &str, at: &std::path::Path, words: &[&str], status: i32) {
    let [check, run] =
        [&["check", "recipe.yaml"][..], &["run", "recipe.yaml", "--out", "out"]].map(|arguments| abbe(at, arguments));
    for (command, printed) in [("check", &check), ("run", &run)] {
        let text = said(printed);
        for word in words {
            assert!(text.contains(word), "{case}: {command} does not say `{word}`: {text}");
        }
        assert_eq!(printed.status, status, "{case}: {command}: {text}");
    }
}

#[test]
fn names_that_no_row_has_are_told_by_a_check() {
    let small = Small::new();
    let unseen = "  unseen:  { validate: hold-out, of: fine, rows: table, column: group, folds: [[2], [3]] }";
    assert!(SMALL.contains(unseen));
    let hold_out = |folds: &str| unseen.replace("[[2], [3]]", folds);
    for (case, stage, words) in [
        ("a label", hold_out("[[2], [-11]]"), &["no row of `table` has the group -11", "recipe.yaml:"][..]),
        ("a label that is near", hold_out("[[2], [33]]"), &["no row of `table` has the group 33"]),
        ("too many folds", hold_out("5000"), &["5000 folds were asked for"]),
        (
            "one repeat",
            "  unseen: { validate: repeats, of: fine, by: round }".to_owned(),
            &["the column `round` has 1 label", "two repeats or more were expected"],
        ),
    ] {
        let round = SMALL.replace("path: data/touches.csv", "path: data/touches.csv, constants: { round: first }");
        small.write("recipe.yaml", &round.replace(unseen, &stage));
        both_say(case, small.folder.path(), words, 1);
    }
    // As it stands, nobody says a word.
    small.write("recipe.yaml", SMALL);
    assert_eq!(small.abbe(&["check", "recipe.yaml"]).status, 0);
}

#[test]
fn names_of_runs_and_estimates_of_a_spindle_are_told_by_a_check() {
    let folder = temporary();
    let spindle = || Variant::of(&recipes()["spindle-motion-exact"]);
    for (setting, value, words, status) in [
        ("last", json!("xyzzy"), &["`xyzzy` is not among the estimates under `of`", "recipe.yaml:"][..], 2),
        ("last", json!("reversl"), &["did you mean `reversal`?"], 2),
        ("last", json!("reversal"), &["`reversal` is no estimate of `spindle-motion` under `of`"], 2),
        ("runs", json!(["601"]), &["has no run `601`; its runs are 600, 3000, 9000"], 2),
    ] {
        let at = folder.path();
        std::fs::rename(spindle().set("spindle", setting, value).write(at), at.join("recipe.yaml")).expect("a recipe");
        let check = abbe(at, &["check", "recipe.yaml"]);
        let run = abbe(at, &["run", "recipe.yaml", "--out", "out"]);
        for word in words {
            assert!(
                said(&check).contains(word) && said(&run).contains(word),
                "{word}: {} {}",
                said(&check),
                said(&run)
            );
        }
        assert!(check.status == status && run.status != 0, "{setting}: {} {}", check.status, run.status);
    }
    let at = folder.path();
    let tools = Variant::of(&recipes()["tool-check-exact"]).set("before-the-cut", "tools", json!([1, 77]));
    std::fs::rename(tools.write(at), at.join("recipe.yaml")).expect("a recipe");
    let [check, run] =
        [&["check", "recipe.yaml"][..], &["run", "recipe.yaml", "--out", "out"]].map(|all| abbe(at, all));
    for printed in [&check, &run] {
        assert!(printed.status != 0 && said(printed).contains("77"), "{}", said(printed));
    }
}

/// Each case has the setting and its value, the place of the value, and the file that lacks it.
#[test]
fn a_missing_column_is_told_with_its_setting_its_line_and_its_file() {
    let small = Small::new();
    let (touches, table) = ("  touches: { ingest: csv, path: data/touches.csv }", "  table:   {");
    let rows = "nominal: data/facets.csv, standard_uncertainty_um: 1.6";
    let last = "  unseen:  { validate: hold-out, of: fine, rows: table, column: group, folds: [[2], [3]] }";
    assert!([touches, table, rows, last].iter().all(|text| SMALL.contains(text)));
    let written = "  written: { export: error-table, of: fine, step_mm: 100, step_deg: 30 }\n";
    assert!(SMALL.contains(written));
    let in_touches = |more: &str| SMALL.replace("path: data/touches.csv", &format!("path: data/touches.csv, {more}"));
    let judged = |stage: &str| SMALL.replace(last, stage);
    let balls = SMALL.replace(
        "artefact: facets, from: touches, nominal: data/facets.csv",
        "artefact: balls, from: touches, nominal: data/balls.csv, centres_by: grop",
    );
    small.write("data/balls.csv", "feature,x_mm,y_mm,z_mm,diameter_mm\n3,0,0,0,20\n4,50,0,0,20\n5,0,50,0,20\n");
    for (case, recipe, setting) in [
        ("hold-out", judged(&last.replace("column: group", "column: grop")), "column"),
        ("repeats", judged("  unseen: { validate: repeats, of: fine, by: grop }"), "by"),
        ("per", SMALL.replace("    start: rough\n", "    per: grop\n").replace(written, ""), "per"),
        ("centres", balls, "centres_by"),
        ("unseen rows", SMALL.replace(rows, &format!("{rows}, unseen: {{ grop: [1] }}")), "unseen.grop"),
        ("ignored rows", in_touches("ignore: { grop: [1] }"), "ignore.grop"),
        ("means", in_touches("average: { over: grop, by: [feature] }"), "average.over"),
        ("motion", in_touches("motion: { axes: [Q] }"), "motion.axes"),
    ] {
        small.write("recipe.yaml", &recipe);
        let lacking = if case == "motion" { "`Q" } else { "`grop`" };
        let line = 1 + recipe.lines().position(|line| line.contains("grop") || line.contains("[Q]")).expect("a line");
        for command in [&["check", "recipe.yaml"][..], &["run", "recipe.yaml", "--out", "out"]] {
            let printed = small.abbe(command);
            let text = said(&printed);
            let file = if case == "per" { "data/lengths.csv" } else { "data/touches.csv" };
            for word in [file, &format!("{setting}:"), &format!("recipe.yaml:{line}:"), lacking] {
                assert!(text.contains(word), "{case}: {command:?} does not say `{word}`: {text}");
            }
            assert_eq!(printed.status, 2, "{case}: {text}");
        }
    }
}

/// Readings that are no geometry: the setting that names the column, and the data set.
#[test]
fn a_missing_column_of_readings_is_told_with_its_setting() {
    let folder = temporary();
    let at = folder.path();
    let spindle =
        |stage: &str, setting: &str, value| Variant::of(&recipes()["spindle-motion-exact"]).set(stage, setting, value);
    let thermal =
        |stage: &str, setting: &str, value| Variant::of(&recipes()["thermal-spindle-exact"]).set(stage, setting, value);
    let circle = |setting: &str, value| Variant::of(&recipes()["standards-ball-bar"]).set("figures", setting, value);
    for (recipe, words) in [
        (spindle("motion", "axial", json!("zz")), ["axial:", "motion-600.csv", "`zz_um`"]),
        (spindle("motion", "columns", json!({ "angle": "SS" })), ["columns.angle:", "motion-600.csv", "`SS_deg`"]),
        (spindle("motion", "columns", json!({ "run": "speeed" })), ["columns.run:", "motion-600.csv", "`speeed`"]),
        (
            spindle("reversal", "radial", json!({ "r7": { "azimuth_deg": 0 } })),
            ["radial.r7:", "reversal-1.csv", "`r7_um`"],
        ),
        (
            spindle("warm-up", "drift", json!(["drift_x", "drift_q"])),
            ["drift[1]:", "thermal-warmup.csv", "`drift_q_um`"],
        ),
        (spindle("warm-up", "temperatures", json!(["T99"])), ["temperatures[0]:", "thermal-warmup.csv", "`T99_degC`"]),
        (thermal("spindle", "inputs", json!(["T34", "T99"])), ["inputs[1]:", "thermal-const.csv", "`T99`"]),
        (circle("angle", json!("angel")), ["angle:", "ballbar-xy-f500.csv", "`angel_deg`"]),
    ] {
        std::fs::rename(recipe.write(at), at.join("recipe.yaml")).expect("a recipe");
        let printed = abbe(at, &["check", "recipe.yaml"]);
        let text = said(&printed);
        for word in words.iter().chain(&["recipe.yaml:"]) {
            assert!(text.contains(word), "{words:?}: {text}");
        }
        assert_eq!(printed.status, 2, "{text}");
    }
}

/// The column that tells circles apart is a setting of the validator, and not of the artefact.
#[test]
fn a_misspelt_column_of_tests_is_told_of_the_validator() {
    let folder = temporary();
    let at = folder.path();
    let recipe = Variant::of(&recipes()["standards-ball-bar"]).set("diagnosis", "tests", json!("tset"));
    std::fs::rename(recipe.write(at), at.join("recipe.yaml")).expect("a recipe");
    let line = 1 + read(&at.join("recipe.yaml")).lines().position(|line| line.contains("tset")).expect("a line");
    let printed = abbe(at, &["check", "recipe.yaml"]);
    let text = said(&printed);
    for word in ["stage `diagnosis`", "tests:", "`tset`", "ballbar-xy-f500.csv", &format!("recipe.yaml:{line}:")] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(printed.status == 2 && !text.contains("stage `bar`"), "{text}");
}

#[test]
fn settings_that_nothing_reads_are_refused() {
    let folder = temporary();
    let at = folder.path();
    let of = |recipe: &str| Variant::of(&recipes()[recipe]);
    let scanned = |setting: &str| of("standards-scanned-ring").set("figures", setting, json!("C"));
    let selected = |select| of("first-steps").set("fit", "select", select);
    let stated = json!({ "EXX[1]": { "value": 1, "unit": "um/m" } });
    for (recipe, word) in [
        (scanned("angle"), "leave out `angle`, or `scanned`"),
        (scanned("reading"), "leave out `reading`, or `scanned`"),
        (selected(json!({ "candidates": ["EXX[1]"], "parts": 5 })), "`by: prediction`"),
        (selected(json!({ "candidates": ["EXX[1]"], "worse": 0.1 })), "`by: prediction`"),
        (selected(json!({ "candidates": ["EXX[1]"], "by": "prediction", "level": 0.1 })), "`by: significance`"),
        (selected(json!({ "candidates": ["EXX[1]"], "by": "prediction", "direction": "both" })), "`by: significance`"),
        (selected(json!({ "candidates": ["EXX[1]"], "by": "prediction", "runs": "group", "parts": 5 })), "or `runs`"),
    ] {
        std::fs::rename(recipe.write(at), at.join("recipe.yaml")).expect("a recipe");
        let printed = abbe(at, &["check", "recipe.yaml"]);
        assert!(printed.status == 2 && said(&printed).contains(word), "{word}: {}", said(&printed));
    }
    // What is stated here does not count, and nothing is ignored of a file that is not there.
    let small = Small::new();
    let stage = |more: &str| {
        SMALL.replace(
            "  judge:",
            &format!("  known: {{ estimate: stated, machine: machine, values: {stated}{more} }}\n  judge:"),
        )
    };
    small.write("recipe.yaml", &stage(", ignore: [\"EX*\"]"));
    let printed = small.abbe(&["check", "recipe.yaml"]);
    assert!(printed.status == 2 && said(&printed).contains("leave out `ignore`"), "{}", said(&printed));
    // What is ignored in a file still counts where it is stated itself.
    small.write("report.csv", "parameter,value,unit\nEXX[1],7,um/m\nEYY[1],3,um/m\n");
    small.write("recipe.yaml", &stage(", path: report.csv, ignore: [\"EXX*\"]"));
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}", said(&printed));
    let known = crate::support::json_file(&small.path("out/recipe/known.calibration.json"));
    let value = |name: &str| {
        let mut all = known["parameters"].as_array().expect("parameters").iter();
        all.find(|own| own["name"] == name).and_then(|own| own["value"].as_f64()).expect("a value")
    };
    assert!((value("EXX[1]") - 1e-6).abs() < 1e-15 && (value("EYY[1]") - 3e-6).abs() < 1e-15);
}

#[test]
fn a_factor_for_uncertainties_that_nobody_limits_is_refused() {
    let small = Small::new();
    let stage = |limit: &str| {
        format!(
            "{SMALL}  sure: {{ validate: uncertainty, of: fine, coverage_factor: 2, parameters: [{{ names: [EX0C], {limit}: 100 }}] }}\n"
        )
    };
    write(&small.path("recipe.yaml"), &stage("standard_uncertainty_um"));
    let printed = small.abbe(&["check", "recipe.yaml"]);
    assert!(printed.status == 2 && said(&printed).contains("leave out `coverage_factor`"), "{}", said(&printed));
    write(&small.path("recipe.yaml"), &stage("expanded_um"));
    assert_eq!(small.abbe(&["check", "recipe.yaml"]).status, 0);
}

/// An update that estimates nothing is nothing to fail on.
#[test]
fn an_update_without_parameters_is_checked_as_it_runs() {
    let folder = temporary();
    let recipe =
        Variant::of(&recipes()["warming-days"]).only(&["month", "today"]).set("today", "parameters", json!([]));
    recipe.write(folder.path());
    for command in [&["check", "recipe.yaml"][..], &["run", "recipe.yaml", "--out", "out"]] {
        let printed = abbe(folder.path(), command);
        assert_eq!(printed.status, 0, "{command:?}: {}", said(&printed));
    }
}
