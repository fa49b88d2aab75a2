//! A stage of a recipe.

use std::collections::BTreeMap;
use std::path::PathBuf;

use abbe_core::{DeclaredTie, EstimateSource, Kind};
use serde_json::Value;

/// One stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Stage {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: Kind,
    /// The plugin that does the work.
    pub plugin: String,
    /// What an estimate is made from.
    pub estimate_source: EstimateSource,
    /// The plugin's settings, an object; a model's file is merged in.
    pub settings: Value,
    /// Unknowns of an estimate: patterns of names, sets expanded. Empty for other kinds, and for an estimate that analyses
    /// another one.
    pub parameters: Vec<String>,
    /// Parameters of the machine that are one unknown.
    pub ties: Vec<DeclaredTie>,
    /// The settings of an artefact's rows, an object; the same for all artefact plugins.
    pub row_settings: Value,
    /// Whether an estimate may use rows again from which its known values were estimated.
    pub shared_rows: bool,
    /// The largest plausible errors of an estimate from measurements, an object.
    pub plausible: Value,
    /// The column whose labels divide the rows of an estimate into groups with an estimate each, or `file`.
    pub per: Option<String>,
    /// The names of stages under each reference key, as in the recipe.
    pub references: BTreeMap<String, Vec<String>>,
    /// The YAML files that were merged in.
    pub files: Vec<PathBuf>,
}

impl Stage {
    /// The stages named under `key`; none if there is no such key.
    pub fn reference(&self, key: &str) -> &[String] {
        self.references.get(key).map_or(&[], Vec::as_slice)
    }
}
