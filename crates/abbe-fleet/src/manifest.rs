//! The manifest: one line that says what the fleet is, then one line for each job. It is JSON line by line, so that one job is found
//! without reading the others.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use abbe_core::{AskedOfPart, Error, FileFormat, Result};
use abbe_engine::{FileRecord, refuse_temporary_place, temporary_file};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::hash::{is_sha256, sha256};
use crate::mistaken;
use crate::seal::{self, LONGEST_HEAD, Sealed, may_take};
use crate::store::{RESULT_FORMAT, Store};
use crate::text::Variables;
use crate::{unreadable, unwritable};

/// The number of the format of manifests.
pub const MANIFEST_FORMAT: u32 = 1;

const FORMAT: FileFormat =
    FileFormat { name: "manifest of a fleet", key: "abbe_fleet_manifest", number: MANIFEST_FORMAT };

/// The version of this program. Another one may find other digits.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// What the name of a manifest ends in.
const ENDING: &str = ".manifest.jsonl";

/// The first line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// [`MANIFEST_FORMAT`].
    pub abbe_fleet_manifest: u32,
    /// The version of the program that planned it, which has to be that of the program that does it.
    pub version: String,
    /// The name of the fleet.
    pub fleet: String,
    /// Where paths start, from the folder of the manifest.
    pub base: String,
    /// How many jobs there are.
    pub jobs: usize,
    /// The history to which the results go.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub history: Option<String>,
    /// The families.
    pub families: Vec<Family>,
    /// For estimates in shards the values, by name, at which their shards are asked in this round; none at the start.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub points: BTreeMap<String, Point>,
    /// Hash of the whole manifest with zeros in the place of these digits; none in manifests of earlier programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

/// Values of unknowns by their names, mm, rad and their powers.
pub type Point = BTreeMap<String, f64>;

/// Jobs of one recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Family {
    /// Its name.
    pub name: String,
    /// The recipe.
    pub recipe: String,
    /// The estimate whose trials are dealt out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trials_of: Option<String>,
    /// The estimate that is made of shards.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shards_of: Option<String>,
}

impl Family {
    /// The estimate whose trials or shards are dealt out.
    pub fn dealt_out(&self) -> Option<&str> {
        self.trials_of.as_deref().or(self.shards_of.as_deref())
    }
}

/// A setting that replaces one of the recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// The stage, then the keys to the setting.
    pub at: Vec<String>,
    /// Its value.
    pub value: Value,
}

/// What the history gets to know of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// The machine; that of its description if none is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine: Option<String>,
    /// What the test is called.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// When it was, in `unit`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<f64>,
    /// `day`, `week`, ...
    pub unit: String,
}

/// Trials of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trials {
    /// The name of what all blocks together are.
    pub of: String,
    /// The number of the first one, from 0.
    pub first: usize,
    /// How many the job has.
    pub count: usize,
    /// How many there are in all blocks.
    pub all: usize,
}

/// The files of a job that is a shard of one estimate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// The name of what all shards together are.
    pub of: String,
    /// Its number, from 0.
    pub number: usize,
    /// How many there are.
    pub all: usize,
    /// The ingest stage whose files are dealt out.
    pub from: String,
    /// Its own files, from the folder of the recipe.
    pub files: Vec<String>,
    /// The round, from 0.
    pub round: usize,
    /// What it is asked in this round.
    pub asked: AskedOfPart,
}

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Hash of all that its result depends on: 64 hexadecimal digits.
    #[serde(deserialize_with = "hash_of_job")]
    pub job: String,
    /// Its name, for people.
    pub name: String,
    /// Its family, by its place in the list.
    pub family: usize,
    /// The variables.
    #[serde(default, skip_serializing_if = "Variables::is_empty")]
    pub variables: Variables,
    /// Settings that replace those of the recipe.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub set: Vec<Setting>,
    /// The files that it reads, with their hashes.
    pub inputs: Vec<FileRecord>,
    /// What the history gets to know.
    pub history: Kept,
    /// The trials that it solves, if it is a block.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trials: Option<Trials>,
    /// The files that it has, if it is a shard.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<Shard>,
    /// Why it cannot be done at all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

/// A hash, which names a file: anything else could lead anywhere.
fn hash_of_job<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let text = String::deserialize(deserializer)?;
    match is_sha256(&text) {
        true => Ok(text),
        false => Err(serde::de::Error::custom("the hash of a job has 64 hexadecimal digits")),
    }
}

