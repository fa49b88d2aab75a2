//! Figures of standards as users meet them: limits, decisions, bad input. Expected values: `expected_figures.rs`.

use std::path::Path;

use abbe_core::{Decision, Figure, Rule};
use abbe_engine::Outcome;
use serde_json::{Value, json};

use crate::support::{Variant, read, recipes, root};

pub const DATA: [&str; 2] = ["exact", "realistic"];

pub fn recipe(name: &str) -> Variant {
    Variant::of(&recipes()[&format!("standards-{name}")])
}

fn positioning() -> Variant {
    recipe("positioning").only(&["positioning"])
}

/// A recipe with the data of this kind.
pub fn on(name: &str, data: &str) -> Variant {
    let mut found = recipe(name);
    for stage in found.0["stages"].as_object_mut().expect("stages").values_mut() {
        if let Some(path) = stage.get("path").and_then(Value::as_str) {
            stage["path"] = json!(path.replace("standards/realistic/", &format!("standards/{data}/")));
        }
    }
    found
}

pub fn figures<'a>(outcome: &'a Outcome, stage: &str) -> &'a [Figure] {
    let failures: Vec<String> = outcome.failures.iter().map(|failure| failure.error.to_string()).collect();
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == stage);
    &verdict.unwrap_or_else(|| panic!("no verdict of {stage}: {failures:?}")).figures
}

/// 105 lengths of which one is outside: it has to be measured again, and the repeats decide.
#[test]
fn a_length_that_is_outside_is_measured_again() {
    let judged = |from: Value, mpe: f64| {
        let recipe =
            recipe("cmm").only(&["e0"]).set("e0", "from", from).set("e0", "mpe", json!({ "A_um": mpe, "K": 300 }));
        let outcome = recipe.run();
        let figure = figures(&outcome, "e0").iter().find(|figure| figure.name.contains("decides")).expect("it").clone();
        (figure.decision.expect("a decision"), figure.inconclusive.unwrap_or_default())
    };
    let (decision, why) = judged(json!("lengths"), 1.9);
    assert_eq!((decision, why.as_str()), (Decision::Inconclusive, "measure three times again: line 5 at 272.5581 mm"));
    assert_eq!(judged(json!(["lengths", "repeats"]), 1.9).0, Decision::Pass);
    // The repeats are outside, too.
    assert_eq!(judged(json!(["lengths", "repeats"]), 0.02).0, Decision::Fail);
    let recipe = recipe("cmm").only(&["e150"]).set("e150", "from", json!(["lengths-beside", "repeats"]));
    let failed = recipe.run();
    let said: String = failed.failures.iter().map(|failure| failure.error.to_string()).collect();
    assert!(said.contains("the repeats have line 5 at 272.5581 mm, which lengths-el150 has not"), "{said}");
}

