//! What a recipe says under `errors`, one line a family: `{ polynomial: [EXX, EYX], degrees: [1, 2, 3] }`.

use std::collections::BTreeMap;

use abbe_core::{SettingsError, from_settings, schema_of};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Constant errors of the location of axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Location {
    /// Location errors by ISO 230-1 symbol, e.g. EA0B; `?` and `*` are wildcards.
    pub location: Vec<String>,
}

/// Ordinary polynomials of the axis command: `EXX[1]`, `EXX[2]`, ... in the unit of the error per power of mm or rad.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Polynomial {
    /// Motion errors by ISO 230-1 symbol, e.g. EYX; `?` and `*` are wildcards.
    pub polynomial: Vec<String>,
    /// The degrees, 0 to 9.
    pub degrees: Vec<u8>,
}

/// Reversal errors: `EXX[b]` is half the reversal value, added after a positive approach and taken off after a negative one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backlash {
    /// Motion errors by ISO 230-1 symbol, e.g. EXX; `?` and `*` are wildcards.
    pub backlash: Vec<String>,
}

/// Slow drift of set-up parameters: Legendre polynomials in the time scaled to -1..1, `dzt[t1]`, `dzt[t2]`, ...
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Set-up parameters, e.g. dzt.
    pub drift: Vec<String>,
    /// The degrees, from 1 to 9; the constant part is the set-up parameter itself.
    pub degrees: Vec<u8>,
    /// What has a drift of its own.
    #[serde(default)]
    pub per: Per,
    /// First and last time in s of each series; found in the data unless given.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub time_s: BTreeMap<String, [f64; 2]>,
}

/// What has a drift of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Per {
    /// One drift over all rows that have a time.
    #[default]
    DataSet,
    /// One for each file (column `file`).
    File,
    /// One for each day (column `day`).
    Day,
    /// One for each cycle (column `cycle`).
    Cycle,
}

impl Per {
    /// The label column that tells the series apart.
    pub fn column(self) -> Option<&'static str> {
        match self {
            Self::DataSet => None,
            Self::File => Some("file"),
            Self::Day => Some("day"),
            Self::Cycle => Some("cycle"),
        }
    }

    /// What the names of a series' terms begin with inside the bracket: `day2.` of `dzt[day2.t1]`.
    pub fn prefix(self, label: &str) -> String {
        match self {
            Self::DataSet => String::new(),
            Self::File => format!("{label}."),
            Self::Day => format!("day{label}."),
            Self::Cycle => format!("cycle{label}."),
        }
    }
}

/// One line under `errors`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Declaration {
    /// See [`Location`].
    Location(Location),
    /// See [`Polynomial`].
    Polynomial(Polynomial),
    /// See [`Backlash`].
    Backlash(Backlash),
    /// See [`Drift`].
    Drift(Drift),
}

