//! The subset of RS274 as LinuxCNC extends it, and that of grbl, from the manuals of both.

use std::collections::BTreeMap;

use super::machine::{ByAxis, Machine};
use crate::gcode::expression::value;

const AXES: [&str; 9] = ["X", "Y", "Z", "A", "B", "C", "U", "V", "W"];

pub struct Rs274<'a> {
    lines: Vec<&'a str>,
    machine: &'a mut Machine,
    global: BTreeMap<String, f64>,
    local: Vec<BTreeMap<String, f64>>,
    incremental: bool,
    /// The host writes down what it sends and what comes back.
    grbl: bool,
    open: bool,
}

/// Runs a program; what is not known is refused.
pub fn run(text: &str, grbl: bool, machine: &mut Machine) -> Result<(), String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let count = lines.len();
    let (global, local) = (BTreeMap::new(), vec![BTreeMap::new()]);
    let mut state = Rs274 { lines, machine, global, local, incremental: false, grbl, open: false };
    state.lines(0, count)
}

impl Rs274<'_> {
    fn variable(&self, name: &str) -> Result<f64, String> {
        if let Some(number) = name.strip_prefix('#').and_then(|number| number.parse::<usize>().ok()) {
            return match number {
                5061..=5069 => Ok(self.machine.place(AXES[number - 5061]).unwrap_or(0.0)),
                5070 => Ok(f64::from(u8::from(self.machine.triggered))),
                5210..=5390 => Ok(0.0),
                _ => self
                    .local
                    .last()
                    .and_then(|local| local.get(name))
                    .copied()
                    .ok_or_else(|| format!("{name} is not set")),
            };
        }
        let known = self.global.get(name).or_else(|| self.local.last().and_then(|local| local.get(name)));
        known.copied().ok_or_else(|| format!("{name} is not set"))
    }

    fn value(&self, text: &str) -> Result<f64, String> {
        value(text, ('[', ']'), &|name| self.variable(name))
    }

    fn find(&self, from: usize, label: &str, ends: &[&str]) -> Result<usize, String> {
        let found = (from..self.lines.len())
            .find(|&line| self.lines[line].strip_prefix(label).is_some_and(|rest| ends.contains(&rest.trim())));
        found.ok_or_else(|| format!("{label} has no end"))
    }

    fn lines(&mut self, from: usize, to: usize) -> Result<(), String> {
        let mut line = from;
        while line < to && self.machine.alarm.is_none() {
            line = self.line(line).map_err(|message| format!("line {}: {message}", line + 1))?;
        }
        Ok(())
    }

    fn line(&mut self, at: usize) -> Result<usize, String> {
        let text = self.lines[at].to_owned();
        if let Some(rest) = text.strip_prefix("o<").filter(|_| !self.grbl) {
            let (name, rest) = rest.split_once("> ").ok_or("no word after the label")?;
            let label = format!("o<{name}>");
            let (word, rest) = rest.split_once(' ').unwrap_or((rest, ""));
            return match word {
                "sub" => Ok(self.find(at, &label, &["endsub"])? + 1),
                "call" => {
                    let start = self.find(0, &label, &["sub"])?;
                    let end = self.find(start, &label, &["endsub"])?;
                    let values =
                        rest.split_whitespace().map(|value| self.value(value)).collect::<Result<Vec<_>, _>>()?;
                    self.local.push(
                        values.iter().enumerate().map(|(index, value)| (format!("#{}", index + 1), *value)).collect(),
                    );
                    self.lines(start + 1, end)?;
                    self.local.pop();
                    Ok(at + 1)
                }
                "if" => match self.value(rest)? != 0.0 {
                    true => Ok(at + 1),
                    false => Ok(self.find(at, &label, &["else", "endif"])? + 1),
                },
                "else" => Ok(self.find(at, &label, &["endif"])? + 1),
                "while" => {
                    let end = self.find(at, &label, &["endwhile"])?;
                    if self.value(rest)? != 0.0 { Ok(at + 1) } else { Ok(end + 1) }
                }
                "endwhile" => (0..at)
                    .rev()
                    .find(|&line| self.lines[line].starts_with(&format!("{label} while")))
                    .ok_or_else(|| "no while".to_owned()),
                "endif" | "endsub" => Ok(at + 1),
                _ => Err(format!("`{word}` is not known")),
            };
        }
        if let Some((name, expression)) = text.strip_prefix('#').and_then(|_| text.split_once(" = ")) {
            let value = self.value(expression)?;
            let at_home =
                if name.starts_with("#<_") { &mut self.global } else { self.local.last_mut().ok_or("no level")? };
            at_home.insert(name.to_owned(), value);
            return Ok(at + 1);
        }
        if let Some(comment) = text.strip_prefix('(') {
            let comment =
                comment.strip_suffix(')').filter(|inner| !inner.contains(['(', ')'])).ok_or("a comment stays open")?;
            self.comment(comment)?;
            return Ok(at + 1);
        }
        self.words(&text)?;
        Ok(if ["M2", "M30"].contains(&text.as_str()) { self.lines.len() } else { at + 1 })
    }

    fn comment(&mut self, text: &str) -> Result<(), String> {
        if self.grbl {
            self.machine.log.push(format!("({text})"));
            return Ok(());
        }
        match text.split_once(',') {
            Some(("LOGOPEN", _)) => self.open = true,
            Some(("LOG", text)) if self.open => {
                // %d and %.4f say how the variables after them are printed.
                let (mut line, mut rest, mut decimals) = (String::new(), text, 6);
                while let Some(letter) = rest.chars().next() {
                    if let Some(after) = rest.strip_prefix("%d") {
                        (decimals, rest) = (0, after);
                    } else if let Some(after) = rest.strip_prefix("%.") {
                        let digits = after.split_once('f').ok_or("a format that is not known")?;
                        decimals = digits.0.parse().map_err(|_| "a format that is not known")?;
                        rest = digits.1;
                    } else if letter == '#' {
                        let end = rest
                            .find([' ', '>'])
                            .map_or(rest.len(), |end| end + usize::from(rest[end..].starts_with('>')));
                        line.push_str(&format!("{:.decimals$}", self.variable(&rest[..end])?));
                        rest = &rest[end..];
                    } else {
                        line.push(letter);
                        rest = &rest[letter.len_utf8()..];
                    }
                }
                self.machine.log.push(format!(" {line}"));
            }
            Some(("LOGCLOSE", _)) => self.open = false,
            Some(("ABORT", text)) => self.machine.alarm = Some(text.to_owned()),
            _ => {}
        }
        Ok(())
    }

    fn words(&mut self, text: &str) -> Result<(), String> {
        let (mut motion, mut target, mut feed) = (None, ByAxis::new(), None);
        if self.grbl {
            self.machine.log.push(text.to_owned());
        }
        for word in text.split_whitespace() {
            let (letter, number) = word.split_at(1);
            match (letter, word) {
                (_, "G1" | "G38.3" | "G10") => motion = Some(word.to_owned()),
                (_, "G90") => self.incremental = false,
                (_, "G91") => self.incremental = true,
                (_, "G20") => self.machine.unit = Some(25.4),
                (_, "G21") => self.machine.unit = Some(1.0),
                (_, "G4") => motion = Some(word.to_owned()),
                ("P", _) if motion.as_deref() == Some("G4") => {
                    self.machine.wait(self.value(number)?);
                    return Ok(());
                }
                (_, "G17" | "G40" | "G49" | "G80" | "G94" | "G59.3" | "G59" | "G92.1" | "M0" | "M2" | "M30") => {}
                ("F", _) => feed = Some(self.value(number)?).filter(|feed| *feed > 0.0),
                ("N", _) if self.grbl => {}
                ("L" | "P", _) if self.grbl && motion.as_deref() == Some("G10") => {}
                (axis, _) if AXES.contains(&axis) => drop(target.insert(axis.to_owned(), self.value(number)?)),
                _ => return Err(format!("the word `{word}` is not known")),
            }
        }
        if self.incremental {
            for (axis, value) in &mut target {
                *value += self.machine.place(axis)?;
            }
        }
        match motion.as_deref() {
            None if target.is_empty() => {}
            Some("G10") => {}
            Some("G1") => self.machine.go(&target, feed.ok_or("no feed")?, false)?,
            Some("G38.3") => {
                self.machine.go(&target, feed.ok_or("no feed")?, true)?;
                if self.grbl {
                    // Three decimals of millimetres, four of inches ($13=1).
                    let decimals = if self.machine.unit == Some(1.0) { 3 } else { 4 };
                    let place = |axis| self.machine.place(axis).map(|place| format!("{place:.decimals$}"));
                    let mut places = ["X", "Y", "Z"].map(place).into_iter().collect::<Result<Vec<String>, String>>()?;
                    // Controls with rotary axes have all axes in their answer, in the order of the letters.
                    let rotary = ["A", "B", "C"].map(|axis| self.machine.at.get(axis));
                    if rotary.iter().any(Option::is_some) {
                        places.extend(rotary.map(|at| format!("{:.3}", at.copied().unwrap_or(0.0))));
                    }
                    let place = places.join(",");
                    self.machine.log.push(format!("[PRB:{place}:{}]", u8::from(self.machine.triggered)));
                }
            }
            _ => return Err(format!("`{text}` moves in a way that is not known")),
        }
        Ok(())
    }
}
