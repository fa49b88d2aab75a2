//! What is wrong: in a fleet, in its data, with its workers. It is told by name, and costs no other job.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::plant::{Plant, bounded, lengths, ok, quiet, start};
use super::{contents, merged, reference, same};
use crate::libraries::c_library;
use crate::plugins::valid;
use crate::support::{Random, json_file, read, root, temporary, write};

/// Jobs whose data are broken, are gone, have changed; whose process crashes or hangs.
#[test]
fn a_poisoned_job_costs_no_other() {
    let folder = temporary();
    let at = folder.path();
    let library = c_library(at, "tests/bad-plugins/bad.c", "bad", &[]);
    let sha256 = sha256(&fs::read(&library).expect("the library"));
    let recipe = json!({ "abbe": 1, "plugins": [{ "path": "libbad.so", "sha256": sha256 }], "stages": {
        "runs": { "ingest": "csv", "path": "lengths.csv" },
        "bar": { "artefact": "length", "from": "runs", "standard_uncertainty_um": 1.0 },
        "machine": { "model": "bad-model", "mode": "good" },
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["bar"], "parameters": ["E*[1]"] },
    } });
    write(&at.join("recipe.yaml"), &recipe.to_string());
    let mut random = Random::new(5);
    let mut rows = "name,mode,file\n".to_owned();
    for (name, mode) in [
        ("first", "good"),
        ("crash", "abort"),
        ("second", "good"),
        ("hang", "hang"),
        ("third", "good"),
        ("broken", "good"),
        ("changed", "good"),
        ("fourth", "good"),
        ("gone", "good"),
        ("fifth", "good"),
    ] {
        rows.push_str(&format!("{name},{mode},data/{name}.csv\n"));
        write(&at.join(format!("data/{name}.csv")), &lengths(&mut random));
    }
    write(&at.join("jobs.csv"), &rows);
    let broken = read(&at.join("data/broken.csv")).replacen("\n3,", "\n3,not a number", 1);
    write(&at.join("data/broken.csv"), &broken);
    fs::remove_file(at.join("data/gone.csv")).expect("it goes");
    write(
        &at.join("fleet.yaml"),
        "abbe_fleet: 1\nfamilies:\n  f:\n    recipe: recipe.yaml\n    for: { name: { table: jobs.csv } }\n    \
         set: { machine.mode: \"{mode}\", runs.path: \"{file}\" }\n",
    );
    let planned = quiet(at, &["fleet", "plan", "fleet.yaml"]);
    assert!(planned.status == 1 && planned.stdout.contains("failed: f/gone: "), "{}{}", planned.stdout, planned.stderr);
    write(&at.join("data/changed.csv"), &lengths(&mut random));
    let run = ["fleet", "run", "fleet.manifest.jsonl", "--workers", "2", "--retries", "1", "--time-limit", "4"];
    let printed = quiet(at, &run);
    assert_eq!(printed.status, 1, "{}", printed.stderr);
    let expected = [
        ("f/crash", "its process was ended by signal 6"),
        ("f/hang", "it takes longer than 4 s, the time limit of a job"),
        ("f/broken", "data/broken.csv:"),
        ("f/changed", "data/changed.csv: the file is not the one that was planned"),
        ("f/gone", "does not exist"),
    ];
    let told = |text: &str| {
        let lines: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("failed: ")).collect();
        assert_eq!(lines.len(), expected.len(), "{text}");
        for (line, (name, why)) in lines.iter().zip(expected) {
            assert!(line.starts_with(&format!("{name}: ")) && line.contains(why), "{text}");
        }
    };
    assert!(printed.stdout.starts_with("5 jobs done\n"), "{}", printed.stdout);
    told(&printed.stdout);
    let status = quiet(at, &["fleet", "status", "fleet.manifest.jsonl"]);
    assert!(status.status == 1 && status.stdout.starts_with("5 done, 5 failed, 0 open\n"), "{}", status.stdout);
    told(&status.stdout);
    let printed = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]);
    assert_eq!(printed.status, 1, "{}", printed.stderr);
    told(&printed.stdout);
    let jobs = read(&at.join("fleet.merged/jobs.csv"));
    for name in ["first", "second", "third", "fourth", "fifth"] {
        assert!(jobs.contains(&format!("f/{name},f,done,")), "{jobs}");
    }
    assert_eq!(jobs.matches(",failed,").count(), 5, "{jobs}");
    // One that is mended is done; the others stay what they are.
    write(&at.join("data/broken.csv"), &broken.replace("not a number", ""));
    assert_eq!(quiet(at, &["fleet", "plan", "fleet.yaml"]).status, 1);
    let printed = quiet(at, &run);
    assert!(printed.stdout.starts_with("2 jobs done, 5 were done before\n"), "{}", printed.stdout);
}

