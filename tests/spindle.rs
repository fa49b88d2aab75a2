//! Check of a spindle: truth and expected figures of the simulated data, the last check, and bad input as users meet it.

mod words;

use std::sync::OnceLock;

use abbe_core::{Calibration, Figure, Status};
use abbe_engine::Outcome;
use serde_json::{Value, json};

use crate::support::{Variant, abbe, fit, json_file, read, recipes, root, temporary, write};

fn recipe(data: &str) -> Variant {
    Variant::of(&recipes()[if data == "exact" { "spindle-motion-exact" } else { "spindle-motion" }])
}

fn outcome(data: &str) -> &'static Outcome {
    static EXACT: OnceLock<Outcome> = OnceLock::new();
    static REALISTIC: OnceLock<Outcome> = OnceLock::new();
    let once = if data == "exact" { &EXACT } else { &REALISTIC };
    once.get_or_init(|| recipe(data).run())
}

fn truth(data: &str) -> Vec<(String, f64)> {
    let file = json_file(&root().join(format!("tests/truth/spindle-motion-{data}.json")));
    let parameters = file["parameters"].as_object().expect("parameters").iter();
    parameters.map(|(name, value)| (name.clone(), value.as_f64().expect("a number"))).collect()
}

fn expected(data: &str) -> Value {
    json_file(&root().join(format!("tests/truth/spindle-motion-{data}-expected.json")))
}

/// Value and standard uncertainty.
fn found(calibration: &Calibration, name: &str) -> (f64, f64) {
    let found = calibration.get(name).unwrap_or_else(|| panic!("no {name}"));
    (found.value, found.standard_uncertainty)
}

/// Harmonics of runs with the form in them, the truth and the uncertainty; what the truth does not name is zero.
fn harmonics(data: &str) -> Vec<(String, f64, f64, f64)> {
    let (outcome, truth) = (outcome(data), truth(data));
    let of = |name: &str| truth.iter().find(|(other, _)| other == name).map_or(0.0, |(_, value)| *value);
    let motion = &fit(outcome, "motion").calibration;
    let mut all = Vec::new();
    for estimated in motion.parameters.iter().filter(|parameter| parameter.status == Status::Estimated) {
        let name = &estimated.name;
        if name.contains("mean.") || name.contains("drift.") {
            continue;
        }
        let mut expected = of(name);
        // h(a - S) of the artefact: sensors at 0 and at 90 degrees.
        for (sensor, azimuth) in [("r1", 0.0_f64), ("r2", 90.0)] {
            if let Some((_, order)) = name.split_once(&format!("sync.{sensor}[")) {
                let (part, order) = order.trim_end_matches(']').split_at(3);
                let (sin, cos) = (order.parse::<f64>().expect("an order") * azimuth.to_radians()).sin_cos();
                let [form_cos, form_sin] = ["cos", "sin"].map(|part| of(&format!("form[{part}{order}]")));
                expected +=
                    if part == "cos" { form_cos * cos + form_sin * sin } else { form_cos * sin - form_sin * cos };
            }
        }
        all.push((name.clone(), estimated.value, expected, estimated.standard_uncertainty));
    }
    let reversal = &fit(outcome, "reversal").calibration;
    for estimated in reversal.parameters.iter().filter(|parameter| parameter.status == Status::Estimated) {
        let expected = match estimated.name.strip_prefix("sync.") {
            Some(own) => of(&format!("run[600].sync.{own}")),
            None => of(&estimated.name),
        };
        all.push((format!("reversal {}", estimated.name), estimated.value, expected, estimated.standard_uncertainty));
    }
    let warm_up = &fit(outcome, "warm-up").calibration;
    for estimated in warm_up.parameters.iter().filter(|parameter| parameter.status == Status::Estimated) {
        all.push((estimated.name.clone(), estimated.value, of(&estimated.name), estimated.standard_uncertainty));
    }
    all
}

#[test]
fn exact_data_give_the_truth_back() {
    let all = harmonics("exact");
    // Of each run 4, 2 x 46 and 48; of the reversal 92; six gains.
    assert_eq!(all.len(), 3 * 144 + 92 + 6);
    for (name, value, truth, _) in all {
        let off = (value - truth).abs() * 1e3;
        assert!(off < 3e-11, "{name} is off by {off:e} um");
    }
}

