//! Words of a line of G-code, with the places where they stand. Text is never changed here.

use std::ops::Range;

use crate::dialect::Dialect;
use crate::refusal::Refusal;

/// How a value is meant (SINUMERIK: `IC(..)`, `AC(..)`, `DC(..)`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sense {
    /// As the modal state says.
    Modal,
    /// Relative to the position before.
    Relative,
    /// Absolute.
    Absolute,
    /// Absolute, the shorter way around.
    Shortest,
}

/// A word: a letter, or a name, with a number.
#[derive(Debug, Clone, PartialEq)]
pub struct Word {
    /// The letter, upper case; 0 for a word with a longer name.
    pub letter: u8,
    /// The name in upper case where it is longer than a letter (`CR`, `TRAORI`); empty otherwise.
    pub name: String,
    /// The number; 0 for a name without one.
    pub value: f64,
    /// How it is meant.
    pub sense: Sense,
    /// Whether the number is written with a decimal point.
    pub has_point: bool,
    /// Where it stands in the line, bytes.
    pub span: Range<usize>,
}

/// A line of a program.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Line {
    /// Its words. The block number is not one of them.
    pub words: Vec<Word>,
    /// Where comments stand.
    pub comments: Vec<Range<usize>>,
    /// Whether it begins with `/`: the place of that.
    pub optional: Option<usize>,
    /// `%`, the number of a program (`O1001`), a label, or another line that is no block.
    pub is_frame: bool,
}

struct Cursor<'a> {
    text: &'a [u8],
    at: usize,
    dialect: Dialect,
}

/// Reads a line; its end of line is not part of it.
///
/// Fails at what is no word of the dialect.
pub fn line(text: &[u8], dialect: Dialect) -> Result<Line, Refusal> {
    let mut found = Line::default();
    let mut cursor = Cursor { text, at: 0, dialect };
    cursor.skip_blanks();
    if cursor.peek() == Some(b'%') {
        cursor.program_mark();
        found.is_frame = true;
        return cursor.alone("%").map(|()| found);
    }
    let mut is_first = true;
    loop {
        cursor.skip_blanks();
        let Some(&byte) = text.get(cursor.at) else { break };
        match byte {
            b';' if dialect.has_semicolon_comments() => {
                found.comments.push(cursor.at..text.len());
                break;
            }
            b'(' if dialect.has_bracket_comments() => found.comments.push(cursor.comment()?),
            b'/' if found.words.is_empty() && found.optional.is_none() => {
                found.optional = Some(cursor.at);
                cursor.at += 1;
                if text.get(cursor.at).is_some_and(u8::is_ascii_digit) && !dialect.is_siemens() {
                    cursor.at += 1;
                }
            }
            b'A'..=b'Z' | b'a'..=b'z' | b'_' => {
                let is_start = is_first || found.words.is_empty() && found.optional.is_none();
                if let Some(word) = cursor.word(is_start, &mut found.is_frame)? {
                    found.words.push(word);
                }
            }
            _ => return Err(cursor.refused_character(byte)),
        }
        is_first = false;
        if found.is_frame {
            cursor.alone("the number of a program")?;
            break;
        }
    }
    Ok(found)
}

