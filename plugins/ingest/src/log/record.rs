//! What a log says: a header, touches by their numbers, and whether the program came to its end.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Error, Result};

use super::words::{Word, words};

/// The axes that a log may have, in the order of their letters.
pub(crate) const AXES: [char; 9] = ['A', 'B', 'C', 'U', 'V', 'W', 'X', 'Y', 'Z'];

/// Whether an axis turns: its positions are degrees.
pub(crate) fn is_rotary(axis: char) -> bool {
    ('A'..='C').contains(&axis)
}

/// Positions of axes, in the units of the log.
pub(crate) type Positions = BTreeMap<char, f64>;

/// What a touch found.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Hit {
    pub(crate) positions: Positions,
    pub(crate) feed: Option<f64>,
    pub(crate) clock: Option<f64>,
    pub(crate) temperature: Option<f64>,
}

/// A touch, or a miss.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Touch {
    pub(crate) number: u32,
    pub(crate) repeat: u32,
    pub(crate) line: usize,
    pub(crate) hit: Option<Hit>,
}

/// A log, as read: numbers are in its own units.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Log {
    /// The identity of the plan, and its line.
    pub(crate) plan: Option<(String, usize)>,
    pub(crate) inches: Option<bool>,
    pub(crate) is_work: Option<bool>,
    /// What has to be added to positions, with its line.
    pub(crate) offset: Option<(Positions, usize)>,
    /// Length and diameter, with the line.
    pub(crate) tool: Option<([Option<f64>; 2], usize)>,
    pub(crate) touches: Option<u32>,
    pub(crate) repeats: Option<u32>,
    /// Every touch and repeat once, in the order of their lines.
    pub(crate) records: Vec<Touch>,
    pub(crate) has_ended: bool,
}

/// The number of repeats without a word about them.
pub(crate) const ONCE: u32 = 1;

/// Builds a log line by line.
pub(crate) struct Builder<'a> {
    path: &'a Path,
    /// The word behind `CONTROL`.
    control: &'static str,
    version: Option<usize>,
    control_line: Option<usize>,
    log: Log,
    places: BTreeMap<(u32, u32), usize>,
}

impl<'a> Builder<'a> {
    pub(crate) fn new(path: &'a Path, control: &'static str) -> Self {
        Self { path, control, version: None, control_line: None, log: Log::default(), places: BTreeMap::new() }
    }

    /// An error at a line.
    pub(crate) fn wrong(&self, line: usize, message: impl Into<String>) -> Error {
        Error::data(message).at(self.path, line, None)
    }

    /// A line of the common form.
    pub(crate) fn line(&mut self, line: usize, content: &str) -> Result<()> {
        let first = content.split_whitespace().next().unwrap_or_default();
        if self.version.is_none() && first != "ABBE" {
            let message = format!("`{}` stands where the log begins; `ABBE 1` was expected", shown(content));
            return Err(self
                .wrong(line, message)
                .help("is it the log of a measuring program of Abbe? `ingest: text` reads others by a pattern"));
        }
        if self.log.has_ended {
            let error = self.wrong(line, format!("`{}` stands behind END", shown(content)));
            return Err(error.help("take it out, or split the file if a second log begins there"));
        }
        match first {
            "ABBE" | "PLAN" | "CONTROL" | "UNITS" | "FRAME" | "OFFSET" | "TOOL" | "TOUCHES" | "REPEATS" => {
                self.header(line, first, content)
            }
            "END" if content.trim() == "END" => {
                self.log.has_ended = true;
                Ok(())
            }
            _ => {
                let touch = self.touch_of(line, content)?;
                self.touch(touch)
            }
        }
    }

