//! The folder with the results of a run: it is replaced as a whole, and nothing in it that is not ours is touched.
//!
//! Ours is what an earlier run has written there and has listed in its `run.json`, as long as it still has the content that it had.
//! All else stays: notes, changed results, data that somebody keeps there, and every file that the run reads.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_files::{LARGEST_RESULT, read_text};

use crate::record::{RunRecord, sha256_of};
use crate::staging::{Staging, unwritable};

/// The record of a run among its results.
pub(crate) const RECORD: &str = "run.json";

/// A folder for results, with what is in it already. Paths in it are relative.
pub(crate) struct ResultFolder {
    /// The folder; where a link to one stands, the folder that it leads to.
    place: PathBuf,
    /// What an earlier run wrote.
    ours: BTreeSet<PathBuf>,
    /// What somebody else has put there, or has changed, and what the run reads.
    others: BTreeSet<PathBuf>,
    /// Those of them that the run reads.
    read: BTreeSet<PathBuf>,
}

impl ResultFolder {
    /// Looks at the folder `place`, which may not be there. `inputs` are the files that the run reads.
    ///
    /// Fails if something else than a folder is there, or a folder that holds something, but no results of a run.
    pub fn new(place: &Path, inputs: &[PathBuf]) -> Result<Self> {
        let none = |place: PathBuf| {
            let [ours, others, read] = [const { BTreeSet::new() }; 3];
            Self { place, ours, others, read }
        };
        let real = real(place);
        if real.symlink_metadata().is_err() {
            return Ok(none(real));
        }
        if !real.is_dir() {
            return Err(no_results(place));
        }
        let mut all = BTreeSet::new();
        list(&real, Path::new(""), &mut all).map_err(|error| unwritable(place, &error))?;
        if all.is_empty() {
            return Ok(none(real));
        }
        let record =
            read_text(&real.join(RECORD), LARGEST_RESULT).ok().and_then(|text| RunRecord::from_json(&text).ok());
        let Some(record) = record else { return Err(no_results(place)) };
        let inputs: BTreeSet<PathBuf> = inputs.iter().filter_map(|input| fs::canonicalize(input).ok()).collect();
        let mut folder = none(real);
        for name in all {
            let path = folder.place.join(&name);
            let is_input = fs::canonicalize(&path).is_ok_and(|path| inputs.contains(&path));
            let listed = record.outputs.iter().find(|output| Path::new(&output.file) == name);
            let unchanged = || listed.is_some_and(|output| has_content(&path, &output.sha256));
            let is_record = name == Path::new(RECORD) && !path.is_symlink();
            let is_ours = !is_input && (is_record || unchanged());
            if is_input {
                folder.read.insert(name.clone());
            }
            if is_ours { &mut folder.ours } else { &mut folder.others }.insert(name);
        }
        Ok(folder)
    }

    /// Fails if a file of somebody else stands where a file of this name is to be written.
    pub fn can_take(&self, name: &Path) -> Result<()> {
        let in_the_way = |other: &&PathBuf| other.starts_with(name) || name.starts_with(other.as_path());
        self.others.iter().find(in_the_way).map_or(Ok(()), |other| Err(self.in_the_way(other)))
    }

    fn in_the_way(&self, other: &Path) -> Error {
        let path = self.place.join(other);
        let (why, help) = match self.read.contains(other) {
            true => (
                "this run reads it",
                "copy it to another folder and name the copy in the recipe, or name another folder with `--out`",
            ),
            false => {
                ("an earlier run did not write it as it is now", "move it away, or name another folder with `--out`")
            }
        };
        Error::data(format!("{} is in the way: {why}", path.display())).help(help)
    }

    /// The folder in which a new folder of results can be made, so that the two can change places.
    pub fn parent(&self) -> &Path {
        parent(&self.place)
    }

