//! The subset of the SINUMERIK language that our programs use: subprograms with parameters, MEAS, WRITE.

use std::collections::{BTreeMap, BTreeSet};

use super::{ByAxis, End, World, expression};

/// Blocks that a program may run before it is taken for endless.
const MOST: usize = 100_000;

/// Runs one of several programs, which have names without endings, on R parameters, which it changes; those that were never set are 0.
pub fn run_among(
    programs: &BTreeMap<String, String>,
    name: &str,
    parameters: &mut BTreeMap<u32, f64>,
    world: &mut dyn World,
) -> Result<End, String> {
    let parsed: Result<BTreeMap<&str, Program<'_>>, String> =
        programs.iter().map(|(name, text)| Ok((name.as_str(), Program::parse(name, text)?))).collect();
    let mut state = State {
        programs: &parsed?,
        parameters: std::mem::take(parameters),
        world,
        measured: None,
        waited: true,
        alarm: None,
        message: String::new(),
        blocks: 0,
    };
    let end = state.run(name, &[]);
    *parameters = state.parameters;
    end?.ok_or_else(|| "M17 ends the main program".to_owned())
}

/// The same of a program that calls no other.
pub fn run(text: &str, parameters: &mut BTreeMap<u32, f64>, world: &mut dyn World) -> Result<End, String> {
    run_among(&[("MAIN".to_owned(), text.to_owned())].into(), "MAIN", parameters, world)
}

struct Program<'a> {
    lines: Vec<&'a str>,
    /// Names of its parameters.
    takes: Vec<&'a str>,
    blocks: Vec<Block>,
}

/// Lines that open and close a block, and its ELSE.
struct Block {
    open: usize,
    other: Option<usize>,
    close: usize,
}

/// The words that open and close blocks.
const PAIRS: [(&str, &str); 3] = [("IF", "ENDIF"), ("WHILE", "ENDWHILE"), ("LOOP", "ENDLOOP")];

fn first_word(text: &str) -> &str {
    text.split([' ', '(']).next().unwrap_or_default()
}

impl<'a> Program<'a> {
    fn parse(name: &str, text: &'a str) -> Result<Self, String> {
        let lines: Vec<&str> = text.lines().map(|line| line.split(';').next().unwrap_or_default().trim()).collect();
        let head = lines.first().and_then(|line| line.strip_prefix("PROC "));
        let takes = match head.map(|head| head.strip_prefix(name)) {
            None | Some(Some("")) => Vec::new(),
            Some(Some(rest)) => {
                let inner = rest.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')).ok_or("PROC stays open")?;
                let typed = |each: &'a str| each.strip_prefix("INT ").or_else(|| each.strip_prefix("REAL "));
                let names: Option<Vec<&str>> = inner.split(',').map(typed).collect();
                names.ok_or_else(|| format!("{name}: a parameter has no type"))?
            }
            Some(None) => return Err(format!("{name} begins with the PROC of another name")),
        };
        Ok(Self { blocks: blocks(&lines).map_err(|error| format!("{name} {error}"))?, lines, takes })
    }
}

fn blocks(lines: &[&str]) -> Result<Vec<Block>, String> {
    let (mut open, mut found) = (Vec::new(), Vec::new());
    for (line, text) in lines.iter().enumerate() {
        let wrong = || format!("line {}: `{text}` belongs to no block", line + 1);
        if let Some((_, close)) = PAIRS.iter().find(|(opens, _)| first_word(text) == *opens) {
            open.push((line, *close, None));
        } else if *text == "ELSE" {
            match open.last_mut() {
                Some((_, "ENDIF", other @ None)) => *other = Some(line),
                _ => return Err(wrong()),
            }
        } else if PAIRS.iter().any(|(_, close)| text == close) {
            match open.pop() {
                Some((start, close, other)) if close == *text => {
                    found.push(Block { open: start, other, close: line });
                }
                _ => return Err(wrong()),
            }
        }
    }
    if open.is_empty() { Ok(found) } else { Err("a block stays open".to_owned()) }
}

