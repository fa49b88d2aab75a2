//! Heidenhain plain text (Klartext): blocks as moves.
//!
//! Facts are those of Heidenhain's manuals of the TNC 360 to 640: coordinates of CC count from the workpiece datum,
//! incremental ones from the last programmed position; a helix is programmed in polar coordinates only; M91 leaves out
//! the length of the tool and acts in its block; M128 acts at the start of its block, M129 at its end; the length is L
//! and DL from the tool call on.

mod table;
mod tool;
mod words;
mod write;

use crate::block::{Action, Reader, named};
use crate::geometry::place;
use crate::lexer::{Line, Sense, Word};
use crate::machine::Space;
use crate::modal::{Motion, Said, Special, refused};
use crate::plan::Moved;
use crate::refusal::Refusal;
use table::{Effect, Statement};
use words::{Cursor, Frame};

pub(crate) use table::table;
pub(crate) use write::{Numbers, write};

/// A program in plain text.
#[derive(Default)]
pub(crate) struct Program {
    pub(crate) has_ended: bool,
    pub(crate) has_begun: bool,
    /// The circle centre, machine coordinates in the plane of the tool axis.
    pole: Option<[f64; 2]>,
    /// A statement that goes on in the next line.
    open: Option<Statement>,
    /// The length of the tool without DL, if one was called.
    length: Option<f64>,
    /// Whether the tip is programmed by `FUNCTION TCPM`, and not by M128.
    is_function: bool,
}

/// What M functions of a block do to its motion, by their word.
#[derive(Default)]
struct Effects {
    late: Vec<usize>,
    machine: Option<Word>,
    other_datum: Option<Word>,
    tip_off: Option<Word>,
    change: Option<Word>,
    ends_shorter_way: bool,
}

impl Program {
    /// Understands a line.
    pub(crate) fn line(&mut self, text: &[u8], reader: &mut Reader<'_>) -> Result<Action, Refusal> {
        let frame = words::frame(text);
        let own = text[frame.block.clone()].to_ascii_uppercase();
        if let Some(open) = self.open.take() {
            self.open = Some(open).filter(|_| frame.is_open);
            check_continued(text, &frame, &own)?;
            return match open {
                Statement::Preset => self.preset(text, &frame, reader),
                _ => Ok(Action::Copy(None)),
            };
        }
        if own.is_empty() || reader.is_left_out(frame.optional)? {
            return Ok(Action::Copy(None));
        }
        let cursor = Cursor::new(text, frame.block.clone());
        let start = frame.block.start;
        let found = match table::statement(&own) {
            Some(found) => found,
            None if own[0] == b'M' => (0, Statement::Auxiliary),
            None => return Err(unknown(&cursor, &own)),
        };
        let (length, statement) = found;
        if !self.has_begun && statement != Statement::Begin {
            return Err(cursor.refused(
                start,
                "a program begins with `BEGIN PGM`",
                "write `BEGIN PGM name MM` before it",
            ));
        }
        reader.has_block |= !matches!(statement, Statement::Begin | Statement::End);
        if frame.is_open && !matches!(statement, Statement::Keep | Statement::Preset | Statement::Refuse(..)) {
            let place = text.iter().rposition(|byte| *byte == b'~').unwrap_or(start);
            let help = "write the block in one line";
            return Err(Refusal::new(place, "~", "a block that goes on in the next line", help));
        }
        self.open = Some(statement).filter(|_| frame.is_open);
        let rest = Cursor::new(text, start + length..frame.block.end);
        match statement {
            Statement::Keep => Ok(Action::Copy(None)),
            Statement::Refuse(what, help) => {
                let shown = String::from_utf8_lossy(&own[..length]);
                Err(Refusal::new(start, &shown, what, help))
            }
            Statement::Begin => {
                reader.modal.inches = match own.split(u8::is_ascii_whitespace).next_back() {
                    Some(b"MM") => false,
                    Some(b"INCH") => true,
                    _ => {
                        return Err(cursor.refused(
                            start,
                            "a program without a unit",
                            "write `BEGIN PGM name MM`, or INCH",
                        ));
                    }
                };
                // Centres are written as absolute coordinates.
                (self.has_begun, reader.modal.has_unit, reader.modal.arc_absolute) = (true, true, true);
                Ok(Action::Copy(None))
            }
            Statement::End => {
                self.has_ended = true;
                Ok(Action::Copy(None))
            }
            Statement::Line | Statement::Arc | Statement::RadiusArc | Statement::Auxiliary => {
                self.block(statement, rest, &frame, start..start + length, reader)
            }
            Statement::Centre => self.centre(rest, reader),
            Statement::ToolCall => self.tool_call(rest, start, reader),
            Statement::ToolDefinition => tool::definition(rest, start),
            Statement::Shift => self.shift(rest, start, reader),
            Statement::Preset => self.preset(text, &frame, reader),
            Statement::TipOn => {
                check_tip_function(&own[length..], &cursor, start + length)?;
                self.tip(true, true, &head(start..start + length, &own), reader)?;
                Ok(Action::Copy(None))
            }
            Statement::TipOff => {
                self.tip(false, true, &head(start..start + length, &own), reader)?;
                Ok(Action::Copy(None))
            }
        }
    }

