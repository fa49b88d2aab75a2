//! Entries of a recipe under `errors`, one line for each family: `{ polynomial: [EXX, EYX], degrees: [1, 2, 3] }`.

use abbe_core::{SettingsError, from_settings, schema_of};
use serde::Serialize;
use serde_json::{Value, json};

use crate::families::{
    BSpline, Backlash, Chebyshev, Cyclic, Drift, Expansion, Family, Fourier, Gravity, Lag, Legendre, Load, Location,
    Periodic, Piecewise, Polynomial, Product, Spline, Thermal,
};

/// Makes the enum of all families from a list of their keys and types.
macro_rules! families {
    ($($key:literal => $name:ident),+ $(,)?) => {
        /// One line under `errors`.
        #[derive(Debug, Clone, PartialEq, Serialize)]
        #[serde(untagged)]
        pub enum Declaration {
            $(#[doc = concat!("See [`", stringify!($name), "`].")] $name($name),)+
        }

        impl Declaration {
            const FAMILIES: &'static [&'static str] = &[$($key),+];

            /// Reads the settings of the family with this key.
            fn read_as(key: &str, settings: &Value) -> Result<Self, SettingsError> {
                match key {
                    $($key => Ok(Self::$name(from_settings(settings)?)),)+
                    other => Err(SettingsError::new(other, "this names no error family")),
                }
            }

            /// The key of the family, which holds its symbols.
            pub fn key(&self) -> &'static str {
                match self {
                    $(Self::$name(_) => $key,)+
                }
            }

            /// What the line declares.
            pub fn family(&self) -> &dyn Family {
                match self {
                    $(Self::$name(family) => family,)+
                }
            }

            /// JSON Schema of a line.
            pub fn schema() -> Value {
                json!({ "anyOf": [$(schema_of::<$name>()),+] })
            }
        }
    };
}

families! {
    "location" => Location,
    "polynomial" => Polynomial,
    "piecewise" => Piecewise,
    "legendre" => Legendre,
    "chebyshev" => Chebyshev,
    "spline" => Spline,
    "b-spline" => BSpline,
    "fourier" => Fourier,
    "gravity" => Gravity,
    "periodic" => Periodic,
    "cyclic" => Cyclic,
    "product" => Product,
    "load" => Load,
    "expansion" => Expansion,
    "backlash" => Backlash,
    "lag" => Lag,
    "drift" => Drift,
    "thermal" => Thermal,
}

