//! Crates outside of the workspace, as vendors have them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::target;
use crate::support::{Printed, Small, files_in, read, root, temporary, write};

/// What is written in the page for vendors: manifest and source.
fn page() -> (String, String) {
    let page = read(&root().join("docs/vendor-plugins.md"));
    let block = |language: &str| {
        let start = page.split(&format!("```{language}\n")).nth(1).expect("the page has such a block");
        start.split("```").next().expect("the block ends").to_owned()
    };
    (block("toml"), block("rust"))
}

/// The profile that the tests are built with: with it the crates of the registry need no second build.
fn profile() -> String {
    let manifest = read(&root().join("Cargo.toml"));
    let start = manifest.find("[profile.dev]").expect("the workspace has a profile");
    let end = manifest.find("[profile.release]").expect("and one for releases");
    manifest[start..end].to_owned()
}

/// Builds the crate of the page as a vendor does, with these options of the compiler for it alone.
fn from_the_page(folder: &Path, source: &str, options: &[&str]) -> PathBuf {
    let sdk = root().join("crates/abbe-plugin");
    let manifest = page().0.replace("../abbe/crates/abbe-plugin", &sdk.to_string_lossy());
    let package = "[package]\nname = \"vendor-list\"\nversion = \"1.2.3\"\nedition = \"2024\"\n\n";
    write(&folder.join("Cargo.toml"), &format!("{package}{manifest}\n[workspace]\n\n{}", profile()));
    write(&folder.join("src/lib.rs"), source);
    fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).expect("the versions of the workspace");
    let mut command = Command::new(env!("CARGO"));
    command.args(["rustc", "--offline", "--quiet", "--lib", "--target-dir"]).arg(target()).arg("--").args(options);
    let built = command.current_dir(folder).output().expect("cargo runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let name = format!("{}vendor_list{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    // The next one gets another name: who was asked for this one finds it.
    let library = folder.join(format!("{}-{name}", files_in(folder).len()));
    fs::copy(target().join("debug").join(&name), &library).expect("the library");
    library
}

/// A small recipe with the exporter of the page.
fn recipe() -> Small {
    let small = Small::new();
    let written = "written: { export: error-table, of: fine, step_mm: 100, step_deg: 30 }";
    let recipe = crate::support::SMALL.replace(written, "written: { export: vendor-list, of: fine }");
    assert_ne!(recipe, crate::support::SMALL);
    small.write("recipe.yaml", &recipe);
    small
}

fn run(small: &Small, library: &Path, more: &[&str]) -> (Printed, String) {
    let printed = small.abbe(&[&["run", "recipe.yaml", "--plugin", &*library.to_string_lossy()], more].concat());
    let text = printed.stderr.replace(['│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
    (printed, text)
}

#[test]
fn what_the_page_for_vendors_says_works() {
    let (vendor, small) = (temporary(), recipe());
    let source = page().1;
    assert!(source.lines().filter(|line| !line.trim().is_empty()).count() < 40, "it stays short");
    let panics = source.replace(
        "        let lines",
        "        assert!(calibration.parameters.is_empty(), \"a bug of the vendor\");\n        let lines",
    );
    assert_ne!(panics, source);

    let library = from_the_page(vendor.path(), &source, &[]);
    let (printed, text) = run(&small, &library, &[]);
    assert_eq!(printed.status, 0, "{text}");
    assert!(small.read("out/recipe/written/list.txt").contains("EXX[1] "));
    let checked = small.abbe(&["plugin", "check", &library.to_string_lossy()]);
    assert_eq!(checked.status, 0, "{}", checked.stdout);

    // A panic in an exporter, and one while settings are read.
    let library = from_the_page(vendor.path(), &panics, &[]);
    let creates = source
        .replace("    from_settings", "    assert!(settings.is_null(), \"a bug of the vendor\");\n    from_settings");
    assert_ne!(creates, source);
    for library in [library, from_the_page(vendor.path(), &creates, &[])] {
        for more in [&[][..], &["--isolate-plugins"]] {
            let (printed, text) = run(&small, &library, more);
            assert_eq!(printed.status, 1, "{text}");
            assert!(
                text.contains("the plugin `vendor-list` of") && text.contains("panicked: a bug of the vendor"),
                "{text}"
            );
        }
    }

    // Built with other settings than the program: it works, and what no panic can leave is kept by isolation.
    let other = ["-Cpanic=abort", "-Copt-level=s", "-Cdebug-assertions=no", "-Coverflow-checks=no"];
    let library = from_the_page(vendor.path(), &source, &other);
    for more in [&[][..], &["--isolate-plugins"]] {
        let (printed, text) = run(&small, &library, more);
        assert_eq!(printed.status, 0, "{text}");
    }
    let (printed, text) = run(&small, &from_the_page(vendor.path(), &panics, &other), &["--isolate-plugins"]);
    assert_eq!(printed.status, 1, "{text}");
    assert!(text.contains("the plugin `vendor-list` of") && text.contains("ended by signal 6 (SIGABRT)"), "{text}");
}
