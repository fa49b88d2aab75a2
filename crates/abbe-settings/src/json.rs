//! JSON that others wrote: a key that stands twice in a map is refused, because nobody knows which of the two was meant.

use std::collections::BTreeSet;
use std::fmt;

use serde::de::{DeserializeOwned, Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// Reads JSON; as [`serde_json::from_str`], but no map may have a key twice.
///
/// ```
/// let twice = abbe_settings::from_json::<serde_json::Value>(r#"{ "EXX[1]": 1, "EXX[1]": 2 }"#).unwrap_err();
/// assert_eq!(twice.to_string(), "the key `EXX[1]` stands here a second time at line 1 column 23");
/// ```
///
/// # Errors
/// What is wrong, with line and column.
pub fn from_json<T: DeserializeOwned>(text: &str) -> serde_json::Result<T> {
    serde_json::from_str::<UniqueKeys>(text)?;
    serde_json::from_str(text)
}

/// JSON of any kind whose maps have every key once.
struct UniqueKeys;

impl<'de> Deserialize<'de> for UniqueKeys {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Self)
    }
}

impl<'de> Visitor<'de> for UniqueKeys {
    type Value = Self;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_bool<E>(self, _: bool) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_i64<E>(self, _: i64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_u64<E>(self, _: u64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_f64<E>(self, _: f64) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_str<E>(self, _: &str) -> Result<Self, E> {
        Ok(self)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Self, A::Error> {
        while items.next_element::<Self>()?.is_some() {}
        Ok(self)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self, A::Error> {
        let mut keys = BTreeSet::new();
        while let Some(key) = map.next_key::<String>()? {
            if keys.contains(&key) {
                return Err(A::Error::custom(format!("the key `{key}` stands here a second time")));
            }
            keys.insert(key);
            map.next_value::<Self>()?;
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn a_key_that_stands_twice_is_refused_wherever_it_is() {
        let said = |text: &str| from_json::<Value>(text).unwrap_err().to_string();
        for (text, place) in [
            ("{\"a\": 1,\n \"a\": 1}", "`a` stands here a second time at line 2 column 4"),
            ("[1, {\"b\": {\"c\": [], \"d\": 2, \"c\": []}}]", "`c` stands here a second time at line 1 column 31"),
            // The same key, written otherwise.
            ("{\"a\": 1, \"\\u0061\": 2}", "`a` stands here a second time at line 1 column 17"),
        ] {
            assert!(said(text).contains(place), "{text}: {}", said(text));
        }
        assert!(said("{\"a\": 1,}").contains("line 1 column"));
        let fine = "{\"a\": [{\"a\": null}, {\"a\": true}, -1, 1.5, \"a\"], \"b\": {\"a\": 18446744073709551615}}";
        let expected = json!({ "a": [{ "a": null }, { "a": true }, -1, 1.5, "a"], "b": { "a": u64::MAX } });
        assert_eq!(from_json::<Value>(fine).unwrap(), expected);
    }
}
