//! Each mistake gets one clear error: which file, what was expected, what to do, and no number of the system.

use std::fs;

use crate::fleet::plant::{Plant, ok, quiet};
use crate::support::{Printed, Small, as_typed, read, temporary, write};

/// What was printed, in one line.
fn said(printed: &Printed) -> String {
    let all = format!("{}{}", printed.stdout, printed.stderr).replace('│', " ");
    let all = all.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(!all.contains("os error"), "{all}");
    all
}

/// Two names that are no text would have one folder of results.
#[cfg(target_os = "linux")]
#[test]
fn a_recipe_whose_name_is_no_text_is_refused() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let small = Small::new();
    for name in [&b"a\xff.yaml"[..], b"a\xfe.yaml"] {
        let name = OsStr::from_bytes(name);
        fs::copy(small.path("recipe.yaml"), small.folder.path().join(name)).expect("a copy");
        for command in ["run", "check", "test"] {
            let printed = as_typed(small.folder.path(), &[OsStr::new(command), name]);
            let said = said(&printed);
            assert!(printed.status != 0 && said.contains("no text in UTF-8"), "{command}: {said}");
            assert!(said.contains("give the file another name"), "{command}: {said}");
        }
    }
    assert!(!small.path("out").exists());
    // Folders on the way may have any name.
    let folder = small.folder.path().join(OsStr::from_bytes(b"f\xff"));
    fs::create_dir(&folder).expect("a folder");
    let text = small.read("recipe.yaml").replace("data/", "../data/");
    fs::write(folder.join("recipe.yaml"), text).expect("a recipe");
    let recipe = folder.join("recipe.yaml");
    let printed = as_typed(small.folder.path(), &[OsStr::new("run"), recipe.as_os_str()]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
}

/// Some editors write a byte order mark before what they save.
#[test]
fn a_byte_order_mark_is_read_away() {
    let small = Small::new();
    ok(&small.abbe(&["run", "recipe.yaml", "--out", "out"]));
    small.write("points.csv", "X_mm,Y_mm,Z_mm,B_deg,C_deg\n0,0,300,0,0\n");
    let text = small.read("out/recipe/fine.calibration.json");
    small.write("plain.calibration.json", &text);
    small.write("marked.calibration.json", &format!("\u{feff}{text}"));
    let correct = |name: &str| small.abbe(&["compensate", name, "points.csv", "--out", &format!("{name}.csv")]);
    for name in ["plain.calibration.json", "marked.calibration.json"] {
        let printed = correct(name);
        assert_eq!(printed.status, 0, "{}", said(&printed));
    }
    assert_eq!(small.read("plain.calibration.json.csv"), small.read("marked.calibration.json.csv"));
}

#[test]
fn an_age_that_a_broken_record_does_not_tell_is_an_error_of_the_record() {
    let small = Small::new();
    ok(&small.abbe(&["run", "recipe.yaml", "--out", "out"]));
    small.write("points.csv", "X_mm,Y_mm,Z_mm,B_deg,C_deg\n0,0,300,0,0\n");
    let record = small.read("out/recipe/run.json");
    let aged = || {
        let calibration = "out/recipe/fine.calibration.json";
        small.abbe(&["compensate", calibration, "points.csv", "--max-age-days", "1", "--out", "corrected.csv"])
    };
    for (text, why) in
        [(&record[..record.len() / 2], "this is no"), ("{}", "`abbe_run` is missing"), ("", "this is not a JSON file")]
    {
        small.write("out/recipe/run.json", text);
        let printed = aged();
        let said = said(&printed);
        let is_told =
            said.contains("out/recipe/run.json") && said.contains("how old the calibration is cannot be told");
        assert!(printed.status != 0 && is_told, "{said}");
        assert!(said.contains(why) || text.starts_with("{\n"), "{why}: {said}");
        assert!(said.contains("a folder that `abbe run` wrote"), "{said}");
    }
    fs::remove_file(small.path("out/recipe/run.json")).expect("it goes");
    assert!(said(&aged()).contains("cannot be told without"));
    small.write("out/recipe/run.json", &record);
    ok(&aged());
}

