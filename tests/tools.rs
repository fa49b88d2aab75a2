//! Logs of tool setters: every figure and every verdict of the set, random stores of tools, files of controls, bad logs.

mod bad;
mod controls;
mod sequence;
mod sets;
mod stores;

use std::collections::BTreeMap;

use abbe_core::Calibration;
use serde_json::Value;

use crate::support::{Variant, abbe, fit, json_file, read, recipes, root, temporary};

const DATA: [(&str, &str); 2] = [("exact", "tool-check-exact"), ("realistic", "tool-check")];

fn run(recipe: &str) -> (abbe_engine::Outcome, BTreeMap<String, String>) {
    let outcome = Variant::of(&recipes()[recipe]).run();
    let out = temporary();
    let file = recipes()[recipe].clone();
    let printed = abbe(&root(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.path().as_os_str()]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    let results = out.path().join(recipe);
    let files = crate::support::tree(&results).into_iter();
    let files = files.map(|file| (file.display().to_string(), read(&results.join(&file)))).collect();
    (outcome, files)
}

/// The rows of a table, cells by the names of columns.
pub(crate) fn rows(text: &str) -> Vec<BTreeMap<String, String>> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let row = |line: &str| {
        let (mut cells, mut quoted) = (vec![String::new()], false);
        for c in line.chars() {
            match c {
                '"' => quoted = !quoted,
                ',' if !quoted => cells.push(String::new()),
                c => cells.last_mut().expect("a cell").push(c),
            }
        }
        assert_eq!(cells.len(), header.len(), "{line}");
        header.iter().map(|name| (*name).to_owned()).zip(cells).collect()
    };
    lines.map(row).collect()
}

fn number(cell: &str) -> f64 {
    cell.parse().unwrap_or_else(|_| panic!("`{cell}` is no number"))
}

fn table(files: &BTreeMap<String, String>, end: &str) -> Vec<BTreeMap<String, String>> {
    let found = files.iter().find(|(name, _)| name.ends_with(end));
    rows(found.unwrap_or_else(|| panic!("no {end} in {:?}", files.keys())).1)
}

#[test]
fn all_verdicts_of_the_set_are_met() {
    for (data, recipe) in DATA {
        let (_, files) = run(recipe);
        let expected = json_file(&root().join(format!("tests/truth/tool-check-{data}-expected.json")));
        let found = table(&files, "history/verdicts.csv");
        assert_eq!(found.len() as u64, expected["judged"].as_u64().expect("a number"));
        let mut not_ok = expected["not_ok"].as_array().expect("a list").iter();
        let mut counts: BTreeMap<&str, u64> = BTreeMap::new();
        for row in &found {
            *counts.entry(&row["verdict"]).or_default() += 1;
            if row["verdict"] == "ok" {
                continue;
            }
            let wanted = not_ok.next().unwrap_or_else(|| panic!("{data}: {row:?}"));
            for key in ["session", "tool", "verdict"] {
                let told = &wanted[key];
                assert_eq!(row[key], told.as_str().map_or(told.to_string(), str::to_owned), "{data}: {row:?}");
            }
            let looks_like = wanted.get("looks_like").map_or(String::new(), Value::to_string);
            assert_eq!(row["looks_like"], looks_like, "{data}");
            if let Some(quantity) = wanted.get("quantity") {
                assert_eq!(*quantity, row["quantity"], "{data}");
            }
            for (key, end) in [("deviation_um", "deviation_um"), ("expanded_uncertainty_um", "expanded_uncertainty_um")]
            {
                for quantity in ["length", "radius"] {
                    let cell = &row[&format!("{quantity}_{end}")];
                    match wanted[key].get(quantity).and_then(Value::as_f64) {
                        // The figures of the set have six digits.
                        Some(told) => {
                            assert!((number(cell) - told).abs() <= 6e-6 * told.abs().max(1.0), "{cell} {told}")
                        }
                        None => assert_eq!(cell, ""),
                    }
                }
            }
        }
        assert_eq!(not_ok.next(), None, "{data}");
        let wanted = expected["counts"].as_object().expect("a map").iter();
        assert_eq!(counts, wanted.map(|(name, count)| (name.as_str(), count.as_u64().expect("a number"))).collect());
    }
}

