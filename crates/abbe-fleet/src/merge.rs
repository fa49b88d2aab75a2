//! Results of all jobs as one: tables, a history, distributions.

mod blocks;
mod keeper;
mod names;

use std::collections::BTreeSet;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Calibration, Decision, Error, Monitor, Result, Verdict};
use abbe_engine::{MadeFolders, refuse_temporary_place};
use abbe_history::{Entry, Stored};
use abbe_recipe::HistoryPlace;
use serde_json::{Value, json};

use crate::manifest::{Job, Kept, Manifest, VERSION};
use crate::own_files::OwnFiles;
use crate::rounds::{Answer, Estimate};
use crate::store::Store;
use crate::table::{Cell, Column, Table};
use crate::worker::{Found, Registries};
use crate::{BROKEN, unwritable};
use blocks::Blocks;
use keeper::Keeper;
use names::Names;

/// What a merge has made.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Merged {
    /// Jobs whose results are in it.
    pub jobs: usize,
    /// Calibrations.
    pub calibrations: usize,
    /// Entries that are new in the history.
    pub entries: usize,
    /// Names of jobs without a result, or with stages that failed, with the reason.
    pub failed: Vec<(String, String)>,
    /// Jobs that nobody has done.
    pub open: usize,
    /// Jobs with remarks on their estimates.
    pub remarked: usize,
    /// Files of earlier merges, by their names in the folder, that this one did not write.
    pub earlier: BTreeSet<String>,
}

/// Puts the results of all jobs together, in the order of the manifest: tables in `out`, calibrations as files on request (`files`), entries
/// of the history that the fleet names. It is called in the folder where the paths of the fleet start.
///
/// Jobs that failed are told, and cost no others; jobs that nobody has done yet are an error unless `partial`.
///
/// # Errors
/// For open jobs, for a manifest that was changed since it was planned, for results and tables of another fleet, for names of temporary folders, if the disk or the history does not take what is written,
/// while another merge of this manifest is at work, after a minute, and if `monitor` is cancelled before all jobs are read.
pub fn merge(
    manifest: &Manifest,
    out: &Path,
    files: bool,
    partial: bool,
    registries: &Registries<'_>,
    monitor: &Monitor,
) -> Result<Merged> {
    if !partial {
        none_open(manifest)?;
    }
    manifest.unchanged()?;
    refuse_temporary_place(out)?;
    refuse_history_within(out, manifest.head.history.as_deref())?;
    let _alone = alone(manifest, monitor)?;
    let (mut last, mut shards, mut families) = (None, Vec::new(), Vec::new());
    let mut folder = MadeFolders::new(out).map_err(|error| unwritable(out, &error).help("name a folder: `--out`"))?;
    for family in &manifest.head.families {
        families.push(family.trials_of.as_deref());
    }
    let mut merging = Merging {
        manifest,
        store: manifest.store(),
        tables: Tables::new(out)?,
        keeper: manifest.head.history.as_deref().map(Keeper::open).transpose()?,
        own: OwnFiles::of(out, &manifest.head.fleet)?,
        out: out.to_owned(),
        files,
        names: Names::default(),
        merged: Merged::default(),
    };
    merging.tables.check(&merging.own)?;
    manifest.each_job(0..manifest.head.jobs, |_, job| {
        monitor.check()?;
        match (&job.trials, families[job.family], &job.shard) {
            (Some(_), Some(stage), _) => merging.block(&mut last, job, stage, registries),
            (_, _, Some(_)) => merging.shard(&mut shards, job, partial, registries),
            _ => merging.job(&job),
        }
    })?;
    let Merging { tables, keeper, mut merged, mut own, .. } = merging;
    if !partial && merged.open > 0 {
        // A result that is damaged is none.
        return Err(still_open(manifest, merged.open, None));
    }
    if let Some(keeper) = keeper {
        merged.entries -= keeper.finish()?;
    }
    tables.finish(&mut own)?;
    own.put_waiting()?;
    merged.earlier = own.finish();
    folder.keep();
    Ok(merged)
}

/// What the names of the files that a merge writes end with.
const ENDINGS: [&str; 3] = ["csv", "json", "jsonl"];

