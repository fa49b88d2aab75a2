//! New folders, written whole or not at all.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};

use crate::staging::{Staging, can_write, unwritable};

/// Fails early if a new folder cannot be written at `out`. `out` has to be empty or not to exist.
pub fn can_write_folder(out: &Path) -> Result<()> {
    if out.is_symlink() && !out.is_dir() {
        return Err(Error::data(format!("{} is a link that leads to no folder", out.display()))
            .help("remove it, or name another folder with `--out`"));
    }
    if out.exists() && !out.is_dir() {
        return Err(Error::data(format!("{} is there already, and is no folder", out.display()))
            .help("move it away, or name another folder with `--out`"));
    }
    let is_empty = || fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_none());
    if out.exists() && !is_empty() {
        return Err(Error::data(format!("{} is there already and not empty", out.display()))
            .help("move it away, or name another folder with `--out`"));
    }
    can_write(parent(out))
}

/// Writes files, whose names are relative to it, into the folder `out`: whole or not at all. It has to be empty or not to exist.
pub fn write_folder(out: &Path, files: &BTreeMap<PathBuf, Vec<u8>>) -> Result<()> {
    can_write_folder(out)?;
    let failed = |error: io::Error| unwritable(parent(out), &error);
    // Where a link stands, the folder that it leads to is written.
    let place = if out.is_symlink() { fs::canonicalize(out).map_err(failed)? } else { out.to_owned() };
    let (out, parent) = (place.as_path(), parent(&place));
    let staging = Staging::new(parent)?;
    for (name, content) in files {
        staging.write(name, content).map_err(failed)?;
    }
    if out.exists() {
        fs::remove_dir(out).map_err(failed)?;
    }
    fs::rename(staging.path(), out).map_err(failed)?;
    // The folder has been renamed: there is nothing to clean up.
    let _ = staging.keep();
    Ok(())
}

fn parent(out: &Path) -> &Path {
    out.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."))
}
