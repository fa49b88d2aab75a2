//! The reference page of a plugin, made from its record.

use abbe_core::{EstimateSource, Kind, Plugin, ranges};
use serde_json::{Map, Value};

use crate::graph::references;

/// Maps within maps that are shown; a schema may refer to itself.
const DEEPEST: usize = 8;

/// The first line of every page. A file that begins otherwise is never replaced.
pub const PAGE_MARK: &str =
    "<!-- Made by `abbe plugins --pages` from the plugins' own records: changes here are lost. -->";

/// Longest line of a page.
const WIDTH: usize = 116;

/// The page of a plugin as Markdown: what it does, what its record says of it (when to use it, equation, source), its
/// settings with units and defaults as the schema has them, and the stage that its example makes.
pub fn page(plugin: &Plugin) -> String {
    let kind = plugin.kind();
    let mut page = format!("{PAGE_MARK}\n\n# `{kind}: {}`\n\n", plugin.name);
    page.push_str(&wrapped("", &format!("{}.", capital(&plugin.about))));
    if !plugin.reference.is_empty() {
        page.push_str(&format!("\n{}\n", plugin.reference.trim()));
    }
    page.push_str("\n## Settings\n");
    let schema = plugin.schema.get();
    let mut settings = String::new();
    list(schema, schema, 0, &mut settings);
    page.push_str(if settings.is_empty() { "None of its own.\n" } else { &settings });
    let mut more: Vec<String> = references(plugin).iter().map(|reference| format!("`{}`", reference.key)).collect();
    if kind == Kind::Estimate
        && matches!(plugin.estimate_source, EstimateSource::Measurements | EstimateSource::Combination)
    {
        more.extend(["`parameters`", "`shared_rows`"].map(str::to_owned));
        if plugin.estimate_source == EstimateSource::Measurements {
            more.extend(["`plausible`", "`tie`"].map(str::to_owned));
        }
    }
    more.extend(
        ["`uncertainty`", "`pooled`", "`id`", "`unseen`"]
            .iter()
            .filter(|_| kind == Kind::Artefact)
            .map(|key| (*key).into()),
    );
    more.extend(Some("`file`".to_owned()).filter(|_| kind == Kind::Model));
    if !more.is_empty() {
        let text =
            format!("The keys of all such stages are explained in [recipes.md](../recipes.md): {}.", more.join(", "));
        page.push_str(&format!("\n{}", wrapped("", &text)));
    }
    page.push_str(&format!("\n## Example\n```yaml\n{}```\n", example(plugin)));
    page
}

/// The file of the page among those of other plugins.
pub fn page_name(plugin: &Plugin) -> String {
    format!("{}-{}.md", plugin.kind(), plugin.name)
}

/// The page that lists those of some plugins, by kind.
pub fn index<'a>(plugins: impl Iterator<Item = &'a Plugin>) -> String {
    let mut text = format!(
        "{PAGE_MARK}\n\n# Plugins\nWhat each plugin does, when to use it, its equation, settings and source.\n"
    );
    let mut last = None;
    for plugin in plugins {
        if last != Some(plugin.kind()) {
            text.push_str(&format!("\n## {}\n", plugin.kind()));
            last = Some(plugin.kind());
        }
        text.push_str(&wrapped("  ", &format!("- [{}]({}): {}", plugin.name, page_name(plugin), plugin.about)));
    }
    text
}

/// The stage that the plugin's example makes, references left to be filled in.
fn example(plugin: &Plugin) -> String {
    let mut stage = Map::new();
    stage.insert(plugin.kind().key().to_owned(), Value::from(plugin.name.as_ref()));
    for reference in references(plugin).iter().filter(|reference| reference.required) {
        stage.insert(reference.key.to_owned(), Value::from("a-stage"));
    }
    if plugin.kind() == Kind::Estimate && plugin.estimate_source == EstimateSource::Measurements {
        stage.insert("parameters".to_owned(), Value::from(vec!["E*"]));
    }
    if let Value::Object(settings) = plugin.example.get() {
        stage.extend(settings.clone());
    }
    serde_yaml::to_string(&Value::Object([("my-stage".to_owned(), Value::Object(stage))].into_iter().collect()))
        .unwrap_or_default()
}

