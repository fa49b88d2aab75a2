//! Where the results of jobs are: one file each, named after the hash of the job, which says in its first line what the rest is.
//!
//! A file is written beside and renamed, so that it is there whole or not at all for everybody who shares the folder. Nothing is forced
//! to the disk: a file that a power cut has damaged is not what its first line says, and its job is done again.

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::hash::{is_sha256, sha256};
use crate::unwritable;

/// The number of the format of results.
pub const RESULT_FORMAT: u32 = 1;

/// Bytes of the largest result: 4 GiB.
pub(crate) const LARGEST: u64 = 4 << 30;

/// Bytes of the longest first line.
const LONGEST_HEAD: u64 = 4096;

/// What the names of files begin with that are not written yet.
const HALF_WRITTEN: &str = ".abbe-partial-";

/// A folder of results.
#[derive(Debug, Clone)]
pub struct Store {
    folder: PathBuf,
}

/// What the first line of a result says.
#[derive(Serialize, Deserialize)]
struct Mark {
    abbe_fleet_result: u32,
    job: String,
    sha256: String,
    bytes: u64,
}

/// Why a job has no result.
#[derive(Serialize, Deserialize)]
struct FailureMark {
    abbe_fleet_failure: u32,
    job: String,
    reason: String,
}

impl Store {
    /// Results in this folder, which is made when the first one comes.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// The file of a result. 256 folders share them: a folder with a million files is slow on many disks.
    pub fn result_file(&self, job: &str) -> PathBuf {
        // What is no hash names no place.
        let job = if is_sha256(job) { job } else { &sha256(job.as_bytes()) };
        self.folder.join(job.get(..2).unwrap_or("00")).join(format!("{job}.result"))
    }

    /// The file that says why there is none.
    pub fn failure_file(&self, job: &str) -> PathBuf {
        self.result_file(job).with_extension("failure")
    }

    /// The result of a job; none if there is none, or if the file is damaged.
    pub fn get(&self, job: &str) -> Option<Vec<u8>> {
        let mut reader = BufReader::with_capacity(1 << 16, abbe_files::open(&self.result_file(job)).ok()?);
        let mut head = Vec::new();
        reader.by_ref().take(LONGEST_HEAD).read_until(b'\n', &mut head).ok()?;
        let mark: Mark = serde_json::from_slice(&head).ok()?;
        if mark.abbe_fleet_result != RESULT_FORMAT || mark.job != job || mark.bytes > LARGEST {
            return None;
        }
        let mut content = Vec::new();
        reader.take(mark.bytes + 1).read_to_end(&mut content).ok()?;
        (content.len() as u64 == mark.bytes && sha256(&content) == mark.sha256).then_some(content)
    }

    /// Whether a job is done.
    pub fn has(&self, job: &str) -> bool {
        self.get(job).is_some()
    }

    /// Keeps a result; an earlier failure is forgotten.
    ///
    /// # Errors
    /// If the disk does not take it.
    pub fn put(&self, job: &str, content: &[u8]) -> Result<()> {
        let mark = Mark {
            abbe_fleet_result: RESULT_FORMAT,
            job: job.to_owned(),
            sha256: sha256(content),
            bytes: content.len() as u64,
        };
        let head = json!(mark).to_string() + "\n";
        self.write(&self.result_file(job), &[head.as_bytes(), content])?;
        match fs::remove_file(self.failure_file(job)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(unwritable(&self.failure_file(job), &error)),
            _ => Ok(()),
        }
    }

    /// Keeps why a job has no result.
    ///
    /// # Errors
    /// If the disk does not take it.
    pub fn fail(&self, job: &str, reason: &str) -> Result<()> {
        let mark = FailureMark { abbe_fleet_failure: RESULT_FORMAT, job: job.to_owned(), reason: reason.to_owned() };
        self.write(&self.failure_file(job), &[json!(mark).to_string().as_bytes(), b"\n"])
    }

    /// Why a job has no result, as far as somebody tried.
    pub fn failure(&self, job: &str) -> Option<String> {
        let text = abbe_files::read_text(&self.failure_file(job), abbe_files::LARGEST_TEXT).ok()?;
        serde_json::from_str(&text).ok().map(|mark: FailureMark| mark.reason)
    }

    /// Fails if something stands in the place of the folder, so that no result could be kept.
    ///
    /// # Errors
    /// With what is there, and what to do.
    pub fn can_be_written(&self) -> Result<()> {
        match fs::metadata(&self.folder) {
            Ok(found) if !found.is_dir() => {
                let error = Error::data("this is no folder, and the results of the jobs go into a folder of this name");
                Err(error.in_file(&self.folder).help("move it away"))
            }
            _ => Ok(()),
        }
    }

    /// Removes what killed workers have left half written.
    pub fn clear(&self) {
        // Behind a link lies a folder of somebody else.
        let is_own = fs::symlink_metadata(self.half_written()).is_ok_and(|found| found.is_dir());
        let all = is_own.then(|| fs::read_dir(self.half_written()).ok()).flatten();
        for entry in all.into_iter().flatten().flatten() {
            let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
            if !is_file || !entry.file_name().to_string_lossy().starts_with(HALF_WRITTEN) {
                continue;
            }
            let abandoned = File::open(entry.path()).is_ok_and(|file| file.try_lock().is_ok());
            if abandoned {
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    fn half_written(&self) -> PathBuf {
        self.folder.join("new")
    }

    fn write(&self, path: &Path, parts: &[&[u8]]) -> Result<()> {
        is_free(path)?;
        let tried = self.try_to_write(path, parts);
        // A folder that is not there yet, or a new file that looked abandoned because it had no lock yet.
        let again = tried.or_else(|error| match error.kind() {
            io::ErrorKind::NotFound => {
                fs::create_dir_all(self.half_written())?;
                path.parent().map_or(Ok(()), fs::create_dir_all)?;
                self.try_to_write(path, parts)
            }
            _ => Err(error),
        });
        again.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => {
                Error::data(format!("{} cannot be written: somebody removes it", path.display()))
            }
            _ => unwritable(path, &error),
        })
    }

    fn try_to_write(&self, path: &Path, parts: &[&[u8]]) -> io::Result<()> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(HALF_WRITTEN).rand_bytes(12);
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let mut file = builder.tempfile_in(self.half_written())?;
        // A disk without locks has none for those who would remove it, either.
        let _ = file.as_file().try_lock();
        for part in parts {
            file.write_all(part)?;
        }
        file.persist(path).map(drop).map_err(|error| error.error)
    }
}

