//! The subset of Custom Macro B.

use std::collections::BTreeMap;

use super::{ByAxis, End, Machine, expression};

/// Blocks that a program may run before it is taken for endless.
const MOST: usize = 100_000;

/// Runs a program on common variables, which it changes; vacant ones are not in the map.
pub fn run(text: &str, common: &mut BTreeMap<u32, f64>, machine: &mut Machine) -> Result<End, String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let loops = loops(&lines)?;
    let mut state = State { variables: std::mem::take(common), skipped: ByAxis::new(), machine };
    let end = state.run(&lines, &loops);
    *common = state.variables;
    common.retain(|number, _| *number >= 100);
    end
}

/// A loop: lines of WHILE and END.
type Loops = Vec<(usize, usize)>;

fn loops(lines: &[&str]) -> Result<Loops, String> {
    let (mut open, mut found) = (Vec::new(), Vec::new());
    for (line, text) in lines.iter().enumerate() {
        if text.starts_with("WHILE") {
            let number = text.rsplit("DO").next().unwrap_or_default();
            open.push((line, number.to_owned()));
        } else if let Some(number) = text.strip_prefix("END") {
            match open.pop() {
                Some((start, opened)) if opened == number && ["1", "2", "3"].contains(&number) => {
                    found.push((start, line))
                }
                _ => return Err(format!("line {}: `{text}` closes no loop", line + 1)),
            }
        }
    }
    if open.is_empty() { Ok(found) } else { Err("a loop stays open".to_owned()) }
}

struct State<'a> {
    variables: BTreeMap<u32, f64>,
    skipped: ByAxis,
    machine: &'a mut Machine,
}