/// The properties of a map, one item each, with those of the maps in it below.
fn list(root: &Value, schema: &Value, depth: usize, out: &mut String) {
    if depth > DEEPEST {
        return;
    }
    let required: Vec<&str> = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    for (key, written) in schema["properties"].as_object().into_iter().flatten() {
        let property = plain(root, written);
        // Entries beside a reference belong to this setting.
        let beside = |key: &str| written.get(key).or(property.get(key));
        let mut traits = vec![kind_of(root, property, false, 0)];
        traits.extend(unit(key).map(str::to_owned));
        if required.contains(&key.as_str()) {
            traits.push("required".to_owned());
        } else if let Some(default) = beside("default").filter(|default| says_something(default)) {
            traits.push(format!("default `{}`", shown(default)));
        }
        item(out, depth, &format!("`{key}` ({})", traits.join(", ")), beside("description"));
        below(root, property, depth + 1, 0, out);
    }
}

/// The contents of a setting: its maps, also those in lists (`steps` levels so far), and its alternatives with descriptions.
fn below(root: &Value, schema: &Value, depth: usize, steps: usize, out: &mut String) {
    if depth.max(steps) > DEEPEST {
        return;
    }
    if schema["properties"].is_object() {
        return list(root, schema, depth, out);
    }
    for inner in ["items", "additionalProperties"] {
        if schema[inner].is_object() {
            return below(root, plain(root, &schema[inner]), depth, steps + 1, out);
        }
    }
    for alternative in alternatives(schema) {
        let alternative = plain(root, alternative);
        if let Some(constant) = alternative.get("const").filter(|_| alternative["description"].is_string()) {
            item(out, depth, &format!("`{}`", shown(constant)), alternative.get("description"));
        } else if alternative["properties"].is_object() {
            // A required setting identifies the map best.
            let what = match alternative["required"][0].as_str() {
                Some(key) => format!("a map with `{key}`"),
                None => "a map".to_owned(),
            };
            item(out, depth, &what, alternative.get("description"));
            list(root, alternative, depth + 1, out);
        } else if !alternatives(alternative).is_empty() {
            below(root, alternative, depth, steps + 1, out);
        }
    }
}

fn item(out: &mut String, depth: usize, what: &str, description: Option<&Value>) {
    let indent = "  ".repeat(depth);
    let description =
        description.and_then(Value::as_str).unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(" ");
    let text = match description.is_empty() {
        true => format!("{indent}- {what}"),
        false => format!("{indent}- {what}: {description}"),
    };
    out.push_str(&wrapped(&format!("{indent}  "), &text));
}

/// A schema with its reference resolved.
fn plain<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    if let Some(name) = schema["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/")) {
        return &root["$defs"][name];
    }
    schema
}

fn alternatives(schema: &Value) -> Vec<&Value> {
    let all = ["oneOf", "anyOf"].into_iter().filter_map(|key| schema[key].as_array()).flatten();
    all.filter(|alternative| alternative["type"] != "null").collect()
}

/// What may be written, in a few words; of several such things in the plural.
fn kind_of(root: &Value, schema: &Value, plural: bool, depth: usize) -> String {
    if depth > DEEPEST {
        return "...".to_owned();
    }
    if let Some(constant) = schema.get("const") {
        return format!("`{}`", shown(constant));
    }
    if let Some(listed) = schema["enum"].as_array() {
        return listed.iter().map(|value| format!("`{}`", shown(value))).collect::<Vec<_>>().join(" or ");
    }
    let alternatives = alternatives(schema);
    if !alternatives.is_empty() {
        let mut all: Vec<String> =
            alternatives.iter().map(|one| kind_of(root, plain(root, one), plural, depth + 1)).collect();
        all.dedup();
        return all.join(" or ");
    }
    let of = |inner: &str| kind_of(root, plain(root, &schema[inner]), true, depth + 1);
    let listed = schema["type"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let types: Vec<&str> = schema["type"].as_str().into_iter().chain(listed).filter(|kind| *kind != "null").collect();
    let words = types.into_iter().map(|kind| {
        let (one, rest) = match kind {
            "string" => ("text", String::new()),
            "number" => ("number", range(schema)),
            "integer" => ("whole number", range(schema)),
            "boolean" => return "true or false".to_owned(),
            "array" => ("list", of("items")),
            "object" if schema["additionalProperties"].is_object() => ("map", of("additionalProperties")),
            "object" => ("map", String::new()),
            other => return other.to_owned(),
        };
        let by_name = if kind == "object" && !rest.is_empty() { " by name" } else { "" };
        let rest = match kind {
            _ if rest.is_empty() => rest,
            "integer" | "number" => format!(" {rest}"),
            _ => format!(" of {rest}"),
        };
        format!("{one}{}{rest}{by_name}", if plural { "s" } else { "" })
    });
    words.collect::<Vec<_>>().join(" or ")
}

/// The range of a number. A label may be written as a number, and has none; a seed may be any.
fn range(schema: &Value) -> String {
    let stated = schema.as_object().filter(|schema| schema.get("format").is_none_or(|format| format != "uint64"));
    stated.and_then(ranges::range).unwrap_or_default()
}

/// The unit that the name of a setting ends with.
fn unit(key: &str) -> Option<&'static str> {
    const UNITS: [(&str, &str); 19] = [
        ("_mm_per_min", "mm/min"),
        ("_mm_per_s", "mm/s"),
        ("_um_per_m", "µm/m"),
        ("_per_K", "1/K"),
        ("_um2", "µm²"),
        ("_urad2", "µrad²"),
        ("_mm", "mm"),
        ("_um", "µm"),
        ("_nm", "nm"),
        ("_m", "m"),
        ("_deg", "deg"),
        ("_urad", "µrad"),
        ("_rad", "rad"),
        ("_degC", "°C"),
        ("_K", "K"),
        ("_N", "N"),
        ("_Hz", "Hz"),
        ("_min", "min"),
        ("_s", "s"),
    ];
    UNITS.iter().find(|(suffix, _)| key.ends_with(suffix)).map(|(_, unit)| *unit)
}

