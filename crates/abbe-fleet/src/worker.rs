//! Doing a job.

use std::collections::BTreeSet;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};

use abbe_core::{Calibration, Error, Monitor, Registry, Result, Verdict};
use abbe_engine::{FailureRecord, FileRecord, Outcome, PluginRecord, Remark, Share, prepared};
use abbe_recipe::Template;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::hash::sha256_of;
use crate::manifest::{Job, Manifest, Point, Shard, Trials};
use crate::plan::{BLOCK, PATH, number, way};
use crate::store::{LARGEST, Store};
use crate::unreadable;

/// Gives the plugins that a recipe is run with.
pub type Registries<'a> = dyn Fn(&Path) -> Result<Registry> + 'a;

/// What a run found, as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The recipe.
    pub recipe: String,
    /// Its calibrations.
    pub calibrations: Vec<Calibration>,
    /// Its verdicts.
    pub verdicts: Vec<Verdict>,
    /// Stages without a result.
    pub failures: Vec<FailureRecord>,
    /// What users should know.
    pub remarks: Vec<Remark>,
    /// The files that were read.
    pub inputs: Vec<FileRecord>,
    /// The plugins that took part.
    pub plugins: Vec<PluginRecord>,
}

impl Found {
    pub(crate) fn of(outcome: &Outcome) -> Self {
        let record = outcome.record();
        Self {
            recipe: record.recipe,
            calibrations: outcome.fits.iter().map(|fit| fit.calibration.clone()).collect(),
            verdicts: outcome.verdicts.clone(),
            failures: record.failures,
            remarks: record.remarks,
            inputs: record.inputs,
            plugins: record.plugins,
        }
    }
}

/// What stands before the values of a block of trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BlockHead {
    /// Names and units of what varies.
    pub quantities: Vec<(String, String)>,
    /// The number of the first trial.
    pub first: usize,
    /// How many they are.
    pub count: usize,
}

/// The recipe of a job: with its settings, without exporters that nobody judges; of a block of trials and of a shard what they need
/// alone. `of` is the estimate whose trials or shards are dealt out.
pub fn adapted(family: &Template, job: &Job, of: Option<&str>, registry: &Registry) -> Result<Template> {
    let mut text = family.clone();
    for setting in &job.set {
        text.set(&setting.at, setting.value.clone())?;
    }
    match (&job.trials, &job.shard, of) {
        (Some(Trials { first, count, .. }), _, Some(stage)) => {
            with_what_it_needs(&mut text, stage, registry)?;
            text.set(&way(stage, BLOCK), json!({ "first": number(*first), "count": number(*count) }))?;
        }
        (None, Some(Shard { from, files, .. }), Some(stage)) => {
            with_what_it_needs(&mut text, stage, registry)?;
            text.set(&way(from, PATH), json!(files))?;
        }
        _ => without_exports(&mut text),
    }
    Ok(text)
}

/// Leaves out what the trials of a stage do not need.
pub fn with_what_it_needs(text: &mut Template, stage: &str, registry: &Registry) -> Result<()> {
    let recipe = text.recipe(registry)?;
    let mut needed: BTreeSet<&str> = BTreeSet::from([stage]);
    // A stage comes after those that it refers to.
    for stage in recipe.stages.iter().rev() {
        if needed.contains(stage.name.as_str()) {
            needed.extend(stage.references.values().flatten().map(String::as_str));
        }
    }
    text.keep(|name| needed.contains(name));
    Ok(())
}

/// Leaves out exporters that no validator judges: a fleet keeps no files of theirs.
fn without_exports(text: &mut Template) {
    let stages = text.value()["stages"].as_object().cloned().unwrap_or_default();
    let names = |value: &Value| -> Vec<String> {
        let list = value.as_array().cloned().unwrap_or_else(|| vec![value.clone()]);
        list.iter().filter_map(Value::as_str).map(str::to_owned).collect()
    };
    let judged: BTreeSet<String> = stages.values().flat_map(|stage| names(&stage["exports"])).collect();
    text.keep(|name| stages.get(name).is_none_or(|stage| stage.get("export").is_none()) || judged.contains(name));
}

/// What became of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Done {
    /// It was done.
    New,
    /// Its result was there already.
    Known,
}

/// Does jobs. It is made in the folder in which the paths of the manifest start, and reads the recipe and the plugins of a family once.
pub struct Worker<'a> {
    manifest: &'a Manifest,
    store: Store,
    registries: &'a Registries<'a>,
    families: Vec<Option<(Template, Registry)>>,
}

impl<'a> Worker<'a> {
    /// A worker that has done nothing yet.
    pub fn new(manifest: &'a Manifest, registries: &'a Registries<'a>) -> Self {
        let families = manifest.head.families.iter().map(|_| None).collect();
        Self { manifest, store: manifest.store(), registries, families }
    }

    /// Does a job, unless it is done.
    ///
    /// # Errors
    /// What the recipe fails with; and for a file that is not the one that was planned. Nothing is kept then.
    pub fn work(&mut self, job: &Job) -> Result<Done> {
        if self.store.has(&job.job) {
            return Ok(Done::Known);
        }
        if let Some(reason) = &job.refused {
            return Err(Error::data(reason));
        }
        let content = self.result(job).map_err(|error| changed_input(&job.inputs).unwrap_or(error))?;
        self.store.put(&job.job, &content)?;
        Ok(Done::New)
    }

