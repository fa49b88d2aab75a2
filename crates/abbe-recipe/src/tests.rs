use abbe_core::{Build, Class, Constructor, Context, Place, path_text};
use proptest::prelude::*;
use serde_json::json;

use super::*;

const GOOD: &str = r#"abbe: 1
name: A good one
sets:
  S1: [dxt, dyt]
  S2: ["@S1", EXX, dxt]
plugins:
  - { path: vendor/libhexapod.so, sha256: 0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f }
stages:
  cnc: { export: linuxcnc, of: fit-2, step_mm: 20 }
  touches: { ingest: csv, path: touches.csv }
  table: { artefact: facets, from: touches }
  bar: { artefact: length, from: touches, nominal: { 2: x } }
  hu40t:
    model: chain
    file: machine.yaml
    chain: { w: 1, t: { tip_mm: 5 } }
    errors:
      - { backlash: [EXX] }
  fit-1:
    estimate: gauss-newton
    machine: hu40t
    observations: [table, bar]
    parameters: [dzt, "@S2", "bar.*"]
  fit-2: { estimate: gauss-newton, machine: hu40t, observations: table, known: fit-1, parameters: [dyt] }
  residuals: { validate: residuals, of: [fit-1, fit-2], from: touches }
"#;

const MACHINE: &str =
    "photo: front.jpg\nchain:\n  b: 7\n  t: { tip_mm: 1, radius_mm: 3 }\nerrors: [{ a: { b: 1 } }]\ntool_mm: 80\n";

fn refuse<T: ?Sized>(_: &Value, _: &Context) -> Result<Box<T>, SettingsError> {
    Err(SettingsError::new("", "recipes build nothing"))
}

fn registry() -> Registry {
    let mut registry = Registry::built_in().unwrap();
    let build = |kind| match kind {
        Kind::Ingest => Build::Ingest(Constructor::Static(refuse)),
        Kind::Artefact => Build::Artefact(Constructor::Static(refuse)),
        Kind::Model => Build::Model(Constructor::Static(refuse)),
        Kind::Estimate => Build::Estimate(Constructor::Static(refuse)),
        Kind::Validate => Build::Validate(Constructor::Static(refuse)),
        Kind::Export => Build::Export(Constructor::Static(refuse)),
    };
    let names = [
        (Kind::Ingest, ["csv", "sql"]),
        (Kind::Artefact, ["facets", "length"]),
        (Kind::Model, ["chain", "hexapod"]),
        (Kind::Estimate, ["gauss-newton", "filter"]),
        (Kind::Validate, ["residuals", "hold-out"]),
        (Kind::Export, ["linuxcnc", "table"]),
    ];
    for (kind, name) in names.iter().flat_map(|(kind, names)| names.map(|name| (*kind, name))) {
        let schema = || {
            let names = ["path", "nominal", "chain", "errors", "tool_mm", "step_mm"];
            let properties: Map<String, Value> = names.map(|name| (name.to_owned(), json!(true))).into_iter().collect();
            json!({ "$schema": "x", "properties": properties, "additionalProperties": false })
        };
        registry.add(Plugin::built_in(name, "A fake.", schema, || json!({}), build(kind))).unwrap();
    }
    registry
}

/// A folder with a machine description, a broken one and a recipe's path.
fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("machine.yaml", MACHINE),
        ("broken.yaml", "chain:\n  b: [1\n"),
        ("list.yaml", "- 1\n"),
        ("misspelt.yaml", "tol_mm: 80\n"),
        ("cut.yaml", "chain: w X t\ntable_frame: origin at the po"),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let path = folder.path().join("r.yaml");
    (folder, path)
}

/// What is said about the good recipe after the first `old` in it became `new`.
fn check(old: &str, new: &str, expected: &str) {
    let (folder, path) = folder();
    assert!(GOOD.contains(old), "{old}");
    let error = Recipe::parse(&path, &GOOD.replacen(old, new, 1), &registry()).expect_err(new);
    assert_eq!(error.class, Class::Use);
    let folder = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
    assert_eq!(error.to_string().replace(&folder, ""), expected, "{old} -> {new}");
}