    /// A positioning block, or M functions alone.
    fn block(
        &mut self,
        statement: Statement,
        mut cursor: Cursor<'_>,
        frame: &Frame,
        begins: std::ops::Range<usize>,
        reader: &mut Reader<'_>,
    ) -> Result<Action, Refusal> {
        let start = begins.start;
        let name = match statement {
            Statement::Line => "L",
            Statement::Arc => "C",
            Statement::RadiusArc => "CR",
            _ => "",
        };
        let mut line = Line { words: vec![head(begins, name.as_bytes())], optional: frame.optional, ..Line::default() };
        while let Some(word) = cursor.next()? {
            line.words.push(word);
        }
        check_words(statement, &line.words)?;
        let effects = self.effects(&line, reader)?;
        let axes = line.words.iter().find(|word| place(word.letter).is_some());
        let action = match axes {
            Some(word) if effects.change.is_some() && !reader.options.stays_at_tool_change => {
                let help = "write M6 in a block of its own; or say `--tool-change stays` if no axis moves for it";
                return Err(refused(word, "a move beside a change of the tool", help));
            }
            Some(_) if effects.machine.is_some() || effects.other_datum.is_some() => {
                machine_block(statement, &line, &effects, reader)?;
                reader.jump(None, true, Moved::to(named(&line)))
            }
            Some(_) => self.moved(statement, line, effects.late, reader)?,
            None if matches!(statement, Statement::Arc | Statement::RadiusArc) => {
                return Err(cursor.refused(
                    start,
                    "an arc without an end",
                    "write its end, in the plane of the tool axis",
                ));
            }
            None if effects.change.is_some() && !reader.options.stays_at_tool_change => {
                reader.modal.at = [None; 9];
                reader.jump(None, false, [Moved::To; 9])
            }
            None => Action::Copy(None),
        };
        reader.modal.takes_shorter_way &= !effects.ends_shorter_way;
        if let Some(word) = effects.tip_off {
            self.tip(false, false, &word, reader)?;
        }
        Ok(action)
    }

    /// What M functions do; those that act at the start of the block are carried out.
    fn effects(&mut self, line: &Line, reader: &mut Reader<'_>) -> Result<Effects, Refusal> {
        let mut found = Effects::default();
        for (index, word) in line.words.iter().enumerate().filter(|(_, word)| word.letter == b'M') {
            let Some((is_late, effect)) = table::auxiliary(word.value as u32) else {
                return Err(refused(
                    word,
                    "an M function that is not known",
                    "see docs/programs.md for those that are",
                ));
            };
            if is_late {
                found.late.push(index);
            }
            match effect {
                Effect::Keep => {}
                Effect::ShorterWay(true) => reader.modal.takes_shorter_way = true,
                Effect::ShorterWay(false) => found.ends_shorter_way = true,
                Effect::End => self.has_ended = true,
                Effect::ToolChange => found.change = Some(word.clone()),
                Effect::Machine => found.machine = Some(word.clone()),
                Effect::OtherDatum => found.other_datum = Some(word.clone()),
                Effect::TipOn => self.tip(true, false, word, reader)?,
                Effect::TipOff => found.tip_off = Some(word.clone()),
                Effect::Refuse(what, help) => return Err(refused(word, what, help)),
            }
        }
        Ok(found)
    }