#[test]
fn realistic_data_hold_the_truth_within_their_uncertainty() {
    let all = harmonics("realistic");
    let mut outside = 0;
    for (name, value, truth, uncertainty) in &all {
        let off = (value - truth).abs() / uncertainty;
        // 31 degrees of freedom: 95 % are within 2.04, and 99.9 % of 530 values within 4.9.
        outside += usize::from(off > 2.04);
        assert!(off < 3.0, "{name} is {off} standard uncertainties off");
        assert!(*uncertainty < if name.contains("drift_") { 1e-5 } else { 2e-5 }, "{name}: {uncertainty:e}");
    }
    assert!(outside * 20 <= all.len(), "{outside} of {}", all.len());
}

fn figures(data: &str) -> &'static [Figure] {
    let verdict = outcome(data).verdicts.iter().find(|verdict| verdict.stage == "spindle").expect("a verdict");
    &verdict.figures
}

fn figure<'a>(figures: &'a [Figure], name: &str) -> &'a Figure {
    figures.iter().find(|figure| figure.name == name).unwrap_or_else(|| panic!("no figure {name}"))
}

#[test]
fn figures_are_those_that_are_expected() {
    // Names, keys of the expected values, and whether the form makes a difference.
    let names = [
        ("eccentricity[R]", "eccentricity_um", false),
        ("eccentricity phase[R]", "eccentricity_phase_deg", false),
        ("backward fundamental[R]", "backward_fundamental_um", false),
        ("synchronous rotating[R]", "synchronous_rotating_um", true),
        ("asynchronous rotating[R]", "asynchronous_rotating_um", false),
        ("synchronous fixed[R r1]", "synchronous_fixed_r1_um", true),
        ("synchronous fixed[R r2]", "synchronous_fixed_r2_um", true),
        ("asynchronous fixed[R r1]", "asynchronous_fixed_r1_um", false),
        ("asynchronous fixed[R r2]", "asynchronous_fixed_r2_um", false),
        ("synchronous axial[R]", "axial_synchronous_um", false),
        ("fundamental axial[R]", "axial_fundamental_um", false),
        ("residual synchronous axial[R]", "axial_residual_synchronous_um", false),
        ("asynchronous axial[R]", "axial_asynchronous_um", false),
    ];
    for (data, removed) in [("exact", 1e-6), ("realistic", 2e-3)] {
        let (all, expected) = (figures(data), expected(data));
        for run in ["600", "3000", "9000"] {
            let of = |form: &str, key: &str| expected[format!("motion-{run}")][form][key].as_f64().expect("a number");
            for (name, key, by_form) in names {
                let name = name.replace('R', run);
                let found = figure(all, &name);
                let off = (found.value.expect("a value") - of("form_removed", key)).abs();
                let allowed = if by_form { removed } else { 5e-5 };
                assert!(off < allowed, "{data} {name}: off by {off:e}");
                assert!(found.standard_uncertainty.is_some() || data == "exact", "{data} {name}");
                if by_form {
                    let read = figure(all, &name.replacen('[', " as read[", 1));
                    let off = (read.value.expect("a value") - of("as_read", key)).abs();
                    assert!(off < 5e-5 && read.detail, "{data} {name} as read: off by {off:e}");
                }
            }
        }
        let reversal = [
            ("form out of roundness", "form_out_of_roundness_um"),
            ("reversal synchronous fixed[r1]", "spindle_synchronous_fixed_r1_um"),
        ];
        for (name, key) in reversal {
            let found = figure(all, name);
            let (value, uncertainty) = (found.value.expect("a value"), found.standard_uncertainty.expect("one"));
            let off = (value - expected["reversal"][key].as_f64().expect("a number")).abs();
            assert!(off < if data == "exact" { 1e-6 } else { 3e-3 } && uncertainty < 0.02, "{data} {name}: {off:e}");
        }
        for axis in ["x", "y", "z"] {
            let of = |key: &str| expected["thermal-warmup"][axis][key].as_f64().expect("a number");
            for (name, key) in [
                ("warm-up end", "end_um"),
                ("warm-up range", "range_um"),
                ("warm-up slope", "rate_last_5_min_um_per_min"),
            ] {
                let value = figure(all, &format!("{name}[drift_{axis}]")).value.expect("a value");
                assert!((value - of(key)).abs() < 1e-5, "{data} {name} {axis}: {value}");
            }
        }
    }
}

