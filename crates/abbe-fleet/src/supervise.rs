//! Jobs in processes of their own: what one of them does to its process costs no other job.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Write};
use std::ops::Range;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use abbe_core::{Error, Result};

use crate::manifest::Manifest;
use crate::store::Store;
use crate::worker::Answer;

/// How jobs are done.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Processes at a time.
    pub workers: usize,
    /// How often a job that failed is tried again.
    pub retries: usize,
    /// How long a job may take.
    pub time_limit: Option<Duration>,
}

/// What became of jobs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Finished {
    /// Jobs that were done.
    pub new: usize,
    /// Jobs that were done before.
    pub known: usize,
    /// Names of jobs that failed, in the order of the manifest, with the reason.
    pub failed: Vec<(String, String)>,
}

/// A job that waits.
struct Task {
    index: usize,
    name: String,
    job: String,
    line: String,
    tries: usize,
}

/// Jobs that a process has before it has answered the first: it never waits for the next one.
const AHEAD: usize = 4;

/// Does some jobs of a manifest in processes that `command` starts, each of which answers as [`crate::serve`] does. A job that fails,
/// that ends its process, or that takes too long is tried again; after its retries its reason is kept. `told` gets the number of
/// jobs that are through.
///
/// # Errors
/// If the manifest cannot be read, no process can be started, or the disk does not take results.
pub fn supervise(
    manifest: &Manifest,
    range: Range<usize>,
    command: &(dyn Fn() -> Command + Sync),
    limits: &Limits,
    told: &(dyn Fn(usize) + Sync),
) -> Result<Finished> {
    let store = manifest.store();
    store.can_be_written()?;
    store.clear();
    let (mut tasks, mut finished) = (VecDeque::new(), Finished::default());
    let mut refused = Vec::new();
    manifest.each_line(range, |index, line| {
        let job = manifest.job(index, &line)?;
        match job.refused {
            Some(reason) => {
                store.fail(&job.job, &reason)?;
                refused.push((index, job.name, reason));
            }
            None => tasks.push_back(Task { index, name: job.name, job: job.job, line, tries: 0 }),
        }
        Ok(())
    })?;
    let workers = limits.workers.min(tasks.len());
    let shared = Shared { tasks: Mutex::new(tasks), found: Mutex::new(Found::default()), store, limits, told };
    let results: Vec<Result<()>> = std::thread::scope(|scope| {
        let started: Vec<_> = (0..workers).map(|_| scope.spawn(|| shared.work(command))).collect();
        started
            .into_iter()
            .map(|thread| thread.join().unwrap_or_else(|_| Err(Error::data("a thread panicked"))))
            .collect()
    });
    let found = shared.found.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.into_iter().collect::<Result<()>>()?;
    refused.extend(found.failed);
    refused.sort();
    (finished.new, finished.known) = (found.new, found.known);
    finished.failed = refused.into_iter().map(|(_, name, reason)| (name, reason)).collect();
    Ok(finished)
}

#[derive(Default)]
struct Found {
    new: usize,
    known: usize,
    failed: Vec<(usize, String, String)>,
}

/// What the threads share that each watch a process.
struct Shared<'a> {
    tasks: Mutex<VecDeque<Task>>,
    found: Mutex<Found>,
    store: Store,
    limits: &'a Limits,
    told: &'a (dyn Fn(usize) + Sync),
}

