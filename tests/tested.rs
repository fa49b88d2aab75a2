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