/// Fails where something of somebody else stands in the place of a result: what is no file, and a file that begins otherwise. What a power
/// cut leaves of a result is empty, zeros, or begins as one.
fn is_free(path: &Path) -> Result<()> {
    let Ok(found) = fs::symlink_metadata(path) else { return Ok(()) };
    let mut head = Vec::new();
    let read = |file: File| file.take(OURS.len() as u64).read_to_end(&mut head);
    // What cannot be read may be anybody's.
    let is_readable = found.is_file() && File::open(path).and_then(read).is_ok();
    if is_readable && (head.iter().all(|byte| *byte == 0) || OURS.starts_with(&head)) {
        return Ok(());
    }
    let error = Error::data("this is no result of a job, and one of this name has to be written");
    Err(error.in_file(path).help("move it away"))
}

/// How the files of a store begin.
const OURS: &[u8; 13] = b"{\"abbe_fleet_";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_keep_in_the_place_of_a_result_stays() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(&folder.path().join("results"));
        let job = sha256(b"a job");
        store.put(&job, b"12").unwrap();
        let (file, whole) = (store.result_file(&job), fs::read(store.result_file(&job)).unwrap());
        for ours in [&whole[..5], b"", &[0; 40], &whole[..40]] {
            fs::write(&file, ours).unwrap();
            store.put(&job, b"12").unwrap();
            assert_eq!(store.get(&job).as_deref(), Some(&b"12"[..]));
        }
        fs::write(&file, "notes").unwrap();
        let told = store.put(&job, b"12").unwrap_err();
        assert!(told.message.contains("no result") && told.help.as_deref() == Some("move it away"), "{told:?}");
        assert_eq!(fs::read(&file).unwrap(), b"notes");
        fs::remove_file(&file).unwrap();
        fs::create_dir(&file).unwrap();
        store.put(&job, b"12").unwrap_err();
        #[cfg(unix)]
        {
            fs::remove_dir(&file).unwrap();
            std::os::unix::fs::symlink(folder.path().join("nothing"), &file).unwrap();
            store.put(&job, b"12").unwrap_err();
            assert!(fs::symlink_metadata(&file).unwrap().is_symlink());
        }
    }

    #[test]
    fn a_result_is_there_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(&folder.path().join("results"));
        let job = sha256(b"a job");
        assert_eq!((store.get(&job), store.failure(&job)), (None, None));
        store.fail(&job, "no \"luck\"").unwrap();
        assert_eq!(store.failure(&job).as_deref(), Some("no \"luck\""));
        store.put(&job, b"12\n34").unwrap();
        assert_eq!(store.get(&job).as_deref(), Some(&b"12\n34"[..]));
        assert_eq!(store.failure(&job), None);
        let file = store.result_file(&job);
        let whole = fs::read(&file).unwrap();
        // Cut off anywhere, longer, or with any byte changed it is none.
        for length in 0..whole.len() {
            fs::write(&file, &whole[..length]).unwrap();
            assert_eq!(store.get(&job), None, "{length}");
        }
        fs::write(&file, [&whole[..], b"5"].concat()).unwrap();
        assert_eq!(store.get(&job), None);
        for place in 0..whole.len() {
            let mut changed = whole.clone();
            changed[place] ^= 1;
            fs::write(&file, &changed).unwrap();
            assert_ne!(store.get(&job).as_deref(), Some(&b"12\n35"[..]), "{place}");
            assert!(store.get(&job).is_none_or(|found| found == b"12\n34"), "{place}");
        }
        // That of another job is none of this one.
        let other = sha256(b"another job");
        fs::create_dir_all(store.result_file(&other).parent().unwrap()).unwrap();
        fs::write(store.result_file(&other), &whole).unwrap();
        assert_eq!(store.get(&other), None);
        store.can_be_written().unwrap();
        let told = Store::new(&file).can_be_written().unwrap_err();
        assert!(told.message.contains("no folder") && told.help.as_deref() == Some("move it away"), "{told:?}");
        store.put(&job, b"").unwrap();
        assert_eq!(store.get(&job).as_deref(), Some(&b""[..]));
        let new = folder.path().join("results/new");
        fs::write(new.join(format!("{HALF_WRITTEN}0123456789ab")), "half").unwrap();
        // Files of somebody else stay, behind a link too.
        fs::write(new.join("notes.txt"), "mine").unwrap();
        store.clear();
        assert_eq!(fs::read_dir(&new).unwrap().count(), 1);
        #[cfg(unix)]
        {
            let mine = folder.path().join("mine");
            fs::create_dir(&mine).unwrap();
            fs::write(mine.join(format!("{HALF_WRITTEN}0123456789ab")), "mine").unwrap();
            fs::remove_dir_all(&new).unwrap();
            std::os::unix::fs::symlink(&mine, &new).unwrap();
            store.clear();
            assert_eq!(fs::read_dir(&mine).unwrap().count(), 1);
        }
    }
}
