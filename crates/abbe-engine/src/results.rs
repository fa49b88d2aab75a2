//! The folder with the results of a run: it is replaced as a whole, and nothing in it that is not ours is touched.
//!
//! Ours is what an earlier run has written there and has listed in its `run.json`, as long as it still has the content that it had.
//! All else stays: notes, changed results, data that somebody keeps there, and every file that the run reads.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};

use crate::record::{RunRecord, sha256_of};
use crate::staging::{Staging, locked, unwritable};

/// The record of a run among its results.
pub(crate) const RECORD: &str = "run.json";

/// A folder for results, with what is in it already. Paths in it are relative.
pub(crate) struct ResultFolder {
    /// The folder; where a link to one stands, the folder that it leads to.
    place: PathBuf,
    /// What an earlier run wrote.
    ours: BTreeSet<PathBuf>,
    /// What somebody else has put there, or has changed.
    others: BTreeSet<PathBuf>,
}

impl ResultFolder {
    /// Looks at the folder `place`, which may not be there. `inputs` are the files that the run reads.
    ///
    /// Fails if something else than a folder is there, or a folder that holds something, but no results of a run.
    pub fn new(place: &Path, inputs: &[PathBuf]) -> Result<Self> {
        let none = |place: PathBuf| Self { place, ours: BTreeSet::new(), others: BTreeSet::new() };
        let Ok(found) = place.symlink_metadata() else { return Ok(none(place.to_owned())) };
        let real = if found.is_symlink() { fs::canonicalize(place).ok() } else { Some(place.to_owned()) };
        let Some(real) = real.filter(|real| real.is_dir()) else { return Err(no_results(place)) };
        let mut all = BTreeSet::new();
        list(&real, Path::new(""), &mut all).map_err(|error| unwritable(place, &error))?;
        if all.is_empty() {
            return Ok(none(real));
        }
        let record = fs::read_to_string(real.join(RECORD)).ok().and_then(|text| RunRecord::from_json(&text).ok());
        let Some(record) = record else { return Err(no_results(place)) };
        let inputs: BTreeSet<PathBuf> = inputs.iter().filter_map(|input| fs::canonicalize(input).ok()).collect();
        let mut folder = none(real);
        for name in all {
            let path = folder.place.join(&name);
            let is_input = fs::canonicalize(&path).is_ok_and(|path| inputs.contains(&path));
            let listed = record.outputs.iter().find(|output| Path::new(&output.file) == name);
            let unchanged = || listed.is_some_and(|output| has_content(&path, &output.sha256));
            let is_ours = !is_input && (name == Path::new(RECORD) || unchanged());
            if is_ours { &mut folder.ours } else { &mut folder.others }.insert(name);
        }
        Ok(folder)
    }

    /// Fails if a file of somebody else stands where a file of this name is to be written.
    pub fn can_take(&self, name: &Path) -> Result<()> {
        let in_the_way = |other: &&PathBuf| other.starts_with(name) || name.starts_with(other.as_path());
        let Some(other) = self.others.iter().find(in_the_way) else { return Ok(()) };
        let path = self.place.join(other);
        let message = format!("{} is in the way: an earlier run did not write it as it is now", path.display());
        Err(Error::data(message).help("move it away, or name another folder with `--out`"))
    }