impl Shared<'_> {
    fn work(&self, command: &(dyn Fn() -> Command + Sync)) -> Result<()> {
        let mut given: VecDeque<Task> = VecDeque::new();
        let mut process: Option<Process> = None;
        let mut began = Instant::now();
        loop {
            while given.len() < AHEAD {
                let Some(task) = self.tasks().pop_front() else { break };
                let process = match &mut process {
                    Some(process) => process,
                    None => process.insert(Process::start(command())?),
                };
                process.give(&task.line);
                if given.is_empty() {
                    began = Instant::now();
                }
                given.push_back(task);
            }
            let (Some(task), Some(running)) = (given.front(), &mut process) else { return Ok(()) };
            match running.answer(self.limits.time_limit.map(|limit| limit.saturating_sub(began.elapsed()))) {
                Ok(answer) if answer.job == task.job => {
                    began = Instant::now();
                    if let Some(task) = given.pop_front() {
                        self.answered(task, answer)?;
                    }
                }
                ended => {
                    let reason = match ended {
                        Err(RecvTimeoutError::Timeout) => {
                            let limit = self.limits.time_limit.unwrap_or_default().as_secs_f64();
                            format!("it takes longer than {limit} s, the time limit of a job")
                        }
                        Ok(_) => "its process answers something else than was asked".to_owned(),
                        Err(RecvTimeoutError::Disconnected) => running.end(),
                    };
                    // The process that is dropped is killed. What it was given beside the first is no fault of these.
                    process = None;
                    let first = given.pop_front();
                    given.drain(..).rev().for_each(|task| self.tasks().push_front(task));
                    if let Some(task) = first {
                        self.failed(task, reason)?;
                    }
                }
            }
        }
    }

    fn tasks(&self) -> std::sync::MutexGuard<'_, VecDeque<Task>> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn answered(&self, task: Task, answer: Answer) -> Result<()> {
        let Some(known) = answer.known else {
            return self.failed(task, answer.reason.unwrap_or_default());
        };
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        *(if known { &mut found.known } else { &mut found.new }) += 1;
        (self.told)(found.known + found.new + found.failed.len());
        Ok(())
    }

    fn failed(&self, mut task: Task, reason: String) -> Result<()> {
        task.tries += 1;
        if task.tries <= self.limits.retries {
            // At once, and not at the end: others may share the queue.
            self.tasks().push_front(task);
            return Ok(());
        }
        self.store.fail(&task.job, &reason)?;
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        found.failed.push((task.index, task.name, reason));
        (self.told)(found.known + found.new + found.failed.len());
        Ok(())
    }
}

/// A process that does jobs.
struct Process {
    child: Child,
    /// Lines on their way: a process that does not read must not stop the one that watches it.
    lines: Sender<String>,
    answers: Receiver<Answer>,
}

impl Process {
    fn start(mut command: Command) -> Result<Self> {
        let cannot = |why: &dyn std::fmt::Display| Error::data(format!("a worker cannot be started: {why}"));
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|error| cannot(&error))?;
        let (Some(mut input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(cannot(&"it has no pipes"));
        };
        let (lines, waiting) = channel::<String>();
        let (answered, answers) = channel();
        let write = move || while waiting.recv().is_ok_and(|line| input.write_all(line.as_bytes()).is_ok()) {};
        // What a plugin prints is no answer.
        let read = move || {
            for line in BufReader::new(output).lines().map_while(std::io::Result::ok) {
                if let Ok(answer) = serde_json::from_str(&line)
                    && answered.send(answer).is_err()
                {
                    return;
                }
            }
        };
        let process = Self { child, lines, answers };
        for work in [Box::new(write) as Box<dyn FnOnce() + Send>, Box::new(read)] {
            std::thread::Builder::new().name("worker".to_owned()).spawn(work).map_err(|error| cannot(&error))?;
        }
        Ok(process)
    }

    /// Hands over a job. That the process is gone is seen when it does not answer.
    fn give(&self, line: &str) {
        let _ = self.lines.send(line.to_owned());
    }

    fn answer(&self, within: Option<Duration>) -> std::result::Result<Answer, RecvTimeoutError> {
        match within {
            Some(within) => self.answers.recv_timeout(within),
            None => self.answers.recv().map_err(|_| RecvTimeoutError::Disconnected),
        }
    }

    /// How a process ended that answers no more.
    fn end(&mut self) -> String {
        // It may have closed its output and live on.
        for _ in 0..50 {
            match self.child.try_wait() {
                Ok(Some(status)) => return ended(status),
                Ok(None) => std::thread::sleep(Duration::from_millis(10)),
                Err(_) => break,
            }
        }
        "its process answers no more".to_owned()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn ended(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        return format!("its process was ended by signal {signal}");
    }
    match status.code() {
        Some(code) => format!("its process ended with exit status {code}"),
        None => "its process ended".to_owned(),
    }
}
