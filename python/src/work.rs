//! Long work beside the interpreter: its lock is released, Ctrl-C ends the work, and progress is told.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use abbe_core::{Event, Monitor, Result};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::failure::OrRaise;

/// How long nobody looks for Ctrl-C.
const INTERVAL: Duration = Duration::from_millis(50);

/// What the work tells the thread that waits for it.
enum Told {
    Event(String),
    Done,
}

/// Sends the end of the work, also that by a panic.
struct AtEnd(Sender<Told>);

impl Drop for AtEnd {
    fn drop(&mut self) {
        // Nobody waits any more if this fails.
        let _ = self.0.send(Told::Done);
    }
}

/// Does work in a thread of its own, until it is done or the user ends it. `progress` is called with every event, in
/// this thread.
pub fn at_work<T: Send>(
    py: Python<'_>,
    progress: Option<Bound<'_, PyAny>>,
    time_limit: Option<Duration>,
    work: impl FnOnce(&Monitor) -> Result<T> + Send,
) -> PyResult<T> {
    let (sender, receiver) = channel();
    let events = sender.clone();
    let wanted = progress.is_some();
    let monitor = Monitor::new(move |event: &Event<'_>| {
        if wanted && let Ok(text) = serde_json::to_string(event) {
            let _ = events.send(Told::Event(text));
        }
    });
    let limited = match time_limit {
        Some(limit) => monitor.clone().with_time_limit(limit),
        None => monitor.clone(),
    };
    let receiver = Mutex::new(receiver);
    thread::scope(|scope| {
        let worker = scope.spawn(move || {
            let _end = AtEnd(sender);
            work(&limited)
        });
        let mut failure = None;
        loop {
            let told = py.detach(|| receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(INTERVAL));
            let heard = py.check_signals().and_then(|()| match &told {
                Ok(Told::Event(text)) if failure.is_none() => tell(&progress, text),
                _ => Ok(()),
            });
            if let Err(error) = heard {
                monitor.cancel();
                failure.get_or_insert(error);
            }
            if matches!(told, Ok(Told::Done) | Err(RecvTimeoutError::Disconnected)) {
                break;
            }
        }
        let result = py.detach(|| worker.join());
        match (failure, result) {
            (Some(failure), _) => Err(failure),
            (None, Ok(result)) => result.or_raise(py),
            (None, Err(_)) => Err(PyRuntimeError::new_err("the program failed: this is a fault of it")),
        }
    })
}

fn tell(progress: &Option<Bound<'_, PyAny>>, event: &str) -> PyResult<()> {
    let Some(progress) = progress else { return Ok(()) };
    let event = progress.py().import("json")?.call_method1("loads", (event,))?;
    progress.call1((event,)).map(drop)
}
