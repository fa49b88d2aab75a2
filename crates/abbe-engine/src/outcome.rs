//! The results of a run, and how they are written to disk: completely or not at all.

use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use abbe_core::{Decision, Error, ExportedFile, Fit, Kind, Result, Verdict};
use abbe_recipe::Stage;
use serde::Serialize;

use crate::prepare::Prepared;
use crate::record::{FailureRecord, FileRecord, PluginRecord, RUN_FORMAT, Remark, RunRecord, sha256};
use crate::results::{RECORD, ResultFolder, parent, put, real};
use crate::staging::{Staging, can_write, exclusive_access, unwritable};

/// Everything that a run found, in memory.
pub struct Outcome {
    /// Name of the recipe, which names the folder.
    pub recipe: String,
    /// What the recipe says that it is.
    pub title: String,
    /// The estimates.
    pub fits: Vec<Fit>,
    /// The verdicts.
    pub verdicts: Vec<Verdict>,
    /// Exported files and tables of validators by stage.
    pub exports: Vec<(String, Vec<ExportedFile>)>,
    /// The stages that failed, and those that were left out because they need one of them.
    pub failures: Vec<Failure>,
    /// What users should know before they trust the results.
    pub remarks: Vec<Remark>,
    /// Those of them that are hard to believe.
    pub doubts: Vec<Remark>,
    /// Further files among the results, by their names in the folder: the report and what it is made of.
    pub attached: Vec<(PathBuf, Vec<u8>)>,
    pub(crate) inputs: Vec<FileRecord>,
    /// The files that were read, by their whole paths.
    pub(crate) input_files: Vec<PathBuf>,
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

    /// Writes the results into `<out>/<recipe>/` and returns that folder. Results of an earlier run there are replaced, as long as
    /// they are as that run wrote them; all else stays.
    ///
    /// Files are written into a temporary folder beside it, which replaces it in the end. So at any time the folder contains
    /// the complete results of one run, or does not exist. Fails if a file of somebody else is in the way of a result, or has made the
    /// folder one that is not of a run; the results are then beside it, and the error says where.
    pub fn write(&self, out: &Path) -> Result<PathBuf> {
        let target = out.join(&self.recipe);
        let unwritable = |error: io::Error| unwritable(out, &error);
        let files = self.files()?;
        let place = real(&target);
        let staging = Staging::new(parent(&place), out)?;
        let record = RunRecord { outputs: outputs(&files), ..self.record() };
        for (name, content) in &files {
            staging.write(name, content).map_err(unwritable)?;
        }
        staging.write(Path::new(RECORD), json(&record)?.as_bytes()).map_err(unwritable)?;
        // Another run may have written the folder in the meantime.
        let _access = exclusive_access(parent(&place));
        put(staging, &place, &self.input_files)?;
        Ok(target)
    }

    /// All files of the results but the record of the run.
    fn files(&self) -> Result<Vec<(PathBuf, Cow<'_, [u8]>)>> {
        let mut files: Vec<(PathBuf, Cow<'_, [u8]>)> = Vec::new();
        for fit in &self.fits {
            files.push((calibration_file(&fit.name), fit.calibration.to_json()?.into_bytes().into()));
        }
        files.push((VERDICTS.into(), json(&self.verdicts)?.into_bytes().into()));
        for (stage, exported) in &self.exports {
            files.extend(exported.iter().map(|file| (Path::new(stage).join(&file.name), Cow::from(&file.content))));
        }
        files.extend(self.attached.iter().map(|(name, content)| (name.clone(), Cow::from(content))));
        Ok(files)
    }

    /// The record of the run, as in `run.json`, without what is written.
    pub fn record(&self) -> RunRecord {
        RunRecord {
            abbe_run: RUN_FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            recipe: self.recipe.clone(),
            title: self.title.clone(),
            inputs: self.inputs.clone(),
            plugins: self.plugins.clone(),
            failures: self.failures.iter().map(FailureRecord::of).collect(),
            remarks: self.remarks.clone(),
            outputs: Vec::new(),
            started_unix_s: self.started.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs()),
            duration_s: self.duration.as_secs_f64(),
        }
    }
}

impl Prepared {
    /// Fails early if the results cannot be written to `out`, or if a file of somebody else is in the way of one that is known
    /// already.
    pub fn can_write(&self, out: &Path) -> Result<()> {
        let folder = ResultFolder::new(&out.join(&self.recipe.id), &self.files)?;
        let estimates = self.stages(Kind::Estimate).map(|stage| calibration_file(&stage.name));
        let residuals = self.stages(Kind::Estimate).map(|stage| residuals_file(&stage.name));
        let known = estimates.chain(residuals).chain([VERDICTS.into(), REPORT.into(), RECORD.into()]);
        known.into_iter().try_for_each(|name: PathBuf| folder.can_take(&name))?;
        can_write(folder.parent(), out)
    }
}

/// The file with all verdicts.
pub const VERDICTS: &str = "verdicts.json";

/// The page about a run.
pub const REPORT: &str = "report.html";

/// What the names of calibrations end in.
pub const CALIBRATION: &str = ".calibration.json";

fn calibration_file(estimate: &str) -> PathBuf {
    format!("{estimate}{CALIBRATION}").into()
}

/// The file with the residuals of an estimate.
pub fn residuals_file(estimate: &str) -> PathBuf {
    format!("{estimate}.residuals.csv").into()
}

/// What the record of a run says of the files that it wrote.
fn outputs(files: &[(PathBuf, Cow<'_, [u8]>)]) -> Vec<FileRecord> {
    let record = |(name, content): &(PathBuf, Cow<'_, [u8]>)| FileRecord {
        file: name.components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/"),
        sha256: sha256(content),
    };
    files.iter().map(record).collect()
}

fn json<T: Serialize>(value: &T) -> Result<String> {
    serde_json::to_string_pretty(value)
        .map(|text| text + "\n")
        .map_err(|error| Error::data(format!("a result cannot be written: {error}")))
}
