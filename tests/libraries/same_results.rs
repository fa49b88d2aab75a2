//! The same results as built in: from Rust and from C, isolated or not.

use std::path::Path;

use abbe_core::{Quantity, Registry};
use abbe_engine::{Outcome, prepare};
use abbe_plugin::Library;
use serde_json::{Value, json};

use super::{c_library, cargo_library, lengths, limits, three_axes};
use crate::support::{Variant, fit, recipes, temporary, values, write};

/// The built-in plugins, and those of a library under `vendor-<name>`.
pub(super) fn with_renamed(mut library: Library) -> Registry {
    let mut registry = Registry::built_in().expect("the built-in plugins");
    for plugin in &mut library.plugins {
        plugin.name = format!("vendor-{}", plugin.name).into();
    }
    library.register(&mut registry).expect("the names are free");
    registry
}

/// A recipe with every stage done by `vendor-<plugin>`.
pub(super) fn by_vendor(recipe: &Variant) -> Variant {
    let mut recipe = recipe.clone();
    for stage in recipe.0["stages"].as_object_mut().expect("stages").values_mut() {
        for kind in ["ingest", "artefact", "model", "estimate", "validate", "export"] {
            if let Some(Value::String(name)) = stage.get_mut(kind) {
                *name = format!("vendor-{name}");
            }
        }
    }
    recipe
}

fn run(recipe: &Variant, registry: &Registry) -> Outcome {
    let folder = temporary();
    let outcome = prepare(&recipe.write(folder.path()), registry)
        .and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
    outcome.unwrap_or_else(|error| panic!("{error}"))
}

/// Asserts that two runs found the same, to the last digits.
fn same(expected: &Outcome, found: &Outcome) {
    assert_eq!(expected.fits.len(), found.fits.len());
    for (one, other) in expected.fits.iter().zip(&found.fits) {
        assert_eq!(one.problem.quantities(), other.problem.quantities());
        for (one, other) in values(&one.calibration).zip(values(&other.calibration)) {
            assert_eq!((&one.name, &one.unit, one.status), (&other.name, &other.unit, other.status));
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-12 * (1.0 + a.abs());
            assert!(close(one.value, other.value), "{}: {} and {}", one.name, one.value, other.value);
            assert!(close(one.standard_uncertainty, other.standard_uncertainty), "{}", one.name);
        }
    }
    assert_eq!(expected.verdicts.len(), found.verdicts.len());
    for (one, other) in expected.verdicts.iter().zip(&found.verdicts) {
        assert_eq!((&one.stage, one.pass, one.figures.len()), (&other.stage, other.pass, other.figures.len()));
        for (one, other) in one.figures.iter().zip(&other.figures) {
            let (a, b) = (one.value.unwrap_or(0.0), other.value.unwrap_or(0.0));
            assert!(one.name == other.name && (a - b).abs() <= 1e-9 * (1.0 + a.abs()), "{one:?} {other:?}");
        }
    }
    assert_eq!(expected.exports.len(), found.exports.len());
    for (one, other) in expected.exports.iter().zip(&found.exports) {
        let names = |files: &[abbe_core::ExportedFile]| files.iter().map(|file| file.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&one.1), names(&other.1));
    }
}

/// All six kinds: every validator and exporter of the recipe on its second fit.
pub(super) fn six_kinds() -> Variant {
    let recipe = Variant::tango("exact");
    let stages = recipe.0["stages"].as_object().expect("stages").iter();
    let of_fits = stages.filter(|(_, stage)| ["validate", "export"].iter().any(|kind| stage.get(kind).is_some()));
    let mut kept: Vec<String> = of_fits.map(|(name, _)| name.clone()).collect();
    kept.push("fit-S2".to_owned());
    let mut recipe = recipe.only(&kept.iter().map(String::as_str).collect::<Vec<_>>());
    for stage in recipe.0["stages"].as_object_mut().expect("stages").values_mut() {
        if stage.get("of").is_some() {
            stage["of"] = json!("fit-S2");
        }
    }
    recipe
}

