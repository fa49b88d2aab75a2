//! What somebody named in the place of a manifest.

use std::path::Path;

use abbe_core::{Error, harmless};
use abbe_files::{LARGEST_TEXT, read_text};
use abbe_recipe::yaml::Document;

use crate::manifest::Manifest;

/// The error for a file that is no manifest: what it seems to be, what was expected, what to do.
pub fn instead(path: &Path) -> Error {
    let wrong = |what: &str, help: String| {
        let message = format!("{what}: a manifest was expected, which `abbe fleet plan FLEET.yaml` writes");
        Error::usage(message).in_file(path).help(help)
    };
    let text = read_text(path, LARGEST_TEXT).unwrap_or_default();
    let document = Document::parse(path, &text).ok();
    let has = |key: &str| document.as_ref().is_some_and(|document| document.root().get(key).is_some());
    if has("abbe_fleet") {
        let (fleet, manifest) = (path.display().to_string(), Manifest::beside(path).display().to_string());
        let (fleet, manifest) = (harmless(&fleet), harmless(&manifest));
        return wrong(
            "this is what a fleet is planned from",
            format!("`abbe fleet plan {fleet}` writes {manifest}: name that"),
        );
    }
    if has("stages") {
        let help = "write a file that names the recipe and what is done with it, as docs/fleets.md shows, and plan it";
        return wrong("this is a recipe", format!("{help}; `abbe run` does a recipe once"));
    }
    let help = "plan the fleet, and name the file that ends in `.manifest.jsonl`";
    wrong("this is no manifest of a fleet", help.to_owned())
}