#[test]
fn a_total_motion_is_no_smaller_than_its_parts_and_no_larger_than_their_sum() {
    for data in ["exact", "realistic"] {
        let of = |name: String| figure(figures(data), &name).value.expect("a value");
        for run in ["600", "3000", "9000"] {
            for place in [format!("rotating[{run}]"), format!("fixed[{run} r1]"), format!("axial[{run}]")] {
                let [total, synchronous, asynchronous] =
                    ["total", "synchronous", "asynchronous"].map(|name| of(format!("{name} {place}")));
                assert!(total > synchronous.max(asynchronous) && total < synchronous + 2.0 * asynchronous, "{place}");
            }
        }
    }
}

#[test]
fn what_changed_since_the_last_check_is_told_by_a_saved_calibration() {
    let folder = temporary();
    let file = folder.path().join("motion.calibration.json");
    write(&file, &fit(outcome("exact"), "motion").calibration.to_json().expect("text"));
    let mut now = recipe("realistic").only(&["motion", "reversal", "spindle"]);
    now.0["stages"]["last-year"] = json!({ "estimate": "calibration", "path": file });
    now.0["stages"]["spindle"]["of"] = json!(["motion", "reversal", "last-year"]);
    now.0["stages"]["spindle"]["last"] = json!("last-year");
    now.0["stages"]["spindle"]["runs"] = json!(["3000"]);
    now.0["stages"]["spindle"]["limits"] = json!({ "change_of_synchronous_rotating_um": 0.05 });
    let outcome = now.run();
    let verdict = &outcome.verdicts[0];
    let of = |data: &str| figure(figures(data), "synchronous fixed[3000 r2]").value.expect("a value");
    let change = figure(&verdict.figures, "change of synchronous fixed[3000 r2]");
    // The form of the exact data was removed by their own reversal.
    assert!((change.value.expect("a value") - (of("realistic") - of("exact"))).abs() < 2e-3, "{change:?}");
    assert!(change.standard_uncertainty.expect("one") > 0.0);
    let limited = figure(&verdict.figures, "change of synchronous rotating[3000]");
    assert!(limited.limit == Some(0.05) && verdict.pass, "{limited:?}");
    assert!(verdict.remarks.iter().any(|remark| remark.contains("since `last-year` order")), "{:?}", verdict.remarks);
    assert!(!verdict.figures.iter().any(|figure| figure.name.contains("[600")));
}

#[test]
fn tables_can_be_plotted() {
    let (_, files) = outcome("exact").exports.iter().find(|(stage, _)| stage == "spindle").expect("tables");
    let names: Vec<&str> = files.iter().map(|file| file.name.rsplit('/').next().unwrap_or_default()).collect();
    for run in ["600", "3000", "9000"] {
        assert!(names.contains(&format!("polar-{run}.csv").as_str()), "{names:?}");
        assert!(names.contains(&format!("total-{run}.csv").as_str()), "{names:?}");
    }
    let text = |name: &str| {
        let file = files.iter().find(|file| file.name.ends_with(name)).expect("a table");
        String::from_utf8(file.content.clone()).expect("text")
    };
    let polar = text("polar-600.csv");
    let radii = |column: usize| -> Vec<f64> {
        let cells = polar.lines().skip(1).map(|line| line.split(',').nth(column).expect("a cell"));
        cells.map(|cell| cell.parse().expect("a number")).collect()
    };
    assert_eq!(polar.lines().next(), Some("S_deg,rotating_um,r1_um,r2_um,z_um"));
    let range = radii(1).into_iter().fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(value), high.max(value)]);
    assert!((range[1] - range[0] - 0.3186).abs() < 1e-4, "{range:?}");
    let speeds = text("speeds.csv");
    let first: Vec<&str> = speeds.lines().map(|line| line.split(',').next().unwrap_or_default()).collect();
    assert_eq!(first, ["run", "\"600\"", "\"3000\"", "\"9000\""]);
}

