//! Limits as recipes state them.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::{MapAccessDeserializer, MapDeserializer};
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::decision::Rule;

/// The largest admissible value of a figure and the rule that it is judged by.
///
/// In settings it is a number, or a map with the rule: `30`, `{ limit: 30, decision: simple }` or
/// `{ limit: 30, decision: { rule: simple } }`. The unit stands in the name of the setting.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limit {
    /// The largest admissible value.
    #[serde(rename = "limit")]
    pub value: f64,
    /// The rule.
    #[serde(rename = "decision")]
    pub rule: Rule,
}

impl From<f64> for Limit {
    fn from(value: f64) -> Self {
        Self { value, rule: Rule::default() }
    }
}

/// Largest limit, in the unit of its key: in µm a metre. A larger one judges nothing, and none is below zero: figures with limits are sizes.
const LARGEST: f64 = 1e6;

const EXPECTED: &str = "a limit from 0 to 1e6 was expected";

fn bounded<E: Error>(value: f64) -> Result<f64, E> {
    match value.is_finite() && !(0.0..=LARGEST).contains(&value) {
        true if value.abs() <= LARGEST => Err(E::custom(format_args!("{value}: {EXPECTED}"))),
        true => Err(E::custom(format_args!("{value:e}: {EXPECTED}"))),
        false => Ok(value),
    }
}

/// A limit with the rule that decides.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Stated {
    /// The largest admissible value.
    #[schemars(range(min = 0.0, max = 1e6))]
    limit: f64,
    /// The rule that decides whether a value keeps the limit: its name, or a map with its settings. Default: simple
    /// acceptance.
    #[serde(default, deserialize_with = "rule_or_name")]
    #[schemars(schema_with = "schema_of_rules")]
    decision: Rule,
}

