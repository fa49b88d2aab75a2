//! Libraries whose manifest says that they have no unit tests (`test = false`): to build them once more for tests would take time and
//! find none. What a manifest says has to stay true.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::Outcome;

/// What makes a unit test.
const UNIT_TESTS: [&str; 2] = ["#[test]", "#[cfg(test)]"];

/// Fails if a library has tests that would never run.
pub fn check(packages: &[Value]) -> Outcome {
    let mut wrong = Vec::new();
    for package in packages {
        for target in package["targets"].as_array().into_iter().flatten() {
            let is_library = target["kind"].as_array().is_some_and(|kinds| kinds.iter().any(|kind| kind == "lib"));
            let Some(folder) = target["src_path"].as_str().map(Path::new).and_then(Path::parent) else { continue };
            if !is_library || target["test"] != false {
                continue;
            }
            for file in sources(folder)? {
                let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
                if has_unit_tests(&text) {
                    wrong.push(format!("{} has unit tests, and its Cargo.toml says `test = false`", file.display()));
                }
            }
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("; ")) }
}

fn has_unit_tests(text: &str) -> bool {
    UNIT_TESTS.iter().any(|mark| text.contains(mark))
}

/// The Rust files of a folder and of those below it.
fn sources(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut found = Vec::new();
    for path in entries.flatten().map(|entry| entry.path()) {
        if path.is_dir() {
            found.extend(sources(&path)?);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_tests_are_seen() {
        assert!(has_unit_tests("#[cfg(test)]\nmod tests;\n"));
        assert!(!has_unit_tests("//! tests are elsewhere\n"));
    }
}
