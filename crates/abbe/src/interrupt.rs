//! Ctrl-C: the work is asked to end; if it does not, the process ends within a second. No file is left half-written.

use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use abbe_core::{Error, Monitor, Result};

/// Exit status of a process that was interrupted: 128 and the number of the signal.
pub const STATUS: u8 = 130;

/// How long the work has to end by itself.
const GRACE: Duration = Duration::from_millis(600);

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static WRITING: Mutex<()> = Mutex::new(());

/// Ends the work that `monitor` watches on Ctrl-C.
pub fn ends(monitor: Monitor) -> Result<()> {
    let end = move || {
        INTERRUPTED.store(true, Ordering::SeqCst);
        monitor.end();
        std::thread::sleep(GRACE);
        // Waits until a file that is being written is complete.
        let _written = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        // A closed output must not keep the process alive.
        let _ = writeln!(io::stderr(), "interrupted");
        std::process::exit(i32::from(STATUS));
    };
    ctrlc::set_handler(end).map_err(|error| Error::data(format!("Ctrl-C cannot be handled: {error}")))
}

/// Whether Ctrl-C was pressed.
pub fn happened() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}

/// Writes a file that no interruption may cut short.
pub fn while_writing<T>(write: impl FnOnce() -> Result<T>) -> Result<T> {
    let _writing = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    if happened() {
        return Err(Error::interrupted());
    }
    write()
}