/// Refuses a history in the folder of the tables with a name that one of them may have: it would take its place, or it that of the table.
fn refuse_history_within(out: &Path, history: Option<&str>) -> Result<()> {
    let Some(Ok(HistoryPlace::File(history))) = history.map(HistoryPlace::parse) else { return Ok(()) };
    let may_be_ours =
        ENDINGS.iter().any(|ending| history.extension().is_some_and(|own| own.eq_ignore_ascii_case(ending)));
    if !may_be_ours || !abbe_files::place(&history).starts_with(abbe_files::place(out)) {
        return Ok(());
    }
    let error = Error::usage("the history is in the folder of the tables, and has a name as they have");
    Err(error.in_file(&history).help("name another place under `history` of the fleet, such as `plant.sqlite`"))
}

/// How often, and how long after each other, a merge asks whether another one of its manifest has ended.
const ASKED: u32 = 600;
const PAUSE: Duration = Duration::from_millis(100);

/// A lock on the manifest: one merge of it is at work at a time. None where there are no locks, and on Windows, whose locks keep readers
/// out. Folders are no place for it: who writes into one locks it, and tables may go into the folder of results.
fn alone(manifest: &Manifest, monitor: &Monitor) -> Result<Option<File>> {
    if cfg!(windows) {
        return Ok(None);
    }
    let Ok(file) = File::open(&manifest.path) else { return Ok(None) };
    for _ in 0..ASKED {
        monitor.check()?;
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::WouldBlock) => std::thread::sleep(PAUSE),
            Err(TryLockError::Error(_)) => return Ok(None),
        }
    }
    let message =
        format!("another `abbe fleet merge` of this manifest is at work, for {} s now", (PAUSE * ASKED).as_secs());
    Err(Error::data(message).in_file(&manifest.path).help("merge again when it has ended; nothing was changed"))
}

/// Fails if there are jobs that nobody has tried.
fn none_open(manifest: &Manifest) -> Result<()> {
    let store = manifest.store();
    let (mut open, mut first) = (0, None);
    manifest.each_job(0..manifest.head.jobs, |_, job| {
        let is_there = |path: PathBuf| path.symlink_metadata().is_ok();
        let tried = job.refused.is_some() || is_there(store.failure_file(&job.job));
        if !tried && !is_there(store.result_file(&job.job)) {
            open += 1;
            first.get_or_insert(job.name);
        }
        Ok(())
    })?;
    if first.is_some() { Err(still_open(manifest, open, first)) } else { Ok(()) }
}

fn still_open(manifest: &Manifest, open: usize, first: Option<String>) -> Error {
    let first = first.map_or_else(String::new, |first| format!(", the first is `{first}`"));
    let message = format!("{open} of {} jobs are open{first}", manifest.head.jobs);
    Error::data(message).help("do them: `abbe fleet run`; or merge what is there: `--partial`")
}

/// The tables of a fleet.
struct Tables {
    jobs: Table,
    parameters: Table,
    verdicts: Table,
    distributions: Table,
    remarks: Table,
}

impl Tables {
    fn new(out: &Path) -> Result<Self> {
        use Column::{Number, Text};
        const JOB: [Column; 5] = [Text("job"), Text("machine"), Text("label"), Number("at"), Text("unit_of_time")];
        let of_job = |rest: &[Column]| [&JOB, rest].concat();
        let jobs = [
            Text("job"),
            Text("family"),
            Text("state"),
            Text("decision"),
            Text("reason"),
            Text("variables"),
            Number("remarks"),
        ];
        let parameters = [
            Text("estimate"),
            Text("parameter"),
            Number("value"),
            Text("unit"),
            Number("standard_uncertainty"),
            Text("status"),
        ];
        let verdicts = [
            Text("stage"),
            Text("validator"),
            Text("decision"),
            Text("of"),
            Text("figure"),
            Number("value"),
            Text("unit"),
            Number("limit"),
            Text("decision_of_figure"),
        ];
        let distributions = [
            Text("estimate"),
            Text("parameter"),
            Text("unit"),
            Number("mean"),
            Number("standard_uncertainty"),
            Number("symmetric_low"),
            Number("symmetric_high"),
            Number("shortest_low"),
            Number("shortest_high"),
            Number("probability"),
            Number("trials"),
            Number("failed"),
        ];
        Ok(Self {
            jobs: Table::new(out, "jobs", &jobs)?,
            parameters: Table::new(out, "parameters", &of_job(&parameters))?,
            verdicts: Table::new(out, "verdicts", &of_job(&verdicts))?,
            distributions: Table::new(out, "distributions", &of_job(&distributions))?,
            remarks: Table::new(out, "remarks", &[Text("job"), Text("stage"), Text("remark")])?,
        })
    }

