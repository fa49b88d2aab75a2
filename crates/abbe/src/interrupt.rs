//! Ctrl-C, an order to end, a closed terminal: the work is asked to end; if it does not, the process ends within a second, or when the
//! file that is being written is complete. No file is left half-written. A second signal ends the process at once.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use abbe_core::{Error, Monitor, Result};
use abbe_engine::temporary_folder;

use crate::failure;

/// How long the work has to end by itself after a signal.
const AFTER_SIGNAL: Duration = Duration::from_millis(600);

/// How long the work has to end by itself, and to write what is finished, when its time is over.
pub const GRACE: Duration = Duration::from_secs(5);

/// Temporary folders and files that are there now.
static FOLDERS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// The signal that came; 0 as long as none has.
static SIGNAL: AtomicI32 = AtomicI32::new(0);
static WRITING: Mutex<()> = Mutex::new(());

/// Whether the command is carried out, with success or not: what is left is to say so.
static DONE: AtomicBool = AtomicBool::new(false);

/// A folder for what is needed while a command runs. It goes when it is dropped, when a signal or a time limit ends the process, and where
/// that was killed when the next such folder is made.
pub struct TemporaryFolder {
    folder: tempfile::TempDir,
    _lock: Option<std::fs::File>,
}

impl TemporaryFolder {
    /// Makes one.
    pub fn new() -> io::Result<Self> {
        let mut folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
        let (folder, _lock) = temporary_folder(&std::env::temp_dir())?;
        folders.push(folder.path().to_owned());
        Ok(Self { folder, _lock })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        remove(self.folder.path());
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).retain(|folder| folder != self.folder.path());
    }
}

/// What is said where nothing can be written into a temporary folder.
pub fn no_temporary_file(error: io::Error) -> Error {
    let folder = std::env::temp_dir();
    let folder = if folder.as_os_str().is_empty() { Path::new("an unnamed folder") } else { folder.as_path() };
    let message = format!("a temporary file cannot be written to {}: {}", folder.display(), abbe_files::why(&error));
    Error::data(message).help("make room there, or name another folder in TMPDIR")
}

/// A temporary file that somebody else makes and removes. As long as this is there, a signal or a time limit that ends the process removes
/// the file, too.
pub struct TemporaryFile(PathBuf);

impl TemporaryFile {
    /// Notes one.
    pub fn at(path: &Path) -> Self {
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).push(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        FOLDERS.lock().unwrap_or_else(PoisonError::into_inner).retain(|file| *file != self.0);
    }
}

/// How often, and how long after each other, a folder is removed into which something that is about to end may still write.
const TRIES: usize = 10;
const PAUSE: Duration = Duration::from_millis(20);

fn remove(folder: &Path) {
    for _ in 0..TRIES {
        let removed = if folder.is_dir() { std::fs::remove_dir_all(folder) } else { std::fs::remove_file(folder) };
        if removed.is_ok() || !folder.exists() {
            return;
        }
        std::thread::sleep(PAUSE);
    }
}

/// Removes temporary folders and files when the process ends before what made them. No other is made any more.
fn clear_away() {
    let folders = FOLDERS.lock().unwrap_or_else(PoisonError::into_inner);
    folders.iter().for_each(|folder| remove(folder));
    std::mem::forget(folders);
}

/// With a limit on the size of files, writing beyond it fails with an error that can be told. Without this the process would be ended,
/// and its temporary file would stay.
pub fn tell_limits_of_files() {
    // Where signals cannot be handled the limit ends the process, as it would without Abbe.
    #[cfg(unix)]
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, std::sync::Arc::default());
}

/// Ends the work that `monitor` watches when a signal asks for it.
pub fn cancel_on_signal(monitor: Monitor) -> Result<()> {
    watched(move |signal| {
        SIGNAL.store(signal, Ordering::SeqCst);
        monitor.cancel();
        std::thread::sleep(AFTER_SIGNAL);
        // Waits until a file that is being written is complete.
        let _written = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        // A closed output must not keep the process alive.
        let _ = writeln!(io::stderr(), "interrupted");
        clear_away();
        abbe_plugin::expect_exit();
        std::process::exit(i32::from(status()));
    })
    .map_err(|error| Error::data(format!("signals cannot be handled: {}", abbe_files::why(&error))))
}

