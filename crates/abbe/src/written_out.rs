//! LinuxCNC programs, written out by the control's own interpreter while they are read.

use std::cell::RefCell;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use abbe_controllers::{Canonical, Options, prepare};
use abbe_core::{Error, Result};
use abbe_files::{LARGEST_RESULT, read_text};

use crate::children;
use crate::interrupt::{self, TemporaryFolder};

/// LinuxCNC's interpreter without a machine.
const INTERPRETER: &str = "rs274";

/// Time, s, without a command after which a program is taken to run in circles.
const SILENCE: u64 = 60;

/// How often the interpreter is looked at.
const LOOK: Duration = Duration::from_millis(100);

/// Most commands of a program.
const MOST_COMMANDS: u64 = 50_000_000;

/// What became of the lines of a program.
#[derive(Default)]
pub struct Origins {
    canonical: Option<Canonical>,
    failed: Option<Error>,
}

impl Origins {
    /// The line of the program from which a written-out line comes.
    pub fn line_of(&self, written: usize) -> Option<usize> {
        self.canonical.as_ref()?.line_of(written)
    }

    /// Why the program could not be written out.
    pub fn failed(&mut self) -> Option<Error> {
        self.failed.take()
    }
}

/// A program as its interpreter writes it out, block by block.
pub struct WrittenOut {
    output: BufReader<ChildStdout>,
    child: Arc<Mutex<Child>>,
    commands: Arc<AtomicU64>,
    /// Whether it was ended because it came to no command.
    is_silent: Arc<AtomicBool>,
    folder: TemporaryFolder,
    options: Options,
    origins: Rc<RefCell<Origins>>,
    text: Vec<u8>,
    read: usize,
    is_at_end: bool,
    /// Whether the program says its unit, and whether it uses inches.
    pub has_unit: bool,
    /// Whether it uses inches: then positions have 2.54 µm.
    pub has_inches: bool,
}

impl WrittenOut {
    /// Starts the interpreter on a program.
    pub fn start(file: &Path, options: &Options) -> Result<Self> {
        let unreadable =
            |error| Error::usage(format!("the program cannot be read: {}", abbe_files::why(&error))).in_file(file);
        let prepared = prepare(&read_text(file, LARGEST_RESULT).map_err(unreadable)?, options)?;
        let failed = interrupt::no_temporary_file;
        let folder = TemporaryFolder::new().map_err(failed)?;
        for (name, text) in
            [("part.ngc", &prepared.program), ("tool.tbl", &prepared.tools), ("part.var", &prepared.parameters)]
        {
            std::fs::write(folder.path().join(name), text).map_err(failed)?;
        }
        let told = File::create(folder.path().join("told")).map_err(failed)?;
        let mut command = Command::new(INTERPRETER);
        children::apart(&mut command);
        let child = command
            .args(["-g", "-t", "tool.tbl", "-v", "part.var", "part.ngc"])
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(told)
            .spawn();
        let mut child = child.map_err(|error| {
            let message = format!("LinuxCNC's interpreter, `{INTERPRETER}`, does not start: {error}");
            Error::usage(message).help("install it (Debian: apt-get install linuxcnc-uspace), or write the program out")
        })?;
        let Some(output) = child.stdout.take() else {
            return Err(Error::usage(format!("`{INTERPRETER}` has no output")));
        };
        let (child, commands) = (Arc::new(Mutex::new(child)), Arc::new(AtomicU64::new(0)));
        let is_silent = Arc::new(AtomicBool::new(false));
        watch(Arc::downgrade(&child), Arc::clone(&commands), Arc::clone(&is_silent));
        Ok(Self {
            output: BufReader::new(output),
            child,
            commands,
            is_silent,
            folder,
            options: options.clone(),
            origins: Rc::new(RefCell::new(Origins { canonical: Some(Canonical::new(options)), failed: None })),
            text: Vec::new(),
            read: 0,
            is_at_end: false,
            has_unit: prepared.has_unit,
            has_inches: prepared.has_inches,
        })
    }

    /// Where the lines come from.
    pub fn origins(&self) -> Rc<RefCell<Origins>> {
        Rc::clone(&self.origins)
    }

