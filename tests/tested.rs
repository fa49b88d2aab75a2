//! `abbe test`: what recipes find against what was reviewed.

use crate::support::Small;

#[test]
fn a_change_is_told_and_accepted() {
    let small = Small::new();
    let test = |more: &[&str], status: i32| {
        let printed = small.abbe(&[&["test", "recipe.yaml"], more].concat());
        assert_eq!(printed.status, status, "{}{}", printed.stdout, printed.stderr);
        printed.stdout
    };
    assert!(test(&[], 1).contains("NEW: nothing is expected of it yet"));
    assert!(test(&["--accept"], 0).contains("accepted"));
    assert!(test(&[], 0).contains("1 recipe, all as expected"));
    let before = small.read("recipe.expected");
    // Digits below the stated part make no difference, and accepting leaves the file alone.
    let touches = small.read("data/touches.csv");
    let first = touches.lines().nth(1).expect("a row").to_owned();
    let moved = |by: f64| {
        let mut cells: Vec<String> = first.split(',').map(str::to_owned).collect();
        for cell in &mut cells[2..5] {
            *cell = (cell.parse::<f64>().expect("a position") + by).to_string();
        }
        touches.replacen(&first, &cells.join(","), 1)
    };
    small.write("data/touches.csv", &moved(1e-6));
    assert!(test(&["--accept"], 0).contains("nothing had changed"));
    assert_eq!(small.read("recipe.expected"), before);
    // A gross error is a change of values.
    let remark = "# Reviewed by the metrologist on Monday";
    let before = before.replacen("\nrun = ", &format!("\n{remark}\nrun = "), 1);
    small.write("recipe.expected", &before);
    small.write("data/touches.csv", &moved(0.2));
    let told = test(&["--junit", "test.xml", "--markdown", "test.md", "--out", "kept"], 1);
    assert!(told.contains("standard uncertainties apart"), "{told}");
    assert!(small.read("test.xml").contains("<failure message=\"CHANGED: "));
    assert!(small.read("test.md").contains("| recipe.yaml | ❌ CHANGED"));
    assert!(small.path("kept/recipe/report.html").is_file());
    // Less strict, what is left is more than values.
    assert_eq!(small.read("recipe.expected"), before);
    test(&["--accept"], 0);
    test(&[], 0);
    assert_ne!(small.read("recipe.expected"), before);
    assert!(
        small.read("recipe.expected").contains(&format!("\n{remark}\nrun = ")),
        "{}",
        small.read("recipe.expected")
    );
}

#[test]
fn ranks_verdicts_and_files_are_compared() {
    let small = Small::new();
    let test = || small.abbe(&["test"]);
    assert_eq!(small.abbe(&["test", "--accept"]).status, 0);
    let recipe = small.read("recipe.yaml");
    for (was, is, told) in [
        ("max_um: 1000", "max_um: 0.001", "verdict judge: fail, expected pass"),
        ("step_mm: 100", "step_mm: 50", "file written/"),
        ("\"EXX[1]\", \"table", "\"table", "fine EXX[1]: gone"),
        ("parameters: [\"@tool\", EX0C", "parameters: [\"@tool\", EA0B, EX0C", "fine EA0B: new"),
    ] {
        assert!(recipe.contains(was), "{was}");
        small.write("recipe.yaml", &recipe.replace(was, is));
        let printed = test();
        assert_eq!(printed.status, 1, "{told}: {}", printed.stdout);
        assert!(printed.stdout.contains(told), "{told}: {}", printed.stdout);
    }
    small.write("recipe.yaml", &recipe.replace("gauss-newton", "guess"));
    let printed = test();
    assert_eq!(printed.status, 1);
    assert!(printed.stdout.contains("recipe.yaml: ERROR"), "{}", printed.stdout);
    small.write("recipe.yaml", &recipe);
    small.write("recipe.expected", "format 1\nrun\n");
    assert!(test().stdout.contains("line 2: `what = value` was expected"));
    let printed = small.abbe(&["test", "data"]);
    assert_eq!(printed.status, 2);
    assert!(printed.stderr.contains("there are no recipes in data"), "{}", printed.stderr);
}

