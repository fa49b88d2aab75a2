//! Whole numbers with a range.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de};
use serde_json::Value;

/// A whole number from `LEAST` to `MOST`; its messages and its schema say the range. `1e6` is one, too.
///
/// ```
/// use abbe_settings::Whole;
///
/// let trials: Whole<1, 10_000_000> = serde_json::from_str("1e6")?;
/// assert_eq!(trials.get(), 1_000_000);
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Whole<const LEAST: u64, const MOST: u64>(u64);

impl<const LEAST: u64, const MOST: u64> Whole<LEAST, MOST> {
    /// A number that is known to be in the range; one that is not becomes its nearest end.
    pub const fn new(number: u64) -> Self {
        Self(match number {
            less if less < LEAST => LEAST,
            more if more > MOST => MOST,
            other => other,
        })
    }

    /// The number.
    pub const fn get(self) -> usize {
        self.0 as usize
    }
}

/// The number that a value is, if it is whole.
fn whole(value: &Value) -> Option<u64> {
    let of_float =
        |value: f64| (value >= 0.0 && value.fract() == 0.0 && value <= 2f64.powi(53)).then_some(value as u64);
    value.as_u64().or_else(|| value.as_f64().and_then(of_float))
}

fn unexpected(value: &Value) -> de::Unexpected<'_> {
    match value {
        Value::Null => de::Unexpected::Unit,
        Value::Bool(value) => de::Unexpected::Bool(*value),
        Value::Number(number) => match (number.as_u64(), number.as_i64()) {
            (Some(number), _) => de::Unexpected::Unsigned(number),
            (_, Some(number)) => de::Unexpected::Signed(number),
            _ => de::Unexpected::Float(number.as_f64().unwrap_or(f64::NAN)),
        },
        Value::String(text) => de::Unexpected::Str(text),
        Value::Array(_) => de::Unexpected::Seq,
        Value::Object(_) => de::Unexpected::Map,
    }
}

impl<'de, const LEAST: u64, const MOST: u64> Deserialize<'de> for Whole<LEAST, MOST> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        match whole(&value) {
            Some(number) if (LEAST..=MOST).contains(&number) => Ok(Self(number)),
            _ => {
                let expected = format!("a whole number from {LEAST} to {MOST}");
                Err(de::Error::invalid_value(unexpected(&value), &expected.as_str()))
            }
        }
    }
}

impl<const LEAST: u64, const MOST: u64> JsonSchema for Whole<LEAST, MOST> {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        format!("Whole_{LEAST}_{MOST}").into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "integer", "minimum": LEAST, "maximum": MOST })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::from_settings;
    use serde_json::json;

    #[test]
    fn the_range_is_said() {
        type Few = Whole<2, 10>;
        for good in [json!(2), json!(10), json!(3.0), json!(1e1)] {
            assert!(from_settings::<Few>(&good).is_ok(), "{good}");
        }
        for (wrong, expected) in [
            (json!(1), "the number 1 was found; a whole number from 2 to 10 was expected"),
            (json!(1e12), "the number 1000000000000 was found; a whole number from 2 to 10 was expected"),
            (json!(2.5), "the number 2.5 was found; a whole number from 2 to 10 was expected"),
            (json!(-3), "the number -3 was found; a whole number from 2 to 10 was expected"),
            (json!("many"), "the text `many` was found; a whole number from 2 to 10 was expected"),
            (json!(null), "nothing was found; a whole number from 2 to 10 was expected"),
        ] {
            assert_eq!(from_settings::<Few>(&wrong).unwrap_err().to_string(), expected);
        }
        assert_eq!([Few::new(0), Few::new(5), Few::new(99)].map(Few::get), [2, 5, 10]);
    }
}
