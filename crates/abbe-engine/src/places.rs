//! Paths of the files of a recipe when it is copied into a new folder.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use abbe_core::{Error, Result};

/// Paths of files inside the folder, and how the recipe has to name them there.
pub(crate) struct Places<'a> {
    base: &'a Path,
    taken: BTreeMap<PathBuf, PathBuf>,
    /// Folders as written in the recipe, with their new names, and whether the recipe has to contain them.
    folders: BTreeMap<String, (String, bool)>,
}

impl<'a> Places<'a> {
    pub(crate) fn new(base: &'a Path) -> Self {
        Self { base, taken: BTreeMap::new(), folders: BTreeMap::new() }
    }

    /// Reserves a path for a file.
    pub(crate) fn take(&mut self, place: &Path, source: &Path) -> Result<()> {
        match self.taken.insert(place.to_owned(), source.to_owned()) {
            Some(other) if other != source => Err(Error::usage(format!(
                "`{}` and `{}` would both be written to `{}`",
                other.display(),
                source.display(),
                place.display()
            ))
            .help("rename one of them")),
            _ => Ok(()),
        }
    }

    /// The path of a file inside the folder: its path in the recipe without components that lead out of the recipe's folder.
    pub(crate) fn of(&mut self, source: &Path) -> Result<PathBuf> {
        let written = source.strip_prefix(self.base).unwrap_or(source);
        let normal = written.components().filter(|part| matches!(part, Component::Normal(_)));
        let place: PathBuf = normal.collect();
        self.take(&place, source)?;
        let target = folder(&place);
        let leads_out = written.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir));
        if leads_out {
            self.folders.insert(folder(written), (target, true));
        } else if source.is_absolute() {
            // The recipe may name it by its absolute path, too.
            self.folders.insert(folder(source), (target, false));
        }
        Ok(place)
    }

    /// The text of the recipe with the folders as they are named inside the folder.
    pub(crate) fn adapt(&self, text: &str) -> Result<String> {
        let mut adapted = text.to_owned();
        let mut folders: Vec<_> = self.folders.iter().collect();
        folders.sort_by_key(|(from, _)| std::cmp::Reverse(from.len()));
        for (from, (to, needed)) in folders {
            let (next, count) = replaced(&adapted, from, to);
            if *needed && count == 0 {
                return Err(Error::usage(format!("the recipe does not write the folder `{from}` as it is")).help(
                    "write paths that lead out of the recipe's folder without escapes, or copy these files into it",
                ));
            }
            adapted = next;
        }
        Ok(adapted)
    }
}

/// The folder of a file with a closing slash; empty if it has none.
fn folder(file: &Path) -> String {
    match file.parent() {
        Some(folder) if folder == Path::new("/") => "/".to_owned(),
        Some(folder) if folder != Path::new("") => format!("{}/", folder.display()),
        _ => String::new(),
    }
}

/// The text with `from` replaced wherever a path begins with it, and how often that is.
fn replaced(text: &str, from: &str, to: &str) -> (String, usize) {
    let (mut out, mut rest, mut count) = (String::with_capacity(text.len()), text, 0);
    while let Some(at) = rest.find(from) {
        let begins = !rest[..at].ends_with(|c: char| c.is_alphanumeric() || matches!(c, '.' | '/' | '_' | '-'));
        out.push_str(&rest[..at]);
        out.push_str(if begins { to } else { from });
        count += usize::from(begins);
        rest = &rest[at + from.len()..];
    }
    out.push_str(rest);
    (out, count)
}
