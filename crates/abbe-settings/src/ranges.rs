//! Ranges of numbers: every number in settings has one, in the schema of the settings, and one check keeps all of them.
//!
//! A range that a setting does not state itself follows from the unit in its name. These ranges are wide: beyond them a number is a
//! mistake of units or of typing, whatever the machine.

use std::borrow::Cow;
use std::ops::RangeInclusive;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde_json::{Map, Value, json};

use crate::settings::{PathItem, SettingsError};
use crate::unit::Quantity;

/// Temperatures that are read, °C: no machine is measured at others, and 293 is in kelvin.
pub const TEMPERATURES: RangeInclusive<f64> = -100.0..=200.0;

/// Temperatures of rooms and of machines at rest, °C, whose numbers in °F are none: 50 to 120 °F.
pub const AT_REST: RangeInclusive<f64> = 10.0..=49.0;

/// Largest size of a number, by the end of its name.
const LARGEST: [(&str, f64); 29] = [
    ("_um_per_m_K", 1e4),
    ("_um_per_mm", 1e6),
    ("_um_per_m", 1e6),
    ("_um_per_s", 1e6),
    ("_mm_per_min", 1e6),
    ("_mm_per_s", 1e5),
    ("_per_K", 1.0),
    ("_um2", 1e12),
    ("_urad2", 1e13),
    ("_percent", 1e4),
    ("_mdeg", 1e6),
    ("_mrad", 1e4),
    ("_urad", 1e7),
    ("_rad", 1e5),
    ("_deg", 1e6),
    ("_rpm", 1e6),
    ("_degC", 2e3),
    ("_nm", 1e9),
    ("_mm", 1e6),
    ("_um", 1e6),
    ("_m", 1e2),
    ("_Hz", 1e9),
    ("_min", 1e8),
    ("_N", 1e7),
    ("_K", 2e3),
    ("_s", 1e10),
    ("probability", 1.0),
    ("significance", 1.0),
    ("factor", 1e6),
];

/// Largest size of any other number.
const LARGEST_OF_ANY: f64 = 1e9;

/// Names of numbers that are not negative, by a part of them.
const NOT_NEGATIVE: [&str; 8] = [
    "uncertainty",
    "standard_u",
    "diameter",
    "tolerance",
    "wavelength",
    "probability",
    "significance",
    "stylus_radius",
];

/// Smallest standard uncertainties and tolerances that can be meant, but for none at all, by the end of the name. Of a length this is a
/// picometre: one that is smaller would let its row alone decide everything.
const SMALLEST: [(&str, f64); 6] =
    [("_um_per_m", 1e-6), ("_per_K", 1e-12), ("_urad", 1e-3), ("_um", 1e-6), ("_K", 1e-9), ("uncertainty", 1e-30)];

/// A number above zero, for the schema of a setting: `#[schemars(with = "AboveZero")]`. A standard uncertainty is then as large as one
/// can be at least, so that no message offers a 0 which is refused.
pub enum AboveZero {}

impl JsonSchema for AboveZero {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "AboveZero".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "number", "exclusiveMinimum": 0 })
    }
}

/// Whether a name says of which kind its number is. `mm` and `mrad` are names, too.
fn largest(name: &str) -> Option<f64> {
    LARGEST.iter().find(|(end, _)| name.ends_with(end) || name == end.trim_start_matches('_')).map(|(_, most)| *most)
}

fn smallest(name: &str) -> Option<f64> {
    let is_one = ["uncertainty", "tolerance"].iter().any(|part| name.contains(part));
    let is_one = is_one || name.starts_with("standard_u") || name.starts_with("directions_u");
    SMALLEST.iter().find(|(end, _)| is_one && name.ends_with(end)).map(|(_, least)| *least)
}

/// Gives a range to every number of a schema that states none.
pub fn complete(schema: &mut Value) {
    complete_named(schema, "");
}

fn complete_named(schema: &mut Value, name: &str) {
    let Value::Object(schema) = schema else { return };
    if is_number(schema) {
        add_range(schema, name);
    }
    for (key, inner) in schema.iter_mut() {
        match (key.as_str(), inner) {
            ("properties" | "$defs", Value::Object(named)) => {
                for (key, inner) in named {
                    // What stands in a map is in the unit of the map, unless it says another.
                    let own = if largest(key).is_none() && largest(name).is_some() { name } else { key };
                    let own = own.to_owned();
                    complete_named(inner, &own);
                }
            }
            ("items" | "additionalProperties", inner) => complete_named(inner, name),
            ("anyOf" | "oneOf" | "allOf" | "prefixItems", Value::Array(all)) => {
                all.iter_mut().for_each(|inner| complete_named(inner, name));
            }
            _ => {}
        }
    }
}