    /// Puts written files in the place of the folder; what others have there stays. At any time the folder has all old results or all
    /// new ones.
    ///
    /// Fails if a file of others is in the way of a written one, or if the folder cannot be replaced; the results are then beside it,
    /// and the message says where.
    pub fn replace_by(&self, staging: Staging) -> Result<()> {
        let mut written = BTreeSet::new();
        list(staging.path(), Path::new(""), &mut written).map_err(|error| unwritable(&self.place, &error))?;
        let free = written.iter().try_for_each(|name| self.can_take(name));
        // A second name of the same file, so that it is in both folders while these change places.
        let linked = free.and_then(|()| self.linked(staging.path()));
        if linked.is_ok() {
            self.folders_as_they_were(staging.path());
        }
        let (staged, _lock) = staging.keep();
        // From here on no cleaning takes the folder for one that a killed run has left: it may be the old one.
        let named = beside(&self.place, "new").and_then(|new| fs::rename(&staged, &new).map(|()| new));
        let new = named.as_ref().map_or(staged, PathBuf::clone);
        let exchanged = linked.and_then(|linked| {
            let old = named.and_then(|new| self.exchange(&new));
            Ok((linked, old.map_err(|error| unwritable(&self.place, &error))?))
        });
        match exchanged {
            Ok((_, None)) => Ok(()),
            Ok((linked, Some(old))) => self.emptied(&old, &linked).map_err(|error| {
                let message = format!("the old folder of results cannot be removed: {}", abbe_files::why(&error));
                Error::data(message).help(format!("what is left of it is in {}", old.display()))
            }),
            Err(error) => Err(written_beside(&new, error)),
        }
    }

    /// Puts a folder in the place of this one; gives the path at which the old one is then, if there was one.
    ///
    /// If the system can exchange two folders in one step, the place always has the old folder or the new one, even if the program
    /// is stopped.
    fn exchange(&self, new: &Path) -> io::Result<Option<PathBuf>> {
        if self.place.symlink_metadata().is_err() {
            return fs::rename(new, &self.place).map(|()| None);
        }
        let aside = beside(&self.place, "old")?;
        #[cfg(target_os = "linux")]
        {
            use rustix::fs::{CWD, RenameFlags, renameat_with};
            if renameat_with(CWD, new, CWD, &self.place, RenameFlags::EXCHANGE).is_ok() {
                // Under which name it is removed does not matter.
                let is_aside = fs::rename(new, &aside).is_ok();
                return Ok(Some(if is_aside { aside } else { new.to_owned() }));
            }
        }
        // Two renames. If the second one fails, the old results return.
        fs::rename(&self.place, &aside)?;
        fs::rename(new, &self.place).or_else(|error| fs::rename(&aside, &self.place).and(Err(error)))?;
        Ok(Some(aside))
    }

    /// Gives the files of others second names in the folder `staged`; those that have one now. A file that stands there already, because
    /// the disk takes its name for that of a result, is in the way.
    fn linked(&self, staged: &Path) -> Result<BTreeSet<PathBuf>> {
        let mut linked = BTreeSet::new();
        for name in &self.others {
            match link(&self.place.join(name), &staged.join(name)) {
                Ok(()) => drop(linked.insert(name.clone())),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => return Err(self.in_the_way(name)),
                // It moves over later.
                Err(_) => {}
            }
        }
        Ok(linked)
    }

    /// The folder itself and all in it that stay, relative to it, the innermost first; whether somebody else made it.
    fn folders(&self) -> Vec<(PathBuf, bool)> {
        let above = |name: &PathBuf, skipped: usize| name.ancestors().skip(skipped).map(Path::to_path_buf).collect();
        let mut folders: BTreeMap<PathBuf, bool> = BTreeMap::new();
        for name in &self.ours {
            let own: Vec<PathBuf> = above(name, 1);
            folders.extend(own.into_iter().map(|folder| (folder, false)));
        }
        for name in &self.others {
            let is_folder = self.place.join(name).symlink_metadata().is_ok_and(|found| found.is_dir());
            let own: Vec<PathBuf> = above(name, usize::from(!is_folder));
            folders.extend(own.into_iter().map(|folder| (folder, true)));
        }
        folders.insert(PathBuf::new(), false);
        folders.into_iter().rev().collect()
    }

    /// Gives folders in `staged` the permissions and the owner that they have, and those of others their times, as far as that is
    /// allowed.
    fn folders_as_they_were(&self, staged: &Path) {
        for (name, is_of_others) in self.folders() {
            let _ = as_it_was(&self.place.join(&name), &staged.join(&name), is_of_others);
        }
    }

