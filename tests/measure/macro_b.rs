//! The subset of Custom Macro B that measuring programs use: macros in one file, skip positions, DPRNT.

use std::collections::BTreeMap;

use super::machine::{ByAxis, Machine};
use crate::gcode::expression::value;

/// Local variables of the arguments of `G65`.
const ARGUMENTS: [(&str, u32); 11] = [
    ("A", 1),
    ("B", 2),
    ("Q", 17),
    ("R", 18),
    ("S", 19),
    ("U", 21),
    ("V", 22),
    ("W", 23),
    ("X", 24),
    ("Y", 25),
    ("Z", 26),
];

struct State<'a> {
    lines: Vec<&'a str>,
    machine: &'a mut Machine,
    common: BTreeMap<u32, f64>,
    local: Vec<BTreeMap<u32, f64>>,
    incremental: bool,
    open: bool,
}

pub fn run(text: &str, machine: &mut Machine) -> Result<(), String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let mut state = State {
        lines,
        machine,
        common: BTreeMap::new(),
        local: vec![BTreeMap::new()],
        incremental: false,
        open: false,
    };
    state.program(0)
}

impl State<'_> {
    fn program(&mut self, from: usize) -> Result<(), String> {
        let mut line = from;
        while self.machine.alarm.is_none() {
            let text = self.lines.get(line).copied().ok_or("the program has no end")?;
            match self.line(line, text).map_err(|message| format!("line {}: {message}", line + 1))? {
                Some(next) => line = next,
                None => return Ok(()),
            }
        }
        Ok(())
    }

    fn variable(&self, name: &str) -> Result<f64, String> {
        let number: u32 = name.strip_prefix('#').and_then(|name| name.parse().ok()).ok_or(format!("{name}?"))?;
        let axis = |first: u32| ["X", "Y", "Z"][(number - first) as usize];
        match number {
            1..=33 => Ok(self.local.last().and_then(|local| local.get(&number)).copied().unwrap_or(0.0)),
            100..=199 => Ok(self.common.get(&number).copied().unwrap_or(0.0)),
            3001 => Ok(1000.0 * self.machine.log.len() as f64),
            5021..=5023 => self.machine.place(axis(5021)),
            5041..=5043 => self.machine.place(axis(5041)),
            5061..=5063 => self.machine.place(axis(5061)),
            _ => Err(format!("#{number} is not known")),
        }
    }

    fn value(&self, text: &str) -> Result<f64, String> {
        value(text, ('[', ']'), &|name| self.variable(name))
    }

    fn label(&self, from: usize, label: &str) -> Result<usize, String> {
        // Labels belong to a program, which an O number begins.
        let first = (0..=from).rev().find(|&line| self.lines[line].starts_with('O')).unwrap_or(0);
        let found = (first..self.lines.len()).find(|&line| self.lines[line] == label);
        found.ok_or_else(|| format!("there is no {label}"))
    }

    fn line(&mut self, at: usize, text: &str) -> Result<Option<usize>, String> {
        let next = Ok(Some(at + 1));
        if text.is_empty() || text == "%" || text.starts_with('O') || text.starts_with('N') {
            return next;
        }
        if text.starts_with('(') {
            return if text.ends_with(')') && text == text.to_uppercase() {
                next
            } else {
                Err("no comment".to_owned())
            };
        }
        if let Some(rest) = text.strip_prefix("IF ") {
            let cut = rest.rfind("] ").ok_or("no condition")? + 1;
            let (condition, then) = rest.split_at(cut);
            let holds = self.value(condition)? != 0.0;
            return match (holds, then.trim().strip_prefix("GOTO "), then.trim().strip_prefix("THEN ")) {
                (false, ..) => next,
                (true, Some(label), _) => Ok(Some(self.label(at, &format!("N{label}"))?)),
                (true, _, Some(then)) => self.assign(then).map(|()| Some(at + 1)),
                _ => Err(format!("`{then}` is not known")),
            };
        }
        if let Some(label) = text.strip_prefix("GOTO ") {
            return Ok(Some(self.label(at, &format!("N{label}"))?));
        }
        if let Some(rest) = text.strip_prefix("WHILE ") {
            let (condition, number) = rest.rsplit_once(" DO").ok_or("no DO")?;
            let end = self.label(at, &format!("END{number}"))?;
            return Ok(Some(if self.value(condition)? != 0.0 { at + 1 } else { end + 1 }));
        }
        if let Some(number) = text.strip_prefix("END") {
            let start = (0..at).rev().find(|&line| self.lines[line].ends_with(&format!(" DO{number}")));
            return Ok(Some(start.ok_or("no WHILE")?));
        }
        if text.starts_with('#') {
            return self.assign(text).map(|()| Some(at + 1));
        }
        if let Some(print) = text.strip_prefix("DPRNT[").and_then(|rest| rest.strip_suffix(']')) {
            let line = self.printed(print)?;
            self.machine.log.push(line);
            return if self.open { next } else { Err("no POPEN".to_owned()) };
        }
        match text {
            "POPEN" => self.open = true,
            "PCLOS" => self.open = false,
            "M30" | "M99" => return Ok(None),
            _ if text.starts_with("G65 ") => self.call(text)?,
            _ => self.words(text)?,
        }
        next
    }

    fn assign(&mut self, text: &str) -> Result<(), String> {
        let (name, expression) = text.split_once('=').ok_or_else(|| format!("`{text}` assigns nothing"))?;
        let number: u32 = name[1..].parse().map_err(|_| format!("`{name}` is no variable"))?;
        match number {
            3000 | 3006 => {
                let comment = expression.split_once('(').and_then(|(_, text)| text.strip_suffix(')'));
                let comment = comment.filter(|text| text.len() <= 26).ok_or("no text")?;
                self.machine.alarm = (number == 3000).then(|| comment.to_owned()).or(self.machine.alarm.take());
            }
            1..=33 => {
                let value = self.value(expression)?;
                self.local.last_mut().ok_or("no level")?.insert(number, value);
            }
            100..=199 => drop(self.common.insert(number, self.value(expression)?)),
            _ => return Err(format!("#{number} cannot be set")),
        }
        Ok(())
    }

    fn call(&mut self, text: &str) -> Result<(), String> {
        let (mut program, mut local) = (None, BTreeMap::new());
        for word in text.split_whitespace().skip(1) {
            let (letter, number) = word.split_at(1);
            match ARGUMENTS.iter().find(|(known, _)| *known == letter) {
                _ if letter == "P" => program = Some(format!("O{number}(")),
                Some((_, place)) if number.contains('.') => drop(local.insert(*place, self.value(number)?)),
                _ => return Err(format!("`{word}` is no argument")),
            }
        }
        let program = program.ok_or("no program")?;
        let start = self.lines.iter().position(|line| line.starts_with(&program)).ok_or("no such program")?;
        self.local.push(local);
        self.program(start)?;
        self.local.pop();
        Ok(())
    }

    /// Letters as they are, `*` as a blank, `#1[53]` as a number of five digits and three decimals, padded with blanks.
    fn printed(&self, mut text: &str) -> Result<String, String> {
        let mut line = String::new();
        while let Some(letter) = text.chars().next() {
            if letter == '#' {
                let (name, rest) = text.split_once('[').ok_or("no format")?;
                let (format, rest) = rest.split_once(']').ok_or("no format")?;
                let digits: Vec<usize> =
                    format.chars().filter_map(|digit| digit.to_digit(10)).map(|digit| digit as usize).collect();
                let [whole, decimals] = digits[..] else { return Err(format!("`{format}` is no format")) };
                let number = format!("{:.decimals$}", self.variable(name)?);
                let width = whole + decimals + usize::from(decimals > 0) + 1;
                if number.len() > width {
                    return Err(format!("{number} is wider than [{format}]"));
                }
                line.push_str(&format!("{number:>width$}"));
                text = rest;
            } else {
                let allowed = letter.is_ascii_uppercase() || letter.is_ascii_digit() || "+-/.*".contains(letter);
                line.push(if letter == '*' { ' ' } else { letter });
                text = &text[1..];
                if !allowed {
                    return Err(format!("DPRNT does not print `{letter}`"));
                }
            }
        }
        Ok(line)
    }

    fn words(&mut self, text: &str) -> Result<(), String> {
        let (mut motion, mut target, mut feed) = (None, ByAxis::new(), None);
        for word in text.split_whitespace() {
            let (letter, number) = word.split_at(1);
            match (letter, word) {
                (_, "G1" | "G31") => motion = Some(word),
                (_, "G90") => self.incremental = false,
                (_, "G91") => self.incremental = true,
                (_, "G20") => self.machine.unit = Some(25.4),
                (_, "G21") => self.machine.unit = Some(1.0),
                (_, "G4") => motion = Some(word),
                // Without a point it is milliseconds, on Fanuc and on Haas.
                ("P", _) if motion == Some("G4") && !number.contains('.') => {
                    self.machine.wait(self.value(number)? / 1e3);
                    return Ok(());
                }
                (_, "G17" | "G40" | "G49" | "G80" | "G94" | "G59" | "M19") => {}
                ("F", _) => feed = Some(self.value(number)?).filter(|feed| *feed > 0.0),
                ("X" | "Y" | "Z" | "A" | "B" | "C", _) => drop(target.insert(letter.to_owned(), self.value(number)?)),
                _ => return Err(format!("the word `{word}` is not known")),
            }
        }
        if self.incremental {
            for (axis, value) in &mut target {
                *value += self.machine.place(axis)?;
            }
        }
        match motion {
            None if target.is_empty() => Ok(()),
            Some("G1") => self.machine.go(&target, feed.ok_or("no feed")?, false),
            Some("G31") => self.machine.go(&target, feed.ok_or("no feed")?, true),
            _ => Err(format!("`{text}` moves in a way that is not known")),
        }
    }
}
