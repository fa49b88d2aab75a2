//! New folders, written whole or not at all.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};

use crate::results::{as_it_was, kept_beside, parent, real};
use crate::staging::{Staging, can_write, exclusive_access, unwritable};

/// Fails early if a new folder cannot be written at `out`. `out` has to be empty or not to exist.
pub fn can_write_folder(out: &Path) -> Result<()> {
    is_free(out)?;
    can_write(parent(&real(out)), out)
}

/// Fails if something is at `out`.
fn is_free(out: &Path) -> Result<()> {
    // `f/` is the file f: a slash at its end does not make it a folder.
    let out: &Path = &out.components().collect::<PathBuf>();
    if out.is_symlink() && !out.is_dir() {
        return Err(Error::data(format!("{} is a link that leads to no folder", out.display()))
            .help("remove it, or name another folder"));
    }
    if out.exists() && !out.is_dir() {
        return Err(Error::data(format!("{} is there already, and is no folder", out.display()))
            .help("move it away, or name another folder"));
    }
    let is_empty = || fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_none());
    if out.exists() && !is_empty() {
        return Err(Error::data(format!("{} is there already and not empty", out.display()))
            .help("move it away, or name another folder"));
    }
    // The new folder takes the place of an empty one, and whoever works in that one would be nowhere.
    let is_here = || Some(fs::canonicalize(out).ok()? == fs::canonicalize(std::env::current_dir().ok()?).ok()?);
    if is_here() == Some(true) {
        return Err(Error::data(format!("{} is the folder that this command runs in", out.display()))
            .help("name a new folder in it"));
    }
    Ok(())
}

/// Writes files, whose names are relative to it, into the folder `out`: whole or not at all. If something has come there since it was
/// [looked at](can_write_folder), they are written beside it, and the error says where.
pub fn write_folder(out: &Path, files: &BTreeMap<PathBuf, Vec<u8>>) -> Result<()> {
    let failed = |error: io::Error| unwritable(out, &error);
    let place = real(out);
    let staging = Staging::new(parent(&place), out)?;
    for (name, content) in files {
        staging.write(name, content).map_err(failed)?;
    }
    // Two commands that write the same folder do so one after the other.
    let _access = exclusive_access(parent(&place));
    let taken = is_free(out).and_then(|()| take(staging.path(), &place).map_err(failed));
    match taken {
        Ok(()) => {
            // The folder has been renamed: there is nothing to clean up.
            let _ = staging.keep();
            Ok(())
        }
        Err(error) => Err(kept_beside(staging, &place, error)),
    }
}

/// Moves a folder to where an empty one is, whose permissions and owner it takes, or nothing. Where that fails the empty one stays.
fn take(new: &Path, place: &Path) -> io::Result<()> {
    // Nothing is there as a rule, and a disk may know no owners.
    let _ = as_it_was(place, new, false);
    fs::rename(new, place).or_else(|error| match fs::remove_dir(place) {
        // Not every system replaces an empty folder.
        Ok(()) => fs::rename(new, place).inspect_err(|_| drop(fs::create_dir(place))),
        Err(_) => Err(error),
    })
}
