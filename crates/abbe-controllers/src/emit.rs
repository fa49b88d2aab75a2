//! Corrected moves as text: what is not motion stays as it is written.

use std::fmt::Write as _;

use crate::block::Move;
use crate::dialect::Dialect;
use crate::geometry::{Coordinates, LETTERS, is_rotary, place};
use crate::modal::Motion;
use crate::options::Options;
use crate::plan::{Piece, Planned, Purpose, is_written};

/// Writes corrected blocks.
pub(crate) struct Emitter<'a> {
    options: &'a Options,
    /// The motion that the written program has made modal.
    pub(crate) motion: Option<Motion>,
    /// Block numbers of plain text, which run without gaps.
    numbers: Option<crate::klartext::Numbers>,
}

impl<'a> Emitter<'a> {
    pub(crate) fn new(options: &'a Options) -> Self {
        let is_klartext = options.dialect == Dialect::Heidenhain;
        Self { options, motion: None, numbers: is_klartext.then(crate::klartext::Numbers::default) }
    }

    /// Text that is not motion, as it is written; `is_new` if it is no line of the program.
    pub(crate) fn copied(&mut self, text: Vec<u8>, is_new: bool) -> Vec<u8> {
        match &mut self.numbers {
            Some(numbers) => numbers.copied(text, is_new),
            None => text,
        }
    }

    /// The text of a move: its own line with other numbers, and a line for every further piece. `line` is as it is in the file.
    pub(crate) fn lines(&mut self, planned: &Planned, line: &[u8], out: &mut Vec<u8>) {
        let end = line.iter().rposition(|byte| !b"\r\n".contains(byte)).map_or(0, |last| last + 1);
        let (text, eol) = line.split_at(end);
        if let Some(numbers) = &mut self.numbers {
            return crate::klartext::write(numbers, self.options, planned, text, eol, out);
        }
        let eol = if eol.is_empty() { b"\n".as_slice() } else { eol };
        let last = planned.pieces.len() - 1;
        for (index, piece) in planned.pieces.iter().enumerate() {
            let motion = motion_of(&planned.of, piece);
            let words = self.words(planned, piece);
            if index == 0 {
                self.first(&planned.of, text, motion, &words, last > 0, out);
            } else {
                if planned.of.line.optional.is_some() {
                    out.push(b'/');
                }
                let code = if self.motion == Some(motion) { String::new() } else { format!("G{} ", motion.code()) };
                out.extend_from_slice(code.as_bytes());
                out.extend_from_slice(words.as_bytes());
                if index == last {
                    for word in planned.of.late.iter().map(|late| &planned.of.line.words[*late]) {
                        out.push(b' ');
                        out.extend_from_slice(&text[word.span.clone()]);
                    }
                }
            }
            self.motion = Some(motion);
            if index < last || end < line.len() {
                out.extend_from_slice(eol);
            }
        }
    }

    /// The line of the program with other words of its motion.
    fn first(&self, of: &Move, text: &[u8], motion: Motion, words: &str, is_split: bool, out: &mut Vec<u8>) {
        let mut at = 0;
        let mut is_written = false;
        for (index, word) in of.line.words.iter().enumerate() {
            let is_motion_word = of.motion_word == Some(index);
            let is_own_code = is_motion_word && of.motion == motion;
            let is_feed = of.inverse_feed.is_some_and(|(_, feed)| feed == index);
            let is_late = is_split && of.late.contains(&index);
            if !(is_position(word) || is_motion_word && !is_own_code || is_feed || is_late) {
                continue;
            }
            let keep = &text[at..word.span.start];
            at = word.span.end;
            if is_written || is_motion_word || is_feed || is_late {
                out.extend_from_slice(keep.trim_ascii_end());
                // What follows needs a blank of its own.
                if !is_motion_word {
                    continue;
                }
                separate(out);
                out.extend_from_slice(format!("G{}", motion.code()).as_bytes());
                continue;
            }
            out.extend_from_slice(keep);
            separate(out);
            if of.motion_word.is_none() && self.motion != Some(motion) {
                out.extend_from_slice(format!("G{} ", motion.code()).as_bytes());
            }
            out.extend_from_slice(words.as_bytes());
            is_written = true;
        }
        let rest = &text[at..];
        if !rest.is_empty() && !rest[0].is_ascii_whitespace() {
            separate(out);
        }
        out.extend_from_slice(rest);
    }

    /// The words of a piece: positions, centre, feed.
    fn words(&self, planned: &Planned, piece: &Piece) -> String {
        let of = &planned.of;
        let mut words = String::with_capacity(64);
        let unit = |axis: usize| if of.inches && !is_rotary(axis) { 25.4 } else { 1.0 };
        for (axis, letter) in LETTERS.iter().enumerate().filter(|(axis, _)| is_written(of, *axis)) {
            let base = if of.relative { piece.path.from[axis] } else { of.offset[axis] };
            self.push(&mut words, *letter, axis, (piece.path.to[axis] - base) / unit(axis), of.inches);
        }
        if let Some(arc) = piece.path.arc {
            for (place, axis) in arc.plane.into_iter().enumerate() {
                let base = if of.arc_absolute { of.offset[axis] } else { piece.path.from[axis] };
                self.push(&mut words, b'I' + axis as u8, axis, (arc.centre[place] - base) / unit(axis), of.inches);
            }
        }
        if let Some((feed, _)) = of.inverse_feed {
            words.push_str(" F");
            push_number(&mut words, self.inverse_feed(planned, piece, feed), 6, true);
        }
        if words.starts_with(' ') {
            words.remove(0);
        }
        words
    }