#[test]
fn all_dimensions_and_wear_rates_are_met() {
    for (data, recipe) in DATA {
        let (outcome, files) = run(recipe);
        let calibration = &fit(&outcome, "tools").calibration;
        let expected = json_file(&root().join(format!("tests/truth/tool-check-{data}-expected.json")));
        let truth = json_file(&root().join(format!("tests/truth/tool-check-{data}-truth.json")));
        let rows: Vec<usize> = calibration.outliers.iter().map(|outlier| outlier.row).collect();
        assert_eq!(serde_json::json!(rows), expected["spoiled_readings"], "{data}");
        assert!(calibration.outliers.iter().all(|it| it.file.ends_with("tool-log.csv") && it.line == it.row + 1));

        let (worst, rms, count) = against_truth(data, calibration);
        assert_eq!(count, 201);
        match data {
            // Millimetres with 1e-9: 1e-10 um is the rounding of a sum of them.
            "exact" => assert!(worst.0 < 2e-10, "{worst:?}"),
            _ => assert!((rms - 0.56).abs() < 0.006 && worst.1 < 3.35 && worst.1 > 3.2, "{rms} {worst:?}"),
        }
        let wear = table(&files, "history/wear.csv");
        assert_eq!(wear.len(), 14);
        for row in &wear {
            let name = format!("wear[{}].{}", row["tool"], row["quantity"]);
            let wanted = |key: &str| expected["wear"][&name][key].as_f64().expect("a number");
            let near = |cell: &str, told: f64, tolerance: f64| {
                let off = (number(&row[cell]) / told - 1.0).abs();
                assert!(off < tolerance, "{data} {name}: {cell} {} {told}", row[cell]);
            };
            let digits = if data == "exact" { 2e-9 } else { 6e-6 };
            near("um_per_100_min", wanted("um_per_100_min"), digits);
            near("standard_uncertainty_um_per_100_min", wanted("standard_uncertainty"), digits.max(1e-8));
            near("limit_reached_min", wanted("limit_reached_min"), digits);
            let true_rate = truth["parameters"][&name].as_f64().expect("a rate") * 1e5;
            let off = number(&row["um_per_100_min"]) - true_rate;
            let most = if data == "exact" { 1e-8 } else { 2.15 * wanted("standard_uncertainty") };
            assert!(off.abs() < most, "{data} {name}: off by {off:e}");
        }
        let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "before-the-cut").expect("a verdict");
        let first =
            verdict.figures.iter().find(|it| it.name == "first limit reached: wear[3].length").expect("a figure");
        let minutes = first.value.expect("a value");
        assert!((minutes - if data == "exact" { 357.9 } else { 367.3 }).abs() < 0.05, "{data}: {minutes}");
    }
}

/// The row of a tool in a session.
fn row(rows: &[BTreeMap<String, String>], session: u32, tool: u32) -> &BTreeMap<String, String> {
    let is = |row: &&BTreeMap<String, String>| row["session"] == session.to_string() && row["tool"] == tool.to_string();
    rows.iter().find(is).unwrap_or_else(|| panic!("no tool {tool} in session {session}"))
}

#[test]
fn the_figures_that_the_set_tells_in_words() {
    for (data, recipe) in DATA {
        let (outcome, files) = run(recipe);
        let verdicts = table(&files, "history/verdicts.csv");
        let near = |cell: &str, told: f64, tolerance: f64| {
            assert!((number(cell) - told).abs() <= tolerance, "{data}: {cell} is not {told}")
        };
        // Expanded uncertainties of values without a spoiled reading.
        near(&row(&verdicts, 11, 3)["length_expanded_uncertainty_um"], 2.76, 0.005);
        near(&row(&verdicts, 11, 3)["radius_expanded_uncertainty_um"], 2.82, 0.005);
        near(&row(&verdicts, 5, 2)["length_deviation_um"], -13310.0, 5.0);
        near(&row(&verdicts, 9, 5)["value_um"], 7320.0, 5.0);
        assert_eq!(row(&verdicts, 9, 5)["radius_deviation_um"], "");
        let calibration = &fit(&outcome, "tools").calibration;
        // Broken tools are judged without a radius: alone, the stump of tool 5 is as long as tool 2 by its preset.
        let stump = calibration.get("length[5]").expect("a value").value - 118.236;
        assert!((stump * 1e3 + 9.4).abs() < 3.0, "{data}: {stump}");
        // A spoiled reading would move the mean of three by a third.
        let by_mean = calibration.outliers.iter().map(|outlier| outlier.residual_um / 3.0);
        for (found, told) in by_mean.zip([-17.0, 61.0, 82.0]) {
            assert!((found - told).abs() < 0.6, "{data}: {found} {told}");
        }
        let checks = calibration.model.settings["checks"].as_array().expect("checks");
        assert!(checks.len() == 101 && checks.iter().all(|check| check.get("inconsistent").is_none()), "{data}");
        if data == "exact" {
            assert!((stump * 1e3 + 9.4).abs() < 0.05, "{stump}");
            near(&row(&verdicts, 6, 6)["radius_deviation_um"], -60.3, 0.06);
            near(&row(&verdicts, 11, 3)["length_deviation_um"], -39.5, 0.05);
            near(&row(&verdicts, 12, 3)["length_deviation_um"], -42.9, 0.05);
            // The drop has the wear of the minutes between in it.
            let rate = calibration.get("wear[6].radius").expect("a rate").value * 6e4;
            let minutes = number(&row(&verdicts, 6, 6)["cutting_min"]) - number(&row(&verdicts, 5, 6)["cutting_min"]);
            let at_once = number(&row(&verdicts, 6, 6)["value_um"]) + rate * minutes;
            assert!((at_once - 46.7).abs() < 1e-6, "{at_once}");
        }
    }
}