impl Cursor<'_> {
    fn skip_blanks(&mut self) {
        while self.text.get(self.at).is_some_and(|byte| byte.is_ascii_whitespace()) {
            self.at += 1;
        }
    }

    fn peek(&self) -> Option<u8> {
        self.text.get(self.at).map(u8::to_ascii_uppercase)
    }

    fn refused(&self, from: usize, what: &str, help: &str) -> Refusal {
        let end = self.text.len().min(from + 24);
        let shown = String::from_utf8_lossy(&self.text[from..end]);
        let word = shown.split_whitespace().next().unwrap_or_default().to_owned();
        Refusal::new(from, &word, what, help)
    }

    fn refused_character(&self, byte: u8) -> Refusal {
        let (what, help) = match byte {
            b'#' => ("a variable, whose value is known to the control alone", VARIABLES),
            b'[' => ("an expression, which only the control evaluates", VARIABLES),
            b'$' => ("a command to the control and no block", "send it apart from the program"),
            b',' => ("a word that is not known", "write chamfers and roundings as moves"),
            _ => ("no word of this dialect", "is `--dialect` right?"),
        };
        self.refused(self.at, what, help)
    }

    /// Passes `%` with the name or the number of a program: `%1234`, `%O1234`, `%_N_PART_MPF` (SINUMERIK).
    fn program_mark(&mut self) {
        self.at += 1;
        if !self.dialect.is_siemens() && matches!(self.peek(), Some(b'O' | b':')) {
            self.at += 1;
        }
        let is_of_name = |byte: &u8| match self.dialect.is_siemens() {
            true => byte.is_ascii_alphanumeric() || *byte == b'_',
            false => byte.is_ascii_digit(),
        };
        self.at += self.text[self.at..].iter().take_while(|byte| is_of_name(byte)).count();
    }

    /// Fails where anything but a comment stands behind what frames a program: nothing there is read.
    fn alone(&mut self, what: &str) -> Result<(), Refusal> {
        loop {
            self.skip_blanks();
            match self.text.get(self.at) {
                None => return Ok(()),
                Some(b';') if self.dialect.has_semicolon_comments() => return Ok(()),
                Some(b'(') if self.dialect.has_bracket_comments() => {
                    self.comment()?;
                }
                Some(_) => {
                    let what = format!("a word in the line of {what}");
                    return Err(self.refused(self.at, &what, "write it in a line of its own"));
                }
            }
        }
    }

    fn comment(&mut self) -> Result<Range<usize>, Refusal> {
        let from = self.at;
        match self.text[from..].iter().position(|byte| *byte == b')') {
            Some(length) => {
                self.at = from + length + 1;
                Ok(from..self.at)
            }
            None => Err(self.refused(from, "a comment without an end", "close it with `)`")),
        }
    }

    /// A word, or none for a block number.
    fn word(&mut self, is_first: bool, is_frame: &mut bool) -> Result<Option<Word>, Refusal> {
        let from = self.at;
        let run = self.text[from..].iter().take_while(|byte| byte.is_ascii_alphabetic() || **byte == b'_').count();
        if run > 1 && (self.dialect.is_siemens() || self.is_name(run)) {
            return self.named(from, run).map(Some);
        }
        let letter = self.text[from].to_ascii_uppercase();
        self.at += 1;
        if letter == b'O' && is_first {
            return match self.dialect.has_program_numbers() {
                true => {
                    let digits = self.text[self.at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
                    if digits == 0 {
                        return Err(self.refused(from, "the number of a program was expected", "write its digits"));
                    }
                    self.at += digits;
                    *is_frame = true;
                    Ok(None)
                }
                false => Err(self.refused(from, "an O-word: a subprogram, a loop or a branch", VARIABLES)),
            };
        }
        if self.dialect.is_siemens() {
            let digits = self.text[self.at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
            if digits > 0 && self.text.get(self.at + digits) == Some(&b'=') {
                // `A3=0.17`, `R1=12.5`, `M2=3`.
                return self.named(from, 1 + digits).map(Some);
            }
            if self.peek() == Some(b'=') {
                self.at += 1;
                return self.assigned(letter, String::new(), from).map(Some);
            }
        }
        let (value, has_point) = self.number(from)?;
        if letter == b'N' && is_first {
            return Ok(None);
        }
        let span = from..self.at;
        Ok(Some(Word { letter, name: String::new(), value, sense: Sense::Modal, has_point, span }))
    }

    /// Whether letters in a row are a name and not words without numbers: nothing of G-code has two letters in a row.
    fn is_name(&self, run: usize) -> bool {
        run > 1 && self.text.get(self.at + 1).is_some_and(u8::is_ascii_alphabetic)
    }

    fn named(&mut self, from: usize, length: usize) -> Result<Word, Refusal> {
        if !self.dialect.is_siemens() {
            return Err(self.refused(from, "a statement that only the control carries out", VARIABLES));
        }
        let mut end = from + length;
        while self.text.get(end).is_some_and(|byte| byte.is_ascii_alphanumeric() || *byte == b'_') {
            end += 1;
        }
        let name = String::from_utf8_lossy(&self.text[from..end]).to_ascii_uppercase();
        self.at = end;
        if self.peek() == Some(b'=') {
            self.at += 1;
            return self.assigned(0, name, from);
        }
        if self.peek() == Some(b'(') {
            let close = self.text[self.at..].iter().position(|byte| *byte == b')');
            let Some(close) = close else {
                return Err(self.refused(from, "a bracket without an end", "close it with `)`"));
            };
            self.at += close + 1;
        }
        Ok(Word { letter: 0, name, value: 0.0, sense: Sense::Modal, has_point: true, span: from..self.at })
    }

    /// A value after `=`: a number, `IC(..)`, `AC(..)`, `DC(..)`, or a text.
    fn assigned(&mut self, letter: u8, name: String, from: usize) -> Result<Word, Refusal> {
        self.skip_blanks();
        let word = |value, sense, span| Word { letter, name: name.clone(), value, sense, has_point: true, span };
        if self.peek() == Some(b'"') {
            let length = self.text[self.at + 1..].iter().position(|byte| *byte == b'"');
            let Some(length) = length else {
                return Err(self.refused(from, "a text without an end", "close it with `\"`"));
            };
            self.at += length + 2;
            return Ok(word(f64::NAN, Sense::Modal, from..self.at));
        }
        let rest = self.text[self.at..].to_ascii_uppercase();
        let sense = match rest {
            _ if rest.starts_with(b"IC(") => Some(Sense::Relative),
            _ if rest.starts_with(b"AC(") => Some(Sense::Absolute),
            _ if rest.starts_with(b"DC(") => Some(Sense::Shortest),
            _ => None,
        };
        if sense.is_some() {
            self.at += 3;
        }
        let (value, _) = self.number(from)?;
        if let Some(sense) = sense {
            self.skip_blanks();
            if self.peek() != Some(b')') {
                return Err(self.refused(from, "more than a number in brackets", VARIABLES));
            }
            self.at += 1;
            return Ok(word(value, sense, from..self.at));
        }
        self.skip_blanks();
        if self.peek().is_some_and(|byte| b"*/+-(<>=".contains(&byte)) {
            return Err(self.refused(from, "an expression, which only the control evaluates", VARIABLES));
        }
        Ok(word(value, Sense::Modal, from..self.at))
    }

    fn number(&mut self, from: usize) -> Result<(f64, bool), Refusal> {
        let (mut text, mut has_point, mut digits) = (String::new(), false, 0);
        loop {
            match self.text.get(self.at) {
                Some(byte) if byte.is_ascii_whitespace() && self.dialect.has_blanks_in_numbers() => {}
                Some(byte @ (b'+' | b'-')) if text.is_empty() => text.push(char::from(*byte)),
                Some(b'.') if !has_point => {
                    has_point = true;
                    text.push('.');
                }
                Some(byte) if byte.is_ascii_digit() => {
                    digits += 1;
                    text.push(char::from(*byte));
                }
                Some(byte) if byte.is_ascii_whitespace() && text.is_empty() => {}
                _ => break,
            }
            self.at += 1;
        }
        // Blanks behind the number are not part of it.
        while self.at > from && self.text[self.at - 1].is_ascii_whitespace() {
            self.at -= 1;
        }
        let next = self.peek();
        let value = text.parse::<f64>().ok().filter(|_| digits > 0 && digits < 18);
        match (value, next) {
            (None, Some(b'#' | b'[' | b'<')) => {
                Err(self.refused(from, "a value that only the control knows", VARIABLES))
            }
            (None, Some(b'R' | b'Q')) if digits == 0 && self.at == from + 1 => {
                Err(self.refused(from, "a value that only the control knows", VARIABLES))
            }
            (None, _) => {
                Err(self.refused(from, "a number was expected", "write digits, at most one sign and one point"))
            }
            (Some(_), Some(b'+' | b'-' | b'.')) => {
                Err(self.refused(from, "no number", "write at most one sign and one point"))
            }
            (Some(_), Some(b'E'))
                if self.text.get(self.at + 1).is_some_and(|byte| byte.is_ascii_digit() || b"+-".contains(byte)) =>
            {
                Err(self.refused(from, "a number with an exponent, which G-code does not have", "write it without"))
            }
            (Some(value), _) => Ok((value, has_point)),
        }
    }
}

const VARIABLES: &str = "write out what it stands for, as numbers and moves";

#[cfg(test)]
mod tests {
    use super::*;

    fn letters(text: &str, dialect: Dialect) -> Vec<(char, f64)> {
        let line = line(text.as_bytes(), dialect).unwrap_or_else(|refusal| panic!("{text}: {refusal:?}"));
        line.words.iter().map(|word| (char::from(word.letter), word.value)).collect()
    }

    #[test]
    fn words_are_read_as_controls_read_them() {
        let linuxcnc = |text| letters(text, Dialect::Linuxcnc);
        assert_eq!(linuxcnc("N5X4.Y-.5"), [('X', 4.0), ('Y', -0.5)]);
        assert_eq!(linuxcnc(" ( a G1 X99 ) x5 (twice) y6 ; X77"), [('X', 5.0), ('Y', 6.0)]);
        assert_eq!(linuxcnc("G1 X 1 0 Y 2"), [('G', 1.0), ('X', 10.0), ('Y', 2.0)]);
        assert_eq!(linuxcnc("g21g90g1x1y2z3f100").len(), 7);
        assert_eq!(letters("N10 /G01 X50.", Dialect::Fanuc), [('G', 1.0), ('X', 50.0)]);
    }

    #[test]
    fn what_frames_a_program_stands_alone() {
        let framed = |text: &str, dialect| line(text.as_bytes(), dialect).map(|line| line.is_frame);
        for dialect in [Dialect::Iso, Dialect::Fanuc] {
            for text in ["O1001", "O0001 (PART) ", "N5 o7", "%", " % ", "%1234", "%O12 (A)", "%:12"] {
                assert_eq!(framed(text, dialect), Ok(true), "{text}");
            }
            for (text, column) in [
                ("O100 G1 X250.", 5),
                ("N5 O100 G1", 8),
                ("O100 M98 P2", 5),
                ("O1 (a) G20", 7),
                ("O100 REPEAT [5]", 5),
                ("O<sub> call [1]", 0),
                ("%5 G1 X250.", 3),
                ("% G20", 2),
                ("%G1X250.", 1),
                ("O1 (open", 3),
            ] {
                assert_eq!(framed(text, dialect).expect_err(text).column, column, "{text}");
            }
        }
        assert_eq!(framed("%_N_PART_MPF ; a G1", Dialect::Siemens), Ok(true));
        assert_eq!(framed("%_N_PART_MPF G1 X250", Dialect::Siemens).expect_err("a block").column, 13);
        for dialect in [Dialect::Linuxcnc, Dialect::Grbl] {
            assert_eq!(framed("%", dialect), Ok(true));
            assert_eq!(framed("% G1 X250.", dialect).expect_err("a block").column, 2);
        }
    }

    #[test]
    fn what_is_no_word_is_refused_where_it_stands() {
        for (text, column) in [("G1 X1e3", 3), ("G1 X--3", 3), ("X#1", 0), ("o100 sub", 0), ("(open", 0), ("$H", 0)] {
            let refusal = line(text.as_bytes(), Dialect::Linuxcnc).expect_err(text);
            assert_eq!(refusal.column, column, "{text}");
        }
    }
}
