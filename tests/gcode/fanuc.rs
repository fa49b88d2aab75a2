//! The subset of Fanuc's Custom Macro B that our programs use: macros in one file, skip positions, DPRNT.

use std::collections::BTreeMap;

use super::{ByAxis, End, World, expression};

/// Blocks that a program may run before it is taken for endless.
const MOST: usize = 100_000;

/// Local variables of the arguments of `G65`, specification I.
const ARGUMENTS: [(&str, u32); 21] = [
    ("A", 1),
    ("B", 2),
    ("C", 3),
    ("I", 4),
    ("J", 5),
    ("K", 6),
    ("D", 7),
    ("E", 8),
    ("F", 9),
    ("H", 11),
    ("M", 13),
    ("Q", 17),
    ("R", 18),
    ("S", 19),
    ("T", 20),
    ("U", 21),
    ("V", 22),
    ("W", 23),
    ("X", 24),
    ("Y", 25),
    ("Z", 26),
];

/// Words that compare, with blanks around them.
const COMPARISONS: [&str; 6] = [" EQ ", " NE ", " LT ", " GE ", " GT ", " LE "];

/// Runs the first program of a file on common variables, which it changes; vacant ones are not in the map.
pub fn run(text: &str, common: &mut BTreeMap<u32, f64>, world: &mut dyn World) -> Result<End, String> {
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let mut programs = Vec::new();
    for (line, text) in lines.iter().enumerate() {
        if text.starts_with('O') || programs.is_empty() {
            programs.push(Program { first: line, lines: Vec::new(), loops: Vec::new() });
        }
        programs.last_mut().ok_or("no program")?.lines.push(text);
    }
    // What stands before the first number belongs to no program.
    if programs.len() > 1 && !programs[0].lines[0].starts_with('O') {
        let before = programs.remove(0);
        if before.lines != ["%"] {
            return Err("only `%` stands before the number of a program".to_owned());
        }
    }
    for program in &mut programs {
        program.loops = loops(program)?;
    }
    let mut state = State {
        programs: &programs,
        common: std::mem::take(common),
        local: vec![BTreeMap::new()],
        skipped: None,
        incremental: false,
        open: false,
        blocks: 0,
        world,
    };
    let end = programs.first().ok_or_else(|| "the file is empty".to_owned()).and_then(|first| state.run(first));
    *common = state.common;
    end?.ok_or_else(|| "M99 ends the main program".to_owned())
}

struct Program<'a> {
    /// Its place in the file.
    first: usize,
    lines: Vec<&'a str>,
    /// Lines of WHILE and END.
    loops: Vec<(usize, usize)>,
}

fn loops(program: &Program<'_>) -> Result<Vec<(usize, usize)>, String> {
    let (mut open, mut found) = (Vec::new(), Vec::new());
    for (line, text) in program.lines.iter().enumerate() {
        if text.starts_with("WHILE") {
            let number = text.rsplit("DO").next().unwrap_or_default();
            open.push((line, number.to_owned()));
        } else if let Some(number) = text.strip_prefix("END") {
            match open.pop() {
                Some((start, opened)) if opened == number && ["1", "2", "3"].contains(&number) => {
                    found.push((start, line));
                }
                _ => return Err(format!("line {}: `{text}` closes no loop", program.first + line + 1)),
            }
        }
    }
    if open.is_empty() { Ok(found) } else { Err("a loop stays open".to_owned()) }
}

struct State<'a> {
    programs: &'a [Program<'a>],
    common: BTreeMap<u32, f64>,
    /// Of the main program and of the macros that have been called.
    local: Vec<BTreeMap<u32, f64>>,
    /// Where the last G31 ended.
    skipped: Option<ByAxis>,
    incremental: bool,
    /// Whether POPEN has opened the line to the outside.
    open: bool,
    blocks: usize,
    world: &'a mut dyn World,
}

