//! Dynamic plugins: the same results as built in, from Rust and from C, isolated or not; and libraries that misbehave.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use abbe_core::{Class, Registry};
use abbe_engine::{Outcome, prepare};
use abbe_plugin::{Library, Limits};
use serde_json::{Value, json};

use crate::support::{Printed, Variant, abbe, fit, recipes, root, temporary, values, write};

/// A library of the workspace, built with other settings for optimisation and panics than the program.
fn cargo_library(package: &str) -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    let folder = BUILT.get_or_init(|| {
        let program = Path::new(env!("CARGO_BIN_EXE_abbe-under-test"));
        let target = program.ancestors().nth(2).expect("the program is in <target>/<profile>").join("libraries");
        let mut command = Command::new(env!("CARGO"));
        command.args(["build", "--locked", "--lib", "--quiet", "--target-dir"]).arg(&target);
        for package in ["abbe-stock-library", "abbe-vendor-hexapod", "abbe-vendor-nutating-head"] {
            command.args(["--package", package]);
        }
        command.args(["--config", "profile.dev.opt-level=0", "--config", "profile.dev.panic=\"abort\""]);
        let built = command.current_dir(root()).output().expect("cargo runs");
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        target.join("debug")
    });
    folder.join(format!("{}{}{}", std::env::consts::DLL_PREFIX, package.replace('-', "_"), std::env::consts::DLL_SUFFIX))
}