/// Limits that no figure answers: an unknown name is refused, and a figure that is absent fails.
#[test]
fn no_limit_is_left_unjudged() {
    let all = [
        ("positioning", "positioning", "A_um", "R_up_urad"),
        ("positioning", "positioning-long", "R_um", "A_um"),
        ("circular", "circles", "G_b_lsc_um", "G_lsc_um"),
        ("circular", "arc-of-a-circle", "G_um", "H_um"),
        ("cmm", "probing", "PFTU_um", "PLTM_um"),
        ("rotary-interpolation", "c-axis", "x_um", "axial_um"),
        ("diagonals", "diagonals", "B_d_um", "squareness_urad"),
    ];
    for (name, stage, one, other) in all {
        let limited = |limits: Value| recipe(name).only(&[stage]).set(stage, "limits", limits);
        // All figures of the last digit are above this limit, by any rule that knows their uncertainty.
        let rule = |limit: f64| json!({ "limit": limit, "decision": { "rule": "simple" } });
        let outcome = limited(json!({ one: rule(1e-6), other: rule(1e-6) })).run();
        let judged: Vec<&Figure> = figures(&outcome, stage).iter().filter(|own| own.limit.is_some()).collect();
        assert!(
            judged.len() >= 2 && judged.iter().all(|own| own.decision == Some(Decision::Fail)),
            "{stage} {judged:?}"
        );
        let folder = crate::support::temporary();
        let refused = limited(json!({ "Gb_um": 1 })).write(folder.path());
        let error = abbe_engine::prepare(&refused, &crate::support::registry()).err().expect("it is refused");
        assert!(error.to_string().contains("there is no figure `Gb_um` to limit"), "{error}");
    }
    // Without one of the styli, and with the ball on the axis.
    let alone = recipe("cmm").only(&["probing"]).set("probing", "single", json!("9")).run();
    let failed = |figure: &&Figure| figure.decision == Some(Decision::Fail) && figure.value.is_none();
    let names: Vec<&str> =
        figures(&alone, "probing").iter().filter(failed).map(|figure| figure.name.as_str()).collect();
    assert_eq!(names, ["P_FTU[sphere-points]", "|P_STU|[sphere-points]"]);
    let on_axis =
        recipe("rotary-interpolation").only(&["c-axis"]).set("c-axis", "ball_from_axis_mm", json!([0, 0, 60]));
    let on_axis = on_axis.run();
    let absent = figures(&on_axis, "c-axis").iter().filter(failed).count();
    assert_eq!(absent, 3);
}

/// What has a sign is limited in its size, and keeps its sign.
#[test]
fn limits_of_figures_with_a_sign_are_those_of_their_size() {
    let found =
        recipe("circular").only(&["circles"]).set("circles", "limits", json!({ "D_um": 1.0, "F_um": 40 })).run();
    let of = |name: &str| figures(&found, "circles").iter().find(|figure| figure.name == name).expect("a figure");
    let signed = of("D[ballbar-xy-f500]");
    assert!(signed.value.expect("D") < -1.4 && signed.limit.is_none());
    assert_eq!(of("|D|[ballbar-xy-f500]").decision, Some(Decision::Fail));
    assert_eq!(of("|F_max_ccw as set up|[ballbar-xy-f500]").decision, Some(Decision::Pass));
    assert_eq!(of("|F_min_ccw as set up|[ballbar-xy-f500]").decision, Some(Decision::Fail));
    let found = positioning().set("positioning", "limits", json!({ "mean_B_um": 3 })).run();
    let figure = figures(&found, "positioning").iter().find(|figure| figure.name == "|mean B|[direct-x]").expect("it");
    assert_eq!(figure.decision, Some(Decision::Fail));
}

/// Of machines exactly at the limit one in twenty is accepted where conformity has to be proved at 95 %, one in two by simple
/// acceptance; by the same way as every figure of a validator.
#[test]
fn few_machines_at_the_limit_are_accepted() {
    let machines = 10_000;
    let accepted = |decision: Value, seed: u64| {
        let limit: abbe_core::Limit =
            serde_json::from_value(json!({ "limit": 20.0, "decision": decision })).expect("it");
        let mut next = normal(seed);
        let mut passes = || {
            let figure = Figure::new("", "A", 20.0 + 0.7 * next(), "um").uncertain(0.7).limited(limit);
            figure.decide() == Some(Decision::Pass)
        };
        f64::from((0..machines).map(|_| u32::from(passes())).sum::<u32>()) / f64::from(machines)
    };
    for seed in 1..=5 {
        for (rule, law) in [
            ("simple", 0.5),
            ("iso-14253-1-2017", 0.0495),
            ("iso-14253-1-1998", 0.02275),
            ("binary-guard-band", 0.02275),
        ] {
            // 2.8 standard deviations: a band of 99.5 % about each of twenty shares.
            let band = 2.8 * (law * (1.0 - law) / f64::from(machines)).sqrt();
            let share = accepted(json!(rule), seed);
            assert!((share - law).abs() <= band, "{rule}, seed {seed}: {share} instead of {law}");
        }
        // At most 5 %, within its band of 99 %.
        let guarded = accepted(json!({ "rule": "iso-14253-1-2017", "probability": 0.95 }), seed);
        assert!(guarded <= 0.05 + 2.326 * (0.05 * 0.95 / f64::from(machines)).sqrt(), "{guarded}");
    }
    assert_eq!(Rule::default(), Rule::Simple {});
}

