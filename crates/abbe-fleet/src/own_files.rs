//! The files of merges in their folder: a merge replaces what an earlier one wrote, as long as nobody has changed it since.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_engine::{MadeFolders, Staging};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tempfile::NamedTempFile;

use crate::hash::sha256_of;
use crate::unwritable;

/// The record of what was written: a line for each file.
pub const RECORD: &str = "written.jsonl";

/// A file that a merge wrote.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
struct Written {
    /// Its name in the folder, with `/`.
    file: String,
    /// Hash of its content.
    sha256: String,
    /// The name of the fleet that was merged; none in records of earlier programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fleet: Option<String>,
}

impl Written {
    fn is_same_file(&self, other: &Self) -> bool {
        (&self.file, &self.sha256) == (&other.file, &other.sha256)
    }
}

/// The files of merges in a folder.
pub struct OwnFiles {
    folder: PathBuf,
    fleet: String,
    known: BTreeSet<Written>,
    now: BTreeSet<Written>,
    /// Files that wait for the end of the merge, under their names in a folder of their own.
    waiting: Option<Staging>,
    names: Vec<PathBuf>,
    /// Others that wait, with their places.
    files: Vec<(NamedTempFile, PathBuf)>,
}

impl OwnFiles {
    /// What earlier merges of a fleet wrote into a folder, which is there.
    ///
    /// # Errors
    /// If something that is no record of a merge has its name, if files of another fleet are there, and if the record cannot be read.
    pub fn of(folder: &Path, fleet: &str) -> Result<Self> {
        let path = folder.join(RECORD);
        let text = match abbe_files::read_text(&path, abbe_files::LARGEST_RESULT) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(unwritable(&path, &error)),
        };
        // A merge that was killed may have left a part of a line.
        let known: BTreeSet<Written> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        if known.is_empty() && !text.trim().is_empty() {
            return Err(of_somebody(&path));
        }
        let known: BTreeSet<Written> = known.into_iter().filter(|own| folder.join(&own.file).exists()).collect();
        if let Some(other) = known.iter().filter_map(|own| own.fleet.as_deref()).find(|other| *other != fleet) {
            let message = format!("the tables of another fleet are there: those of `{other}`, not of `{fleet}`");
            return Err(Error::data(message).help("name another folder: `--out`; or move them away").in_file(folder));
        }
        Ok(Self {
            folder: folder.to_owned(),
            fleet: fleet.to_owned(),
            known,
            now: BTreeSet::new(),
            waiting: None,
            names: Vec::new(),
            files: Vec::new(),
        })
    }

    /// Writes the record anew, whole or not at all.
    fn write_record(&self, all: &BTreeSet<&Written>) -> io::Result<()> {
        let lines: String = all.iter().map(|own| json!(own).to_string() + "\n").collect();
        let mut file = abbe_engine::temporary_file(&self.folder)?;
        file.write_all(lines.as_bytes())?;
        file.persist(self.folder.join(RECORD)).map(drop).map_err(|error| error.error)
    }

    /// Fails if something is at a place in the folder that no merge wrote, or that was changed since.
    pub fn check(&self, path: &Path) -> Result<()> {
        if path.symlink_metadata().is_err() {
            return Ok(());
        }
        let is_file = path.symlink_metadata().is_ok_and(|found| found.is_file());
        let written = sha256_of(path).ok().map(|sha256| self.written(path, sha256));
        let mut all = self.known.iter().chain(&self.now);
        let is_own = is_file && written.is_some_and(|own| all.any(|known| known.is_same_file(&own)));
        if is_own { Ok(()) } else { Err(of_somebody(path)) }
    }

    /// Keeps a file that is written, until [`put_waiting`](Self::put_waiting) puts it at its place.
    ///
    /// # Errors
    /// As [`OwnFiles::check`].
    pub fn keep(&mut self, file: NamedTempFile, path: &Path) -> Result<()> {
        self.check(path)?;
        self.files.push((file, path.to_owned()));
        Ok(())
    }

    /// Writes a file that [`put_waiting`](Self::put_waiting) puts at its place: a merge that ends before has changed nothing.
    ///
    /// # Errors
    /// As [`OwnFiles::check`]; if its folder is none; and if the disk does not take it.
    pub fn keep_ready(&mut self, content: &[u8], path: &Path) -> Result<()> {
        let folder = path.parent().unwrap_or(&self.folder);
        if folder.symlink_metadata().is_ok() && !folder.is_dir() {
            let error = Error::data("this is no folder, and files of the merge go into one of this name");
            return Err(error.help("move it away, or name another folder: `--out`").in_file(folder));
        }
        self.check(path)?;
        let waiting = match self.waiting.take() {
            Some(waiting) => waiting,
            None => Staging::new(&self.folder, path)?,
        };
        let name = PathBuf::from(self.name(path));
        let written = self.waiting.insert(waiting).write(&name, content);
        self.names.push(name);
        written.map_err(|error| unwritable(path, &error))
    }

    /// Puts the files that wait at their places. What needs room on the disk comes first, so that a full one takes all of them or none.
    ///
    /// # Errors
    /// As [`OwnFiles::check`]; and if the disk does not take them.
    pub fn put_waiting(&mut self) -> Result<()> {
        let (waiting, files) = (self.waiting.take(), std::mem::take(&mut self.files));
        let name = |name: &PathBuf| waiting.as_ref().map(|of| (of.path().join(name), self.folder.join(name)));
        let staged: Vec<(PathBuf, PathBuf)> = self.names.iter().filter_map(name).collect();
        self.names.clear();
        let kept = files.iter().map(|(file, path)| (file.path(), path));
        let mut folders = Vec::new();
        for (file, path) in staged.iter().map(|(file, path)| (file.as_path(), path)).chain(kept) {
            self.check(path)?;
            let sha256 = sha256_of(file).map_err(|error| unwritable(path, &error))?;
            let folder = MadeFolders::new(path.parent().unwrap_or(&self.folder));
            folders.push(folder.map_err(|error| unwritable(path, &error))?);
            self.now.insert(self.written(path, sha256));
        }
        // Before they are there: a merge that is killed leaves no file that the next one does not know.
        let record = self.write_record(&self.known.iter().chain(&self.now).collect());
        record.map_err(|error| unwritable(&self.folder.join(RECORD), &error))?;
        folders.iter_mut().for_each(MadeFolders::keep);
        for (file, path) in &staged {
            fs::rename(file, path).map_err(|error| unwritable(path, &error))?;
        }
        for (file, path) in files {
            file.persist(&path).map_err(|error| unwritable(&path, &error.error))?;
        }
        Ok(())
    }

    /// Writes the record anew: what this merge wrote, and files of earlier ones that are still there. Gives the names of these: they stay,
    /// whether their jobs are gone, were done anew, or this merge was not asked for them.
    pub fn finish(self) -> BTreeSet<String> {
        let names: BTreeSet<&String> = self.now.iter().map(|own| &own.file).collect();
        let is_there = |own: &&Written| !names.contains(&own.file) && self.folder.join(&own.file).exists();
        let earlier: BTreeSet<&Written> = self.known.iter().filter(is_there).collect();
        let all = earlier.iter().copied().chain(&self.now).collect();
        // Where the disk is full by now, the one that is there says it with what it was before.
        let _ = self.write_record(&all);
        earlier.into_iter().map(|own| own.file.clone()).collect()
    }

    fn written(&self, path: &Path, sha256: String) -> Written {
        Written { file: self.name(path), sha256, fleet: Some(self.fleet.clone()) }
    }

    fn name(&self, path: &Path) -> String {
        let own = path.strip_prefix(&self.folder).unwrap_or(path);
        own.components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/")
    }
}

