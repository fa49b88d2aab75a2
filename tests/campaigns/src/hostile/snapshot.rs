//! What lies in a folder, without following links: to tell what is lost, and what is half-written.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// What a path is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Entry {
    File(Vec<u8>),
    Folder,
    Link(PathBuf),
    /// A pipe, a socket, a file too large to be kept.
    Other,
}

/// Everything under a folder.
pub type Snapshot = BTreeMap<PathBuf, Entry>;

/// Largest file whose content is kept.
const LARGEST: u64 = 64 << 20;

pub fn snapshot(folder: &Path) -> Snapshot {
    let mut found = Snapshot::new();
    add(folder, folder, &mut found);
    found
}

fn add(root: &Path, folder: &Path, found: &mut Snapshot) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let Ok(own) = path.symlink_metadata() else { continue };
        let kind = own.file_type();
        let entry = if kind.is_symlink() {
            Entry::Link(fs::read_link(&path).unwrap_or_default())
        } else if kind.is_dir() {
            Entry::Folder
        } else if kind.is_file() && own.len() <= LARGEST {
            Entry::File(fs::read(&path).unwrap_or_default())
        } else {
            Entry::Other
        };
        if entry == Entry::Folder {
            add(root, &path, found);
        }
        found.insert(path.strip_prefix(root).unwrap_or(&path).to_owned(), entry);
    }
}

/// Paths that are gone, or are something else now.
pub fn lost(before: &Snapshot, after: &Snapshot) -> Vec<PathBuf> {
    before.iter().filter(|(path, entry)| after.get(*path) != Some(entry)).map(|(path, _)| path.clone()).collect()
}

/// Paths that are new.
pub fn new(before: &Snapshot, after: &Snapshot) -> Vec<PathBuf> {
    after.keys().filter(|path| !before.contains_key(*path)).cloned().collect()
}

/// Paths of work that was begun and not ended.
pub fn half_written(after: &Snapshot) -> Vec<PathBuf> {
    let is_partial =
        |path: &&PathBuf| path.to_string_lossy().contains("abbe-partial") || path.to_string_lossy().contains(".tmp");
    after.keys().filter(is_partial).cloned().collect()
}
