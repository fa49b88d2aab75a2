//! The plugin libraries that a recipe names.

use std::path::{Path, PathBuf};

use abbe_core::{Error, Place};

use crate::document::{At, Node};

/// Longest time without an answer from an isolated plugin, unless the recipe states another, s.
const TIME_LIMIT_S: f64 = 60.0;

/// Largest time limit for one answer, s: a day.
const LONGEST_LIMIT_S: f64 = 86_400.0;

/// A library with plugins that a recipe asks for.
#[derive(Debug, Clone, PartialEq)]
pub struct Library {
    /// Its file, as it can be opened.
    pub path: PathBuf,
    /// The SHA-256 that the file has to have, as written.
    pub sha256: Option<String>,
    /// Time limit if its plugins run in processes of their own: longest time without an answer, s.
    pub isolate: Option<f64>,
    /// Where the recipe names it.
    pub place: Option<Place>,
}

/// The libraries under the key `plugins`.
pub fn libraries(root: &Node<'_>, base: &Path) -> Result<Vec<Library>, Error> {
    let Some(plugins) = root.get("plugins") else { return Ok(Vec::new()) };
    let library = |node: Node<'_>| {
        node.only(&["path", "sha256", "isolate", "time_limit_s"])?;
        let missing = || node.missing(&["path"], "`path` is missing: the file of the library");
        let path = node.get("path").ok_or_else(missing)?;
        let sha256 = node.get("sha256").map(|pin| digest(&pin)).transpose()?;
        let isolate = isolation(&node)?;
        Ok(Library { path: base.join(path.text()?), sha256, isolate, place: path.error(At::Value, "").place })
    };
    plugins.list()?.into_iter().map(library).collect()
}

/// A SHA-256 in hexadecimal digits.
fn digest(node: &Node<'_>) -> Result<String, Error> {
    let text = node.text()?;
    match text.len() == 64 && text.chars().all(|c| c.is_ascii_hexdigit()) {
        true => Ok(text.to_owned()),
        false => {
            Err(node.error(At::Value, "sha256: 64 hexadecimal digits were expected").help("`sha256sum` prints them"))
        }
    }
}

/// Whether a library's plugins are isolated, and the time limit then.
fn isolation(node: &Node<'_>) -> Result<Option<f64>, Error> {
    let isolate = match node.get("isolate") {
        None => false,
        Some(isolate) => {
            isolate.value.as_bool().ok_or_else(|| isolate.error(At::Value, "isolate: true or false was expected"))?
        }
    };
    let Some(limit) = node.get("time_limit_s") else { return Ok(isolate.then_some(TIME_LIMIT_S)) };
    match limit.value.as_f64().filter(|limit| *limit > 0.0 && *limit <= LONGEST_LIMIT_S) {
        Some(_) if !isolate => {
            Err(limit.error(At::Key, "`time_limit_s` holds for plugins that are isolated").help("add `isolate: true`"))
        }
        Some(limit) => Ok(Some(limit)),
        None => {
            Err(limit
                .error(At::Value, format!("time_limit_s: a number above 0, at most {LONGEST_LIMIT_S}, was expected")))
        }
    }
}
