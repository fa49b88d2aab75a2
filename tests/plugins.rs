//! What every plugin promises, whoever wrote it, and the schema of recipes.

use std::path::PathBuf;

use abbe_core::{Build, Context, PathItem, SettingsError};
use serde_json::{Value, json};

use crate::support::{abbe, json_file, read, recipes, registry, root, temporary, tree, write};

#[test]
fn every_plugin_can_be_built_from_its_example() {
    let registry = registry();
    let context = Context { base: PathBuf::new() };
    let mut count = 0;
    for plugin in registry.iter() {
        let what = format!("{} {}", plugin.kind(), plugin.name);
        assert!(!plugin.about.is_empty() && !plugin.about.contains('\n'), "{what}: about: {:?}", plugin.about);
        assert!(!plugin.about.ends_with('.'), "{what}: a line of a list has no full stop");
        let headings: Vec<&str> = plugin.reference.lines().filter(|line| line.starts_with('#')).collect();
        let wanted = ["## When to use it", "## Equation", "## Notes", "## Source"];
        let without_notes = [wanted[0], wanted[1], wanted[3]];
        assert!(headings == wanted || headings == without_notes, "{what}: its reference has {headings:?}");
        let (schema, example) = (plugin.schema.get(), plugin.example.get());
        valid(&what, schema, example);
        let refuse = jsonschema::validator_for(schema).expect("a schema");
        assert!(!refuse.is_valid(&Value::from(1)), "{what}: the schema takes anything");
        let settings = example;
        let built = match &plugin.build {
            Build::Ingest(constructor) => constructor.build(settings, &context).map(drop),
            Build::Artefact(constructor) => constructor.build(settings, &context).map(drop),
            Build::Model(constructor) => constructor.build(settings, &context).map(drop),
            Build::Estimate(constructor) => constructor.build(settings, &context).map(drop),
            Build::Validate(constructor) => constructor.build(settings, &context).map(drop),
            Build::Export(constructor) => constructor.build(settings, &context).map(drop),
        };
        // A program without the libraries of a format says so (`--features parquet`).
        let is_built = |error: &SettingsError| !error.message.contains("was built without");
        assert!(built.as_ref().err().is_none_or(|error| !is_built(error)), "{what}: {:?}", built.err());
        count += 1;
    }
    assert!(count > 0, "no plugin is linked");
}

#[test]
fn every_plugin_refuses_a_setting_that_it_does_not_know() {
    let registry = registry();
    let context = Context { base: PathBuf::new() };
    for plugin in registry.iter() {
        let what = format!("{} {}", plugin.kind(), plugin.name);
        let mut settings = plugin.example.get().clone();
        settings["frobnicate"] = Value::from(1);
        assert!(!jsonschema::is_valid(plugin.schema.get(), &settings), "{what}: its schema allows it");
        let refused = match &plugin.build {
            Build::Ingest(constructor) => constructor.build(&settings, &context).err(),
            Build::Artefact(constructor) => constructor.build(&settings, &context).err(),
            Build::Model(constructor) => constructor.build(&settings, &context).err(),
            Build::Estimate(constructor) => constructor.build(&settings, &context).err(),
            Build::Validate(constructor) => constructor.build(&settings, &context).err(),
            Build::Export(constructor) => constructor.build(&settings, &context).err(),
        };
        let refused = refused.unwrap_or_else(|| panic!("{what} takes it"));
        assert!(refused.key && refused.to_string().contains("`frobnicate`"), "{what}: {refused}");
    }
}

#[test]
fn plugins_are_listed() {
    let printed = abbe(&root(), &["plugins"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    insta::assert_snapshot!("plugins", printed.stdout);

    let printed = abbe(&root(), &["plugins", "--json"]);
    let listed: Vec<Value> = serde_json::from_str(&printed.stdout).expect("JSON");
    let names: Vec<String> = listed.iter().map(|one| format!("{} {}", one["kind"], one["name"])).collect();
    let registered: Vec<String> =
        registry().iter().map(|plugin| format!("\"{}\" \"{}\"", plugin.kind(), plugin.name)).collect();
    assert_eq!(names, registered);
    for one in &listed {
        valid(&one["name"].to_string(), &one["schema"], &one["example"]);
    }
}

#[test]
fn the_schema_of_recipes_is_up_to_date_and_takes_every_recipe() {
    let printed = abbe(&root(), &["schema"]);
    assert_eq!((printed.status, printed.stderr.as_str()), (0, ""));
    let kept = root().join("docs/schemas/recipe.schema.json");
    assert!(printed.stdout == read(&kept), "docs/schemas/recipe.schema.json is old: run `cargo xtask schema`");
    let schema = json_file(&kept);
    for (name, file) in recipes() {
        let recipe: Value = serde_yaml::from_str(&read(&file)).expect("the recipe is YAML");
        valid(&name, &schema, &recipe);
    }
    let wrong = [
        r#"{ "abbe": 2, "stages": { "a": { "ingest": "csv", "path": "a.csv" } } }"#,
        r#"{ "abbe": 1, "stages": { "a": { "ingest": "cvs", "path": "a.csv" } } }"#,
        r#"{ "abbe": 1, "stages": { "a": { "ingest": "csv", "paht": "a.csv" } } }"#,
        r#"{ "abbe": 1, "stages": { "a": { "artefact": "length", "standard_uncertainty_um": 1 } } }"#,
        r#"{ "abbe": 1, "stage": {} }"#,
    ];
    for wrong in wrong {
        let recipe = serde_json::from_str(wrong).expect("JSON");
        assert!(!jsonschema::is_valid(&schema, &recipe), "the schema takes {wrong}");
    }
}

/// Asserts that a schema is one, and that it takes an instance.
pub fn valid(what: &str, schema: &Value, instance: &Value) {
    jsonschema::meta::validate(schema).unwrap_or_else(|error| panic!("{what}: no JSON Schema: {error}"));
    let validator = jsonschema::validator_for(schema).unwrap_or_else(|error| panic!("{what}: {error}"));
    let errors: Vec<String> =
        validator.iter_errors(instance).map(|error| format!("{}: {error}", error.instance_path())).collect();
    assert!(errors.is_empty(), "{what}: {errors:#?}");
}

/// The JSON pointers to the numbers in a value.
pub fn numbers(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(at.to_owned()),
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(index, item)| numbers(item, &format!("{at}/{index}"), found));
        }
        Value::Object(map) => map.iter().for_each(|(key, item)| numbers(item, &format!("{at}/{key}"), found)),
        _ => {}
    }
}

