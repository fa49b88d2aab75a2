//! Libraries and plugins that misbehave.

use std::fs;

use abbe_core::{Class, Registry};
use serde_json::{Value, json};

use super::{bad, lengths, limits, three_axes};
use crate::support::{Printed, Variant, abbe, json_file, temporary, write};

/// Runs the recipe of three axes on the bad model, which misbehaves in this way.
fn misbehave(mode: &str, isolate: bool) -> (Printed, String) {
    let folder = temporary();
    lengths(folder.path());
    let library = bad(folder.path(), "bad", &[]);
    let mut recipe = three_axes(json!({ "model": "bad-model", "mode": mode }));
    recipe["stages"]["fit"]["parameters"] = json!(["E*[1]"]);
    recipe["plugins"] = json!([{ "path": library, "isolate": false }]);
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
        ("status-in-create", "gave the unknown status 78"),
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
        ("abort-in-create", "crashed: its process was ended by signal 6 (SIGABRT)"),
    ];
    for (mode, expected) in cases {
        let (printed, text) = misbehave(mode, true);
        assert!(text.contains(expected) && text.contains("`bad-model` of libbad.so"), "{mode}: {text}");
        assert_eq!(printed.status, 1, "{mode}: {text}");
    }
}

/// What a plugin in the program can do, an isolated one cannot.
#[test]
#[cfg(target_os = "linux")]
fn an_isolated_plugin_is_confined() {
    if let Some(missing) = abbe_plugin::missing() {
        println!("skipped: {missing}");
        return;
    }
    let cases = [
        ("read", "read a file of the system"),
        ("list", "list a folder"),
        ("write", "write a file"),
        ("change", "change a file"),
        ("network", "open a socket"),
        ("fork", "start a process"),
        ("signal", "signal to another process"),
        ("memory", "have 3 GiB of memory"),
        ("environment", "read the environment"),
    ];
    for (mode, could) in cases {
        let (printed, text) = misbehave(mode, false);
        assert!(printed.status == 1 && text.contains(could), "{mode}: {text}");
        let (printed, text) = misbehave(mode, true);
        assert_eq!(printed.status, 0, "{mode}: {text}");
    }
}

/// Who pins nothing gets a process for the plugin, unless he says that he trusts it.
#[test]
fn a_library_that_nobody_pins_is_isolated() {
    let folder = temporary();
    lengths(folder.path());
    let library = bad(folder.path(), "bad", &[]);
    let mut recipe = three_axes(json!({ "model": "bad-model", "mode": "environment" }));
    recipe["stages"]["fit"]["parameters"] = json!(["E*[1]"]);
    let sha256 = abbe_plugin::isolated(&library, None, &limits(60.0)).expect("a library").sha256;
    for (plugins, flag, status) in [
        (json!([{ "path": library }]), None, 0),
        (json!([{ "path": library }]), Some("--trust-plugins"), 1),
        (json!([{ "path": library, "sha256": sha256 }]), None, 1),
        (json!([{ "path": library, "sha256": sha256 }]), Some("--isolate-plugins"), 0),
        (json!([{ "path": library, "isolate": true }]), Some("--trust-plugins"), 0),
        (json!([{ "path": library, "memory_limit_mib": 128 }]), None, 0),
    ] {
        recipe["plugins"] = plugins.clone();
        Variant(recipe.clone()).write(folder.path());
        let arguments = ["run", "recipe.yaml", "--out", "out"].into_iter().chain(flag).collect::<Vec<_>>();
        let printed = abbe(folder.path(), &arguments);
        assert_eq!(printed.status, status, "{plugins} {flag:?}: {}", printed.stderr);
    }
}

#[test]
fn a_plugin_in_the_process_that_ends_it_is_no_success() {
    let (printed, text) = misbehave("exit", false);
    assert!(text.contains("a plugin library ended the program before its work was done"), "{text}");
    assert_eq!((printed.status, printed.stdout.as_str()), (1, ""), "{text}");
}

#[test]
fn a_plugin_that_goes_elsewhere_takes_no_results_along() {
    let folder = temporary();
    lengths(folder.path());
    let library = bad(folder.path(), "bad", &[]);
    let mut recipe = three_axes(json!({ "model": "bad-model", "mode": "directory" }));
    recipe["stages"]["fit"]["parameters"] = json!(["E*[1]"]);
    recipe["plugins"] = json!([{ "path": library }]);
    Variant(recipe).write(folder.path());
    let printed = abbe(folder.path(), &["run", "recipe.yaml", "--out", "results-of-the-bad-model"]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    assert!(folder.path().join("results-of-the-bad-model/recipe/run.json").exists());
    assert!(!std::path::Path::new("/results-of-the-bad-model").exists());
}

#[test]
fn a_plugin_that_fails_at_a_step_ends_the_run_and_one_that_refuses_it_is_asked_for_a_smaller_one() {
    let cases = [
        ("away-nan", &[false, true][..], "gave positions that are not finite numbers"),
        ("away-status", &[false, true], "gave the unknown status 77"),
        ("away-not-utf8", &[false, true], "gave a text that is not UTF-8"),
        ("away-beyond", &[false, true], "wrote beyond the end of the room that it was given"),
        ("away-panic", &[false, true], "panicked: a bug of the vendor"),
        ("away-fault", &[false, true], "the licence has expired"),
        ("away-abort", &[true], "ended by signal 6 (SIGABRT)"),
        ("away-exit", &[true], "ended its process, with exit status: 0"),
        ("away-hang", &[true], "gave no answer within 1 s"),
    ];
    for (mode, isolations, expected) in cases {
        for &isolate in isolations {
            let (printed, text) = misbehave(mode, isolate);
            assert!(printed.status == 1 && text.contains(expected), "{mode}: {text}");
            assert_eq!(text.matches("asked away from the start").count(), 1, "{mode}: {text}");
        }
    }
    // The whole step, of which a gradient is asked first, and 19 halves are refused; then the refusal is told.
    for isolate in [false, true] {
        let (printed, text) = misbehave("away-fail", isolate);
        assert!(printed.status == 1 && text.contains("the vendor says no"), "{text}");
        assert_eq!(text.matches("asked away from the start").count(), 21, "{text}");
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
        (
            bad(at, "abi", &["-DABI=7"]),
            "speaks version 7 of the plugin interface, this program speaks version 2: build it again",
        ),
        // The number before there were roles.
        (bad(at, "abi-1", &["-DABI=1"]), "speaks version 1 of the plugin interface, this program speaks version 2"),
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
    let printed = run(json!({ "path": "libbad.so", "isolate": false, "time_limit_s": 5 }), &[]);
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
