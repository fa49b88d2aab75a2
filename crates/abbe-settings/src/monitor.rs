//! Progress events of long work, and cancellation.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::{Error, Result};

/// An event of the progress of some work.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event<'a> {
    /// A stage starts; `done` of `all` stages are finished.
    Started {
        /// Its name.
        stage: &'a str,
        /// Its kind.
        kind: &'a str,
        /// Stages that are finished.
        done: usize,
        /// All stages that have something to do.
        all: usize,
    },
    /// An estimate has taken a step.
    Iteration {
        /// The stage.
        stage: &'a str,
        /// Steps of this iteration so far; robust weights start a new one in every round.
        iteration: usize,
        /// Size of the step: change of all rows together, in standard uncertainties.
        step: f64,
    },
    /// A part of repeated work is finished: a trial, a fold.
    Part {
        /// The stage.
        stage: &'a str,
        /// What its parts are, in plural: `trials`.
        of: &'a str,
        /// Parts that are finished.
        done: usize,
        /// All parts, where that is known.
        all: Option<usize>,
    },
}

/// Observer of some work: receives events, from any thread, and can cancel the work.
///
/// A problem has a monitor, so that all work on the problem reports events and can be cancelled. The default monitor does
/// nothing.
#[derive(Clone, Default)]
pub struct Monitor {
    watcher: Option<Arc<Watcher>>,
    /// When the work has to end, and the time that it has in all.
    deadline: Option<(Instant, Duration)>,
    /// Whether nobody wants this work any more.
    unwanted: Option<Arc<AtomicBool>>,
    stage: Arc<str>,
    quiet: bool,
}

struct Watcher {
    ended: AtomicBool,
    receive: Box<dyn Fn(&Event<'_>) + Send + Sync>,
}

impl fmt::Debug for Monitor {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Monitor")
            .field("stage", &self.stage)
            .field("quiet", &self.quiet)
            .finish_non_exhaustive()
    }
}

impl Monitor {
    /// A monitor that passes events to `receive`.
    pub fn new(receive: impl Fn(&Event<'_>) + Send + Sync + 'static) -> Self {
        let watcher = Watcher { ended: AtomicBool::new(false), receive: Box::new(receive) };
        Self { watcher: Some(Arc::new(watcher)), ..Self::default() }
    }

    /// The same monitor; [`check`](Self::check) fails from `limit` from now on.
    pub fn with_time_limit(self, limit: Duration) -> Self {
        // A moment that the clock cannot tell is never reached.
        Self { deadline: Instant::now().checked_add(limit).map(|end| (end, limit)), ..self }
    }

    /// The same without a time limit, for what is made of results that are there in time. The work can still be cancelled.
    pub fn without_time_limit(&self) -> Self {
        Self { deadline: None, ..self.clone() }
    }

    /// The same for the work of a stage.
    pub fn of_stage(&self, stage: &str) -> Self {
        Self { stage: stage.into(), ..self.clone() }
    }

    /// The same monitor without events, for work that is repeated many times. The work can still be cancelled.
    pub fn without_events(&self) -> Self {
        Self { quiet: true, ..self.clone() }
    }

    /// The same for a part of the work that may turn out to be of no use: [`check`](Self::check) fails from when `unwanted` is true.
    pub fn until(&self, unwanted: Arc<AtomicBool>) -> Self {
        Self { unwanted: Some(unwanted), ..self.clone() }
    }

    /// Cancels the work: [`check`](Self::check) then returns an error.
    pub fn cancel(&self) {
        if let Some(watcher) = &self.watcher {
            watcher.ended.store(true, Ordering::Relaxed);
        }
    }

    /// Fails with [`Class::Interrupted`](crate::Class::Interrupted) if the work has been cancelled or nobody wants it any more, and with
    /// [`Error::out_of_time`] if its time is over.
    pub fn check(&self) -> Result<()> {
        let ended = self.watcher.as_ref().map(|watcher| &watcher.ended);
        if ended.into_iter().chain(self.unwanted.as_deref()).any(|is_over| is_over.load(Ordering::Relaxed)) {
            return Err(Error::interrupted());
        }
        match self.deadline {
            Some((end, limit)) if Instant::now() >= end => {
                Err(Error::out_of_time(format!("the time limit of {} s is over", limit.as_secs_f64())))
            }
            _ => Ok(()),
        }
    }

    /// Reports an event.
    pub fn report(&self, event: &Event<'_>) {
        if let Some(watcher) = self.watcher.as_ref().filter(|_| !self.quiet) {
            (watcher.receive)(event);
        }
    }

    /// Reports that an estimate has taken a step.
    pub fn iteration(&self, iteration: usize, step: f64) {
        self.report(&Event::Iteration { stage: &self.stage, iteration, step });
    }

    /// Reports that `done` parts of some work are finished. `of` is the name of the parts, in plural.
    pub fn parts_done(&self, of: &str, done: usize, all: Option<usize>) {
        self.report(&Event::Part { stage: &self.stage, of, done, all });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::Class;

    #[test]
    fn events_are_heard_and_work_ends_on_request() {
        let heard = Arc::new(Mutex::new(Vec::new()));
        let into = heard.clone();
        let monitor = Monitor::new(move |event| into.lock().unwrap().push(serde_json::to_string(event).unwrap()));
        let of_fit = monitor.of_stage("fit");
        of_fit.iteration(1, 0.5);
        of_fit.without_events().iteration(2, 0.1);
        of_fit.parts_done("folds", 3, Some(10));
        assert_eq!(
            *heard.lock().unwrap(),
            [
                r#"{"event":"iteration","stage":"fit","iteration":1,"step":0.5}"#,
                r#"{"event":"part","stage":"fit","of":"folds","done":3,"all":10}"#
            ]
        );
        assert!(of_fit.check().is_ok());
        monitor.cancel();
        let error = of_fit.without_events().check().unwrap_err();
        assert_eq!((error.class, error.fatal), (Class::Interrupted, true));
        let unwanted = Arc::new(AtomicBool::new(false));
        let part = Monitor::default().until(unwanted.clone()).of_stage("fit");
        assert!(part.check().is_ok());
        unwanted.store(true, Ordering::Relaxed);
        assert_eq!(part.check().unwrap_err().class, Class::Interrupted);
        let late = Monitor::default().with_time_limit(Duration::ZERO).of_stage("fit");
        let error = late.check().unwrap_err();
        assert!(error.out_of_time && error.fatal && error.class == Class::Data);
        assert!(Monitor::default().with_time_limit(Duration::MAX).check().is_ok());
        // The default monitor cannot cancel work.
        let nobody = Monitor::default();
        nobody.cancel();
        assert!(nobody.check().is_ok());
    }
}
