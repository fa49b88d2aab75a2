//! Ingest plugin `grbl-log`: the console of a host that sends a measuring program to grbl or a control of its kind.
//!
//! The control writes nothing of its own but answers. The host shows the lines that it sends, with a prefix of its own or
//! without, and the answers; it may send lines before earlier ones are answered. Every probing move has one answer
//! `[PRB:..]`, in the order in which they were sent.

use std::collections::VecDeque;
use std::path::Path;

use abbe_core::{Context, Error, Ingest, Result, SettingsError};
use regex_lite::Regex;
use serde_json::Value;

use super::controls::{Logs, Settings, Understand, lines};
use super::record::{Builder, Hit, Log, Positions, Touch, shown};
use super::step::{self, Steps};

abbe_core::register!(
    Ingest,
    "grbl-log",
    "reads the console log of a host that sent a measuring program to grbl, matched to its plan",
    Settings,
    example,
    build,
    "../../reference/ingest-grbl-log.md",
);

fn example() -> Value {
    super::controls::example("console.txt")
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    let console = Console::new().map_err(|message| SettingsError::new("path", message))?;
    let understand: Understand = Box::new(move |path, text, of| console.log(path, text, of));
    Ok(Box::new(Logs::new(settings, context, understand)?))
}

/// The axes of an answer, in the order of grbl and its descendants.
const ORDER: [char; 9] = ['X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V', 'W'];

/// What lines of a console look like.
pub(super) struct Console {
    comment: Regex,
    answer: Regex,
    word: Regex,
    /// What a line of a program ends with.
    last_word: Regex,
    confirmation: Regex,
}

/// Words of the header, and that of the end, which the program sends as comments.
const KEYS: [&str; 10] = ["ABBE", "PLAN", "CONTROL", "UNITS", "FRAME", "OFFSET", "TOOL", "TOUCHES", "REPEATS", "END"];

/// The touch of a line number: N = 100 touch + repeat.
const PER_TOUCH: u32 = 100;

/// A probing move that was sent.
struct Sent {
    line: usize,
    /// Touch and repeat; none for a move that searches.
    touch: Option<(u32, u32)>,
    feed: Option<f64>,
    before: step::Sent,
}

/// What is known at a line of the console.
#[derive(Default)]
struct State {
    sent: VecDeque<Sent>,
    feed: Option<f64>,
    /// Whether the program has switched to inches (G20) or to millimetres (G21).
    in_inches: Option<bool>,
    /// The line before listed parameters (`$#`): the next answer is one of them.
    lists: bool,
    has_ended: bool,
    inches: Option<bool>,
    steps: Steps,
}

impl Console {
    pub(super) fn new() -> Result<Self, String> {
        let pattern = |written: &str| Regex::new(written).map_err(|error| error.to_string());
        Ok(Self {
            comment: pattern(r"\(([^()]*)\)")?,
            answer: pattern(r"\[PRB:([^\]:]*):([01])\]")?,
            word: pattern(r"([A-Z])\s*([-+]?\d*\.?\d+\.?)")?,
            last_word: pattern(r"[A-Z]\s*[-+]?\d*\.?\d+\.?[\s<]*$")?,
            confirmation: pattern(r"\bok\b")?,
        })
    }

    pub(super) fn log(&self, path: &Path, text: &str, (from, to): (usize, usize)) -> Result<Log> {
        let mut builder = Builder::new(path, "GRBL");
        let mut state = State::default();
        for (line, content) in lines(text, |line| line).filter(|(line, _)| (from..to).contains(line)) {
            if content.contains("ALARM:") {
                // What follows may be without a reference. Lines that were sent ahead, the end among them, were not carried out.
                state.has_ended &= state.sent.is_empty();
                state.sent.clear();
                break;
            }
            if content.contains("error:") {
                let error = builder.wrong(line, format!("the control refused a line: `{}`", shown(content.trim())));
                return Err(
                    error.help("what was not carried out was not measured: correct the program, and measure again")
                );
            }
            self.header(&mut builder, &mut state, line, content)?;
            let (sent, answers) = content.split_at(content.find('[').unwrap_or(content.len()));
            let words = self.comment.replace_all(sent, " ");
            self.sent(&mut state, line, &words);
            if !self.last_word.is_match(&self.confirmation.replace_all(&words, "")) && words != sent {
                state.steps.comment();
            }
            self.answers(&mut builder, &mut state, line, answers)?;
            let others = self.comment.replace_all(content, " ");
            state.steps.confirm(self.confirmation.find_iter(&others).count());
            state.lists = content.contains("[TLO:");
        }
        if let Some(open) = state.sent.front().filter(|_| state.has_ended) {
            let message = format!("{} probing moves have no answer; the first was sent here", state.sent.len());
            return Err(builder
                .wrong(open.line, message)
                .help("lines of the console are lost; which answer belongs to which touch is not known"));
        }
        if let Some((line, confirmed)) = state.steps.out_of_step() {
            let message = format!(
                "the control confirmed {confirmed} lines by `ok` since the answer before this one, and the console shows another number of lines between the two moves"
            );
            return Err(builder
                .wrong(line, message)
                .help("lines of the console are lost; which answer belongs to which touch is not known"));
        }
        if state.has_ended {
            builder.end();
        }
        builder.finish()
    }