impl State<'_> {
    fn run(&mut self, lines: &[&str], loops: &Loops) -> Result<End, String> {
        let mut line = 0;
        for _ in 0..MOST {
            let Some(text) = lines.get(line) else { return Err("the program has no M30".to_owned()) };
            let wrong = |message: String| format!("line {}: {message}", line + 1);
            match self.block(text).map_err(wrong)? {
                Next::Line => line += 1,
                Next::End(end) => return Ok(end),
                Next::Loop(true) => line += 1,
                Next::Loop(false) => {
                    let end = loops.iter().find(|(start, _)| *start == line);
                    line = end.ok_or_else(|| wrong("this loop has no end".to_owned()))?.1 + 1;
                }
                Next::Again => {
                    let start = loops.iter().find(|(_, end)| *end == line);
                    line = start.ok_or_else(|| wrong("this loop has no beginning".to_owned()))?.0;
                }
                Next::Label(label) => {
                    let labelled = |text: &&str| **text == format!("N{label}");
                    let target = lines.iter().position(labelled);
                    let target = target.ok_or_else(|| wrong(format!("there is no N{label}")))?;
                    let inside = |line: usize| loops.iter().filter(move |(start, end)| (*start..=*end).contains(&line));
                    if inside(target).any(|entered| !inside(line).any(|around| around == entered)) {
                        return Err(wrong(format!("GOTO {label} jumps into a loop")));
                    }
                    line = target;
                }
            }
        }
        Err("the program does not end".to_owned())
    }

    fn variable(&self, number: u32) -> Result<f64, String> {
        let axis = |first: u32| ["X", "Y", "Z"][(number - first) as usize];
        match number {
            // A vacant variable counts as 0 in sums and in comparisons of size.
            1..=33 | 100..=999 => Ok(self.variables.get(&number).copied().unwrap_or(0.0)),
            5021..=5023 => self.machine.at(axis(5021)),
            // The work offset is zero.
            5041..=5043 => self.machine.at(axis(5041)),
            5061..=5063 => {
                let axis = axis(5061);
                self.skipped.get(axis).copied().ok_or_else(|| format!("nothing was skipped along {axis}"))
            }
            _ => Err(format!("#{number} is not known")),
        }
    }

    fn value(&self, text: &str) -> Result<f64, String> {
        let variable = |name: &str| {
            let number = name.strip_prefix('#').and_then(|number| number.parse().ok());
            self.variable(number.ok_or_else(|| format!("`{name}` is no variable"))?)
        };
        expression::value(text, ('[', ']'), &variable)
    }

    /// A condition in brackets, and what follows it.
    fn condition<'t>(&self, text: &'t str) -> Result<(bool, &'t str), String> {
        let text = text.trim();
        let mut depth = 0;
        let close = text.char_indices().find(|(_, letter)| {
            depth += match letter {
                '[' => 1,
                ']' => -1,
                _ => 0,
            };
            depth == 0
        });
        let (close, _) = close.filter(|_| text.starts_with('[')).ok_or_else(|| format!("`{text}` is no condition"))?;
        let inner = &text[1..close];
        for (word, holds) in
            [(" LT ", f64::lt as fn(&f64, &f64) -> bool), (" GE ", f64::ge), (" GT ", f64::gt), (" LE ", f64::le)]
        {
            if let Some((one, other)) = inner.split_once(word) {
                return Ok((holds(&self.value(one)?, &self.value(other)?), text[close + 1..].trim()));
            }
        }
        Err(format!("`{inner}` compares by a word that is not known"))
    }

    fn block(&mut self, text: &str) -> Result<Next, String> {
        if text.is_empty() || text == "%" || is_comment(text) {
            return Ok(Next::Line);
        }
        if let Some(rest) = text.strip_prefix("IF ") {
            let (holds, then) = self.condition(rest)?;
            if let Some(label) = then.strip_prefix("GOTO ") {
                let label = label.parse().map_err(|_| format!("`{label}` is no label"))?;
                return Ok(if holds { Next::Label(label) } else { Next::Line });
            }
            let then = then.strip_prefix("THEN ").filter(|then| then.starts_with('#'));
            let then = then.ok_or_else(|| format!("`{rest}` has neither GOTO nor THEN with an assignment"))?;
            return if holds { self.assign(then) } else { Ok(Next::Line) };
        }
        if let Some(rest) = text.strip_prefix("WHILE ") {
            return Ok(Next::Loop(self.condition(rest)?.0));
        }
        if text.strip_prefix("END").is_some_and(|number| number.len() == 1) {
            return Ok(Next::Again);
        }
        if let Some(rest) = text.strip_prefix('O') {
            let (number, comment) = rest.split_at(rest.find('(').unwrap_or(rest.len()));
            let known =
                number.len() == 4 && number.parse::<u32>().is_ok() && (comment.is_empty() || is_comment(comment));
            return if known { Ok(Next::Line) } else { Err(format!("`{text}` is no program number")) };
        }
        if text.starts_with('#') {
            return self.assign(text);
        }
        self.words(text)
    }

    fn assign(&mut self, text: &str) -> Result<Next, String> {
        let (name, value) = text.split_once('=').ok_or_else(|| format!("`{text}` assigns nothing"))?;
        let number: u32 = name[1..].parse().map_err(|_| format!("`{name}` is no variable"))?;
        match number {
            3000 | 3006 => {
                let (code, comment) = value.split_at(value.find('(').unwrap_or(value.len()));
                let code = code.parse().map_err(|_| format!("`{code}` is no alarm number"))?;
                if !is_comment(comment) || comment.len() > 28 {
                    return Err(format!("`{comment}` is no text of an alarm"));
                }
                let text = comment[1..comment.len() - 1].to_owned();
                if number == 3000 {
                    return Ok(Next::End(End::Alarm(code, text)));
                }
                self.machine.messages.push(text);
            }
            1..=33 | 100..=999 => {
                let value = self.value(value)?;
                self.variables.insert(number, value);
            }
            _ => return Err(format!("#{number} cannot be set")),
        }
        Ok(Next::Line)
    }

    fn words(&mut self, text: &str) -> Result<Next, String> {
        let (mut motion, mut target, mut feed) = (None, ByAxis::new(), None);
        for word in text.split(' ') {
            let (letter, number) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
            let number: f64 = number.parse().map_err(|_| format!("`{word}` is no word"))?;
            match (letter, word) {
                (_, "G0" | "G1" | "G31") => motion = Some(word),
                (_, "G21" | "G17" | "G40" | "G49" | "G80" | "G90" | "G94" | "G59" | "M19") => {}
                (_, "M30") => return Ok(Next::End(End::Done)),
                ("N", _) => {}
                ("F", _) if number > 0.0 => feed = Some(number),
                ("X" | "Y" | "Z" | "A" | "B" | "C", _) if word.contains('.') => {
                    target.insert(letter.to_owned(), number);
                }
                _ => return Err(format!("the word `{word}` is not known")),
            }
        }
        match motion {
            None if target.is_empty() => {}
            Some("G0") if feed.is_none() => self.machine.rapid(&target)?,
            Some("G1") if feed.is_some() => self.machine.feed(&target)?,
            Some("G31") if feed.is_some() => {
                self.machine.probe(&target)?;
                self.skipped = self.machine.positions.clone();
            }
            _ => return Err(format!("`{text}` moves in a way that is not known")),
        }
        Ok(Next::Line)
    }
}

/// Where the program goes on.
enum Next {
    Line,
    Label(u32),
    Loop(bool),
    Again,
    End(End),
}

fn is_comment(text: &str) -> bool {
    text.len() >= 2 && text.starts_with('(') && text.find(')') == Some(text.len() - 1) && !text[1..].contains('(')
}