/// Files that a test writes have places of their own, however they are named; nothing runs where they have not.
#[test]
fn what_a_test_writes_collides_with_nothing() {
    let small = Small::new();
    std::fs::create_dir_all(small.path("below")).expect("a folder");
    for name in ["below/recipe.yaml", "other.yaml", "recipe.yml"] {
        small.write(name, &small.read("recipe.yaml").replace("data/", "../data/"));
    }
    let refused = |arguments: &[&str], words: &str| {
        let printed = small.abbe(&[&["test"], arguments].concat());
        assert_eq!(printed.status, 2, "{arguments:?}: {}{}", printed.stdout, printed.stderr);
        let said = printed.stderr.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
        assert!(said.contains(words), "{arguments:?}: {}", printed.stderr);
        assert!(said.contains("help:"), "{arguments:?}: {}", printed.stderr);
        for name in ["j", "out", "kept", "recipe.expected"] {
            assert!(!small.path(name).exists(), "{arguments:?}: {name} was written");
        }
    };
    let same = "`--junit` and `--markdown` name the same file";
    refused(&["recipe.yaml", "--junit", "j", "--markdown", "j"], same);
    refused(&["recipe.yaml", "--junit", "j", "--markdown", "below/../j"], same);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("below", small.path("link")).expect("a link");
        refused(&["recipe.yaml", "--junit", "below/j", "--markdown", "link/j"], same);
        small.write("empty", "");
        std::fs::hard_link(small.path("empty"), small.path("hard")).expect("a link");
        refused(&["recipe.yaml", "--junit", "empty", "--markdown", "hard"], same);
    }
    refused(&["recipe.yaml", "--junit", "./recipe.expected", "--accept"], "belongs to recipe.yaml");
    refused(&["recipe.yaml", "--markdown", "recipe.yaml"], "is not as an earlier `abbe test` wrote it");
    for report in ["kept", "kept/recipe", "kept/recipe/run.json", "kept/recipe/more/test.xml"] {
        refused(&["recipe.yaml", "--junit", report, "--out", "kept"], "where `--out` has results");
    }
    refused(&["recipe.yaml", "recipe.yml"], "have one file of what is expected");
    refused(&["recipe.yaml", "below/recipe.yaml", "--out", "kept"], "would both be written to kept/recipe");
    // The same recipe by another name is tested once.
    let printed = small.abbe(&["test", "recipe.yaml", "./recipe.yaml", "below/../recipe.yaml"]);
    assert!(printed.stdout.contains("1 recipe, 1 not as expected"), "{}", printed.stdout);
}

/// Nothing is accepted where the report of it cannot be written.
#[test]
fn nothing_is_accepted_if_a_report_cannot_be_written() {
    let small = Small::new();
    for option in ["--junit", "--markdown"] {
        let printed = small.abbe(&["test", "recipe.yaml", "--accept", option, "nowhere/test.txt"]);
        assert_eq!(printed.status, 1, "{}{}", printed.stdout, printed.stderr);
        assert!(printed.stderr.contains("its folder does not exist"), "{}", printed.stderr);
        assert!(!small.path("recipe.expected").exists(), "{option}");
    }
    let files = || std::fs::read_dir(small.path(".")).expect("a folder").count();
    let before = files();
    assert_eq!(small.abbe(&["test", "recipe.yaml", "--accept", "--junit", "test.xml"]).status, 0);
    assert_eq!(files(), before + 2);
}

/// Whatever may be a recipe is tested: one that cannot be read is an error, and not left out.
#[test]
fn a_recipe_of_a_folder_that_cannot_be_read_is_an_error() {
    let small = Small::new();
    assert_eq!(small.abbe(&["test", "--accept"]).status, 0);
    std::fs::create_dir(small.path("more.yaml")).expect("a folder");
    std::fs::write(small.path("text.yaml"), b"abbe: 1\nname: \xff\n").expect("a file");
    let printed = small.abbe(&["test"]);
    assert_eq!(printed.status, 1, "{}", printed.stdout);
    for (name, why) in [("more.yaml", "it is a folder"), ("text.yaml", "it is no text in UTF-8")] {
        let said = printed.stdout.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(said.contains(&format!("{name}: ERROR")) && said.contains(why), "{name}: {}", printed.stdout);
    }
}

