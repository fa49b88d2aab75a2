//! Temporary folders that results are written into before they take their place.
//!
//! The owner of a temporary folder holds a lock on it, which the system releases when the process ends, however it ends. So the next
//! run can tell what a killed one has left, and removes it.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Error, Result};

/// What the names of temporary folders begin with, and how many random letters and digits follow.
const PREFIX: &str = ".abbe-partial-";
const RANDOM: usize = 12;

/// A temporary folder with a lock on it. Dropping it removes it, with those folders above it that were made for it and are empty.
pub struct Staging {
    folder: Option<tempfile::TempDir>,
    lock: Option<File>,
    made: MadeFolders,
}

impl Staging {
    /// Makes a temporary folder in `parent`, and `parent` if it is not there. What killed runs have left there is removed. Errors name
    /// `out`, as the user does.
    pub fn new(parent: &Path, out: &Path) -> Result<Self> {
        refuse_temporary_place(out)?;
        let failed = |error: io::Error| unwritable(out, &error);
        let made = MadeFolders::new(parent).map_err(failed)?;
        let (folder, lock) = temporary_folder(parent).map_err(failed)?;
        Ok(Self { folder: Some(folder), lock, made })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.as_ref().map_or(Path::new(""), tempfile::TempDir::path)
    }

    /// Writes a file of the folder, with the folders in between.
    pub fn write(&self, name: &Path, content: &[u8]) -> io::Result<()> {
        let path = self.path().join(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(path, content)
    }

    /// Gives the folder away: it stays where it is, locked until the result is dropped.
    pub fn keep(mut self) -> (PathBuf, Option<File>) {
        self.made.keep();
        let path = self.folder.take().map(tempfile::TempDir::keep).unwrap_or_default();
        (path, self.lock.take())
    }
}

/// Fails early if nothing can be written below `parent`, without making it. The error names `out`, as the user does.
pub(crate) fn can_write(parent: &Path, out: &Path) -> Result<()> {
    refuse_temporary_place(out)?;
    let there = parent.ancestors().find(|folder| folder.symlink_metadata().is_ok() || folder.as_os_str().is_empty());
    let there = there.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // A name that is too long for the disk is told before the work, and not when the results are there.
    if let Some(error) = out.symlink_metadata().err().filter(|error| error.kind() == io::ErrorKind::InvalidFilename) {
        return Err(unwritable(out, &error));
    }
    // What is there and is no folder says why.
    // It is empty: to remove it so opens no file, where hardly one may be open.
    let tried = || temporary(there).map(|folder| drop(fs::remove_dir(folder.keep())));
    let tried = if there.is_dir() { tried() } else { fs::create_dir(there) };
    tried.map_err(|error| unwritable(out, &error))
}

/// A new temporary folder. The error does not name it: nobody knows it.
fn temporary(parent: &Path) -> io::Result<tempfile::TempDir> {
    tempfile::Builder::new().prefix(PREFIX).rand_bytes(RANDOM).tempdir_in(parent).map_err(|error| bare(&error))
}

/// An error without the path that `tempfile` names.
fn bare(error: &io::Error) -> io::Error {
    let text = error.to_string();
    let reason = text.split(" at path ").next().unwrap_or_default().to_owned();
    io::Error::new(error.kind(), reason)
}

/// The error that results cannot be written.
pub(crate) fn unwritable(out: &Path, error: &io::Error) -> Error {
    let why = match error.kind() {
        io::ErrorKind::AlreadyExists => "it is, or lies in, something that is no folder".to_owned(),
        io::ErrorKind::InvalidFilename => "the name is too long for the disk".to_owned(),
        _ => abbe_files::why(error),
    };
    Error::data(format!("the results cannot be written to {}: {why}", out.display())).help("name another folder")
}

/// Folders that were made on the way to one; those that are empty are removed again unless they are kept.
pub struct MadeFolders(Vec<PathBuf>);

impl MadeFolders {
    /// Makes a folder, and those around it that are missing.
    pub fn new(folder: &Path) -> io::Result<Self> {
        let missing = folder.ancestors().take_while(|path| !path.as_os_str().is_empty() && !path.exists());
        let made = Self(missing.map(Path::to_path_buf).collect());
        fs::create_dir_all(folder)?;
        Ok(made)
    }

