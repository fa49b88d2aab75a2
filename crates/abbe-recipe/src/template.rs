//! A recipe that is used many times, with other values of some of its settings.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{Error, Registry};
use serde_json::{Map, Value};

use crate::document::Document;
use crate::{HISTORY, PLAN, Recipe, read_text};

/// The text of a recipe, read once. Messages about a setting that was replaced point at its place in this text.
#[derive(Debug, Clone)]
pub struct Template {
    path: PathBuf,
    text: Arc<str>,
    document: Document,
}

impl Template {
    /// Reads a file; messages and paths in the recipe are as if it were at `path`. What its stages are is not looked at before
    /// [`Template::recipe`].
    ///
    /// # Errors
    /// For a file that cannot be read or is no YAML.
    pub fn read(file: &Path, path: &Path) -> Result<Self, Error> {
        let text = read_text(file)?;
        Ok(Self { path: path.to_owned(), document: Document::parse(path, &text)?, text: text.into() })
    }

    /// What the recipe says, as JSON.
    pub fn value(&self) -> &Value {
        &self.document.value
    }

    /// The names of its stages.
    pub fn stages(&self) -> Vec<&str> {
        let stages = self.document.value.get("stages").and_then(Value::as_object);
        stages.into_iter().flatten().map(|(name, _)| name.as_str()).collect()
    }

    /// Sets a setting of a stage: `way` begins with the name of the stage; an entry of a list is named by its number, from 0. A
    /// setting that is not there is added.
    ///
    /// # Errors
    /// For a stage that is not there, and for a way through something that is neither a map nor a list.
    pub fn set(&mut self, way: &[String], value: Value) -> Result<(), Error> {
        let [stage, rest @ ..] = way else { return Err(nothing_named()) };
        if rest.is_empty() {
            return Err(nothing_named());
        }
        let names: Vec<String> = self.stages().into_iter().map(str::to_owned).collect();
        let Some(mut place) = self.document.value.get_mut("stages").and_then(|stages| stages.get_mut(stage)) else {
            let error = Error::usage(format!("{} has no stage `{stage}`", self.path.display()));
            let all = format!("its stages are: {}", names.join(", "));
            return Err(error.help(all).suggest(stage, names.iter().map(String::as_str)));
        };
        for key in rest {
            if place.is_null() {
                *place = Value::Object(Map::new());
            }
            let next = match place {
                Value::Object(map) => Some(map.entry(key.clone()).or_insert(Value::Null)),
                Value::Array(list) => key.parse().ok().and_then(|index: usize| list.get_mut(index)),
                _ => None,
            };
            place = next.ok_or_else(|| {
                let message = format!("`{}` leads to no setting of {}", way.join("."), self.path.display());
                Error::usage(message).help("name keys of maps, and numbers of entries of lists from 0")
            })?;
        }
        *place = value;
        Ok(())
    }

    /// Leaves out stages; and what is planned and where results are kept, which is for a run by itself.
    pub fn keep(&mut self, is_kept: impl Fn(&str) -> bool) {
        let Value::Object(root) = &mut self.document.value else { return };
        root.shift_remove(PLAN);
        root.shift_remove(HISTORY);
        if let Some(Value::Object(stages)) = root.get_mut("stages") {
            stages.retain(|name, _| is_kept(name));
        }
    }

    /// The recipe, as [`Recipe::read`] gives it.
    ///
    /// # Errors
    /// As [`Recipe::read`].
    pub fn recipe(&self, registry: &Registry) -> Result<Recipe, Error> {
        Recipe::of_document(&self.path, &self.text, self.document.clone(), registry)
    }
}

fn nothing_named() -> Error {
    Error::usage("the name of a stage and a setting were expected, as `touches.path`")
}