#[test]
fn what_is_expected_twice_is_refused() {
    let small = Small::new();
    assert_eq!(small.abbe(&["test", "--accept"]).status, 0);
    let text = small.read("recipe.expected");
    let line = text.lines().nth(2).expect("a third line");
    small.write("recipe.expected", &format!("{text}{line}\n"));
    let printed = small.abbe(&["test"]);
    let place = format!("line {}: `run` stands here a second time, after line 3", text.lines().count() + 1);
    assert!(printed.status == 1 && printed.stdout.contains(&place), "{}", printed.stdout);
}

/// What is expected is replaced whole, and a link to it stays one.
#[cfg(unix)]
#[test]
fn a_link_to_what_is_expected_stays_one() {
    let small = Small::new();
    small.write("elsewhere/expected", "format 1\n");
    std::os::unix::fs::symlink("elsewhere/expected", small.path("recipe.expected")).expect("a link");
    assert_eq!(small.abbe(&["test", "--accept"]).status, 0);
    assert!(small.path("recipe.expected").is_symlink());
    assert!(small.read("elsewhere/expected").contains("estimate fine"));
}

/// A recipe that is named and is not there is wrong use, as of any other command, and nothing is run before it is told.
#[test]
fn a_recipe_that_is_not_there_is_wrong_use() {
    let small = Small::new();
    for arguments in [
        &["test", "none.yaml"][..],
        &["test", "recipe.yaml", "none.yaml", "--accept"],
        &["test", ".", "none.yaml", "--accept", "--junit", "test.xml"],
        &["test", "recipe.yaml/none.yaml"],
    ] {
        let printed = small.abbe(arguments);
        let says = printed.stderr.contains("none.yaml") && printed.stderr.contains("name recipes, or a folder");
        assert!(printed.status == 2 && says, "{arguments:?}: {}{}", printed.stdout, printed.stderr);
        assert!(!small.path("recipe.expected").exists() && !small.path("test.xml").exists(), "{arguments:?}");
    }
    assert_eq!(small.abbe(&["check", "none.yaml"]).status, 2);
    // One that is there and cannot be used is a recipe that failed.
    small.write("broken.yaml", "abbe: 1\nstages: {\n");
    assert_eq!(small.abbe(&["test", "broken.yaml"]).status, 1);
}

/// A folder is as expected only if each recipe is there of which something is expected.
#[test]
fn a_recipe_that_is_lost_is_told() {
    let small = Small::new();
    assert_eq!(small.abbe(&["test", "recipe.yaml", "--accept"]).status, 0);
    let recipe = small.read("recipe.yaml");
    small.write("other.yaml", &recipe);
    assert_eq!(small.abbe(&["test", "other.yaml", "--accept"]).status, 0);
    assert_eq!(small.abbe(&["test", "."]).status, 0);
    for lost in ["", "\u{1}\u{2} no recipe\n", &recipe.replacen("abbe:", "abb:", 1)] {
        small.write("other.yaml", lost);
        let printed = small.abbe(&["test", "."]);
        assert!(printed.status == 1 && printed.stdout.contains("other.yaml: ERROR"), "{}", printed.stdout);
    }
    std::fs::remove_file(small.path("other.yaml")).expect("it is removed");
    let printed = small.abbe(&["test", "."]);
    assert!(printed.status == 1 && printed.stdout.contains("other.yaml: ERROR"), "{}", printed.stdout);
    std::fs::remove_file(small.path("other.expected")).expect("it is removed");
    // A file of another program with such a name is no expectation.
    small.write("golden.expected", "stdout of another program\n");
    assert_eq!(small.abbe(&["test", "."]).status, 0);
}

#[test]
fn differences_have_a_bound() {
    let small = Small::new();
    assert_eq!(small.abbe(&["test", "recipe.yaml", "--accept"]).status, 0);
    let expected = small.read("recipe.expected");
    small.write("recipe.expected", &expected.replacen("run = ", &format!("run = {}", "\u{0}".repeat(1_000_000)), 1));
    let printed = small.abbe(&["test", "recipe.yaml"]);
    assert!(printed.status == 1 && printed.stdout.len() < 30_000, "{}", printed.stdout.len());
}