    fn check(&self, own: &OwnFiles) -> Result<()> {
        let all = [&self.jobs, &self.parameters, &self.verdicts, &self.distributions, &self.remarks];
        all.into_iter().try_for_each(|it| it.check(own))
    }

    fn finish(self, own: &mut OwnFiles) -> Result<()> {
        let mut all = [self.jobs, self.parameters, self.verdicts, self.distributions, self.remarks].into_iter();
        all.try_for_each(|table| table.finish(own))
    }
}

/// A merge under way.
struct Merging<'a> {
    manifest: &'a Manifest,
    store: Store,
    tables: Tables,
    keeper: Option<Keeper>,
    own: OwnFiles,
    out: PathBuf,
    files: bool,
    names: Names,
    merged: Merged,
}

impl Merging<'_> {
    /// Adds a job that is a run by itself.
    fn job(&mut self, job: &Job) -> Result<()> {
        match self.store.get(&job.job) {
            Some(content) => {
                let found = serde_json::from_slice(&content).map_err(|error| {
                    Error::data(format!("this is no result of a job: {error}"))
                        .in_file(&self.store.result_file(&job.job))
                        .help(BROKEN)
                })?;
                self.found(job, &job.name, found, self.files)
            }
            None => self.without(job, &job.name),
        }
    }

    /// Adds a block of trials; with the last one what all of them are.
    fn block(&mut self, last: &mut Option<Blocks>, job: Job, stage: &str, registries: &Registries<'_>) -> Result<()> {
        let Some(trials) = job.trials.clone() else { return Ok(()) };
        let blocks = match last.take().filter(|blocks| blocks.is_of(&trials)) {
            Some(blocks) => last.insert(blocks),
            None => last.insert(Blocks::new(&self.out, &trials)?),
        };
        match self.store.get(&job.job) {
            Some(content) => blocks.push(&trials, &content)?,
            None => {
                blocks.missing += 1;
                self.without(&job, &job.name)?;
            }
        }
        if trials.first + trials.count < trials.all {
            return Ok(());
        }
        let Some(blocks) = last.take() else { return Ok(()) };
        let missing = blocks.missing;
        if missing > 0 {
            let reason = format!("{missing} of its blocks have no result");
            return self.failed(&job, &trials.of, &reason);
        }
        match blocks.found(&self.manifest.head.families[job.family], &job, stage, registries) {
            Ok(found) => self.found(&job, &trials.of, found, true),
            Err(error) => self.failed(&job, &trials.of, &error.to_string()),
        }
    }

    /// Adds a shard of an estimate; with the last one what all of them are.
    fn shard(&mut self, shards: &mut Vec<Job>, job: Job, partial: bool, registries: &Registries<'_>) -> Result<()> {
        let Some(shard) = job.shard.clone() else { return Ok(()) };
        if !self.store.has(&job.job) {
            self.without(&job, &job.name)?;
        }
        shards.push(job);
        if shard.number + 1 < shard.all {
            return Ok(());
        }
        let (shards, of) = (std::mem::take(shards), shard.of);
        let missing = shards.iter().filter(|job| !self.store.has(&job.job)).count();
        if missing > 0 {
            let reason = format!("{missing} of its shards have no result");
            return self.failed(&shards[0], &of, &reason);
        }
        let estimate = Estimate::new(&self.manifest.head.families[shards[0].family], &shards, &self.store, registries)?;
        match estimate.of_all().and_then(|answer| match answer {
            Answer::Found(found) => estimate.as_run(*found).map(Some),
            Answer::Asks(..) => Ok(None),
        }) {
            Ok(Some(found)) => self.found(&shards[0], &of, found, true),
            Ok(None) if !partial => {
                let error = Error::data(format!("the shards of `{of}` have another round to do"));
                Err(error.help("`abbe fleet next` puts it into the manifest, and `abbe fleet run` does all rounds"))
            }
            Ok(None) => {
                self.merged.open += 1;
                self.row_of_job(&shards[0], &of, ["open", "", ""], Cell::Missing)
            }
            Err(error) => self.failed(&shards[0], &of, &error.to_string()),
        }
    }

    /// A job without a result.
    fn without(&mut self, job: &Job, name: &str) -> Result<()> {
        match job.refused.clone().or_else(|| self.store.failure(&job.job)) {
            Some(reason) => self.failed(job, name, &reason),
            None => {
                self.merged.open += 1;
                self.row_of_job(job, name, ["open", "", ""], Cell::Missing)
            }
        }
    }

    /// Adds a job without a result, and the reason.
    fn failed(&mut self, job: &Job, name: &str, reason: &str) -> Result<()> {
        self.merged.failed.push((name.to_owned(), reason.to_owned()));
        self.row_of_job(job, name, ["failed", "", reason], Cell::Missing)
    }

    /// Adds a row with the state of a job, its decision and the reason, and the number of remarks.
    fn row_of_job(&mut self, job: &Job, name: &str, told: [&str; 3], remarks: Cell<'_>) -> Result<()> {
        let family = &self.manifest.head.families[job.family].name;
        let variables = Value::Object(job.variables.clone()).to_string();
        let [state, decision, reason] = told;
        let texts = [name, family, state, decision, reason, &variables].map(Cell::Text);
        self.tables.jobs.push(&[&texts[..], &[remarks]].concat())
    }

    /// Adds what users should know of estimates, and what validators say.
    fn remarks(&mut self, name: &str, found: &Found) -> Result<()> {
        let of_estimates = found.remarks.iter().map(|remark| (&remark.estimate, &remark.text));
        let of_verdicts = found.verdicts.iter().flat_map(|own| own.remarks.iter().map(|text| (&own.stage, text)));
        self.merged.remarked += usize::from(!found.remarks.is_empty());
        of_estimates
            .chain(of_verdicts)
            .try_for_each(|(stage, text)| self.tables.remarks.push(&[name, stage, text].map(Cell::Text)))
    }

    /// Adds what a run found.
    fn found(&mut self, job: &Job, name: &str, found: Found, files: bool) -> Result<()> {
        let failures: Vec<String> = (found.failures.iter().filter(|failure| failure.needs.is_none()))
            .map(|failure| format!("stage `{}`: {}", failure.stage, failure.message))
            .collect();
        let decision = Decision::of_all(found.verdicts.iter().map(|verdict| verdict.decision)).to_string();
        let state = if failures.is_empty() { "done" } else { "incomplete" };
        let reason = failures.join("; ");
        if !reason.is_empty() {
            self.merged.failed.push((name.to_owned(), reason.clone()));
        }
        let count = Cell::Number(found.remarks.len() as f64);
        self.row_of_job(job, name, [state, &decision, &reason], count)?;
        self.remarks(name, &found)?;
        self.merged.jobs += 1;
        self.merged.calibrations += found.calibrations.len();
        let stored: Vec<Stored> = found
            .calibrations
            .into_iter()
            .map(|calibration| stored(&job.history, &found.recipe, calibration))
            .collect();
        for stored in &stored {
            self.parameters(name, stored)?;
            self.distributions(name, stored)?;
            if files {
                self.file(name, &stored.calibration)?;
            }
        }
        for verdict in &found.verdicts {
            self.verdict(name, job, stored.first(), verdict)?;
        }
        let Some(keeper) = self.keeper.as_mut().filter(|_| !stored.is_empty()) else { return Ok(()) };
        if job.history.at.is_none() && stored.iter().any(|stored| stored.calibration.group.is_none()) {
            let message = format!("the history has to know when `{name}` was: `at` is missing in its family");
            return Err(Error::data(message).help("add `at` and plan the fleet again"));
        }
        let evidence = json!({ "inputs": found.inputs, "plugins": found.plugins, "version": VERSION, "fleet": name });
        let entry = Entry { recipe: found.recipe, calibrations: stored, verdicts: found.verdicts, evidence };
        self.merged.entries += usize::from(keeper.add(&entry)?);
        Ok(())
    }

    fn parameters(&mut self, name: &str, stored: &Stored) -> Result<()> {
        let calibration = &stored.calibration;
        for known in calibration.parameters.iter().chain(&calibration.artefacts) {
            let status = serde_json::to_value(known.status).ok();
            let status = status.as_ref().and_then(Value::as_str).unwrap_or_default();
            self.tables.parameters.push(&of_job(
                name,
                stored,
                &[
                    Cell::Text(&calibration.estimate),
                    Cell::Text(&known.name),
                    Cell::Number(known.value),
                    Cell::Text(&known.unit),
                    Cell::Number(known.standard_uncertainty),
                    Cell::Text(status),
                ],
            ))?;
        }
        Ok(())
    }

    fn distributions(&mut self, name: &str, stored: &Stored) -> Result<()> {
        let Some(found) = &stored.calibration.monte_carlo else { return Ok(()) };
        for parameter in &found.parameters {
            let ends = [parameter.symmetric_interval, parameter.shortest_interval].concat();
            let numbers = [parameter.mean, parameter.standard_uncertainty];
            let counts = [found.coverage_probability, found.trials as f64, found.failed as f64];
            let texts = [&stored.calibration.estimate, &parameter.name, &parameter.unit].map(|text| Cell::Text(text));
            let numbers = numbers.iter().chain(&ends).chain(&counts).map(|number| Cell::Number(*number));
            let row: Vec<Cell<'_>> = texts.into_iter().chain(numbers).collect();
            self.tables.distributions.push(&of_job(name, stored, &row))?;
        }
        Ok(())
    }

    fn verdict(&mut self, name: &str, job: &Job, first: Option<&Stored>, verdict: &Verdict) -> Result<()> {
        let Kept { machine, label, at, unit } = &job.history;
        let (machine, label) = match first {
            Some(stored) => (stored.machine.as_str(), label.as_deref().unwrap_or_default()),
            None => (machine.as_deref().unwrap_or_default(), label.as_deref().unwrap_or_default()),
        };
        let decision = verdict.decision.to_string();
        for figure in &verdict.figures {
            let of_figure = figure.decision.map(|decision| decision.to_string()).unwrap_or_default();
            self.tables.verdicts.push(&[
                Cell::Text(name),
                Cell::Text(machine),
                Cell::Text(label),
                at.map_or(Cell::Missing, Cell::Number),
                Cell::Text(unit),
                Cell::Text(&verdict.stage),
                Cell::Text(&verdict.plugin),
                Cell::Text(&decision),
                Cell::Text(figure.of.as_deref().unwrap_or_default()),
                Cell::Text(&figure.name),
                figure.value.map_or(Cell::Missing, Cell::Number),
                Cell::Text(&figure.unit),
                figure.limit.map_or(Cell::Missing, Cell::Number),
                Cell::Text(&of_figure),
            ])?;
        }
        Ok(())
    }

    fn file(&mut self, name: &str, calibration: &Calibration) -> Result<()> {
        let path = self.out.join("calibrations").join(self.names.of(name, &calibration.estimate));
        let text = calibration.to_json().map_err(|error| unwritable(&path, &std::io::Error::other(error.message)))?;
        self.own.keep_ready(text.as_bytes(), &path)
    }
}