#[test]
fn wrong_recipes_are_refused_with_place_and_help() {
    let cases = [
        (GOOD, "", "r.yaml:1:1: a map was expected, not nothing"),
        (GOOD, "- 1\n", "r.yaml:1:1: a map was expected, not a list"),
        (GOOD, "abbe: 1\nstages: {}", "r.yaml:2:9: stages: at least one stage was expected"),
        (GOOD, "abbe: 1", "r.yaml:1:1: the key `stages` is missing"),
        (
            ", parameters: [dyt]",
            "",
            "r.yaml:24:3: stage `fit-2`: the setting `parameters` is missing: what is to be estimated? (`parameters: []` takes the machine as it is)",
        ),
        (
            "file: machine.yaml",
            "file: misspelt.yaml",
            "misspelt.yaml:1:1: stage `hu40t`: `tol_mm` is no setting of `chain` (did you mean `tool_mm`? a note needs another name)",
        ),
        ("[dxt, dyt]", "[dxt, 3]", "r.yaml:4:13: S1[1]: text was expected, not a number"),
        (
            ", parameters: [dyt]",
            ", parameters: [dyt, [dzt]]",
            "r.yaml:24:105: stage `fit-2`: parameters[1]: text was expected, not a list",
        ),
        ("[dxt, dyt]", "[dxt, dyt", "r.yaml:5:5: this is not YAML: illegal placement of ':' indicator"),
        (
            "[\"@S1\"",
            "[@S1",
            r#"r.yaml:5:8: this is not YAML: unexpected character: `@' (a text that starts with @ needs quotes: "@S1")"#,
        ),
        (
            "{ path: v",
            "{ path: \tv: ",
            "r.yaml:7:15: this is not YAML: while parsing a flow mapping, did not find expected ',' or '}'",
        ),
        ("step_mm: 20", "step_mm: .inf", "r.yaml:9:48: stages.cnc.step_mm: a finite number was expected, not .inf"),
        ("step_mm: 20", "step_mm: 20, step_mm: 21", "r.yaml:9:52: the key `step_mm` stands here a second time"),
        ("step_mm: 20", "step_mm: !mm 20", "r.yaml:9:48: the tag `!mm` was found; recipes have no tags"),
        (
            "step_mm: 20",
            "step_mm: 99999999999999999999999999",
            "r.yaml:9:48: stages.cnc.step_mm: the number is too large",
        ),
        ("step_mm: 20", "[a]: 20", "r.yaml:9:39: a key has to be text or a number"),
        ("stages:", "---\nstages:", "r.yaml:8:1: a second YAML document starts here; one was expected"),
        ("stages:", "a: \"\u{7}\"\nstages:", "r.yaml:8:5: control characters are not allowed"),
        ("stages:", "<<: { a: 1 }\nstages:", "r.yaml:8:1: merge keys (`<<`) are not read: write the settings out"),
        ("abbe: 1", "abbe: 2", "r.yaml:1:7: this program reads recipes of version 1, not 2"),
        ("abbe: 1", "abbe: \"1\"", r#"r.yaml:1:7: this program reads recipes of version 1, not "1""#),
        (
            "abbe: 1",
            "abe: 1",
            "r.yaml:1:1: the key `abbe` is missing: this program reads recipes of version 1, `abbe: 1` (did you mean `abbe`?)",
        ),
        ("abbe: 1\n", "", "r.yaml:1:1: the key `abbe` is missing: this program reads recipes of version 1, `abbe: 1`"),
        ("name:", "nmae:", "r.yaml:2:1: unknown key `nmae` (did you mean `name`?)"),
        ("A good one", "[a]", "r.yaml:2:7: name: text was expected, not a list"),
        ("stages:", "stage:", "r.yaml:8:1: unknown key `stage` (did you mean `stages`?)"),
        ("[dxt, dyt]", "dxt", "r.yaml:4:7: S1: a list was expected, not text"),
        ("[dxt, dyt]", "[dxt, 5]", "r.yaml:4:13: S1[1]: text was expected, not a number"),
        ("[dxt, dyt]", "[dxt, \"@S22\"]", "r.yaml:4:13: there is no set `S22` (did you mean `S2`?)"),
        ("[dxt, dyt]", "[dxt, \"@S2\"]", "r.yaml:5:8: the sets include each other in a circle: S1 -> S2 -> S1"),
        ("\"@S2\"", "\"@2S\"", "r.yaml:23:23: stage `fit-1`: there is no set `2S`"),
        ("path: vendor", "pth: vendor", "r.yaml:7:7: unknown key `pth` (did you mean `path`?)"),
        (
            "{ path: vendor/libhexapod.so, sha256: 0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f0f }",
            "{}",
            "r.yaml:7:5: `path` is missing: the file of the library",
        ),
        ("cnc:", "c.nc:", "r.yaml:9:3: `c.nc` cannot name a stage: letters, digits, `-` and `_` were expected"),
        ("cnc:", "\"\":", "r.yaml:9:3: `` cannot name a stage: letters, digits, `-` and `_` were expected"),
        (
            "{ ingest: csv, path: touches.csv }",
            "csv",
            "r.yaml:10:12: stage `touches`: touches: a map was expected, not text",
        ),
        ("ingest: csv", "path: csv", "r.yaml:10:25: the key `path` stands here a second time"),
        (
            "artefact: facets",
            "artifact: facets",
            "r.yaml:11:12: stage `table`: one of the keys ingest, artefact, model, estimate, validate, export was expected: the kind of the stage (did you mean `artefact`?)",
        ),
        (
            "{ artefact: facets, from: touches }",
            "{ from: touches }",
            "r.yaml:11:3: stage `table`: one of the keys ingest, artefact, model, estimate, validate, export was expected: the kind of the stage",
        ),
        (
            "step_mm: 20",
            "model: chain",
            "r.yaml:9:39: stage `cnc`: a stage is of one kind; this one has `export` and `model`",
        ),
        (
            "csv, path",
            "cvs, path",
            "r.yaml:10:22: stage `touches`: there is no ingest plugin `cvs` (did you mean `csv`?)",
        ),
        ("csv, path", "[csv], path", "r.yaml:10:22: stage `touches`: ingest: text was expected, not a list"),
        (
            "gauss-newton",
            "magic",
            "r.yaml:20:15: stage `fit-1`: there is no estimate plugin `magic` (there are: filter, gauss-newton)",
        ),
        (
            "from: touches",
            "form: touches",
            "r.yaml:11:30: stage `table`: `from` is missing: `from` takes one ingest stage (did you mean `from`?)",
        ),
        (
            "from: touches }",
            "nominal: touches }",
            "r.yaml:11:3: stage `table`: `from` is missing: `from` takes one ingest stage",
        ),
        (
            "from: touches",
            "from: tuches",
            "r.yaml:11:36: stage `table`: there is no stage `tuches` (did you mean `touches`?)",
        ),
        (
            "from: touches",
            "from: hu40t",
            "r.yaml:11:36: stage `table`: `from` takes one ingest stage; `hu40t` is a model stage",
        ),
        (
            "from: touches",
            "from: [touches, touches]",
            "r.yaml:11:36: stage `table`: `from` takes one ingest stage, not 2",
        ),
        ("from: touches", "from: []", "r.yaml:11:36: stage `table`: `from` takes one ingest stage, not 0"),
        ("from: touches", "from: 7", "r.yaml:11:36: stage `table`: from: text was expected, not a number"),
        (
            "[table, bar]",
            "[table, bar, table]",
            "r.yaml:22:32: stage `fit-1`: `observations` names `table` a second time",
        ),
        (
            "[table, bar]",
            "[table, [bar]]",
            "r.yaml:22:27: stage `fit-1`: observations[1]: text was expected, not a list",
        ),
        ("of: fit-2", "of: [fit-1, fit-2]", "r.yaml:9:32: stage `cnc`: `of` takes one estimate stage, not 2"),
        (
            "parameters: [dzt",
            "known: fit-2\n    parameters: [dzt",
            "r.yaml:25:80: the stages refer to each other in a circle: fit-2 -> fit-1 -> fit-2",
        ),
        ("known: fit-1", "start: fit-2", "r.yaml:24:80: the stages refer to each other in a circle: fit-2 -> fit-2"),
        (
            "file: machine.yaml",
            "file: machin.yaml",
            "r.yaml:15:11: stage `hu40t`: the file `machin.yaml` does not exist",
        ),
        (
            "file: machine.yaml",
            "file: broken.yaml",
            "broken.yaml:3:1: stage `hu40t`: this is not YAML: while parsing a flow sequence, expected ',' or ']'",
        ),
        (
            "file: machine.yaml",
            "file: cut.yaml",
            "cut.yaml:2: stage `hu40t`: the machine file ends here within a line, and has no `axes`: it looks cut off (take the whole \
             file; if this is all of it, end its last line)",
        ),
        ("file: machine.yaml", "file: list.yaml", "list.yaml:1:1: stage `hu40t`: a map was expected, not a list"),
        ("file: machine.yaml", "file: 3", "r.yaml:15:11: stage `hu40t`: file: text was expected, not a number"),
    ];
    for (old, new, expected) in cases {
        check(old, new, expected);
    }
    let bomb = (1..30).map(|i| format!("a{i}: &a{i} [*a{0}, *a{0}, *a{0}]\n", i - 1)).collect::<String>();
    for (deep, expected) in [
        (format!("a0: &a0 [1]\n{bomb}"), "r.yaml:1:1: the aliases (`*name`) repeat more than is read"),
        ("[".repeat(100_000), "r.yaml:1:256: lists and maps are more than 64 deep here"),
        ("[".repeat(100), "r.yaml:1:65: lists and maps are more than 64 deep here"),
        ("- ".repeat(100_000), "r.yaml:1:129: lists and maps are more than 64 deep here"),
    ] {
        assert_eq!(Recipe::parse(Path::new("r.yaml"), &deep, &registry()).unwrap_err().to_string(), expected);
    }
}

#[test]
fn a_byte_order_mark_is_passed_over() {
    let marked = Document::parse(Path::new("a.yaml"), "\u{feff}a: 1\nb: 2\n").unwrap();
    assert_eq!(marked.root().value, &serde_json::json!({ "a": 1, "b": 2 }));
    let wrong = Document::parse(Path::new("a.yaml"), "\u{feff}a: [1\n").unwrap_err();
    assert!(wrong.place.is_some_and(|place| place.line.is_some()));
}

#[test]
fn a_good_recipe_is_read() {
    let (folder, path) = folder();
    std::fs::write(&path, GOOD).unwrap();
    let recipe = Recipe::read(&path, &registry()).unwrap();
    let base = folder.path();
    assert_eq!((recipe.name.as_str(), recipe.id.as_str(), recipe.base.as_path()), ("A good one", "r", base));
    let order: Vec<&str> = recipe.stages.iter().map(|stage| stage.name.as_str()).collect();
    assert_eq!(order, ["touches", "table", "bar", "hu40t", "fit-1", "fit-2", "cnc", "residuals"]);
    let stage = |name: &str| recipe.stages.iter().find(|stage| stage.name == name).unwrap();
    assert_eq!((stage("cnc").kind, stage("cnc").plugin.as_str()), (Kind::Export, "linuxcnc"));
    assert_eq!(stage("cnc").settings, json!({ "step_mm": 20 }));
    assert_eq!(stage("bar").settings, json!({ "nominal": { "2": "x" } }));
    assert_eq!(stage("fit-1").settings, json!({}));
    assert_eq!(stage("fit-1").parameters, ["dzt", "dxt", "dyt", "EXX", "bar.*"]);
    assert_eq!(stage("cnc").parameters, [""; 0]);
    assert_eq!(stage("fit-1").reference("observations"), ["table", "bar"]);
    assert_eq!(stage("fit-2").reference("observations"), ["table"]);
    assert_eq!(stage("fit-1").reference("known"), [""; 0]);
    let chain = json!({ "b": 7, "t": { "tip_mm": 5, "radius_mm": 3 }, "w": 1 });
    let expected = json!({ "chain": chain, "errors": [{ "backlash": ["EXX"] }], "tool_mm": 80 });
    assert_eq!(stage("hu40t").settings, expected);
    assert_eq!(stage("hu40t").files, [base.join("machine.yaml")]);
    let place = Some(Place { file: path.clone(), line: Some(7), column: Some(13) });
    let library =
        Library { path: base.join("vendor/libhexapod.so"), sha256: Some("0f".repeat(32)), isolate: None, place };
    assert_eq!(recipe.libraries, [library]);
    assert_eq!(Recipe::libraries(&path, GOOD).unwrap(), recipe.libraries);
    let missing = Recipe::read(&base.join("none.yaml"), &registry()).unwrap_err();
    assert!(missing.to_string().ends_with("none.yaml` does not exist"), "{missing}");
}

#[test]
fn settings_are_found_where_they_were_written() {
    let (folder, path) = folder();
    let recipe = Recipe::parse(
        &path,
        &GOOD.replace("touches }\n  bar", "touches, nominal: &n [[1]] }\n  bar").replace("{ 2: x }", "*n"),
        &registry(),
    )
    .unwrap();
    let key = |text: &str| PathItem::Key(text.to_owned());
    let index = PathItem::Index;
    let cases = [
        ("cnc", vec![], false, "r.yaml:9:3"),
        ("cnc", vec![key("absent")], false, "r.yaml:9:3"),
        ("cnc", vec![key("step_mm")], false, "r.yaml:9:48"),
        ("cnc", vec![key("step_mm")], true, "r.yaml:9:39"),
        ("bar", vec![key("nominal"), index(0)], false, "r.yaml:12:52"), // below an alias
        ("fit-1", vec![key("parameters")], false, "r.yaml:23:17"),
        ("fit-1", vec![key("parameters"), index(0)], false, "r.yaml:23:18"),
        ("fit-1", vec![key("parameters"), index(2)], false, "r.yaml:4:13"), // dyt of S1
        ("fit-1", vec![key("parameters"), index(3)], false, "r.yaml:5:15"), // EXX of S2
        ("fit-1", vec![key("parameters"), index(4)], false, "r.yaml:23:30"),
        ("hu40t", vec![key("chain"), key("w")], false, "r.yaml:16:17"),
        ("hu40t", vec![key("chain"), key("b")], true, "machine.yaml:3:3"),
        ("hu40t", vec![key("chain"), key("t"), key("tip_mm")], false, "r.yaml:16:33"),
        ("hu40t", vec![key("chain"), key("t"), key("radius_mm"), key("x")], false, "machine.yaml:4:30"),
        ("hu40t", vec![key("errors"), index(0), key("a"), key("b")], false, "r.yaml:18:9"), // replaced by the recipe
        ("hu40t", vec![key("tool_mm")], false, "machine.yaml:6:10"),
        ("nobody", vec![key("tool_mm")], false, "r.yaml"),
    ];
    for (stage, path, key, expected) in cases {
        let name = path_text(&path);
        let error =
            SettingsError { path: path.clone(), key, help: Some("h".to_owned()), ..SettingsError::new("", "wrong") };
        let text = |error: Error| {
            error.to_string().replace(&format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR), "")
        };
        let prefix = if key || name.is_empty() { String::new() } else { format!("{name}: ") };
        let settings_error = recipe.settings_error(stage, error);
        assert_eq!(settings_error.class, Class::Use);
        assert_eq!(text(settings_error), format!("{expected}: stage `{stage}`: {prefix}wrong (h)"));
        if !key {
            let located = recipe.locate(Error { setting: path, ..Error::data("wrong").stage(stage) });
            assert_eq!((located.class, text(located)), (Class::Data, format!("{expected}: stage `{stage}`: wrong")));
        }
    }
    for (stage, wrong, near) in [("fit-1", "knwon", "known"), ("hu40t", "fiel", "file")] {
        let error = SettingsError { key: true, ..SettingsError::new(wrong, "wrong") };
        assert_eq!(recipe.settings_error(stage, error).help, Some(format!("did you mean `{near}`?")));
    }
    let failed = SettingsError { class: Class::Data, ..SettingsError::new("", "a plugin crashed") };
    assert_eq!(recipe.settings_error("cnc", failed).class, Class::Data);
    let elsewhere = Error::data("wrong").stage("cnc").at(Path::new("x.csv"), 3, None);
    assert_eq!(recipe.locate(elsewhere.clone()), elsewhere);
    assert_eq!(recipe.locate(Error::data("wrong")), Error::data("wrong"));
}