impl Declaration {
    /// Reads one line; the family is the key that names one.
    pub fn read(settings: &Value) -> Result<Self, SettingsError> {
        let Some(map) = settings.as_object() else {
            return Err(SettingsError::new("", "a family such as `{ polynomial: [EXX], degrees: [1] }` was expected"));
        };
        let named: Vec<&str> = Self::FAMILIES.iter().copied().filter(|family| map.contains_key(*family)).collect();
        let declaration = match named.as_slice() {
            [family] => Self::read_as(family, settings)?,
            [] => {
                let given = map.keys().next().map_or("", String::as_str);
                let known = Self::FAMILIES.iter().copied();
                let mut error = SettingsError::new(given, "this names no error family").suggest(given, known);
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
        declaration.family().check()?;
        Ok(declaration)
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
            (
                json!({ "polynomial": ["EXX"], "degrees": [1, 12] }),
                "degrees[1]: the number 12 was found; a whole number from 0 to 9 was expected",
            ),
            (json!({ "polynomial": ["EXX"], "degrees": [1, 1] }), "degrees[1]: degree 1 stands here twice"),
            (
                json!({ "drift": ["dzt"], "degrees": [0] }),
                "degrees[0]: the number 0 was found; a whole number from 1 to 9 was expected",
            ),
            (json!({ "drift": ["dzt"], "degrees": [] }), "degrees: at least one degree was expected"),
            (
                json!({ "drift": ["dzt"], "degrees": [1], "per": "dya" }),
                "per: unknown choice `dya` (did you mean `day`?)",
            ),
            (json!({ "spline": ["EXX"], "knots_mm": [0, 50, 50] }), "knots_mm[2]: these have to increase; 50 does not"),
            (json!({ "spline": ["EXX"], "knots_mm": [0, 50] }), "knots_mm: a spline has 3 knots at least; 2 are given"),
            (
                json!({ "spline": ["EXX"], "knots_mm": { "from": 0, "to": 500, "step": 60 } }),
                "knots_mm.step: the step 60 does not divide the way from 0 to 500",
            ),
            (
                json!({ "spline": ["EXX"], "knots_mm": { "from": 0, "to": 500, "step": -50 } }),
                "knots_mm: from 0 to 500 in steps of -50: a smaller `from`, a larger `to` and a positive `step` were expected",
            ),
            (json!({ "spline": ["EXX"] }), "a spline needs `knots_mm` (or `knots_deg` of a rotary axis)"),
            (
                json!({ "fourier": ["EXC"], "orders": [0] }),
                "orders[0]: the number 0 was found; a whole number from 1 to 99 was expected",
            ),
            (
                json!({ "piecewise": ["EXX"], "degree": 2, "continuity": 2, "knots_mm": [50] }),
                "continuity: pieces of degree 2 that continue 2 times have no knots: 0 to 1 was expected",
            ),
            (
                json!({ "piecewise": ["EXX"], "degree": 2, "continuity": 1, "knots_mm": [] }),
                "knots_mm: a piecewise polynomial has 1 knots at least; 0 are given",
            ),
            (
                json!({ "legendre": ["EXX"], "degrees": [1], "range_mm": [5, 5] }),
                "range_mm: a range is two numbers, the smaller one first",
            ),
            (
                json!({ "polynomial": ["EYX"], "degrees": [2, 1], "without_line": true }),
                "degrees[1]: degree 1 is nothing but a line, which `without_line` takes off",
            ),
            (
                json!({ "chebyshev": ["EYX"], "degrees": [2], "without_line": true, "without_once_per_turn": true }),
                "without_once_per_turn: there is `without_line` already",
            ),
            (
                json!({ "b-spline": ["EXX"], "degree": 0, "knots_mm": [1] }),
                "degree: the number 0 was found; a whole number from 1 to 5 was expected",
            ),
            (
                json!({ "periodic": ["EXX"], "wavelength_mm": 0, "functions": 3 }),
                "wavelength_mm: a wavelength is positive; 0 is not",
            ),
            (
                json!({ "periodic": ["EXX"], "functions": 3 }),
                "a periodic error needs `wavelength_mm` (or `wavelength_deg` of a rotary axis)",
            ),
            (
                json!({ "periodic": ["EXX"], "wavelength_mm": 1, "functions": 1 }),
                "functions: the number 1 was found; a whole number from 2 to 99 was expected",
            ),
            (json!({ "cyclic": ["EXX"], "pitch_mm": 0 }), "pitch_mm: "),
            (json!({ "cyclic": ["EXX"], "pitch_mm": 5, "orders": [2, 2] }), "orders[1]: order 2 stands here twice"),
            (json!({ "product": ["EXX"], "of": [] }), "of: a product of 0 axes: 1 to 9 was expected"),
            (json!({ "load": ["EAX"], "reference_N": -1, "degree": 1 }), "reference_N: a positive force was expected"),
            (json!({ "load": ["EAX"], "reference_N": 1, "degree": 1, "knots_mm": [5] }), "knots need a `continuity`"),
            (
                json!({ "location": ["EA0B"], "backlash": ["EXX"] }),
                "backlash: two families in one line: location, backlash (give each family a line of its own)",
            ),
            (
                json!({ "expansion": ["EAX"], "temperature": "T_X", "coefficient_per_K": 1e-5 }),
                "expansion[0]: an expanding scale is a positioning error: EXX, EYY or EZZ",
            ),
            (
                json!({ "expansion": ["EXX"], "temperature": "T_X_degC", "coefficient_per_K": 1e-5 }),
                "temperature: the name of a column without its unit was expected, not `T_X_degC` (`T_X` is the column `T_X_degC`)",
            ),
            (json!(["EXX"]), "a family such as `{ polynomial: [EXX], degrees: [1] }` was expected"),
        ];
        for (line, expected) in cases {
            let error = Declaration::read(&line).expect_err(expected);
            assert!(error.to_string().starts_with(expected), "{error}");
        }
    }

    #[test]
    fn lines_round_trip() {
        for line in [
            json!({ "location": ["EA0B"] }),
            json!({ "polynomial": ["E?X"], "degrees": [1, 3] }),
            json!({ "backlash": ["EXX"] }),
            json!({ "backlash": ["EXX"], "degrees": [1] }),
            json!({ "piecewise": ["EYX"], "degree": 2, "continuity": 1, "knots_mm": [50.0, 100.0], "without_line": true }),
            json!({ "legendre": ["EXX"], "degrees": [1, 2], "range_mm": [-250.0, 250.0] }),
            json!({ "chebyshev": ["EXC"], "degrees": [2], "range_deg": [-90.0, 90.0], "without_once_per_turn": true }),
            json!({ "b-spline": ["EXX"], "degree": 3, "knots_mm": [0.0], "range_mm": [-1.0, 2.0], "zero": ["EXX[bs0]"] }),
            json!({ "periodic": ["EXX"], "wavelength_mm": 0.635, "functions": 3, "estimate_wavelength": true }),
            json!({ "cyclic": ["EXX"], "pitch_mm": 10.0 }),
            json!({ "cyclic": ["EXX"], "pitch_mm": 12.7, "orders": [1, 2] }),
            json!({ "lag": ["EXX", "EYY"] }),
            json!({ "product": ["EAY"], "of": ["X", "Y"] }),
            json!({ "gravity": ["EBB1"], "angles": ["B1", "B1+B2"] }),
            json!({ "load": ["EA0B"], "reference_N": 4900.0 }),
            json!({ "load": ["EAX"], "reference_N": 4900.0, "guideway_distance_mm": 375.0, "degree": 2, "continuity": 1,
                    "knots_mm": [350.0] }),
            json!({ "spline": ["EXX"], "knots_mm": { "from": -250.0, "to": 250.0, "step": 50.0 }, "zero": ["EXX[spl5]"] }),
            json!({ "expansion": ["EXX"], "temperature": "T_X", "coefficient_per_K": 1e-5, "reference_degC": 21.5 }),
            json!({ "spline": ["EXB"], "knots_deg": [0.0, 10.0, 50.0] }),
            json!({ "fourier": ["EXC"], "orders": [2, 3] }),
            json!({ "drift": ["dzt"], "degrees": [1], "per": "day", "time_s": { "1": [0.0, 9.5] } }),
        ] {
            let declaration = Declaration::read(&line).expect("valid");
            assert_eq!(serde_json::to_value(&declaration).expect("JSON"), line);
        }
    }
}