    /// Makes blocks of the next commands.
    fn fill(&mut self) -> std::result::Result<(), Error> {
        (self.read, self.text) = (0, Vec::new());
        let mut line = Vec::new();
        while self.text.is_empty() && !self.is_at_end {
            if interrupt::happened() {
                return Err(Error::interrupted());
            }
            line.clear();
            let read = self.output.read_until(b'\n', &mut line);
            let count = read.map_err(|error| self.error(format!("`{INTERPRETER}` cannot be read: {error}"), None))?;
            if count == 0 {
                self.is_at_end = true;
                return self.end();
            }
            if self.commands.fetch_add(1, Ordering::Relaxed) > MOST_COMMANDS {
                return Err(self.error(format!("written out, it has more than {MOST_COMMANDS} commands"), None));
            }
            let text = String::from_utf8_lossy(&line).into_owned();
            let mut origins = self.origins.borrow_mut();
            let done = origins.canonical.as_mut().map(|canonical| canonical.line(&text, &mut self.text));
            drop(origins);
            if let Some(Err(what)) = done {
                let number = number_in(&text);
                return Err(self.error(format!("written out, it comes to what cannot be corrected: {what}"), number));
            }
        }
        Ok(())
    }

    /// Whether the interpreter came to the end of the program.
    fn end(&self) -> std::result::Result<(), Error> {
        let status = self.child.lock().ok().and_then(|mut child| child.wait().ok());
        if interrupt::happened() {
            return Err(Error::interrupted());
        }
        let has_ended = self.origins.borrow().canonical.as_ref().is_some_and(Canonical::has_ended);
        if has_ended && status.is_some_and(|status| status.success()) {
            return Ok(());
        }
        let told = std::fs::read(self.folder.path().join("told")).unwrap_or_default();
        let told = String::from_utf8_lossy(&told[..told.len().min(4096)]).into_owned();
        let lines: Vec<&str> = told.lines().filter(|line| !line.trim().is_empty() && *line != "executing").collect();
        let number = lines.iter().rev().find_map(|line| number_of(line));
        let said = lines.iter().find(|line| number_of(line).is_none());
        let message = match said {
            Some(said) => format!("LinuxCNC's interpreter says: {said}"),
            None if self.is_silent.load(Ordering::Relaxed) => {
                format!("LinuxCNC's interpreter was stopped: for {SILENCE} s it came to no command")
            }
            None if status.is_some_and(|status| status.code().is_none()) => {
                let status = status.map(|status| status.to_string()).unwrap_or_default();
                format!("LinuxCNC's interpreter was ended before the end of the program ({status})")
            }
            None => "the program has no end: LinuxCNC's interpreter came to no M2, M30 or %".to_owned(),
        };
        Err(self.error(message, number))
    }

    fn error(&self, message: String, line: Option<usize>) -> Error {
        let error = Error::data(message);
        match line {
            Some(line) => error.at(&self.options.file, line, None),
            None => error.in_file(&self.options.file),
        }
    }
}

impl Read for WrittenOut {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.read == self.text.len()
            && let Err(error) = self.fill()
        {
            let told = std::io::Error::other(error.message.clone());
            self.origins.borrow_mut().failed = Some(error);
            return Err(told);
        }
        let count = buffer.len().min(self.text.len() - self.read);
        buffer[..count].copy_from_slice(&self.text[self.read..self.read + count]);
        self.read += count;
        Ok(count)
    }
}

impl Drop for WrittenOut {
    fn drop(&mut self) {
        if let Ok(mut child) = self.child.lock() {
            children::end(&mut child);
        }
    }
}

/// Ends an interpreter that comes to no command for a long time, or when a signal asks Abbe to end: who waits for its output then goes
/// on, and clears away its folder.
fn watch(child: std::sync::Weak<Mutex<Child>>, commands: Arc<AtomicU64>, is_silent: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        let (mut last, mut since) = (0, Instant::now());
        loop {
            std::thread::sleep(LOOK);
            let Some(child) = child.upgrade() else { return };
            let now = commands.load(Ordering::Relaxed);
            if now != last {
                (last, since) = (now, Instant::now());
            }
            let is_late = since.elapsed().as_secs() >= SILENCE;
            if is_late || interrupt::happened() {
                is_silent.store(is_late, Ordering::Relaxed);
                if let Ok(mut child) = child.lock() {
                    children::end(&mut child);
                }
                return;
            }
        }
    });
}

/// The number of the line in a command: `   12 N5     STRAIGHT_FEED(..)`.
fn number_in(command: &str) -> Option<usize> {
    number_of(command.split_whitespace().nth(1)?)
}

/// The number at the beginning of a block: `N5 G1`.
fn number_of(block: &str) -> Option<usize> {
    let digits: String = block.trim().strip_prefix('N')?.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok().filter(|number| *number > 0)
}
