//! Dynamic plugins: the same results as built in, from Rust and from C, isolated or not; and libraries that misbehave.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use abbe_core::{Calibration, Class, Registry};
use abbe_engine::{Outcome, prepare};
use abbe_plugin::{Library, Limits, abi};
use serde_json::{Value, json};

use crate::support::{Printed, Small, Variant, abbe, files_in, fit, json_file, read, root, temporary, values, write};

/// The folder that the program was built into.
fn target() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_abbe-under-test"));
    program.ancestors().nth(2).expect("the program is in <target>/<profile>").to_owned()
}

/// A library of the workspace, built as it stands beside the program.
fn cargo_library(package: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        let mut command = Command::new(env!("CARGO"));
        command.args(["build", "--locked", "--quiet", "--target-dir"]).arg(target());
        // With the program, so that shared crates are built with the same features as for it.
        for package in ["abbe", "abbe-vendor-hexapod", "abbe-vendor-nutating-head", "abbe-stock-library"] {
            command.args(["--package", package]);
        }
        let built = command.current_dir(root()).output().expect("cargo runs");
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    });
    let name = package.replace('-', "_");
    target().join("debug").join(format!("{}{name}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX))
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

/// All six kinds: every validator and exporter of the recipe on its second fit.
fn six_kinds() -> Variant {
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

/// Lengths all over a workspace, of a machine with some errors and some noise.
fn lengths(folder: &Path) {
    let mut text = "length,X1_mm,Y1_mm,Z1_mm,X2_mm,Y2_mm,Z2_mm,reference_mm\n".to_owned();
    let steps = [2.0_f64, 3.0, 5.0, 7.0, 11.0, 13.0].map(f64::sqrt);
    let spread = |row: usize, column: usize| 600.0 * (((row + 1) as f64 * steps[column]).fract() - 0.5);
    for row in 0..40 {
        let ends: Vec<f64> = (0..6).map(|column| spread(row, column)).collect();
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
        (
            bad(at, "letters", &["-DNAME=\"bad name\""]),
            "has a plugin `bad name`: letters, digits, `-` and `_` were expected",
        ),
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
    let error =
        abbe_plugin::load(&taken, None).expect("it loads").register(&mut registry).expect_err("the name is taken");
    assert!(
        error.message.contains("has a model plugin `serial-chain`, and there is one of that name already"),
        "{error}"
    );
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
    let record = json_file(&folder.path().join("out/recipe/run.json"));
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
    assert!(
        line.contains("0.1.0") && line.contains("libbad.so") && line.contains("three axes that misbehave"),
        "{line}"
    );
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
        ("hang", "empty-batch", "no end within 1 s"),
        ("abort", "threads", "signal: 6 (SIGABRT)"),
        ("orientation", "derivatives", "gave orientations that are no unit quaternions"),
        ("nan", "derivatives", "gave positions that are not finite numbers"),
    ];
    for (mode, test, expected) in cases {
        let folder = temporary();
        let library = bad(folder.path(), "bad", &[&format!("-DMODE=\"{mode}\"")]);
        let limit = if mode == "hang" { "1" } else { "60" };
        let arguments =
            ["plugin", "check", &library.to_string_lossy(), "--time-limit", limit, "--json"].map(str::to_owned);
        let printed = abbe(folder.path(), &arguments);
        assert_eq!(printed.status, 1, "{mode}: {}{}", printed.stdout, printed.stderr);
        let report: Value = serde_json::from_str(&printed.stdout).expect("JSON");
        let tests = report["tests"].as_array().expect("tests");
        let found = tests.iter().find(|found| found["test"] == test).expect("the test was run");
        assert!(found.to_string().contains(expected), "{mode}: {report:#}");
    }
}

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

/// C assertions that structures of the header are as the program has them.
macro_rules! layouts {
    ($($structure:ident { $($field:ident),* $(,)? })*) => {{
        let mut text = String::new();
        $(
            let size = size_of::<abi::$structure>();
            text.push_str(&format!("_Static_assert(sizeof({0}) == {size}, \"{0}\");\n", stringify!($structure)));
            $(
                let offset = std::mem::offset_of!(abi::$structure, $field);
                let (name, field) = (stringify!($structure), stringify!($field));
                text.push_str(&format!("_Static_assert(offsetof({name}, {field}) == {offset}, \"{name}.{field}\");\n"));
            )*
        )*
        text
    }};
}

#[test]
fn the_header_is_that_of_the_program() {
    let mut text = "#include <stddef.h>\n#include \"abbe_plugin.h\"\n".to_owned();
    text.push_str(&layouts! {
        AbbeText { data, length }
        AbbeObject { table, handle }
        AbbeTable { size, retain, release, call, poses, equations }
        AbbeQuestion { size, text, objects, object_count }
        AbbeReply { size, context, text, object }
        AbbeVariable { kind, index }
        AbbePoses {
            size, statuses, status_count, values, value_count, wanted, wanted_count, pose_count, positions, orientations,
            position_derivatives, rotation_derivatives,
        }
        AbbeRows { size, rows, row_count, positions, orientations, pose_count, own, own_count, inputs, input_count }
        AbbeEquations { size, context, equation, position, rotation, own, input }
        AbbePlugin { size, kind, name, about, schema, example, create }
        AbbeLibrary { abi_major, abi_minor, size, name, version, plugins, plugin_count }
        AbbeHost { abi_major, abi_minor, size, log }
    });
    // Every constant and every structure of the source.
    let source = read(&root().join("crates/abbe-plugin/src/abi.rs"));
    let constants = source.lines().filter_map(|line| line.strip_prefix("pub const ABBE_")?.split_once(": u32 = "));
    let constants: Vec<(&str, &str)> = constants.collect();
    assert!(constants.len() > 30, "{constants:?}");
    for (name, value) in constants {
        let value = value.trim_end_matches(';');
        text.push_str(&format!("_Static_assert(ABBE_{name} == {value}, \"ABBE_{name}\");\n"));
    }
    for structure in source.lines().filter_map(|line| line.strip_prefix("pub struct ")) {
        let name = structure.trim_end_matches(" {");
        assert!(text.contains(&format!("sizeof({name})")), "{name} is not compared");
    }
    let folder = temporary();
    let file = folder.path().join("header.c");
    write(&file, &text);
    for (compiler, language) in [("cc", "c"), ("c++", "c++")] {
        let mut command = Command::new(compiler);
        command.args(["-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-x", language]);
        command.arg("-I").arg(root().join("crates/abbe-plugin/include"));
        if language == "c++" {
            command.arg("-D_Static_assert=static_assert");
        }
        let checked = command.arg(&file).output().expect("the compiler runs");
        assert!(checked.status.success(), "{language}: {}", String::from_utf8_lossy(&checked.stderr));
    }
}

/// Builds a crate outside of the workspace, as a vendor does, from what the page for vendors says.
fn from_the_page(folder: &Path, edit: impl Fn(&str) -> String) -> PathBuf {
    let page = read(&root().join("docs/vendor-plugins.md"));
    let block = |language: &str| {
        let start = page.split(&format!("```{language}\n")).nth(1).expect("the page has such a block");
        start.split("```").next().expect("the block ends").to_owned()
    };
    let (manifest, source) = (block("toml"), block("rust"));
    assert!(source.lines().filter(|line| !line.trim().is_empty()).count() < 30, "fewer than 30 lines are promised");
    let sdk = root().join("crates/abbe-plugin");
    let manifest = manifest.replace("../abbe/crates/abbe-plugin", &sdk.to_string_lossy());
    let package = "[package]\nname = \"vendor-list\"\nversion = \"1.2.3\"\nedition = \"2024\"\n\n";
    write(&folder.join("Cargo.toml"), &format!("{package}{manifest}\n[workspace]\n"));
    write(&folder.join("src/lib.rs"), &edit(&source));
    fs::copy(root().join("Cargo.lock"), folder.join("Cargo.lock")).expect("the versions of the workspace");
    let target = target().join("vendor");
    let mut command = Command::new(env!("CARGO"));
    command.args(["build", "--offline", "--quiet", "--target-dir"]).arg(&target).current_dir(folder);
    let built = command.output().expect("cargo runs");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let name = format!("{}vendor_list{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let library = folder.join(&name);
    fs::copy(target.join("debug").join(&name), &library).expect("the library");
    library
}

#[test]
fn what_the_page_for_vendors_says_works_and_a_panic_is_an_error() {
    let vendor = temporary();
    let small = Small::new();
    let recipe = crate::support::SMALL.replace(
        "written: { export: error-table, of: fine, step_mm: 100, step_deg: 30 }",
        "written: { export: vendor-list, of: fine }",
    );
    assert_ne!(recipe, crate::support::SMALL);
    small.write("recipe.yaml", &recipe);
    let library = from_the_page(vendor.path(), str::to_owned);
    let run = |library: &Path, more: &[&str]| {
        small.abbe(&[&["run", "recipe.yaml", "--plugin", &*library.to_string_lossy()], more].concat())
    };
    let printed = run(&library, &[]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(small.read("out/recipe/written/list.txt").contains("EXX[1] "));
    let checked = small.abbe(&["plugin", "check", &library.to_string_lossy()]);
    assert_eq!(checked.status, 0, "{}", checked.stdout);

    let panics = |source: &str| {
        source.replace(
            "        let lines",
            "        assert!(calibration.parameters.is_empty(), \"a bug of the vendor\");\n        let lines",
        )
    };
    let library = from_the_page(vendor.path(), panics);
    for more in [&[][..], &["--isolate-plugins"]] {
        let printed = run(&library, more);
        let text = printed.stderr.replace(['│', '×'], " ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(printed.status, 1, "{text}");
        assert!(
            text.contains("the plugin `vendor-list` of") && text.contains("panicked: a bug of the vendor"),
            "{text}"
        );
    }
}
