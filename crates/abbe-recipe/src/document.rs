//! YAML text as JSON values that know their place in the text.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{Error, PathItem, path_text};
use saphyr_parser::{Event, Marker, Parser, ScalarStyle};
use serde_json::Value;

/// Line and column, from 1.
type Mark = (usize, usize);

/// Deepest accepted nesting. It bounds the work that a hostile file can cause.
const DEEPEST: usize = 64;

/// Most values of a document, lists and maps among them: each takes some hundred bytes while it is read.
const MOST_VALUES: usize = 250_000;

/// Where a value stands, and its key; in a list both are the same.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Marks {
    key: Mark,
    value: Mark,
}

/// Which of the two a message points at: a key, or its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum At {
    /// The key.
    Key,
    /// The value.
    Value,
}

/// One YAML file.
#[derive(Debug, Clone, PartialEq)]
pub struct Document {
    /// The file.
    pub file: PathBuf,
    /// What it says.
    pub value: Value,
    /// Its last line, if that has no end.
    pub unended_line: Option<usize>,
    places: Arc<BTreeMap<Vec<PathItem>, Marks>>,
}

impl Document {
    /// Two parsers read the text: one knows the places, the other the types. Both have to accept it.
    pub fn parse(file: &Path, text: &str) -> Result<Self, Error> {
        // What some editors put before a text.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let places = places(text).map_err(|refusal| {
            let error = Error::usage(refusal.message).at(file, refusal.mark.0, Some(refusal.mark.1));
            if refusal.at_sign { error.help("a text that starts with @ needs quotes: \"@S1\"") } else { error }
        })?;
        let value = serde_yaml::from_str(text).map_err(|error| {
            // That is what it says of a number with more digits than any type has.
            let message = error.to_string().replace("JSON number out of range", "the number is too large");
            let message =
                message.replace("repetition limit exceeded", "the aliases (`*name`) repeat more than is read");
            let message = message.split(" at line ").next().unwrap_or_default();
            let message = message.split(" at position ").next().unwrap_or_default();
            // The parser does not know where a control character stands.
            let character = control_character(text).filter(|_| message.starts_with("control characters"));
            let place = character.or(error.location().map(|place| (place.line(), place.column())));
            let (line, column) = place.unwrap_or((1, 1));
            Error::usage(message).at(file, line, Some(column))
        })?;
        let unended_line = (!text.is_empty() && !text.ends_with(['\n', '\r'])).then(|| text.lines().count());
        Ok(Self { file: file.to_owned(), value, unended_line, places: Arc::new(places) })
    }

    /// The root, to read from.
    pub fn root(&self) -> Node<'_> {
        Node { document: self, path: Vec::new(), value: &self.value }
    }

    /// The length of the longest prefix of `path` that has a place. Values below an alias have no places.
    pub fn known(&self, path: &[PathItem]) -> usize {
        (0..=path.len()).rev().find(|&length| self.places.contains_key(&path[..length])).unwrap_or(0)
    }

    /// The value at `path`.
    pub fn get(&self, path: &[PathItem]) -> Option<&Value> {
        path.iter().try_fold(&self.value, |value, item| match item {
            PathItem::Key(key) => value.get(key),
            PathItem::Index(index) => value.get(index),
        })
    }

    /// Puts an error at `path`, or at the value that contains it if `path` has no place.
    pub fn locate(&self, error: Error, path: &[PathItem], at: At) -> Error {
        let known = self.known(path);
        let (line, column) = match self.places.get(&path[..known]) {
            Some(marks) if at == At::Key && known == path.len() => marks.key,
            Some(marks) => marks.value,
            None => (1, 1),
        };
        error.at(&self.file, line, Some(column))
    }
}

/// A value in a document, with the way to it.
#[derive(Debug, Clone)]
pub struct Node<'a> {
    document: &'a Document,
    /// The way to it.
    pub path: Vec<PathItem>,
    /// The value.
    pub value: &'a Value,
}

