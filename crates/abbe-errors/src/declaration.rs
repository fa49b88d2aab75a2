//! What a recipe says under `errors`, one line a family: `{ polynomial: [EXX, EYX], degrees: [1, 2, 3] }`.

use abbe_core::{Quantity, SettingsError, from_settings, schema_of};
use serde::Serialize;
use serde_json::{Value, json};

use crate::families::{Backlash, Drift, Fourier, Location, Polynomial, Spline};

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
    /// See [`Spline`].
    Spline(Spline),
    /// See [`Fourier`].
    Fourier(Fourier),
}

impl Declaration {
    const FAMILIES: [&'static str; 6] = ["location", "polynomial", "backlash", "drift", "spline", "fourier"];

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
            ["spline"] => Self::Spline(from_settings(settings)?),
            ["fourier"] => Self::Fourier(from_settings(settings)?),
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
        match self {
            Self::Polynomial(polynomial) => polynomial.check(),
            Self::Drift(drift) => drift.check(),
            Self::Spline(spline) => spline.check(),
            Self::Fourier(fourier) => fourier.check(),
            Self::Location(_) | Self::Backlash(_) => Ok(()),
        }
    }

    /// Checks that the family can be one of an axis whose commands are of this quantity.
    pub fn check_axis(&self, command: Quantity) -> Result<(), SettingsError> {
        match self {
            Self::Spline(spline) => spline.check_axis(command),
            Self::Fourier(fourier) => fourier.check_axis(command),
            Self::Location(_) | Self::Polynomial(_) | Self::Backlash(_) | Self::Drift(_) => Ok(()),
        }
    }

    /// Patterns of coefficients that are zero by definition and no parameters (setting `zero`).
    pub fn zero(&self) -> &[String] {
        match self {
            Self::Spline(spline) => &spline.zero,
            _ => &[],
        }
    }

    /// The key of the family, which holds its symbols.
    pub fn family(&self) -> &'static str {
        match self {
            Self::Location(_) => "location",
            Self::Polynomial(_) => "polynomial",
            Self::Backlash(_) => "backlash",
            Self::Drift(_) => "drift",
            Self::Spline(_) => "spline",
            Self::Fourier(_) => "fourier",
        }
    }

    /// The symbols (or patterns) that the line lists.
    pub fn symbols(&self) -> &[String] {
        match self {
            Self::Location(location) => &location.location,
            Self::Polynomial(polynomial) => &polynomial.polynomial,
            Self::Backlash(backlash) => &backlash.backlash,
            Self::Drift(drift) => &drift.drift,
            Self::Spline(spline) => &spline.spline,
            Self::Fourier(fourier) => &fourier.fourier,
        }
    }

    /// JSON Schema of a line.
    pub fn schema() -> Value {
        json!({ "anyOf": [
            schema_of::<Location>(), schema_of::<Polynomial>(), schema_of::<Backlash>(), schema_of::<Drift>(),
            schema_of::<Spline>(), schema_of::<Fourier>()
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
            (json!({ "spline": ["EXX"], "knots_mm": [0, 50, 50] }), "knots_mm[2]: knots have to increase; 50 does not"),
            (json!({ "spline": ["EXX"], "knots_mm": [0, 50] }), "knots_mm: a spline has 3 knots at least; 2 are given"),
            (
                json!({ "spline": ["EXX"], "knots_mm": { "from": 0, "to": 500, "step": 60 } }),
                "knots_mm.step: the step 60 does not divide the way from 0 to 500",
            ),
            (
                json!({ "spline": ["EXX"], "knots_mm": { "from": 0, "to": 500, "step": -50 } }),
                "knots_mm: knots from 0 to 500 in steps of -50: a smaller `from`, a larger `to` and a positive `step` were expected",
            ),
            (json!({ "spline": ["EXX"] }), "a spline needs `knots_mm` (or `knots_deg` of a rotary axis)"),
            (json!({ "fourier": ["EXC"], "orders": [0] }), "orders[0]: order 0: 1 to 99 was expected"),
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
            json!({ "spline": ["EXX"], "knots_mm": { "from": -250.0, "to": 250.0, "step": 50.0 }, "zero": ["EXX[spl5]"] }),
            json!({ "spline": ["EXB"], "knots_deg": [0.0, 10.0, 50.0] }),
            json!({ "fourier": ["EXC"], "orders": [2, 3] }),
            json!({ "drift": ["dzt"], "degrees": [1], "per": "day", "time_s": { "1": [0.0, 9.5] } }),
        ] {
            let declaration = Declaration::read(&line).expect("valid");
            assert_eq!(serde_json::to_value(&declaration).expect("JSON"), line);
        }
    }
}
