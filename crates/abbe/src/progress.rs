//! How a run is followed: a bar on a terminal, or events as JSON lines.

use std::io::{self, Write};

use abbe_core::{Event, Monitor, harmless, harmless_json};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};

/// How progress is shown, on standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Progress {
    /// A bar on a terminal, nothing in a pipe.
    #[default]
    Bar,
    /// Every event as one line of JSON.
    Json,
    /// Nothing.
    None,
}

impl Progress {
    /// The monitor of a run, and the bar that it moves.
    pub fn monitor(self) -> (Monitor, ProgressBar) {
        let bar = ProgressBar::new(0).with_style(style());
        let shown = bar.clone();
        let monitor = match self {
            Self::Bar => Monitor::new(move |event| show(&shown, event)),
            Self::Json => Monitor::new(|event| {
                if let Ok(line) = serde_json::to_string(event) {
                    // An output that is closed does not end the run.
                    let _ = writeln!(io::stderr(), "{}", harmless_json(&line));
                }
            }),
            Self::None => Monitor::new(|_| {}),
        };
        (monitor, bar)
    }
}

fn show(bar: &ProgressBar, event: &Event<'_>) {
    let set_message = |message: String| bar.set_message(harmless(&message).into_owned());
    match event {
        Event::Started { stage, kind, done, all } => {
            bar.set_length(*all as u64);
            bar.set_position(*done as u64);
            set_message(format!("{kind} {stage}"));
        }
        Event::Iteration { stage, iteration, .. } => set_message(format!("{stage}: iteration {iteration}")),
        Event::Part { stage, of, done, all: Some(all) } => set_message(format!("{stage}: {done} of {all} {of}")),
        Event::Part { stage, of, done, all: None } => set_message(format!("{stage}: {done} {of}")),
    }
    bar.tick();
}

fn style() -> ProgressStyle {
    ProgressStyle::with_template("{pos}/{len} {msg}").unwrap_or_else(|_| ProgressStyle::default_bar())
}