impl<'a> Node<'a> {
    fn child(&self, item: PathItem, value: &'a Value) -> Self {
        let mut path = self.path.clone();
        path.push(item);
        Self { document: self.document, path, value }
    }

    /// An error about this value or its key.
    pub fn error(&self, at: At, message: impl Into<String>) -> Error {
        self.document.locate(Error::usage(message), &self.path, at)
    }

    fn wrong_type(&self, expected: &str) -> Error {
        let found = match self.value {
            Value::Null => "nothing",
            Value::Bool(_) => "true or false",
            Value::Number(_) => "a number",
            Value::String(_) => "text",
            Value::Array(_) => "a list",
            Value::Object(_) => "a map",
        };
        let message = format!("{expected} was expected, not {found}");
        let last_key = self.path.iter().rposition(|item| matches!(item, PathItem::Key(_))).unwrap_or(0);
        let name = path_text(&self.path[last_key..]);
        self.error(At::Value, if name.is_empty() { message } else { format!("{name}: {message}") })
    }

    /// The value as text.
    pub fn text(&self) -> Result<&'a str, Error> {
        self.value.as_str().ok_or_else(|| self.wrong_type("text"))
    }

    /// The entries of a map.
    pub fn map(&self) -> Result<Vec<(&'a str, Self)>, Error> {
        let map = self.value.as_object().ok_or_else(|| self.wrong_type("a map"))?;
        Ok(map.iter().map(|(key, value)| (key.as_str(), self.child(PathItem::Key(key.clone()), value))).collect())
    }

    /// The entries of a list.
    pub fn list(&self) -> Result<Vec<Self>, Error> {
        let list = self.value.as_array().ok_or_else(|| self.wrong_type("a list"))?;
        Ok(list.iter().enumerate().map(|(index, value)| self.child(PathItem::Index(index), value)).collect())
    }

    /// The entry of a map, if this is a map and has it.
    pub fn get(&self, key: &str) -> Option<Self> {
        self.value.get(key).map(|value| self.child(PathItem::Key(key.to_owned()), value))
    }

    /// Refuses keys of a map other than `known`.
    pub fn only(&self, known: &[&str]) -> Result<(), Error> {
        match self.map()?.into_iter().find(|(key, _)| !known.contains(key)) {
            Some((key, node)) => {
                let error = node.error(At::Key, format!("unknown key `{key}`"));
                Err(error.help(format!("possible are: {}", known.join(", "))).suggest(key, known.iter().copied()))
            }
            None => Ok(()),
        }
    }

    /// An error about a missing key, at the place of a similar key if there is one: a probable misspelling.
    pub fn missing(&self, keys: &[&str], message: impl Into<String>) -> Error {
        let near = self.value.as_object().into_iter().flatten().find_map(|(key, value)| {
            let near = abbe_core::nearest(key, keys.iter().copied())?;
            Some((self.child(PathItem::Key(key.clone()), value), near))
        });
        match near {
            Some((node, near)) => node.error(At::Key, message).help(format!("did you mean `{near}`?")),
            None => self.error(At::Key, message),
        }
    }
}

struct Refusal {
    mark: Mark,
    message: String,
    at_sign: bool,
}

/// A map or a list that is being read.
enum Frame {
    /// The key that waits for its value.
    Map(Option<Mark>),
    /// The index that comes next.
    List(usize),
}

fn too_deep() -> String {
    format!("lists and maps are more than {DEEPEST} deep here")
}

