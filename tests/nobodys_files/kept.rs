//! What folders and other things of somebody keep: permissions and times; and what is no file of ours is looked at before the work.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::time::{Duration, SystemTime};

use super::run;
use crate::support::{Small, abbe, as_typed, root, temporary};

#[test]
fn folders_among_results_keep_permissions_and_times() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    small.write("out/recipe/private/deep/notes.txt", "mine");
    let long_ago = SystemTime::UNIX_EPOCH + Duration::from_secs(1_500_000_000);
    let folders = [("out/recipe", 0o700), ("out/recipe/private/deep", 0o750), ("out/recipe/private", 0o700)];
    for (folder, mode) in folders {
        let folder = small.path(folder);
        fs::set_permissions(&folder, fs::Permissions::from_mode(mode)).expect("its owner may");
        fs::File::open(&folder).and_then(|opened| opened.set_modified(long_ago)).expect("its owner may");
    }
    assert_eq!(run(&small, "out").0, 0);
    for (folder, mode) in folders {
        let found = fs::metadata(small.path(folder)).expect("it is there");
        assert_eq!(found.permissions().mode() & 0o7777, mode, "{folder}");
        // What is written into the folder of results changes its time.
        let is_theirs = folder != "out/recipe";
        assert_eq!(found.modified().expect("a time") == long_ago, is_theirs, "{folder}");
    }
    assert_eq!(small.read("out/recipe/private/deep/notes.txt"), "mine");
    // One that may not be written into is no obstacle, and nothing is left beside.
    fs::set_permissions(small.path("out/recipe/private"), fs::Permissions::from_mode(0o555)).expect("its owner may");
    let (status, stderr) = run(&small, "out");
    assert_eq!(status, 0, "{stderr}");
    assert_eq!(fs::read_dir(small.path("out")).expect("a folder").count(), 1);
    let mode = fs::metadata(small.path("out/recipe/private")).expect("it is there").permissions().mode();
    assert_eq!(mode & 0o7777, 0o555);
    fs::set_permissions(small.path("out/recipe/private"), fs::Permissions::from_mode(0o755)).expect("its owner may");
}

/// Somebody may have closed a folder of results to others.
#[test]
fn folders_of_results_keep_permissions() {
    let folder = temporary();
    let out = folder.path().display().to_string();
    let run = || {
        let printed = abbe(&root(), &["run", "pipelines/positioner.yaml", "--out", &out]);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
    };
    run();
    let errors = folder.path().join("positioner/errors");
    for mode in [0o700, 0o500] {
        fs::set_permissions(&errors, fs::Permissions::from_mode(mode)).expect("its owner may");
        run();
        let found = fs::metadata(&errors).expect("it is there").permissions().mode();
        assert_eq!(found & 0o7777, mode, "{found:o}");
    }
    fs::set_permissions(&errors, fs::Permissions::from_mode(0o755)).expect("its owner may");
}

/// A later command would take such results for what a killed one has left.
#[test]
fn results_do_not_go_where_temporary_folders_are_removed() {
    let small = Small::new();
    for out in [".abbe-partial-abcdefghijkl", "sub/.abbe-partial-0123456789AB/deep"] {
        let (status, stderr) = run(&small, out);
        assert!(status == 2 && stderr.contains("a name of temporary folders"), "{status}: {stderr}");
        assert!(!small.path(out).exists());
    }
    assert!(!small.path("sub").exists());
    assert_eq!(run(&small, ".abbe-partial-mine").0, 0);
    let left = ".abbe-partial-abcdefghijkl";
    let commands: [&[&str]; 5] = [
        &["test", "recipe.yaml", "--out", left],
        &["test", "recipe.yaml", "--junit", left],
        &["test", "recipe.yaml", "--markdown", left],
        &["plugins", "--pages", left],
        &["history", "add", left, ".abbe-partial-mine/recipe"],
    ];
    for command in commands {
        let printed = as_typed(small.folder.path(), command);
        let is_told = format!("{}{}", printed.stdout, printed.stderr).contains("a name of temporary folders");
        assert!(printed.status != 0 && is_told, "{command:?}: {} {}{}", printed.status, printed.stdout, printed.stderr);
        assert!(!small.path(left).exists(), "{command:?}");
    }
}

/// A new folder takes the place of an empty one, and not its permissions.
#[test]
fn an_empty_folder_keeps_its_permissions() {
    let folder = temporary();
    let mine = folder.path().join("mine");
    for mode in [0o700, 0o2770, 0o755] {
        fs::create_dir(&mine).expect("a folder");
        fs::set_permissions(&mine, fs::Permissions::from_mode(mode)).expect("its owner may");
        let printed = as_typed(folder.path(), &["new", "mine", "--chain", "w b Y X Z t", "--method", "balls"]);
        assert_eq!(printed.status, 0, "{}", printed.stderr);
        let found = fs::metadata(&mine).expect("it is there").permissions().mode();
        assert_eq!(found & 0o7777, mode, "{found:o}");
        fs::remove_dir_all(&mine).expect("it is removed");
    }
}

#[test]
fn pages_open_no_pipe() {
    let folder = temporary();
    let at = folder.path();
    fs::create_dir(at.join("pages")).expect("a folder");
    let pipe = at.join("pages/ingest-csv.md");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    let printed = as_typed(at, &["plugins", "--pages", "pages"]);
    assert_eq!(printed.status, 2, "{}", printed.stderr);
    assert!(printed.stderr.contains("ingest-csv.md"), "{}", printed.stderr);
    assert_eq!(fs::read_dir(at.join("pages")).expect("a folder").count(), 1);
}

#[test]
fn pages_take_the_place_of_no_link() {
    let folder = temporary();
    let at = folder.path();
    for (name, target) in [("ingest-csv.md", "/mnt/nowhere/ingest-csv.md"), ("README.md", "/dev/fd/99")] {
        let pages = at.join(name.replace('.', "-"));
        fs::create_dir(&pages).expect("a folder");
        std::os::unix::fs::symlink(target, pages.join(name)).expect("a link");
        let printed = as_typed(at, &["plugins", "--pages", pages.to_str().expect("UTF-8")]);
        assert_eq!(printed.status, 2, "{}", printed.stderr);
        assert!(printed.stderr.contains(name), "{}", printed.stderr);
        assert!(pages.join(name).is_symlink());
        assert_eq!(fs::read_dir(&pages).expect("a folder").count(), 1);
    }
}

#[test]
fn a_record_that_lists_a_result_twice_is_none() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    let text = small.read("out/recipe/run.json");
    let mut record: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let twice = record["outputs"][0].clone();
    record["outputs"].as_array_mut().expect("a list").push(twice);
    small.write("out/recipe/run.json", &record.to_string());
    let printed = small.abbe(&["report", "out/recipe", "--out", "report.html"]);
    assert!(printed.status > 0 && printed.stderr.contains("twice"), "{}", printed.stderr);
    assert!(!small.path("report.html").exists());
}

#[test]
fn what_is_no_history_is_told_before_a_run() {
    let small = Small::new();
    small.write("notes.txt", "mine");
    let recipe = small.read("recipe.yaml").replacen("stages:", "history: notes.txt\nstages:", 1);
    small.write("recipe.yaml", &recipe);
    for command in [&["run", "recipe.yaml", "--out", "out"][..], &["check", "recipe.yaml"]] {
        let printed = small.abbe(command);
        assert!(printed.status > 0 && printed.stderr.contains("notes.txt"), "{}", printed.stderr);
        assert!(!small.path("out").exists());
    }
    assert_eq!(small.read("notes.txt"), "mine");
}
