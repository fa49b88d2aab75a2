//! The three decisions pass, fail and inconclusive: of figures, verdicts and runs, as text and as JSON.

use std::fmt::Write;

use serde_json::{Value, json};

use crate::libraries::c_library;
use crate::plugins::valid;
use crate::support::{Printed, SMALL, Small, json_file, root};

const RECIPE: &str = "recipe.yaml";
const JUDGE: &str = "{ validate: residuals, of: [rough, fine], limits: { max_um: 1000 } }";

/// A small recipe whose stage `judge` is this one.
fn judged_by(small: &Small, stage: &str) {
    assert!(SMALL.contains(JUDGE));
    small.write(RECIPE, &SMALL.replace(JUDGE, stage));
}

/// Its verdict, as the program writes it.
fn verdict(small: &Small) -> Value {
    let verdicts = json_file(&small.path("out/recipe/verdicts.json"));
    valid("verdicts", &json_file(&root().join("docs/schemas/verdicts.schema.json")), &verdicts);
    verdicts.as_array().expect("verdicts").iter().find(|verdict| verdict["stage"] == "judge").expect("judge").clone()
}

/// What a vendor's validator may find.
fn findings() -> [(&'static str, i32, Value); 5] {
    let max = |value: f64| json!({ "of": "fine", "name": "max", "value": value, "unit": "um", "limit": 30.0 });
    let mean = json!({ "of": "fine", "name": "mean", "value": 7.5, "unit": "um", "limit": null });
    let untold = |value: Value| {
        json!({ "of": "fine", "name": "form", "value": value, "standard_uncertainty": 2.5, "unit": "um", "limit": 10.0,
                "inconclusive": "the probe was disturbed" })
    };
    [
        // No figure of these has a key of after there were three answers.
        ("pass", 0, json!([max(29.5), mean])),
        ("fail", 3, json!([max(30.5), mean, { "name": "none", "value": null, "unit": "1", "limit": 3.0 }])),
        ("inconclusive", 0, json!([max(29.5), mean, untold(json!(11.5))])),
        ("inconclusive", 0, json!([max(29.5), untold(Value::Null)])),
        ("fail", 3, json!([max(30.5), untold(json!(11.5))])),
    ]
}

#[test]
fn each_of_the_three_answers_reaches_people_files_and_the_exit_status() {
    let small = Small::new();
    let library = c_library(small.folder.path(), "tests/vendor-plugins/saying.c", "saying", &[]);
    let mut told = String::new();
    for (expected, status, figures) in findings() {
        let found = json!({ "figures": figures, "remarks": ["That is all."] });
        judged_by(&small, &format!("{{ validate: vendor-saying, of: fine, findings: {found} }}"));
        let run = |more: &[&str]| {
            let arguments = ["run", RECIPE, "--out", "out", "--plugin", &library.to_string_lossy()];
            let Printed { status: found, stdout, stderr } = small.abbe(&[&arguments, more].concat());
            assert_eq!((found, stderr.as_str()), (status, ""), "{expected} {more:?}");
            stdout
        };
        let text = run(&[]);
        let section = text.split("\n\n").find(|section| section.starts_with("judge (")).expect("the verdict is told");
        assert!(section.lines().next().is_some_and(|line| line.ends_with(&format!(": {}", expected.to_uppercase()))));
        writeln!(told, "{section}\n").expect("text");

        let written = verdict(&small);
        assert_eq!((&written["decision"], &written["pass"]), (&json!(expected), &json!(status == 0)));
        for (given, figure) in
            figures.as_array().expect("figures").iter().zip(written["figures"].as_array().expect("figures"))
        {
            assert_eq!(figure.get("decision").is_some(), !given["limit"].is_null(), "{figure}");
            // Keys are added, and nothing is changed.
            given.as_object().expect("a figure").iter().for_each(|(key, value)| assert_eq!(&figure[key], value));
        }

        let for_machines: Value = serde_json::from_str(&run(&["--json", "--isolate-plugins"])).expect("JSON");
        assert_eq!((&for_machines["decision"], &for_machines["pass"]), (&json!(expected), &json!(status == 0)));
        assert!(for_machines["verdicts"].as_array().expect("verdicts").contains(&written), "{for_machines}");
    }
    insta::assert_snapshot!("three_answers", told);
}

#[test]
fn figures_of_plugins_that_contradict_themselves_are_refused() {
    let small = Small::new();
    let library = c_library(small.folder.path(), "tests/vendor-plugins/saying.c", "saying", &[]);
    let figure = |key: &str, value: Value| {
        let mut figure = json!({ "name": "max", "value": 31.0, "unit": "um", "limit": 30.0 });
        figure[key] = value;
        figure
    };
    let mut without_limit = figure("decision", json!("inconclusive"));
    without_limit["limit"] = Value::Null;
    let cases = [
        (figure("decision", json!("pass")), "says `pass` of the figure `max`, whose limit says `fail`"),
        (figure("decision", json!("inconclusive")), "a plugin that cannot tell says why under `inconclusive`"),
        (without_limit, "says `inconclusive` of the figure `max`, which has no limit"),
        (figure("decision", json!("perhaps")), "gave an answer that cannot be read"),
        (figure("decision_rule", json!({ "rule": "guess" })), "gave an answer that cannot be read"),
        (figure("standard_uncertainty", json!(-0.5)), "gave the figure `max` the standard uncertainty -0.5"),
    ];
    for (figure, expected) in cases {
        let found = json!({ "figures": [figure], "remarks": [] });
        judged_by(&small, &format!("{{ validate: vendor-saying, of: fine, findings: {found} }}"));
        let printed = small.abbe(&["run", RECIPE, "--out", "out", "--plugin", &library.to_string_lossy()]);
        let text = printed.stderr.replace(['│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(printed.status == 1 && text.contains(expected), "{expected}: {} {text}", printed.status);
        assert!(text.contains("vendor-saying"), "it does not say who: {text}");
        let verdicts = small.read("out/recipe/verdicts.json");
        assert!(!verdicts.contains("vendor-saying"), "{expected}: there is a verdict");
    }
}

#[test]
fn every_form_of_a_limit_judges_alike() {
    let small = Small::new();
    let written: Vec<Value> = [
        "max_um: 1000",
        "max_um: { limit: 1000 }",
        "max_um: { limit: 1000, decision: simple }",
        "max_um: { limit: 1e3, decision: { rule: simple } }",
    ]
    .map(|limit| {
        judged_by(&small, &JUDGE.replace("max_um: 1000", limit));
        let printed = small.abbe(&["run", RECIPE, "--out", "out"]);
        assert_eq!((printed.status, printed.stderr.as_str()), (0, ""), "{limit}");
        verdict(&small)
    })
    .into();
    assert_eq!(written[0]["decision"], "pass");
    assert_eq!(written[0]["figures"][0]["decision_rule"], json!({ "rule": "simple" }));
    assert!(written.iter().all(|other| *other == written[0]), "{written:?}");
}