impl<'de> Deserialize<'de> for Limit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;

        // An untagged enum of serde would lose what is wrong, and where.
        impl<'de> Visitor<'de> for Either {
            type Value = Limit;

            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("a number or a map `{ limit: 30, decision: simple }`")
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Limit, E> {
                bounded(value).map(Limit::from)
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Limit, E> {
                bounded(value as f64).map(Limit::from)
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Limit, E> {
                bounded(value as f64).map(Limit::from)
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Limit, A::Error> {
                let Stated { limit, decision } = Stated::deserialize(MapAccessDeserializer::new(map))?;
                Ok(Limit { value: bounded(limit)?, rule: decision })
            }
        }

        deserializer.deserialize_any(Either)
    }
}

/// Reads a rule by its name, which is short for the map with this name alone, or as the map.
pub fn rule_or_name<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Rule, D::Error> {
    struct Either;

    impl<'de> Visitor<'de> for Either {
        type Value = Rule;

        fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
            text.write_str("the name of a rule, `simple`, or a map `{ rule: simple }`")
        }

        fn visit_str<E: Error>(self, name: &str) -> Result<Rule, E> {
            Rule::deserialize(MapDeserializer::new([("rule", name)].into_iter()))
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Rule, A::Error> {
            Rule::deserialize(MapAccessDeserializer::new(map))
        }
    }

    deserializer.deserialize_any(Either)
}

/// The maps of all rules, and the names of those that need no setting.
pub fn schema_of_rules(generator: &mut SchemaGenerator) -> Schema {
    let maps = Rule::json_schema(generator);
    let rules = maps.get("oneOf").and_then(Value::as_array).into_iter().flatten();
    let alone = rules.filter(|rule| rule["required"].as_array().is_some_and(|required| required.len() == 1));
    let names: Vec<&Value> = alone.map(|rule| &rule["properties"]["rule"]["const"]).collect();
    json_schema!({ "anyOf": [{ "enum": names }, maps] })
}

impl JsonSchema for Limit {
    fn schema_name() -> Cow<'static, str> {
        "Limit".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "type": "number", "minimum": 0.0, "maximum": LARGEST }, generator.subschema_for::<Stated>()] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_settings::{from_settings, schema_of};
    use serde_json::json;
    use std::collections::BTreeMap;

    #[derive(Debug, PartialEq, Deserialize, JsonSchema)]
    struct Settings {
        #[serde(default)]
        limits: BTreeMap<String, Limit>,
    }

    #[test]
    fn a_number_or_a_map() {
        let forms = [
            json!(30),
            json!(30.0),
            json!({ "limit": 30 }),
            json!({ "limit": 30, "decision": "simple" }),
            json!({ "decision": { "rule": "simple" }, "limit": 30.0 }),
        ];
        let guarded: Settings =
            from_settings(&json!({ "limits": { "max_um": { "limit": 30, "decision": "iso-14253-1-2017" } } })).unwrap();
        assert_eq!(guarded.limits["max_um"].rule, Rule::Iso14253Of2017 { probability: 0.95 });
        for form in forms {
            let read: Settings = from_settings(&json!({ "limits": { "max_um": form } })).unwrap();
            assert_eq!(read.limits["max_um"], Limit { value: 30.0, rule: Rule::Simple {} }, "{form}");
        }
        let written = json!(Limit::from(3.0));
        assert_eq!(written, json!({ "limit": 3.0, "decision": { "rule": "simple" } }));
        for form in [json!(3), written] {
            assert_eq!(from_settings::<Limit>(&form).unwrap(), Limit::from(3.0));
        }
    }

    #[test]
    fn what_is_none_is_refused_at_its_place() {
        let cases = [
            (
                json!("30"),
                "limits.max_um: the text `30` was found; a number or a map `{ limit: 30, decision: simple }` was expected",
            ),
            (
                json!(null),
                "limits.max_um: nothing was found; a number or a map `{ limit: 30, decision: simple }` was expected",
            ),
            (
                json!([30]),
                "limits.max_um: a list was found; a number or a map `{ limit: 30, decision: simple }` was expected",
            ),
            (json!(-3), "limits.max_um: -3: a limit from 0 to 1e6 was expected"),
            (json!({ "limit": -0.5 }), "limits.max_um: -0.5: a limit from 0 to 1e6 was expected"),
            (json!({ "decision": "simple" }), "limits.max_um: the setting `limit` is missing"),
            (json!({ "limit": "30" }), "limits.max_um.limit: the text `30` was found; a number was expected"),
            (
                json!({ "limit": 30, "decison": "simple" }),
                "limits.max_um.decison: unknown setting `decison` (did you mean `decision`?)",
            ),
            (
                json!({ "limit": 30, "decision": "simpel" }),
                "limits.max_um.decision: unknown choice `simpel` (did you mean `simple`?)",
            ),
            (
                json!({ "limit": 30, "decision": { "rule": "simpel" } }),
                "limits.max_um.decision.rule: unknown choice `simpel` (did you mean `simple`?)",
            ),
            (
                json!({ "limit": 30, "decision": "toss-up" }),
                "limits.max_um.decision: unknown choice `toss-up` (possible are: simple, \
                 iso-14253-1-1998, iso-14253-1-2017, binary-guard-band)",
            ),
            (
                json!({ "limit": 30, "decision": { "rule": "iso-14253-1-2017", "probability": 1.0 } }),
                "limits.max_um.decision: 1: a probability from 0.5 to 0.9999 was expected",
            ),
            (json!({ "limit": 30, "decision": {} }), "limits.max_um.decision: the setting `rule` is missing"),
            (
                json!({ "limit": 30, "decision": { "rule": "simple", "probability": 0.95 } }),
                "limits.max_um.decision: unknown setting `probability`",
            ),
            (
                json!({ "limit": 30, "decision": 0.95 }),
                "limits.max_um.decision: the number 0.95 was found; the name of a rule, `simple`, or a map \
                 `{ rule: simple }` was expected",
            ),
        ];
        for (form, expected) in cases {
            let error = from_settings::<Settings>(&json!({ "limits": { "max_um": form } })).unwrap_err();
            assert_eq!(error.to_string(), expected, "{form}");
        }
    }

    #[test]
    fn editors_know_both_forms() {
        let limits = &schema_of::<Settings>()["properties"]["limits"];
        assert_eq!(limits["default"], json!({}));
        let limit = &limits["additionalProperties"];
        assert_eq!(limit["anyOf"][0], json!({ "type": "number", "minimum": 0.0, "maximum": 1e6 }));
        let map = &limit["anyOf"][1];
        assert_eq!((&map["required"], &map["additionalProperties"]), (&json!(["limit"]), &json!(false)));
        let [name, set] = [0, 1].map(|form| &map["properties"]["decision"]["anyOf"][form]);
        assert_eq!(name["enum"], json!(["simple", "iso-14253-1-1998", "iso-14253-1-2017", "binary-guard-band"]));
        assert_eq!(set["oneOf"][0]["properties"]["rule"]["const"], "simple");
        assert_eq!(set["oneOf"][0]["additionalProperties"], false);
    }
}
