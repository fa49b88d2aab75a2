//! Ways to a folder of results that lead through it, by `..` or by links.

use std::fs;
use std::path::Path;

use super::run;
use crate::support::{Small, recipes};

/// What is in a folder, and where folders are.
fn all_in(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).expect("a folder").flatten() {
            let path = entry.path();
            found.push(path.strip_prefix(folder).expect("a path in it").display().to_string());
            if path.is_dir() && !path.is_symlink() {
                folders.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Ways to a folder that lead through the folder itself, which is replaced: what is written is there, and nothing else is.
#[test]
fn ways_that_lead_through_the_folder_itself_are_followed_before_it_is_replaced() {
    let small = Small::new();
    small.write("truth.json", "{ \"parameters\": {} }");
    let plan = recipes()["design-2d"].display().to_string();
    let added = small.abbe(&["run", "recipe.yaml", "--out", "kept"]);
    assert_eq!(added.status, 0, "{}", added.stderr);
    let added = small.abbe(&["history", "add", "h.sqlite", "kept/recipe"]);
    assert_eq!(added.status, 0, "{}", added.stderr);
    let simulate = ["simulate", "recipe.yaml", "--truth", "truth.json", "--seed", "1", "--out"];
    let new = ["new", "--chain", "w C' A' b X Y Z t", "--method", "ball"];
    let commands: [&[&str]; 4] =
        [&simulate, &["plan", &plan, "--out"], &new, &["history", "export", "h.sqlite", "1", "--out"]];
    for (number, command) in commands.into_iter().enumerate() {
        let write = |name: &str| small.abbe(&[command, &[name]].concat());
        let at = |name: &str| format!("{number}/{name}");
        // As it is where nothing is.
        let straight = at("straight");
        fs::create_dir(small.path(&number.to_string())).expect("a folder");
        assert_eq!(write(&straight).status, 0, "{command:?}");
        let expected = all_in(&small.path(&straight));
        assert!(!expected.is_empty(), "{command:?}");
        fs::create_dir(small.path(&at("k"))).expect("a folder");
        std::os::unix::fs::symlink("../e", small.path(&at("k/l"))).expect("a link");
        for (way, place) in [("s/../s", "s"), ("s2/../s2/.", "s2"), ("k/l/../e", "e"), ("no/such/../../one", "one")] {
            if way != "no/such/../../one" {
                fs::create_dir(small.path(&at(place))).expect("an empty folder");
            }
            let printed = write(&at(way));
            assert_eq!(printed.status, 0, "{command:?} {way}: {}", printed.stderr);
            assert_eq!(all_in(&small.path(&at(place))), expected, "{command:?} {way}");
        }
        let entries = all_in(&small.path(&number.to_string()));
        let above: Vec<&String> = entries.iter().filter(|name| !name.contains('/')).collect();
        assert_eq!(above, ["e", "k", "one", "s", "s2", "straight"], "{command:?}");
        // A way through a file leads nowhere.
        small.write(&at("file"), "mine");
        let before = all_in(small.folder.path());
        let printed = write(&at("file/../other"));
        assert!(printed.status != 0, "{command:?}: {}", printed.stdout);
        assert_eq!(all_in(small.folder.path()), before, "{command:?}");
    }
}

/// The folder of results of a run may have a link in it through which the way to it leads; the same results are replaced.
#[test]
fn a_run_follows_the_way_to_its_results_first() {
    let small = Small::new();
    assert_eq!(run(&small, "out").0, 0);
    std::os::unix::fs::symlink("../..", small.path("out/recipe/up")).expect("a link");
    let before = all_in(small.folder.path());
    for way in ["out/recipe/..", "out/recipe/up/out", "out/recipe/../recipe/up/out/.", "no/../out"] {
        let (status, stderr) = run(&small, way);
        assert_eq!(status, 0, "{way}: {stderr}");
        assert_eq!(all_in(small.folder.path()), before, "{way}");
    }
    let page = small.abbe(&["report", "out/recipe", "--out", "out/recipe/../../page.html"]);
    assert_eq!(page.status, 0, "{}", page.stderr);
    assert!(small.path("page.html").is_file());
}
