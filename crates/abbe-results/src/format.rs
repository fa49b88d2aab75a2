//! Numbered file formats. Every reader of a result file checks the number first.

use serde::de::DeserializeOwned;
use serde_json::Value;

use abbe_settings::{Error, Result, from_json, value_in_json};

/// A file format with a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileFormat {
    /// What such a file is, in words.
    pub name: &'static str,
    /// The key that has the number.
    pub key: &'static str,
    /// The number that this program reads and writes.
    pub number: u32,
}

impl FileFormat {
    /// Reads the text of a file, with a byte order mark or without. Keys that are not known are left alone: a later program may add
    /// some (`docs/formats.md`).
    ///
    /// Fails on text that is no JSON, without a number or with another one, and on missing or wrong parts, with line and column.
    pub fn read<T: DeserializeOwned>(self, text: &str) -> Result<T> {
        let Self { name, key, .. } = self;
        let text = without_mark(text);
        match value_in_json(text, key).map_err(|error| broken(&error))? {
            None => return Err(Error::data(format!("this is not a {name}: the key `{key}` is missing"))),
            Some(found) => self.check(&found)?,
        }
        serde_json::from_str(text).map_err(|error| Error::data(format!("this {name} is broken: {error}")))
    }

    /// Fails if the number is not that of this format.
    pub(crate) fn check(self, found: &Value) -> Result<()> {
        let Self { name, key, number } = self;
        match found.as_u64() {
            Some(found) if found == u64::from(number) => Ok(()),
            Some(found) => {
                let error = format!("{name} format {found} was found, this program reads format {number}");
                Err(Error::data(error).help("read it with the version of Abbe that wrote it, or a later one"))
            }
            None => Err(Error::data(format!("`{key}` is {found}: the number of the format was expected"))),
        }
    }
}

/// JSON of any kind, with every key once.
pub(crate) fn parse(text: &str) -> Result<Value> {
    from_json(without_mark(text)).map_err(|error| broken(&error))
}

/// A text without the byte order mark that some editors write before it.
fn without_mark(text: &str) -> &str {
    text.strip_prefix('\u{feff}').unwrap_or(text)
}

/// Depth of lists and maps that `serde_json` reads.
const DEEPEST: usize = 127;

/// JSON that cannot be read: a key that stands twice, one that is too deep, or no JSON.
fn broken(error: &serde_json::Error) -> Error {
    match error.is_data() {
        true => Error::data(error.to_string()).help("keep the one that is right"),
        false if error.to_string().starts_with("recursion limit") => {
            Error::data(format!("lists and maps lie more than {DEEPEST} deep in each other here: {error}"))
        }
        false => Error::data(format!("this is not a JSON file: {error}")),
    }
}
