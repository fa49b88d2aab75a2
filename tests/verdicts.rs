//! What the data can tell: no effect, confounded, ill-conditioned, dropped; the same for `check` and `run`. And what is lost when
//! one stage fails.

use abbe_core::{Error, Monitor, Status};
use abbe_engine::{Outcome, Planned, Prepared, prepare};
use serde_json::{Value, json};

use crate::support::{Printed, Small, Variant, fit, json_file, list, recipes, registry, temporary};

/// What `check` and `run` say of a recipe.
fn both(recipe: &Variant) -> (Result<Vec<Planned>, Error>, Result<Outcome, Error>) {
    let folder = temporary();
    let prepared = prepare(&recipe.write(folder.path()), &registry()).unwrap_or_else(|error| panic!("{error}"));
    (prepared.check(), run(&prepared))
}

/// The outcome of a run without a failed stage, or the error of the first one.
fn run(prepared: &Prepared) -> Result<Outcome, Error> {
    let outcome = prepared.run(&Monitor::default())?;
    match outcome.failures.first() {
        Some(failure) => Err(failure.error.clone()),
        None => Ok(outcome),
    }
}

fn recipe(name: &str) -> Variant {
    Variant::of(&recipes()[name])
}

/// The cylinder with all location errors, one of which (the zero position of C) does nothing to facets around C.
fn cylinder(more: &[&str]) -> Variant {
    let mut recipe = recipe("cylinder-kx8-exact").only(&["fit-S2"]);
    recipe.stage("kx8")["errors"][0] = json!({ "location": ["E?0?"] });
    // On exact data products of errors are larger than the uncertainties: take those that are stated.
    recipe.stage("fit-S2")["trust_uncertainties"] = json!(true);
    let names: Vec<&str> = ["@machine", "s2.*"].into_iter().chain(more.iter().copied()).collect();
    recipe.set("fit-S2", "parameters", list(&names))
}

#[test]
fn what_has_no_effect_is_named_and_costs_nothing_else() {
    let (planned, outcome) = both(&cylinder(&["EC0C"]));
    let found = &planned.expect("a plan")[0].identifiability;
    assert_eq!(found.rank + 1, found.unknowns);
    assert_eq!(found.null_space.len(), 1, "{:?}", found.null_space);
    assert_eq!(found.null_space[0].describe(), "EC0C has no effect on these measurements");
    let error = outcome.err().expect("it is refused").message;
    assert!(error.contains("EC0C has no effect"), "{error}");

    let without = cylinder(&[]).run();
    for (choice, robust) in [("drop", Value::Null), ("minimum-norm", Value::Null), ("drop", json!("tukey"))] {
        let mut with = cylinder(&["EC0C"]).set("fit-S2", "on_confounded", json!(choice));
        if !robust.is_null() {
            with = with.set("fit-S2", "robust", robust);
        }
        let with = with.run();
        let calibration = &fit(&with, "fit-S2").calibration;
        let lost = calibration.get("EC0C").expect("it is there");
        assert!(lost.status == Status::Confounded && lost.value.abs() < 1e-11, "{choice}: {lost:?}");
        for expected in &fit(&without, "fit-S2").calibration.parameters {
            let found = calibration.get(&expected.name).expect("it is there");
            // Exact data: what is left is rounding, however the iteration goes there.
            assert!((found.value - expected.value).abs() < 1e-9, "{choice}: {}", expected.name);
            let settled = expected.status == Status::Fixed || found.status == Status::Estimated;
            assert!(settled || found.name == "EC0C", "{choice}: {} is {:?}", found.name, found.status);
        }
    }
}

