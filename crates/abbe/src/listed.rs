//! The plugins, listed for people and for machines.

use abbe_core::{Origin, Registry};
use serde_json::{Value, json};

use crate::table;

fn origin(origin: &Origin) -> String {
    match origin {
        Origin::BuiltIn => "built-in".to_owned(),
        Origin::Library { file, sha256 } => format!("{} ({sha256})", file.display()),
    }
}

/// A table of all plugins.
pub fn plugins_text(registry: &Registry) -> String {
    let mut rows = vec![["kind", "name", "version", "origin", "what it does"].map(str::to_owned).to_vec()];
    rows.extend(registry.iter().map(|plugin| {
        let (name, version) = (plugin.name.to_string(), plugin.version.to_string());
        vec![plugin.kind().to_string(), name, version, origin(&plugin.origin), plugin.about.to_string()]
    }));
    table::text(&rows, &[])
}

/// All plugins with the schemas and examples of their settings.
pub fn plugins_json(registry: &Registry) -> Value {
    let plugins = registry.iter().map(|plugin| {
        json!({
            "kind": plugin.kind().key(),
            "name": plugin.name,
            "version": plugin.version,
            "origin": origin(&plugin.origin),
            "about": plugin.about,
            "schema": plugin.schema.get(),
            "example": plugin.example.get(),
        })
    });
    Value::Array(plugins.collect())
}