impl Job {
    /// The hash of all that a result depends on: the program, the recipe as the job has it, the trials, what a shard is asked at which
    /// values, and what is in the files.
    pub(crate) fn hash(&self, recipe: &str, text: &Value, points: &BTreeMap<String, Point>) -> String {
        let trials = self.trials.as_ref().map(|trials| (trials.first, trials.count));
        let inputs: Vec<(&str, &str)> = (self.inputs.iter()).map(|input| (&*input.file, &*input.sha256)).collect();
        let mut all =
            vec![json!(RESULT_FORMAT), json!(VERSION), json!(recipe), text.clone(), json!(trials), json!(inputs)];
        all.extend(self.shard.as_ref().map(|shard| json!([shard.number == 0, shard.asked, points.get(&shard.of)])));
        sha256(Value::Array(all).to_string().as_bytes())
    }
}

/// A manifest on the disk.
#[derive(Debug, Clone)]
pub struct Manifest {
    /// The file, by its whole path.
    pub path: PathBuf,
    /// Its first line.
    pub head: Head,
}

impl Manifest {
    /// The usual place of the manifest of a fleet: beside it.
    pub fn beside(fleet: &Path) -> PathBuf {
        let stem = fleet.file_stem().unwrap_or_default().to_string_lossy();
        fleet.with_file_name(format!("{stem}{ENDING}"))
    }

    /// Writes a manifest, whole or not at all, where there is nothing or an earlier manifest of the same fleet.
    ///
    /// # Errors
    /// If something else is there, a manifest of another fleet, or one that was changed by hand; for a name of temporary folders; and if the
    /// disk does not take it.
    pub fn write(path: &Path, mut head: Head, jobs: &[Job]) -> Result<Self> {
        // `f/` would be written in the place of the file f.
        let path: &Path = &path.components().collect::<PathBuf>();
        let failed = |error: &io::Error| unwritable(path, error);
        refuse_temporary_place(path)?;
        may_take(path, &head)?;
        let path = whole(path)?;
        let folder = path.parent().unwrap_or(Path::new("/"));
        head.sha256 = Some(seal::unknown());
        let written = (|| -> io::Result<()> {
            let mut file = temporary_file(folder)?;
            let mut writer = BufWriter::new(Sealed::begun(file.as_file_mut()));
            serde_json::to_writer(&mut writer, &head)?;
            for job in jobs {
                writer.write_all(b"\n")?;
                serde_json::to_writer(&mut writer, job)?;
            }
            writer.write_all(b"\n")?;
            writer.into_inner().map_err(io::IntoInnerError::into_error)?.close(&mut head)?;
            file.as_file().sync_all()?;
            file.persist(&path).map(drop).map_err(|error| error.error)
        })();
        written.map_err(|error| failed(&error))?;
        Ok(Self { path, head })
    }

    /// Reads the first line.
    ///
    /// # Errors
    /// For what is no manifest, with what it seems to be and what to do; and for one of another version of this program.
    pub fn read(named: &Path) -> Result<Self> {
        let path = whole(named)?;
        let file = abbe_files::open(&path).map_err(|error| {
            let message = format!("{} cannot be read: {}", path.display(), abbe_files::why(&error));
            Error::usage(message).help("`abbe fleet plan` writes it")
        })?;
        let mut line = Vec::new();
        let mut first = BufReader::new(file).take(LONGEST_HEAD);
        first.read_until(b'\n', &mut line).map_err(|error| unreadable(&path, &error))?;
        let Some(line) = str::from_utf8(&line).ok().filter(|line| has_format(line)) else {
            return Err(mistaken::instead(named));
        };
        let head: Head = FORMAT.read(line).map_err(|error| error.in_file(&path))?;
        if head.version != VERSION {
            let message = format!("it was planned by version {} of this program, which is {VERSION}", head.version);
            return Err(Error::usage(message).help("plan it again: `abbe fleet plan`").in_file(&path));
        }
        Ok(Self { path, head })
    }

    /// Fails if somebody changed it since it was planned: what a history or a table gets to know of its jobs would be wrong.
    ///
    /// # Errors
    /// With what to do.
    pub fn unchanged(&self) -> Result<()> {
        // A round of shards may have put another one in its place meanwhile.
        let now = Self::read(&self.path)?;
        if seal::is_unchanged(&now.path, &now.head)? {
            return Ok(());
        }
        let help = "move it away, and plan the fleet again: `abbe fleet plan`; what is done counts there, too";
        Err(Error::data("it was changed since it was planned").help(help).in_file(&self.path))
    }

