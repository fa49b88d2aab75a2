//! Settings of stages: JSON in, a typed struct out, and errors that say which setting is wrong.

use std::any::TypeId;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use schemars::JsonSchema;
use serde::de::{self, DeserializeOwned, IntoDeserializer};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::error::{Class, nearest};
use crate::ranges;

/// One step on the way to a setting: a key of a map or an index of a list.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum PathItem {
    /// Key of a map.
    Key(String),
    /// Index of a list, from 0.
    Index(usize),
}

/// A path as people write it: `errors[2].degrees`.
pub fn path_text(path: &[PathItem]) -> String {
    let mut text = String::new();
    for item in path {
        match item {
            PathItem::Key(key) if text.is_empty() => text.push_str(key),
            PathItem::Key(key) => text.push_str(&format!(".{key}")),
            PathItem::Index(index) => text.push_str(&format!("[{index}]")),
        }
    }
    text
}

/// A setting that is wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SettingsError {
    /// Where the wrong setting stands.
    #[serde(default)]
    pub path: Vec<PathItem>,
    /// The key itself is wrong, not its value.
    #[serde(default)]
    pub key: bool,
    /// What is wrong and what was expected.
    pub message: String,
    /// What to do.
    #[serde(default)]
    pub help: Option<String>,
    /// [`Class::Data`] if no setting is wrong, but the plugin failed while it read them.
    #[serde(default)]
    pub class: Class,
}

impl SettingsError {
    /// A wrong value of the setting `name` (empty: of the whole).
    pub fn new(name: &str, message: impl Into<String>) -> Self {
        let path = if name.is_empty() { Vec::new() } else { vec![PathItem::Key(name.to_owned())] };
        Self { path, key: false, message: message.into(), help: None, class: Class::Use }
    }

    /// Adds what to do.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Adds the nearest valid spelling if there is one, else the list of what is allowed.
    pub fn suggest<'a>(mut self, given: &str, candidates: impl IntoIterator<Item = &'a str>) -> Self {
        let candidates: Vec<&str> = candidates.into_iter().collect();
        self.help = match nearest(given, candidates.iter().copied()) {
            Some(near) => Some(format!("did you mean `{near}`?")),
            None if candidates.is_empty() => None,
            None => Some(format!("possible are: {}", candidates.join(", "))),
        };
        self
    }

    /// Puts the path under another one.
    pub fn under(mut self, prefix: impl IntoIterator<Item = PathItem>) -> Self {
        let mut path: Vec<PathItem> = prefix.into_iter().collect();
        path.append(&mut self.path);
        self.path = path;
        self
    }
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.path.is_empty() {
            write!(f, "{}: ", path_text(&self.path))?;
        }
        write!(f, "{}", self.message)?;
        match &self.help {
            Some(help) => write!(f, " ({help})"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for SettingsError {}

impl de::Error for SettingsError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::new("", message.to_string())
    }

    fn invalid_type(unexpected: de::Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        Self::new("", format!("{} was found; {} was expected", found(unexpected), in_words(&expected.to_string())))
    }

    fn invalid_value(unexpected: de::Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        Self::invalid_type(unexpected, expected)
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        let mut error = Self::new("", format!("unknown setting `{field}`")).suggest(field, expected.iter().copied());
        error.key = true;
        error
    }

    fn missing_field(field: &'static str) -> Self {
        Self::new("", format!("the setting `{field}` is missing"))
    }

    fn unknown_variant(variant: &str, expected: &'static [&'static str]) -> Self {
        Self::new("", format!("unknown choice `{variant}`")).suggest(variant, expected.iter().copied())
    }
}

/// What was found, in the words of people who write recipes.
fn found(unexpected: de::Unexpected<'_>) -> String {
    match unexpected {
        de::Unexpected::Str(text) => format!("the text `{text}`"),
        de::Unexpected::Unsigned(number) => format!("the number {number}"),
        de::Unexpected::Signed(number) => format!("the number {number}"),
        de::Unexpected::Float(number) => format!("the number {number}"),
        de::Unexpected::Bool(value) => format!("`{value}`"),
        de::Unexpected::Unit => "nothing".to_owned(),
        de::Unexpected::Seq => "a list".to_owned(),
        de::Unexpected::Map => "a map".to_owned(),
        other => other.to_string(),
    }
}

/// What was expected, in the words of people who write recipes.
fn in_words(expected: &str) -> String {
    match expected {
        "f64" | "f32" => "a number".to_owned(),
        "u8" => "a whole number from 0 to 255".to_owned(),
        "u16" => "a whole number from 0 to 65535".to_owned(),
        "u32" => "a whole number from 0 to 4294967295".to_owned(),
        "u64" | "usize" => "a whole number, not negative,".to_owned(),
        "a nonzero usize" | "a nonzero u64" | "a nonzero u32" => "a whole number above 0".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a string" => "a text".to_owned(),
        "a sequence" => "a list".to_owned(),
        other if other.starts_with("struct ") => "a map of settings".to_owned(),
        other if other.starts_with("an array of length") => other.replace("an array of length", "a list of"),
        other => other.to_owned(),
    }
}

