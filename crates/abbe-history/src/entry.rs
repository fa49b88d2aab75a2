//! What is kept: entries and their calibrations.

use abbe_core::{Calibration, Error, Result, Verdict};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// What one run found.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Name of the recipe.
    pub recipe: String,
    /// Its calibrations, each with its machine and its time.
    pub calibrations: Vec<Stored>,
    /// Its verdicts.
    pub verdicts: Vec<Verdict>,
    /// What it was made of: the files that were read, with their hashes, and the plugins.
    pub evidence: Value,
}

/// A calibration with its machine and its time.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// The machine.
    pub machine: String,
    /// What the test is called: a week, a date.
    pub label: String,
    /// When it was, in `unit`.
    pub at: f64,
    /// `week`, `day`, ...
    pub unit: String,
    /// The result.
    pub calibration: Calibration,
}

/// What came of adding an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Added {
    /// It has this number now.
    New(i64),
    /// The same content has this number already: nothing was done.
    Known(i64),
}

/// Which calibrations are wanted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    /// Those of one machine.
    pub machine: Option<String>,
    /// Those of one entry.
    pub entry: Option<i64>,
}

impl Entry {
    /// SHA-256 of its content, in hexadecimal digits. Times have no part in it: the same data give the same result on any day.
    pub fn sha256(&self) -> Result<String> {
        let mut parts = Vec::new();
        for stored in &self.calibrations {
            let content = serde_json::to_value(&stored.calibration).map_err(|error| unwritable(&error))?;
            parts.push(json!([stored.machine, content]));
        }
        let verdicts = serde_json::to_value(&self.verdicts).map_err(|error| unwritable(&error))?;
        Ok(hash_of(&self.recipe, &parts, &verdicts, &self.evidence))
    }
}

/// SHA-256 of the content of an entry; each of `parts` is a machine with its calibration.
pub(crate) fn hash_of(recipe: &str, parts: &[Value], verdicts: &Value, evidence: &Value) -> String {
    let content = json!([recipe, parts, verdicts, evidence]);
    Sha256::digest(content.to_string().as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unwritable(error: &serde_json::Error) -> Error {
    Error::data(format!("a result cannot be kept: {error}"))
}

/// An entry as it is written into the tables.
pub(crate) struct Written<'a> {
    pub(crate) entry: &'a Entry,
    pub(crate) sha256: String,
    pub(crate) verdicts: String,
    pub(crate) evidence: String,
    /// The text of each calibration.
    pub(crate) contents: Vec<String>,
}

impl<'a> Written<'a> {
    pub(crate) fn of(entry: &'a Entry) -> Result<Self> {
        Ok(Self {
            sha256: entry.sha256()?,
            verdicts: serde_json::to_string(&entry.verdicts).map_err(|error| unwritable(&error))?,
            evidence: entry.evidence.to_string(),
            contents: entry.calibrations.iter().map(|stored| stored.calibration.to_json()).collect::<Result<_>>()?,
            entry,
        })
    }
}
