//! The recipes of the examples, end to end on simulated data.

use std::fs;
use std::path::Path;

use abbe_core::Calibration;
use serde_json::{Value, json};

use super::cargo_library;
use crate::support::{abbe, files_in, json_file, read, root, temporary, write};

/// A recipe of an example, and as what it wants its library.
struct Example {
    package: &'static str,
    folder: &'static str,
    recipe: &'static str,
    library: &'static str,
}

const HEXAPOD: Example = Example {
    package: "abbe-vendor-hexapod",
    folder: "plugins/vendor-hexapod/recipe",
    recipe: "hexapod",
    library: "libhexapod.so",
};

const NUTATING_HEAD: Example = Example {
    package: "abbe-vendor-nutating-head",
    folder: "plugins/vendor-nutating-head/recipe",
    recipe: "nutating-head",
    library: "libnutatinghead.so",
};

impl Example {
    /// Copies recipe, data and library.
    fn copy(&self, folder: &Path) {
        for file in files_in(&root().join(self.folder)) {
            fs::copy(&file, folder.join(file.file_name().expect("a name"))).expect("the recipe of the example");
        }
        fs::copy(cargo_library(self.package), folder.join(self.library)).expect("the library");
    }

    /// Estimate minus truth and standard uncertainty of every parameter, by a run of `file`.
    fn run(&self, folder: &Path, file: &str) -> Vec<(String, f64, f64)> {
        for arguments in [["check", file], ["run", file]] {
            let printed = abbe(folder, &arguments);
            assert_eq!(printed.status, 0, "{arguments:?}: {}{}", printed.stdout, printed.stderr);
        }
        let calibration = folder.join(format!("out/{}/fit.calibration.json", self.recipe));
        let calibration = Calibration::from_json(&read(&calibration)).expect("a calibration");
        let truth = json_file(&folder.join("truth.json"));
        let truth = truth["parameters"].as_object().expect("parameters");
        assert_eq!((calibration.fit.rank, calibration.fit.unknowns), (truth.len(), truth.len()));
        let found = truth.iter().map(|(name, value)| {
            let found = calibration.get(name).unwrap_or_else(|| panic!("{name} is not estimated"));
            (name.clone(), found.value - value.as_f64().expect("a number"), found.standard_uncertainty)
        });
        found.collect()
    }

    /// The same on data of a virtual machine with this noise.
    fn simulated(&self, noise: Value, isolate: bool) -> Vec<(String, f64, f64)> {
        let folder = temporary();
        self.copy(folder.path());
        let file = format!("{}.yaml", self.recipe);
        if isolate {
            let recipe = read(&folder.path().join(&file));
            let isolated = recipe.replace(".so }", ".so, isolate: true }");
            assert_ne!(recipe, isolated);
            write(&folder.path().join(&file), &isolated);
        }
        let mut truth = json_file(&folder.path().join("truth.json"));
        truth["noise"] = noise;
        write(&folder.path().join("truth.json"), &truth.to_string());
        let simulate = ["simulate", &file, "--truth", "truth.json", "--seed", "1", "--out", "simulated"];
        let printed = abbe(folder.path(), &simulate);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        self.run(folder.path(), &format!("simulated/{file}"))
    }

    fn is_calibrated(&self, parameters: usize) {
        let exact = self.simulated(json!({}), false);
        assert_eq!(exact.len(), parameters);
        for (name, off, _) in &exact {
            assert!(off.abs() < 1e-9, "{name} is off by {off} mm or rad");
        }
        assert_eq!(exact, self.simulated(json!({}), true), "isolated");
        within(&self.simulated(json!({ "probing_sigma_mm": 1e-3 }), false));
    }
}

/// Asserts that estimates differ from the truth by no more than their uncertainties allow.
fn within(found: &[(String, f64, f64)]) {
    for (name, off, uncertainty) in found {
        assert!(
            *uncertainty > 1e-7 && off.abs() < 4.0 * uncertainty,
            "{name} is off by {off} mm or rad, {uncertainty} is stated"
        );
    }
}

#[test]
fn the_hexapod_is_calibrated_end_to_end() {
    HEXAPOD.is_calibrated(39);
}

#[test]
fn the_nutating_head_is_calibrated_end_to_end() {
    NUTATING_HEAD.is_calibrated(6);
    let folder = temporary();
    NUTATING_HEAD.copy(folder.path());
    within(&NUTATING_HEAD.run(folder.path(), "nutating-head.yaml"));
}

#[test]
fn what_a_recipe_uses_keeps_the_laws_and_a_recipe_that_cannot_run_does_not() {
    for example in [&HEXAPOD, &NUTATING_HEAD] {
        let folder = temporary();
        example.copy(folder.path());
        let recipe = format!("{}.yaml", example.recipe);
        let check = |recipe: &str| {
            abbe(
                folder.path(),
                &["plugin", "check", example.library, "--recipe", recipe, "--time-limit", "120", "--json"],
            )
        };
        let printed = check(&recipe);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        let report: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        let tests = report["tests"].as_array().expect("tests");
        let last = tests.last().expect("a test");
        assert_eq!((tests.len(), &last["test"], &last["skipped"]), (14, &json!("recipe"), &json!([])), "{report:#}");

        let text = read(&folder.path().join(&recipe));
        write(&folder.path().join("wrong.yaml"), &text.replace("model: ", "model: no-"));
        let printed = check("wrong.yaml");
        assert_eq!(printed.status, 1, "{}", printed.stdout);
        assert!(printed.stdout.contains("there is no model plugin `no-"), "{}", printed.stdout);
    }
}