/// A message without the lines and the frame that a terminal needs.
fn in_one_line(message: &str) -> String {
    message
        .split(|letter: char| letter.is_whitespace() || letter == '│')
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

#[test]
fn settings_and_stages_that_do_not_fit_are_refused_with_their_place() {
    type Change = fn(&mut Value);
    let cases: [(Change, i32, &str); 13] = [
        (|s| s["motion"]["axial"] = json!("zz"), 2, "data set 1 under `from` has no column `zz_um`"),
        (|s| s["motion"]["axial"] = json!("S"), 2, "has a column `S_deg`, and `S_um` was expected"),
        (|s| s["motion"]["harmonics"] = json!(1), 2, "from 2 to 500 was expected"),
        (|s| s["motion"]["radial"]["r2"]["azimuth_deg"] = json!(175), 2, "tell one direction alone"),
        (|s| s["motion"]["radial"]["r2"]["azimuth_deg"] = json!(-90), 1, "are r1 and r2 swapped"),
        (
            |s| s["motion"]["speeds_rpm"] = json!([600, 3000, 10000]),
            1,
            "the speeds that were set are 600, 3000, 10000 rpm",
        ),
        (|s| s["reversal"]["speed_rpm"] = json!(10), 1, "with a time in min it would have 10.0 rpm"),
        (|s| s["motion"]["plausible_rpm"] = json!([100, 10]), 2, "the larger one last"),
        (|s| s["motion"]["from"] = json!(["run-600", "before"]), 2, "has no column `r2_um`"),
        (|s| s["reversal"]["from"] = json!(["before"]), 1, "two were expected: before and after the reversal"),
        (
            |s| {
                s["reversal"]["from"] = json!(["before", "run-3000"]);
                s["reversal"]["speed_rpm"] = Value::Null;
            },
            1,
            "reverse at one speed",
        ),
        (|s| s["spindle"]["limits"]["synchronous_um"] = json!(1), 2, "there is no figure `synchronous_um` to limit"),
        (|s| s["spindle"]["last"] = json!("reversal"), 1, "`reversal` is no estimate of `spindle-motion`"),
    ];
    for (number, (change, status, expected)) in cases.into_iter().enumerate() {
        let (folder, mut variant) = (temporary(), recipe("exact"));
        change(&mut variant.0["stages"]);
        variant.write(folder.path());
        let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
        assert!(in_one_line(&printed.stderr).contains(expected), "case {number}: {}", printed.stderr);
        assert_eq!(printed.status, status, "case {number}: {}", printed.stderr);
    }
}

#[test]
fn readings_in_a_file_are_refused_with_their_line() {
    let text = read(&root().join("pipelines/data/spindle-motion/realistic/motion-3000.csv"));
    let lines: Vec<&str> = text.lines().collect();
    let with = |change: &dyn Fn(usize, &mut Vec<String>)| {
        let rows = lines.iter().enumerate().map(|(index, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if index > 0 {
                change(index, &mut cells);
            }
            cells.join(",")
        });
        rows.collect::<Vec<_>>().join("\n") + "\n"
    };
    let number = |cell: &str| cell.parse::<f64>().expect("a number");
    let cases = [
        (
            with(&|row, cells| {
                if row >= 2000 {
                    cells[1] = format!("{:.2}", number(&cells[1]) + 1.4)
                }
            }),
            "motion.csv:2001:1",
        ),
        (with(&|_, cells| cells[3] = number(&cells[3]).min(9.5).to_string()), "r1 reads its largest value, 9.5000 um"),
        (with(&|_, cells| cells[4] = (number(&cells[4]) * 1e3).to_string()), "r2 moves by"),
        (with(&|_, cells| cells[1] = number(&cells[1]).to_radians().to_string()), "its angle covers 0.56 turns"),
        (with(&|_, cells| cells.swap(3, 4)), "are r1 and r2 swapped"),
        (with(&|_, cells| cells[4] = cells[3].clone()), "r2 has the readings of r1 in"),
        (lines[..200].join("\n") + "\n", "its angle covers 1.56 turns"),
        ([&lines[..1000], &lines[1100..]].concat().join("\n") + "\n", "readings are missing before this one"),
    ];
    for (place, (text, expected)) in cases.into_iter().enumerate() {
        let folder = temporary();
        write(&folder.path().join("motion.csv"), &text);
        let variant = recipe("realistic").set("run-3000", "path", json!("motion.csv")).only(&["motion"]);
        variant.write(folder.path());
        let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
        assert!(in_one_line(&printed.stderr).contains(expected), "case {place}: {}", printed.stderr);
        assert_eq!(printed.status, 1, "case {place}: {}", printed.stderr);
    }
    // A path that is an ellipse is told: the second sensor is not where the recipe has it.
    for (degrees, is_told) in [(60, true), (90, false)] {
        let folder = temporary();
        let mut variant = recipe("realistic").only(&["motion"]);
        variant.0["stages"]["motion"]["radial"]["r2"]["azimuth_deg"] = json!(degrees);
        variant.write(folder.path());
        let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
        assert_eq!(in_one_line(&printed.stderr).contains("is an ellipse"), is_told, "{degrees}: {}", printed.stderr);
    }
    // Names of parameters follow the speeds of the data.
    let names: Vec<&str> =
        fit(outcome("realistic"), "motion").calibration.parameters.iter().map(|one| one.name.as_str()).collect();
    assert!(["run[600].speed", "run[3000].speed", "run[9000].speed"].iter().all(|name| names.contains(name)));
    let (speed, _) = found(&fit(outcome("realistic"), "motion").calibration, "run[9000].speed");
    assert!((speed - 9000.18).abs() < 0.01, "{speed}");
}

/// The log of the warm-up with other cells in the columns whose names begin so; `change` gets the number of the row and the value.
fn warm_up(begins: &str, change: &dyn Fn(usize, f64) -> f64) -> String {
    let text = read(&root().join("pipelines/data/spindle-motion/realistic/thermal-warmup.csv"));
    let header: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
    let rows = text.lines().enumerate().map(|(line, row)| {
        let cells = row.split(',').zip(&header).map(|(cell, name)| match line > 0 && name.starts_with(begins) {
            true => change(line, cell.parse::<f64>().expect("a number")).to_string(),
            false => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(",")
    });
    rows.collect::<Vec<_>>().join("\n") + "\n"
}

/// Runs the warm-up alone on a log.
fn run_warm_up(log: &str) -> crate::support::Printed {
    let folder = temporary();
    write(&folder.path().join("log.csv"), log);
    let variant = recipe("realistic").only(&["warm-up"]);
    let stage = variant.0["stages"]["warm-up"]["from"].clone();
    let from = stage.as_str().or_else(|| stage[0].as_str()).expect("a stage").to_owned();
    variant.set(&from, "path", json!("log.csv")).write(folder.path());
    abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"])
}

#[test]
fn a_warm_up_in_another_unit_is_refused() {
    let (small, short) = ("drift_z drifts most, by 0.0", "the warm-up ends after");
    let cases = [
        ("drift", 1e-3, small, "widen `plausible_um`"),
        ("drift", 25.4e3, "drift_z drifts most, by 9", "widen `plausible_um`"),
        ("time", 1.0 / 60.0, short, "is the time in the unit"),
        ("time", 1e3, short, "is the time in the unit"),
    ];
    for (column, factor, message, help) in cases {
        let printed = run_warm_up(&warm_up(column, &|_, value| value * factor));
        let told = in_one_line(&printed.stderr);
        assert!(told.contains(message) && told.contains(help), "{column} {factor}: {}", printed.stderr);
        assert_eq!(printed.status, 1, "{column} {factor}");
    }
}

#[test]
fn sensors_of_a_warm_up_that_fail_are_told() {
    type Case<'a> = (&'a str, &'a dyn Fn(usize, f64) -> f64, i32, &'a str);
    // Rows in an order of their own: each is the one that stands so many rows before or behind it.
    let places = std::cell::RefCell::new(Vec::new());
    warm_up("T02", &|_, value| {
        places.borrow_mut().push(value);
        value
    });
    let readings = places.into_inner();
    let exchanged = |row: usize, _: f64| readings[(row * 67) % readings.len()];
    let cases: [Case<'_>; 7] = [
        ("T02", &exchanged, 0, "as no temperature does: are its rows exchanged?"),
        ("T02", &|_, _| 20.8, 1, "T02 reads 20.8 °C in all rows"),
        ("T02", &|row, value| if row == 90 { 0.0 } else { value }, 0, "T02 jumps here"),
        ("drift_z", &|row, value| if row > 100 { value - 20.0 } else { value }, 0, ":102: drift_z jumps here"),
        ("drift_z", &|_, value| value * 1e-3, 0, "drift_z drifts by 0.03"),
        ("time", &|row, value| if row > 90 { value + 1000.0 } else { value }, 0, "s without readings before this row"),
        ("T02", &|_, value| value, 0, ""),
    ];
    for (place, (column, change, status, expected)) in cases.into_iter().enumerate() {
        let printed = run_warm_up(&warm_up(column, change));
        let told = in_one_line(&printed.stderr);
        assert!(told.contains(expected) && printed.status == status, "case {place}: {}", printed.stderr);
        assert_eq!(told.is_empty(), expected.is_empty(), "case {place}: {}", printed.stderr);
    }
}

/// More harmonics than a turn has readings for, at angles that are nearly the same in every turn.
#[test]
fn harmonics_that_angles_hardly_tell_are_told() {
    for (stage, harmonics, is_told) in [("reversal", 24, false), ("reversal", 63, false), ("reversal", 200, true)] {
        let folder = temporary();
        recipe("realistic").set(stage, "harmonics", json!(harmonics)).only(&[stage]).write(folder.path());
        let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
        let told = in_one_line(&printed.stderr);
        let says = told.contains(&format!("hardly tell {harmonics} harmonics apart"));
        assert_eq!((says, printed.status), (is_told, 0), "{stage} {harmonics}: {told}");
    }
}

/// A run with other readings: `change` gets row, angle in degrees, and cells.
fn run_with(
    stage: &str,
    file: &str,
    kept: &[&str],
    change: &dyn Fn(usize, &mut Vec<String>),
) -> crate::support::Printed {
    let text = read(&root().join("pipelines/data/spindle-motion/realistic").join(file));
    let rows = text.lines().enumerate().map(|(line, row)| {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        if line > 0 {
            change(line, &mut cells);
        }
        cells.join(",")
    });
    let folder = temporary();
    write(&folder.path().join(file), &(rows.collect::<Vec<_>>().join("\n") + "\n"));
    recipe("realistic").set(stage, "path", json!(file)).only(kept).write(folder.path());
    abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"])
}

#[test]
fn runs_that_contradict_each_other_are_told() {
    let scale = |cell: &mut String, factor: f64| *cell = (cell.parse::<f64>().expect("a number") * factor).to_string();
    let header = read(&root().join("pipelines/data/spindle-motion/realistic/motion-600.csv"));
    let header: Vec<&str> = header.lines().next().expect("a header").split(',').collect();
    let column = |name: &str| header.iter().position(|own| own.starts_with(name)).expect("a column");
    let (angle, r1, r2, z) = (column("S_"), column("r1"), column("r2"), column("z"));
    // Half a degree in every turn.
    let slips = |row: usize, cells: &mut Vec<String>| {
        let slipped = (row / 128) as f64 * 0.6;
        cells[angle] = format!("{:.6}", cells[angle].parse::<f64>().expect("a number") + slipped);
    };
    let thousandths =
        |_: usize, cells: &mut Vec<String>| [r1, r2, z].iter().for_each(|&at| scale(&mut cells[at], 1.0 / 25.4));
    let noise =
        |row: usize, cells: &mut Vec<String>| cells[z] = format!("{:.3}", 0.006 * ((row * 7919) % 13) as f64 / 6.0);
    let told = |printed: &crate::support::Printed, expected: &str| {
        assert!(in_one_line(&printed.stderr).contains(expected), "`{expected}`: {}", printed.stderr);
    };
    told(&run_with("run-600", "motion-600.csv", &["motion"], &slips), "does the encoder slip a little in every turn?");
    told(&run_with("run-600", "motion-600.csv", &["motion"], &thousandths), "has a sensor another range or unit here?");
    told(&run_with("run-600", "motion-600.csv", &["motion"], &noise), "the asynchronous motion z is 0.0120 um, and");
    let as_it_is = run_with("run-600", "motion-600.csv", &["motion"], &|_, _| {});
    assert_eq!((as_it_is.status, as_it_is.stderr.as_str()), (0, ""));
}

#[test]
fn a_reversal_that_is_a_copy_or_turned_is_told() {
    let first = read(&root().join("pipelines/data/spindle-motion/realistic/reversal-1.csv"));
    let header: Vec<&str> = first.lines().next().expect("a header").split(',').collect();
    let r1 = header.iter().position(|own| own.starts_with("r1")).expect("a column");
    let cells: Vec<f64> =
        first.lines().skip(1).map(|row| row.split(',').nth(r1).expect("a cell").parse().expect("a number")).collect();
    for (sign, expected) in
        [(1.0, "its readings are those of the first set-up"), (-1.0, "are minus those of the first")]
    {
        let copied = |row: usize, own: &mut Vec<String>| own[r1] = format!("{:.6}", sign * cells[row - 1] + 1.0);
        let printed = run_with("after", "reversal-2.csv", &["reversal"], &copied);
        assert!(in_one_line(&printed.stderr).contains(expected) && printed.status == 1, "{}", printed.stderr);
    }
    let folder = temporary();
    let mut turned = recipe("realistic");
    turned.0["stages"]["reversal"]["radial"]["r1"]["azimuth_deg"] = json!(180);
    turned.write(folder.path());
    let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
    assert!(in_one_line(&printed.stdout).contains("the sensor r1 stands at 0 deg in `motion`"), "{}", printed.stdout);
}