#[test]
fn all_six_kinds_through_the_border_find_the_same() {
    let recipe = six_kinds();
    let expected = run(&recipe, &Registry::built_in().expect("the built-in plugins"));
    assert!(!expected.verdicts.is_empty() && !expected.exports.is_empty());
    let library = abbe_plugin::load(&cargo_library("abbe-stock-library"), None).expect("it loads");
    same(&expected, &run(&by_vendor(&recipe), &with_renamed(library)));
}

#[test]
fn all_six_kinds_in_processes_of_their_own_find_the_same() {
    let recipe = six_kinds();
    let expected = run(&recipe, &Registry::built_in().expect("the built-in plugins"));
    let library = abbe_plugin::isolated(&cargo_library("abbe-stock-library"), None, &limits(60.0)).expect("it loads");
    same(&expected, &run(&by_vendor(&recipe), &with_renamed(library)));
}

#[test]
fn equations_of_lengths_and_of_angles_are_told_apart_on_either_side() {
    let recipe = Variant::of(&recipes()["positioner"]);
    let expected = run(&recipe, &Registry::built_in().expect("the built-in plugins"));
    let quantities = expected.fits[0].problem.quantities();
    assert!(quantities.contains(&Quantity::Length) && quantities.contains(&Quantity::Angle));
    let file = cargo_library("abbe-stock-library");
    for library in [abbe_plugin::load(&file, None), abbe_plugin::isolated(&file, None, &limits(60.0))] {
        same(&expected, &run(&by_vendor(&recipe), &with_renamed(library.expect("it loads"))));
    }
}

