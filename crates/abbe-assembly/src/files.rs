//! Which files a path in the settings stands for.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

use abbe_core::{Context, matches};

/// A path in the settings.
#[derive(Debug)]
pub struct Source {
    /// The path, with its `*` and `?` if it has any.
    pub path: PathBuf,
    pattern: Option<String>,
}

impl Source {
    /// Fails if a folder is a pattern.
    pub fn new(path: &str, context: &Context) -> Result<Self, String> {
        let is_pattern = |text: &str| text.contains(['*', '?']);
        let written = Path::new(path);
        if written.parent().and_then(Path::to_str).is_some_and(is_pattern) {
            return Err(format!("`*` and `?` may stand in the name of a file, not of a folder as in `{path}`"));
        }
        let name = written.file_name().and_then(OsStr::to_str).filter(|name| is_pattern(name));
        Ok(Self { path: context.path(path), pattern: name.map(str::to_owned) })
    }

    /// The files, in natural order, and whatever else matches a pattern; none only if nothing does.
    pub fn files(&self) -> Vec<PathBuf> {
        let Some(pattern) = &self.pattern else { return vec![self.path.clone()] };
        let folder = match self.path.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        // What no text in UTF-8 names, and what is no file, is there all the same: who reads it says so.
        let mut names: Vec<(String, OsString)> = fs::read_dir(folder)
            .into_iter()
            .flatten()
            .filter_map(|entry| entry.ok().map(|entry| entry.file_name()))
            .map(|name| (name.to_string_lossy().into_owned(), name))
            // Editors and file managers leave hidden files: these match only a pattern that begins with a dot.
            .filter(|(text, _)| matches(pattern, text) && text.starts_with('.') == pattern.starts_with('.'))
            .collect();
        names.sort_by(|(a, own), (b, other)| natural(a).cmp(&natural(b)).then_with(|| own.cmp(other)));
        names.into_iter().map(|(_, name)| self.path.with_file_name(name)).collect()
    }
}

/// A part of a name, ordered as people do.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part<'a> {
    /// Number of digits and digits, without leading zeros.
    Number(usize, &'a str),
    Text(&'a str),
}

fn natural(name: &str) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(first) = rest.chars().next() {
        let digits = first.is_ascii_digit();
        let end = rest.find(|c: char| c.is_ascii_digit() != digits).unwrap_or(rest.len());
        let (part, after) = rest.split_at(end);
        parts.push(if digits {
            let number = part.trim_start_matches('0');
            Part::Number(number.len(), number)
        } else {
            Part::Text(part)
        });
        rest = after;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::natural;

    #[test]
    fn names_are_ordered_as_people_do() {
        let sorted = ["1.csv", "bar.csv", "bar-1.csv", "bar-02.csv", "bar-2b.csv", "bar-10.csv", "bar-10-1.csv"];
        let mut names = sorted;
        names.reverse();
        names.sort_by(|a, b| natural(a).cmp(&natural(b)));
        assert_eq!(names, ["1.csv", "bar-1.csv", "bar-02.csv", "bar-2b.csv", "bar-10-1.csv", "bar-10.csv", "bar.csv"]);
    }
}
