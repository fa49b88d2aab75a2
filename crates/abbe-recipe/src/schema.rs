//! The JSON Schema of recipes, for editors.

use abbe_core::{EstimateSource, Kind, Plugin, Registry};
use abbe_estimation::{Plausible, RowSettings};
use abbe_planning::Planning;
use serde_json::{Map, Value, json};

use crate::graph::{ANALYSED, references};

/// The JSON Schema (2020-12) of the recipes that the plugins of the registry can run.
pub fn schema(registry: &Registry) -> Value {
    let stages: Vec<Value> = registry.iter().map(stage).collect();
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Recipe of Abbe",
        "type": "object",
        "properties": {
            "abbe": { "const": crate::VERSION, "description": "Version of the recipe's format" },
            "name": { "type": "string", "description": "Title for people" },
            "sets": {
                "description": "Named sets of parameter patterns; \"@S1\" includes the set S1",
                "type": "object",
                "additionalProperties": { "type": "array", "items": { "type": "string" } },
            },
            "plugins": {
                "description": "Libraries with more plugins",
                "type": "array",
                "items": {
                    "type": "object",
                    "properties": {
                        "path": { "type": "string", "description": "The library" },
                        "sha256": { "type": "string", "pattern": "^[0-9A-Fa-f]{64}$", "description": "SHA-256 of its file; a file with another hash is not loaded" },
                        "isolate": { "type": "boolean", "description": "Its plugins run in separate processes" },
                        "memory_limit_mib": { "type": "integer", "minimum": 64, "maximum": 1048576, "description": "Memory of the process of an isolated plugin" },
                        "time_limit_s": { "type": "number", "exclusiveMinimum": 0, "maximum": 86400, "description": "How long an isolated plugin may work without an answer or a question" },
                        "total_time_limit_s": { "type": "number", "exclusiveMinimum": 0, "maximum": 86400, "description": "How long a stage of an isolated plugin may work altogether" },
                    },
                    "required": ["path"],
                    "additionalProperties": false,
                },
            },
            "stages": {
                "type": "object",
                "minProperties": 1,
                "propertyNames": { "pattern": "^[\\p{L}\\p{N}_-]+$" },
                "additionalProperties": { "oneOf": stages },
            },
            "plan": plan(),
            "history": { "type": "string", "minLength": 1, "description": "The history to which every run adds what it finds: a file, or `postgres://USER@HOST/DATABASE` without a password" },
        },
        "required": ["abbe", "stages"],
        "additionalProperties": false,
    })
}

/// The schema of what stands under `plan`.
fn plan() -> Value {
    let mut plan = abbe_core::schema_of::<Planning>();
    if let Some(plan) = plan.as_object_mut() {
        plan.shift_remove("$schema");
        // References such as `#/$defs/X` start from the nearest identifier.
        plan.insert("$id".to_owned(), json!("urn:abbe:plan"));
    }
    plan
}

/// The plugin's own schema of its settings, with the keys that the recipe adds to them.
fn stage(plugin: &Plugin) -> Value {
    let kind = plugin.kind();
    let mut settings = match plugin.schema.get() {
        Value::Object(settings) => settings.clone(),
        _ => Map::new(), // `true`: whatever the plugin takes
    };
    let mut properties = Map::new();
    properties.insert(kind.key().to_owned(), json!({ "const": plugin.name, "description": plugin.about }));
    let mut required = vec![json!(kind.key())];
    for reference in references(plugin) {
        let list = json!({ "type": "array", "items": { "type": "string" }, "uniqueItems": true });
        let one = json!({ "type": "string" });
        let name = if reference.many { json!({ "oneOf": [one, list] }) } else { one };
        properties.insert(reference.key.to_owned(), name);
        if reference.required && (kind != Kind::Estimate || plugin.estimate_source != EstimateSource::Measurements) {
            required.push(json!(reference.key));
        }
    }
    if kind == Kind::Artefact
        && let Value::Object(common) = abbe_core::schema_of::<RowSettings>()
        && let Some(Value::Object(common)) = common.get("properties")
    {
        properties.extend(common.clone());
    }
    if kind == Kind::Estimate
        && matches!(plugin.estimate_source, EstimateSource::Measurements | EstimateSource::Combination)
    {
        let description = "What is estimated: names, patterns with ? and *, sets as \"@S1\"";
        let patterns =
            json!({ "type": "array", "items": { "type": "string" }, "minItems": 1, "description": description });
        properties.insert("parameters".to_owned(), patterns);
        let description = "`accepted`: rows from which the known values were estimated may be used again";
        let accepted = json!({ "const": crate::ACCEPTED, "description": description });
        properties.insert(crate::SHARED_ROWS.to_owned(), accepted);
    }
    if kind == Kind::Estimate && plugin.estimate_source == EstimateSource::Measurements {
        let mut plausible = abbe_core::schema_of::<Plausible>();
        if let Some(plausible) = plausible.as_object_mut() {
            plausible.shift_remove("$schema");
        }
        properties.insert(crate::PLAUSIBLE.to_owned(), plausible);
        properties.insert(crate::TIE.to_owned(), tie());
        let description = "An estimate for every group of rows: those of one `week` or `day`, of one label in another column, or of one `file`";
        properties
            .insert(crate::PER.to_owned(), json!({ "type": "string", "minLength": 1, "description": description }));
        // An estimate of its own, or the analysis of another one.
        let own = json!({ "required": ["machine", "observations", "parameters"] });
        settings.insert("anyOf".to_owned(), json!([own, { "required": [ANALYSED] }]));
    }
    if kind == Kind::Model {
        let description = "YAML file with settings; those of the stage itself replace them";
        properties.insert("file".to_owned(), json!({ "type": "string", "description": description }));
    } else if let Some(Value::Array(own)) = settings.get("required") {
        required.extend(own.iter().cloned()); // those of a model may stand in its file
    }
    if let Some(Value::Object(own)) = settings.remove("properties") {
        properties.extend(own.into_iter().filter(|(key, _)| !properties.contains_key(key)).collect::<Vec<_>>());
    }
    settings.shift_remove("$schema");
    if settings.contains_key("$defs") {
        // References such as `#/$defs/X` start from the nearest identifier.
        settings.insert("$id".to_owned(), json!(format!("urn:abbe:{kind}:{}", plugin.name)));
    }
    settings.insert("title".to_owned(), json!(plugin.name));
    settings.insert("description".to_owned(), json!(plugin.about));
    settings.insert("type".to_owned(), json!("object"));
    settings.insert("properties".to_owned(), Value::Object(properties));
    settings.insert("required".to_owned(), Value::Array(required));
    Value::Object(settings)
}

/// Parameters that are one unknown.
fn tie() -> Value {
    json!({
        "type": "object",
        "description": "Parameters of the machine that are one unknown, each times a factor: names or patterns, and the unknown",
        "additionalProperties": { "anyOf": [
            { "type": "string" },
            {
                "type": "object",
                "properties": { "to": { "type": "string" }, "factor": { "type": "number" } },
                "required": ["to"],
                "additionalProperties": false
            }
        ] }
    })
}
