//! Where a history is: opened to read, or to add to it.

use std::io;
use std::path::Path;

use abbe_core::{Error, Result};
use abbe_engine::{refuse_temporary_place, temporary_file};
use abbe_history::{Added, Entry, History};
use abbe_recipe::HistoryPlace;

use crate::outputs::cannot_be_written;

/// The place that somebody names on the command line. The message does not repeat it: it may hold a password.
pub(super) fn named(place: &Path) -> Result<HistoryPlace> {
    match place.to_str() {
        Some(text) => HistoryPlace::parse(text).map_err(|wrong| Error::usage(format!("the history: {wrong}"))),
        None => Ok(HistoryPlace::File(place.to_owned())),
    }
}

/// Opens the history that somebody names, to read it.
pub fn read(place: &Path) -> Result<History> {
    match named(place)? {
        HistoryPlace::File(path) => History::read(&path),
        HistoryPlace::Server(address) => History::read_server(&address),
    }
}

/// Fails for a file that is there and is no history, for one whose folder is not there, and for a name of temporary folders, before
/// anything is made for it.
pub fn can_add(place: &HistoryPlace) -> Result<()> {
    if let HistoryPlace::File(path) = place {
        refuse_temporary_place(path)?;
    }
    let HistoryPlace::File(path) = place else { return Ok(()) };
    match path.metadata() {
        Ok(found) if found.is_file() && found.len() == 0 => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => match std::fs::metadata(folder_of(path)) {
            Ok(folder) if folder.is_dir() => Ok(()),
            Ok(_) => Err(cannot_be_written(path, &io::ErrorKind::NotADirectory.into())),
            Err(error) => Err(cannot_be_written(path, &error)),
        },
        _ => History::read(path).map(drop),
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Adds entries.
pub(super) fn add_all(place: &HistoryPlace, entries: &[Entry]) -> Result<Vec<Added>> {
    match place {
        HistoryPlace::File(path) => add_to_file(path, entries),
        HistoryPlace::Server(address) => added(&mut History::on_server(address)?, entries),
    }
}

fn added(history: &mut History, entries: &[Entry]) -> Result<Vec<Added>> {
    entries.iter().map(|entry| history.add(entry)).collect()
}

/// Adds entries to a file. A history that is not there is made whole with them, or not at all.
fn add_to_file(path: &Path, entries: &[Entry]) -> Result<Vec<Added>> {
    if path.symlink_metadata().is_err() {
        let mut history = History::new(path)?;
        let numbers = added(&mut history, entries)?;
        let cannot = |error: &io::Error| cannot_be_written(path, error);
        let file = temporary_file(folder_of(path)).map_err(|error| cannot(&error))?;
        history.save(file.path())?;
        file.as_file().sync_all().map_err(|error| cannot(&error))?;
        match file.persist_noclobber(path) {
            Ok(_) => return Ok(numbers),
            // Another program made it in the meantime.
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(cannot(&error.error)),
        }
    }
    added(&mut History::open(path)?, entries)
}
