//! The history that results go to.

use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_engine::{refuse_temporary_place, temporary_file};
use abbe_history::{Added, Entry, History};
use abbe_recipe::HistoryPlace;

use crate::unwritable;

/// A history to which entries are added.
pub struct Keeper {
    history: History,
    /// The file that it becomes, if it is new: whole or not at all.
    new: Option<PathBuf>,
}

impl Keeper {
    /// Opens a file, or connects to a server.
    pub fn open(place: &str) -> Result<Self> {
        let place = HistoryPlace::parse(place).map_err(|wrong| Error::usage(format!("the history: {wrong}")))?;
        match place {
            HistoryPlace::Server(address) => Ok(Self { history: History::on_server(&address)?, new: None }),
            HistoryPlace::File(path) if path.symlink_metadata().is_ok() => {
                Ok(Self { history: History::open(&path)?, new: None })
            }
            HistoryPlace::File(path) => {
                refuse_temporary_place(&path)?;
                Ok(Self { history: History::new(&path)?, new: Some(path) })
            }
        }
    }

    /// Adds an entry; whether it is new.
    pub fn add(&mut self, entry: &Entry) -> Result<bool> {
        Ok(matches!(self.history.add(entry)?, Added::New(_)))
    }

    /// Puts a new history at its place; how many entries were not new after all. Where another command has made one in the meantime
    /// entries are added to that.
    pub fn finish(self) -> Result<usize> {
        let Some(path) = self.new else { return Ok(0) };
        let cannot = |error: &io::Error| unwritable(&path, error);
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let file = temporary_file(folder).map_err(|error| cannot(&error))?;
        self.history.save(file.path())?;
        file.as_file().sync_all().map_err(|error| cannot(&error))?;
        match file.persist_noclobber(&path) {
            Ok(_) => Ok(0),
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => add_all(&self.history, &path),
            Err(error) => Err(cannot(&error.error)),
        }
    }
}

/// Adds all entries of a history to that in a file; how many of them it had already.
fn add_all(from: &History, path: &Path) -> Result<usize> {
    let mut to = History::open(path)?;
    let mut known = 0;
    for (number, ..) in from.entries()? {
        let Some(entry) = from.entry(number)? else { continue };
        known += usize::from(matches!(to.add(&entry)?, Added::Known(_)));
    }
    Ok(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(recipe: &str) -> Entry {
        let evidence = serde_json::json!({ "inputs": [recipe] });
        Entry { recipe: recipe.to_owned(), calibrations: Vec::new(), verdicts: Vec::new(), evidence }
    }

    /// Two of them find no history, and both make one: the later one adds to that of the other.
    #[test]
    fn a_history_that_came_in_the_meantime_takes_the_entries() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plant.sqlite");
        let place = path.to_str().unwrap();
        let (mut one, mut other) = (Keeper::open(place).unwrap(), Keeper::open(place).unwrap());
        for recipe in ["a", "b"] {
            assert!(one.add(&entry(recipe)).unwrap());
        }
        for recipe in ["b", "c", "a"] {
            assert!(other.add(&entry(recipe)).unwrap());
        }
        assert_eq!(one.finish().unwrap(), 0);
        assert_eq!(other.finish().unwrap(), 2);
        let kept = History::read(&path).unwrap().entries().unwrap();
        let recipes: Vec<&str> = kept.iter().map(|(_, _, recipe)| recipe.as_str()).collect();
        assert_eq!(recipes, ["a", "b", "c"]);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        // What is no history stays, and is told.
        let other = Keeper::open(folder.path().join("more.sqlite").to_str().unwrap()).unwrap();
        std::fs::write(folder.path().join("more.sqlite"), "call the plant, it was late, and nobody was there any more")
            .unwrap();
        assert!(other.finish().unwrap_err().message.contains("no history"));
        assert!(std::fs::read_to_string(folder.path().join("more.sqlite")).unwrap().starts_with("call"));
    }
}