/// Reads typed settings; a wrong one is reported with its path, an unknown one with the nearest valid spelling.
pub fn from_settings<T: DeserializeOwned>(settings: &Value) -> Result<T, SettingsError> {
    serde_path_to_error::deserialize(Json(settings)).map_err(|error| {
        let mut path: Vec<PathItem> = error
            .path()
            .iter()
            .filter_map(|segment| match segment {
                serde_path_to_error::Segment::Map { key } => Some(PathItem::Key(key.clone())),
                serde_path_to_error::Segment::Seq { index } => Some(PathItem::Index(*index)),
                _ => None,
            })
            .collect();
        let mut inner = error.into_inner();
        path.append(&mut inner.path);
        inner.path = path;
        inner
    })
}

/// Reads typed settings whose numbers have to be in the ranges of their schema.
pub fn from_settings_in_range<T: DeserializeOwned + JsonSchema + 'static>(
    settings: &Value,
) -> Result<T, SettingsError> {
    ranges::check(&known_schema_of::<T>(), settings)?;
    from_settings(settings)
}

/// The schema of a type, made once in a process: settings of the same type are read for every stage of every recipe.
fn known_schema_of<T: JsonSchema + 'static>() -> Arc<Value> {
    static KNOWN: Mutex<BTreeMap<TypeId, Arc<Value>>> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    known.entry(TypeId::of::<T>()).or_insert_with(|| Arc::new(schema_of::<T>())).clone()
}

/// Refuses a setting that is not a positive finite number.
pub fn positive(name: &str, value: f64) -> Result<f64, SettingsError> {
    match value > 0.0 && value.is_finite() {
        true => Ok(value),
        false => Err(SettingsError::new(name, format!("{}: a positive number was expected", ranges::shown(value)))
            .help("write a finite number above 0")),
    }
}

/// Refuses a setting that is negative or not finite.
pub fn not_negative(name: &str, value: f64) -> Result<f64, SettingsError> {
    match value >= 0.0 && value.is_finite() {
        true => Ok(value),
        false => Err(SettingsError::new(
            name,
            format!("{}: a number that is not negative was expected", ranges::shown(value)),
        )
        .help("write 0 or a finite number above it")),
    }
}

/// The JSON Schema of a settings type, as a plain value; every number in it has a range.
pub fn schema_of<T: JsonSchema>() -> Value {
    let mut schema = schemars::generate::SchemaSettings::draft2020_12()
        .with(|settings| settings.inline_subschemas = true)
        .into_generator()
        .into_root_schema_for::<T>()
        .to_value();
    ranges::complete(&mut schema);
    schema
}

/// An identifier in a recipe: text, or a number taken as text (`feature: 7` and `feature: "7"` are the same).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Label(pub String);

impl<'de> Deserialize<'de> for Label {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Value::deserialize(deserializer)? {
            Value::String(text) => Ok(Self(text)),
            Value::Number(number) => Ok(Self(number.to_string())),
            other => Err(de::Error::custom(format!("a name or a number was expected, not {}", kind_of(&other)))),
        }
    }
}

impl JsonSchema for Label {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Label".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": ["string", "number"] })
    }
}

/// One name or a list of names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a name or a list of names was expected")]
pub enum Names {
    /// One.
    One(String),
    /// Several.
    Several(Vec<String>),
}

impl Names {
    /// The names.
    pub fn as_slice(&self) -> &[String] {
        match self {
            Self::One(name) => std::slice::from_ref(name),
            Self::Several(names) => names,
        }
    }
}

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Null => "nothing",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "a number",
        Value::String(_) => "text",
        Value::Array(_) => "a list",
        Value::Object(_) => "a map",
    }
}

/// The error for a list with more items than a setting takes.
fn too_long(items: &[Value]) -> SettingsError {
    let error = SettingsError::new("", format!("a list of {} items was found; fewer were expected", items.len()));
    match items.iter().all(Value::is_number) {
        true => error.help("decimals are written with a point: `0.5`; commas separate numbers"),
        false => error,
    }
}

/// Deserialises a JSON value with [`SettingsError`], which keeps the unknown names that serde reports.
struct Json<'a>(&'a Value);

impl<'a> IntoDeserializer<'a, SettingsError> for Json<'a> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Json<'de> {
    type Error = SettingsError;

