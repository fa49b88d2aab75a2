//! What every plugin promises, whoever wrote it, and the schema of recipes.

use std::path::PathBuf;

use abbe_core::{Build, Context};
use serde_json::Value;

use crate::support::{abbe, json_file, read, recipes, registry, root};

#[test]
fn every_plugin_can_be_built_from_its_example() {
    let registry = registry();
    let context = Context { base: PathBuf::new() };
    let mut count = 0;
    for plugin in registry.iter() {
        let what = format!("{} {}", plugin.kind(), plugin.name);
        assert!(!plugin.about.is_empty() && !plugin.about.contains('\n'), "{what}: about: {:?}", plugin.about);
        assert!(!plugin.about.ends_with('.'), "{what}: a line of a list has no full stop");
        let (schema, example) = (plugin.schema.get(), plugin.example.get());
        valid(&what, &schema, &example);
        let refuse = jsonschema::validator_for(&schema).expect("a schema");
        assert!(!refuse.is_valid(&Value::from(1)), "{what}: the schema takes anything");
        let settings = &example;
        let built = match &plugin.build {
            Build::Ingest(constructor) => constructor.build(settings, &context).map(drop),
            Build::Artefact(constructor) => constructor.build(settings, &context).map(drop),
            Build::Model(constructor) => constructor.build(settings, &context).map(drop),
            Build::Estimate(constructor) => constructor.build(settings, &context).map(drop),
            Build::Validate(constructor) => constructor.build(settings, &context).map(drop),
            Build::Export(constructor) => constructor.build(settings, &context).map(drop),
        };
        assert!(built.is_ok(), "{what}: {:?}", built.err());
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
        let mut settings = plugin.example.get();
        settings["frobnicate"] = Value::from(1);
        assert!(!jsonschema::is_valid(&plugin.schema.get(), &settings), "{what}: its schema allows it");
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
