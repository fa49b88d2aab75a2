//! `run.json`: record of a run (recipe, files, plugins, time), and its reader.
//!
//! Its number stands in the key `abbe_run`, its schema in `docs/schemas/run.schema.json`; `docs/formats.md` says what may change.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use abbe_core::{Error, FileFormat, Kind, Origin, Plugin, Result};
use abbe_files::{LARGEST_RESULT, read_text};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::outcome::Failure;

/// The number of the format of `run.json`.
pub const RUN_FORMAT: u32 = 1;

const FORMAT: FileFormat = FileFormat { name: "run record", key: "abbe_run", number: RUN_FORMAT };

/// What users should know of an estimate before they trust it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remark {
    /// The estimate.
    pub estimate: String,
    /// A sentence.
    pub text: String,
}

/// Record of a run: recipe, files, plugins, time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Number of the format, [`RUN_FORMAT`].
    pub abbe_run: u32,
    /// Version of the program.
    pub version: String,
    /// Name of the recipe.
    pub recipe: String,
    /// What the recipe says that it is; empty in records of early versions.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub title: String,
    /// Every file that was read, the recipe first.
    pub inputs: Vec<FileRecord>,
    /// Every plugin that took part.
    pub plugins: Vec<PluginRecord>,
    /// The stages without a result; none in a run that is complete.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<FailureRecord>,
    /// What users should know before they trust the results.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<Remark>,
    /// Every file that was written, but this record. A later run replaces them as long as they have this content.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<FileRecord>,
    /// Start, seconds since 1970-01-01 UTC.
    pub started_unix_s: u64,
    /// How long it took without writing the results, s.
    pub duration_s: f64,
}

/// A file that a run read or wrote.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "a map with `file` and `sha256`")]
pub struct FileRecord {
    /// Of a file that was read its path as the run had it, of one that was written its path in the folder of results, with `/`.
    pub file: String,
    /// Hash of its content, when the run began or when it was written: 64 hexadecimal digits.
    pub sha256: String,
}

/// A plugin that took part in a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PluginRecord {
    /// Its kind.
    pub kind: Kind,
    /// Its name.
    pub name: String,
    /// `built-in`, or the file of a library.
    pub origin: String,
    /// SHA-256 of the library, 64 hexadecimal digits; none if the plugin is built in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Its version.
    pub version: String,
}

/// A stage of a run that has no result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FailureRecord {
    /// Its kind.
    pub kind: Kind,
    /// Its name.
    pub stage: String,
    /// Why it has none.
    pub message: String,
    /// What to do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub help: Option<String>,
    /// The file that is concerned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// The line in it, from 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<usize>,
    /// The stage that failed and that it needs; none if it failed itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub needs: Option<String>,
}

impl FailureRecord {
    pub(crate) fn of(failure: &Failure) -> Self {
        let place = failure.error.place.as_ref();
        Self {
            kind: failure.kind,
            stage: failure.stage.clone(),
            message: failure.error.message.clone(),
            help: failure.error.help.clone(),
            file: place.map(|place| place.file.display().to_string()),
            line: place.and_then(|place| place.line),
            needs: failure.needs.clone(),
        }
    }
}

impl RunRecord {
    /// Whether the run wrote a file of this name, in the folder of its results, with this content.
    pub fn wrote(&self, file: &str, content: &[u8]) -> bool {
        let hash = sha256(content);
        self.outputs.iter().any(|output| output.file == file && output.sha256 == hash)
    }

    /// The text of a file that the run wrote into this folder.
    ///
    /// Fails if it cannot be read, and if it is not as the run wrote it: a result that was changed by hand, or that is of another run, is
    /// no result of this one. Records of early versions, which list no files that were written, cannot tell.
    pub fn written_text(&self, folder: &Path, file: &str) -> Result<String> {
        let path = folder.join(file);
        let text = read_text(&path, LARGEST_RESULT).map_err(|error| {
            Error::data(format!("the file cannot be read: {}", abbe_files::why(&error))).in_file(&path)
        })?;
        let is_listed = self.outputs.iter().any(|output| output.file == file);
        if is_listed && !self.wrote(file, text.as_bytes()) {
            let message = "the file is not as the run wrote it that `run.json` beside it records";
            return Err(Error::data(message)
                .help("was it changed, or copied from another run? Run the recipe again")
                .in_file(&path));
        }
        Ok(text)
    }