    fn deserialize_any<V: de::Visitor<'de>>(self, visitor: V) -> Result<V::Value, SettingsError> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
                (Some(value), _, _) => visitor.visit_u64(value),
                (_, Some(value), _) => visitor.visit_i64(value),
                (_, _, value) => visitor.visit_f64(value.unwrap_or(f64::NAN)),
            },
            Value::String(text) => visitor.visit_borrowed_str(text),
            Value::Array(items) => {
                let mut rest = de::value::SeqDeserializer::new(items.iter().map(Json));
                let value = visitor.visit_seq(&mut rest)?;
                // A list of fixed length takes what it needs, and would forget the others.
                match rest.end() {
                    Ok(()) => Ok(value),
                    Err(_) => Err(too_long(items)),
                }
            }
            Value::Object(map) => visitor
                .visit_map(de::value::MapDeserializer::new(map.iter().map(|(key, value)| (key.as_str(), Json(value))))),
        }
    }

    fn deserialize_option<V: de::Visitor<'de>>(self, visitor: V) -> Result<V::Value, SettingsError> {
        if self.0.is_null() { visitor.visit_none() } else { visitor.visit_some(self) }
    }

    fn deserialize_newtype_struct<V: de::Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, SettingsError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: de::Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, SettingsError> {
        match self.0 {
            Value::String(text) => visitor.visit_enum(de::value::StrDeserializer::new(text)),
            Value::Object(map) if map.len() == 1 => visitor.visit_enum(de::value::MapAccessDeserializer::new(
                de::value::MapDeserializer::new(map.iter().map(|(key, value)| (key.as_str(), Json(value)))),
            )),
            other => Err(SettingsError::new(
                "",
                format!("one of {} was expected, not {}", variants.join(", "), kind_of(other)),
            )),
        }
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct seq tuple
        tuple_struct map struct identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only what the deserialiser says is looked at")]
    struct Example {
        name: String,
        degrees: Vec<u8>,
        #[serde(default)]
        styli: BTreeMap<String, f64>,
        #[serde(default)]
        on: Option<Choice>,
        #[serde(default)]
        tip_mm: [f64; 3],
        #[serde(default)]
        ranges: BTreeMap<String, Option<(f64, f64)>>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Choice {
        Drop,
        MinimumNorm,
    }

    #[test]
    fn wrong_settings_are_named() {
        let cases = [
            (json!({ "name": "a", "degree": [1] }), "degree: unknown setting `degree` (did you mean `degrees`?)"),
            (json!({ "name": "a" }), "the setting `degrees` is missing"),
            (
                json!({ "name": "a", "degrees": [1, "two"] }),
                "degrees[1]: the text `two` was found; a whole number from 0 to 255 was expected",
            ),
            (
                json!({ "name": "a", "degrees": [], "on": "minimum" }),
                "on: unknown choice `minimum` (possible are: drop, minimum-norm)",
            ),
            (
                json!({ "name": "a", "degrees": [], "tip_mm": [0, -35, 0, -130, 0] }),
                "tip_mm: a list of 5 items was found; fewer were expected (decimals are written with a point: `0.5`; commas \
                 separate numbers)",
            ),
            (
                json!({ "name": "a", "degrees": [], "ranges": { "X": [0, 1, "x"] } }),
                "ranges.X: a list of 3 items was found; fewer were expected",
            ),
        ];
        for (settings, expected) in cases {
            assert_eq!(from_settings::<Example>(&settings).unwrap_err().to_string(), expected);
        }
        let good = from_settings::<Example>(&json!({ "name": "a", "degrees": [1], "styli": { "2": 1 }, "on": "drop" }));
        assert!(good.is_ok(), "{good:?}");
    }

    #[derive(Debug, Deserialize, JsonSchema)]
    struct Counted {
        #[schemars(schema_with = "counted")]
        n: f64,
    }

    static MADE: AtomicUsize = AtomicUsize::new(0);

    fn counted(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        MADE.fetch_add(1, Ordering::Relaxed);
        schemars::json_schema!({ "type": "number", "minimum": 0, "maximum": 1 })
    }

    #[test]
    fn the_schema_of_a_type_is_made_once() {
        #[derive(Debug, Deserialize, JsonSchema)]
        struct Other {
            #[allow(dead_code, reason = "it is only read")]
            n: f64,
        }
        for n in [0.0, 0.5, 1.0] {
            assert_eq!(from_settings_in_range::<Counted>(&json!({ "n": n })).unwrap().n, n);
        }
        assert_eq!(MADE.load(Ordering::Relaxed), 1);
        // Another type has its own.
        assert!(from_settings_in_range::<Counted>(&json!({ "n": 2 })).is_err());
        assert!(from_settings_in_range::<Other>(&json!({ "n": 2 })).is_ok());
    }
}