/// The program that watches is killed again and again, and its workers one by one: the rest is done later, nothing twice in the result.
#[test]
fn killed_processes_leave_whole_results() {
    let mut random = Random::new(21);
    let plant = Plant { weeks: (1..=24).collect(), ..Plant::of(6) };
    let expected = reference(&plant);
    let folder = temporary();
    plant.write(folder.path());
    ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
    let mut ended = 0;
    for round in 0..8 {
        let mut process = start(folder.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]);
        let began = Instant::now();
        while children(process.id()).is_empty() && process.try_wait().is_ok_and(|ended| ended.is_none()) {
            assert!(began.elapsed() < Duration::from_secs(120), "no worker begins");
            std::thread::sleep(Duration::from_millis(2));
        }
        std::thread::sleep(Duration::from_millis(random.below(200) as u64));
        let workers = children(process.id());
        assert!(workers.len() <= 2);
        if round % 2 == 0 {
            let _ = process.kill();
            let _ = process.wait();
            // Workers do not outlive the program that gives them work.
            let began = Instant::now();
            while workers.iter().any(|worker| lives(*worker)) {
                assert!(began.elapsed() < Duration::from_secs(120), "a worker lives on");
                std::thread::sleep(Duration::from_millis(5));
            }
        } else {
            for worker in &workers {
                ended += usize::from(kill(*worker));
            }
            // They are started again, and the jobs tried again.
            ok(&bounded(process, Duration::from_secs(600)));
            let left = folder.path().join("fleet.results");
            fs::remove_dir_all(left).expect("the results go");
        }
    }
    assert!(ended > 0, "no worker was killed");
    ok(&quiet(folder.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
    same(&merged(folder.path()), &expected, "after many deaths");
    assert_eq!(fs::read_dir(folder.path().join("fleet.results/new")).expect("a folder").count(), 0);
    assert!(contents(folder.path()).contains_key(Path::new("plant.sqlite")));
}

fn children(of: u32) -> Vec<u32> {
    let text = fs::read_to_string(format!("/proc/{of}/task/{of}/children")).unwrap_or_default();
    let threads = fs::read_dir(format!("/proc/{of}/task")).into_iter().flatten().flatten();
    let all = threads.filter_map(|thread| fs::read_to_string(thread.path().join("children")).ok());
    std::iter::once(text)
        .chain(all)
        .flat_map(|text| text.split_whitespace().filter_map(|id| id.parse().ok()).collect::<Vec<u32>>())
        .collect::<std::collections::BTreeSet<_>>()
        .into_iter()
        .collect()
}

fn lives(process: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    !status.is_empty() && !status.contains(") Z ")
}

fn kill(process: u32) -> bool {
    Command::new("kill").args(["-9", &process.to_string()]).output().is_ok_and(|output| output.status.success())
}

fn sha256(content: &[u8]) -> String {
    use sha2::{Digest, Sha256};
    Sha256::digest(content).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn mistakes_in_a_fleet_have_their_places() {
    let folder = temporary();
    let at = folder.path();
    let plant = Plant::of(2);
    plant.write(at);
    let good = read(&at.join("fleet.yaml"));
    let schema = json_file(&root().join("docs/schemas/fleet.schema.json"));
    let value = |text: &str| -> Value { serde_yaml::from_str(text).expect("YAML") };
    valid("the fleet", &schema, &value(&good));
    let changed = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        good.replacen(from, to, 1)
    };
    let cases = [
        ("no_version", changed("abbe_fleet: 1\n", "")),
        ("other_version", changed("abbe_fleet: 1", "abbe_fleet: 2")),
        ("misspelt_key", changed("families:", "famlies:")),
        ("unknown_key", changed("    label:", "    lable:")),
        ("no_recipe", changed("    recipe: recipe.yaml\n", "")),
        ("no_such_recipe", changed("recipe: recipe.yaml", "recipe: none.yaml")),
        ("no_such_stage", changed("runs.path", "run.path")),
        ("nowhere", changed("runs.path", "runs.path.more")),
        ("stage_alone", changed("runs.path", "runs")),
        ("unknown_variable", changed("{machine}/w", "{machin}/w")),
        ("open_brace", changed("w{week}.csv", "w{week.csv")),
        ("no_time", changed("at: \"{week}\"", "at: \"{machine}\"")),
        ("time_is_missing", changed("    at: \"{week}\"\n", "")),
        ("two_names", changed("week: [1]", "week: [1, 1]")),
        ("password", changed("plant.sqlite", "postgres://me:secret@plant/abbe")),
        ("shards", changed("    unit: week\n", "    unit: week\n    shards: 4\n")),
        ("no_files", changed("    unit: week\n", "    unit: week\n    shards: { stage: fit, from: runs }\n")),
        (
            "shards_of_nothing",
            changed("    unit: week\n", "    unit: week\n    shards: { stage: fit, from: run, files: 1 }\n"),
        ),
        (
            "shards_and_trials",
            changed(
                "    unit: week\n",
                "    unit: week\n    shards: { stage: fit, from: runs, files: 1 }\n    trials: { stage: fit, block: 1 }\n",
            ),
        ),
        ("no_block", changed("    unit: week\n", "    unit: week\n    trials: { stage: fit }\n")),
        ("block_of_nothing", changed("    unit: week\n", "    unit: week\n    trials: { stage: fit, block: 0 }\n")),
        ("not_yaml", good.clone() + "  - {\n"),
        ("no_families", "abbe_fleet: 1\nfamilies: {}\n".to_owned()),
    ];
    let mut said = String::new();
    for (case, text) in &cases {
        write(&at.join("fleet.yaml"), text);
        let printed = quiet(at, &["fleet", "plan", "fleet.yaml"]);
        assert_eq!(printed.status, 2, "{case}: {}{}", printed.stdout, printed.stderr);
        assert!(!printed.stderr.contains("secret"), "{case}");
        said.push_str(&format!("{case}\n{}\n", printed.stderr.trim_end()));
    }
    insta::with_settings!({ snapshot_path => "../snapshots" }, {
        insta::assert_snapshot!("mistakes_in_a_fleet", said);
    });
    for (case, arguments, status) in [
        ("no manifest", &["fleet", "run", "none.jsonl"][..], 2),
        ("another file", &["fleet", "status", "recipe.yaml"], 2),
        ("a plugin", &["fleet", "run", "fleet.manifest.jsonl", "--plugin", "a.so"], 2),
    ] {
        assert_eq!(quiet(at, arguments).status, status, "{case}");
    }
    write(&at.join("fleet.yaml"), &good);
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    let printed = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]);
    assert!(printed.status == 1 && printed.stderr.contains("2 of 2 jobs are open"), "{}", printed.stderr);
    assert_eq!(quiet(at, &["fleet", "job", "fleet.manifest.jsonl", "--index", "2"]).status, 2);
    let manifest = at.join("fleet.manifest.jsonl");
    let text = read(&manifest);
    for (case, text) in [
        ("another version", text.replacen("\"version\":\"", "\"version\":\"9", 1)),
        ("another format", text.replacen("\"abbe_fleet_manifest\":1", "\"abbe_fleet_manifest\":2", 1)),
        ("cut off", text[..text.len() - 20].to_owned()),
        ("no line", text.lines().next().expect("a line").to_owned() + "\n"),
    ] {
        write(&manifest, &text);
        assert_ne!(quiet(at, &["fleet", "run", "fleet.manifest.jsonl"]).status, 0, "{case}");
    }
    // A line that is no JSON is told by its place in the file.
    write(&manifest, &text.replacen("\"variables\":", "\"variables\" ", 1));
    let printed = quiet(at, &["fleet", "status", "fleet.manifest.jsonl"]);
    let column = text.lines().nth(1).and_then(|line| line.find("\"variables\":")).expect("a job") + 13;
    let place = format!("fleet.manifest.jsonl:2:{column}");
    assert!(printed.stderr.contains(&place) && !printed.stderr.contains("at line"), "{place}: {}", printed.stderr);
    // A line that was changed by hand is not the job that it says.
    write(&manifest, &text.replace("data/m00000/w1.csv", "data/m00001/w1.csv"));
    let printed = quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--retries", "0"]);
    assert!(printed.status == 1 && printed.stdout.contains("is not the one that was planned"), "{}", printed.stdout);
}