#[test]
fn a_file_in_the_place_of_the_results_of_a_fleet_is_told() {
    let folder = temporary();
    let at = folder.path();
    Plant::of(2).write(at);
    ok(&quiet(at, &["fleet", "plan", "fleet.yaml"]));
    write(&at.join("fleet.results"), "mine");
    for command in
        [&["fleet", "run", "fleet.manifest.jsonl"][..], &["fleet", "job", "fleet.manifest.jsonl", "--index", "0"]]
    {
        let printed = quiet(at, command);
        let said = said(&printed);
        let words = ["fleet.results", "results of the jobs go into a folder of this name", "move it away"];
        assert!(printed.status != 0 && words.iter().all(|words| said.contains(words)), "{command:?}: {said}");
        assert_eq!(said.matches("fleet.results").count(), 1, "{said}");
    }
    assert_eq!(read(&at.join("fleet.results")), "mine");
}

/// Whatever stands in the way of pages, or of a history, is told in words.
#[test]
fn what_stands_in_the_way_is_told_in_words() {
    let small = Small::new();
    ok(&small.abbe(&["run", "recipe.yaml", "--out", "out"]));
    small.write("file", "mine");
    let folder = small.path("folder");
    fs::create_dir_all(folder.join("README.md")).expect("a folder");
    for (arguments, words) in [
        (&["plugins", "--pages", "file"][..], &["file"][..]),
        (&["plugins", "--pages", "file/pages"], &["file", "no folder"]),
        (&["plugins", "--pages", "folder"], &["README.md", "it is a folder"]),
        (&["history", "add", "file/history.sqlite", "out/recipe"], &["file/history.sqlite"]),
        (&["history", "add", "no/history.sqlite", "out/recipe"], &["no/history.sqlite", "folder"]),
        (&["history", "add", "folder", "out/recipe"], &["folder", "a folder"]),
        (&["history", "add", "history.sqlite", "nothing"], &["nothing", "no such file", "name a folder"]),
        (&["history", "list", "file"], &["file is no history"]),
        (&["history", "export", "none.sqlite", "1", "--out", "exported"], &["none.sqlite does not exist"]),
        (&["compensate", "file/x.json", "file", "--out", "c.csv"], &["file/x.json", "no folder"]),
        (&["report", "out/recipe", "--out", "no/page.html"], &["no/page.html", "folder"]),
    ] {
        let printed = small.abbe(arguments);
        let said = said(&printed);
        assert!(printed.status != 0, "{arguments:?}: {said}");
        for words in words {
            assert!(said.contains(words), "{arguments:?}: `{words}`: {said}");
        }
    }
    assert_eq!(small.read("file"), "mine");
    assert!(!small.path("history.sqlite").exists());
}

/// A test runs a recipe as `abbe run` does: in the same folder are the same results, and results that somebody changed stay.
#[test]
fn results_that_a_test_keeps_are_those_of_a_run() {
    let small = Small::new();
    ok(&small.abbe(&["run", "recipe.yaml", "--out", "out"]));
    ok(&small.abbe(&["test", "--accept"]));
    let results = |name: &str| small.read(&format!("out/recipe/{name}"));
    let names = ["fine.calibration.json", "verdicts.json", "report.html", "fine.residuals.csv"];
    let before = names.map(results);
    ok(&small.abbe(&["test", "--out", "out"]));
    assert_eq!(names.map(results), before);
    ok(&small.abbe(&["history", "add", "history.sqlite", "out/recipe"]));
    small.write("out/recipe/verdicts.json", "mine");
    let printed = small.abbe(&["test", "--out", "out"]);
    assert!(printed.status != 0 && said(&printed).contains("in the way"), "{}", said(&printed));
    assert_eq!(results("verdicts.json"), "mine");
}
