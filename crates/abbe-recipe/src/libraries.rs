//! The plugin libraries that a recipe names.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Place};

use crate::document::{At, Node};

/// Longest time without an answer from an isolated plugin, unless the recipe states another, s.
const TIME_LIMIT_S: f64 = 60.0;

/// Largest time limit, for one answer or for all, s: a day.
const LONGEST_LIMIT_S: f64 = 86_400.0;

/// A library with plugins that a recipe asks for.
#[derive(Debug, Clone, PartialEq)]
pub struct Library {
    /// Its file, as it can be opened.
    pub path: PathBuf,
    /// The SHA-256 that the file has to have, as written.
    pub sha256: Option<String>,
    /// Limits if its plugins run in processes of their own. That is so unless the file is pinned, or the recipe says otherwise.
    pub isolate: Option<Isolation>,
    /// Where the recipe names it.
    pub place: Option<Place>,
}

/// Limits of the process of an isolated plugin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Isolation {
    /// Longest time without an answer, s.
    pub time_limit_s: f64,
    /// Longest time of a stage altogether, s.
    pub total_time_limit_s: f64,
    /// Memory, MiB; none: the usual limit.
    pub memory_limit_mib: Option<u64>,
    /// Whether the recipe asks for it; else it is so because nobody pins the file.
    pub is_asked_for: bool,
}

impl Default for Isolation {
    fn default() -> Self {
        Self {
            time_limit_s: TIME_LIMIT_S,
            total_time_limit_s: LONGEST_LIMIT_S,
            memory_limit_mib: None,
            is_asked_for: false,
        }
    }
}

/// Smallest and largest limit of memory, MiB.
const MEMORY_MIB: RangeInclusive<u64> = 64..=1 << 20;

/// The libraries under the key `plugins`.
pub fn libraries(root: &Node<'_>, base: &Path) -> Result<Vec<Library>, Error> {
    let Some(plugins) = root.get("plugins") else { return Ok(Vec::new()) };
    let library = |node: Node<'_>| {
        node.only(&["path", "sha256", "isolate", "time_limit_s", "total_time_limit_s", "memory_limit_mib"])?;
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

/// Whether a library's plugins are isolated, and the limits then. Who pins a file trusts it.
fn isolation(node: &Node<'_>) -> Result<Option<Isolation>, Error> {
    let isolate = match node.get("isolate") {
        None => node.get("sha256").is_none(),
        Some(isolate) => {
            isolate.value.as_bool().ok_or_else(|| isolate.error(At::Value, "isolate: true or false was expected"))?
        }
    };
    for key in ["time_limit_s", "total_time_limit_s", "memory_limit_mib"] {
        if let Some(limit) = node.get(key).filter(|_| !isolate) {
            let message = format!("`{key}` holds for plugins that are isolated");
            return Err(limit.error(At::Key, message).help("add `isolate: true`"));
        }
    }
    let mut limits = Isolation { is_asked_for: node.get("isolate").is_some(), ..Isolation::default() };
    for (key, into) in
        [("time_limit_s", &mut limits.time_limit_s), ("total_time_limit_s", &mut limits.total_time_limit_s)]
    {
        let Some(limit) = node.get(key) else { continue };
        let message = format!("{key}: a number above 0, at most {LONGEST_LIMIT_S}, was expected");
        let seconds = limit.value.as_f64().filter(|limit| *limit > 0.0 && *limit <= LONGEST_LIMIT_S);
        *into = seconds.ok_or_else(|| limit.error(At::Value, message))?;
    }
    if let Some(limit) = node.get("memory_limit_mib") {
        let (least, most) = (MEMORY_MIB.start(), MEMORY_MIB.end());
        let message = format!("memory_limit_mib: a whole number from {least} to {most} was expected");
        let mib = limit.value.as_u64().filter(|mib| MEMORY_MIB.contains(mib));
        limits.memory_limit_mib = Some(mib.ok_or_else(|| limit.error(At::Value, message))?);
    }
    Ok(isolate.then_some(limits))
}
