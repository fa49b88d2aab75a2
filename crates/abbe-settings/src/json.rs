//! JSON that others wrote: a key that stands twice in a map is refused, because nobody knows which of the two was meant.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt;

use serde::de::{DeserializeOwned, Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::Value;

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

/// The value of a key of a JSON text that is a map; none if it is something else, or has not the key. No map outside of this value
/// may have a key twice.
///
/// Nothing else of the text is kept in memory.
///
/// ```
/// let number = abbe_settings::value_in_json(r#"{ "abbe_run": 1, "inputs": [] }"#, "abbe_run")?;
/// assert_eq!(number, Some(1.into()));
/// # Ok::<(), serde_json::Error>(())
/// ```
///
/// # Errors
/// What is wrong, with line and column.
pub fn value_in_json(text: &str, key: &str) -> serde_json::Result<Option<Value>> {
    let mut reader = serde_json::Deserializer::from_str(text);
    let found = match text.trim_start().starts_with('{') {
        true => reader.deserialize_map(OneKey(key))?,
        false => UniqueKeys::deserialize(&mut reader).map(|_| None)?,
    };
    reader.end()?;
    Ok(found)
}

/// The value of one key of a map.
struct OneKey<'a>(&'a str);

impl<'de> Visitor<'de> for OneKey<'_> {
    type Value = Option<Value>;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a map")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Option<Value>, A::Error> {
        let (mut keys, mut found) = (BTreeSet::new(), None);
        while let Some(key) = new_key(&mut map, &mut keys)? {
            match key == self.0 {
                true => found = Some(map.next_value()?),
                false => map.next_value::<UniqueKeys>().map(drop)?,
            }
        }
        Ok(found)
    }
}

/// A key of a map, borrowed from the text where it has no escapes.
#[derive(Deserialize)]
struct Key<'a>(#[serde(borrow)] Cow<'a, str>);

/// The next key of a map; none at its end. Fails on one that was there before.
fn new_key<'de, A: MapAccess<'de>>(
    map: &mut A,
    known: &mut BTreeSet<Cow<'de, str>>,
) -> Result<Option<Cow<'de, str>>, A::Error> {
    let Some(Key(key)) = map.next_key()? else { return Ok(None) };
    match known.insert(key.clone()) {
        true => Ok(Some(key)),
        false => Err(A::Error::custom(format!("the key `{key}` stands here a second time"))),
    }
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
        while new_key(&mut map, &mut keys)?.is_some() {
            map.next_value::<Self>()?;
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

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

    #[test]
    fn one_value_is_found_and_the_rest_is_checked() {
        let found = |text: &str| value_in_json(text, "n");
        assert_eq!(found(" { \"a\": { \"n\": 1 }, \"n\": [2] }").unwrap(), Some(json!([2])));
        for other in ["{ \"a\": { \"n\": 1 } }", "[1]", "null", "\"n\"", "{}"] {
            assert_eq!(found(other).unwrap(), None, "{other}");
        }
        for wrong in ["{ \"n\": 1, \"a\": { \"b\": 1, \"b\": 2 } }", "{ \"n\": 1", "", "{ \"n\": 1 } x"] {
            assert!(found(wrong).is_err(), "{wrong}");
        }
    }
}