    /// Puts written files in the place of the folder; what others have there stays. At any time the folder has all old results or all
    /// new ones.
    ///
    /// Fails if a file of others is in the way of a written one; the results are then beside the folder, and the message says where.
    pub fn replace_by(&self, staging: Staging) -> Result<()> {
        let failed = |error: io::Error| unwritable(&self.place, &error);
        let mut written = BTreeSet::new();
        list(staging.path(), Path::new(""), &mut written).map_err(failed)?;
        if let Err(error) = written.iter().try_for_each(|name| self.can_take(name)) {
            let beside = self.beside("new").map_err(failed)?;
            let (staged, _lock) = staging.keep();
            fs::rename(staged, &beside).map_err(failed)?;
            let help =
                format!("the results are in {}; move what is in the way, or name another folder", beside.display());
            return Err(error.help(help));
        }
        // A second name of the same file, so that it is in both folders while these change places.
        let (linked, unlinked): (Vec<&PathBuf>, Vec<&PathBuf>) =
            self.others.iter().partition(|name| link(&self.place.join(name), &staging.path().join(name)).is_ok());
        let (staged, _lock) = staging.keep();
        let Some(old) = exchange(&staged, &self.place).map_err(failed)? else { return Ok(()) };
        let _old_lock = locked(&old);
        for name in self.ours.iter().chain(linked) {
            remove(&old.join(name)).map_err(failed)?;
        }
        for name in unlinked {
            move_over(&old.join(name), &self.place.join(name)).map_err(failed)?;
        }
        self.clear(&old).map_err(failed)
    }

    /// Removes what is left of the old folder. What somebody has put there in the meantime moves over.
    fn clear(&self, old: &Path) -> io::Result<()> {
        let mut late = BTreeSet::new();
        list(old, Path::new(""), &mut late)?;
        for name in late.into_iter().filter(|name| !old.join(name).is_dir()) {
            if self.place.join(&name).symlink_metadata().is_ok() {
                return fs::rename(old, self.beside("old")?);
            }
            move_over(&old.join(&name), &self.place.join(&name))?;
        }
        fs::remove_dir_all(old)
    }

    /// A name beside the folder that nothing has yet.
    fn beside(&self, what: &str) -> io::Result<PathBuf> {
        let name = self.place.file_name().unwrap_or_default().to_string_lossy();
        let mut names = (1..10_000).map(|number| self.place.with_file_name(format!("{name}-{what}-{number}")));
        let free = names.find(|path| path.symlink_metadata().is_err());
        free.ok_or_else(|| io::Error::other("no name is free beside it"))
    }
}

fn no_results(place: &Path) -> Error {
    Error::data(format!("{} is there already and holds no results of a run", place.display()))
        .help("move it away, or name another folder with `--out`")
}

/// All that a folder has which is no folder, and empty folders, relative to it. Links are not followed.
fn list(folder: &Path, below: &Path, found: &mut BTreeSet<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = below.join(entry.file_name());
        let before = found.len();
        if entry.file_type()?.is_dir() {
            list(&entry.path(), &name, found)?;
        }
        if found.len() == before {
            found.insert(name);
        }
    }
    Ok(())
}

fn has_content(file: &Path, sha256: &str) -> bool {
    file.symlink_metadata().is_ok_and(|found| found.is_file()) && sha256_of(file).is_ok_and(|found| found == sha256)
}

/// Gives a file a second name, or makes an empty folder anew.
fn link(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    if from.symlink_metadata()?.is_dir() { fs::create_dir_all(to) } else { fs::hard_link(from, to) }
}

fn move_over(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::rename(from, to)
}

/// Removes a file or an empty folder.
fn remove(path: &Path) -> io::Result<()> {
    match path.symlink_metadata() {
        Ok(found) if found.is_dir() => fs::remove_dir(path),
        Ok(_) => fs::remove_file(path),
        Err(_) => Ok(()),
    }
}

/// Puts a folder in the place of another one; gives the path at which that one is then, if there was one.
///
/// If the system can exchange two folders in one step, the place always has the old folder or the new one, even if the program
/// is stopped.
fn exchange(staged: &Path, place: &Path) -> io::Result<Option<PathBuf>> {
    if place.symlink_metadata().is_err() {
        return fs::rename(staged, place).map(|()| None);
    }
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        if renameat_with(CWD, staged, CWD, place, RenameFlags::EXCHANGE).is_ok() {
            return Ok(Some(staged.to_owned()));
        }
    }
    // Two renames. If the second one fails, the old results return.
    let old = staged.with_extension("old");
    fs::rename(place, &old)?;
    fs::rename(staged, place).or_else(|error| fs::rename(&old, place).and(Err(error)))?;
    Ok(Some(old))
}
