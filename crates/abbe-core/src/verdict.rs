//! What a validator found: figures, their limits, pass or fail.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::{Error, Result};
use crate::format::{FileFormat, parse};

/// The number of the format of `verdicts.json`: a list, in which no number stands. A later one would be a map that has it under
/// `abbe_verdicts`.
pub const VERDICTS_FORMAT: u32 = 1;

const FORMAT: FileFormat = FileFormat { name: "verdicts", key: "abbe_verdicts", number: VERDICTS_FORMAT };

/// One figure of a verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// The estimate that the figure is about, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<String>,
    /// What the figure is, e.g. `max` or `rms[group=5]`.
    pub name: String,
    /// Its value; a figure that could not be computed is null and fails its limit.
    pub value: Option<f64>,
    /// Unit of value and limit.
    pub unit: String,
    /// The largest admissible value.
    #[serde(default)]
    pub limit: Option<f64>,
    /// A detail that a summary for people leaves out (one of many of its kind).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub detail: bool,
}

impl Figure {
    /// A figure of one estimate, without a limit.
    pub fn new(of: &str, name: impl Into<String>, value: f64, unit: &str) -> Self {
        Self {
            of: Some(of.to_owned()),
            name: name.into(),
            value: value.is_finite().then_some(value),
            unit: unit.to_owned(),
            limit: None,
            detail: false,
        }
    }

    /// Marks it as a detail.
    pub fn detail(mut self) -> Self {
        self.detail = true;
        self
    }

    /// Whether the figure keeps its limit; without a limit it does.
    pub fn passes(&self) -> bool {
        self.limit.is_none_or(|limit| self.value.is_some_and(|value| value <= limit))
    }
}

/// What a validator hands back.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Findings {
    /// The figures, most important first.
    pub figures: Vec<Figure>,
    /// What people should be told besides: sentences.
    pub remarks: Vec<String>,
    /// Tables for others to plot: text by file name, written into the folder of the stage.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub tables: BTreeMap<String, String>,
}

/// The verdict of one validate stage, as it stands in `verdicts.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Name of the stage.
    pub stage: String,
    /// Name of its plugin.
    pub plugin: String,
    /// Whether every figure keeps its limit.
    pub pass: bool,
    /// The figures.
    pub figures: Vec<Figure>,
    /// What people should be told besides.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
}

impl Verdict {
    /// Judges findings: they pass if every figure keeps its limit.
    pub fn new(stage: &str, plugin: &str, findings: Findings) -> Self {
        Self {
            stage: stage.to_owned(),
            plugin: plugin.to_owned(),
            pass: findings.figures.iter().all(Figure::passes),
            figures: findings.figures,
            remarks: findings.remarks,
        }
    }

    /// Reads the text of a `verdicts.json`: the verdicts of all validate stages of a run, in their order.
    ///
    /// Keys that are not known are left alone. Fails on text that is not JSON, on another format number, on anything but a list, on
    /// missing or wrong parts (with line and column), and on two verdicts of one stage.
    pub fn list_from_json(text: &str) -> Result<Vec<Self>> {
        match parse(text)? {
            Value::Array(_) => {}
            Value::Object(map) if map.contains_key(FORMAT.key) => FORMAT.check(&map[FORMAT.key])?,
            _ => return Err(Error::data("these are no verdicts: a list was expected")),
        }
        let verdicts: Vec<Self> =
            serde_json::from_str(text).map_err(|error| Error::data(format!("these verdicts are broken: {error}")))?;
        let mut stages = BTreeSet::new();
        match verdicts.iter().find(|verdict| !stages.insert(verdict.stage.as_str())) {
            Some(twice) => Err(Error::data(format!("the stage `{}` has two verdicts", twice.stage))),
            None => Ok(verdicts),
        }
    }
}