impl State<'_> {
    /// Runs a program to its end, or to the M99 that leads back.
    fn run(&mut self, program: &Program<'_>) -> Result<Option<End>, String> {
        let mut line = 0;
        loop {
            let Some(text) = program.lines.get(line) else { return Err("the program has no M30".to_owned()) };
            let wrong = |message: String| format!("line {}: {message}", program.first + line + 1);
            self.blocks += 1;
            if self.blocks > MOST {
                return Err("the program does not end".to_owned());
            }
            line = match self.block(text).map_err(wrong)? {
                Next::Line | Next::Loop(true) => line + 1,
                Next::End(end) => return Ok(Some(end)),
                Next::Back => return Ok(None),
                Next::Loop(false) => {
                    let end = program.loops.iter().find(|(start, _)| *start == line);
                    end.ok_or_else(|| wrong("this loop has no end".to_owned()))?.1 + 1
                }
                Next::Again => {
                    let start = program.loops.iter().find(|(_, end)| *end == line);
                    start.ok_or_else(|| wrong("this loop has no beginning".to_owned()))?.0
                }
                Next::Label(label) => jump(program, line, label).map_err(wrong)?,
            };
        }
    }

    fn variable(&self, number: u32) -> Result<f64, String> {
        let axis = |first: u32| ["X", "Y", "Z"][(number - first) as usize];
        match number {
            // A vacant variable counts as 0 in sums and in comparisons of size.
            1..=33 | 100..=199 | 500..=999 => Ok(self.stored(number).unwrap_or(0.0)),
            3001 => Ok(1000.0 * self.world.clock()),
            5021..=5023 => self.world.place(axis(5021)),
            // The work offset is zero.
            5041..=5043 => self.world.place(axis(5041)),
            5061..=5063 => {
                let axis = axis(5061);
                let skipped = self.skipped.as_ref().and_then(|skipped| skipped.get(axis));
                skipped.copied().ok_or_else(|| format!("nothing was skipped along {axis}"))
            }
            _ => Err(format!("#{number} is not known")),
        }
    }

    /// What a variable has; nothing if it is vacant.
    fn stored(&self, number: u32) -> Option<f64> {
        let home = if number <= 33 { self.local.last()? } else { &self.common };
        home.get(&number).copied()
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
        let word = COMPARISONS.iter().find(|word| inner.contains(*word));
        let word = word.ok_or_else(|| format!("`{inner}` compares by a word that is not known"))?;
        // A vacant variable is not equal to 0, but not less or greater.
        let mut names = inner.split('#').skip(1).filter_map(|rest| {
            rest.split(|letter: char| !letter.is_ascii_digit()).next().and_then(|number| number.parse::<u32>().ok())
        });
        if [" EQ ", " NE "].contains(word) && names.any(|number| number < 1000 && self.stored(number).is_none()) {
            return Err(format!("`{inner}` compares a vacant variable"));
        }
        Ok((self.value(inner)? != 0.0, text[close + 1..].trim()))
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
        if let Some(label) = text.strip_prefix("GOTO ") {
            return Ok(Next::Label(label.parse().map_err(|_| format!("`{label}` is no label"))?));
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
        if let Some(print) = text.strip_prefix("DPRNT[").and_then(|rest| rest.strip_suffix(']')) {
            let line = self.printed(print)?;
            return if self.open { self.world.log(line).map(|()| Next::Line) } else { Err("no POPEN".to_owned()) };
        }
        match text {
            "POPEN" | "PCLOS" => {
                self.open = text == "POPEN";
                Ok(Next::Line)
            }
            "M30" if self.open => Err("the line to the outside stays open".to_owned()),
            "M30" => Ok(Next::End(End::Done)),
            "M99" => Ok(Next::Back),
            _ if text.starts_with("G65 ") => self.call(text),
            _ => self.words(text).map(|()| Next::Line),
        }
    }

    fn assign(&mut self, text: &str) -> Result<Next, String> {
        let (name, value) = text.split_once('=').ok_or_else(|| format!("`{text}` assigns nothing"))?;
        let number: u32 = name[1..].parse().map_err(|_| format!("`{name}` is no variable"))?;
        match number {
            3000 | 3006 => {
                let (code, comment) = value.split_at(value.find('(').unwrap_or(value.len()));
                let code: u32 = code.parse().map_err(|_| format!("`{code}` is no alarm number"))?;
                if !is_comment(comment) || comment.len() > 28 || code > 200 {
                    return Err(format!("`{value}` is no number of an alarm with its text"));
                }
                let text = comment[1..comment.len() - 1].to_owned();
                if number == 3000 {
                    return Ok(Next::End(End::Alarm(code, text)));
                }
                self.world.message(&text);
            }
            1..=33 => {
                let value = self.value(value)?;
                self.local.last_mut().ok_or("no level")?.insert(number, value);
            }
            100..=199 | 500..=999 => {
                let value = self.value(value)?;
                self.common.insert(number, value);
            }
            _ => return Err(format!("#{number} cannot be set")),
        }
        Ok(Next::Line)
    }

    fn call(&mut self, text: &str) -> Result<Next, String> {
        let (mut number, mut local) = (None, BTreeMap::new());
        for word in text.split_whitespace().skip(1) {
            let (letter, value) = word.split_at(1);
            match ARGUMENTS.iter().find(|(known, _)| *known == letter) {
                _ if letter == "P" => number = Some(format!("O{value}")),
                // Without a point the control moves the point, by the letter.
                Some((_, place)) if value.contains('.') => drop(local.insert(*place, self.value(value)?)),
                _ => return Err(format!("`{word}` is no argument")),
            }
        }
        let number = number.ok_or("no program")?;
        let programs = self.programs;
        let program = programs.iter().find(|program| program.lines[0].split('(').next() == Some(number.as_str()));
        self.local.push(local);
        let end = self.run(program.ok_or_else(|| format!("there is no program {number}"))?)?;
        self.local.pop();
        Ok(end.map_or(Next::Line, Next::End))
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
                let number = format!("{:.decimals$}", self.value(name)?);
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
            let (letter, number) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
            // A number without a point may be one of thousandths.
            let has_point = number.contains('.') || number.contains('#');
            match (letter, word) {
                (_, "G0" | "G1" | "G31" | "G4") => motion = Some(word),
                (_, "G90") => self.incremental = false,
                (_, "G91") => self.incremental = true,
                (_, "G20") => self.world.unit(25.4)?,
                (_, "G21") => self.world.unit(1.0)?,
                (_, "G17" | "G40" | "G49" | "G80" | "G94" | "G59" | "M19") => {}
                // Without a point it is milliseconds, on Fanuc and on Haas.
                ("P", _) if motion == Some("G4") && !number.contains('.') => {
                    self.world.wait(self.value(number)? / 1e3);
                    return Ok(());
                }
                ("N", _) if number.parse::<u32>().is_ok() => {}
                ("F", _) => feed = Some(self.value(number)?).filter(|feed| *feed > 0.0),
                ("X" | "Y" | "Z" | "A" | "B" | "C", _) if has_point => {
                    target.insert(letter.to_owned(), self.value(number)?);
                }
                _ => return Err(format!("the word `{word}` is not known")),
            }
        }
        if self.incremental {
            for (axis, value) in &mut target {
                *value += self.world.place(axis)?;
            }
        }
        match (motion, feed) {
            (None, None) if target.is_empty() => Ok(()),
            (Some("G0"), None) => self.world.rapid(&target),
            (Some("G1"), Some(feed)) => self.world.feed(&target, feed),
            (Some("G31"), Some(feed)) => {
                self.world.probe(&target, feed)?;
                let places = ["X", "Y", "Z"].map(|axis| Some((axis.to_owned(), self.world.place(axis).ok()?)));
                self.skipped = Some(places.into_iter().flatten().collect());
                Ok(())
            }
            _ => Err(format!("`{text}` moves in a way that is not known")),
        }
    }
}

/// The line of a label, which is none within a loop that the program is not in.
fn jump(program: &Program<'_>, line: usize, label: u32) -> Result<usize, String> {
    let target = program.lines.iter().position(|text| *text == format!("N{label}"));
    let target = target.ok_or_else(|| format!("there is no N{label}"))?;
    let inside = |line: usize| program.loops.iter().filter(move |(start, end)| (*start..=*end).contains(&line));
    if inside(target).any(|entered| !inside(line).any(|around| around == entered)) {
        return Err(format!("GOTO {label} jumps into a loop"));
    }
    Ok(target)
}

/// Where the program goes on.
enum Next {
    Line,
    Label(u32),
    Loop(bool),
    Again,
    Back,
    End(End),
}

fn is_comment(text: &str) -> bool {
    text.len() >= 2
        && text.starts_with('(')
        && text.find(')') == Some(text.len() - 1)
        && !text[1..].contains('(')
        && text == text.to_uppercase()
}
