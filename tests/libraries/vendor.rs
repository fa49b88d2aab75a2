//! Crates outside of the workspace, as vendors have them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use abbe_core::Calibration;
use serde_json::json;

use super::target;
use crate::support::{Printed, Small, files_in, read, root, temporary, write};

/// The blocks of a language in the page for vendors.
fn blocks(language: &str) -> Vec<String> {
    let page = read(&root().join("docs/vendor-plugins.md"));
    let start = format!("```{language}\n");
    let blocks = page.split(start.as_str()).skip(1);
    blocks.map(|block| block.split("```").next().expect("the block ends").to_owned()).collect()
}

/// What is written first in the page for vendors: manifest and source.
fn page() -> (String, String) {
    (blocks("toml").remove(0), blocks("rust").remove(0))
}

/// Builds the crate of the page as a vendor does, with these options of the compiler for it alone.
fn from_the_page(folder: &Path, source: &str, options: &[&str]) -> PathBuf {
    // All of them are built to one file, and copied from there.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let sdk = root().join("crates/abbe-plugin");
    let manifest = page().0.replace("../abbe/crates/abbe-plugin", &sdk.to_string_lossy());
    let package = "[package]\nname = \"vendor-list\"\nversion = \"1.2.3\"\nedition = \"2024\"\n\n";
    write(&folder.join("Cargo.toml"), &format!("{package}{manifest}\n[workspace]\n"));
    write(&folder.join("src/lib.rs"), source);
    fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).expect("the versions of the workspace");
    let mut command = Command::new(env!("CARGO"));
    command.args(["rustc", "--offline", "--quiet", "--lib", "--target-dir"]).arg(target()).arg("--").args(options);
    // The lints of this project are not those of a vendor, and its dependencies are built with fewer features: they need no profile either.
    command.env("CARGO_PROFILE_DEV_DEBUG", "false").env_remove("RUSTC_WORKSPACE_WRAPPER");
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
    let checked = small.abbe(&["plugin", "check", &library.to_string_lossy(), "--time-limit", "600"]);
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

/// Touches of known points on a machine whose errors decay: the errors are found, and the kit finds nothing wrong.
#[test]
fn the_artefact_and_the_errors_of_the_page_find_what_was_put_in() {
    let vendor = temporary();
    let sources = blocks("rust");
    let libraries = [1, 2].map(|block| from_the_page(vendor.path(), &sources[block], &[]));
    let (length, truth) = (80.0, [("EXX[decay]", 0.012), ("EYX[decay]", -0.02), ("EZX[decay]", 0.005)]);
    let mut points = serde_json::Map::new();
    let mut touches = "feature,X_mm,Y_mm,Z_mm\n".to_owned();
    for number in 0..8 {
        let point = [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { 10.0 } else { 150.0 });
        // Where X stands when its tip is on the point.
        let x = (0..20).fold(point[0], |x: f64, _| point[0] - truth[0].1 * (-x / length).exp());
        let [y, z] = [1, 2].map(|axis| point[axis] - truth[axis].1 * (-x / length).exp());
        touches.push_str(&format!("{number},{x},{y},{z}\n"));
        points.insert(number.to_string(), json!(point));
    }
    let recipe = json!({ "abbe": 1, "stages": {
        "touches": { "ingest": "csv", "path": "touches.csv" },
        "points": { "artefact": "vendor-points", "from": "touches", "points_mm": points, "standard_uncertainty_um": 1 },
        "machine": { "model": "vendor-mill", "decay_mm": length },
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["points"], "parameters": ["E*"],
                 "trust_uncertainties": true },
        "written": { "export": "error-table", "of": "fit", "step_mm": 50, "ranges": { "X": { "from_mm": 0, "to_mm": 200 }, "Y": { "from_mm": 0, "to_mm": 200 }, "Z": { "from_mm": 0, "to_mm": 200 } } },
    } });
    write(&vendor.path().join("touches.csv"), &touches);
    let files = libraries.each_ref().map(|file| file.to_string_lossy().into_owned());
    let named = |recipe: &serde_json::Value| {
        let mut recipe = recipe.clone();
        recipe["plugins"] = json!(files.each_ref().map(|file| json!({ "path": file })));
        recipe
    };
    write(&vendor.path().join("recipe.yaml"), &named(&recipe).to_string());
    let printed = crate::support::abbe(vendor.path(), &["run", "recipe.yaml"]);
    assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    let calibration = Calibration::from_json(&read(&vendor.path().join("out/recipe/fit.calibration.json")));
    let calibration = calibration.expect("a calibration");
    for (name, truth) in truth {
        let found = calibration.get(name).expect("it is estimated").value;
        assert!((found - truth).abs() < 1e-9, "{name}: {found} and {truth}");
    }
    for file in &files {
        let printed = crate::support::abbe(
            vendor.path(),
            &["plugin", "check", file, "--recipe", "recipe.yaml", "--time-limit", "600"],
        );
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
    }
}