#[test]
fn what_is_known_tells_nothing_apart() {
    for name in ["EX0X", "EB0X", "EY0Y", "EA0Y", "EZ0Z", "EA0A", "EC0C"] {
        let mut recipe = recipe("mfb-ucp710").only(&["fit-bar", "fit-sphere-known"]);
        recipe.stage("fit-sphere-known")["parameters"] = json!(["@table-1", name]);
        let (planned, outcome) = both(&recipe);
        let planned = planned.expect("a plan");
        let planned = planned.iter().find(|planned| planned.estimate == "fit-sphere-known").expect("it is planned");
        let found = &planned.identifiability;
        assert!(!planned.accepted && found.rank + 1 == found.unknowns, "{name}: {} of {}", found.rank, found.unknowns);
        let error = outcome.err().unwrap_or_else(|| panic!("{name} passes")).message;
        let expected = format!("the data determine {} of {} unknowns", found.rank, found.unknowns);
        assert!(error.starts_with(&expected) && error.contains(name), "{name}: {error}");
    }
}

#[test]
fn what_is_at_the_mercy_of_the_noise_is_told() {
    let small = Small::new();
    // Rotary axes that hardly move.
    let text = small.read("data/touches.csv");
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let columns: Vec<usize> = (header.split(',').enumerate())
        .filter(|(_, name)| ["B_deg", "C_deg"].contains(name))
        .map(|(at, _)| at)
        .collect();
    let mut out = format!("{header}\n");
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        for &column in &columns {
            let angle: f64 = cells[column].parse().expect("an angle");
            cells[column] = format!("{}", angle * 1e-6);
        }
        out.push_str(&(cells.join(",") + "\n"));
    }
    small.write("data/touches.csv", &out);
    let recipe = small.read("recipe.yaml").replace("\"EXX[1]\", \"table.*\"", "EA0B, \"table.*\"");
    small.write("recipe.yaml", &recipe);
    let printed = small.abbe(&["check", "recipe.yaml"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    for part in ["fine: the condition is", "at the mercy of the noise", "EX0C", "rank_tolerance", "on_confounded: drop"]
    {
        assert!(printed.stdout.contains(part), "{part}: {}", printed.stdout);
    }
}

#[test]
fn people_say_what_is_rather_kept() {
    let truth: Value = json_file(&crate::support::root().join("tests/truth/cylinder-kx8-exact.json"));
    let of = |prefer: &[&str]| {
        let recipe =
            recipe("cylinder-kx8-exact").only(&["fit-section"]).set("fit-section", "on_confounded", json!("drop"));
        recipe.set("fit-section", "prefer", list(prefer)).run()
    };
    let mut left_out = Vec::new();
    for prefer in [&["EA0C", "dzt"][..], &["EB0C", "section.*"], &[]] {
        let outcome = of(prefer);
        let calibration = &fit(&outcome, "fit-section").calibration;
        let dropped = &calibration.fit.dropped;
        assert_eq!(dropped.len(), 2, "{prefer:?}: {dropped:?}");
        assert!(
            prefer.iter().all(|name| !dropped.iter().any(|dropped| abbe_core::matches(name, dropped))),
            "{dropped:?}"
        );
        // What is not marked is right, on exact data.
        for found in calibration.parameters.iter().filter(|found| found.status == Status::Estimated) {
            let true_value = truth["parameters"][&found.name].as_f64().unwrap_or(0.0);
            let allowed = 10.0 * found.standard_uncertainty + 1e-9;
            assert!((found.value - true_value).abs() < allowed, "{prefer:?}: {} = {:e}", found.name, found.value);
        }
        left_out.push(dropped.clone());
    }
    assert_ne!(left_out[0], left_out[1]);

    let recipe = recipe("cylinder-kx8-exact").only(&["fit-section"]).set("fit-section", "on_confounded", json!("drop"));
    let (planned, _) = both(&recipe.set("fit-section", "prefer", list(&["EA0D"])));
    let error = planned.expect_err("it is refused").to_string();
    assert!(error.contains("`EA0D` matches nothing that is to be estimated (did you mean `EA0C`?)"), "{error}");
}

#[test]
fn the_minimal_set_helps_where_the_rank_is_not_full() {
    let mut recipe = recipe("cylinder-kx8-exact").only(&["fit-section"]);
    recipe.0["stages"]["minimal"] = json!({ "validate": "minimal-set", "of": "fit-section" });
    let outcome = recipe.run();
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "minimal").expect("a verdict");
    let of = |name: &str| verdict.figures.iter().find(|figure| figure.name == name).expect("a figure").value;
    let report = &fit(&outcome, "fit-section").calibration.fit;
    assert_eq!((of("rank"), of("left out")), (Some(report.rank as f64), Some(2.0)));
}