/// Circles of a bar of unknown length on a machine with unknown scales, about a ball that is not quite where the file has it.
fn circles(folder: &Path) -> Variant {
    let mut rows = "X_mm,Y_mm,Z_mm,test,reading_mm\n".to_owned();
    for test in 0..3 {
        for sample in 0..24 {
            let angle = f64::from(sample) * 15.0_f64.to_radians();
            let mut tip = [50.0, -30.0, 20.0];
            tip[test] += 100.0 * angle.cos();
            tip[(test + 1) % 3] += 100.0 * angle.sin();
            let centre = [50.1, -30.05, 20.08];
            let length: f64 = (0..3).map(|axis| (tip[axis] - centre[axis]) * (tip[axis] - centre[axis])).sum();
            rows.push_str(&format!("{},{},{},{test},{}\n", tip[0], tip[1], tip[2], length.sqrt() - 100.0));
        }
    }
    write(&folder.join("rows.csv"), &rows);
    write(&folder.join("balls.csv"), "feature,x_mm,y_mm,z_mm\n1,50.02,-30,20.01\n");
    Variant(json!({
        "abbe": 1,
        "name": "Circles",
        "stages": {
            "rows": { "ingest": "csv", "path": folder.join("rows.csv") },
            "bar": {
                "artefact": "ball-bar", "from": "rows", "nominal": folder.join("balls.csv"), "bars_mm": { "one": 100 },
                "lengths": "estimated", "standard_uncertainty_um": 0.5, "tool_ball_standard_uncertainty_um": 0.2,
            },
            "machine": {
                "model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 0, "stylus_radius_mm": 0,
                "errors": [{ "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] }, { "location": ["EC0Y", "EA0Z", "EB0Z"] }],
            },
            "fit": {
                "estimate": "gauss-newton", "machine": "machine", "observations": ["bar"], "parameters": ["E*", "bar.*"],
                "on_confounded": "drop",
            },
        },
    }))
}

#[test]
fn readings_are_judged_alike_on_either_side() {
    let folder = temporary();
    let recipe = circles(folder.path());
    let expected = run(&recipe, &Registry::built_in().expect("the built-in plugins"));
    assert_eq!(fit(&expected, "fit").calibration.fit.null_space.len(), 1);
    let file = cargo_library("abbe-stock-library");
    for library in [abbe_plugin::load(&file, None), abbe_plugin::isolated(&file, None, &limits(60.0))] {
        let found = run(&by_vendor(&recipe), &with_renamed(library.expect("it loads")));
        assert_eq!(fit(&found, "fit").calibration.fit.null_space.len(), 1);
        same(&expected, &found);
    }
}

#[test]
fn monte_carlo_on_many_threads_may_be_isolated_with_everything_that_it_asks() {
    let small = crate::support::Small::new();
    let mut recipe = Variant::of(&small.folder.path().join("recipe.yaml"));
    recipe.0["stages"]["trials"] =
        json!({ "estimate": "monte-carlo", "of": "fine", "trials": 200, "coverage_probability": 0.5, "seed": 1 });
    recipe.0["stages"]["judge"]["of"] = json!(["fine", "trials"]);
    let expected = run(&recipe, &Registry::built_in().expect("the built-in plugins"));
    let library = abbe_plugin::isolated(&cargo_library("abbe-stock-library"), None, &limits(60.0)).expect("it loads");
    same(&expected, &run(&by_vendor(&recipe), &with_renamed(library)));
}

#[test]
fn the_same_machine_built_in_from_rust_and_from_c_gives_the_same_estimates() {
    let folder = temporary();
    lengths(folder.path());
    let chain = json!({ "model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 100.0, "stylus_radius_mm": 0.0, "errors": [
        { "polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1] }, { "location": ["EC0Y", "EA0Z", "EB0Z"] } ] });
    let mut vendor = chain.clone();
    vendor["model"] = json!("vendor-serial-chain");
    let c = json!({ "model": "vendor-three-axis", "tool_length_mm": 100.0 });
    let fit_of = |recipe: Value, registry: &Registry| {
        let file = Variant(recipe).write(folder.path());
        let outcome = prepare(&file, registry).and_then(|prepared| prepared.run(&abbe_core::Monitor::default()));
        outcome.unwrap_or_else(|error| panic!("{error}"))
    };
    let estimates = |outcome: &Outcome| {
        let calibration = &fit(outcome, "fit").calibration;
        ["EXX[1]", "EYY[1]", "EZZ[1]", "EC0Y", "EA0Z", "EB0Z"].map(|name| {
            let found = calibration.get(name).expect("it is estimated");
            [found.value, found.standard_uncertainty]
        })
    };
    let expected = estimates(&fit_of(three_axes(chain), &Registry::built_in().expect("plugins")));
    let size: f64 = expected.iter().map(|value| value[0].abs()).sum();
    assert!(size > 1e-4, "the errors of the machine are found: {expected:?}");

    let rust = cargo_library("abbe-stock-library");
    let from_c = c_library(folder.path(), "plugins/vendor-three-axis-c/three_axis.c", "threeaxis", &["-Wpedantic"]);
    let mut c_registry = Registry::built_in().expect("plugins");
    abbe_plugin::load(&from_c, None).and_then(|library| library.register(&mut c_registry)).expect("it loads");
    let mut isolated = Registry::built_in().expect("plugins");
    let library = abbe_plugin::isolated(&from_c, None, &limits(60.0)).expect("it loads");
    library.register(&mut isolated).expect("the names are free");
    let others = [
        fit_of(three_axes(vendor), &with_renamed(abbe_plugin::load(&rust, None).expect("it loads"))),
        fit_of(three_axes(c.clone()), &c_registry),
        fit_of(three_axes(c), &isolated),
    ];
    for other in &others {
        for (one, other) in expected.iter().zip(estimates(other)) {
            assert!((one[0] - other[0]).abs() < 1e-12 && (one[1] - other[1]).abs() < 1e-12, "{one:?} {other:?}");
        }
    }
}