/// What a program has of its own while it runs.
#[derive(Default)]
struct Local {
    variables: BTreeMap<String, f64>,
    /// Programs with parameters that it has made known.
    known: BTreeSet<String>,
    /// Whether a block moved: declarations come before.
    moved: bool,
}

struct State<'a> {
    programs: &'a BTreeMap<&'a str, Program<'a>>,
    parameters: BTreeMap<u32, f64>,
    world: &'a mut dyn World,
    /// Whether the last measuring block triggered, and where.
    measured: Option<(bool, ByAxis)>,
    /// Whether reading waited for the last move.
    waited: bool,
    alarm: Option<u32>,
    message: String,
    blocks: usize,
}

impl State<'_> {
    /// Runs a program to its end, or to the M17 that leads back.
    fn run(&mut self, name: &str, arguments: &[f64]) -> Result<Option<End>, String> {
        let programs = self.programs;
        let program = programs.get(name).ok_or_else(|| format!("there is no program {name}"))?;
        if program.takes.len() != arguments.len() {
            return Err(format!("{name} takes {} values", program.takes.len()));
        }
        let variables = program.takes.iter().map(|name| (*name).to_owned()).zip(arguments.iter().copied()).collect();
        let mut local = Local { variables, ..Local::default() };
        let mut line = 0;
        loop {
            let Some(&text) = program.lines.get(line) else { return Err(format!("{name} has no M30 and no M17")) };
            let wrong = |message: String| format!("{name} line {}: {message}", line + 1);
            self.blocks += 1;
            if self.blocks > MOST {
                return Err("the program does not end".to_owned());
            }
            let opened = program.blocks.iter().find(|block| block.open == line);
            let closed = program.blocks.iter().find(|block| block.close == line || block.other == Some(line));
            line = match (first_word(text), opened, closed) {
                ("IF" | "WHILE", Some(block), _) => {
                    let condition = text.split_once(' ').map(|(_, condition)| condition).unwrap_or_default();
                    let holds = self.condition(condition, &local).map_err(wrong)?;
                    if holds { line + 1 } else { block.other.unwrap_or(block.close) + 1 }
                }
                ("LOOP", Some(_), _) | ("ENDIF", _, Some(_)) => line + 1,
                ("ELSE", _, Some(block)) => block.close + 1,
                ("ENDWHILE" | "ENDLOOP", _, Some(block)) => block.open,
                ("PROC", ..) if line == 0 => line + 1,
                _ => match self.block(text, &mut local).map_err(wrong)? {
                    Next::Line => line + 1,
                    Next::Back => return Ok(None),
                    Next::End(end) => return Ok(Some(end)),
                },
            };
        }
    }

    fn value(&self, text: &str, local: &Local) -> Result<f64, String> {
        let variable = |name: &str| if name.starts_with('$') { self.system(name) } else { self.variable(name, local) };
        expression::value(text, ('(', ')'), &variable)
    }

    fn variable(&self, name: &str, local: &Local) -> Result<f64, String> {
        if let Some(number) = parameter(name) {
            return Ok(self.parameters.get(&number).copied().unwrap_or(0.0));
        }
        local.variables.get(name).copied().ok_or_else(|| format!("`{name}` is not known"))
    }

    fn system(&self, name: &str) -> Result<f64, String> {
        let clock = self.world.clock();
        match name {
            "$A_DAY" => return Ok(1.0 + (clock / 86400.0).floor()),
            "$A_HOUR" => return Ok((clock / 3600.0).floor() % 24.0),
            "$A_MINUTE" => return Ok((clock / 60.0).floor() % 60.0),
            "$A_SECOND" => return Ok(clock.floor() % 60.0),
            _ => {}
        }
        if !self.waited {
            return Err(format!("`{name}` is read without STOPRE before it"));
        }
        let axis = |of: &str| name.strip_prefix(of).and_then(|rest| rest.strip_suffix(']'));
        if let Some(axis) = axis("$AA_IM[") {
            return self.world.place(axis);
        }
        let measured = self.measured.as_ref();
        let (triggered, at) = measured.ok_or_else(|| format!("`{name}` is read without a measurement"))?;
        match axis("$AA_MM[") {
            Some(axis) => at.get(axis).copied().ok_or_else(|| format!("there is no axis {axis}")),
            None if name == "$AC_MEA[1]" => Ok(f64::from(u8::from(*triggered))),
            None => Err(format!("`{name}` is not known")),
        }
    }

    fn condition(&self, text: &str, local: &Local) -> Result<bool, String> {
        if !text.contains('<') && !text.contains(">=") {
            return Err(format!("`{text}` compares in a way that is not known"));
        }
        Ok(self.value(text, local)? != 0.0)
    }

    fn block(&mut self, text: &str, local: &mut Local) -> Result<Next, String> {
        match text {
            "" | "TRAFOOF" | "D0" => return Ok(Next::Line),
            "M30" => return Ok(Next::End(End::Done)),
            "M17" => return Ok(Next::Back),
            // After an alarm the program stands here until reset.
            "M0" => {
                let alarm = self.alarm.map(|number| End::Alarm(number, self.message.clone()));
                return Ok(alarm.map_or(Next::Line, Next::End));
            }
            "STOPRE" => {
                self.waited = true;
                return Ok(Next::Line);
            }
            _ => {}
        }
        if let Some(rest) = text.strip_prefix("DEF REAL ").or_else(|| text.strip_prefix("DEF INT ")) {
            let (name, value) = rest.split_once('=').ok_or_else(|| format!("`{rest}` has no value"))?;
            if local.moved || parameter(name).is_some() || name.len() > 31 {
                return Err(format!("`{text}` cannot stand here"));
            }
            let value = self.value(value, local)?;
            local.variables.insert(name.to_owned(), value);
        } else if let Some(rest) = text.strip_prefix("EXTERN ") {
            if local.moved {
                return Err(format!("`{text}` cannot stand here"));
            }
            let name = first_word(rest);
            let takes = self.programs.get(name).map(|program| program.takes.len());
            if takes != Some(rest.matches(',').count() + 1) {
                return Err(format!("{name} takes other values"));
            }
            local.known.insert(name.to_owned());
        } else if let Some(message) = text.strip_prefix("MSG(\"").and_then(|rest| rest.strip_suffix("\")")) {
            self.message = message.to_owned();
            self.world.message(message);
        } else if let Some(number) = text.strip_prefix("SETAL(").and_then(|rest| rest.strip_suffix(')')) {
            let number: u32 = number.parse().map_err(|_| format!("`{number}` is no alarm"))?;
            if !(65000..=69999).contains(&number) {
                return Err(format!("{number} is no alarm of the user"));
            }
            self.alarm = Some(number);
        } else if let Some(rest) = text.strip_prefix("WRITE(").and_then(|rest| rest.strip_suffix(')')) {
            self.write(rest, local)?;
        } else if self.programs.contains_key(first_word(text)) {
            return self.call(text, local);
        } else {
            let home = text.split_once('=').filter(|(name, _)| !name.contains(' ') && !["SPOS", "MEAS"].contains(name));
            let Some((name, value)) = home else { return self.words(text, local).map(|()| Next::Line) };
            let value = self.value(value, local)?;
            match parameter(name) {
                Some(number) => drop(self.parameters.insert(number, value)),
                None => {
                    self.variable(name, local)?;
                    local.variables.insert(name.to_owned(), value);
                }
            }
        }
        Ok(Next::Line)
    }

    /// A line of a file: texts and values, put together by `<<`.
    fn write(&mut self, text: &str, local: &Local) -> Result<(), String> {
        let mut parts = text.splitn(3, ',');
        let (error, file, parts) = (parts.next().unwrap_or_default(), parts.next(), parts.next().ok_or("no line")?);
        self.variable(error, local)?;
        if !file.is_some_and(|file| file.len() > 2 && file.starts_with('"') && file.ends_with('"')) {
            return Err(format!("`{text}` names no file"));
        }
        let mut line = String::new();
        for part in parts.split("<<") {
            match part.strip_prefix('"').and_then(|part| part.strip_suffix('"')) {
                Some(text) => line.push_str(text),
                None => line.push_str(&self.value(part, local)?.to_string()),
            }
        }
        self.world.log(line)
    }

    fn call(&mut self, text: &str, local: &Local) -> Result<Next, String> {
        let name = first_word(text);
        let values = match &text[name.len()..] {
            "" => Vec::new(),
            rest if local.known.contains(name) => {
                let inner =
                    rest.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')).ok_or("a call stays open")?;
                inner.split(',').map(|value| self.value(value, local)).collect::<Result<Vec<_>, _>>()?
            }
            _ => return Err(format!("{name} is not made known by EXTERN")),
        };
        Ok(self.run(name, &values)?.map_or(Next::Line, Next::End))
    }

    fn words(&mut self, text: &str, local: &mut Local) -> Result<(), String> {
        local.moved = true;
        let (mut motion, mut target, mut feed) = (None, ByAxis::new(), None);
        let (mut measures, mut machine) = (false, false);
        for word in text.split_whitespace() {
            match word {
                "G0" | "G1" | "G4" => motion = Some(word),
                "SUPA" => machine = true,
                "MEAS=1" => measures = true,
                "G710" => self.world.unit(1.0)?,
                "G700" => self.world.unit(25.4)?,
                "G17" | "G40" | "G90" | "G94" => {}
                _ if word.starts_with("SPOS=") => drop(self.value(&word[5..], local)?),
                _ if word.starts_with('F') => {
                    feed = Some(self.value(&word[1..], local)?).filter(|feed| *feed > 0.0);
                }
                _ => {
                    let (axis, at) = word.split_once('=').ok_or_else(|| format!("the word `{word}` is not known"))?;
                    if !["X", "Y", "Z", "A", "B", "C"].contains(&axis) {
                        return Err(format!("the word `{word}` is not known"));
                    }
                    let to = match at.strip_prefix("IC") {
                        Some(by) => self.world.place(axis)? + self.value(by, local)?,
                        None => self.value(at, local)?,
                    };
                    target.insert(axis.to_owned(), to);
                }
            }
        }
        let still = target.is_empty();
        if !still {
            self.waited = false;
        }
        match (motion, measures, feed) {
            (None, false, None) if still => Ok(()),
            (Some("G4"), false, Some(seconds)) if still => {
                self.world.wait(seconds);
                Ok(())
            }
            _ if !machine => Err(format!("`{text}` does not suppress the offsets")),
            (Some("G0"), false, None) => self.world.rapid(&target),
            (Some("G1"), false, Some(feed)) => self.world.feed(&target, feed),
            (Some("G1"), true, Some(feed)) => {
                let triggered = self.world.probe(&target, feed)?;
                let places = ["X", "Y", "Z", "A", "B", "C"];
                let places = places.map(|axis| Some((axis.to_owned(), self.world.place(axis).ok()?)));
                self.measured = Some((triggered, places.into_iter().flatten().collect()));
                Ok(())
            }
            _ => Err(format!("`{text}` moves in a way that is not known")),
        }
    }
}

/// Where the program goes on.
enum Next {
    Line,
    Back,
    End(End),
}

/// The number of an R parameter.
fn parameter(name: &str) -> Option<u32> {
    name.strip_prefix('R')?.parse().ok()
}