#[test]
fn without_the_master_most_verdicts_change() {
    let (_, files) = run("tool-check-exact");
    let with = table(&files, "history/verdicts.csv");
    let text = read(&root().join("pipelines/data/tool-check/exact/tool-log.csv"));
    let (mut lines, mut lengths) = (vec![text.lines().next().expect("a header").to_owned()], Vec::new());
    for line in text.lines().skip(1) {
        let mut cells: Vec<&str> = line.split(',').collect();
        if cells[2] == "0" {
            let own = if cells[3] == "length" { "200.0124" } else { "12.4996" };
            if cells[3] == "length" {
                lengths.push((cells[4].to_owned(), (number(cells[6]) - number(own)) * 1e3));
            }
            // A master that reads its own value corrects nothing.
            cells[6] = own;
        }
        lines.push(cells.join(","));
    }
    // Contact and laser differ by up to 17.9 um, and the spindle grows by up to 21 um.
    let range = |method: &str| {
        let of = lengths.iter().filter(|(name, _)| name == method).map(|(_, off)| *off);
        of.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], off| [low.min(off), high.max(off)])
    };
    let (contact, laser) = (range("contact"), range("laser"));
    assert!((contact[0] - laser[0] - 17.9).abs() < 0.05, "{contact:?} {laser:?}");
    assert!((contact[1] - 6.2 - 21.0).abs() < 0.5, "{contact:?}");

    let folder = temporary();
    crate::support::write(&folder.path().join("log.csv"), &(lines.join("\n") + "\n"));
    let recipe = Variant::of(&recipes()["tool-check-exact"]).only(&["tools", "history"]);
    let outcome = recipe.set("log", "path", folder.path().join("log.csv").display().to_string().into()).run();
    let (_, tables) = outcome.exports.iter().find(|(stage, _)| stage == "history").expect("tables");
    let text = tables.iter().find(|file| file.name.ends_with("verdicts.csv")).expect("a table").content.clone();
    let without = rows(&String::from_utf8(text).expect("text"));
    let changed = with.iter().zip(&without).filter(|(one, other)| one["verdict"] != other["verdict"]).count();
    assert_eq!((with.len(), without.len(), changed), (101, 101, 94));
}

/// Largest deviation of the dimensions, um, and relative to u_v; their rms deviation, um; their number.
fn against_truth(data: &str, calibration: &Calibration) -> ((f64, f64), f64, usize) {
    let truth = rows(&read(&root().join(format!("tests/truth/tool-check-{data}-dimensions.csv"))));
    let mut last: BTreeMap<&str, &str> = BTreeMap::new();
    for row in &truth {
        last.insert(&row["tool"], &row["session"]);
    }
    let (mut largest, mut ratio, mut squares, mut count) = (0.0_f64, 0.0_f64, 0.0, 0);
    for row in truth.iter().filter(|row| row["tool"] != "0") {
        let (tool, session, quantity) = (&row["tool"], &row["session"], &row["quantity"]);
        let name = if last[tool.as_str()] == session { tool.clone() } else { format!("{tool},{session}") };
        let found = calibration.get(&format!("{quantity}[{name}]"));
        let found = found.unwrap_or_else(|| panic!("no {quantity}[{name}]"));
        let off = (found.value - number(&row["value_mm"])).abs() * 1e3;
        // Without the master, which is right in this set.
        let uncertainty = ((found.standard_uncertainty * 1e3).powi(2) - 0.25).sqrt();
        (largest, ratio) = (largest.max(off), ratio.max(off / uncertainty));
        squares += off * off;
        count += 1;
    }
    ((largest, ratio), (squares / count as f64).sqrt(), count)
}