/// Normal numbers, of a generator that shares nothing with the project.
fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut uniform = move || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    };
    move || (-2.0 * (1.0 - uniform()).ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()
}

/// A of direct-x is 19.41 um with U 4.00 um.
#[test]
fn rules_decide_with_the_uncertainty() {
    let rule = |limit: f64, rule: &str| {
        let mut recipe = positioning();
        recipe.0["stages"]["positioning"]["from"] = json!("linear");
        recipe.0["stages"]["positioning"]["limits"] = json!({ "A_um": { "limit": limit, "decision": rule } });
        let found = recipe.run();
        let figure =
            figures(&found, "positioning").iter().find(|figure| figure.name == "A[direct-x]").expect("A").clone();
        (figure.decision.expect("a decision"), figure.inconclusive.is_some())
    };
    use Decision::{Fail, Inconclusive, Pass};
    assert_eq!(rule(19.5, "simple"), (Pass, false));
    assert_eq!(rule(19.5, "binary-guard-band"), (Fail, false));
    assert_eq!(rule(23.0, "iso-14253-1-1998"), (Inconclusive, true));
    assert_eq!(rule(23.0, "iso-14253-1-2017"), (Pass, false));
    assert_eq!(rule(16.0, "iso-14253-1-1998"), (Inconclusive, true));
    assert_eq!(rule(16.0, "iso-14253-1-2017"), (Fail, false));
}

#[test]
fn wrong_plans_are_told_and_wrong_rows_refused() {
    let text = read(&root().join("pipelines/data/standards/realistic/direct-x.csv"));
    let judged = |text: &str| {
        let folder = crate::support::temporary();
        crate::support::write(&folder.path().join("direct-x.csv"), text);
        let mut recipe = positioning();
        recipe.0["stages"]["linear"]["path"] = json!(folder.path().join("direct-x.csv"));
        recipe.0["stages"]["positioning"]["from"] = json!("linear");
        recipe.0["stages"]["positioning"]["limits"] = json!({ "R_um": 10 });
        recipe.run()
    };
    let one_run: String = text
        .lines()
        .filter(|line| line.starts_with("r") || line.starts_with("1,1,"))
        .fold(String::new(), |text, line| text + line + "\n");
    let found = judged(&one_run);
    let verdict = &found.verdicts[0];
    // What the limit asks for was not measured.
    assert_eq!(verdict.decision, Decision::Fail);
    assert!(verdict.figures.iter().all(|figure| figure.name == "E up[direct-x]" || figure.value.is_none()));
    let told = verdict.remarks.join(" ");
    assert!(told.contains("only one direction") && told.contains("1 runs in a direction"), "{told}");

    let twice = text.clone() + text.lines().nth(1).expect("a row") + "\n";
    let failed = judged(&twice);
    let said: String = failed.failures.iter().map(|failure| failure.error.to_string()).collect();
    assert!(said.contains("has this target in this direction already, in line 2"), "{said}");
    let failed = judged(&text.replace("\n1,1,-372.4000", "\n1,up,-372.4000"));
    let said: String = failed.failures.iter().map(|failure| failure.error.to_string()).collect();
    assert!(said.contains("`direction` is up; 1 or -1 was expected"), "{said}");
}

/// The cells of a table, row by row.
type Cells = Vec<Vec<String>>;

