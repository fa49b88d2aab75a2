//! From what is wanted to a manifest.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use abbe_core::{AskedOfPart, Error, Kind, Monitor, Registry, Result, in_parallel};
use abbe_engine::{FileRecord, prepared};
use abbe_recipe::Template;
use serde_json::Value;

use crate::fleet::{FamilyWanted, Fleet, ShardsWanted, TrialsWanted, Wanted};
use crate::hash::sha256_of;
use crate::manifest::{Family, Head, Job, MANIFEST_FORMAT, Manifest, Shard, Trials, VERSION, relative};
use crate::rounds::next_round;
use crate::unreadable;
use crate::worker::{Registries, adapted};

/// Writes the manifest of a fleet to `path`. It is called in the folder of the fleet, where all its paths start.
///
/// A job whose recipe or data cannot be used as far as that shows without reading rows stays in the manifest with the reason, and costs
/// no other one.
///
/// # Errors
/// For what is wrong with all jobs of a family, if the manifest cannot be written, and if `monitor` is cancelled.
pub fn plan(
    fleet: &Fleet,
    path: &Path,
    registries: &Registries<'_>,
    monitor: &Monitor,
) -> Result<(Manifest, Vec<Job>)> {
    let hashes = Hashes::default();
    let mut jobs = Vec::new();
    for (index, wanted) in fleet.families.iter().enumerate() {
        let registry = registries(&wanted.recipe)?;
        let family =
            FamilyPlan { index, wanted, registry: &registry, hashes: &hashes, history: fleet.history.is_some() };
        let planned = |job: &Wanted| monitor.check().and_then(|()| family.jobs(job));
        for planned in in_parallel(&wanted.jobs, None, planned) {
            jobs.extend(planned?);
        }
    }
    let family = |wanted: &FamilyWanted| Family {
        name: wanted.name.clone(),
        recipe: wanted.recipe.display().to_string(),
        trials_of: wanted.trials.as_ref().map(|trials| trials.stage.clone()),
        shards_of: wanted.shards.as_ref().map(|shards| shards.stage.clone()),
    };
    let here = std::env::current_dir().map_err(|error| unreadable(Path::new("."), &error))?;
    let place = abbe_files::place(path);
    let head = Head {
        abbe_fleet_manifest: MANIFEST_FORMAT,
        version: VERSION.to_owned(),
        fleet: fleet.name.clone(),
        base: relative(place.parent().unwrap_or(Path::new("/")), &abbe_files::place(&here)),
        jobs: jobs.len(),
        history: fleet.history.clone(),
        families: fleet.families.iter().map(family).collect(),
        points: BTreeMap::new(),
        sha256: None,
    };
    let mut manifest = Manifest::write(path, head, &jobs)?;
    // Rounds of shards that are done already are not done again.
    if manifest.has_shards() {
        next_round(&mut manifest, registries)?;
        jobs.clear();
        manifest.each_job(0..manifest.head.jobs, |_, job| {
            jobs.push(job);
            Ok(())
        })?;
    }
    Ok((manifest, jobs))
}

/// The hashes of files, each read once.
#[derive(Default)]
struct Hashes(Mutex<BTreeMap<PathBuf, String>>);

impl Hashes {
    fn of(&self, file: &Path) -> Result<String> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(hash) = known().get(file) {
            return Ok(hash.clone());
        }
        let hash = sha256_of(file).map_err(|error| unreadable(file, &error))?;
        known().insert(file.to_owned(), hash.clone());
        Ok(hash)
    }
}

/// A family that is planned.
struct FamilyPlan<'a> {
    index: usize,
    wanted: &'a FamilyWanted,
    registry: &'a Registry,
    hashes: &'a Hashes,
    /// Whether results go to a history, which has to know when they were.
    history: bool,
}

