//! What a user asks for: a recipe by its path or as a text, tables in the place of files, and artefacts in Python.

use std::path::PathBuf;
use std::sync::Arc;

use abbe_core::{Registry, Result};
use abbe_engine::{Given, Prepared, prepare_given};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::artefact::Definition;
use crate::tables::table_of;

/// A recipe with what stands in the place of files, read from Python.
pub struct Asked {
    path: PathBuf,
    given: Given,
    artefacts: Vec<Arc<Definition>>,
}

impl Asked {
    /// Takes over what Python gives; nothing of the recipe is looked at.
    pub fn new(
        path: PathBuf,
        recipe: Option<String>,
        data: Option<&Bound<'_, PyDict>>,
        artefacts: Vec<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let mut given = Given { recipe, ..Given::default() };
        for (name, table) in data.into_iter().flat_map(|data| data.iter()) {
            given.tables.insert(name.extract()?, Arc::new(table_of(&table)?));
        }
        let artefacts = artefacts.iter().map(|artefact| Definition::of(artefact).map(Arc::new));
        Ok(Self { path, given, artefacts: artefacts.collect::<PyResult<_>>()? })
    }

    /// Reads the recipe and builds its stages.
    pub fn prepare(&self) -> Result<Prepared> {
        let mut registry = Registry::built_in()?;
        for definition in &self.artefacts {
            registry.add(definition.plugin())?;
        }
        prepare_given(&self.path, &registry, &self.given)
    }
}