    /// They stay.
    pub fn keep(&mut self) {
        self.0.clear();
    }
}

impl Drop for MadeFolders {
    fn drop(&mut self) {
        // The innermost first. One that holds something by now stays.
        self.0.iter().for_each(|folder| drop(fs::remove_dir(folder)));
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // Before the folders around it; without its lock, which is a file that removing may need to open.
        drop(self.lock.take());
        if let Some(folder) = self.folder.take() {
            remove(&folder.keep());
        }
    }
}

/// Removes a folder with what is in it. One file is open at a time: where no more may be open, results could not be written either.
fn remove(folder: &Path) {
    let entries: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    for path in entries {
        let is_folder = path.symlink_metadata().is_ok_and(|own| own.is_dir());
        if is_folder { remove(&path) } else { drop(fs::remove_file(&path)) }
    }
    let _ = fs::remove_dir(folder);
}

/// A lock on a folder or a file; none on systems or disks that have no such locks.
fn locked(path: &Path) -> Option<File> {
    let opened = File::open(path).ok()?;
    opened.try_lock().ok()?;
    Some(opened)
}

/// How often, and how long after each other, access is asked for.
const ASKED: usize = 200;
const PAUSE: Duration = Duration::from_millis(50);

/// A lock on a folder that several runs write into, for the moment in which only one may; none if it cannot be had.
pub(crate) fn exclusive_access(folder: &Path) -> Option<File> {
    let folder = File::open(folder).ok()?;
    for _ in 0..ASKED {
        match folder.try_lock() {
            Ok(()) => return Some(folder),
            Err(TryLockError::WouldBlock) => std::thread::sleep(PAUSE),
            Err(TryLockError::Error(_)) => return None,
        }
    }
    None
}

/// A new temporary folder in `parent`, with a lock on it that holds until it is dropped. What killed commands have left there is removed.
pub fn temporary_folder(parent: &Path) -> io::Result<(tempfile::TempDir, Option<File>)> {
    // Nobody takes the new folder for an abandoned one before it has its lock.
    let _access = exclusive_access(parent);
    match remove_abandoned(parent) {
        // In a folder that may not be listed nothing can be found.
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {}
        removed => removed?,
    }
    let folder = temporary(parent)?;
    let lock = locked(folder.path());
    Ok((folder, lock))
}

/// A new temporary file in `folder` that others may read, as any new file, with a lock on it. What killed commands have left there is
/// removed.
pub fn temporary_file(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    // Nobody takes the new file for an abandoned one before it has its lock.
    let _access = exclusive_access(folder);
    remove_abandoned(folder)?;
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let file = builder.prefix(PREFIX).rand_bytes(RANDOM).tempfile_in(folder)?;
    // A disk without locks has none for those who would remove it, either.
    let _ = file.as_file().try_lock();
    Ok(file)
}

/// Whether a folder or file has a name that [`temporary`] gives; what somebody else calls alike has hardly the same length.
fn is_temporary(name: &str) -> bool {
    let random = name.strip_prefix(PREFIX).unwrap_or_default();
    random.len() == RANDOM && random.chars().all(|letter| letter.is_ascii_alphanumeric())
}

/// Refuses a file that is, or lies in, something with a name of temporary folders that nobody owns: a later command takes it for what a
/// killed one has left, and removes it. Results of a recipe have its name, without the ending.
pub(crate) fn refuse_temporary(file: &Path) -> Result<()> {
    let absolute = std::path::absolute(file).unwrap_or_else(|_| file.to_path_buf());
    let name_of = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let is_left = |path: &&Path| name_of(path).is_some_and(|name| is_temporary(&name)) && locked(path).is_some();
    let results = absolute.file_stem().map(|name| name.to_string_lossy().into_owned());
    // What a command of this program has at work has a lock.
    let found = absolute.ancestors().find(is_left).and_then(name_of);
    match found.or(results.filter(|name| is_temporary(name) && name_of(&absolute).as_ref() != Some(name))) {
        Some(name) => Err(would_be_removed(file, &name)),
        None => Ok(()),
    }
}

/// Refuses a place for results that has such a name, or lies in something that has: a later command would remove it.
pub fn refuse_temporary_place(place: &Path) -> Result<()> {
    let absolute = std::path::absolute(place).unwrap_or_else(|_| place.to_path_buf());
    let mut names = absolute.components().map(|part| part.as_os_str().to_string_lossy().into_owned());
    names.find(|name| is_temporary(name)).map_or(Ok(()), |name| Err(would_be_removed(place, &name)))
}

fn would_be_removed(path: &Path, name: &str) -> Error {
    let message =
        format!("{}: `{name}` is a name of temporary folders of this program, which are removed", path.display());
    Error::usage(message).help("give it another name")
}

/// What SQLite calls the journal of a data base, behind its name.
const JOURNAL: &str = "-journal";

/// Removes the temporary folders and files whose owner is dead, and journals of such files that are gone.
fn remove_abandoned(parent: &Path) -> io::Result<()> {
    let mut journals = Vec::new();
    for entry in fs::read_dir(parent)?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Ok(kind) = entry.file_type() else { continue };
        if let Some(of) = name.strip_suffix(JOURNAL).filter(|of| is_temporary(of) && kind.is_file()) {
            journals.push((entry.path(), parent.join(of)));
        }
        if !is_temporary(&name) {
            continue;
        }
        if (kind.is_dir() || kind.is_file())
            && let Some(_lock) = locked(&entry.path())
        {
            // Somebody else may be removing it, too.
            let _ = if kind.is_dir() { fs::remove_dir_all(entry.path()) } else { fs::remove_file(entry.path()) };
        }
    }
    // After their files, in whatever order the folder lists them: nobody would look for one that is left then.
    journals.into_iter().filter(|(_, of)| !of.exists()).for_each(|(journal, _)| drop(fs::remove_file(journal)));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn journals_go_when_their_files_are_gone() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let new = temporary_file(folder.path()).unwrap();
        let own = PathBuf::from(format!("{}{JOURNAL}", new.path().display()));
        let left = at(".abbe-partial-0123456789ab-journal");
        let somebodys = at("plant.sqlite-journal");
        for journal in [&own, &left, &somebodys] {
            fs::write(journal, "what was there before").unwrap();
        }
        drop(temporary_file(folder.path()).unwrap());
        assert!(own.exists() && somebodys.exists() && !left.exists());
        drop(new);
        drop(temporary_file(folder.path()).unwrap());
        assert!(!own.exists() && somebodys.exists());
        // Of killed commands both are there: the next one removes both, in any order of the folder.
        for number in 0..50 {
            let file = at(&format!(".abbe-partial-{:012}", 7919 * number));
            let journal = PathBuf::from(format!("{}{JOURNAL}", file.display()));
            fs::write(if number % 2 == 0 { &journal } else { &file }, "").unwrap();
            fs::write(if number % 2 == 0 { &file } else { &journal }, "").unwrap();
        }
        drop(temporary_file(folder.path()).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
