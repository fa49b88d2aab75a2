//! `abbe fleet`: many calibrations as independent jobs.

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use abbe_core::{Error, Monitor, Result};
use abbe_fleet::{
    Finished, Fleet, Limits, Manifest, Registries, Rounds, Status, Worker, merge, next_round, plan, serve, status,
    supervise,
};
use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use serde_json::json;

use crate::failure::readable;
use crate::interrupt::{self, seconds};
use crate::libraries::{Libraries, this_program};
use crate::outputs::is_file_name;
use crate::pretty;

/// What is done with a fleet.
#[derive(Subcommand)]
pub enum Asked {
    /// Write the manifest of a fleet: its jobs, each known by the hash of all that its result depends on.
    Plan {
        /// What is wanted: `FLEET.yaml`.
        fleet: PathBuf,
        /// The manifest to write. Default: `FLEET.manifest.jsonl` beside it. Results go into `FLEET.results` beside the manifest.
        #[arg(long, value_name = "MANIFEST")]
        out: Option<PathBuf>,
    },
    /// Do all jobs of a manifest on this computer. Those that are done are not done again.
    Run {
        /// The manifest.
        manifest: PathBuf,
        /// Processes at a time. Default: as many as there are cores.
        #[arg(long, value_parser = clap::value_parser!(u16).range(1..=4096))]
        workers: Option<u16>,
        #[command(flatten)]
        tries: Tries,
    },
    /// Do one job of a manifest, or some that follow each other, for engines that deal them out.
    Job {
        /// The manifest.
        manifest: PathBuf,
        /// Number of the job, from 0.
        #[arg(long)]
        index: usize,
        /// How many jobs; what is beyond the last one is left out.
        #[arg(long, default_value_t = 1)]
        count: usize,
        #[command(flatten)]
        tries: Tries,
    },
    /// Tell what is done, what failed and why, and what is open.
    Status {
        /// The manifest.
        manifest: PathBuf,
        /// Print it as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Put the results of all jobs together: tables, the history that the fleet names, distributions of trials.
    Merge {
        /// The manifest.
        manifest: PathBuf,
        /// Folder for tables. Default: `FLEET.merged` beside the manifest.
        #[arg(long)]
        out: Option<PathBuf>,
        /// Write the calibrations of all jobs as files, too.
        #[arg(long)]
        calibrations: bool,
        /// Merge what is there, although jobs are open.
        #[arg(long)]
        partial: bool,
    },
    /// Put the next round of estimates in shards into the manifest, for engines that deal jobs out; `run` does so by itself.
    Next {
        /// The manifest.
        manifest: PathBuf,
    },
    /// Do the jobs whose lines come in.
    #[command(hide = true)]
    Work { manifest: PathBuf },
}

/// How often, and how long.
#[derive(Args)]
pub struct Tries {
    /// How often a job that failed is tried again, 100 times at most.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(0..=100))]
    retries: u16,
    /// Time limit of a job, seconds. A job that takes longer is ended.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    time_limit: Option<Duration>,
}

impl Asked {
    /// Whether the output is for programs.
    pub fn is_json(&self) -> bool {
        matches!(self, Self::Status { json: true, .. })
    }

    /// Whether this is a process that does jobs for another one, which tells what is to be told.
    pub fn is_worker(&self) -> bool {
        matches!(self, Self::Work { .. })
    }