    /// A line of the header.
    fn header(&mut self, line: usize, key: &str, content: &str) -> Result<()> {
        let rest = content.trim_start().strip_prefix(key).unwrap_or_default();
        if key == "ABBE" {
            return self.begin(line, rest);
        }
        if let Some(first) = self.log.records.first() {
            let message = format!("{key} belongs to the header, but the touches begin in line {}", first.line);
            return Err(self.wrong(line, message).help("are two logs in one file? Give each a file of its own"));
        }
        let known = match key {
            "PLAN" => self.log.plan.is_some(),
            "CONTROL" => self.control_line.is_some(),
            "UNITS" => self.log.inches.is_some(),
            "FRAME" => self.log.is_work.is_some(),
            "OFFSET" => self.log.offset.is_some(),
            "TOOL" => self.log.tool.is_some(),
            "TOUCHES" => self.log.touches.is_some(),
            _ => self.log.repeats.is_some(),
        };
        if known {
            return Err(self.wrong(line, format!("{key} stands twice in the header")));
        }
        match key {
            "PLAN" => self.log.plan = Some((self.identity(line, rest)?, line)),
            "CONTROL" => self.set_control(line, rest.trim())?,
            "UNITS" => self.log.inches = Some(self.choice(line, key, rest, ["MM", "INCH"])? == 1),
            "FRAME" => self.log.is_work = Some(self.choice(line, key, rest, ["MACHINE", "WORK"])? == 1),
            "OFFSET" => {
                let words = self.words(line, content, rest)?;
                if let Some(word) = words.iter().find(|word| !AXES.contains(&word.letter)) {
                    return Err(self.at_word(line, word, "is no axis; X Y Z A B C U V W were expected"));
                }
                let axes = words.into_iter().map(|word| (word.letter, word.value));
                self.log.offset = Some((axes.collect(), line));
            }
            "TOOL" => {
                let words = self.words(line, content, rest)?;
                if let Some(word) = words.iter().find(|word| !['L', 'D'].contains(&word.letter)) {
                    return Err(self.at_word(line, word, "is no word of TOOL; L and D were expected"));
                }
                let of = |letter| words.iter().find(|word| word.letter == letter).map(|word| word.value);
                self.log.tool = Some(([of('L'), of('D')], line));
            }
            "TOUCHES" => {
                let (touches, repeats) = rest.split_once("REPEATS").map_or((rest, None), |(a, b)| (a, Some(b)));
                self.log.touches = Some(self.count(line, key, touches)?);
                self.log.repeats = repeats.map(|repeats| self.count(line, "REPEATS", repeats)).transpose()?;
            }
            _ => self.log.repeats = Some(self.count(line, key, rest)?),
        }
        Ok(())
    }

    fn begin(&mut self, line: usize, rest: &str) -> Result<()> {
        if let Some(first) = self.version {
            let error = self.wrong(line, format!("a second log begins here; the first one begins in line {first}"));
            return Err(error.help("give each log a file of its own, and read them by two stages or as two paths"));
        }
        if self.count(line, "ABBE", rest)? != 1 {
            let message = format!("the log has version {}; version 1 was expected", rest.trim());
            return Err(self
                .wrong(line, message)
                .help("a newer Abbe wrote the measuring program: read it with that one"));
        }
        self.version = Some(line);
        Ok(())
    }

    fn identity(&self, line: usize, rest: &str) -> Result<String> {
        let written = rest.trim();
        match written.len() == 16 && written.bytes().all(|it| it.is_ascii_digit() || (b'A'..=b'F').contains(&it)) {
            true => Ok(written.to_owned()),
            false => Err(self.wrong(line, format!("PLAN is `{}`; 16 digits 0-9 A-F were expected", shown(written)))),
        }
    }

    fn set_control(&mut self, line: usize, written: &str) -> Result<()> {
        const READERS: [(&str, &str); 5] = [
            ("LINUXCNC", "linuxcnc-log"),
            ("FANUC", "dprnt"),
            ("SIEMENS", "siemens-log"),
            ("HEIDENHAIN", "heidenhain-log"),
            ("GRBL", "grbl-log"),
        ];
        self.control_line = Some(line);
        if written == self.control {
            return Ok(());
        }
        let error = self.wrong(line, format!("CONTROL is `{}`; {} was expected", shown(written), self.control));
        Err(match READERS.iter().find(|(control, _)| *control == written) {
            Some((_, reader)) => error.help(format!("read it by `ingest: {reader}`")),
            None => error,
        })
    }

    fn choice(&self, line: usize, key: &str, rest: &str, words: [&str; 2]) -> Result<usize> {
        let written = rest.trim();
        words.iter().position(|word| *word == written).ok_or_else(|| {
            self.wrong(line, format!("{key} is `{}`; {} or {} was expected", shown(written), words[0], words[1]))
        })
    }

    /// A number of things, from 1.
    fn count(&self, line: usize, key: &str, rest: &str) -> Result<u32> {
        let value = rest.trim().parse::<f64>().ok().and_then(whole);
        value.ok_or_else(|| {
            self.wrong(line, format!("{key} is `{}`; a whole number from 1 was expected", shown(rest.trim())))
        })
    }

    fn words(&self, line: usize, content: &str, rest: &str) -> Result<Vec<Word>> {
        let before = content.chars().count() - rest.chars().count();
        let found = words(rest).map_err(|(message, column)| {
            Error::data(message).at(self.path, line, Some(before + column)).help(
                "words of a log are a capital letter and a number: `X12.3456`; was the file cut or mixed with another?",
            )
        })?;
        Ok(found.into_iter().map(|word| Word { column: word.column + before, ..word }).collect())
    }

