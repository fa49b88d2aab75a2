//! Figures of standards as recipes find them: expected values of simulated tests, decisions, bad input as users meet it.

use std::sync::OnceLock;

use abbe_core::{Decision, Figure};
use abbe_engine::Outcome;
use serde_json::json;

use crate::support::{Variant, json_file, read, recipes, root};

fn positioning() -> Variant {
    Variant::of(&recipes()["standards-positioning"])
}

fn outcome() -> &'static Outcome {
    static ONCE: OnceLock<Outcome> = OnceLock::new();
    ONCE.get_or_init(|| positioning().run())
}

fn figures(outcome: &Outcome) -> &[Figure] {
    &outcome.verdicts.iter().find(|verdict| verdict.stage == "positioning").expect("a verdict").figures
}

#[test]
fn positioning_is_as_expected() {
    let expected = json_file(&root().join("tests/truth/standards-realistic-expected.json"));
    let names = [
        ("A", "A", "U_A"),
        ("A up", "A_up", "U_A"),
        ("A down", "A_down", "U_A"),
        ("E", "E", "U_E"),
        ("E up", "E_up", "U_E"),
        ("E down", "E_down", "U_E"),
        ("M", "M", "U_M"),
        ("R", "R", "U_R"),
        ("R up", "R_up", "U_R"),
        ("R down", "R_down", "U_R"),
        ("B", "B", "U_B"),
    ];
    let close = |found: f64, expected: f64, what: &str| {
        assert!((found - expected).abs() < 1e-8, "{what}: {found} instead of {expected}");
    };
    for file in ["direct-x", "direct-c", "direct-long"] {
        let of = &expected["positioning"][format!("{file}.csv")];
        for (name, key, uncertainty) in names {
            let figure = figures(outcome()).iter().find(|figure| figure.name == format!("{name}[{file}]"));
            match of[key].as_f64() {
                None => assert!(figure.is_none(), "{name} of {file} cannot be told"),
                Some(value) => {
                    let figure = figure.unwrap_or_else(|| panic!("no {name} of {file}"));
                    close(figure.value.expect("a value"), value, name);
                    let stated = of["uncertainty"][uncertainty].as_f64().expect("U");
                    close(2.0 * figure.standard_uncertainty.expect("u"), stated, uncertainty);
                }
            }
        }
        for (name, key) in [("VDI P", "P"), ("VDI Pa", "Pa"), ("VDI Ps", "Ps_max"), ("VDI U", "U_max")] {
            let figure = figures(outcome()).iter().find(|figure| figure.name == format!("{name}[{file}]"));
            assert_eq!(figure.is_some(), of["vdi3441"].is_object(), "{name} of {file}");
            if let Some(figure) = figure {
                close(figure.value.expect("a value"), of["vdi3441"][key].as_f64().expect("a value"), name);
            }
        }
    }
}

/// A of direct-x is 19.41 um with U 4.00 um.
#[test]
fn rules_decide_with_the_uncertainty() {
    let rule = |limit: f64, rule: &str| {
        let mut recipe = positioning();
        recipe.0["stages"]["positioning"]["from"] = json!("linear");
        recipe.0["stages"]["positioning"]["limits"] = json!({ "A_um": { "limit": limit, "decision": rule } });
        let found = recipe.run();
        let figure = figures(&found).iter().find(|figure| figure.name == "A[direct-x]").expect("A").clone();
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