    fn moved(
        &mut self,
        statement: Statement,
        mut line: Line,
        late: Vec<usize>,
        reader: &mut Reader<'_>,
    ) -> Result<Action, Refusal> {
        let ends = |word: &&Word| word.sense == Sense::Relative;
        let endless =
            |word: &&Word| place(word.letter).is_some_and(|axis| reader.modal.machine.is_endless(axis)) && ends(word);
        if let Some(word) = line.words.iter().find(endless) {
            return Err(refused(word, "a relative move of an axis without ends", "write the position itself"));
        }
        let motion = match statement {
            Statement::Line if line.words.iter().any(|word| word.name == "FMAX") => Motion::Rapid,
            Statement::Line => Motion::Feed,
            _ => self.arc(statement, &mut line, reader)?,
        };
        reader.modal.motion = Some(motion);
        let said = Said { special: Special::None, motion_word: Some(0), is_end: false, late };
        reader.motion(line, said, motion)
    }

    /// The sense of an arc. Its centre becomes words without text.
    fn arc(&self, statement: Statement, line: &mut Line, reader: &mut Reader<'_>) -> Result<Motion, Refusal> {
        let plane = reader.modal.plane;
        let outside = |word: &&Word| place(word.letter).is_some_and(|axis| !plane.contains(&axis));
        if let Some(word) = line.words.iter().find(outside) {
            let what = "a coordinate of an arc outside of the plane of the tool axis";
            return Err(refused(word, what, "write a helix, or an arc in another plane, as lines"));
        }
        let Some(sense) = line.words.iter().find(|word| word.name == "DR").map(|word| word.value) else {
            return Err(refused(&line.words[0], "an arc without a sense of rotation", "write DR+ or DR-"));
        };
        let has_radius = line.words.iter().any(|word| word.letter == b'R');
        match (statement, has_radius, self.pole) {
            (Statement::RadiusArc, false, _) => {
                return Err(refused(&line.words[0], "an arc without a radius", "write R"));
            }
            (Statement::RadiusArc, true, _) => {}
            (_, _, None) => {
                return Err(refused(
                    &line.words[0],
                    "an arc without a centre",
                    "write CC after the last change of coordinates",
                ));
            }
            (_, _, Some(pole)) => {
                let offset = reader.modal.offset();
                let end = line.words[0].span.start;
                for (axis, at) in plane.into_iter().zip(pole) {
                    let value = (at - offset[axis]) / reader.modal.unit(axis);
                    line.words.push(Word {
                        letter: b'I' + axis as u8,
                        name: String::new(),
                        value,
                        sense: Sense::Absolute,
                        has_point: true,
                        span: end..end,
                    });
                }
            }
        }
        Ok(if sense > 0.0 { Motion::CounterClockwise } else { Motion::Clockwise })
    }

    /// `CC X+5 Y-2`, or `CC` alone: where the tool stands.
    fn centre(&mut self, mut cursor: Cursor<'_>, reader: &mut Reader<'_>) -> Result<Action, Refusal> {
        let start = cursor.at;
        let modal = &mut reader.modal;
        let (plane, offset) = (modal.plane, modal.offset());
        let mut found = [None; 2];
        while let Some(word) = cursor.next()? {
            let own = place(word.letter).and_then(|axis| plane.iter().position(|other| *other == axis));
            let Some(own) = own else {
                let help = "write its coordinates in the plane of the tool axis; other arcs as lines";
                return Err(refused(&word, "it is not in the plane of the tool axis", help));
            };
            let by = word.value * modal.unit(plane[own]);
            let base = if word.sense == Sense::Relative { modal.at[plane[own]] } else { Some(offset[plane[own]]) };
            let Some(base) = base else {
                return Err(refused(&word, "it counts from a position that is not known", "write it without I"));
            };
            if found[own].replace(base + by).is_some() {
                return Err(refused(&word, "a letter that stands twice in a block", "leave one of them out"));
            }
        }
        if found == [None; 2] {
            found = plane.map(|axis| modal.at[axis]);
        }
        let help = "write both of its coordinates";
        let [Some(first), Some(second)] = found else {
            return Err(Refusal::new(start.saturating_sub(2), "CC", "a centre that is not known", help));
        };
        self.pole = Some([first, second]);
        Ok(Action::Copy(None))
    }