fn types(schema: &Map<String, Value>) -> impl Iterator<Item = &str> {
    let one = schema.get("type").into_iter();
    one.flat_map(|types| types.as_array().map_or(std::slice::from_ref(types), Vec::as_slice)).filter_map(Value::as_str)
}

/// Whether it stands for numbers. A label may be written as a number, and is none.
fn is_number(schema: &Map<String, Value>) -> bool {
    types(schema).any(|kind| kind == "number" || kind == "integer") && types(schema).all(|kind| kind != "string")
}

fn add_range(schema: &mut Map<String, Value>, name: &str) {
    let has = |key: &str, other: &str| schema.contains_key(key) || schema.contains_key(other);
    let (has_least, has_most) = (has("minimum", "exclusiveMinimum"), has("maximum", "exclusiveMaximum"));
    let is_whole = types(schema).any(|kind| kind == "integer");
    if is_whole {
        let of_any = LARGEST_OF_ANY as u64;
        let most = if schema.get("format") == Some(&json!("uint64")) { u64::MAX } else { of_any };
        let mut set = |has: bool, key: &str, value: Value| (!has).then(|| schema.insert(key.to_owned(), value));
        set(has_least, "minimum", json!(-(of_any as i64)));
        set(has_most, "maximum", json!(most));
        return;
    }
    let most = largest(name).unwrap_or(LARGEST_OF_ANY);
    let least = match NOT_NEGATIVE.iter().any(|part| name.contains(part)) {
        true => 0.0,
        false if name.ends_with("_degC") => -273.15,
        false => -most,
    };
    let is_above_zero = bound(schema, "exclusiveMinimum") == Some(0.0);
    let mut set = |has: bool, key: &str, value: Value| (!has).then(|| schema.insert(key.to_owned(), value));
    set(has_least, "minimum", shortest(least));
    set(has_most, "maximum", shortest(most));
    match smallest(name) {
        Some(least) if is_above_zero => {
            schema.remove("exclusiveMinimum");
            schema.insert("minimum".to_owned(), json!(least));
        }
        Some(least) => drop(set(false, "not", json!({ "exclusiveMinimum": 0, "exclusiveMaximum": least }))),
        None => {}
    }
}

/// A whole number as such.
fn shortest(value: f64) -> Value {
    if value.fract() == 0.0 { json!(value as i64) } else { json!(value) }
}

/// Refuses a number that is outside the range that its schema states. Anything else that is wrong with settings is for those who
/// read them.
pub fn check(schema: &Value, settings: &Value) -> Result<(), SettingsError> {
    Check { root: schema }.value(&[schema], settings, &mut Vec::new())
}

struct Check<'a> {
    root: &'a Value,
}

impl<'a> Check<'a> {
    /// A schema and what it stands for: its reference and its alternatives.
    fn alternatives(&self, schema: &'a Value, found: &mut Vec<&'a Map<String, Value>>, depth: usize) {
        const DEEPEST: usize = 32;
        let Some(map) = schema.as_object().filter(|_| depth < DEEPEST) else { return };
        found.push(map);
        if let Some(name) = map.get("$ref").and_then(Value::as_str).and_then(|path| path.strip_prefix("#/$defs/")) {
            self.alternatives(&self.root["$defs"][name], found, depth + 1);
        }
        for key in ["anyOf", "oneOf", "allOf"] {
            for inner in map.get(key).and_then(Value::as_array).into_iter().flatten() {
                self.alternatives(inner, found, depth + 1);
            }
        }
    }