#[test]
fn every_limit_has_a_rule_of_decision() {
    let registry = registry();
    let context = Context { base: PathBuf::new() };
    let mut elsewhere = Vec::new();
    for plugin in registry.iter() {
        let Build::Validate(constructor) = &plugin.build else { continue };
        let (schema, example) = (plugin.schema.get(), plugin.example.get());
        let mut places = Vec::new();
        numbers(example, "", &mut places);
        for place in places {
            let what = format!("{} {place}", plugin.name);
            let with = |decision: Value| {
                let mut settings = example.clone();
                let number = settings.pointer_mut(&place).expect("it is there");
                *number = json!({ "limit": number, "decision": decision });
                let built = constructor.build(&settings, &context).map(drop);
                (built, jsonschema::is_valid(schema, &settings))
            };
            let (built, taken) = with(json!("simple"));
            assert_eq!(built.is_ok(), taken, "{what}: code and schema differ");
            if built.is_err() {
                assert!(!place.starts_with("/limits/"), "{what}: {built:?}");
                continue;
            }
            if !place.starts_with("/limits/") {
                elsewhere.push(what.clone());
            }
            assert_eq!(with(json!({ "rule": "simple" })), (Ok(()), true), "{what}");
            for wrong in [json!("simpl"), json!({ "rule": "simpl" }), json!({ "rule": "simple", "w": 1 })] {
                let (refused, taken) = with(wrong.clone());
                let refused = refused.expect_err("a wrong rule");
                assert!(!taken && refused.path.contains(&PathItem::Key("decision".to_owned())), "{what}: {refused}");
                let near = refused.help.is_some_and(|help| help == "did you mean `simple`?");
                assert!(near || wrong.get("w").is_some(), "{what}: {wrong}");
            }
        }
    }
    assert_eq!(
        elsewhere,
        [
            "cmm-lengths /repeatability_um",
            "thermal /prediction/limits/max_um",
            "thermal /prediction/limits/rms_K",
            "thermal /drift/limits/range_um",
            "trend /changes",
            "uncertainty /parameters/0/expanded_urad",
            "uncertainty /parameters/1/standard_uncertainty_um_per_m",
            "uncertainty /volumetric/expanded_um",
            "verify /tolerance_um",
            "verify-cut /tolerance_um",
        ]
    );
}

#[test]
fn the_pages_of_plugins_are_up_to_date() {
    let folder = temporary();
    let printed = abbe(&root(), &["plugins", "--pages", &folder.path().to_string_lossy()]);
    assert_eq!(printed.status, 0, "{}", printed.stderr);
    let kept = root().join("docs/plugins");
    let names = |folder: &std::path::Path| tree(folder).into_iter().collect::<Vec<_>>();
    assert_eq!(
        names(folder.path()),
        names(&kept),
        "run `cargo xtask schema`, and remove pages of plugins that are gone"
    );
    for name in names(&kept) {
        let (made, kept) = (read(&folder.path().join(&name)), read(&kept.join(&name)));
        assert!(made == kept, "docs/plugins/{} is out of date: run `cargo xtask schema`", name.display());
        let long = kept.lines().find(|line| line.chars().count() > 120);
        assert_eq!(long, None, "{}", name.display());
    }
}

/// Tables have their rows in one line each.
#[test]
fn lines_of_pages_are_short() {
    let pages = |folder: &str| {
        let folder = root().join(folder);
        let all = tree(&folder).into_iter().map(|file| folder.join(file));
        all.filter(|file| file.extension().is_some_and(|ending| ending == "md")).collect::<Vec<_>>()
    };
    let at_root = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|name| root().join(name));
    let pages = ["docs", "crates", "plugins"].into_iter().flat_map(pages).chain(at_root);
    for page in pages {
        let is_long = |line: &&str| line.chars().count() > 120 && !line.starts_with('|');
        assert_eq!(read(&page).lines().find(is_long), None, "{}", page.display());
    }
}

#[test]
fn a_file_that_is_no_page_is_never_replaced() {
    let folder = temporary();
    write(&folder.path().join("README.md"), "# My own notes\n");
    let printed = abbe(&root(), &["plugins", "--pages", &folder.path().to_string_lossy()]);
    assert_eq!(printed.status, 2, "{}", printed.stdout);
    assert!(printed.stderr.contains("README.md is there and is no page of a plugin"), "{}", printed.stderr);
    assert_eq!(tree(folder.path()).len(), 1);
    assert_eq!(read(&folder.path().join("README.md")), "# My own notes\n");
}
