//! The subset of Heidenhain's Klartext that measuring programs use: labels, Q parameters, touch probe cycle 4, FN 16 with masks.

use std::collections::BTreeMap;

use super::machine::{ByAxis, Machine};
use crate::gcode::expression::value;

/// Runs a program with its masks, by the names of the files.
pub fn run(files: &BTreeMap<String, String>, name: &str, machine: &mut Machine) -> Result<(), String> {
    let text = files.get(name).ok_or("no program")?;
    let mut lines = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let (block, line) = line.split_once(' ').ok_or("an empty block")?;
        if block != number.to_string() {
            return Err(format!("block {block} is number {number}"));
        }
        lines.push(line.split(';').next().unwrap_or_default().trim());
    }
    let stem = name.split('.').next().unwrap_or_default();
    machine.unit = match text.lines().next() {
        Some(first) if first == format!("0 BEGIN PGM {stem} MM") => Some(1.0),
        Some(first) if first == format!("0 BEGIN PGM {stem} INCH") => Some(25.4),
        _ => return Err("the program has no beginning".to_owned()),
    };
    let mut state = State { files, lines, q: BTreeMap::new(), machine, cycle: BTreeMap::new() };
    state.from(0)
}

/// Rapid traverse of the machine, mm/min.
pub const RAPID: f64 = 6000.0;

struct State<'a> {
    files: &'a BTreeMap<String, String>,
    lines: Vec<&'a str>,
    q: BTreeMap<String, f64>,
    machine: &'a mut Machine,
    /// Parts of the touch probe cycle so far.
    cycle: BTreeMap<u32, String>,
}