/// A change of cells, by the places of columns.
type Change = dyn Fn(&mut Cells, &dyn Fn(&str) -> usize);

/// Rows of a table by the places of its columns.
fn rows(file: &Path) -> (String, Cells, impl Fn(&str) -> usize) {
    let text = read(file);
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let header = lines.next().expect("a header").to_owned();
    let rows = lines.map(|line| line.split(',').map(str::to_owned).collect()).collect();
    let names: Vec<String> = header.split(',').map(str::to_owned).collect();
    (header, rows, move |name| names.iter().position(|own| own == name).expect("the column"))
}

/// Readings that are copies, the same in all rows or far quieter than stated, and tests that lack most of what they need.
#[test]
fn what_is_no_test_is_told_or_decides_nothing() {
    let folder = crate::support::temporary();
    let told = |name: &str, ingest: &str, change: &Change| {
        let mut recipe = recipe(name);
        let table = recipe.path(ingest, "path");
        let (header, mut rows, place) = rows(&table);
        change(&mut rows, &place);
        let file = folder.path().join(format!("{ingest}.csv"));
        let text: String = rows.iter().fold(header + "\n", |text, row| text + &row.join(",") + "\n");
        crate::support::write(&file, &text);
        recipe.stage(ingest)["path"] = json!(file);
        let outcome = recipe.run();
        assert!(outcome.failures.is_empty(), "{:?}", outcome.failures.first().map(|failure| &failure.error));
        outcome
    };
    let remarks = |outcome: &Outcome| -> String {
        outcome.verdicts.iter().flat_map(|verdict| &verdict.remarks).map(|text| text.clone() + "\n").collect()
    };
    let words = ["are they copies?", "was anything measured?", "is the unit of the column right?"];
    for (name, ingest) in [
        ("positioning", "linear"),
        ("positioning", "rotary"),
        ("diagonals", "ppp"),
        ("circular", "slow"),
        ("cmm", "lengths"),
        ("cmm", "sphere"),
        ("rotary-interpolation", "read-c"),
    ] {
        let said = remarks(&told(name, ingest, &|_, _| {}));
        assert!(!words.iter().any(|word| said.contains(word)), "{name} {ingest}: {said}");
    }
    // One run as all runs; the way back as the way there; one line as all lines; one stylus as all.
    let copied = told("positioning", "linear", &|rows, place| {
        let (run, target, way, reading) = (place("run"), place("position_mm"), place("direction"), place("reading_um"));
        let first = rows[0][run].clone();
        let of_first: Vec<Vec<String>> = rows.iter().filter(|row| row[run] == first).cloned().collect();
        let same = |row: &[String], other: &[String]| {
            let at = |row: &[String]| row[target].parse::<f64>().expect("a position").round();
            row[way] == other[way] && at(row) == at(other)
        };
        for row in rows.iter_mut() {
            let other = of_first.iter().find(|other| same(row, other)).expect("the target");
            row[reading] = other[reading].clone();
        }
    });
    assert!(remarks(&copied).contains(words[0]), "{}", remarks(&copied));
    let copied = told("cmm", "sphere", &|rows, place| {
        let stylus = place("stylus");
        let of = |rows: &[Vec<String>], label: &str| -> Vec<Vec<String>> {
            rows.iter().filter(|row| row[stylus] == label).cloned().collect()
        };
        let (all, first) = (rows.clone(), of(rows, "0"));
        rows.retain(|row| row[stylus] == "0");
        for label in ["1", "2", "3"] {
            assert_eq!(of(&all, label).len(), first.len());
            rows.extend(first.iter().map(|row| {
                let mut row = row.clone();
                row[stylus] = label.to_owned();
                row
            }));
        }
    });
    assert!(remarks(&copied).contains(words[0]), "{}", remarks(&copied));
    // Readings of zero keep all limits, and decide on none.
    let zeros = told("positioning", "linear", &|rows, place| {
        let reading = place("reading_um");
        rows.iter_mut().for_each(|row| row[reading] = "0".to_owned());
    });
    assert!(remarks(&zeros).contains(words[1]), "{}", remarks(&zeros));
    let of_all = zeros.verdicts.iter().flat_map(|verdict| &verdict.figures);
    let of_linear: Vec<&Figure> =
        of_all.filter(|figure| figure.limit.is_some() && figure.name.ends_with("[linear]")).collect();
    assert!(!of_linear.is_empty());
    of_linear.iter().for_each(|figure| assert!(figure.decide() != Some(Decision::Pass), "{figure:?}"));
    let nothing = told("cmm", "lengths", &|rows, place| {
        let (reference, measured) = (place("reference_mm"), place("measured_mm"));
        rows.iter_mut().for_each(|row| row[measured] = row[reference].clone());
    });
    assert!(remarks(&nothing).contains(words[1]), "{}", remarks(&nothing));
    // Millimetres for micrometres, and the same of angles.
    let a_thousandth = |rows: &mut Cells, reading: usize| {
        rows.iter_mut()
            .for_each(|row| row[reading] = format!("{}", 1e-3 * row[reading].parse::<f64>().expect("a number")));
    };
    for (name, ingest) in [("circular", "slow"), ("positioning", "linear"), ("diagonals", "ppp")] {
        let quiet = told(name, ingest, &move |rows, place| a_thousandth(rows, place("reading_um")));
        assert!(remarks(&quiet).contains(words[2]), "{name} {ingest}: {}", remarks(&quiet));
    }
    let quiet = told("positioning", "rotary", &move |rows, place| a_thousandth(rows, place("reading_urad")));
    assert!(remarks(&quiet).contains(words[2]), "{}", remarks(&quiet));
    // Positions with the wrong sign: rows run against their directions. Rows that are sorted do not.
    let against = "run to smaller positions";
    for (name, ingest) in [("positioning", "linear"), ("positioning", "rotary"), ("diagonals", "ppp")] {
        let negated = |rows: &mut Cells, position: usize| {
            rows.iter_mut()
                .for_each(|row| row[position] = (-row[position].parse::<f64>().expect("a number")).to_string());
        };
        let unit = if ingest == "rotary" { "position_deg" } else { "position_mm" };
        let turned = told(name, ingest, &move |rows, place| negated(rows, place(unit)));
        assert!(remarks(&turned).contains(against), "{name} {ingest}: {}", remarks(&turned));
        let stage = if name == "diagonals" { "diagonals" } else { name };
        let of_run = |figure: &&Figure| figure.name.contains(&format!("[{ingest}]")) && figure.limit.is_some();
        let limited: Vec<&Figure> = figures(&turned, stage).iter().filter(of_run).collect();
        assert!(limited.iter().all(|figure| figure.inconclusive.is_some()), "{limited:?}");
        let sorted = told(name, ingest, &move |rows, place| {
            let at = place(unit);
            let position = |row: &[String]| row[at].parse::<f64>().expect("a number");
            rows.sort_by(|one, other| position(other).total_cmp(&position(one)));
        });
        assert!(!remarks(&sorted).contains(against), "{name} {ingest}: {}", remarks(&sorted));
    }
    // Three rows decide nothing; nor does one diagonal of four.
    let short = told("rotary-interpolation", "read-c", &|rows, _| rows.truncate(3));
    let of_c: Vec<&Figure> = figures(&short, "c-axis").iter().filter(|figure| figure.limit.is_some()).collect();
    assert!(!of_c.is_empty() && of_c.iter().all(|figure| figure.inconclusive.is_some()), "{of_c:?}");
    // One row back is no second way.
    let one_back = told("rotary-interpolation", "read-a", &|rows, _| rows.truncate(13));
    let of_a: Vec<&Figure> = figures(&one_back, "a-axis").iter().filter(|figure| figure.limit.is_some()).collect();
    assert!(!of_a.is_empty() && of_a.iter().all(|figure| figure.inconclusive.is_some()), "{of_a:?}");
    // Nor do two targets, ten lengths of 35 and four points of a sphere, which have no form error.
    let two_targets = |rows: &mut Cells, position: usize| {
        let smallest = |row: &Vec<String>| row[position].parse::<f64>().expect("a number") < 40.0;
        rows.retain(smallest);
    };
    let of_axis = told("positioning", "rotary", &move |rows, place| two_targets(rows, place("position_deg")));
    let of_lengths = told("cmm", "lengths-beside", &|rows, _| rows.truncate(3));
    let of_sphere = told("cmm", "sphere", &|rows, _| {
        let mut number = 0;
        rows.retain(|_| {
            number += 1;
            number % 25 < 4
        });
    });
    for (found, run) in [(&of_axis, "[rotary]"), (&of_lengths, "[lengths-beside]"), (&of_sphere, "[sphere]")] {
        let all = found.verdicts.iter().flat_map(|verdict| &verdict.figures);
        let kept: Vec<&Figure> = all
            .filter(|figure| figure.name.ends_with(run) && figure.limit.is_some())
            .filter(|figure| figure.inconclusive.is_none() && figure.decide() == Some(Decision::Pass))
            .collect();
        assert!(kept.is_empty(), "{run}: {kept:?}");
    }
    let mut one = recipe("diagonals");
    one.stage("diagonals")["from"] = json!(["ppp"]);
    let found = one.run();
    let of_body = figures(&found, "diagonals").iter().find(|figure| figure.name == "E_d[body]").expect("the figure");
    assert!(of_body.inconclusive.as_ref().is_some_and(|why| why.contains("1 of 4")), "{of_body:?}");
    let all = recipe("diagonals").run();
    assert!(
        figures(&all, "diagonals").iter().all(|figure| figure.name != "E_d[body]" || figure.inconclusive.is_none())
    );
}

