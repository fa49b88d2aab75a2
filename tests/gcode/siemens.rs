//! The subset of the SINUMERIK language.

use std::collections::BTreeMap;

use super::{ByAxis, End, Machine, expression};

/// Blocks that a program may run before it is taken for endless.
const MOST: usize = 100_000;

/// Runs a program on R parameters, which it changes; those that were never set are 0.
pub fn run(text: &str, parameters: &mut BTreeMap<u32, f64>, machine: &mut Machine) -> Result<End, String> {
    let lines: Vec<&str> = text.lines().map(|line| line.split(';').next().unwrap_or_default().trim()).collect();
    let blocks = blocks(&lines)?;
    let mut state = State {
        parameters: std::mem::take(parameters),
        local: BTreeMap::new(),
        machine,
        measured: None,
        alarm: None,
        moved: false,
    };
    let end = state.run(&lines, &blocks);
    *parameters = state.parameters;
    end
}

/// The words that open and close blocks.
const PAIRS: [(&str, &str); 3] = [("IF", "ENDIF"), ("WHILE", "ENDWHILE"), ("LOOP", "ENDLOOP")];

fn first_word(text: &str) -> &str {
    text.split([' ', '(']).next().unwrap_or_default()
}

/// The lines that open and close each block.
fn blocks(lines: &[&str]) -> Result<Vec<(usize, usize)>, String> {
    let (mut open, mut found) = (Vec::new(), Vec::new());
    for (line, text) in lines.iter().enumerate() {
        if let Some((_, close)) = PAIRS.iter().find(|(opens, _)| first_word(text) == *opens) {
            open.push((line, *close));
        } else if PAIRS.iter().any(|(_, close)| text == close) {
            match open.pop() {
                Some((start, close)) if close == *text => found.push((start, line)),
                _ => return Err(format!("line {}: `{text}` closes nothing", line + 1)),
            }
        }
    }
    if open.is_empty() { Ok(found) } else { Err("a block stays open".to_owned()) }
}

struct State<'a> {
    parameters: BTreeMap<u32, f64>,
    local: BTreeMap<String, f64>,
    machine: &'a mut Machine,
    /// Whether the last measuring block triggered, and whether reading waited for it.
    measured: Option<(bool, bool)>,
    alarm: Option<u32>,
    /// Whether a block moved: declarations come before.
    moved: bool,
}