    /// F of a piece under G93: the time of the block goes to its pieces as their share of the path.
    fn inverse_feed(&self, planned: &Planned, piece: &Piece, feed: f64) -> f64 {
        let share = match piece.purpose {
            Purpose::TakeUp => {
                let length = size(&planned.of.path.from, &planned.of.path.to);
                (size(&piece.path.from, &piece.path.to) / length).clamp(1e-4, 1.0)
            }
            _ => piece.part[1] - piece.part[0],
        };
        match self.options.inverse_is_seconds {
            Some(true) => feed * share,
            _ => feed / share,
        }
    }

    /// Appends a word with the number of an axis.
    fn push(&self, words: &mut String, letter: u8, axis: usize, value: f64, inches: bool) {
        let rotary = is_rotary(axis);
        let decimals = if rotary { self.options.rotary_decimals } else { self.options.decimals + usize::from(inches) };
        words.extend([' ', char::from(letter)]);
        push_number(words, value, decimals, self.options.dialect.has_program_numbers());
    }
}

/// Largest number of last digits that is written as a whole number: it is exact there.
const MOST_DIGITS: f64 = 1e15;

/// Appends a number without needless zeros; with its point where the control asks for it.
pub(crate) fn push_number(out: &mut String, value: f64, decimals: usize, keeps_point: bool) {
    let from = out.len();
    let digits = (value * 10_f64.powi(decimals as i32)).round();
    // Nearly all numbers come here, and most of the time of writing would go into the general way of the library.
    if digits.abs() < MOST_DIGITS && decimals <= 12 {
        let (digits, one) = (digits as i64, 10_i64.pow(decimals as u32));
        let sign = if digits < 0 { "-" } else { "" };
        let (whole, part) = (digits.abs() / one, digits.abs() % one);
        let _ = match decimals {
            0 => write!(out, "{sign}{whole}"),
            _ => write!(out, "{sign}{whole}.{part:0decimals$}"),
        };
    } else {
        let _ = write!(out, "{value:.decimals$}");
    }
    if out[from..].contains('.') {
        out.truncate(out.trim_end_matches('0').len());
    }
    if !keeps_point && out.ends_with('.') {
        out.pop();
    } else if keeps_point && !out[from..].contains('.') {
        out.push('.');
    }
    if out[from..].starts_with("-0") && matches!(&out[from..], "-0" | "-0.") {
        out.remove(from);
    }
}

fn size(one: &Coordinates, other: &Coordinates) -> f64 {
    (0..9).map(|axis| (one[axis] - other[axis]).powi(2)).sum::<f64>().sqrt()
}

fn motion_of(of: &Move, piece: &Piece) -> Motion {
    match (of.motion, piece.path.arc) {
        (motion, Some(_)) => motion,
        (Motion::Rapid, None) => Motion::Rapid,
        (_, None) => Motion::Feed,
    }
}

fn is_position(word: &crate::lexer::Word) -> bool {
    place(word.letter).is_some() || b"IJKR".contains(&word.letter) || word.name == "CR"
}

fn separate(out: &mut Vec<u8>) {
    if out.last().is_some_and(|last| !last.is_ascii_whitespace() && *last != b'/') {
        out.push(b' ');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_as_short_as_they_can_be() {
        for (number, decimals, plain, pointed) in [
            (10.0, 4, "10", "10."),
            (-0.00001, 4, "0", "0."),
            (-0.5, 4, "-0.5", "-0.5"),
            (100.0, 0, "100", "100."),
            (1e13, 4, "10000000000000", "10000000000000."),
            (-12.00306, 4, "-12.0031", "-12.0031"),
        ] {
            for (keeps_point, wanted) in [(false, plain), (true, pointed)] {
                let mut text = "X".to_owned();
                push_number(&mut text, number, decimals, keeps_point);
                assert_eq!(text, format!("X{wanted}"));
            }
        }
    }

    /// Whole numbers of last digits are what the library writes.
    #[test]
    fn numbers_are_those_of_the_library() {
        let mut state = 7_u64;
        for _ in 0..20_000 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let decimals = (state >> 60) as usize % 7;
            let units = (state >> 20) as i64 % 4_000_000_000 - 2_000_000_000;
            let value = units as f64 / 10_f64.powi(decimals as i32);
            let mut text = String::new();
            push_number(&mut text, value, decimals, false);
            let library = format!("{value:.decimals$}");
            assert_eq!(text.parse::<f64>(), library.parse::<f64>(), "{value} {decimals}");
            assert!(text.len() <= library.len());
        }
    }
}