impl State<'_> {
    fn value(&self, text: &str) -> Result<f64, String> {
        let q = |name: &str| self.q.get(name).copied().ok_or_else(|| format!("{name} is not set"));
        value(text, ('(', ')'), &q)
    }

    fn label(&self, label: &str) -> Result<usize, String> {
        self.lines
            .iter()
            .position(|line| *line == format!("LBL {label}"))
            .ok_or_else(|| format!("there is no LBL {label}"))
    }

    /// Runs until the end of the program or of the subprogram.
    fn from(&mut self, from: usize) -> Result<(), String> {
        let mut line = from;
        while self.machine.alarm.is_none() {
            let text = *self.lines.get(line).ok_or("the program has no end")?;
            if ["M30", "LBL 0"].contains(&text) {
                return Ok(());
            }
            let next = self.line(text).map_err(|message| format!("block {line}: {message}"))?;
            line = next.unwrap_or(line + 1);
        }
        Ok(())
    }

    fn line(&mut self, text: &str) -> Result<Option<usize>, String> {
        if text.is_empty() || text == "M0" || text.starts_with("BEGIN PGM") || text.starts_with("LBL ") {
            return Ok(None);
        }
        if let Some(label) = text.strip_prefix("CALL LBL ") {
            self.from(self.label(label)?)?;
            return Ok(None);
        }
        if let Some(rest) = text.strip_prefix("FN 16: F-PRINT ") {
            let mask = rest.split(" / ").next().and_then(|path| path.rsplit('\\').next()).ok_or("no mask")?;
            let mask = self.files.get(mask).ok_or_else(|| format!("there is no mask {mask}"))?.clone();
            self.print(&mask)?;
            return Ok(None);
        }
        if let Some(rest) = text.strip_prefix("FN 18: SYSREAD ") {
            let (name, what) = rest.split_once(" = ").ok_or("no SYSREAD")?;
            let clock = what == "ID320 NR1 IDX0";
            self.q.insert(name.to_owned(), self.machine.log.len() as f64);
            return if clock { Ok(None) } else { Err(format!("{what} is not known")) };
        }
        if text.starts_with("FN 14: ERROR") {
            self.machine.alarm = Some(text.to_owned());
            return Ok(None);
        }
        for (function, word) in [("FN 9: IF ", " EQU "), ("FN 12: IF ", " LT ")] {
            if let Some(rest) = text.strip_prefix(function) {
                let (condition, label) = rest.split_once(" GOTO LBL ").ok_or("no GOTO")?;
                let (one, other) = condition.split_once(word).ok_or("no condition")?;
                let (one, other) = (self.value(one)?, self.value(other)?);
                let holds = if word == " EQU " { one == other } else { one < other };
                return Ok(if holds { Some(self.label(label)?) } else { None });
            }
        }
        for function in ["FN 0: ", "FN 1: "] {
            if let Some((name, expression)) = text.strip_prefix(function).and_then(|rest| rest.split_once(" = ")) {
                let value = self.value(&expression.replace("+ +", "+"))?;
                self.q.insert(name.to_owned(), value);
                return Ok(None);
            }
        }
        if let Some((part, rest)) = text.strip_prefix("TCH PROBE 4.").and_then(|rest| rest.split_once(' ')) {
            let part: u32 = part.parse().map_err(|_| "no part of the cycle".to_owned())?;
            self.cycle.insert(part, rest.to_owned());
            return if part == 3 { self.measure().map(|()| None) } else { Ok(None) };
        }
        if text == "CYCL DEF 9.0 DWELL TIME" {
            return Ok(None);
        }
        if let Some(seconds) = text.strip_prefix("CYCL DEF 9.1 DWELL ") {
            self.machine.wait(self.value(seconds)?);
            return Ok(None);
        }
        if text.starts_with("L ") {
            return self.straight(text).map(|()| None);
        }
        Err(format!("`{text}` is not known"))
    }

    /// A move in machine coordinates. The control watches the probe.
    fn straight(&mut self, text: &str) -> Result<(), String> {
        let (mut target, mut machine, mut feed) = (ByAxis::new(), false, 0.0);
        for word in text.split_whitespace().skip(1) {
            let (letter, number) = word.split_at(1);
            match word {
                "R0" => {}
                "M91" => machine = true,
                _ if letter == "F" => feed = self.value(number)?,
                _ if self.machine.at.contains_key(letter) && number.starts_with(['+', '-']) => {
                    target.insert(letter.to_owned(), self.value(number)?);
                }
                _ => return Err(format!("the word `{word}` is not known")),
            }
        }
        if !machine || feed <= 0.0 {
            return Err(format!("`{text}` has neither M91 nor F"));
        }
        let turns = target.keys().any(|axis| "ABC".contains(axis.as_str()));
        self.machine.go(&target, if turns { feed } else { self.feed(feed) }, true)?;
        if self.machine.triggered {
            self.machine.alarm = Some("the stylus is deflected".to_owned());
        }
        Ok(())
    }

    /// A feed of linear axes in units per minute: programs in inches have tenths of an inch.
    fn feed(&self, programmed: f64) -> f64 {
        if self.machine.unit == Some(1.0) { programmed } else { programmed / 10.0 }
    }

    /// Cycle 4: along a direction, at most as far as ABST, and back by MB, not beyond where it began.
    fn measure(&mut self) -> Result<(), String> {
        let part =
            |number: u32| self.cycle.get(&number).cloned().ok_or(format!("part {number} of the cycle is missing"));
        let (name, direction, last) = (part(1)?, part(2)?, part(3)?);
        self.cycle.clear();
        let first: u32 = name.strip_prefix('Q').and_then(|number| number.parse().ok()).ok_or("no result")?;
        let mut along = ByAxis::new();
        for word in direction.split_whitespace() {
            along.insert(word[1..2].to_owned(), self.value(&word[2..])?);
        }
        let length = along.values().map(|part| part * part).sum::<f64>().sqrt();
        let words: Vec<&str> = last.split_whitespace().collect();
        let [distance, feed, back, "REFERENCE", "SYSTEM:1"] = words[..] else { return Err(format!("`{last}`?")) };
        let number = |word: &str, prefix: &str| self.value(word.strip_prefix(prefix).ok_or(format!("no {prefix}"))?);
        let (distance, feed, back) = (number(distance, "ABST")?, number(feed, "F")?, number(back, "MB")?);
        let places = |machine: &Machine| -> Result<ByAxis, String> {
            along.keys().map(|axis| Ok((axis.clone(), machine.place(axis)?))).collect()
        };
        let start = places(self.machine)?;
        let target: ByAxis =
            along.iter().map(|(axis, part)| (axis.clone(), start[axis] + part / length * distance)).collect();
        if feed <= 0.0 {
            return Err("no feed".to_owned());
        }
        self.machine.go(&target, self.feed(feed), true)?;
        let met = self.machine.triggered;
        for (index, axis) in ["X", "Y", "Z"].iter().enumerate() {
            if let Ok(place) = self.machine.place(axis) {
                self.q.insert(format!("Q{}", first + index as u32), place);
            }
        }
        self.q.insert(format!("Q{}", first + 3), if met { 0.0 } else { -1.0 });
        let there = places(self.machine)?;
        let gone = along.keys().map(|axis| (there[axis] - start[axis]).powi(2)).sum::<f64>().sqrt();
        let back = back.min(gone);
        let target: ByAxis =
            along.iter().map(|(axis, part)| (axis.clone(), there[axis] - part / length * back)).collect();
        // Back in rapid traverse.
        self.machine.go(&target, RAPID / self.machine.unit.unwrap_or(1.0), false)
    }

    fn print(&mut self, mask: &str) -> Result<(), String> {
        for line in mask.lines().map(str::trim).filter(|line| line.starts_with('"')) {
            let (text, values) = line[1..].split_once('"').ok_or("a text stays open")?;
            let values: Vec<&str> = values.trim_end_matches(';').split(',').filter(|value| !value.is_empty()).collect();
            let (mut printed, mut rest, mut values) = (String::new(), text, values.into_iter());
            while let Some((before, after)) = rest.split_once('%') {
                let (format, after) = after.split_once("LF").ok_or("no format")?;
                let (width, decimals) = format.split_once('.').ok_or("no format")?;
                let (width, decimals): (usize, usize) =
                    (width.parse().map_err(|_| "no width")?, decimals.parse().map_err(|_| "no decimals")?);
                let value = self.value(values.next().ok_or("too few values")?)?;
                printed.push_str(&format!("{before}{value:width$.decimals$}"));
                rest = after;
            }
            if values.next().is_some() {
                return Err("too many values".to_owned());
            }
            self.machine.log.push(format!("{printed}{rest}"));
        }
        Ok(())
    }
}