    /// Reads the text of a `run.json`.
    ///
    /// Keys that are not known are left alone. Fails on text that is not JSON, on another format number, on missing or wrong
    /// parts (with line and column), on an invalid hash and on a negative duration.
    pub fn from_json(text: &str) -> Result<Self> {
        let record: Self = FORMAT.read(text)?;
        let files = record.inputs.iter().chain(&record.outputs).map(|file| (&file.file, &file.sha256));
        let libraries = record.plugins.iter().filter_map(|plugin| Some((&plugin.origin, plugin.sha256.as_ref()?)));
        let is_hash = |text: &str| text.len() == 64 && text.bytes().all(|digit| digit.is_ascii_hexdigit());
        if let Some((file, sha256)) = files.chain(libraries).find(|(_, sha256)| !is_hash(sha256)) {
            return Err(Error::data(format!("`{file}`: `{sha256}` is no SHA-256, which has 64 hexadecimal digits")));
        }
        let mut names = BTreeSet::new();
        if let Some(twice) = record.outputs.iter().find(|output| !names.insert(&output.file)) {
            return Err(Error::data(format!("`outputs` lists `{}` twice", twice.file)));
        }
        match record.duration_s >= 0.0 {
            true => Ok(record),
            false => Err(Error::data(format!("a run cannot have taken {} s", record.duration_s))),
        }
    }
}

/// Records of the files that are read, each file once. They are made before the run, so that they show the content at its
/// start.
pub(crate) fn input_records(files: &[PathBuf]) -> Result<Vec<FileRecord>> {
    let (mut records, mut seen) = (Vec::new(), BTreeSet::new());
    for path in files {
        let file = path.display().to_string();
        if seen.insert(file.clone()) {
            let unreadable = |error: io::Error| {
                Error::data(format!("the file cannot be read: {}", abbe_files::why(&error))).in_file(path)
            };
            records.push(FileRecord { file, sha256: sha256_of(path).map_err(unreadable)? });
        }
    }
    Ok(records)
}

/// Size and time of the last change of a file; none if it is not there.
pub(crate) type Stamp = Option<(u64, SystemTime)>;

pub(crate) fn stamp(file: &Path) -> Stamp {
    let found = file.metadata().ok()?;
    Some((found.len(), found.modified().ok()?))
}

/// Fails if a file has another content now than when its record was made: nobody could tell which one the results are of. `files` are the
/// places of those of `records`, with their stamps of that time.
pub(crate) fn unchanged(files: &[(PathBuf, Stamp)], records: &[FileRecord]) -> Result<()> {
    let is_another = |(file, before): &&(PathBuf, Stamp)| {
        let now = stamp(file);
        let has_content = || sha256_of(file).is_ok_and(|hash| records.iter().any(|record| record.sha256 == hash));
        now.is_some() && now != *before && !has_content()
    };
    match files.iter().find(is_another) {
        Some((file, _)) => Err(changed(file)),
        None => Ok(()),
    }
}

/// The error for a file that was changed between two looks at it.
pub(crate) fn changed(file: &Path) -> Error {
    Error::data("this file was changed while the run went on: nobody could tell which content its results are of")
        .in_file(file)
        .help("run again, with files that stay as they are meanwhile")
}

/// Sentences on files of data that have the same content: the rows of one that was copied count twice.
pub(crate) fn files_with_same_content(data: &[PathBuf], inputs: &[FileRecord]) -> Vec<String> {
    let mut first: BTreeMap<&str, &str> = BTreeMap::new();
    let mut sentences = Vec::new();
    let by_file: BTreeMap<&str, &FileRecord> = inputs.iter().map(|input| (input.file.as_str(), input)).collect();
    for record in data.iter().filter_map(|path| by_file.get(path.display().to_string().as_str()).copied()) {
        let other = *first.entry(&record.sha256).or_insert(&record.file);
        if other != record.file {
            sentences.push(format!("{other} and {} have the same content: is one a copy?", record.file));
        }
    }
    sentences
}

impl PluginRecord {
    pub(crate) fn of(plugin: &Plugin) -> Self {
        let (origin, sha256) = match &plugin.origin {
            Origin::BuiltIn => ("built-in".to_owned(), None),
            Origin::Library { file, sha256 } => (file.display().to_string(), Some(sha256.clone())),
        };
        let (name, version) = (plugin.name.to_string(), plugin.version.to_string());
        Self { kind: plugin.kind(), name, origin, sha256, version }
    }
}

/// SHA-256 of a content, 64 hexadecimal digits.
pub fn sha256(content: &[u8]) -> String {
    hexadecimal(Sha256::digest(content).as_slice())
}

/// SHA-256 of the content of a file.
pub(crate) fn sha256_of(file: &Path) -> io::Result<String> {
    let mut reader = abbe_files::open(file)?;
    let mut digest = Sha256::new();
    let mut buffer = [0; 1 << 16];
    loop {
        match reader.read(&mut buffer)? {
            0 => break,
            count => digest.update(&buffer[..count]),
        }
    }
    Ok(hexadecimal(digest.finalize().as_slice()))
}

pub(crate) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