#[test]
fn the_schema_tells_good_from_bad() {
    let schema = schema(&registry());
    let validator = jsonschema::draft202012::new(&schema).unwrap();
    let valid = |text: &str| validator.is_valid(&serde_yaml::from_str(text).unwrap());
    assert!(valid(GOOD));
    let wrong = [
        ("abbe: 1", "abbe: 2"),
        ("name:", "nmae:"),
        ("cnc:", "c.nc:"),
        ("step_mm", "step"),
        ("of: fit-2, ", ""),
        ("csv, path", "cvs, path"),
        ("of: fit-2", "of: [fit-2]"),
        ("file: machine.yaml", "file: 3"),
    ];
    for (old, new) in wrong {
        assert!(!valid(&GOOD.replacen(old, new, 1)), "{old} -> {new}");
    }
    let stages = &schema["properties"]["stages"]["additionalProperties"]["oneOf"];
    let names: Vec<&str> =
        registry().iter().zip(stages.as_array().unwrap()).map(|(_, stage)| stage["title"].as_str().unwrap()).collect();
    assert_eq!(names[..4], ["csv", "sql", "facets", "length"]);
}

/// Any text gives a recipe or an error of the right class with a place, never a panic.
fn survives(text: &str) -> Result<(), TestCaseError> {
    let path = Path::new("r.yaml");
    match Recipe::parse(path, text, &registry()) {
        Ok(recipe) => {
            let error = recipe.settings_error(&recipe.stages[0].name, SettingsError::new("a", "b"));
            prop_assert!(error.place.is_some());
        }
        Err(error) => {
            prop_assert_eq!(error.class, Class::Use);
            prop_assert!(error.place.is_some_and(|place| place.line.is_some()));
        }
    }
    let _ = Recipe::libraries(path, text);
    Ok(())
}

proptest! {
    #[test]
    fn random_text_is_survived(text in any::<String>(), yaml in "([a-c@]|[-:,{}\\[\\]&*!'\"#|>%?.~ \n\t]){0,60}") {
        survives(&text)?;
        survives(&yaml)?;
    }

    #[test]
    fn mutations_of_a_good_recipe_are_survived(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0..12_usize, any::<prop::sample::Index>(), 0..12_usize), 1..6)
    ) {
        // Without its file, so that mutations do not stop there.
        let mut text: Vec<char> = GOOD.replace("    file: machine.yaml\n", "").chars().collect();
        for (at, length, from, copied) in edits {
            let piece = |start: usize, length: usize, text: &[char]| start..(start + length).min(text.len());
            let copy = text[piece(from.index(text.len()), copied, &text)].to_vec();
            text.splice(piece(at.index(text.len()), length, &text), copy);
            if text.is_empty() {
                break;
            }
        }
        survives(&text.iter().collect::<String>())?;
    }
}
