//! The recipes of the examples, end to end on simulated data.

use std::fs;

use abbe_core::Calibration;
use serde_json::{Value, json};

use super::cargo_library;
use crate::support::{abbe, files_in, json_file, read, root, temporary, write};

/// The recipe of the hexapod on data of a virtual machine with this noise: estimate minus truth and standard uncertainty of
/// every parameter.
fn hexapod(noise: Value, isolate: bool) -> Vec<(String, f64, f64)> {
    let folder = temporary();
    let source = root().join("plugins/vendor-hexapod/recipe");
    for file in files_in(&source) {
        fs::copy(&file, folder.path().join(file.file_name().expect("a name"))).expect("the recipe of the example");
    }
    fs::copy(cargo_library("abbe-vendor-hexapod"), folder.path().join("libhexapod.so")).expect("the library");
    if isolate {
        let recipe = read(&folder.path().join("hexapod.yaml"));
        let isolated = recipe.replace("path: libhexapod.so }", "path: libhexapod.so, isolate: true }");
        assert_ne!(recipe, isolated);
        write(&folder.path().join("hexapod.yaml"), &isolated);
    }
    let mut truth = json_file(&folder.path().join("truth.json"));
    truth["noise"] = noise;
    write(&folder.path().join("truth.json"), &truth.to_string());
    let simulate = ["simulate", "hexapod.yaml", "--truth", "truth.json", "--seed", "1", "--out", "simulated"];
    for arguments in [&simulate[..], &["check", "simulated/hexapod.yaml"], &["run", "simulated/hexapod.yaml"]] {
        let printed = abbe(folder.path(), arguments);
        assert_eq!(printed.status, 0, "{arguments:?}: {}{}", printed.stdout, printed.stderr);
    }
    let calibration = Calibration::from_json(&read(&folder.path().join("out/hexapod/fit.calibration.json")));
    let calibration = calibration.expect("a calibration");
    assert_eq!((calibration.fit.rank, calibration.fit.unknowns), (39, 39));
    let truth = truth["parameters"].as_object().expect("parameters");
    assert_eq!(truth.len(), 39);
    let found = truth.iter().map(|(name, value)| {
        let found = calibration.get(name).unwrap_or_else(|| panic!("{name} is not estimated"));
        (name.clone(), found.value - value.as_f64().expect("a number"), found.standard_uncertainty)
    });
    found.collect()
}

#[test]
fn the_hexapod_is_calibrated_end_to_end() {
    let exact = hexapod(json!({}), false);
    for (name, off, _) in &exact {
        assert!(off.abs() < 1e-9, "{name} is off by {off} mm");
    }
    assert_eq!(exact, hexapod(json!({}), true), "isolated");
    for (name, off, uncertainty) in hexapod(json!({ "probing_sigma_mm": 1e-3 }), false) {
        assert!(
            uncertainty > 1e-5 && off.abs() < 4.0 * uncertainty,
            "{name} is off by {off} mm, {uncertainty} is stated"
        );
    }
}
