//! The subset of the SINUMERIK language that measuring programs use: subprograms with parameters, MEAS, WRITE.

use std::collections::BTreeMap;

use super::machine::{ByAxis, Machine};
use crate::gcode::expression::value;

struct State<'a> {
    files: &'a BTreeMap<String, String>,
    machine: &'a mut Machine,
    parameters: BTreeMap<String, f64>,
    /// Whether STOPRE came after the last measuring block.
    waited: bool,
}

/// Runs a program among the files, by their names without endings.
pub fn run(files: &BTreeMap<String, String>, name: &str, machine: &mut Machine) -> Result<(), String> {
    State { files, machine, parameters: BTreeMap::new(), waited: false }.program(name, &[])
}

impl State<'_> {
    fn program(&mut self, name: &str, arguments: &[f64]) -> Result<(), String> {
        let text = self.files.get(name).ok_or_else(|| format!("there is no program {name}"))?.clone();
        let lines: Vec<&str> = text.lines().map(|line| line.split(';').next().unwrap_or_default().trim()).collect();
        let mut local = BTreeMap::new();
        if let Some(names) = lines[0].strip_prefix(&format!("PROC {name}")).filter(|rest| !rest.is_empty()) {
            let names: Vec<&str> = names.trim_matches(['(', ')']).split(',').collect();
            if names.len() != arguments.len() {
                return Err(format!("{name} takes {} values", names.len()));
            }
            let names = names.iter().map(|name| name.split(' ').next_back().unwrap_or_default().to_owned());
            local.extend(names.zip(arguments.iter().copied()));
        }
        let mut line = 0;
        while self.machine.alarm.is_none() {
            let text = *lines.get(line).ok_or("the program has no end")?;
            if ["M30", "M17"].contains(&text) {
                return Ok(());
            }
            let next = self.line(&lines, line, text, &mut local);
            line = next.map_err(|message| format!("{name} line {}: {message}", line + 1))?;
        }
        Ok(())
    }

    fn value(&self, text: &str, local: &BTreeMap<String, f64>) -> Result<f64, String> {
        let variable = |name: &str| {
            let axis = |of: &str| name.strip_prefix(of).and_then(|rest| rest.strip_suffix(']'));
            if let Some(axis) = axis("$AA_MM[").or(axis("$AA_IM[")) {
                let place = self.machine.place(axis);
                return if self.waited { place } else { Err(format!("{name} too early")) };
            }
            match name {
                "$AC_MEA[1]" if self.waited => Ok(f64::from(u8::from(self.machine.triggered))),
                "$A_DAY" | "$A_HOUR" | "$A_MINUTE" => Ok(1.0),
                "$A_SECOND" => Ok(self.machine.log.len() as f64),
                _ if is_parameter(name) => Ok(self.parameters.get(name).copied().unwrap_or(0.0)),
                _ => local.get(name).copied().ok_or_else(|| format!("`{name}` is not known")),
            }
        };
        value(text, ('(', ')'), &variable)
    }

    fn line(
        &mut self,
        lines: &[&str],
        at: usize,
        text: &str,
        local: &mut BTreeMap<String, f64>,
    ) -> Result<usize, String> {
        let first = text.split([' ', '(']).next().unwrap_or_default();
        // The line that closes a block, or the ELSE on its level.
        let close = |ends: &[&str]| -> Result<usize, String> {
            let mut depth = 0;
            for (line, text) in lines.iter().enumerate().skip(at + 1) {
                let word = text.split(' ').next().unwrap_or_default();
                match word {
                    _ if depth == 0 && ends.contains(&word) => return Ok(line),
                    "IF" | "WHILE" | "LOOP" => depth += 1,
                    "ENDIF" | "ENDWHILE" | "ENDLOOP" => depth -= 1,
                    _ => {}
                }
            }
            Err("a block stays open".to_owned())
        };
        match first {
            "" | "PROC" | "EXTERN" | "TRAFOOF" | "D0" | "ENDIF" => {}
            "LOOP" => return Err("the program stands in a loop".to_owned()),
            "STOPRE" => self.waited = true,
            "M0" => {}
            "IF" => {
                let holds = self.value(&text[3..], local)? != 0.0;
                return Ok(if holds { at + 1 } else { close(&["ELSE", "ENDIF"])? + 1 });
            }
            "ELSE" => return Ok(close(&["ENDIF"])? + 1),
            "WHILE" => {
                let end = close(&["ENDWHILE"])?;
                return Ok(if self.value(&text[6..], local)? != 0.0 { at + 1 } else { end + 1 });
            }
            "ENDWHILE" => {
                let start = (0..at).rev().find(|&line| lines[line].starts_with("WHILE"));
                return start.ok_or_else(|| "no WHILE".to_owned());
            }
            "MSG" => {}
            "SETAL" => self.machine.alarm = Some(text.to_owned()),
            "DEF" => {
                let (name, expression) =
                    text.rsplit(' ').next().and_then(|rest| rest.split_once('=')).ok_or("no DEF")?;
                let value = self.value(expression, local)?;
                local.insert(name.to_owned(), value);
            }
            "WRITE" => {
                let parts = text.splitn(3, ',').nth(2).and_then(|rest| rest.strip_suffix(')')).ok_or("no WRITE")?;
                let mut line = String::new();
                for part in parts.split("<<") {
                    match part.strip_prefix('"').and_then(|part| part.strip_suffix('"')) {
                        Some(text) => line.push_str(text),
                        None => line.push_str(&self.value(part, local)?.to_string()),
                    }
                }
                self.machine.log.push(line);
            }
            _ if self.files.contains_key(first) => {
                let inner = text.strip_prefix(first).unwrap_or_default().trim_matches(['(', ')']);
                let values = inner.split(',').filter(|value| !value.is_empty());
                let values = values.map(|value| self.value(value, local)).collect::<Result<Vec<_>, _>>()?;
                self.program(first, &values)?;
            }
            _ => match text.split_once('=').filter(|(name, _)| is_parameter(name) || local.contains_key(*name)) {
                Some((name, expression)) => {
                    let value = self.value(expression, local)?;
                    let home = if is_parameter(name) { &mut self.parameters } else { local };
                    home.insert(name.to_owned(), value);
                }
                None => self.words(text, local)?,
            },
        }
        Ok(at + 1)
    }

    fn words(&mut self, text: &str, local: &BTreeMap<String, f64>) -> Result<(), String> {
        let (mut moves, mut measures, mut machine, mut feed, mut target) = (false, false, false, None, ByAxis::new());
        let mut stands = false;
        for word in text.split_whitespace() {
            match word.split_once('=') {
                None if word == "G1" => moves = true,
                None if word == "SUPA" => machine = true,
                None if word == "G710" => self.machine.unit = Some(1.0),
                None if word == "G700" => self.machine.unit = Some(25.4),
                None if word == "G4" => stands = true,
                None if ["G17", "G40", "G90", "G94"].contains(&word) => {}
                None if word.starts_with('F') => feed = Some(self.value(&word[1..], local)?),
                Some(("MEAS", "1")) => measures = true,
                Some(("SPOS", _)) => {}
                Some((axis, place)) if self.machine.at.contains_key(axis) => {
                    let by = place.strip_prefix("IC").map(|by| self.value(by, local)).transpose()?;
                    let to = by.map_or_else(
                        || self.value(place, local),
                        |by| Ok::<f64, String>(self.machine.place(axis)? + by),
                    )?;
                    target.insert(axis.to_owned(), to);
                }
                _ => return Err(format!("the word `{word}` is not known")),
            }
        }
        if let Some(seconds) = feed.filter(|_| stands) {
            self.machine.wait(seconds);
            return Ok(());
        }
        if !moves && target.is_empty() {
            return Ok(());
        }
        let Some(feed) = feed.filter(|_| moves && machine) else {
            return Err(format!("`{text}` moves in a way that is not known"));
        };
        self.waited = false;
        self.machine.go(&target, feed, measures)
    }
}

fn is_parameter(name: &str) -> bool {
    name.strip_prefix('R')
        .is_some_and(|number| !number.is_empty() && number.chars().all(|digit| digit.is_ascii_digit()))
}