/// Ends the process when this time and `grace` are over, if the work has not ended by itself and written its files. `what` says what is
/// not there then; the error is JSON on request.
pub fn end_after(limit: Option<Duration>, grace: Duration, json: bool, what: &'static str) -> Result<()> {
    let Some(limit) = limit else { return Ok(()) };
    let wait = move || {
        std::thread::sleep(limit.saturating_add(grace));
        let _written = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        if DONE.load(Ordering::SeqCst) {
            return;
        }
        let message = format!("the time limit of {} s is over, and {what}", limit.as_secs_f64());
        let error = Error::out_of_time(message);
        // A closed output must not keep the process alive.
        let _ = match json {
            true => writeln!(io::stdout(), "{}", failure::json(&error)),
            false => io::stderr().write_all(failure::text(&error).as_bytes()),
        };
        clear_away();
        abbe_plugin::expect_exit();
        std::process::exit(1);
    };
    let thread = std::thread::Builder::new().name("time limit".to_owned()).spawn(wait);
    thread.map(drop).map_err(|error| Error::data(format!("a time limit cannot be watched: {error}")))
}

/// Calls `end` with the number of the first signal that asks the process to end; the second one ends it. One that the process was told
/// to ignore (`nohup`) stays ignored.
#[cfg(unix)]
fn watched(end: impl FnOnce(i32) + Send + 'static) -> io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let ignored = ignored();
    let wanted = [SIGINT, SIGTERM, SIGHUP].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
    let mut signals = signal_hook::iterator::Signals::new(wanted)?;
    thread("signals", move || {
        let mut signals = signals.forever();
        if let Some(signal) = signals.next() {
            // Without a thread there is nothing that could end the work.
            if thread("end of work", move || end(signal)).is_err() {
                signal_hook::low_level::exit(128 + signal);
            }
        }
        if let Some(signal) = signals.next() {
            signal_hook::low_level::exit(128 + signal);
        }
    })
}

#[cfg(unix)]
fn thread(name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
    std::thread::Builder::new().name(name.to_owned()).spawn(work).map(drop)
}

/// The signals that the process was told to ignore, bit by bit; none where the system does not say.
#[cfg(unix)]
fn ignored() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    line.and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok()).unwrap_or(0)
}

#[cfg(not(unix))]
fn watched(end: impl FnOnce(i32) + Send + 'static) -> io::Result<()> {
    let mut end = Some(end);
    ctrlc::set_handler(move || match end.take() {
        Some(end) => drop(std::thread::spawn(move || end(2))),
        None => std::process::exit(130),
    })
    .map_err(io::Error::other)
}

/// Exit status of a process that was interrupted: 128 and the number of the signal.
pub fn status() -> u8 {
    u8::try_from(128 + SIGNAL.load(Ordering::SeqCst)).unwrap_or(u8::MAX)
}

/// Whether a signal has asked the process to end.
pub fn happened() -> bool {
    SIGNAL.load(Ordering::SeqCst) != 0
}

/// Writes a file that no interruption may cut short.
pub fn while_writing<T>(write: impl FnOnce() -> Result<T>) -> Result<T> {
    let _writing = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    if happened() {
        return Err(Error::interrupted());
    }
    let written = write();
    // The work is at its end, whether it can be written or not.
    DONE.store(true, Ordering::SeqCst);
    written
}

/// The command is carried out: no time limit ends the process any more.
pub fn done() {
    let _writing = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    DONE.store(true, Ordering::SeqCst);
}

/// Most seconds of a limit: a year.
const LONGEST: f64 = 366.0 * 86_400.0;

/// Shortest time limit, s.
const SHORTEST: f64 = 1e-6;

/// A time in seconds.
pub fn seconds(text: &str) -> std::result::Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| "a number of seconds was expected".to_owned())?;
    match (SHORTEST..=LONGEST).contains(&seconds) {
        true => Ok(Duration::from_secs_f64(seconds)),
        false => Err(format!("a number of seconds from {SHORTEST} to {LONGEST} was expected")),
    }
}