/// Whether a default says more than that nothing is there.
fn says_something(default: &Value) -> bool {
    match default {
        Value::Null => false,
        Value::Array(list) => !list.is_empty(),
        Value::Object(map) => !map.is_empty(),
        _ => true,
    }
}

fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Text in lines of [`WIDTH`]; further lines begin with `indent`.
fn wrapped(indent: &str, text: &str) -> String {
    let (first, text) = (text.len() - text.trim_start().len(), text.trim_start());
    let mut out = " ".repeat(first);
    let mut length = first;
    for (index, word) in text.split(' ').enumerate() {
        let size = word.chars().count();
        if index > 0 && length + 1 + size > WIDTH {
            out.push_str(&format!("\n{indent}"));
            length = indent.len();
        } else if index > 0 {
            out.push(' ');
            length += 1;
        }
        out.push_str(word);
        length += size;
    }
    out + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn settings_say_what_they_take() {
        let schema = json!({
            "type": "object",
            "required": ["nominal"],
            "properties": {
                "nominal": { "type": "string", "description": "File." },
                "standard_uncertainty_um": { "type": ["number", "null"], "default": 0.5, "description": "Of one\ntouch." },
                "rows": { "oneOf": [
                    { "const": "touches", "description": "One touch." }, { "const": "centres", "description": "Centres." },
                ], "default": "touches" },
                "degrees": { "type": "array", "items": { "type": "integer", "minimum": 0, "maximum": 9 } },
                "seed": { "type": "integer", "format": "uint64", "minimum": 0, "default": 1 },
                "distances": { "type": "array", "items": { "type": "object", "properties": {
                    "between": { "type": "array", "items": { "type": "string" } },
                } } },
            },
        });
        let mut found = String::new();
        list(&schema, &schema, 0, &mut found);
        let expected = "- `nominal` (text, required): File.\n\
                        - `standard_uncertainty_um` (number, µm, default `0.5`): Of one touch.\n\
                        - `rows` (`touches` or `centres`, default `touches`)\n  \
                          - `touches`: One touch.\n  - `centres`: Centres.\n\
                        - `degrees` (list of whole numbers from 0 to 9)\n\
                        - `seed` (whole number, default `1`)\n\
                        - `distances` (list of maps)\n  - `between` (list of texts)\n";
        assert_eq!(found, expected);
    }

    #[test]
    fn a_schema_that_holds_itself_comes_to_an_end() {
        let node = json!({ "type": "object", "properties": { "children": { "type": "array", "items": { "$ref": "#/$defs/node" } },
            "more": { "$ref": "#/$defs/list", "description": "Lists of lists." } } });
        let list_of_lists = json!({ "type": "array", "items": { "$ref": "#/$defs/list" } });
        let schema = json!({ "$defs": { "node": node, "list": list_of_lists }, "properties": { "tree": { "$ref": "#/$defs/node" } } });
        let mut found = String::new();
        list(&schema, &schema, 0, &mut found);
        assert!(found.starts_with("- `tree` (map)\n  - `children` (list of maps)\n"), "{found}");
        assert!(found.contains("Lists of lists.") && found.len() < 100_000, "{}", found.len());
    }

    #[test]
    fn lines_are_short() {
        let text = format!("- `a`: {}", "word ".repeat(60).trim());
        let lines: Vec<String> = wrapped("  ", &text).lines().map(str::to_owned).collect();
        assert!(lines.len() > 2 && lines.iter().all(|line| line.len() <= WIDTH) && lines[1].starts_with("  word"));
    }
}