    fn result(&mut self, job: &Job) -> Result<Vec<u8>> {
        let family = &self.manifest.head.families[job.family];
        let recipe = PathBuf::from(&family.recipe);
        let ready = &mut self.families[job.family];
        let (template, registry) = match ready {
            Some(ready) => ready,
            None => ready.insert((Template::read(&recipe, &recipe)?, (self.registries)(&recipe)?)),
        };
        let text = adapted(template, job, family.dealt_out(), registry)?;
        let points = &self.manifest.head.points;
        if job.hash(&family.recipe, text.value(), points) != job.job {
            let message = "the recipe, or this line of the manifest, is not the one that was planned";
            return Err(Error::data(message).help(AGAIN).in_file(&recipe));
        }
        let prepared = prepared(text.recipe(registry)?, registry)?;
        if let (Some(shard), Some(stage)) = (&job.shard, &family.shards_of) {
            let none = Point::new();
            let share = Share { from: &shard.from, with_others: shard.number == 0 };
            let part = prepared.part(stage, share, shard.asked, points.get(&shard.of).unwrap_or(&none))?;
            as_planned(&part.inputs, job)?;
            return written(&part);
        }
        let outcome = prepared.run(&Monitor::default())?;
        let found = Found::of(&outcome);
        as_planned(&found.inputs, job)?;
        match (&job.trials, &family.trials_of) {
            (Some(trials), Some(stage)) => block(&outcome, stage, trials),
            _ => written(&found),
        }
    }
}

/// Fails if files were read that are not those that were planned.
fn as_planned(read: &[FileRecord], job: &Job) -> Result<()> {
    match read == job.inputs {
        true => Ok(()),
        false => {
            Err(changed_input(&job.inputs)
                .unwrap_or_else(|| Error::data("a file has changed in the meantime").help(AGAIN)))
        }
    }
}

/// A result as it is kept.
fn written(result: &impl Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec(result).map_err(|error| Error::data(format!("the result cannot be written: {error}")))
}

/// What to do about files that have changed.
const AGAIN: &str = "plan the fleet again: jobs whose files are the same stay done";

/// The first file that is not the one that was planned.
fn changed_input(inputs: &[FileRecord]) -> Option<Error> {
    inputs.iter().find_map(|input| {
        let path = Path::new(&input.file);
        // To read more would take minutes, and tells no more than the error that is known.
        if path.metadata().is_ok_and(|found| found.len() > LARGEST) {
            return None;
        }
        match sha256_of(path) {
            Err(error) => Some(unreadable(path, &error).help(AGAIN)),
            Ok(found) if found == input.sha256 => None,
            Ok(_) => Some(Error::data("the file is not the one that was planned").help(AGAIN).in_file(path)),
        }
    })
}

/// The values of a block: a line that says what they are, then trials x quantities numbers of 8 bytes.
fn block(outcome: &Outcome, stage: &str, trials: &Trials) -> Result<Vec<u8>> {
    if let Some(failure) = outcome.failures.iter().find(|failure| failure.needs.is_none()) {
        return Err(failure.error.clone());
    }
    let fit = outcome.fits.iter().find(|fit| fit.name == stage);
    let samples = fit.and_then(|fit| fit.calibration.monte_carlo.as_ref()?.samples.as_ref());
    let samples = samples.ok_or_else(|| Error::data("the estimate has kept no trials").stage(stage))?;
    if samples.values.len() != trials.count * samples.quantities.len() {
        return Err(Error::data("the estimate has not as many trials as were asked for").stage(stage));
    }
    let head = BlockHead { quantities: samples.quantities.clone(), first: trials.first, count: trials.count };
    let mut content = (json!(head).to_string() + "\n").into_bytes();
    content.extend(samples.values.iter().flat_map(|value| value.to_le_bytes()));
    Ok(content)
}

/// What a worker answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Answer {
    /// The job.
    pub job: String,
    /// Whether its result was there already; none if it failed.
    pub known: Option<bool>,
    /// Why it failed.
    pub reason: Option<String>,
}

/// Does jobs as long as there are lines with some, and answers a line to each. It ends with the process that started it.
///
/// # Errors
/// If the lines cannot be read or answered.
pub fn serve(worker: &mut Worker<'_>, jobs: impl BufRead, mut answers: impl Write) -> Result<()> {
    end_with_parent();
    let broken = |error: &std::io::Error| Error::data(format!("the process that deals out jobs has gone: {error}"));
    for line in jobs.lines() {
        let line = line.map_err(|error| broken(&error))?;
        let job: Job = serde_json::from_str(&line).map_err(|error| Error::data(format!("this is no job: {error}")))?;
        let (known, reason) = match worker.work(&job) {
            Ok(done) => (Some(done == Done::Known), None),
            Err(error) => (None, Some(error.to_string())),
        };
        let answer = json!(Answer { job: job.job, known, reason }).to_string() + "\n";
        answers.write_all(answer.as_bytes()).and_then(|()| answers.flush()).map_err(|error| broken(&error))?;
    }
    Ok(())
}

/// A worker whose owner was killed would work on, and nobody would know.
fn end_with_parent() {
    #[cfg(any(target_os = "linux", target_os = "freebsd"))]
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL));
}