    fn value(&self, schemas: &[&'a Value], value: &Value, path: &mut Vec<PathItem>) -> Result<(), SettingsError> {
        let mut all = Vec::new();
        schemas.iter().for_each(|schema| self.alternatives(schema, &mut all, 0));
        match value {
            Value::Number(number) => {
                // A label may be any number; a number has to be in the range of one that it can be.
                if all.iter().any(|schema| types(schema).any(|kind| kind == "string")) {
                    return Ok(());
                }
                let ranges: Vec<&&Map<String, Value>> = all.iter().filter(|schema| is_number(schema)).collect();
                let number = number.as_f64().unwrap_or(f64::NAN);
                match ranges.first() {
                    Some(range) if !ranges.iter().any(|range| takes(range, number)) => {
                        Err(refused(number, range, path).under(path.iter().cloned()))
                    }
                    _ => Ok(()),
                }
            }
            Value::Array(items) => {
                for (index, item) in items.iter().enumerate() {
                    let place = |schema: &&'a Map<String, Value>| {
                        schema.get("prefixItems").and_then(|all| all.get(index)).or_else(|| schema.get("items"))
                    };
                    let inner: Vec<&Value> = all.iter().filter_map(place).collect();
                    self.inside(&inner, item, PathItem::Index(index), path)?;
                }
                Ok(())
            }
            Value::Object(settings) => {
                // Of several maps those that are meant, by the settings that they need.
                let fits = |schema: &&&'a Map<String, Value>| {
                    let needs = schema.get("required").and_then(Value::as_array).into_iter().flatten();
                    needs.filter_map(Value::as_str).all(|key| {
                        let constant = schema.get("properties").and_then(|all| all.get(key)?.get("const"));
                        settings.get(key).is_some_and(|given| constant.is_none_or(|constant| constant == given))
                    })
                };
                let fitting: Vec<&Map<String, Value>> = all.iter().filter(fits).copied().collect();
                for (key, item) in settings {
                    let of = |schema: &&'a Map<String, Value>| {
                        schema
                            .get("properties")
                            .and_then(|all| all.get(key))
                            .or_else(|| schema.get("additionalProperties"))
                    };
                    let mut inner: Vec<&Value> = fitting.iter().filter_map(of).collect();
                    if inner.is_empty() {
                        inner = all.iter().filter_map(of).collect();
                    }
                    self.inside(&inner, item, PathItem::Key(key.clone()), path)?;
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn inside(
        &self,
        schemas: &[&'a Value],
        value: &Value,
        item: PathItem,
        path: &mut Vec<PathItem>,
    ) -> Result<(), SettingsError> {
        path.push(item);
        self.value(schemas, value, path)?;
        path.pop();
        Ok(())
    }
}

/// A bound of a schema.
fn bound(schema: &Map<String, Value>, key: &str) -> Option<f64> {
    schema.get(key).and_then(Value::as_f64)
}

fn takes(schema: &Map<String, Value>, number: f64) -> bool {
    let is_between = |schema: &Map<String, Value>| {
        bound(schema, "minimum").is_none_or(|least| number >= least)
            && bound(schema, "exclusiveMinimum").is_none_or(|least| number > least)
            && bound(schema, "maximum").is_none_or(|most| number <= most)
            && bound(schema, "exclusiveMaximum").is_none_or(|most| number < most)
    };
    let is_refused = schema.get("not").and_then(Value::as_object).is_some_and(is_between);
    is_between(schema) && !is_refused
}

/// The range in words: from -100000 to 100000.
pub fn range(schema: &Map<String, Value>) -> Option<String> {
    let is_whole = types(schema).any(|kind| kind == "integer");
    let of = |value: &Value| {
        let number = value.as_f64().unwrap_or(f64::NAN);
        if is_whole {
            value.to_string()
        } else if number != 0.0 && !(1e-3..1e6).contains(&number.abs()) {
            format!("{number:e}")
        } else {
            format!("{number}")
        }
    };
    let from = schema.get("minimum").map(|least| format!("from {}", of(least)));
    let from = from.or_else(|| schema.get("exclusiveMinimum").map(|least| format!("above {}", of(least))))?;
    let to = schema.get("maximum").map(|most| format!("to {}", of(most)));
    let to = to.or_else(|| schema.get("exclusiveMaximum").map(|most| format!("and below {}", of(most))))?;
    let smallest = schema.get("not").and_then(|not| not.get("exclusiveMaximum")).map(of);
    let smallest = smallest.map_or_else(String::new, |least| format!(", 0 or at least {least}"));
    Some(format!("{from} {to}{smallest}"))
}

/// The unit in the name of the innermost setting of a path that has one.
fn unit(path: &[PathItem]) -> Option<&str> {
    path.iter().rev().find_map(|item| {
        let PathItem::Key(key) = item else { return None };
        let (name, ..) = Quantity::of_column(key);
        key.strip_prefix(name).map(|suffix| suffix.trim_start_matches('_')).filter(|suffix| !suffix.is_empty())
    })
}

/// A number as it is shown, without hundreds of zeros.
pub(crate) fn shown(number: f64) -> String {
    match number != 0.0 && number.is_finite() && !(1e-6..1e12).contains(&number.abs()) {
        true => format!("{number:e}"),
        false => format!("{number}"),
    }
}

fn refused(number: f64, schema: &Map<String, Value>, path: &[PathItem]) -> SettingsError {
    let number = shown(number);
    let what = if types(schema).any(|kind| kind == "integer") { "a whole number" } else { "a number" };
    let range = range(schema).unwrap_or_default();
    let comma = if range.contains(',') { "," } else { "" };
    let help = match unit(path) {
        Some(unit) => format!("is it in the unit of its name, {unit}?"),
        None => "write a number in this range, or leave the setting out if it is optional".to_owned(),
    };
    SettingsError::new("", format!("{number}: {what} {range}{comma} was expected")).help(help)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schema_of;
    use schemars::JsonSchema;
    use std::collections::BTreeMap;

    #[derive(JsonSchema)]
    #[allow(dead_code, reason = "only its schema is looked at")]
    struct Example {
        tip_mm: [f64; 3],
        label: crate::Label,
        standard_uncertainty_um: Option<f64>,
        #[schemars(with = "Option<AboveZero>")]
        reading_standard_uncertainty_um: Option<f64>,
        #[schemars(with = "Vec<AboveZero>")]
        steps_mm: Vec<f64>,
        standard_um: BTreeMap<String, f64>,
        lengths_mm: crate::Series,
        #[schemars(range(min = 2, max = 9))]
        count: usize,
        seed: u64,
        inner: Vec<Inner>,
    }

    #[derive(JsonSchema)]
    #[serde(tag = "kind", rename_all = "kebab-case")]
    #[allow(dead_code, reason = "only its schema is looked at")]
    enum Inner {
        Warm { limit_rpm: f64 },
        Long { limit_mm: f64, share: f64 },
    }

    #[test]
    fn every_number_has_a_range_and_keeps_it() {
        let schema = schema_of::<Example>();
        for good in [
            json!({ "tip_mm": [0, -1e5, 1e5], "label": 1e300, "standard_uncertainty_um": 0, "count": 9 }),
            json!({ "seed": u64::MAX, "standard_um": { "a": 1e-6 }, "lengths_mm": { "from": 1, "to": 2, "step": 1 } }),
            json!({ "inner": [{ "kind": "long", "limit_mm": 1e5 }, { "kind": "warm", "limit_rpm": 1e6 }] }),
            json!({ "standard_uncertainty_um": null, "tip_mm": "text", "unknown": 1e300 }),
        ] {
            assert_eq!(check(&schema, &good), Ok(()), "{good}");
        }
        for (wrong, expected) in [
            (json!({ "tip_mm": [0, 1e7] }), "tip_mm[1]: 10000000: a number from -1e6 to 1e6 was expected"),
            (
                json!({ "standard_uncertainty_um": 1e-300 }),
                "standard_uncertainty_um: 1e-300: a number from 0 to 1e6, 0 or at least 1e-6, was expected",
            ),
            (
                json!({ "reading_standard_uncertainty_um": 0 }),
                "reading_standard_uncertainty_um: 0: a number from 1e-6 to 1e6 was expected",
            ),
            (json!({ "steps_mm": [1, 0] }), "steps_mm[1]: 0: a number above 0 to 1e6 was expected"),
            (json!({ "standard_uncertainty_um": -1 }), "standard_uncertainty_um: -1: a number from 0 to 1e6, 0 or"),
            (json!({ "standard_um": { "a": 1e-10 } }), "standard_um.a: 1e-10: a number from 0"),
            (json!({ "lengths_mm": [1, 1e9] }), "lengths_mm[1]: 1000000000: a number from -1e6 to 1e6"),
            (json!({ "lengths_mm": { "step": 1e9 } }), "lengths_mm.step: 1000000000: a number from -1e6 to 1e6"),
            (json!({ "count": 10 }), "count: 10: a whole number from 2 to 9 was expected"),
            (
                json!({ "inner": [{ "kind": "warm", "limit_rpm": 1e7 }] }),
                "inner[0].limit_rpm: 10000000: a number from -1e6",
            ),
            (
                json!({ "inner": [{ "kind": "long", "share": 1e12 }] }),
                "inner[0].share: 1e12: a number from -1e9 to 1e9",
            ),
        ] {
            let said = check(&schema, &wrong).expect_err("it is refused").to_string();
            assert!(said.starts_with(expected), "{said}");
        }
        for (wrong, help) in [
            (json!({ "tip_mm": [0, 1e7] }), "is it in the unit of its name, mm?"),
            (json!({ "standard_um": { "a": 1e-10 } }), "is it in the unit of its name, um?"),
            (json!({ "count": 10 }), "write a number in this range, or leave the setting out if it is optional"),
        ] {
            assert_eq!(check(&schema, &wrong).expect_err("it is refused").help.as_deref(), Some(help), "{wrong}");
        }
    }
}