#[test]
fn one_stage_that_fails_costs_what_needs_it_and_nothing_else() {
    let small = Small::new();
    let broken =
        small.read("recipe.yaml").replace("parameters: [\"@tool\", EX0C", "parameters: [\"@tool\", EA0B, dxw, EX0C");
    let broken = broken.replace("  fine:\n", "  other: { validate: residuals, of: rough }\n  fine:\n");
    small.write("recipe.yaml", &broken);
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 1, "{}", printed.stdout);
    assert!(printed.stderr.contains("the data determine"), "{}", printed.stderr);
    assert!(printed.stdout.contains("Failed\n  fine (estimate): the data determine"), "{}", printed.stdout);
    assert!(printed.stdout.contains("\n  judge (validate): it needs `fine`, which failed\n"), "{}", printed.stdout);
    let record = json_file(&small.path("out/recipe/run.json"));
    let failures = record["failures"].as_array().expect("failures");
    let of = |name: &str| failures.iter().find(|failure| failure["stage"] == name).expect("it failed");
    assert_eq!((of("fine")["kind"].as_str(), of("fine")["needs"].as_str()), (Some("estimate"), None));
    assert_eq!(of("judge")["needs"], "fine");
    assert!(small.path("out/recipe/rough.calibration.json").is_file());
    assert!(!small.path("out/recipe/fine.calibration.json").exists());
    let verdicts = json_file(&small.path("out/recipe/verdicts.json"));
    let stages: Vec<&str> =
        verdicts.as_array().expect("verdicts").iter().filter_map(|it| it["stage"].as_str()).collect();
    assert_eq!(stages, ["other"]);
    let json: Value = serde_json::from_str(&small.abbe(&["run", "recipe.yaml", "--json"]).stdout).expect("JSON");
    assert_eq!((&json["pass"], json["failures"].as_array().map(Vec::len)), (&json!(false), Some(failures.len())));
}

#[test]
fn a_fold_that_fails_is_reported_and_fails_the_verdict() {
    let mut recipe = Variant::tango("exact").only(&["fit-S3"]);
    // Without the bar there is no scale: that fold cannot be estimated.
    recipe.0["stages"]["folds"] =
        json!({ "validate": "hold-out", "of": "fit-S3", "rows": "table", "column": "group", "folds": 3 });
    let whole = recipe.run();
    let told = |outcome: &Outcome| {
        let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "folds").expect("a verdict").clone();
        let failed = verdict.figures.iter().find(|figure| figure.name == "failed folds").map(|figure| figure.value);
        (verdict.pass, failed, verdict.remarks.join("\n"))
    };
    assert_eq!(told(&whole).1, None);
    // One fold that holds out nearly everything.
    let groups: Vec<String> = {
        let problem = &fit(&whole, "fit-S3").problem;
        let set = problem.sets.iter().find(|set| set.name == "table").expect("the table");
        let labels = set.info().layout.data.labels("group").expect("groups");
        let mut labels: Vec<String> = labels.iter().map(|label| label.to_string()).collect();
        labels.sort();
        labels.dedup();
        labels
    };
    recipe.stage("folds")["folds"] = json!([groups[1..].to_vec(), groups[..1].to_vec()]);
    let (pass, failed, remarks) = told(&recipe.run());
    assert_eq!((pass, failed), (false, Some(Some(1.0))), "{remarks}");
    assert!(remarks.contains("not judged: fit-S3 without"), "{remarks}");
}