    /// Comments that the program sends as its header.
    fn header(&self, builder: &mut Builder<'_>, state: &mut State, line: usize, content: &str) -> Result<()> {
        for comment in self.comment.captures_iter(content).filter_map(|found| found.get(1)) {
            let words = comment.as_str().trim();
            match words.split_whitespace().next() {
                Some("END") => state.has_ended = true,
                Some(key) if KEYS.contains(&key) => {
                    builder.line(line, words)?;
                    if let ("UNITS", Some(unit)) = (key, words.split_whitespace().nth(1)) {
                        state.inches = Some(unit == "INCH");
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// What the host has sent, without comments.
    fn sent(&self, state: &mut State, line: usize, content: &str) {
        let mut number = None;
        let (mut probes, mut pauses) = (false, false);
        for found in self.word.captures_iter(content) {
            let (Some(letter), Some(value)) = (found.get(1), found.get(2)) else { continue };
            let Ok(value) = value.as_str().parse::<f64>() else { continue };
            match (letter.as_str(), (value * 10.0).round()) {
                ("N", _) => number = (value.fract() == 0.0 && value > 0.0 && value < 4e9).then_some(value as u32),
                ("F", _) => state.feed = Some(value),
                ("G", 380.0..=385.0) if value > 38.0 => probes = true,
                ("G", 200.0) => state.in_inches = Some(true),
                ("G", 210.0) => state.in_inches = Some(false),
                ("M", 0.0) => pauses = true,
                ("M", 20.0 | 300.0) => state.has_ended = true,
                _ => {}
            }
        }
        let before = state.steps.sent();
        if self.last_word.is_match(&self.confirmation.replace_all(content, "")) {
            state.steps.line(pauses);
        }
        if probes {
            let touch = number.map(|it| (it / PER_TOUCH, it % PER_TOUCH)).filter(|(touch, _)| *touch > 0);
            state.sent.push_back(Sent { line, touch, feed: self.feed(state), before });
        }
    }

    /// The feed in the unit of the answers.
    fn feed(&self, state: &State) -> Option<f64> {
        let factor = match (state.in_inches, state.inches) {
            (Some(true), Some(false)) => 25.4,
            (Some(false), Some(true)) => 1.0 / 25.4,
            _ => 1.0,
        };
        state.feed.map(|feed| feed * factor)
    }

    /// The answers of a line.
    fn answers(&self, builder: &mut Builder<'_>, state: &mut State, line: usize, content: &str) -> Result<()> {
        let found: Vec<_> = self.answer.captures_iter(content).collect();
        if found.is_empty() && content.contains("[PRB:") {
            let error = builder.wrong(line, format!("`{}` is no answer to a probing move", shown(content)));
            return Err(error.help("`[PRB:x,y,z:1]` was expected; is the line cut?"));
        }
        for found in found {
            if state.lists {
                continue;
            }
            let Some(sent) = state.sent.pop_front() else {
                let error = builder.wrong(line, "an answer `[PRB:..]` to no probing move");
                return Err(error.help("does the host show the lines that it sends? Or was the log mixed up?"));
            };
            state.steps.answer(line, sent.before);
            let Some((number, repeat)) = sent.touch else { continue };
            let positions = found.get(1).map_or("", |found| found.as_str());
            let hit = match found.get(2).map(|found| found.as_str()) {
                Some("1") => Some(Hit {
                    positions: self.positions(builder, line, positions)?,
                    feed: sent.feed,
                    clock: None,
                    temperature: None,
                }),
                _ => None,
            };
            if repeat == 0 {
                return Err(builder
                    .wrong(sent.line, "the line number ends in 00; N is 100 times the touch, plus the repeat from 1"));
            }
            builder.touch(Touch { number, repeat, line, hit })?;
        }
        Ok(())
    }

    fn positions(&self, builder: &Builder<'_>, line: usize, written: &str) -> Result<Positions> {
        let values: Option<Vec<f64>> =
            written.split(',').map(|it| it.trim().parse().ok().filter(|it: &f64| it.is_finite())).collect();
        let wrong = |message: String| -> Error { builder.wrong(line, message) };
        let values = values.ok_or_else(|| wrong(format!("`{}` are no positions", shown(written))))?;
        if !(3..=ORDER.len()).contains(&values.len()) {
            return Err(wrong(format!(
                "the answer has {} positions; 3 to {} were expected",
                values.len(),
                ORDER.len()
            )));
        }
        Ok(ORDER.into_iter().zip(values).collect())
    }
}
