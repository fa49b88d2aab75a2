//! Manifests of somebody else, and files that are none.

use std::fs;

use super::plant::{Plant, ok, quiet};
use crate::support::{json_file, read, root, temporary, write};

/// A name with a slash behind it is no way round what stands there, and a later command would remove what has a name of its own.
#[test]
fn plans_and_merges_replace_no_file_by_another_name() {
    let folder = temporary();
    let at = folder.path();
    Plant::of(3).write(at);
    write(&at.join("mine.csv"), "mine\n");
    std::os::unix::fs::symlink("mine.csv", at.join("link")).expect("a link");
    fs::create_dir(at.join("sub")).expect("a folder");
    for out in ["mine.csv/", "sub/../mine.csv/", "link/", "fleet.yaml/", "mine.csv/.", ".abbe-partial-abcdefghijkl"] {
        let before = read(&at.join("fleet.yaml"));
        let printed = quiet(at, &["fleet", "plan", "fleet.yaml", "--out", out]);
        assert_eq!(printed.status, 2, "{out}: {}{}", printed.stdout, printed.stderr);
        assert_eq!(read(&at.join("mine.csv")), "mine\n", "{out}");
        assert_eq!(read(&at.join("fleet.yaml")), before, "{out}");
        assert!(at.join("link").is_symlink() && !at.join(".abbe-partial-abcdefghijkl").exists(), "{out}");
    }
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
    let merge = |out: &str| quiet(at, &["fleet", "merge", "fleet.manifest.jsonl", "--out", out]);
    let printed = merge(".abbe-partial-abcdefghijkl");
    assert!(printed.status == 2 && printed.stderr.contains("a name of temporary folders"), "{}", printed.stderr);
    assert!(!at.join("plant.sqlite").exists());
    // Tables beside the results of jobs, which stay.
    ok(&merge("fleet.results"));
    ok(&merge("elsewhere"));
    assert_eq!(read(&at.join("fleet.results/jobs.csv")), read(&at.join("elsewhere/jobs.csv")));
}

/// A history that has the place of what a merge writes would be lost with it.
#[test]
fn a_history_in_the_place_of_a_table_is_refused() {
    let folder = temporary();
    let at = folder.path();
    Plant::of(2).write(at);
    let fleet = read(&at.join("fleet.yaml"));
    for (history, status) in [("merged/written.jsonl", 2), ("./merged/jobs.csv", 2), ("merged/plant.sqlite", 0)] {
        write(&at.join("fleet.yaml"), &fleet.replace("history: plant.sqlite", &format!("history: {history}")));
        let _ = fs::remove_file(at.join("fleet.manifest.jsonl"));
        ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
        ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl"]));
        fs::create_dir_all(at.join("merged")).expect("a folder");
        let printed = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl", "--out", "merged"]);
        assert_eq!(printed.status, status, "{history}: {}{}", printed.stdout, printed.stderr);
        assert_eq!(at.join(history).exists(), status == 0, "{history}");
        assert!(status == 0 || printed.stderr.contains("has a name as they have"), "{history}: {}", printed.stderr);
    }
}

/// What a job is called and when it was stands in the manifest alone, and a history keeps it for good.
#[test]
fn what_was_changed_since_it_was_planned_is_not_merged() {
    let folder = temporary();
    let at = folder.path();
    Plant::of(3).write(at);
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl"]));
    let manifest = at.join("fleet.manifest.jsonl");
    let own = read(&manifest);
    let changes: [&dyn Fn(&str) -> String; 4] = [
        &|text| text.replacen("\"at\":1.0", "\"at\":7.0", 1),
        &|text| text.replacen("\"machine\":\"m00000\"", "\"machine\":\"m00001\"", 1),
        &|text| text.replacen("\"fleet\":\"A plant\"", "\"fleet\":\"B plant\"", 1),
        &|text| text.replacen("\"history\":\"plant.sqlite\"", "\"history\":\"plant2.sqlite\"", 1),
    ];
    for (number, change) in changes.iter().enumerate() {
        let changed = change(&own);
        assert_ne!(changed, own, "{number}");
        write(&manifest, &changed);
        for command in [&["fleet", "status", "fleet.manifest.jsonl"][..], &["fleet", "merge", "fleet.manifest.jsonl"]] {
            let printed = quiet(at, command);
            assert_eq!(printed.status, 1, "{number}: {}{}", printed.stdout, printed.stderr);
            for word in ["it was changed since it was planned", "plan the fleet again", "fleet.manifest.jsonl"] {
                assert!(printed.stderr.contains(word), "{number}, {word}: {}", printed.stderr);
            }
            assert!(!at.join("fleet.merged").exists() && !at.join("plant.sqlite").exists(), "{number}");
        }
    }
    write(&manifest, &own);
    ok(&quiet(at, &["fleet", "status", "fleet.manifest.jsonl"]));
    ok(&quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]));
}