#[test]
fn check_finds_what_a_long_run_would_have_found() {
    let cases = [
        ("{ validate: minimal-set, of: fine, candidates: [EX0D] }", "`EX0D` matches no parameter"),
        ("{ validate: minimal-set, of: fine, prefer: [EX0D] }", "`EX0D` matches nothing that is to be estimated"),
        ("{ validate: residuals, of: fine, by: [bal] }", "no observed data set has a column of labels `bal`"),
        ("{ validate: repeats, of: fine, by: cycel }", "cycel"),
        ("{ validate: hold-out, of: fine, rows: table, column: grup, folds: 3 }", "grup"),
        ("{ validate: cause, of: fine, candidates: [EX0D] }", "`EX0D` matches no parameter of the machine"),
        ("{ validate: geometric-bias, of: fine, rows: table, compensated: [EX0D] }", "`EX0D`"),
        ("{ validate: consistency, of: [rough, fine], parameters: [EX0D] }", "`EX0D`"),
        ("{ export: linuxcnc, of: fine, step_mm: 10, axes: [Q] }", "Q"),
    ];
    for (stage, expected) in cases {
        let small = Small::new();
        let recipe = small.read("recipe.yaml").replace("  judge:", &format!("  wrong: {stage}\n  judge:"));
        small.write("recipe.yaml", &recipe);
        for command in [&["check", "recipe.yaml"][..], &["run", "recipe.yaml", "--out", "out"]] {
            let Printed { status, stderr, .. } = small.abbe(command);
            assert!(status == 2 && stderr.contains(expected), "{command:?} {stage}: {status} {stderr}");
            assert!(stderr.contains("stage `wrong`"), "{stderr}");
        }
        assert!(!small.path("out/recipe").exists(), "{stage}: there are results");
    }
}