    fn at_word(&self, line: usize, word: &Word, what: &str) -> Error {
        Error::data(format!("`{}` {what}", word.letter)).at(self.path, line, Some(word.column))
    }

    /// The touch of a line.
    fn touch_of(&self, line: usize, content: &str) -> Result<Touch> {
        let words = self.words(line, content, content)?;
        let mut own: BTreeMap<char, Word> = words.into_iter().map(|word| (word.letter, word)).collect();
        let mut needed = |letter: char, what: &str| {
            own.remove(&letter).ok_or_else(|| self.wrong(line, format!("the line has no {letter}, {what}")))
        };
        let [number, repeat, hit] = [
            needed('T', "the number of the touch")?,
            needed('R', "the repeat")?,
            needed('H', "1 for a hit, 0 for a miss")?,
        ];
        let whole = |word: &Word| {
            whole(word.value).ok_or_else(|| self.at_word(line, word, "is no whole number from 1, which was expected"))
        };
        let (number, repeat) = (whole(&number)?, whole(&repeat)?);
        let has_hit = match hit.value {
            1.0 => true,
            0.0 => false,
            _ => return Err(self.at_word(line, &hit, "is neither 1 (hit) nor 0 (miss)")),
        };
        let mut rest = |letter| own.remove(&letter).map(|word: Word| word.value);
        let (feed, clock, temperature) = (rest('F'), rest('K'), rest('J'));
        if let Some(word) = own.values().find(|word| !AXES.contains(&word.letter)) {
            return Err(self.at_word(line, word, "is no word of a touch"));
        }
        let positions: Positions = own.into_iter().map(|(letter, word)| (letter, word.value)).collect();
        // On a miss a control may print where it touched last: that is no position of this touch.
        let hit = has_hit.then_some(Hit { positions, feed, clock, temperature });
        Ok(Touch { number, repeat, line, hit })
    }

    /// Adds a touch. After a miss the same touch may be tried again.
    pub(crate) fn touch(&mut self, touch: Touch) -> Result<()> {
        let Touch { number, repeat, line, .. } = touch;
        let repeats = self.log.repeats.unwrap_or(ONCE);
        if repeat > repeats {
            return Err(self.wrong(line, format!("there is no repeat {repeat}: REPEATS is {repeats}")));
        }
        let Some(&place) = self.places.get(&(number, repeat)) else {
            self.places.insert((number, repeat), self.log.records.len());
            self.log.records.push(touch);
            return Ok(());
        };
        let first = &self.log.records[place];
        if first.hit.is_some() {
            let message = format!("touch {number} (repeat {repeat}) stands in line {} already", first.line);
            return Err(self.wrong(line, message).help("take one of them out; was the log written twice?"));
        }
        self.log.records[place] = touch;
        Ok(())
    }

    /// The program came to its end.
    pub(crate) fn end(&mut self) {
        self.log.has_ended = true;
    }

    /// The log, if its header says what has to be known.
    pub(crate) fn finish(mut self) -> Result<Log> {
        self.log.records.sort_by_key(|touch| touch.line);
        let file = |message: String| Error::data(message).in_file(self.path);
        if self.version.is_none() {
            return Err(file("there is no log in the file: `ABBE 1` was expected".to_owned()));
        }
        let log = &self.log;
        for (key, is_there) in [
            ("PLAN", log.plan.is_some()),
            ("UNITS", log.inches.is_some()),
            ("FRAME", log.is_work.is_some()),
            ("TOUCHES", log.touches.is_some()),
        ] {
            if !is_there {
                let error = file(format!("the header of the log has no line {key}"));
                return Err(
                    error.help("nothing is guessed: a log has PLAN, UNITS, FRAME and TOUCHES before its touches")
                );
            }
        }
        match (log.is_work, &log.offset) {
            (Some(true), None) => Err(file("FRAME is WORK, but the header has no line OFFSET".to_owned())
                .help("add it: machine coordinates are those of the log plus OFFSET")),
            (Some(false), Some((_, line))) => {
                Err(self.wrong(*line, "FRAME is MACHINE, and still there is an OFFSET").help("one of them is wrong"))
            }
            _ => Ok(self.log),
        }
    }
}

/// A whole number from 1.
fn whole(value: f64) -> Option<u32> {
    (value.fract() == 0.0 && (1.0..=4e9).contains(&value)).then_some(value as u32)
}

/// Letters of a line that a message shows.
const SHOWN: usize = 60;

/// The beginning of a text, which may be long.
pub(crate) fn shown(text: &str) -> String {
    let more = if text.chars().nth(SHOWN).is_some() { "..." } else { "" };
    text.chars().take(SHOWN).chain(more.chars()).collect()
}