/// Files that somebody has where a fleet would write stay; a damaged result is open, and a job names no place outside.
#[test]
fn files_of_others_stay() {
    let folder = temporary();
    let at = folder.path();
    let plant = Plant::of(3);
    plant.write(at);
    let recipe = read(&at.join("recipe.yaml"));
    for file in ["recipe.yaml", "fleet.yaml", "machines.csv"] {
        let before = read(&at.join(file));
        let printed = quiet(at, &["fleet", "plan", "fleet.yaml", "--out", file]);
        assert!(printed.status == 2 && printed.stderr.contains("no manifest"), "{file}: {}", printed.stderr);
        assert_eq!(read(&at.join(file)), before);
    }
    #[cfg(unix)]
    {
        let link = at.join("fleet.manifest.jsonl");
        std::os::unix::fs::symlink("recipe.yaml", &link).expect("a link");
        assert_eq!(quiet(at, &["fleet", "plan", "fleet.yaml"]).status, 2);
        assert_eq!(read(&at.join("recipe.yaml")), recipe);
        fs::remove_file(&link).expect("it goes");
    }
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    // A manifest takes the place of another one.
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "1"]));
    write(&at.join("tables/parameters.csv"), "mine");
    let merge = ["fleet", "merge", "fleet.manifest.jsonl", "--calibrations", "--out", "tables"];
    let printed = quiet(at, &merge);
    assert!(printed.status == 1 && printed.stderr.contains("no merge wrote it"), "{}", printed.stderr);
    assert_eq!(crate::support::tree(&at.join("tables")), [Path::new("parameters.csv")]);
    assert_eq!(read(&at.join("tables/parameters.csv")), "mine");
    fs::remove_file(at.join("tables/parameters.csv")).expect("it goes");
    ok(&quiet(at, &merge));
    ok(&quiet(at, &merge));
    let table = read(&at.join("tables/parameters.csv"));
    let calibration = at.join("tables/calibrations").join("weekly-m00001-1.fit.calibration.json");
    let own = read(&calibration).replacen("\"value\"", "\"value\" ", 1);
    write(&calibration, &own);
    assert_eq!(quiet(at, &merge).status, 1);
    assert_eq!((read(&calibration), read(&at.join("tables/parameters.csv"))), (own, table.clone()));
    fs::remove_file(&calibration).expect("it goes");
    // A damaged result.
    let store = at.join("fleet.results");
    let results = || {
        let files = crate::support::tree(&store).into_iter();
        files.filter(|name| name.extension() == Some("result".as_ref())).collect::<Vec<_>>()
    };
    let first = store.join(&results()[0]);
    let content = fs::read(&first).expect("a result");
    fs::write(&first, &content[..content.len() - 100]).expect("it is cut off");
    let printed = quiet(at, &merge);
    assert!(printed.status == 1 && printed.stderr.contains("1 of 3 jobs are open"), "{}", printed.stderr);
    assert_eq!(read(&at.join("tables/parameters.csv")), table);
    // A line that leads elsewhere.
    let manifest = at.join("fleet.manifest.jsonl");
    let id = super::plant::lines(&manifest)[1]["job"].as_str().expect("a hash").to_owned();
    write(&manifest, &read(&manifest).replace(&id, "../../evil"));
    for command in [&["fleet", "run", "fleet.manifest.jsonl"][..], &["fleet", "status", "fleet.manifest.jsonl"]] {
        let printed = quiet(at, command);
        assert!(printed.status == 1, "{}{}", printed.stdout, printed.stderr);
    }
    let outside = fs::read_dir(at).expect("a folder").flatten().map(|entry| entry.file_name());
    assert!(outside.into_iter().all(|name| !name.to_string_lossy().contains("evil")));
}