    /// Does it; gives what to print and the exit status.
    pub fn run(self, libraries: &Libraries, verbose: bool) -> Result<(String, u8)> {
        if let Some(file) = libraries.files.first() {
            let message = format!("--plugin {}: a job knows the libraries of its recipe alone", file.display());
            return Err(Error::usage(message).help("name the library in the recipe, under `plugins`, with its SHA-256"));
        }
        let registries = |recipe: &Path| libraries.registry(Some(recipe));
        match self {
            Self::Plan { fleet, out } => {
                let out = out.unwrap_or_else(|| Manifest::beside(&fleet));
                is_file_name(&out)?;
                let out = std::path::absolute(&out).map_err(|error| cannot_enter(&out, &error))?;
                let wanted = Fleet::read(&fleet)?;
                let (manifest, jobs) =
                    whole(|monitor| inside(&wanted.folder, || plan(&wanted, &out, &registries, monitor)))?;
                let refused = jobs.iter().filter_map(|job| Some((job.name.clone(), job.refused.clone()?)));
                Ok(planned(&manifest, &refused.collect::<Vec<_>>()))
            }
            Self::Run { manifest, workers, tries } => {
                let manifest = Manifest::read(&manifest)?;
                let cores = || std::thread::available_parallelism().map_or(1, usize::from);
                let workers = workers.map_or_else(cores, usize::from);
                let limits = tries.limits(workers);
                all_rounds(manifest, &registries, |manifest| {
                    done(manifest, 0..manifest.head.jobs, &limits, libraries, verbose)
                })
            }
            Self::Job { manifest, index, count, tries } => {
                let manifest = Manifest::read(&manifest)?;
                if index >= manifest.head.jobs || count == 0 {
                    let message = format!("--index {index} --count {count}: there are {} jobs", manifest.head.jobs);
                    return Err(Error::usage(message).help("the first job has the number 0"));
                }
                let some = index..index.saturating_add(count).min(manifest.head.jobs);
                done(&manifest, some, &tries.limits(1), libraries, verbose)
            }
            Self::Status { manifest, json } => {
                let manifest = Manifest::read(&manifest)?;
                state(&status(&manifest)?, json)
            }
            Self::Merge { manifest, out, calibrations, partial } => {
                let manifest = Manifest::read(&manifest)?;
                let out = out.unwrap_or_else(|| manifest.beside_it("merged"));
                let out = std::path::absolute(&out).map_err(|error| cannot_enter(&out, &error))?;
                let merged = whole(|monitor| {
                    inside(&manifest.base(), || merge(&manifest, &out, calibrations, partial, &registries, monitor))
                })?;
                let mut text = format!("{} jobs, {} calibrations", merged.jobs, merged.calibrations);
                if manifest.head.history.is_some() {
                    let _ = write!(text, ", {} new entries of the history", merged.entries);
                }
                let _ = writeln!(text, " in {}", out.display());
                if merged.open > 0 {
                    let _ = writeln!(text, "{} jobs are open", merged.open);
                }
                if merged.remarked > 0 {
                    let _ = writeln!(text, "{} jobs have remarks on their estimates: see remarks.csv", merged.remarked);
                }
                if let Some(first) = merged.earlier.first() {
                    let count = merged.earlier.len();
                    let _ = writeln!(
                        text,
                        "{count} files of earlier merges stay, and may be of jobs that are gone: the first is {first}"
                    );
                }
                Ok(with_failures(text, &merged.failed))
            }
            Self::Next { manifest } => {
                let mut manifest = Manifest::read(&manifest)?;
                let rounds = whole(|_| inside(&manifest.base(), || next_round(&mut manifest, &registries)))?;
                let Rounds { asked, open, done, failed } = &rounds;
                let (word, asked) = (if asked.is_empty() { "no" } else { "a" }, asked.len());
                let text = format!(
                    "{word} new round: {asked} estimates in shards have one, {} are open, {} are done\n",
                    open.len(),
                    done.len()
                );
                Ok(with_failures(text, failed))
            }
            Self::Work { manifest } => {
                let manifest = Manifest::read(&manifest)?;
                inside(&manifest.base(), || {
                    serve(&mut Worker::new(&manifest, &registries), io::stdin().lock(), io::stdout())
                })?;
                Ok((String::new(), 0))
            }
        }
    }
}

impl Tries {
    fn limits(&self, workers: usize) -> Limits {
        Limits { workers, retries: usize::from(self.retries), time_limit: self.time_limit }
    }
}

/// Does what writes several files, or one of many jobs. A signal ends it where it asks the monitor, or when it is done: nothing temporary
/// stays.
fn whole<T>(work: impl FnOnce(&Monitor) -> Result<T>) -> Result<T> {
    let monitor = Monitor::new(|_| {});
    interrupt::cancel_on_signal(monitor.clone())?;
    interrupt::while_writing(|| work(&monitor))
}

/// Does something in another folder. Results name files as they are seen from there, so that they are the same wherever it is.
fn inside<T>(folder: &Path, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let here = std::env::current_dir().map_err(|error| cannot_enter(Path::new("."), &error))?;
    if !folder.as_os_str().is_empty() {
        std::env::set_current_dir(folder).map_err(|error| cannot_enter(folder, &error))?;
    }
    let found = work();
    std::env::set_current_dir(&here).map_err(|error| cannot_enter(&here, &error))?;
    found
}

fn cannot_enter(folder: &Path, error: &io::Error) -> Error {
    Error::usage(format!("{} cannot be used: {}", folder.display(), abbe_files::why(error)))
}

/// Does jobs, and the rounds of estimates in shards that follow from them, until there are no more.
fn all_rounds(
    mut manifest: Manifest,
    registries: &Registries<'_>,
    done: impl Fn(&Manifest) -> Result<(String, u8)>,
) -> Result<(String, u8)> {
    let (mut told, base) = (String::new(), manifest.base());
    loop {
        let (text, mut code) = done(&manifest)?;
        told.push_str(&text);
        let rounds = inside(&base, || next_round(&mut manifest, registries))?;
        if rounds.asked.is_empty() {
            let (text, failed) = with_failures(String::new(), &rounds.failed);
            code = code.max(failed);
            return Ok((told + &text, code));
        }
    }
}

fn planned(manifest: &Manifest, refused: &[(String, String)]) -> (String, u8) {
    with_failures(format!("{} jobs in {}\n", manifest.head.jobs, manifest.path.display()), refused)
}

/// Does jobs in processes of their own.
fn done(
    manifest: &Manifest,
    range: std::ops::Range<usize>,
    limits: &Limits,
    libraries: &Libraries,
    verbose: bool,
) -> Result<(String, u8)> {
    interrupt::cancel_on_signal(Monitor::default())?;
    let program = this_program()?;
    let command = || {
        let mut command = Command::new(&program);
        command.args(["fleet", "work"]).arg(&manifest.path);
        for (flag, is_set) in [
            ("--isolate-plugins", libraries.isolate),
            ("--trust-plugins", libraries.trust),
            ("--no-dynamic-plugins", libraries.refuse),
        ] {
            command.args(is_set.then_some(flag));
        }
        command.stderr(if verbose { Stdio::inherit() } else { Stdio::null() });
        command
    };
    let bar = ProgressBar::new(range.len() as u64);
    let finished = supervise(manifest, range, &command, limits, &|through| bar.set_position(through as u64))?;
    bar.finish_and_clear();
    let Finished { new, known, failed } = &finished;
    let known = if *known > 0 { format!(", {known} were done before") } else { String::new() };
    Ok(with_failures(format!("{new} jobs done{known}\n"), failed))
}

fn state(status: &Status, json: bool) -> Result<(String, u8)> {
    let code = u8::from(!status.failed.is_empty());
    if json {
        let failed = status.failed.iter().map(|(name, reason)| json!({ "job": name, "reason": reason }));
        let failed: Vec<_> = failed.collect();
        return Ok((pretty(&json!({ "done": status.done, "failed": failed, "open": status.open }))?, code));
    }
    let text = format!("{} done, {} failed, {} open\n", status.done, status.failed.len(), status.open.len());
    Ok(with_failures(text, &status.failed))
}

/// A text, and the jobs that failed.
fn with_failures(mut text: String, failed: &[(String, String)]) -> (String, u8) {
    for (name, reason) in failed {
        let _ = writeln!(text, "failed: {}: {}", readable(name), readable(reason));
    }
    (text, u8::from(!failed.is_empty()))
}
