//! The blocks of trials of one estimate, put together.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use abbe_core::{Error, Monitor, Result};
use abbe_engine::{prepared, temporary_file};
use abbe_recipe::Template;
use serde_json::Value;

use crate::manifest::{Family, Job, Trials};
use crate::plan::{SOLVED, way};
use crate::unwritable;
use crate::worker::{BlockHead, Found, Registries, adapted};

/// The values of trials so far, in a file: they need not fit into the memory.
pub struct Blocks {
    trials: Trials,
    /// Blocks without a result.
    pub missing: usize,
    quantities: Option<Vec<(String, String)>>,
    file: BufWriter<tempfile::NamedTempFile>,
}

impl Blocks {
    pub fn new(folder: &Path, trials: &Trials) -> Result<Self> {
        let file = temporary_file(folder).map_err(|error| unwritable(folder, &error))?;
        let file = BufWriter::with_capacity(1 << 16, file);
        Ok(Self { trials: trials.clone(), missing: 0, quantities: None, file })
    }

    pub fn is_of(&self, trials: &Trials) -> bool {
        self.trials.of == trials.of
    }

    /// Adds the next block.
    pub fn push(&mut self, trials: &Trials, content: &[u8]) -> Result<()> {
        let wrong = || Error::data(format!("the result of trial {} and those after it is none", trials.first));
        let end = content.iter().position(|byte| *byte == b'\n').ok_or_else(wrong)?;
        let head: BlockHead = serde_json::from_slice(&content[..end]).map_err(|_| wrong())?;
        let values = &content[end + 1..];
        let same = self.quantities.get_or_insert_with(|| head.quantities.clone()) == &head.quantities;
        if !same
            || (head.first, head.count) != (trials.first, trials.count)
            || values.len() != 8 * head.count * head.quantities.len()
        {
            return Err(wrong());
        }
        let path = self.file.get_ref().path().to_owned();
        self.file.write_all(values).map_err(|error| unwritable(&path, &error))
    }

    /// What the recipe finds if these are its trials.
    pub fn found(self, family: &Family, job: &Job, stage: &str, registries: &Registries<'_>) -> Result<Found> {
        let folder = self.file.get_ref().path().to_owned();
        let file = self.file.into_inner().map_err(|error| unwritable(&folder, &error.into_error()))?;
        let recipe = PathBuf::from(&family.recipe);
        let registry = registries(&recipe)?;
        // As a whole, and not as a block.
        let whole = Job { trials: None, ..job.clone() };
        let mut text = adapted(&Template::read(&recipe, &recipe)?, &whole, None, &registry)?;
        let place = std::path::absolute(file.path()).map_err(|error| unwritable(file.path(), &error))?;
        let named = place.display().to_string();
        text.set(&way(stage, SOLVED), Value::String(named.clone()))?;
        let outcome = prepared(text.recipe(&registry)?, &registry)?.run(&Monitor::default())?;
        let mut found = Found::of(&outcome);
        found.inputs.retain(|input| input.file != named);
        match job.inputs.iter().find(|input| !found.inputs.contains(input)) {
            Some(changed) => {
                let error = Error::data("the file is not the one that was planned").in_file(Path::new(&changed.file));
                Err(error.help("plan the fleet again"))
            }
            None => Ok(found),
        }
    }
}