    /// `CYCL DEF 7.1 X+60`.
    fn shift(&mut self, mut cursor: Cursor<'_>, start: usize, reader: &mut Reader<'_>) -> Result<Action, Refusal> {
        cursor.takes(b".");
        if cursor.number(start)? == 0.0 {
            return Ok(Action::Copy(None));
        }
        while let Some(word) = cursor.next()? {
            let Some(axis) = place(word.letter).filter(|axis| !crate::geometry::is_rotary(*axis)) else {
                let what = "a datum shift that is not followed";
                return Err(refused(&word, what, "shift X, Y, Z, U, V and W; the others by `--offset`"));
            };
            let value = word.value * reader.modal.unit(axis);
            let base = if word.sense == Sense::Relative { reader.modal.shift[axis] } else { 0.0 };
            reader.modal.shift[axis] = base + value;
            self.pole = None;
        }
        Ok(Action::Copy(None))
    }

    /// `CYCL DEF 247 .. Q339=+1`: preset 1 is the first of `--offset`.
    fn preset(&mut self, text: &[u8], frame: &Frame, reader: &mut Reader<'_>) -> Result<Action, Refusal> {
        let own = text[frame.block.clone()].to_ascii_uppercase();
        let help = "write `Q339=` with a preset from 1 to 9, which are `--offset G54` to `G59.3`";
        let Some(at) = own.windows(5).position(|window| window == b"Q339=") else {
            return match frame.is_open {
                true => Ok(Action::Copy(None)),
                false => Err(Refusal::new(frame.block.start, "CYCL DEF 247", "a preset without its number", help)),
            };
        };
        let from = frame.block.start + at;
        let mut cursor = Cursor::new(text, from + 5..frame.block.end);
        let number = cursor.number(from + 5)?;
        if number.fract() != 0.0 || !(1.0..=9.0).contains(&number) {
            return Err(cursor.refused(from, "a preset that is not known here", help));
        }
        reader.modal.system = Some(number as usize - 1);
        reader.modal.shift = [0.0; 9];
        self.pole = None;
        self.open = Some(Statement::Keep).filter(|_| frame.is_open);
        Ok(Action::Copy(None))
    }

    /// Switches between positions of the axes and of the tip.
    fn tip(&mut self, on: bool, by_function: bool, word: &Word, reader: &mut Reader<'_>) -> Result<(), Refusal> {
        let is_on = reader.modal.space == Space::Workpiece;
        if is_on && self.is_function != by_function {
            let own = if self.is_function { "FUNCTION RESET TCPM" } else { "M129" };
            let help = format!("switch it off before: {own}");
            return Err(refused(word, "the tip is programmed by another function", &help));
        }
        if on != is_on {
            self.pole = None;
            self.is_function = by_function;
            reader.modal.set_centre(on, word)?;
        }
        Ok(())
    }
}

/// Refuses a line that is a block by itself where the one before says that it goes on: nothing of it would be read.
fn check_continued(text: &[u8], frame: &Frame, own: &[u8]) -> Result<(), Refusal> {
    let is_block = table::statement(own).is_some_and(|(_, statement)| !matches!(statement, Statement::Refuse(..)))
        || own.first() == Some(&b'M');
    if own.is_empty() || !(is_block || frame.number.is_some()) {
        return Ok(());
    }
    let word = String::from_utf8_lossy(&text[frame.block.clone()]);
    let word = word.split_whitespace().next().unwrap_or_default();
    let what = "a block where the one before goes on";
    Err(Refusal::new(frame.block.start, word, what, "write no `~` at the end of the line before"))
}