#[test]
fn sets_work_wherever_patterns_do() {
    let small = Small::new();
    let stage = "{ validate: minimal-set, of: fine, candidates: [EX0C, \"@tool\", EXX*] }";
    let base = small.read("recipe.yaml");
    let recipe = |stage: &str| base.replace("  judge:", &format!("  minimal: {stage}\n  judge:"));
    small.write("recipe.yaml", &recipe(stage));
    let printed = small.abbe(&["run", "recipe.yaml", "--out", "out"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let verdicts = small.read("out/recipe/verdicts.json");
    assert!(verdicts.contains("kept are dxt dyt dzt"), "{verdicts}");
    // Errors point at what people wrote: the entry after the set.
    small.write("recipe.yaml", &recipe(&stage.replace("EXX*", "EXQ*")));
    let stderr = small.abbe(&["check", "recipe.yaml"]).stderr;
    assert!(stderr.contains("`EXQ*` matches no parameter") && stderr.contains("EXQ*]"), "{stderr}");
    small.write("recipe.yaml", &recipe(&stage.replace("@tool", "@toll")));
    let stderr = small.abbe(&["check", "recipe.yaml"]).stderr;
    assert!(stderr.contains("there is no set `toll`") && stderr.contains("did you mean `tool`?"), "{stderr}");
}

#[test]
fn a_machine_can_be_judged_as_it_is() {
    let mut recipe = Variant::tango("exact").only(&["fit-S3"]);
    recipe.0["stages"]["before"] = json!({
        "estimate": "gauss-newton", "machine": recipe.0["stages"]["fit-S3"]["machine"], "observations": ["table"], "parameters": []
    });
    recipe.0["stages"]["raw"] = json!({ "validate": "residuals", "of": ["before", "fit-S3"] });
    let outcome = recipe.run();
    let before = fit(&outcome, "before");
    assert_eq!((before.calibration.fit.unknowns, before.calibration.fit.rank), (0, 0));
    let nominal = before.problem.residuals(&[]).expect("residuals");
    let largest = nominal.iter().fold(0.0, |largest: f64, residual| largest.max(residual.abs()));
    assert!((before.calibration.fit.residual_max_um - largest * 1e3).abs() < 1e-9);
    assert!(largest * 1e3 > 10.0 * fit(&outcome, "fit-S3").calibration.fit.residual_max_um);
}

/// The value of a figure of a verdict.
fn figure(outcome: &Outcome, stage: &str, name: &str) -> f64 {
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == stage).expect("a verdict");
    let figure = verdict.figures.iter().find(|figure| figure.name == name).expect("a figure");
    figure.value.expect("a value")
}

#[test]
fn a_stage_is_split_into_rows_that_train_and_rows_that_are_predicted() {
    // The same by other means: `hold-out` estimates without these indexations and predicts them.
    let split = |unseen: bool| {
        let mut recipe = recipe("samba").only(&["fit-all", "unseen"]);
        if unseen {
            recipe.stage("all")["unseen"] = json!({ "group": [8, 9, 10, 11] });
            recipe.0["stages"]["unseen"] =
                json!({ "validate": "residuals", "of": "fit-all", "observations": "all", "limits": { "rms_um": 2 } });
        }
        recipe.run()
    };
    let (held_out, unseen) = (split(false), split(true));
    for name in ["max", "mean", "rms"] {
        let (expected, found) = (figure(&held_out, "unseen", name), figure(&unseen, "unseen", name));
        assert!((found - expected).abs() < 1e-6, "{name}: {found} instead of {expected}");
    }
    let rows = |outcome: &Outcome| fit(outcome, "fit-all").problem.sets[0].rows.len();
    let predicted = figure(&held_out, "unseen", "predicted");
    assert_eq!(rows(&held_out) - rows(&unseen), predicted as usize);
    // The calibration says which rows it rests on.
    let count = |outcome: &Outcome| -> usize {
        let data = fit(outcome, "fit-all").calibration.data.iter().flat_map(|record| &record.rows);
        data.map(|[first, last]| last - first + 1).sum()
    };
    assert_eq!(count(&held_out) - count(&unseen), predicted as usize);
}

#[test]
fn what_unseen_rows_alone_tell_is_not_predicted() {
    let with = |unseen: Value, more: Value| {
        let mut recipe = recipe("cylinder-kx8").only(&["fit-S2"]);
        recipe.stage("s2")["unseen"] = unseen;
        recipe.0["stages"]["unseen"] = json!({ "validate": "residuals", "of": "fit-S2", "observations": "s2" });
        recipe.set("fit-S2", "on_confounded", more)
    };
    let facet = json!({ "feature": [18], "group": [2] });
    let (planned, outcome) = both(&with(facet.clone(), json!("error")));
    let found = &planned.expect("a plan")[0].identifiability;
    assert_eq!(found.null_space[0].describe(), "s2.facet[18].d has no effect on these measurements");
    assert!(outcome.err().expect("it is refused").message.contains("s2.facet[18].d has no effect"));
    let outcome = with(facet, json!("drop")).run();
    let verdict = outcome.verdicts.iter().find(|verdict| verdict.stage == "unseen").expect("a verdict");
    let remark = &verdict.remarks[0];
    assert!(remark.starts_with("fit-S2: ") && remark.ends_with(" what they depend on: s2.facet[18].d"), "{remark}");
    assert!(figure(&outcome, "unseen", "max") < 10.0);

    for (unseen, expected) in [
        (json!({ "group": [2, 99] }), "no row of `s2` has the group 99"),
        (json!({ "grop": [2] }), "there is no column `grop`"),
        (json!({ "X": [2] }), "the column `X_mm` holds numbers; labels were expected"),
        (json!({ "feature": [11, 12, 13, 14, 15, 16, 17, 18] }), "every row of `s2` is unseen"),
    ] {
        let (planned, outcome) = both(&with(unseen, json!("error")));
        for error in [planned.err(), outcome.err()] {
            let error = error.expect("it is refused");
            let place = error.place.as_ref().expect("a place");
            assert!(place.file.ends_with("recipe.yaml") && place.line.is_some(), "{error}");
            assert!(error.message.contains(expected), "{error}");
        }
    }
}