impl FamilyPlan<'_> {
    /// The jobs of one combination of variables: one, or the blocks of its trials, or its shards.
    fn jobs(&self, wanted: &Wanted) -> Result<Vec<Job>> {
        let whole = Job {
            job: String::new(),
            name: wanted.name.clone(),
            family: self.index,
            variables: wanted.variables.clone(),
            set: wanted.settings.clone(),
            inputs: Vec::new(),
            history: wanted.kept.clone(),
            trials: None,
            shard: None,
            refused: None,
        };
        let planned: Vec<Job> = match (&self.wanted.trials, &self.wanted.shards) {
            (Some(trials), _) => {
                let blocks = self.blocks(wanted, trials)?.into_iter();
                blocks.map(|block| Job { name: name_of_block(&block), trials: Some(block), ..whole.clone() }).collect()
            }
            (None, Some(shards)) => match self.shards(&whole, shards) {
                Ok(all) => all
                    .into_iter()
                    .map(|shard| Job { name: name_of_shard(&shard), shard: Some(shard), ..whole.clone() })
                    .collect(),
                Err(error) => vec![Job { refused: Some(error.to_string()), ..whole }],
            },
            (None, None) => vec![whole],
        };
        let of = self.wanted.trials.as_ref().map(|trials| trials.stage.as_str());
        let of = of.or(self.wanted.shards.as_ref().map(|shards| shards.stage.as_str()));
        let mut inputs = None;
        let mut jobs = Vec::new();
        for mut job in planned {
            let text = adapted(&self.wanted.template, &job, of, self.registry);
            // All blocks read the same files.
            let read = text.as_ref().map_err(Clone::clone).and_then(|text| match inputs.take() {
                Some(inputs) if job.shard.is_none() => Ok(inputs),
                _ => self.inputs(wanted, text),
            });
            match read {
                _ if job.refused.is_some() => {}
                Ok(found) => job.inputs = found,
                Err(error) if is_of_family(&error) => return Err(error),
                Err(error) => job.refused = Some(error.to_string()),
            }
            let text = text.as_ref().map_or(self.wanted.template.value(), Template::value);
            job.job = job.hash(&self.wanted.recipe.display().to_string(), text, &BTreeMap::new());
            inputs = job.refused.is_none().then(|| job.inputs.clone());
            jobs.push(job);
        }
        Ok(jobs)
    }

    /// The files that a recipe reads, with their hashes.
    fn inputs(&self, wanted: &Wanted, text: &Template) -> Result<Vec<FileRecord>> {
        let prepared = prepared(text.recipe(self.registry)?, self.registry)?;
        let estimates = prepared.recipe.stages.iter().filter(|stage| stage.kind == Kind::Estimate);
        if self.history && wanted.kept.at.is_none() && estimates.clone().any(|stage| stage.per.is_none()) {
            let message = format!("`at` is missing in the family `{}`", self.wanted.name);
            return Err(Error::usage(message).help(WHEN));
        }
        let mut inputs: Vec<FileRecord> = Vec::new();
        for path in prepared.files() {
            let file = path.display().to_string();
            if !inputs.iter().any(|known| known.file == file) {
                inputs.push(FileRecord { file, sha256: self.hashes.of(path)? });
            }
        }
        Ok(inputs)
    }

    /// The shards of one estimate: some files each, in their order.
    fn shards(&self, whole: &Job, shards: &ShardsWanted) -> Result<Vec<Shard>> {
        let mut text = self.wanted.template.clone();
        for setting in &whole.set {
            text.set(&setting.at, setting.value.clone())?;
        }
        let prepared = prepared(text.recipe(self.registry)?, self.registry)?;
        prepared.check_parts(&shards.stage, &shards.from)?;
        let base = &prepared.recipe.base;
        let own = |file: PathBuf| file.strip_prefix(base).unwrap_or(&file).display().to_string();
        let files: Vec<String> = prepared.measured_files(&shards.from)?.into_iter().map(own).collect();
        let all = files.len().div_ceil(shards.files);
        let shard = |(number, files): (usize, &[String])| Shard {
            of: whole.name.clone(),
            number,
            all,
            from: shards.from.clone(),
            files: files.to_vec(),
            round: 0,
            asked: AskedOfPart::Start,
        };
        Ok(files.chunks(shards.files).enumerate().map(shard).collect())
    }

    /// The blocks of the trials of a combination.
    fn blocks(&self, wanted: &Wanted, trials: &TrialsWanted) -> Result<Vec<Trials>> {
        let mut text = self.wanted.template.clone();
        for setting in &wanted.settings {
            text.set(&setting.at, setting.value.clone())?;
        }
        let stage = &text.value()["stages"][&trials.stage];
        let wrong = |message: String| Error::usage(message).stage(&trials.stage);
        let plugin = stage["estimate"].as_str().and_then(|name| self.registry.find(Kind::Estimate, name).ok());
        let settings = plugin.map(|plugin| plugin.schema.get());
        let takes = |key: &str| settings.is_some_and(|schema| schema["properties"].get(key).is_some());
        if !takes(BLOCK) || !takes(SOLVED) {
            return Err(wrong("this is no estimate by trials in blocks; `monte-carlo` is one".to_owned()));
        }
        if stage.get("adaptive").is_some() {
            return Err(wrong(
                "trials in blocks need a number that is fixed before: `trials`, and not `adaptive`".into(),
            ));
        }
        let all = stage["trials"].as_u64().and_then(|all| usize::try_from(all).ok()).filter(|all| *all > 0);
        let all = all.ok_or_else(|| wrong("the number of trials is missing: `trials: 100000`".to_owned()))?;
        let count = all.div_ceil(trials.block);
        if count > MOST_BLOCKS {
            let message = format!(
                "{all} trials in blocks of {} are {count} jobs, at most {MOST_BLOCKS} were expected",
                trials.block
            );
            return Err(wrong(message).help("choose a larger `block`"));
        }
        let block = |first| Trials { of: wanted.name.clone(), first, count: trials.block.min(all - first), all };
        Ok((0..all).step_by(trials.block).map(block).collect())
    }
}

/// Most blocks of the trials of a calculation: more of them take longer to deal out than to solve.
const MOST_BLOCKS: usize = 10_000;

/// What people call a block.
fn name_of_block(Trials { of, first, count, .. }: &Trials) -> String {
    format!("{of}/trials {first}-{}", first + count - 1)
}

/// What people call a shard in its round, both from 1.
pub fn name_of_shard(Shard { of, number, round, .. }: &Shard) -> String {
    format!("{of}/shard {}, round {}", number + 1, round + 1)
}

/// The settings of an estimate by trials: a block to solve, and where solved ones are.
pub const BLOCK: &str = "block";
pub const SOLVED: &str = "solved";

/// The setting of an ingest stage that names its files.
pub const PATH: &str = "path";

/// What to do about a history that does not know when.
const WHEN: &str =
    "write `at: \"{week}\"` and `unit: week`, or a date as 2026-03-02: the history orders calibrations by their times";

/// Whether an error is about what is written for all jobs of a family.
fn is_of_family(error: &Error) -> bool {
    error.help.as_deref() == Some(WHEN)
}

/// A setting as a list of keys.
pub fn way(stage: &str, setting: &str) -> [String; 2] {
    [stage.to_owned(), setting.to_owned()]
}

/// A number as JSON.
pub fn number(value: usize) -> Value {
    Value::from(value as u64)
}
