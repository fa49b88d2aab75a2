//! Libraries whose manifest says that they have no unit tests (`test = false`), or no examples in their documentation
//! (`doctest = false`): to build them once more for tests, or to read them once more for examples, would take time and find none. What
//! a manifest says has to stay true.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::Outcome;

/// What a manifest may say that a library lacks: the key, what would never run, and whether a text has some.
type Claim = (&'static str, &'static str, fn(&str) -> bool);

const CLAIMS: [Claim; 2] = [("test", "unit tests", has_unit_tests), ("doctest", "examples", has_examples)];

/// Fails if a library has tests that would never run.
pub fn check(packages: &[Value]) -> Outcome {
    let mut wrong = Vec::new();
    for package in packages {
        for target in package["targets"].as_array().into_iter().flatten() {
            let is_library = target["kind"].as_array().is_some_and(|kinds| kinds.iter().any(|kind| kind == "lib"));
            let Some(folder) = target["src_path"].as_str().map(Path::new).and_then(Path::parent) else { continue };
            let claimed: Vec<Claim> = CLAIMS.into_iter().filter(|(key, ..)| target[*key] == false).collect();
            if !is_library || claimed.is_empty() {
                continue;
            }
            for file in sources(folder)? {
                let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
                wrong.extend(claimed.iter().filter(|(.., has)| has(&text)).map(|(key, what, _)| {
                    format!("{} has {what}, and its Cargo.toml says `{key} = false`", file.display())
                }));
            }
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("; ")) }
}

fn has_unit_tests(text: &str) -> bool {
    ["#[test]", "#[cfg(test)]"].iter().any(|mark| text.contains(mark))
}

/// Whether the documentation has a block of code, between fences or indented.
fn has_examples(text: &str) -> bool {
    let told = |line| str::strip_prefix(line, "///").or_else(|| str::strip_prefix(line, "//!"));
    let lines: Vec<&str> = text.lines().filter_map(|line| told(line.trim_start())).collect();
    let fenced = lines.iter().any(|line| line.trim_start().starts_with("```"));
    fenced || lines.windows(2).any(|pair| pair[0].trim().is_empty() && pair[1].starts_with("     "))
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

    #[test]
    fn examples_are_seen() {
        assert!(has_examples("/// Adds.\n///\n/// ```\n/// add(1, 2);\n/// ```\nfn add() {}\n"));
        assert!(has_examples("    //! Adds:\n    //!\n    //!     add(1, 2);\n"));
        assert!(!has_examples("/// A list:\n/// - of one,\n///   which is long\nfn list() {}\n// ```\n"));
    }
}
