//! Words of a block of plain text, with the places where they stand.

use std::ops::Range;

use crate::geometry::place;
use crate::lexer::{Sense, Word};
use crate::refusal::Refusal;

/// What stands around a block.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Frame {
    /// Where its number stands, and what it is.
    pub(crate) number: Option<(Range<usize>, u64)>,
    /// The place of `/`, if a switch of the control can leave it out.
    pub(super) optional: Option<usize>,
    /// From its first word to its comment; empty for a comment alone.
    pub(super) block: Range<usize>,
    /// Whether it goes on in the next line.
    pub(super) is_open: bool,
}

/// Splits a line into its number, its block and a comment.
pub(crate) fn frame(text: &[u8]) -> Frame {
    let mut found = Frame::default();
    let mut at = 0;
    loop {
        at += text[at..].iter().take_while(|byte| byte.is_ascii_whitespace()).count();
        let digits = text[at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
        if text.get(at) == Some(&b'/') && found.optional.is_none() {
            found.optional = Some(at);
            at += 1;
        } else if found.number.is_none() && (1..=LONGEST_NUMBER).contains(&digits) {
            let number = text[at..at + digits].iter().fold(0, |sum, digit| 10 * sum + u64::from(digit - b'0'));
            found.number = Some((at..at + digits, number));
            at += digits;
        } else {
            break;
        }
    }
    let mut is_quoted = false;
    let comment = text[at..].iter().position(|byte| {
        is_quoted ^= *byte == b'"';
        *byte == b';' && !is_quoted
    });
    let end = comment.map_or(text.len(), |length| at + length);
    let mut own = text[at..end].trim_ascii_end();
    found.is_open = text.trim_ascii_end().ends_with(b"~");
    if own.ends_with(b"~") {
        own = own[..own.len() - 1].trim_ascii_end();
    }
    // `* - text` is a line of the structure.
    found.block = if own.starts_with(b"*") { at..at } else { at..at + own.len() };
    found
}

/// Most digits of a block number.
const LONGEST_NUMBER: usize = 15;

/// Reads words of a block.
pub(super) struct Cursor<'a> {
    text: &'a [u8],
    /// Where it stands.
    pub(super) at: usize,
    end: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(text: &'a [u8], block: Range<usize>) -> Self {
        Self { text, at: block.start, end: block.end }
    }

    pub(super) fn skip_blanks(&mut self) {
        while self.at < self.end && self.text[self.at].is_ascii_whitespace() {
            self.at += 1;
        }
    }

    /// The next byte, upper case, `ahead` of where it stands.
    pub(super) fn peek(&self, ahead: usize) -> Option<u8> {
        let at = self.at + ahead;
        if at < self.end { Some(self.text[at].to_ascii_uppercase()) } else { None }
    }

    /// Whether this stands here; then it is passed.
    pub(super) fn takes(&mut self, wanted: &[u8]) -> bool {
        let is_here = (0..wanted.len()).all(|ahead| self.peek(ahead) == Some(wanted[ahead]));
        if is_here {
            self.at += wanted.len();
        }
        is_here
    }

    /// A refusal of the word that begins here.
    pub(super) fn refused(&self, from: usize, what: &str, help: &str) -> Refusal {
        let word = self.text[from..self.end].split(u8::is_ascii_whitespace).next().unwrap_or_default();
        let shown = String::from_utf8_lossy(&word[..word.len().min(24)]);
        Refusal::new(from, &shown, what, help)
    }

    /// A number; blanks may stand before it.
    pub(super) fn number(&mut self, from: usize) -> Result<f64, Refusal> {
        self.skip_blanks();
        let start = self.at;
        if matches!(self.peek(0), Some(b'+' | b'-')) {
            self.at += 1;
        }
        if self.peek(0) == Some(b'Q') {
            return Err(self.refused(from, "a Q parameter, whose value is known to the control alone", WRITE_OUT));
        }
        while self.peek(0).is_some_and(|byte| byte.is_ascii_digit() || byte == b'.') {
            self.at += 1;
        }
        let text = std::str::from_utf8(&self.text[start..self.at]).unwrap_or_default();
        let value = text.parse::<f64>().ok().filter(|_| text.len() < 20);
        let ends = self.peek(0).is_none_or(|next| next.is_ascii_whitespace() || next.is_ascii_alphabetic());
        match value.filter(|_| ends) {
            Some(value) => Ok(value),
            None => Err(self.refused(from, "a number was expected", "write digits, at most one sign and one point")),
        }
    }

    fn word(&self, from: usize, letter: u8, name: &str, value: f64, sense: Sense) -> Word {
        Word { letter, name: name.to_owned(), value, sense, has_point: true, span: from..self.at }
    }

    /// The next word of a positioning block; none at its end.
    pub(super) fn next(&mut self) -> Result<Option<Word>, Refusal> {
        self.skip_blanks();
        let from = self.at;
        let Some(byte) = self.peek(0) else { return Ok(None) };
        let (own, sense) = match (byte, self.peek(1)) {
            (b'I', Some(next)) => (next, Sense::Relative),
            _ => (byte, Sense::Absolute),
        };
        if place(own).is_some() {
            self.at += if sense == Sense::Relative { 2 } else { 1 };
            let value = self.number(from)?;
            return Ok(Some(self.word(from, own, "", value, sense)));
        }
        let found = match byte {
            b'D' if self.takes(b"DR") => {
                let value = match self.peek(0) {
                    Some(b'+') => 1.0,
                    Some(b'-') => -1.0,
                    _ => return Err(self.refused(from, "a sense of rotation was expected", "write DR+ or DR-")),
                };
                self.at += 1;
                self.word(from, 0, "DR", value, Sense::Modal)
            }
            b'R' => self.radius(from)?,
            b'F' => self.feed(from)?,
            b'M' => {
                self.at += 1;
                let value = self.number(from)?;
                if value.fract() != 0.0 || !(0.0..1e5).contains(&value) {
                    return Err(self.refused(from, "an M function that is not known", "write its number"));
                }
                // `M128 F1000` and `M103 F0.5` have a number of their own.
                let end = self.at;
                self.skip_blanks();
                if matches!(value as u32, 103 | 128) && self.peek(0) == Some(b'F') {
                    self.at += 1;
                    self.number(from)?;
                } else {
                    self.at = end;
                }
                self.word(from, b'M', "", value, Sense::Modal)
            }
            b'Q' => {
                return Err(self.refused(from, "a Q parameter, whose value is known to the control alone", WRITE_OUT));
            }
            _ => {
                return Err(self.refused(
                    from,
                    "a word that is not known here",
                    "see docs/programs.md for those that are",
                ));
            }
        };
        Ok(Some(found))
    }

    /// `R0`, or the radius of an arc.
    fn radius(&mut self, from: usize) -> Result<Word, Refusal> {
        self.at += 1;
        let is_end = |next: Option<u8>| next.is_none_or(|next| !next.is_ascii_digit() && next != b'.');
        match (self.peek(0), self.peek(1)) {
            (Some(b'0'), next) if is_end(next) => {
                self.at += 1;
                Ok(self.word(from, 0, "R0", 0.0, Sense::Modal))
            }
            (Some(b'L' | b'R'), _) => Err(self.compensated(from)),
            (Some(b'+' | b'-'), next) if is_end(next) => Err(self.compensated(from)),
            _ => {
                let value = self.number(from)?;
                Ok(self.word(from, b'R', "", value, Sense::Modal))
            }
        }
    }

    fn compensated(&self, from: usize) -> Refusal {
        let what = "the path of the tool is not the programmed one under radius compensation";
        self.refused(from, what, "let the CAM system write the path of the tool, with R0")
    }

    fn feed(&mut self, from: usize) -> Result<Word, Refusal> {
        self.at += 1;
        self.skip_blanks();
        if self.takes(b"MAX") && !self.peek(0).is_some_and(|next| next.is_ascii_alphanumeric()) {
            return Ok(self.word(from, 0, "FMAX", 0.0, Sense::Modal));
        }
        if self.takes(b"AUTO") {
            return Ok(self.word(from, b'F', "", 0.0, Sense::Modal));
        }
        if matches!(self.peek(0), Some(b'Z' | b'U')) {
            self.at += 1;
        }
        if self.peek(0).is_some_and(|next| next.is_ascii_alphabetic() && next != b'Q') {
            self.at = from;
            let help = "write F with a number, FMAX, F AUTO, FZ or FU";
            return Err(self.refused(from, "a feed that is not known here", help));
        }
        let value = self.number(from)?;
        Ok(self.word(from, b'F', "", value, Sense::Modal))
    }
}

