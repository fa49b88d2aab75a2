//! Verify the machine, the spindle, the tools, cut: one recipe, one verdict, one exit status.

use serde_json::json;

use crate::support::{Variant, abbe, read, recipes, root, temporary};

const STAGES: [&str; 3] = ["verify", "spindle", "tools-of-the-cut"];

fn recipe() -> Variant {
    Variant::of(&recipes()["before-the-cut"])
}

/// Exit status, what was printed, and decision of each stage.
fn run(recipe: &Variant) -> (i32, String, Vec<String>) {
    let folder = temporary();
    let file = recipe.write(folder.path());
    let out = folder.path().join("out");
    let printed = abbe(folder.path(), &["run".as_ref(), file.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    let decision = |stage: &str| {
        let line = printed.stdout.lines().find(|line| line.starts_with(&format!("{stage} (")));
        line.and_then(|line| line.rsplit_once(": ")).map_or(String::new(), |(_, decision)| decision.to_owned())
    };
    // The offsets of the tools are there in any case, and the list of those that are locked.
    if printed.status != 1 && printed.status != 2 {
        assert!(read(&out.join("recipe/offsets/locked.csv")).starts_with("tool,reason"));
    }
    (printed.status, format!("{}{}", printed.stdout, printed.stderr), STAGES.map(decision).to_vec())
}

#[test]
fn a_healthy_machine_spindle_and_tools_may_cut() {
    let (status, text, decisions) = run(&recipe());
    assert_eq!((status, decisions), (0, ["PASS"; 3].map(str::to_owned).to_vec()), "{text}");
}

#[test]
fn each_of_the_three_alone_stops_the_cut() {
    let crashed = root().join("pipelines/data/rapid-verify/realistic/three-axis/verify-16.csv");
    let fast = root().join("pipelines/data/spindle-motion/realistic/motion-9000.csv");
    let cases = [
        recipe().set("today", "path", json!(crashed)),
        recipe().set("spindle-run", "path", json!(fast)).set("motion", "speeds_rpm", json!([9000])),
        recipe().set("tools-of-the-cut", "tools", json!([1, 2, 3])),
    ];
    for (bad, recipe) in cases.iter().enumerate() {
        let (status, text, decisions) = run(recipe);
        assert_eq!(status, 3, "{}: {text}", STAGES[bad]);
        for (stage, decision) in decisions.iter().enumerate() {
            assert_eq!(decision == "FAIL", stage == bad, "{}: {decisions:?}", STAGES[bad]);
        }
    }
}

#[test]
fn a_log_that_cannot_be_used_is_no_verdict_on_tools() {
    let folder = temporary();
    let text = read(&root().join("pipelines/data/tool-check/realistic/tool-log.csv"));
    let without: Vec<&str> = text.lines().filter(|line| !line.contains(",14,0,")).collect();
    let log = folder.path().join("tool-log.csv");
    crate::support::write(&log, &(without.join("\n") + "\n"));
    let (status, text, decisions) = run(&recipe().set("setter", "path", json!(log)));
    // The others are judged, but the run is an error and not a verdict.
    assert_eq!((status, decisions[2].as_str()), (1, ""), "{text}");
    assert!(text.contains("session 14 has no reading of the master, tool 0"), "{text}");
}