/// A plan takes the place of an earlier one of the same fleet, as it was planned, and of nothing else.
#[test]
fn a_plan_replaces_its_own_manifest_alone() {
    let folder = temporary();
    let at = folder.path();
    let plant = Plant::of(3);
    plant.write(at);
    let plan = |fleet: &str, out: &str| quiet(at, &["fleet", "plan", fleet, "--out", out]);
    ok(&plan("fleet.yaml", "kept.jsonl"));
    let own = read(&at.join("kept.jsonl"));
    ok(&plan("fleet.yaml", "kept.jsonl"));
    assert_eq!(read(&at.join("kept.jsonl")), own, "the same plan has the same bytes");
    // Another fleet; and one of this name in another folder.
    write(&at.join("other.yaml"), &read(&at.join("fleet.yaml")).replace("name: A plant", "name: Another plant"));
    let elsewhere = at.join("elsewhere");
    plant.write(&elsewhere);
    let refused = |printed: crate::support::Printed, words: &[&str], before: &str| {
        assert_eq!(printed.status, 2, "{}{}", printed.stdout, printed.stderr);
        for word in words.iter().chain(&["kept.jsonl", "move it away, or name another file: `--out MANIFEST`"]) {
            assert!(printed.stderr.contains(word), "{word}: {}", printed.stderr);
        }
        assert_eq!(read(&at.join("kept.jsonl")), before);
    };
    refused(plan("other.yaml", "kept.jsonl"), &["another fleet", "`A plant`, not of `Another plant`"], &own);
    refused(plan("elsewhere/fleet.yaml", "kept.jsonl"), &["another fleet of this name", "`elsewhere`"], &own);
    // Changes by hand: of a job, of the head, a line more or less, a note.
    let changes: [&dyn Fn(&str) -> String; 6] = [
        &|text| text.replacen("data/m00000/w1.csv", "data/m00001/w1.csv", 1),
        &|text| text.replacen("\"history\":\"plant.sqlite\"", "\"history\":\"plant2.sqlite\"", 1),
        &|text| text.lines().take(3).map(|line| format!("{line}\n")).collect(),
        &|text| text.to_owned() + text.lines().last().expect("a line") + "\n",
        &|text| text.to_owned() + "\n",
        &|text| text.replacen('{', "{\"note\":\"mine\",", 1),
    ];
    for (number, change) in changes.iter().enumerate() {
        let changed = change(&own);
        assert_ne!(changed, own, "{number}");
        write(&at.join("kept.jsonl"), &changed);
        refused(plan("fleet.yaml", "kept.jsonl"), &["was changed since it was planned"], &changed);
    }
    // Something that only looks like a manifest.
    for text in ["{\"abbe_fleet_manifest\":1}\n", "abbe_fleet_manifest: 1\n", "", "a list\n"] {
        write(&at.join("kept.jsonl"), text);
        refused(plan("fleet.yaml", "kept.jsonl"), &["no manifest of a fleet"], text);
    }
    // Programs before this one wrote no hash, and other versions have another number.
    let head = own.lines().next().expect("a line");
    let sha256 = json(head)["sha256"].as_str().expect("a hash").to_owned();
    let without = own.replacen(&format!(",\"sha256\":\"{sha256}\""), "", 1);
    assert_ne!(without, own);
    write(&at.join("kept.jsonl"), &without);
    ok(&quiet(at, &["fleet", "status", "kept.jsonl"]));
    write(&at.join("kept.jsonl"), &without.replacen("\"version\":\"", "\"version\":\"0.0.1-", 1));
    ok(&plan("fleet.yaml", "kept.jsonl"));
    assert_eq!(read(&at.join("kept.jsonl")), own);
    // A fleet that has changed replaces its plan.
    let more = Plant::of(4);
    more.write(at);
    ok(&plan("fleet.yaml", "kept.jsonl"));
    assert_eq!(read(&at.join("kept.jsonl")).lines().count(), 5);
}

fn json(line: &str) -> serde_json::Value {
    serde_json::from_str(line).expect("a line of JSON")
}

/// Whatever stands in the place of a manifest, each command says what it is, what was expected, and what to do.
#[test]
fn what_is_no_manifest_is_told() {
    let folder = temporary();
    let at = folder.path();
    Plant::of(2).write(at);
    write(&at.join("notes.txt"), "call the plant\n");
    fs::write(at.join("picture.png"), [0x89, b'P', b'N', b'G', 0, 0xff, b'\n']).expect("a file");
    write(&at.join("empty.jsonl"), "");
    write(&at.join("list.json"), "[1, 2]\n");
    fs::copy(root().join("docs/schemas/fleet.schema.json"), at.join("schema.json")).expect("a file");
    assert!(json_file(&at.join("schema.json")).is_object());
    for (file, words) in [
        ("recipe.yaml", ["this is a recipe", "docs/fleets.md"]),
        (
            "fleet.yaml",
            ["this is what a fleet is planned from", "`abbe fleet plan fleet.yaml` writes fleet.manifest.jsonl"],
        ),
        ("machines.csv", ["this is no manifest", "plan the fleet"]),
        ("notes.txt", ["this is no manifest", "plan the fleet"]),
        ("picture.png", ["this is no manifest", "plan the fleet"]),
        ("empty.jsonl", ["this is no manifest", "plan the fleet"]),
        ("list.json", ["this is no manifest", "plan the fleet"]),
        ("schema.json", ["this is no manifest", "plan the fleet"]),
    ] {
        for command in [&["status"][..], &["next"], &["run"], &["merge"], &["job", "--index", "0"]] {
            let mut arguments = vec!["fleet", command[0], file];
            arguments.extend(&command[1..]);
            let printed = quiet(at, &arguments);
            assert_eq!(printed.status, 2, "{arguments:?}: {}{}", printed.stdout, printed.stderr);
            let text = printed.stderr.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
            for word in
                words.iter().chain(&[file, "a manifest was expected, which `abbe fleet plan FLEET.yaml` writes"])
            {
                assert!(text.contains(word), "{arguments:?}: {word}: {text}");
            }
        }
    }
}