#[test]
fn the_exit_status_tells_a_cell_controller() {
    let recipe = &recipes()["tool-check"];
    let variant = |settings: Value| {
        let mut variant = Variant::of(recipe).only(&["tools", "before-the-cut"]);
        let stage = variant.stage("before-the-cut");
        *stage = settings;
        stage["validate"] = "tools".into();
        stage["of"] = "tools".into();
        variant
    };
    let cases = [
        (serde_json::json!({}), 3, "worn length[tool=3,session=14]"),
        (serde_json::json!({ "tools": [1, 8] }), 0, ""),
        (serde_json::json!({ "fail": ["broken"] }), 0, ""),
        (serde_json::json!({ "tools": [1, 5] }), 3, "not measured[tool=5,session=14]"),
        (serde_json::json!({ "sessions": "all", "tools": [1, 4] }), 0, ""),
        (serde_json::json!({ "sessions": "all", "tools": [2] }), 3, "wrong-tool length[tool=2,session=5]"),
        (
            serde_json::json!({ "sessions": "all", "tools": [3], "fail": ["broken"] }),
            0,
            "recheck length[tool=3,session=11]",
        ),
        (
            serde_json::json!({ "sessions": "all", "tools": [3], "fail": ["recheck"] }),
            3,
            "recheck length[tool=3,session=11]",
        ),
    ];
    for (settings, status, told) in cases {
        let folder = temporary();
        let file = variant(settings.clone()).write(folder.path());
        let out = folder.path().join("out");
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
        assert_eq!(printed.status, status, "{settings}: {}{}", printed.stdout, printed.stderr);
        assert!(printed.stdout.contains(told), "{settings}: {}", printed.stdout);
    }
}

#[test]
fn what_no_rule_refuses_is_told_and_can_fail() {
    let text = read(&root().join("pipelines/data/tool-check/exact/tool-log.csv"));
    let lines: Vec<&str> = text.lines().collect();
    let is = |line: &str, tool: &str, quantity: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        cells[1..4] == ["14", tool, quantity]
    };
    let without = lines.iter().filter(|line| !is(line, "4", "radius")).map(|line| (*line).to_owned());
    // Tool 7 is 2 mm longer than its preset, and no other tool is as long.
    let longer = lines.iter().map(|line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if is(line, "7", "length") {
            cells[6] = format!("{:.9}", number(&cells[6]) + 2.0);
        }
        cells.join(",")
    });
    let cases: [(Vec<String>, &str); 2] =
        [(without.collect(), "recheck radius[tool=4,session=14]"), (longer.collect(), "too long[tool=7,session=14]")];
    for (lines, told) in cases {
        for (fail, status) in [(None, 0), (Some(serde_json::json!(["recheck"])), 3)] {
            let folder = temporary();
            crate::support::write(&folder.path().join("log.csv"), &(lines.join("\n") + "\n"));
            let mut recipe = Variant::of(&recipes()["tool-check-exact"]).only(&["tools", "before-the-cut", "siemens"]);
            recipe.stage("log")["path"] = "log.csv".into();
            if let Some(fail) = &fail {
                recipe.stage("before-the-cut")["fail"] = fail.clone();
            }
            let file = recipe.write(folder.path());
            let out = folder.path().join("out");
            let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
            assert_eq!(printed.status, status, "{told}: {}{}", printed.stdout, printed.stderr);
            assert!(printed.stdout.contains(told), "{told}: {}", printed.stdout);
            let locked = read(&out.join("recipe/siemens/locked.csv"));
            assert_eq!(locked.contains("4,not-measured,14,"), told.contains("tool=4"), "{locked}");
        }
    }
}