/// A row of a calibration: what the job is, then the rest.
fn of_job<'a>(name: &'a str, stored: &'a Stored, rest: &[Cell<'a>]) -> Vec<Cell<'a>> {
    let at = if stored.unit.is_empty() { Cell::Missing } else { Cell::Number(stored.at) };
    let head = [Cell::Text(name), Cell::Text(&stored.machine), Cell::Text(&stored.label), at, Cell::Text(&stored.unit)];
    head.iter().chain(rest).copied().collect()
}

/// A calibration as the history has it. Groups of rows have their own times.
fn stored(kept: &Kept, recipe: &str, calibration: Calibration) -> Stored {
    let own = calibration.model.settings.get("name").and_then(Value::as_str).filter(|name| !name.trim().is_empty());
    let machine = kept.machine.as_deref().or(own).unwrap_or(recipe).to_owned();
    match (&calibration.group, kept.at) {
        (Some(group), _) => {
            Stored { machine, label: group.label.clone(), at: group.at, unit: group.unit.clone(), calibration }
        }
        (None, Some(at)) => {
            let label = kept.label.clone().unwrap_or_default();
            Stored { machine, label, at, unit: kept.unit.clone(), calibration }
        }
        // No time is known; only tables are written of it.
        (None, None) => {
            let label = kept.label.clone().unwrap_or_default();
            Stored { machine, label, at: 0.0, unit: String::new(), calibration }
        }
    }
}