/// A library of plain C.
fn c_library(folder: &Path, source: &str, name: &str, options: &[&str]) -> PathBuf {
    let file = folder.join(format!("lib{name}.so"));
    let mut command = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    command.args(["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC", "-I"]);
    command.arg(root().join("crates/abbe-plugin/include")).args(options).arg(root().join(source)).arg("-o").arg(&file);
    let built = command.arg("-lm").output().expect("the C compiler runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    file
}

fn bad(folder: &Path, name: &str, options: &[&str]) -> PathBuf {
    c_library(folder, "tests/bad-plugins/bad.c", name, options)
}

fn limits(silence: f64) -> Limits {
    Limits {
        program: env!("CARGO_BIN_EXE_abbe-under-test").into(),
        arguments: ["plugin", "serve"].map(str::to_owned).to_vec(),
        silence: Duration::from_secs_f64(silence),
    }
}

/// The built-in plugins, and those of a library under `vendor-<name>`.
fn with_renamed(mut library: Library) -> Registry {
    let mut registry = Registry::built_in().expect("the built-in plugins");
    for plugin in &mut library.plugins {
        plugin.name = format!("vendor-{}", plugin.name).into();
    }
    library.register(&mut registry).expect("the names are free");
    registry
}

/// A recipe with every stage done by `vendor-<plugin>`.
fn by_vendor(recipe: &Variant) -> Variant {
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
    let outcome = prepare(&recipe.write(folder.path()), registry).and_then(|prepared| prepared.run(&|_| {}));
    outcome.unwrap_or_else(|error| panic!("{error}"))
}

/// Asserts that two runs found the same, to the last digits.
fn same(expected: &Outcome, found: &Outcome) {
    assert_eq!(expected.fits.len(), found.fits.len());
    for (one, other) in expected.fits.iter().zip(&found.fits) {
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

/// All six kinds: ingest, facets, lengths, chain, estimate, hold-out, exporter.
fn six_kinds() -> Variant {
    let recipe = Variant::tango("exact");
    let exporter = recipe.0["stages"].as_object().expect("stages").iter().find(|(_, stage)| stage.get("export").is_some());
    let mut kept = vec!["fit-S2"];
    let of = |kind: &str| {
        let stages = recipe.0["stages"].as_object().expect("stages");
        stages.iter().filter(|(_, stage)| stage.get(kind).is_some()).map(|(name, _)| name.clone()).collect::<Vec<_>>()
    };
    let (exports, validators) = (of("export"), of("validate"));
    assert!(exporter.is_some() && !validators.is_empty());
    kept.extend(exports.iter().chain(&validators).map(String::as_str));
    let mut recipe = recipe.only(&kept);
    let stages = recipe.0["stages"].as_object_mut().expect("stages");
    stages.retain(|name, stage| {
        // What judges or writes another fit judges and writes this one.
        let wants = |kind: &str| stage.get(kind).is_some();
        !(wants("validate") || wants("export")) || !name.is_empty()
    });
    for stage in stages.values_mut() {
        if stage.get("export").is_some() {
            stage["of"] = json!("fit-S2");
        } else if stage.get("validate").is_some() {
            stage["of"] = if stage["of"].is_array() { json!(["fit-S2"]) } else { json!("fit-S2") };
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

/// Lengths all over a workspace, of a machine with some errors and some noise.
fn lengths(folder: &Path) {
    let mut text = "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n".to_owned();
    let spread = |index: usize| 600.0 * ((index as f64 * 0.618_033_988_75).fract() - 0.5);
    for row in 0..40 {
        let ends: Vec<f64> = (0..6).map(|column| spread(6 * row + column + 1)).collect();
        let moved = |at: &[f64]| {
            let (x, y, z) = (at[0] * (1.0 + 3e-5), at[1] * (1.0 - 2e-5), at[2] * (1.0 + 1e-5));
            [x - 4e-5 * y + 2e-5 * z, y + 5e-5 * z, z]
        };
        let (one, other) = (moved(&ends[..3]), moved(&ends[3..]));
        let length: f64 = one.iter().zip(&other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let noise = 1e-3 * ((row * 7 % 11) as f64 - 5.0) / 3.0;
        let cells: Vec<String> = ends.iter().map(f64::to_string).collect();
        text.push_str(&format!("{row},{},{}\n", cells.join(","), length + noise));
    }
    write(&folder.join("lengths.csv"), &text);
}

/// A recipe of lengths on a machine with three axes.
fn three_axes(model: Value) -> Value {
    json!({ "abbe": 1, "stages": {
        "runs": { "ingest": "csv", "path": "lengths.csv" },
        "bar": { "artefact": "length", "from": "runs", "standard_uncertainty_um": 1.0 },
        "machine": model,
        "fit": { "estimate": "gauss-newton", "machine": "machine", "observations": ["bar"],
                 "parameters": ["E*[1]", "EC0Y", "EA0Z", "EB0Z"] },
    } })
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
        let outcome = prepare(&file, registry).and_then(|prepared| prepared.run(&|_| {}));
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

/// Runs the recipe of three axes on the bad model, which misbehaves in this way.
fn misbehave(mode: &str, isolate: bool) -> (Printed, String) {
    let folder = temporary();
    lengths(folder.path());
    let library = bad(folder.path(), "bad", &[]);
    let mut recipe = three_axes(json!({ "model": "bad-model", "mode": mode }));
    recipe["stages"]["fit"]["parameters"] = json!(["E*[1]"]);
    recipe["plugins"] = json!([{ "path": library }]);
    if isolate {
        recipe["plugins"] = json!([{ "path": library, "isolate": true, "time_limit_s": 1.0 }]);
    }
    Variant(recipe).write(folder.path());
    let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "out"]);
    let text = printed.stderr.replace(['│', '╰', '─', '▶', '×'], " ");
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    (printed, text)
}

#[test]
fn a_model_that_behaves_runs() {
    for isolate in [false, true] {
        let (printed, text) = misbehave("good", isolate);
        assert_eq!(printed.status, 0, "{text}");
    }
}

#[test]
fn what_a_bad_model_does_becomes_an_error_of_its_stage() {
    let cases = [
        ("fail", "the vendor says no"),
        ("status", "gave the unknown status 77"),
        ("not-utf8", "gave a text that is not UTF-8"),
        ("nan", "gave positions that are not finite numbers"),
        ("beyond", "wrote beyond the end of the room that it was given"),
        ("no-object", "gave no object"),
        ("no-table", "gave an object without a table"),
        ("no-json", "gave an answer that cannot be read"),
        ("wrong-axis", "whose axis Z has status 9, which is not there"),
        ("no-poses", "it has no `poses`"),
    ];
    for (mode, expected) in cases {
        for isolate in [false, true] {
            let (printed, text) = misbehave(mode, isolate);
            assert!(text.contains(expected), "{mode}: {text}");
            assert!(mode == "fail" || text.contains("`bad-model` of libbad.so"), "{mode} does not say who: {text}");
            assert_eq!(printed.status, 1, "{mode}: {text}");
        }
    }
}

#[test]
fn what_would_end_the_program_ends_an_isolated_plugin_only() {
    let cases = [
        ("abort", "crashed: its process was ended by signal 6 (SIGABRT)"),
        ("crash", "crashed: its process was ended by signal 11 (SIGSEGV)"),
        ("exit", "ended its process, with exit status: 0"),
        ("hang", "gave no answer within 1 s; its process was ended"),
        ("abort-in-build", "crashed: its process was ended by signal 6 (SIGABRT)"),
    ];
    for (mode, expected) in cases {
        let (printed, text) = misbehave(mode, true);
        assert!(text.contains(expected) && text.contains("`bad-model` of libbad.so"), "{mode}: {text}");
        assert_eq!(printed.status, 1, "{mode}: {text}");
    }
}

#[test]
fn wrong_libraries_are_refused() {
    let folder = temporary();
    let at = folder.path();
    let good = bad(at, "good", &[]);
    let whole = fs::read(&good).expect("the library");
    let truncated = at.join("libtruncated.so");
    fs::write(&truncated, &whole[..whole.len() / 3]).expect("a file");
    let text = at.join("text.so");
    write(&text, "no library\n");
    let cases = [
        (at.join("missing.so"), "does not exist"),
        (text, "cannot be loaded"),
        (truncated, "cannot be loaded"),
        (bad(at, "abi", &["-DABI=7"]), "speaks version 7 of the plugin interface, this program speaks version 1"),
        (bad(at, "symbol", &["-DLIBRARY_WITHOUT_SYMBOL"]), "exports no `abbe_plugin`: it is no plugin library"),
        (bad(at, "null", &["-DLIBRARY_GIVES_NULL"]), "gives no table: it refuses to work with this program"),
        (bad(at, "create", &["-DLIBRARY_WITHOUT_CREATE"]), "has a plugin `bad-model` without a function `create`"),
        (bad(at, "plugin", &["-DLIBRARY_WITH_NULL_PLUGIN"]), "has a null pointer in its list of plugins"),
        (bad(at, "letters", &["-DNAME=\"bad name\""]), "has a plugin `bad name`: letters, digits, `-` and `_` were expected"),
    ];
    for (file, expected) in cases {
        for error in [abbe_plugin::load(&file, None).err(), abbe_plugin::isolated(&file, None, &limits(10.0)).err()] {
            let error = error.unwrap_or_else(|| panic!("{} is taken", file.display()));
            assert!(error.message.contains(expected), "{error}");
            assert!(error.message.contains(&*file.to_string_lossy()) && error.class == Class::Use, "{error}");
        }
    }
    let crashes = bad(at, "crashes", &["-DLIBRARY_CRASHES"]);
    let error = abbe_plugin::isolated(&crashes, None, &limits(10.0)).err().expect("it crashes");
    assert!(error.message.contains("crashed: its process was ended by signal 6"), "{error}");

    let taken = bad(at, "taken", &["-DNAME=\"serial-chain\""]);
    let mut registry = Registry::built_in().expect("plugins");
    let error = abbe_plugin::load(&taken, None).expect("it loads").register(&mut registry).expect_err("the name is taken");
    assert!(error.message.contains("has a model plugin `serial-chain`, and there is one of that name already"), "{error}");
}

#[test]
fn a_pinned_library_is_loaded_only_with_its_hash() {
    let folder = temporary();
    lengths(folder.path());
    let library = bad(folder.path(), "bad", &["-DLIBRARY_CRASHES"]);
    let mut recipe = three_axes(json!({ "model": "bad-model", "mode": "good" }));
    recipe["stages"]["fit"]["parameters"] = json!(["E*[1]"]);
    let mut run = |library: Value, more: &[&str]| {
        recipe["plugins"] = json!([library]);
        Variant(recipe.clone()).write(folder.path());
        abbe(folder.path(), &[&["run", "recipe.yaml", "--out", "out"], more].concat())
    };
    // It would crash as soon as it is asked for its table: another hash keeps it from being loaded.
    let printed = run(json!({ "path": "libbad.so", "sha256": "0".repeat(64) }), &[]);
    assert_eq!(printed.status, 2, "{}", printed.stderr);
    assert!(printed.stderr.contains("another SHA-256 than it is pinned to"), "{}", printed.stderr);
    let printed = run(json!({ "path": "libbad.so" }), &["--no-dynamic-plugins"]);
    assert!(printed.status == 2 && printed.stderr.contains("--no-dynamic-plugins"), "{}", printed.stderr);
    let printed = run(json!({ "path": "libbad.so", "sha256": "12" }), &[]);
    assert!(printed.status == 2 && printed.stderr.contains("64 hexadecimal digits"), "{}", printed.stderr);
    let printed = run(json!({ "path": "libbad.so", "time_limit_s": 5 }), &[]);
    assert!(printed.status == 2 && printed.stderr.contains("add `isolate: true`"), "{}", printed.stderr);

    let good = bad(folder.path(), "bad", &[]);
    assert_eq!(good, library);
    let sha256 = abbe_plugin::load(&good, None).expect("it loads").sha256;
    let printed = run(json!({ "path": "libbad.so", "sha256": sha256 }), &[]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let record = crate::support::json_file(&folder.path().join("out/recipe/run.json"));
    let model = record["plugins"].as_array().expect("plugins").iter().find(|plugin| plugin["name"] == "bad-model");
    let model = model.expect("the model is in the record");
    assert_eq!((&model["sha256"], &model["version"]), (&json!(sha256), &json!("0.1.0")));
}

#[test]
fn libraries_are_listed_with_origin_and_version() {
    let folder = temporary();
    let library = bad(folder.path(), "bad", &[]);
    let printed = abbe(folder.path(), &["plugins", "--plugin", &library.to_string_lossy()]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let line = printed.stdout.lines().find(|line| line.contains("bad-model")).expect("the plugin is listed");
    assert!(line.contains("0.1.0") && line.contains("libbad.so") && line.contains("three axes that misbehave"), "{line}");
}

#[test]
fn the_conformance_kit_passes_the_examples() {
    let folder = temporary();
    let files = [
        c_library(folder.path(), "plugins/vendor-three-axis-c/three_axis.c", "threeaxis", &[]),
        cargo_library("abbe-vendor-hexapod"),
        cargo_library("abbe-vendor-nutating-head"),
    ];
    for file in files {
        let printed = abbe(folder.path(), &["plugin", "check", &file.to_string_lossy()]);
        assert_eq!(printed.status, 0, "{}{}", printed.stdout, printed.stderr);
        assert_eq!(printed.stdout.matches("PASS").count(), 9, "{}", printed.stdout);
    }
}

#[test]
fn the_conformance_kit_finds_what_is_wrong() {
    let cases = [
        ("slope", "derivatives", "the derivative of the position to EXX[1] is off by"),
        ("random", "threads", "answers on 8 threads differ"),
        ("leak", "leaks", "poses: 10,000 of them leave"),
        ("rounding", "surroundings", "the floating-point state of the thread was changed"),
        ("directory", "surroundings", "changes the working directory"),
        ("hang", "empty-batch", "no end within 5 s"),
        ("abort", "threads", "signal: 6 (SIGABRT)"),
        ("nan", "derivatives", "gave positions that are not finite numbers"),
    ];
    for (mode, test, expected) in cases {
        let folder = temporary();
        let library = bad(folder.path(), "bad", &[&format!("-DMODE=\"{mode}\"")]);
        let arguments = ["plugin", "check", &library.to_string_lossy(), "--time-limit", "5", "--json"].map(str::to_owned);
        let printed = abbe(folder.path(), &arguments);
        assert_eq!(printed.status, 1, "{mode}: {}{}", printed.stdout, printed.stderr);
        let report: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        let tests = report["tests"].as_array().expect("tests");
        let found = tests.iter().find(|found| found["test"] == test).expect("the test was run");
        assert!(found["wrong"].to_string().contains(expected), "{mode}: {report:#}");
    }
}

#[test]
fn the_hexapod_is_calibrated_end_to_end() {
    let folder = temporary();
    let source = root().join("plugins/vendor-hexapod/recipe");
    for name in ["hexapod.yaml", "machine.yaml", "balls.csv", "centres.csv", "truth.json"] {
        fs::copy(source.join(name), folder.path().join(name)).expect("the recipe of the example");
    }
    let library = cargo_library("abbe-vendor-hexapod");
    fs::copy(&library, folder.path().join("libhexapod.so")).expect("the library");
    let printed = abbe(folder.path(), &["simulate", "hexapod.yaml", "--truth", "truth.json", "--seed", "1", "--out", "simulated", "--plugin", "libhexapod.so"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let _ = recipes;
}