#[test]
fn a_saved_estimate_is_judged_and_exported_alike() {
    let (_, files) = run("tool-check");
    let folder = temporary();
    let saved = files.iter().find(|(name, _)| name.ends_with("tools.calibration.json")).expect("a calibration");
    crate::support::write(&folder.path().join("saved.json"), saved.1);
    crate::support::write(
        &folder.path().join("again.yaml"),
        "abbe: 1\nname: again\nstages:\n  old: { estimate: calibration, path: saved.json }\n  \
         history: { validate: tools, of: old, sessions: all, fail: [] }\n  \
         fanuc: { export: tool-offsets, of: old, control: fanuc, decimals: 4 }\n",
    );
    let printed = abbe(folder.path(), &["run", "again.yaml", "--out", "out"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    let results = folder.path().join("out/again");
    for file in crate::support::tree(&results) {
        let name = file.display().to_string();
        if name.ends_with(".csv") || name.ends_with(".nc") {
            assert_eq!(read(&results.join(&file)), files[&name], "{name}");
        }
    }
    assert!(results.join("history/verdicts.csv").is_file());
}

#[test]
fn what_no_wear_explains_is_told_and_locked() {
    let text = read(&root().join("pipelines/data/tool-check/realistic/tool-log.csv"));
    let with = |change: &dyn Fn(&mut Vec<String>)| {
        let lines = text.lines().enumerate().map(|(index, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if index > 0 {
                change(&mut cells);
            }
            cells.join(",")
        });
        lines.collect::<Vec<_>>().join("\n") + "\n"
    };
    let off = |cells: &mut Vec<String>, by: f64| cells[6] = format!("{:.4}", number(&cells[6]) + by);
    let master = |cells: &mut Vec<String>| {
        if cells[1] == "14" && cells[2] == "0" && cells[3] == "length" {
            off(cells, -0.05);
        }
    };
    let one = |cells: &mut Vec<String>| {
        if cells[1] == "14" && cells[2] == "7" && cells[3] == "radius" {
            off(cells, 0.02);
        }
    };
    let certificate = |cells: &mut Vec<String>| {
        if cells[2] == "0" && cells[3] == "length" {
            off(cells, -0.1);
        }
    };
    let cases: [(String, i32, &str, Option<&str>); 4] = [
        (with(&master), 3, "is the master clean, and the same one?", Some("4,grown,14,")),
        (with(&one), 3, "the radius of tool 7 (18.9 um) has grown", Some("7,grown,14,")),
        (with(&certificate), 0, "is `length_mm` of the master right?", None),
        (text.clone(), 0, "", None),
    ];
    for (place, (log, status, expected, locked)) in cases.into_iter().enumerate() {
        let folder = temporary();
        crate::support::write(&folder.path().join("log.csv"), &log);
        let mut recipe = Variant::of(&recipes()["before-the-cut"]).only(&["tools", "tools-of-the-cut", "offsets"]);
        recipe.stage("setter")["path"] = "log.csv".into();
        let file = recipe.write(folder.path());
        let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()]);
        assert!(
            printed.status == status && printed.stderr.contains(expected),
            "case {place}: {}{}",
            printed.stdout,
            printed.stderr
        );
        let list = read(&folder.path().join("out/recipe/offsets/locked.csv"));
        assert!(locked.is_none_or(|locked| list.contains(locked)), "case {place}: {list}");
        // The set itself has the stump of a broken tool and a swapped one, and nothing that grows.
        assert_eq!(
            expected.is_empty(),
            !printed.stderr.contains("no wear does that") && !printed.stderr.contains("of the master right")
        );
    }
}

#[test]
fn copied_sessions_are_told() {
    let text = read(&root().join("pipelines/data/tool-check/realistic/tool-log.csv"));
    let rows = rows(&text);
    let of_13 = |row: &BTreeMap<String, String>| {
        let same = |other: &&BTreeMap<String, String>| {
            other["session"] == "13"
                && ["tool", "quantity", "method", "repeat"].iter().all(|name| other[*name] == row[*name])
        };
        rows.iter().find(same).map(|other| other["value_mm"].clone())
    };
    let lines = text.lines().enumerate().map(|(index, line)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if index > 0 && cells[1] == "14" && cells[4] == "laser" {
            cells[6] = of_13(&rows[index - 1]).unwrap_or_else(|| cells[6].clone());
        }
        cells.join(",")
    });
    let folder = temporary();
    crate::support::write(&folder.path().join("log.csv"), &(lines.collect::<Vec<_>>().join("\n") + "\n"));
    let mut recipe = Variant::of(&recipes()["tool-check"]).only(&["tools"]);
    recipe.stage("log")["path"] = "log.csv".into();
    let file = recipe.write(folder.path());
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), "out".as_ref()]);
    assert!(
        printed.stderr.contains("all readings by laser in session 14 are those of session 13"),
        "{}",
        printed.stderr
    );
    assert!(!printed.stderr.contains("by contact"), "{}", printed.stderr);
}
