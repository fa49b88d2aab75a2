//! Corrected moves as text: what is not motion stays as it is written.

use crate::block::Move;
use crate::geometry::{Coordinates, LETTERS, is_rotary, place};
use crate::modal::Motion;
use crate::options::Options;
use crate::plan::{Piece, Planned, Purpose, is_written};

/// Writes corrected blocks.
pub(crate) struct Emitter<'a> {
    options: &'a Options,
    /// The motion that the written program has made modal.
    pub(crate) motion: Option<Motion>,
}

impl<'a> Emitter<'a> {
    pub(crate) fn new(options: &'a Options) -> Self {
        Self { options, motion: None }
    }

    /// The text of a move: its own line with other numbers, and a line for every further piece. `line` is as it is in the file.
    pub(crate) fn lines(&mut self, planned: &Planned, line: &[u8], out: &mut Vec<u8>) {
        let end = line.iter().rposition(|byte| !b"\r\n".contains(byte)).map_or(0, |last| last + 1);
        let (text, eol) = line.split_at(end);
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
        let mut words = Vec::new();
        let unit = |axis: usize| if of.inches && !is_rotary(axis) { 25.4 } else { 1.0 };
        for (axis, letter) in LETTERS.iter().enumerate() {
            if is_written(of, axis) {
                let base = if of.relative { piece.path.from[axis] } else { of.offset[axis] };
                let value = (piece.path.to[axis] - base) / unit(axis);
                words.push(format!("{}{}", char::from(*letter), self.number(axis, value, of.inches)));
            }
        }
        if let Some(arc) = piece.path.arc {
            for (place, axis) in arc.plane.into_iter().enumerate() {
                let base = if of.arc_absolute { of.offset[axis] } else { piece.path.from[axis] };
                let value = (arc.centre[place] - base) / unit(axis);
                words.push(format!("{}{}", char::from(b'I' + axis as u8), self.number(axis, value, of.inches)));
            }
        }
        if let Some((feed, _)) = of.inverse_feed {
            words.push(format!("F{}", trimmed(&format!("{:.6}", self.inverse_feed(planned, piece, feed)), true)));
        }
        words.join(" ")
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

    fn number(&self, axis: usize, value: f64, inches: bool) -> String {
        let rotary = is_rotary(axis);
        let decimals = if rotary { self.options.rotary_decimals } else { self.options.decimals + usize::from(inches) };
        trimmed(&format!("{value:.decimals$}"), self.options.dialect.has_program_numbers())
    }
}

/// A number without needless zeros; with its point where the control asks for it.
fn trimmed(number: &str, keeps_point: bool) -> String {
    let mut text = if number.contains('.') { number.trim_end_matches('0').to_owned() } else { number.to_owned() };
    if !keeps_point {
        text = text.trim_end_matches('.').to_owned();
    } else if !text.contains('.') {
        text.push('.');
    }
    match text.as_str() {
        "-0" => "0".to_owned(),
        "-0." => "0.".to_owned(),
        _ => text,
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
        for (number, plain, pointed) in
            [("10.0000", "10", "10."), ("-0.0000", "0", "0."), ("-0.5000", "-0.5", "-0.5"), ("100", "100", "100.")]
        {
            assert_eq!((trimmed(number, false).as_str(), trimmed(number, true).as_str()), (plain, pointed));
        }
    }
}
