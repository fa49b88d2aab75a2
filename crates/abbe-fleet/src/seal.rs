//! The seal of a manifest: the hash of its content, by which a later plan knows that nobody changed it.
//!
//! The first line has the hash under `sha256`. It is that of the whole file with zeros in the place of its digits.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

use abbe_core::{Error, Result};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::hash::{hexadecimal, is_sha256};
use crate::manifest::Head;
use crate::unreadable;

/// Bytes of the longest first line: points of shards have a number for each unknown.
pub const LONGEST_HEAD: u64 = 64 << 20;

/// What stands where the hash comes, while it is not known.
pub fn unknown() -> String {
    "0".repeat(64)
}

/// A file that is written and hashed at once.
pub struct Sealed<'a> {
    file: &'a mut File,
    digest: Sha256,
}

impl<'a> Sealed<'a> {
    /// A file that begins with a head, which has [`unknown`] as its hash.
    pub fn begun(file: &'a mut File) -> Self {
        Self { file, digest: Sha256::new() }
    }

    /// Puts the hash into the head, which is known; the file ends here.
    pub fn close(self, head: &mut Head) -> io::Result<()> {
        head.sha256 = Some(hexadecimal(self.digest.finalize().as_slice()));
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(&serde_json::to_vec(head)?)
    }
}

impl Write for Sealed<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.digest.update(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// What of a first line tells whose manifest it is. Manifests of other versions have it, too.
#[derive(Deserialize)]
struct Whose {
    #[serde(rename = "abbe_fleet_manifest")]
    _format: u32,
    fleet: String,
    base: String,
    sha256: Option<String>,
}

/// Fails if something is at a place that a manifest with this head must not replace: what is no manifest, what is one of another
/// fleet, and what somebody changed since it was planned. Manifests of programs that wrote no hash are taken as they are.
///
/// # Errors
/// With what is there, and what to do.
pub fn may_take(path: &Path, head: &Head) -> Result<()> {
    if path.symlink_metadata().is_err() {
        return Ok(());
    }
    let refused = |message: String| {
        Err(Error::usage(message).in_file(path).help("move it away, or name another file: `--out MANIFEST`"))
    };
    let Some(whose) = (!path.is_symlink()).then(|| whose(path)).flatten() else {
        return refused("something is there already that is no manifest of a fleet".to_owned());
    };
    if whose.fleet != head.fleet {
        return refused(format!(
            "the manifest of another fleet is there: that of `{}`, not of `{}`",
            whose.fleet, head.fleet
        ));
    }
    if whose.base != head.base {
        let message = "the manifest of another fleet of this name is there: its paths start in";
        return refused(format!("{message} {}, not in {}", shown(&whose.base), shown(&head.base)));
    }
    match whose.sha256 {
        Some(sha256) if sealed(path, &sha256, usize::MAX)? != sha256 => {
            refused("the manifest that is there was changed since it was planned".to_owned())
        }
        _ => Ok(()),
    }
}

/// Whose manifest a file is; none if it is not one.
fn whose(path: &Path) -> Option<Whose> {
    let mut line = Vec::new();
    BufReader::new(abbe_files::open(path).ok()?).take(LONGEST_HEAD).read_until(b'\n', &mut line).ok()?;
    serde_json::from_slice(&line).ok()
}

/// Whether the first line of a manifest and those of its jobs are as they were planned, by the hash that the first line has. What is behind
/// them is not looked at.
///
/// # Errors
/// If the file cannot be read.
pub fn is_unchanged(path: &Path, head: &Head) -> Result<bool> {
    match &head.sha256 {
        Some(sha256) => Ok(sealed(path, sha256, head.jobs)? == *sha256),
        None => Ok(true),
    }
}

/// The hash of the first line of a file, with zeros in the place of the hash that it has, and of so many lines behind it.
fn sealed(path: &Path, sha256: &str, lines: usize) -> Result<String> {
    let failed = |error: &io::Error| unreadable(path, error);
    let mut reader = BufReader::new(abbe_files::open(path).map_err(|error| failed(&error))?);
    let (mut line, mut digest) = (Vec::new(), Sha256::new());
    reader.by_ref().take(LONGEST_HEAD).read_until(b'\n', &mut line).map_err(|error| failed(&error))?;
    let known = line.windows(64).position(|digits| digits == sha256.as_bytes());
    if let Some(start) = known.filter(|_| is_sha256(sha256)) {
        line[start..start + 64].fill(b'0');
    }
    digest.update(&line);
    let mut left = lines;
    while left > 0 {
        let rest = reader.fill_buf().map_err(|error| failed(&error))?;
        if rest.is_empty() {
            break;
        }
        let mut ends = rest.iter().enumerate().filter(|(_, byte)| **byte == b'\n').map(|(place, _)| place + 1);
        let end = ends.nth(left - 1);
        left -= end.map_or_else(|| rest.iter().filter(|byte| **byte == b'\n').count(), |_| left);
        let count = end.unwrap_or(rest.len());
        digest.update(&rest[..count]);
        reader.consume(count);
    }
    Ok(hexadecimal(digest.finalize().as_slice()))
}

/// The folder in which paths start, as people know it.
fn shown(base: &str) -> String {
    match base {
        "." => "its own folder".to_owned(),
        base => format!("`{base}`"),
    }
}