impl State<'_> {
    fn run(&mut self, lines: &[&str], blocks: &[(usize, usize)]) -> Result<End, String> {
        let mut line = 0;
        for _ in 0..MOST {
            let Some(&text) = lines.get(line) else { return Err("the program has no M30".to_owned()) };
            let wrong = |message: String| format!("line {}: {message}", line + 1);
            let close = blocks.iter().find(|(open, _)| *open == line).map(|(_, close)| *close);
            let open = blocks.iter().find(|(_, close)| *close == line).map(|(open, _)| *open);
            line = match (first_word(text), close, open) {
                ("IF" | "WHILE", Some(close), _) => {
                    let condition = text.split_once(' ').map(|(_, condition)| condition).unwrap_or_default();
                    if self.condition(condition).map_err(wrong)? { line + 1 } else { close + 1 }
                }
                ("LOOP", Some(_), _) | ("ENDIF", _, Some(_)) => line + 1,
                ("ENDWHILE" | "ENDLOOP", _, Some(open)) => open,
                _ => {
                    if let Some(end) = self.block(text).map_err(wrong)? {
                        return Ok(end);
                    }
                    line + 1
                }
            };
        }
        Err("the program does not end".to_owned())
    }

    fn value(&self, text: &str) -> Result<f64, String> {
        let variable = |name: &str| if name.starts_with('$') { self.system(name) } else { self.variable(name) };
        expression::value(text, ('(', ')'), &variable)
    }

    fn variable(&self, name: &str) -> Result<f64, String> {
        if let Some(number) = parameter(name) {
            return Ok(self.parameters.get(&number).copied().unwrap_or(0.0));
        }
        self.local.get(name).copied().ok_or_else(|| format!("`{name}` is not known"))
    }

    fn system(&self, name: &str) -> Result<f64, String> {
        let Some((triggered, true)) = self.measured else {
            return Err(format!("`{name}` is read without a measurement and STOPRE before it"));
        };
        if name == "$AC_MEA[1]" {
            return Ok(f64::from(u8::from(triggered)));
        }
        let axis = name.strip_prefix("$AA_MM[").and_then(|rest| rest.strip_suffix(']'));
        self.machine.at(axis.ok_or_else(|| format!("`{name}` is not known"))?)
    }

    fn condition(&self, text: &str) -> Result<bool, String> {
        if text.contains("==") || text.contains("<>") {
            return Err(format!("`{text}` compares in a way that is not known"));
        }
        if let Some((one, other)) = text.split_once(">=") {
            return Ok(self.value(one)? >= self.value(other)?);
        }
        let (one, other) = text.split_once('<').ok_or_else(|| format!("`{text}` is no condition"))?;
        Ok(self.value(one)? < self.value(other)?)
    }

    fn block(&mut self, text: &str) -> Result<Option<End>, String> {
        match text {
            "" | "TRAFOOF" | "D0" => return Ok(None),
            "M30" => return Ok(Some(End::Done)),
            "M0" => {
                // After an alarm the program stands here until reset.
                let last = || self.machine.messages.last().cloned().unwrap_or_default();
                return Ok(self.alarm.map(|number| End::Alarm(number, last())));
            }
            "STOPRE" => {
                self.measured = self.measured.map(|(triggered, _)| (triggered, true));
                return Ok(None);
            }
            _ => {}
        }
        if let Some(rest) = text.strip_prefix("DEF REAL ").or_else(|| text.strip_prefix("DEF INT ")) {
            let (name, value) = rest.split_once('=').ok_or_else(|| format!("`{rest}` has no value"))?;
            if self.moved || parameter(name).is_some() || name.len() > 31 {
                return Err(format!("`{text}` cannot stand here"));
            }
            let value = self.value(value)?;
            self.local.insert(name.to_owned(), value);
            return Ok(None);
        }
        if let Some(message) = text.strip_prefix("MSG(\"").and_then(|rest| rest.strip_suffix("\")")) {
            self.machine.messages.push(message.to_owned());
            return Ok(None);
        }
        if let Some(number) = text.strip_prefix("SETAL(").and_then(|rest| rest.strip_suffix(')')) {
            let number: u32 = number.parse().map_err(|_| format!("`{number}` is no alarm"))?;
            if !(65000..=69999).contains(&number) {
                return Err(format!("{number} is no alarm of the user"));
            }
            self.alarm = Some(number);
            return Ok(None);
        }
        if let Some((name, value)) =
            text.split_once('=').filter(|(name, _)| !name.contains(' ') && *name != "SPOS" && *name != "MEAS")
        {
            let value = self.value(value)?;
            match parameter(name) {
                Some(number) => drop(self.parameters.insert(number, value)),
                None => {
                    self.variable(name)?;
                    self.local.insert(name.to_owned(), value);
                }
            }
            return Ok(None);
        }
        self.words(text).map(|()| None)
    }

    fn words(&mut self, text: &str) -> Result<(), String> {
        self.moved = true;
        let (mut motion, mut target, mut feed, mut measures, mut machine) = (None, ByAxis::new(), None, false, false);
        for word in text.split(' ') {
            match word {
                "G0" | "G1" => motion = Some(word),
                "SUPA" => machine = true,
                "MEAS=1" => measures = true,
                "G17" | "G40" | "G90" | "G94" | "G710" => {}
                _ if word.starts_with("SPOS=") => drop(self.value(&word[5..])?),
                _ if word.starts_with('F') => feed = Some(self.value(&word[1..])?),
                _ => {
                    let (axis, at) = word.split_once('=').ok_or_else(|| format!("the word `{word}` is not known"))?;
                    if !["X", "Y", "Z", "A", "B", "C"].contains(&axis) {
                        return Err(format!("the word `{word}` is not known"));
                    }
                    target.insert(axis.to_owned(), self.value(at)?);
                }
            }
        }
        match (motion, measures) {
            (None, false) if target.is_empty() => Ok(()),
            _ if !machine => Err(format!("`{text}` does not suppress the offsets")),
            (Some("G0"), false) => self.machine.rapid(&target),
            (Some("G1"), false) if feed.is_some() => self.machine.feed(&target),
            (Some("G1"), true) if feed.is_some() => {
                self.measured = Some((self.machine.probe(&target)?, false));
                Ok(())
            }
            _ => Err(format!("`{text}` moves in a way that is not known")),
        }
    }
}

/// The number of an R parameter.
fn parameter(name: &str) -> Option<u32> {
    name.strip_prefix('R')?.parse().ok()
}
