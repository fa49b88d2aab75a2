//! The history that results go to.

use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_engine::temporary_file;
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
            HistoryPlace::File(path) => Ok(Self { history: History::new(&path)?, new: Some(path) }),
        }
    }

    /// Adds an entry; whether it is new.
    pub fn add(&mut self, entry: &Entry) -> Result<bool> {
        Ok(matches!(self.history.add(entry)?, Added::New(_)))
    }

    /// Puts a new history at its place.
    pub fn finish(self) -> Result<()> {
        let Some(path) = self.new else { return Ok(()) };
        let cannot = |error: &io::Error| unwritable(&path, error);
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let file = temporary_file(folder).map_err(|error| cannot(&error))?;
        self.history.save(file.path())?;
        file.as_file().sync_all().map_err(|error| cannot(&error))?;
        file.persist_noclobber(&path).map(drop).map_err(|error| cannot(&error.error))
    }
}