const WRITE_OUT: &str = "write out what it stands for";

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<(String, f64, Sense)> {
        let frame = frame(text.as_bytes());
        let mut cursor = Cursor::new(text.as_bytes(), frame.block);
        let mut found = Vec::new();
        while let Some(word) = cursor.next().unwrap_or_else(|refusal| panic!("{text}: {refusal:?}")) {
            let name = if word.letter == 0 { word.name } else { char::from(word.letter).to_string() };
            found.push((name, word.value, word.sense));
        }
        found
    }

    #[test]
    fn words_have_their_places() {
        let names = |text: &str| words(text).into_iter().map(|word| (word.0, word.1)).collect::<Vec<_>>();
        let of = |all: &[(&str, f64)]| all.iter().map(|word| (word.0.to_owned(), word.1)).collect::<Vec<_>>();
        let found = "12 X+10 IY-5.5 F MAX M3 ; as X99 was";
        assert_eq!(names(found), of(&[("X", 10.0), ("Y", -5.5), ("FMAX", 0.0), ("M", 3.0)]));
        assert_eq!(words(found)[1].2, Sense::Relative);
        assert_eq!(names("X+1R+25DR-R0 FAUTO"), of(&[("X", 1.0), ("R", 25.0), ("DR", -1.0), ("R0", 0.0), ("F", 0.0)]));
        assert_eq!(names("M128 F1000 F500"), of(&[("M", 128.0), ("F", 500.0)]));
        assert_eq!(frame(b"/ 7 L").number, Some((2..3, 7)));
        assert!(frame(b"8 * - face X+5").block.is_empty() && frame(b"9 CYCL DEF 247 ~").is_open);
    }

    #[test]
    fn what_is_no_word_is_refused_where_it_stands() {
        for (text, column) in [("X+Q5", 0), ("X+1 RL", 4), ("X+1,5", 0), ("Y+2 FT5", 4), ("X++2", 0), ("X+1 LIN_Z", 4)]
        {
            let frame = frame(text.as_bytes());
            let mut cursor = Cursor::new(text.as_bytes(), frame.block);
            let refusal = loop {
                match cursor.next() {
                    Ok(Some(_)) => {}
                    Ok(None) => panic!("{text} is not refused"),
                    Err(refusal) => break refusal,
                }
            };
            assert_eq!(refusal.column, column, "{text}");
        }
    }
}