    /// Moves what is not in both folders out of the old one, then removes what is ours in it, and the folder.
    fn emptied(&self, old: &Path, linked: &BTreeSet<PathBuf>) -> io::Result<()> {
        // What is removed in a moment need not stay without permission to write.
        #[cfg(unix)]
        for (name, _) in self.folders() {
            use std::os::unix::fs::PermissionsExt;
            let _ = fs::set_permissions(old.join(name), fs::Permissions::from_mode(0o700));
        }
        for name in self.others.iter().filter(|name| !linked.contains(*name)) {
            move_over(&old.join(name), &self.place.join(name))?;
        }
        for name in self.ours.iter().chain(linked) {
            remove(&old.join(name))?;
        }
        self.clear(old)
    }

    /// Removes what is left of the old folder. What somebody has put there in the meantime moves over.
    fn clear(&self, old: &Path) -> io::Result<()> {
        let mut late = BTreeSet::new();
        list(old, Path::new(""), &mut late)?;
        for name in late.into_iter().filter(|name| !old.join(name).is_dir()) {
            move_over(&old.join(&name), &self.place.join(&name))?;
        }
        fs::remove_dir_all(old)
    }
}

/// Gives a folder the permissions and the owner of another one, and its times if that is asked.
pub(crate) fn as_it_was(old: &Path, new: &Path, with_times: bool) -> io::Result<()> {
    let before = old.symlink_metadata()?;
    if !(before.is_dir() && new.symlink_metadata()?.is_dir()) {
        return Ok(());
    }
    if with_times {
        let times = fs::FileTimes::new().set_accessed(before.accessed()?).set_modified(before.modified()?);
        fs::File::open(new)?.set_times(times)?;
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, chown};
        let now = new.symlink_metadata()?;
        if (now.uid(), now.gid()) != (before.uid(), before.gid()) {
            // Others than the owner and root may not.
            let _ = chown(new, Some(before.uid()), Some(before.gid()));
        }
    }
    fs::set_permissions(new, before.permissions())
}

/// Puts written files in the place of the folder of results `place`, as [`ResultFolder::replace_by`]; beside it if something else is there.
pub(crate) fn put(staging: Staging, place: &Path, inputs: &[PathBuf]) -> Result<()> {
    match ResultFolder::new(place, inputs) {
        Ok(folder) => folder.replace_by(staging),
        Err(error) => Err(kept_beside(staging, place, error)),
    }
}

/// Keeps what is written beside a place that it cannot take; the error says where.
pub(crate) fn kept_beside(staging: Staging, place: &Path, error: Error) -> Error {
    let (staged, _lock) = staging.keep();
    let named = beside(place, "new").and_then(|new| fs::rename(&staged, &new).map(|()| new));
    written_beside(&named.unwrap_or(staged), error)
}

fn written_beside(folder: &Path, error: Error) -> Error {
    let help = error.help.clone().map_or_else(String::new, |help| format!("; {help}"));
    error.help(format!("the results are in {}{help}", folder.display()))
}

/// The folder in which something stands, or would stand.
pub(crate) fn parent(place: &Path) -> &Path {
    place.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The folder that is written where `named` stands, with or without a slash or `/.` at its end: with all links followed, so that it
/// does not lead through what is removed or renamed on the way. What leads there straight stays as it is named.
pub(crate) fn real(named: &Path) -> PathBuf {
    let named: PathBuf = named.components().collect();
    let place = abbe_files::place(&named);
    let is_straight = std::env::current_dir().is_ok_and(|here| here.join(&named) == place);
    if is_straight { named } else { place }
}

/// Bytes of a name that are left of it in one beside it: disks take 255.
const PART_OF_NAME: usize = 200;

/// A name beside a folder that nothing has yet.
fn beside(place: &Path, what: &str) -> io::Result<PathBuf> {
    let name = place.file_name().unwrap_or_default().to_string_lossy();
    let end = (0..=name.len().min(PART_OF_NAME)).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    let name = &name[..end];
    let mut names = (1..10_000).map(|number| place.with_file_name(format!("{name}-{what}-{number}")));
    let free = names.find(|path| path.symlink_metadata().is_err());
    free.ok_or_else(|| io::Error::other("no name is free beside it"))
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

/// Moves a file to a place where nothing is.
fn move_over(from: &Path, to: &Path) -> io::Result<()> {
    if to.symlink_metadata().is_ok() {
        return Err(io::Error::other(format!("{} is there already", to.display())));
    }
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