    /// The folder in which all paths of the fleet start.
    pub fn base(&self) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("/")).join(&self.head.base)
    }

    /// A name beside the manifest: `plant.results` for `plant.manifest.jsonl`.
    pub fn beside_it(&self, what: &str) -> PathBuf {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let stem = name.strip_suffix(ENDING).or(name.strip_suffix(".jsonl")).unwrap_or(&name);
        self.path.with_file_name(format!("{stem}.{what}"))
    }

    /// Where its results are.
    pub fn store(&self) -> Store {
        Store::new(&self.beside_it("results"))
    }

    /// Calls `take` with the lines of jobs, by their numbers from 0, without reading them.
    ///
    /// # Errors
    /// If the file cannot be read or lacks one of them, or has lines behind its last job if that is one of them; and what `take` fails
    /// with.
    pub fn each_line(&self, range: Range<usize>, mut take: impl FnMut(usize, String) -> Result<()>) -> Result<()> {
        let file = File::open(&self.path).map_err(|error| unreadable(&self.path, &error))?;
        let mut reader = BufReader::with_capacity(1 << 18, file);
        for _ in 0..=range.start.min(self.head.jobs) {
            reader.skip_until(b'\n').map_err(|error| unreadable(&self.path, &error))?;
        }
        let end = range.end;
        for index in range {
            let mut line = String::new();
            let count = reader.read_line(&mut line).map_err(|error| unreadable(&self.path, &error))?;
            if count == 0 || !line.ends_with('\n') {
                let message = format!("the manifest ends with job {index} of {}", self.head.jobs);
                return Err(Error::data(message).help("plan it again: `abbe fleet plan`").in_file(&self.path));
            }
            take(index, line)?;
        }
        if end == self.head.jobs { self.nothing_more(reader) } else { Ok(()) }
    }

    /// Fails if there is anything behind the last job: nobody would do it.
    fn nothing_more(&self, mut rest: impl BufRead) -> Result<()> {
        let mut blank = 0;
        loop {
            let bytes = rest.fill_buf().map_err(|error| unreadable(&self.path, &error))?;
            if let Some(place) = bytes.iter().position(|byte| !byte.is_ascii_whitespace()) {
                let lines = bytes[..place].iter().filter(|byte| **byte == b'\n').count();
                let message =
                    format!("this line is behind the last of the {} jobs that the first line states", self.head.jobs);
                let help = "remove it; or plan the fleet again, with all its jobs: `abbe fleet plan`";
                return Err(Error::data(message).at(&self.path, self.head.jobs + 2 + blank + lines, None).help(help));
            }
            blank += bytes.iter().filter(|byte| **byte == b'\n').count();
            let count = bytes.len();
            if count == 0 {
                return Ok(());
            }
            rest.consume(count);
        }
    }

    /// The job of a line.
    ///
    /// # Errors
    /// For a line that is no job, with its place.
    pub fn job(&self, index: usize, line: &str) -> Result<Job> {
        serde_json::from_str(line).map_err(|error| {
            let (message, column) = (error.to_string(), Some(error.column().max(1)));
            let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(message, _)| message);
            let error = Error::data(format!("this is no job: {message}"));
            let error = error.at(&self.path, index + 2, column);
            error.help("write the manifest anew: `abbe fleet plan`")
        })
    }

    /// Calls `take` with jobs.
    ///
    /// # Errors
    /// As [`Manifest::each_line`], and for a line that is no job.
    pub fn each_job(&self, range: Range<usize>, mut take: impl FnMut(usize, Job) -> Result<()>) -> Result<()> {
        self.each_line(range, |index, line| {
            let job = self.job(index, &line)?;
            match job.family < self.head.families.len() {
                true => take(index, job),
                false => Err(Error::data("there is no such family").at(&self.path, index + 2, None)),
            }
        })
    }
}

/// Whether a first line is that of a manifest, maybe of another version or broken.
fn has_format(line: &str) -> bool {
    serde_json::from_str::<Value>(line).is_ok_and(|head| head.get(FORMAT.key).is_some())
        || (line.starts_with('{') && line.contains(FORMAT.key))
}

/// The whole path of a file, which may not be there yet.
fn whole(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).map(|path| abbe_files::place(&path)).map_err(|error| unreadable(path, &error))
}

/// The way from one folder to another, both by their whole paths.
pub fn relative(from: &Path, to: &Path) -> String {
    let (from, to): (Vec<_>, Vec<_>) = (from.components().collect(), to.components().collect());
    let same = from.iter().zip(&to).take_while(|(one, other)| one == other).count();
    let up = std::iter::repeat_n("..".to_owned(), from.len() - same);
    let down = to[same..].iter().map(|part| part.as_os_str().to_string_lossy().into_owned());
    let parts: Vec<String> = up.chain(down).collect();
    if parts.is_empty() { ".".to_owned() } else { parts.join("/") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ways_between_folders() {
        for (from, to, way) in
            [("/a/b", "/a/b", "."), ("/a/b", "/a", ".."), ("/a", "/a/b/c", "b/c"), ("/a/b/c", "/a/d", "../../d")]
        {
            assert_eq!(relative(Path::new(from), Path::new(to)), way);
        }
    }
}
