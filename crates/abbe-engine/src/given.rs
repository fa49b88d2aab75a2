//! What a program gives in the place of files: the text of the recipe, and tables for its ingest stages.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{Error, InputFile, Kind, Registry, Result, Table};
use abbe_recipe::{Recipe, Stage};
use sha2::{Digest, Sha256};

use crate::prepare::{Prepared, built};
use crate::record::{FileRecord, hexadecimal, sha256};
use crate::run::Datasets;

/// What stands in the place of files.
#[derive(Debug, Clone, Default)]
pub struct Given {
    /// The text of the recipe; without one its file is read.
    pub recipe: Option<String>,
    /// Tables by the ingest stages whose files they stand for.
    pub tables: BTreeMap<String, Arc<Table>>,
}

/// As [`prepare`](crate::prepare), with what a program gives in the place of files. `path` is where the recipe stands, or would stand:
/// relative paths start at its folder.
///
/// Also fails for a table of a stage that the recipe does not have, or that takes none.
pub fn prepare_given(path: &Path, registry: &Registry, given: &Given) -> Result<Prepared> {
    let recipe = match &given.recipe {
        Some(text) => Recipe::parse(path, text, registry)?,
        None => Recipe::read(path, registry)?,
    };
    let ingests = || recipe.stages.iter().filter(|stage| stage.kind == Kind::Ingest).map(|stage| stage.name.as_str());
    if let Some(name) = given.tables.keys().find(|name| ingests().all(|known| known != name.as_str())) {
        let names: Vec<&str> = ingests().collect();
        return Err(Error::usage(format!("a table is given for `{name}`, which is no ingest stage of the recipe"))
            .in_file(path)
            .help(format!("its ingest stages are: {}", names.join(", ")))
            .suggest(name, names.iter().copied()));
    }
    let built = built(recipe, registry, given)?;
    Ok(if given.recipe.is_none() { built.of_its_file() } else { built })
}

impl Given {
    /// The record of the recipe, if its text is given.
    pub(crate) fn recipe_record(&self, path: &Path) -> Option<FileRecord> {
        let text = self.recipe.as_ref()?;
        Some(FileRecord { file: path.display().to_string(), sha256: sha256(text.as_bytes()) })
    }
}

impl Prepared {
    /// Gives an ingest stage its table, if there is one; the files that the stage then still reads.
    pub(crate) fn take_table(
        &mut self,
        stage: &Stage,
        given: &Given,
        inputs: Vec<InputFile>,
    ) -> Result<Vec<InputFile>> {
        let Some(table) = given.tables.get(&stage.name) else { return Ok(inputs) };
        let Some(ingest) = self.ingests.remove(&stage.name) else { return Ok(inputs) };
        let ingest = self.located(stage, ingest.with_table(table.clone()))?;
        let inputs = ingest.inputs();
        self.ingests.insert(stage.name.clone(), ingest);
        let mut digest = Sha256::new();
        table.each_byte(|bytes| digest.update(bytes));
        self.tables.insert(stage.name.clone(), hexadecimal(digest.finalize().as_slice()));
        Ok(inputs)
    }

    /// The records of what is read, with those of the recipe and of the tables that were given.
    ///
    /// Fails if another stage reads the file for which a table stands.
    pub(crate) fn with_given(&self, read: Vec<FileRecord>, data: &Datasets) -> Result<Vec<FileRecord>> {
        let mut all: Vec<FileRecord> = self.given_recipe.iter().cloned().chain(read).collect();
        for (stage, sha256) in &self.tables {
            for file in data[stage].files.iter().map(|file| file.display().to_string()) {
                if all.iter().any(|record| record.file == file) {
                    let message = format!("a table stands for {file}, which another stage reads, too");
                    let error = Error::usage(message).help("give a table for that stage as well, or name another file");
                    return Err(self.recipe.locate(error.stage(stage).setting("path")));
                }
                all.push(FileRecord { file, sha256: sha256.clone() });
            }
        }
        Ok(all)
    }
}
