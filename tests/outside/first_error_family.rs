//! The worked diff of CONTRIBUTING.md, "Your first error family", applied to a copy of the crates and built there.

use std::path::Path;
use std::process::Command;

use crate::support::{read, root, skipped, temporary, write};

/// What an error family needs of the workspace.
const CRATES: [&str; 6] =
    ["abbe-settings", "abbe-results", "abbe-core", "abbe-numerics", "abbe-thermal", "abbe-errors"];

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder");
    for entry in std::fs::read_dir(from).expect("a folder").flatten() {
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy(&entry.path(), &target),
            false => drop(std::fs::copy(entry.path(), target).expect("a file")),
        }
    }
}

#[test]
fn the_worked_diff_of_a_first_error_family_applies_and_passes_its_tests() {
    if Command::new("git").arg("--version").output().is_err() {
        return skipped("first_error_family", "there is no git to apply the diff with (Debian: apt-get install git)");
    }
    let folder = temporary();
    for name in CRATES {
        copy(&root().join("crates").join(name), &folder.path().join("crates").join(name));
    }
    let manifest = read(&root().join("Cargo.toml"));
    let members = manifest.lines().map(|line| match line.starts_with("members = ") {
        true => "members = [\"crates/*\"]",
        false => line,
    });
    // Without profiles, which come last: a few small tests need no optimised libraries.
    let kept = members.filter(|line| !line.starts_with("exclude")).take_while(|line| !line.starts_with("[profile"));
    let kept = kept.collect::<Vec<_>>().join("\n");
    write(&folder.path().join("Cargo.toml"), &kept);
    std::fs::copy(root().join("Cargo.lock"), folder.path().join("Cargo.lock")).expect("a file");
    let run = |command: &mut Command| {
        let output = command.current_dir(folder.path()).output().expect("it starts");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        assert!(output.status.success(), "{command:?}: {}{}", text(&output.stdout), text(&output.stderr));
        text(&output.stdout)
    };
    run(Command::new("git").arg("apply").arg(root().join("examples/first_error_family.diff")));
    let target = root().join("target/first-error-family");
    let mut test = Command::new(env!("CARGO"));
    test.args(["test", "--offline", "--package", "abbe-errors", "--lib", "--target-dir"]).arg(target);
    test.env("CARGO_PROFILE_DEV_DEBUG", "false").env("CARGO_INCREMENTAL", "0").env_remove("RUSTC_WORKSPACE_WRAPPER");
    let printed = run(&mut test);
    for name in ["families::decay::tests::slopes_are_those_of_the_values", "declaration::tests::lines_round_trip"] {
        assert!(printed.lines().any(|line| line.contains(name) && line.ends_with("... ok")), "{name}: {printed}");
    }
}