/// Readings that are all 25.4 or 1,000 times too large exceed all limits, and somebody asks for their unit. A machine that is a few times
/// worse than its limits is just that.
#[test]
fn readings_in_a_larger_unit_are_asked_about() {
    let folder = crate::support::temporary();
    let said = |name: &str, ingest: &str, reading: &[&str], factor: f64| -> Vec<String> {
        let mut recipe = recipe(name);
        let table = recipe.path(ingest, "path");
        let (header, mut rows, place) = rows(&table);
        for row in &mut rows {
            for cell in reading.iter().map(|column| place(column)) {
                row[cell] = (factor * row[cell].parse::<f64>().expect("a number")).to_string();
            }
        }
        let file = folder.path().join(format!("{ingest}.csv"));
        crate::support::write(&file, &rows.iter().fold(header + "\n", |text, row| text + &row.join(",") + "\n"));
        recipe.stage(ingest)["path"] = json!(file);
        let outcome = recipe.run();
        assert!(outcome.failures.is_empty(), "{:?}", outcome.failures.first().map(|failure| &failure.error));
        let remarks = outcome.verdicts.iter().flat_map(|verdict| &verdict.remarks);
        remarks.filter(|text| text.contains("is the unit of the column right?")).cloned().collect()
    };
    let of_bar: &[&str] = &["reading_um"];
    for (name, ingest, reading, run, most) in [
        ("positioning", "linear", of_bar, "linear", 1e3),
        ("positioning", "rotary", &["reading_urad"], "rotary", 1e3),
        ("circular", "slow", of_bar, "slow", 25.4),
        ("diagonals", "ppp", of_bar, "body", 1e3),
        ("rotary-interpolation", "read-c", &["meas_x_um", "meas_y_um", "meas_z_um"], "read-c", 1e3),
    ] {
        for factor in [25.4, 1e3].into_iter().filter(|factor| *factor <= most) {
            let found = said(name, ingest, reading, factor);
            let words = format!("divided by {factor}: is the unit of the column right?");
            assert!(
                found.len() == 1 && found[0].starts_with(&format!("{run}: ")),
                "{name} {ingest} {factor}: {found:?}"
            );
            assert!(found[0].ends_with(&words), "{name} {ingest} {factor}: {found:?}");
        }
        for factor in [1.0, 1.5, 3.0, 7.0] {
            assert_eq!(said(name, ingest, reading, factor), Vec::<String>::new(), "{name} {ingest} {factor}");
        }
    }
}

