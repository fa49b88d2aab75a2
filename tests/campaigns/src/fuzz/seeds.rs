//! Where inputs begin: files of the repository.

use std::fs;
use std::path::{Path, PathBuf};

use super::LONGEST;

/// The folder of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A file, cut where it is longer than any input.
pub fn file(path: &str) -> Vec<u8> {
    let path = root().join(path);
    let mut content = fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    content.truncate(LONGEST);
    content
}

/// The files of a folder, and of those in it, whose names end so; in order, those only that are no longer than an input.
pub fn folder(path: &str, ends: &[&str]) -> Vec<Vec<u8>> {
    let mut found = Vec::new();
    walk(&root().join(path), ends, &mut found);
    found.sort();
    assert!(!found.is_empty(), "{path} has no files that end with {ends:?}");
    let contents = found.iter().map(|file| fs::read(file).expect("a file of the repository"));
    contents.filter(|content| content.len() <= LONGEST).collect()
}

fn walk(folder: &Path, ends: &[&str], found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of the repository").flatten() {
        let path = entry.path();
        match path.is_dir() {
            true => walk(&path, ends, found),
            false if ends.iter().any(|end| path.to_string_lossy().ends_with(end)) => found.push(path),
            false => {}
        }
    }
}

/// Texts as seeds.
pub fn texts<const N: usize>(texts: [&str; N]) -> Vec<Vec<u8>> {
    texts.map(|text| text.as_bytes().to_vec()).to_vec()
}