/// What a run tells of its data a merge tells of the job.
#[test]
fn remarks_of_jobs_are_told() {
    let folder = temporary();
    let at = folder.path();
    Plant::of(3).write(at);
    let doubled = at.join("data/m00001/w1.csv");
    let text = read(&doubled);
    let rows: Vec<&str> = text.lines().skip(1).collect();
    write(&doubled, &(text.clone() + &rows.join("\n") + "\n"));
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "1"]));
    let merged = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl"]);
    ok(&merged);
    assert!(merged.stdout.contains("1 jobs have remarks on their estimates"), "{}", merged.stdout);
    let jobs = read(&at.join("fleet.merged/jobs.csv"));
    let counts: Vec<bool> = jobs.lines().skip(1).map(|line| line.ends_with(",0.0")).collect();
    assert_eq!(counts, [true, false, true], "{jobs}");
    let remarks = read(&at.join("fleet.merged/remarks.csv"));
    let told = remarks.lines().any(|line| line.starts_with("weekly/m00001/1,fit,") && line.contains("24 rows"));
    assert!(told, "{remarks}");
    let onto = quiet(at, &["fleet", "merge", "fleet.manifest.jsonl", "--out", "recipe.yaml"]);
    assert!(onto.status == 1 && onto.stderr.contains("name a folder"), "{}", onto.stderr);
}