/// A run whose signs are all turned, on random axes: told where its errors are more than its scatter, and never without it.
#[test]
fn a_run_with_turned_signs_is_told() {
    const WORDS: &str = "is the sign of this run wrong?";
    let folder = crate::support::temporary();
    let said = |name: &str, ingest: &str, text: &str| {
        let mut recipe = recipe(name);
        let file = folder.path().join(format!("{ingest}.csv"));
        crate::support::write(&file, text);
        recipe.stage(ingest)["path"] = json!(file);
        let outcome = recipe.run();
        let remarks = outcome.verdicts.iter().flat_map(|verdict| verdict.remarks.clone());
        remarks.filter(|remark| remark.contains(WORDS)).collect::<Vec<String>>()
    };
    // The recipes, as they are and with their second run turned.
    for (name, ingest, reading) in [
        ("positioning", "linear", "reading_um"),
        ("positioning", "rotary", "reading_urad"),
        ("diagonals", "ppp", "reading_um"),
    ] {
        let file = recipe(name).path(ingest, "path");
        let (header, rows, place) = rows(&file);
        let text = |turned: bool| {
            let line = |row: &Vec<String>| {
                let mut row = row.clone();
                if turned && row[place("run")] == "2" {
                    row[place(reading)] = format!("{}", -row[place(reading)].parse::<f64>().expect("a number"));
                }
                row.join(",") + "\n"
            };
            format!("{header}\n{}", rows.iter().map(line).collect::<String>())
        };
        assert_eq!(said(name, ingest, &text(false)), [""; 0], "{name} {ingest}");
        let told = said(name, ingest, &text(true));
        assert!(told.len() == 1 && told[0].contains(": run 2 is "), "{name} {ingest}: {told:?}");
    }
    // Axes with errors from much smaller to much larger than their scatter.
    let mut found = 0;
    for seed in 0..120 {
        let mut random = crate::support::Random::new(seed);
        let (slope, wave, backlash) = (random.within(-20.0, 20.0), random.within(0.0, 5.0), random.within(0.0, 4.0));
        let scatter = 10_f64.powf(random.within(-1.0, 1.0));
        let runs = 3 + random.below(4);
        let turned = random.below(runs);
        let table = |sign: f64, random: &mut crate::support::Random| {
            let mut text = "run,direction,position_mm,reading_um\n".to_owned();
            for run in 0..runs {
                for (way, target) in (0..9).map(|target| (1, target)).chain((0..9).rev().map(|target| (-1, target))) {
                    let at = f64::from(target) * 97.0 + 3.0 * f64::from(target * target % 7);
                    let error = slope * at / 800.0 + wave * (at / 90.0).sin() + 0.5 * backlash * f64::from(way);
                    let own = if run == turned { sign } else { 1.0 };
                    text.push_str(&format!("{run},{way},{at:.3},{:.3}\n", own * error + scatter * random.normal()));
                }
            }
            text
        };
        assert_eq!(said("positioning", "linear", &table(1.0, &mut random)), [""; 0], "{seed}");
        let told = said("positioning", "linear", &table(-1.0, &mut random));
        assert!(told.iter().all(|told| told.contains(&format!(": run {turned} is "))), "{seed}: {told:?}");
        found += told.len();
    }
    assert!(found > 20, "{found} were told");
}