/// The place of every key and value. Refuses YAML that recipes do not allow.
fn places(text: &str) -> Result<BTreeMap<Vec<PathItem>, Marks>, Refusal> {
    let mark_of = |marker: Marker| (marker.line(), marker.col() + 1);
    let refuse = |mark, message: String| Err(Refusal { mark, message, at_sign: false });
    let mut places = BTreeMap::new();
    let (mut frames, mut path) = (Vec::new(), Vec::new());
    let mut documents = 0;
    let mut parser = Parser::new_from_str(text);
    while let Some(event) = parser.next_event() {
        let (event, span) = event.map_err(|error| Refusal {
            mark: mark_of(*error.marker()),
            // The parser has a depth of its own, which it may find before.
            message: match error.info() {
                "recursion limit exceeded" => too_deep(),
                info => format!("this is not YAML: {info}"),
            },
            at_sign: error.info().contains("`@'"),
        })?;
        let mark = mark_of(span.start);
        match &event {
            Event::DocumentStart(_) if documents > 0 => {
                return refuse(mark, "a second YAML document starts here; one was expected".to_owned());
            }
            Event::DocumentStart(_) => documents += 1,
            Event::MappingEnd | Event::SequenceEnd => {
                frames.pop();
                close(&mut frames, &mut path);
            }
            Event::Scalar(_, _, _, Some(tag))
            | Event::SequenceStart(_, Some(tag))
            | Event::MappingStart(_, Some(tag)) => {
                return refuse(mark, format!("the tag `{tag}` was found; recipes have no tags"));
            }
            Event::Alias(_) | Event::Scalar(..) | Event::SequenceStart(..) | Event::MappingStart(..) => {
                let mut key = mark;
                match frames.last_mut() {
                    Some(Frame::Map(waiting @ None)) => {
                        let Event::Scalar(text, ..) = event else {
                            return refuse(mark, "a key has to be text or a number".to_owned());
                        };
                        if text == "<<" {
                            return refuse(mark, "merge keys (`<<`) are not read: write the settings out".to_owned());
                        }
                        *waiting = Some(mark);
                        path.push(PathItem::Key(text.to_string()));
                        if places.contains_key(&path) {
                            return refuse(mark, format!("the key `{text}` stands here a second time"));
                        }
                        continue;
                    }
                    Some(Frame::Map(Some(waiting))) => key = *waiting,
                    Some(Frame::List(next)) => {
                        path.push(PathItem::Index(*next));
                        *next += 1;
                    }
                    None => {}
                }
                places.insert(path.clone(), Marks { key, value: mark });
                if places.len() > MOST_VALUES {
                    return refuse(mark, format!("{MOST_VALUES} values stand before this one; more are not read"));
                }
                match event {
                    Event::SequenceStart(..) | Event::MappingStart(..) if frames.len() == DEEPEST => {
                        return refuse(mark, too_deep());
                    }
                    Event::SequenceStart(..) => frames.push(Frame::List(0)),
                    Event::MappingStart(..) => frames.push(Frame::Map(None)),
                    Event::Scalar(text, ScalarStyle::Plain, ..) if is_not_finite(&text) => {
                        return refuse(mark, format!("{}: a finite number was expected, not {text}", path_text(&path)));
                    }
                    _ => close(&mut frames, &mut path),
                }
            }
            _ => {}
        }
    }
    Ok(places)
}

/// Line and column of the first control character that YAML does not allow.
fn control_character(text: &str) -> Option<(usize, usize)> {
    let is_wrong = |letter: char| letter.is_control() && !matches!(letter, '\t' | '\n' | '\r' | '\u{85}');
    let lines = text.split('\n').enumerate();
    lines.filter_map(|(line, text)| Some((line + 1, text.chars().position(is_wrong)? + 1))).next()
}

/// A value has ended: its container goes on.
fn close(frames: &mut [Frame], path: &mut Vec<PathItem>) {
    path.pop();
    if let Some(Frame::Map(waiting)) = frames.last_mut() {
        *waiting = None;
    }
}

/// Whether YAML means infinity or "not a number"; JSON values would make `null` of both.
fn is_not_finite(text: &str) -> bool {
    matches!(text.trim_start_matches(['+', '-']), ".inf" | ".Inf" | ".INF" | ".nan" | ".NaN" | ".NAN")
}
