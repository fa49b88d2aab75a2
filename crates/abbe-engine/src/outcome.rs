//! The results of a run, and how they are written to disk: completely or not at all.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use abbe_core::{Decision, Error, ExportedFile, Fit, Kind, Result, Verdict};
use abbe_recipe::Stage;
use serde::Serialize;

use crate::record::{FailureRecord, InputRecord, PluginRecord, RUN_FORMAT, RunRecord};

/// Everything that a run found, in memory.
pub struct Outcome {
    /// Name of the recipe, which names the folder.
    pub recipe: String,
    /// The estimates.
    pub fits: Vec<Fit>,
    /// The verdicts.
    pub verdicts: Vec<Verdict>,
    /// Exported files and tables of validators by stage.
    pub exports: Vec<(String, Vec<ExportedFile>)>,
    /// The stages that failed, and those that were left out because they need one of them.
    pub failures: Vec<Failure>,
    pub(crate) inputs: Vec<InputRecord>,
    pub(crate) plugins: Vec<PluginRecord>,
    pub(crate) started: SystemTime,
    pub(crate) duration: Duration,
}

/// A stage without a result.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Its name.
    pub stage: String,
    /// Its kind.
    pub kind: Kind,
    /// Why it has no result.
    pub error: Error,
    /// The stage that failed and that it needs; none if it failed itself.
    pub needs: Option<String>,
}

impl Failure {
    pub(crate) fn own(stage: &Stage, error: Error) -> Self {
        Self { stage: stage.name.clone(), kind: stage.kind, error, needs: None }
    }

    pub(crate) fn of_needed(stage: &Stage, needed: &str) -> Self {
        let error = Error::data(format!("it needs `{needed}`, which failed")).stage(&stage.name);
        Self { stage: stage.name.clone(), kind: stage.kind, error, needs: Some(needed.to_owned()) }
    }
}

impl Outcome {
    /// The decision on the run: it fails if one verdict fails, else it is inconclusive if one is, else it passes.
    pub fn decision(&self) -> Decision {
        Decision::of_all(self.verdicts.iter().map(|verdict| verdict.decision))
    }

    /// Whether no stage failed and no verdict fails.
    pub fn passes(&self) -> bool {
        self.failures.is_empty() && self.decision().passes()
    }

    /// Writes the results into `<out>/<recipe>/` and returns that folder. Results of an earlier run there are replaced.
    ///
    /// Files are written into a temporary folder beside it, which replaces it in the end. So at any time the folder contains
    /// the complete results of one run, or does not exist.
    pub fn write(&self, out: &Path) -> Result<PathBuf> {
        let unwritable = |error: io::Error| unwritable(out, &error);
        is_ours(&out.join(&self.recipe))?;
        let staging = staging(out)?;
        let write = |name: &str, content: &[u8]| -> Result<()> {
            let path = staging.path().join(name);
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder).map_err(unwritable)?;
            }
            fs::write(path, content).map_err(unwritable)
        };
        for fit in &self.fits {
            write(&format!("{}.calibration.json", fit.name), fit.calibration.to_json()?.as_bytes())?;
        }
        write("verdicts.json", json(&self.verdicts)?.as_bytes())?;
        for (stage, files) in &self.exports {
            for file in files {
                write(&format!("{stage}/{}", file.name), &file.content)?;
            }
        }
        write("run.json", json(&self.record())?.as_bytes())?;

        let target = out.join(&self.recipe);
        let staged = staging.keep();
        replace(&staged, &target).map_err(unwritable)?;
        Ok(target)
    }

    /// The record of the run, as in `run.json`.
    pub fn record(&self) -> RunRecord {
        RunRecord {
            abbe_run: RUN_FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            recipe: self.recipe.clone(),
            inputs: self.inputs.clone(),
            plugins: self.plugins.clone(),
            failures: self.failures.iter().map(FailureRecord::of).collect(),
            started_unix_s: self.started.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs()),
            duration_s: self.duration.as_secs_f64(),
        }
    }

    /// Fails early if the results of a recipe cannot be written to `out`.
    pub fn can_write(out: &Path, recipe: &str) -> Result<()> {
        is_ours(&out.join(recipe))?;
        staging(out).map(drop)
    }
}

/// Refuses to replace anything but the results of an earlier run.
fn is_ours(target: &Path) -> Result<()> {
    let empty = || fs::read_dir(target).is_ok_and(|mut entries| entries.next().is_none());
    let run = || fs::read_to_string(target.join("run.json")).is_ok_and(|text| text.contains("\"abbe_run\""));
    if !target.exists() || (target.is_dir() && (run() || empty())) {
        return Ok(());
    }
    Err(Error::data(format!("{} is there already and holds no results of a run", target.display()))
        .help("move it away, or name another folder with `--out`"))
}

/// Replaces a folder by another one, or moves it to a new path.
///
/// If the system can exchange two folders in one step, the path always has the old folder or the new one, even if the program
/// is stopped.
fn replace(staged: &Path, target: &Path) -> io::Result<()> {
    if !target.exists() {
        return fs::rename(staged, target);
    }
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        if renameat_with(CWD, staged, CWD, target, RenameFlags::EXCHANGE).is_ok() {
            return fs::remove_dir_all(staged);
        }
    }
    // Two renames, so that the old results are gone only once the new ones are complete.
    let old = staged.with_extension("old");
    fs::rename(target, &old)?;
    fs::rename(staged, target)?;
    fs::remove_dir_all(&old)
}

/// What the names of temporary folders begin with.
const STAGING: &str = ".abbe-partial-";

/// Makes a temporary folder in `out`. Temporary folders of interrupted runs, older than a minute, are removed.
pub(crate) fn staging(out: &Path) -> Result<tempfile::TempDir> {
    let unwritable = |error: io::Error| unwritable(out, &error);
    fs::create_dir_all(out).map_err(unwritable)?;
    for entry in fs::read_dir(out).map_err(unwritable)?.flatten() {
        let stale = entry.metadata().and_then(|data| data.modified()).ok();
        let age = stale.and_then(|modified| modified.elapsed().ok()).unwrap_or_default();
        // Folders of another run that is writing now must stay: writing takes much less than a minute.
        if entry.file_name().to_string_lossy().starts_with(STAGING) && age > Duration::from_secs(60) {
            fs::remove_dir_all(entry.path()).map_err(unwritable)?;
        }
    }
    tempfile::Builder::new().prefix(STAGING).tempdir_in(out).map_err(unwritable)
}

pub(crate) fn unwritable(out: &Path, error: &io::Error) -> Error {
    Error::data(format!("the results cannot be written to {}: {error}", out.display()))
        .help("name another folder with `--out`")
}

fn json<T: Serialize>(value: &T) -> Result<String> {
    serde_json::to_string_pretty(value)
        .map(|text| text + "\n")
        .map_err(|error| Error::data(format!("a result cannot be written: {error}")))
}