/// Refuses words that a block cannot have, and those that stand twice.
fn check_words(statement: Statement, words: &[Word]) -> Result<(), Refusal> {
    for (index, word) in words.iter().enumerate().skip(1) {
        let again = |other: &Word| other.letter == word.letter && other.name == word.name;
        if word.letter != b'M' && words[1..index].iter().any(again) {
            return Err(refused(word, "a letter that stands twice in a block", "leave one of them out"));
        }
        let is_known = match (word.letter, word.name.as_str()) {
            (b'R', _) => statement == Statement::RadiusArc,
            (_, "DR") => matches!(statement, Statement::Arc | Statement::RadiusArc),
            (b'M', _) => true,
            _ => statement != Statement::Auxiliary,
        };
        if !is_known {
            return Err(refused(word, "a word that this block cannot have", "leave it out, or write L before it"));
        }
    }
    Ok(())
}

/// Positions of the machine: M91 leaves out datum and tool; where M92 counts from nobody tells.
fn machine_block(statement: Statement, line: &Line, effects: &Effects, reader: &mut Reader<'_>) -> Result<(), Refusal> {
    let word = effects.machine.as_ref().or(effects.other_datum.as_ref()).unwrap_or(&line.words[0]);
    if statement != Statement::Line {
        return Err(refused(word, "an arc in machine coordinates", "write it as lines"));
    }
    if let Some(word) = line.words.iter().find(|word| word.sense == Sense::Relative) {
        return Err(refused(word, "a relative position in machine coordinates", "write the position itself"));
    }
    reader.machine_block(line)?;
    if effects.other_datum.is_some() {
        let named = line.words.iter().filter_map(|word| place(word.letter));
        named.for_each(|axis| reader.modal.at[axis] = None);
    }
    Ok(())
}

/// `F TCP AXIS POS PATHCTRL AXIS`.
fn check_tip_function(own: &[u8], cursor: &Cursor<'_>, start: usize) -> Result<(), Refusal> {
    let help = "write FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS";
    let mut at = start;
    let mut words = own.split(u8::is_ascii_whitespace).filter_map(|word| {
        let from = at;
        at += word.len() + 1;
        (!word.is_empty()).then_some((from, word))
    });
    let mut found = 0;
    while let Some((from, word)) = words.next() {
        let is_limit = word.len() > 1 && word.starts_with(b"F") && word[1..].iter().all(u8::is_ascii_digit);
        let value = if is_limit { b"".as_slice() } else { words.next().map_or(b"".as_slice(), |(_, value)| value) };
        match (word, value) {
            (b"AXIS", b"POS") | (b"PATHCTRL", b"AXIS") => found += 1,
            (b"F", b"TCP" | b"CONT") | (b"REFPNT", b"TIP-TIP") => {}
            _ if is_limit => {}
            _ => return Err(cursor.refused(from, "a way of programming the tip that is not followed", help)),
        }
    }
    match found {
        2 => Ok(()),
        _ => Err(cursor.refused(cursor.at, "what positions of rotary axes are, and their path, is not said", help)),
    }
}

fn unknown(cursor: &Cursor<'_>, own: &[u8]) -> Refusal {
    let is_number = |byte: Option<&u8>| byte.is_some_and(|next| next.is_ascii_digit() || b"+-".contains(next));
    let is_position = place(own[0]).is_some() && is_number(own.get(1))
        || own[0] == b'I' && own.get(1).is_some_and(|next| place(*next).is_some()) && is_number(own.get(2));
    match is_position {
        true => cursor.refused(cursor.at, "a position without the kind of its move", "write L before it"),
        false => cursor.refused(cursor.at, "not known", "see docs/programs.md for what is; is `--dialect` right?"),
    }
}

/// The word that a block begins with.
fn head(span: std::ops::Range<usize>, name: &[u8]) -> Word {
    let name = String::from_utf8_lossy(name).into_owned();
    Word { letter: 0, name, value: 0.0, sense: Sense::Modal, has_point: true, span }
}

/// Whether a program begins with this line.
pub(crate) fn begins(text: &[u8]) -> bool {
    let frame = words::frame(text);
    let own = text[frame.block].to_ascii_uppercase();
    table::statement(&own).is_some_and(|(_, statement)| statement == Statement::Begin)
}