fn of_somebody(path: &Path) -> Error {
    Error::data("the file is there already, and no merge wrote it, or it was changed since")
        .help("move it away, or name another folder: `--out`")
        .in_file(path)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn put(folder: &Path, own: &mut OwnFiles, name: &str, content: &str) -> Result<()> {
        let mut file = abbe_engine::temporary_file(folder).unwrap();
        file.write_all(content.as_bytes()).unwrap();
        own.keep(file, &folder.join(name))?;
        own.put_waiting()
    }

    #[test]
    fn only_own_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        fs::write(at.join("mine.csv"), "mine").unwrap();
        let mut own = OwnFiles::of(at, "A plant").unwrap();
        put(at, &mut own, "a.csv", "1").unwrap();
        put(at, &mut own, "a.csv", "2").unwrap();
        put(at, &mut own, "b.csv", "1").unwrap();
        assert!(put(at, &mut own, "mine.csv", "2").is_err());
        // Killed here: what was written is known all the same.
        drop(own);
        let mut own = OwnFiles::of(at, "A plant").unwrap();
        put(at, &mut own, "a.csv", "3").unwrap();
        own.finish();
        let mut own = OwnFiles::of(at, "A plant").unwrap();
        fs::write(at.join("a.csv"), "3, and more").unwrap();
        assert!(put(at, &mut own, "a.csv", "4").is_err());
        put(at, &mut own, "b.csv", "4").unwrap();
        own.finish();
        assert_eq!(fs::read_to_string(at.join("mine.csv")).unwrap(), "mine");
        assert_eq!(fs::read_to_string(at.join("a.csv")).unwrap(), "3, and more");
        // Merges that fail do not make the record longer, and another fleet gets none of these files.
        let record = || fs::read_to_string(at.join(RECORD)).unwrap();
        let before = record();
        for _ in 0..3 {
            let mut own = OwnFiles::of(at, "A plant").unwrap();
            put(at, &mut own, "b.csv", "4").unwrap();
        }
        assert_eq!(record(), before);
        let error = OwnFiles::of(at, "Another plant").map(drop).unwrap_err().to_string();
        assert!(error.contains("those of `A plant`, not of `Another plant`"), "{error}");
        // A record of somebody else is none.
        fs::write(at.join(RECORD), "{\"file\": 1}\n").unwrap();
        assert!(OwnFiles::of(at, "A plant").is_err());
    }

    #[test]
    fn files_that_wait_come_together_and_earlier_ones_stay() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let names = |folder: &Path| {
            let mut names: Vec<String> = fs::read_dir(folder).map_or_else(
                |_| vec!["no folder".to_owned()],
                |all| all.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect(),
            );
            names.sort();
            names
        };
        let inner = at.join("calibrations");
        let mut own = OwnFiles::of(at, "A plant").unwrap();
        own.keep_ready(b"1", &inner.join("one")).unwrap();
        drop(own);
        assert_eq!((names(&inner), names(at)), (vec!["no folder".to_owned()], Vec::new()));
        let merge = |all: &[&str]| {
            let mut own = OwnFiles::of(at, "A plant").unwrap();
            all.iter().for_each(|name| own.keep_ready(name.as_bytes(), &inner.join(name)).unwrap());
            own.put_waiting().unwrap();
            own.finish().into_iter().collect::<Vec<_>>()
        };
        assert_eq!(merge(&["one", "two"]), Vec::<String>::new());
        assert_eq!(merge(&["one"]), ["calibrations/two"]);
        assert_eq!(
            (names(&inner), names(at)),
            (vec!["one".into(), "two".into()], vec!["calibrations".into(), RECORD.into()])
        );
        // Somebody has changed one of them: it is theirs now.
        fs::write(inner.join("two"), "mine").unwrap();
        let mut own = OwnFiles::of(at, "A plant").unwrap();
        assert!(own.keep_ready(b"2", &inner.join("two")).is_err());
        assert_eq!(fs::read_to_string(inner.join("two")).unwrap(), "mine");
        fs::rename(&inner, at.join("theirs")).unwrap();
        fs::write(&inner, "mine").unwrap();
        let error = own.keep_ready(b"1", &inner.join("one")).unwrap_err();
        assert!(error.to_string().contains("this is no folder"), "{error}");
    }
}