impl Declaration {
    const FAMILIES: [&'static str; 4] = ["location", "polynomial", "backlash", "drift"];

    /// Reads one line; the family is the key that names one.
    pub fn read(settings: &Value) -> Result<Self, SettingsError> {
        let Some(map) = settings.as_object() else {
            return Err(SettingsError::new("", "a family such as `{ polynomial: [EXX], degrees: [1] }` was expected"));
        };
        let named: Vec<&str> = Self::FAMILIES.into_iter().filter(|family| map.contains_key(*family)).collect();
        let declaration = match named.as_slice() {
            ["location"] => Self::Location(from_settings(settings)?),
            ["polynomial"] => Self::Polynomial(from_settings(settings)?),
            ["backlash"] => Self::Backlash(from_settings(settings)?),
            ["drift"] => Self::Drift(from_settings(settings)?),
            [] => {
                let given = map.keys().next().map_or("", String::as_str);
                let mut error = SettingsError::new(given, "this names no error family").suggest(given, Self::FAMILIES);
                error.key = true;
                return Err(error);
            }
            several => {
                return Err(SettingsError::new(
                    several[1],
                    format!("two families in one line: {}", several.join(", ")),
                )
                .help("give each family a line of its own"));
            }
        };
        declaration.check()?;
        Ok(declaration)
    }

    fn check(&self) -> Result<(), SettingsError> {
        let (degrees, least) = match self {
            Self::Polynomial(polynomial) => (&polynomial.degrees, 0),
            Self::Drift(drift) => (&drift.degrees, 1),
            Self::Location(_) | Self::Backlash(_) => return Ok(()),
        };
        if degrees.is_empty() {
            return Err(SettingsError::new("degrees", "at least one degree was expected"));
        }
        for (index, degree) in degrees.iter().enumerate() {
            let at = |message: String| {
                SettingsError::new("", message)
                    .under([abbe_core::PathItem::Key("degrees".to_owned()), abbe_core::PathItem::Index(index)])
            };
            if !(least..=9).contains(degree) {
                return Err(at(format!("degree {degree}: {least} to 9 was expected")));
            }
            if degrees[..index].contains(degree) {
                return Err(at(format!("degree {degree} stands here twice")));
            }
        }
        Ok(())
    }

    /// The key of the family, which holds its symbols.
    pub fn family(&self) -> &'static str {
        match self {
            Self::Location(_) => "location",
            Self::Polynomial(_) => "polynomial",
            Self::Backlash(_) => "backlash",
            Self::Drift(_) => "drift",
        }
    }

    /// The symbols (or patterns) that the line lists.
    pub fn symbols(&self) -> &[String] {
        match self {
            Self::Location(location) => &location.location,
            Self::Polynomial(polynomial) => &polynomial.polynomial,
            Self::Backlash(backlash) => &backlash.backlash,
            Self::Drift(drift) => &drift.drift,
        }
    }

    /// JSON Schema of a line.
    pub fn schema() -> Value {
        json!({ "anyOf": [
            schema_of::<Location>(), schema_of::<Polynomial>(), schema_of::<Backlash>(), schema_of::<Drift>()
        ] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_lines_are_named() {
        let cases = [
            (json!({ "polynomal": ["EXX"] }), "polynomal: this names no error family (did you mean `polynomial`?)"),
            (json!({ "polynomial": ["EXX"] }), "the setting `degrees` is missing"),
            (json!({ "polynomial": ["EXX"], "degrees": [1, 12] }), "degrees[1]: degree 12: 0 to 9 was expected"),
            (json!({ "polynomial": ["EXX"], "degrees": [1, 1] }), "degrees[1]: degree 1 stands here twice"),
            (json!({ "drift": ["dzt"], "degrees": [0] }), "degrees[0]: degree 0: 1 to 9 was expected"),
            (json!({ "drift": ["dzt"], "degrees": [] }), "degrees: at least one degree was expected"),
            (
                json!({ "drift": ["dzt"], "degrees": [1], "per": "dya" }),
                "per: unknown choice `dya` (did you mean `day`?)",
            ),
            (
                json!({ "location": ["EA0B"], "backlash": ["EXX"] }),
                "backlash: two families in one line: location, backlash (give each family a line of its own)",
            ),
            (json!(["EXX"]), "a family such as `{ polynomial: [EXX], degrees: [1] }` was expected"),
        ];
        for (line, expected) in cases {
            let error = Declaration::read(&line).expect_err(expected);
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn lines_round_trip() {
        for line in [
            json!({ "location": ["EA0B"] }),
            json!({ "polynomial": ["E?X"], "degrees": [1, 3] }),
            json!({ "backlash": ["EXX"] }),
            json!({ "drift": ["dzt"], "degrees": [1], "per": "day", "time_s": { "1": [0.0, 9.5] } }),
        ] {
            let declaration = Declaration::read(&line).expect("valid");
            assert_eq!(serde_json::to_value(&declaration).expect("JSON"), line);
        }
    }
}
