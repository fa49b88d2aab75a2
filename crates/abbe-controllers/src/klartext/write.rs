//! Corrected moves as plain text: what is not motion stays as it is written, and block numbers run on.

use crate::block::Move;
use crate::emit::push_number;
use crate::geometry::{LETTERS, is_rotary, place};
use crate::lexer::Word;
use crate::options::Options;
use crate::plan::{Piece, Planned, is_written};

use super::words::frame;

/// Block numbers of the corrected program.
#[derive(Default)]
pub(crate) struct Numbers {
    /// Blocks that were added so far.
    added: u64,
    /// The last number that was written, if the last line had one.
    last: Option<u64>,
}

impl Numbers {
    /// A line of the program with its number, or a new one with the next number.
    pub(crate) fn copied(&mut self, text: Vec<u8>, is_new: bool) -> Vec<u8> {
        if is_new {
            let Some(last) = self.last else { return text };
            self.added += 1;
            self.last = Some(last + 1);
            return [format!("{} ", last + 1).as_bytes(), &text].concat();
        }
        let Some((span, number)) = frame(&text).number else { return text };
        self.last = Some(number + self.added);
        match self.added {
            0 => text,
            added => [&text[..span.start], (number + added).to_string().as_bytes(), &text[span.end..]].concat(),
        }
    }

    /// What stands before a block of a line, with the next number.
    fn before(&mut self, text: &[u8], end: usize, is_first: bool) -> Vec<u8> {
        self.added += u64::from(!is_first && frame(text).number.is_some());
        self.copied(text[..end].to_vec(), false)
    }
}

/// Writes the blocks of a move: its own line with other words, and a line for every further piece and every centre.
pub(crate) fn write(
    numbers: &mut Numbers,
    options: &Options,
    planned: &Planned,
    text: &[u8],
    eol: &[u8],
    out: &mut Vec<u8>,
) {
    let of = &planned.of;
    let start = of.line.words.first().map_or(0, |word| word.span.start);
    let between = if eol.is_empty() { b"\n".as_slice() } else { eol };
    let is_fast = of.is_fast_arc();
    let last = planned.pieces.len() - 1;
    let mut is_first = true;
    for (index, piece) in planned.pieces.iter().enumerate() {
        let mut begin = |out: &mut Vec<u8>| {
            if !is_first {
                out.extend_from_slice(between);
            }
            out.extend(numbers.before(text, start, is_first));
            is_first = false;
        };
        if piece.path.arc.is_some() {
            begin(out);
            out.extend_from_slice(b"CC");
            out.extend_from_slice(centre(options, of, piece).as_bytes());
        }
        begin(out);
        let words = words(options, of, piece);
        let name = if piece.path.arc.is_some() { "C" } else { "L" };
        if index == 0 {
            own_line(of, &text[start..], start, name, &words, last > 0, out);
        } else {
            out.extend_from_slice(name.as_bytes());
            out.extend_from_slice(words.as_bytes());
            if is_fast {
                out.extend_from_slice(b" FMAX");
            }
            for word in of.late.iter().map(|late| &of.line.words[*late]).filter(|_| index == last) {
                out.push(b' ');
                out.extend_from_slice(&text[word.span.clone()]);
            }
        }
    }
    out.extend_from_slice(eol);
}

/// The block of the program with other words of its motion; `text` begins with it, at `start` of its line.
fn own_line(of: &Move, text: &[u8], start: usize, name: &str, words: &str, is_split: bool, out: &mut Vec<u8>) {
    let mut at = 0;
    let mut is_written = false;
    for (index, word) in of.line.words.iter().enumerate().filter(|(_, word)| !word.span.is_empty()) {
        let is_late = is_split && of.late.contains(&index);
        let is_head = index == 0;
        if !(is_head || is_late || is_path(word)) {
            continue;
        }
        let span = word.span.start - start..word.span.end - start;
        let keep = &text[at..span.start];
        at = span.end;
        if is_head {
            out.extend_from_slice(name.as_bytes());
        } else if is_late || is_written {
            out.extend_from_slice(keep.trim_ascii_end());
        } else {
            out.extend_from_slice(keep.trim_ascii_end());
            out.extend_from_slice(words.as_bytes());
            is_written = true;
        }
    }
    let rest = &text[at..];
    if rest.first().is_some_and(|next| !next.is_ascii_whitespace()) {
        out.push(b' ');
    }
    out.extend_from_slice(rest);
}

/// Whether a word says where a path goes.
fn is_path(word: &Word) -> bool {
    place(word.letter).is_some() || word.letter == b'R' || word.name == "DR"
}

/// Positions, and the sense of an arc, each with a blank before it.
fn words(options: &Options, of: &Move, piece: &Piece) -> String {
    let mut words = String::with_capacity(64);
    let in_arc = |axis: usize| piece.path.arc.is_none_or(|arc| arc.plane.contains(&axis));
    for axis in (0..9).filter(|axis| is_written(of, *axis) && in_arc(*axis)) {
        push(&mut words, options, of, axis, piece.path.to[axis]);
    }
    if let Some(arc) = piece.path.arc {
        words.push_str(if arc.sweep < 0.0 { " DR-" } else { " DR+" });
    }
    words
}

fn centre(options: &Options, of: &Move, piece: &Piece) -> String {
    let mut words = String::new();
    for (axis, at) in piece.path.arc.iter().flat_map(|arc| arc.plane.into_iter().zip(arc.centre)) {
        push(&mut words, options, of, axis, at);
    }
    words
}

/// Appends a position, which is in coordinates of the machine, with its sign.
fn push(words: &mut String, options: &Options, of: &Move, axis: usize, at: f64) {
    let rotary = is_rotary(axis);
    let unit = if of.inches && !rotary { 25.4 } else { 1.0 };
    let decimals = if rotary { options.rotary_decimals } else { options.decimals + usize::from(of.inches) };
    words.extend([' ', char::from(LETTERS[axis])]);
    let from = words.len();
    push_number(words, (at - of.offset[axis]) / unit, decimals, false);
    if !words[from..].starts_with('-') {
        words.insert(from, '+');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_run_without_gaps() {
        let mut numbers = Numbers::default();
        let mut of =
            |text: &str, is_new| String::from_utf8(numbers.copied(text.as_bytes().to_vec(), is_new)).expect("text");
        assert_eq!(of("0 BEGIN PGM A MM\n", false), "0 BEGIN PGM A MM\n");
        assert_eq!(of("; new\n", true), "1 ; new\n");
        assert_eq!(of("1 TOOL CALL 5 Z\n", false), "2 TOOL CALL 5 Z\n");
        assert_eq!(of("  Q339=+1\n", false), "  Q339=+1\n");
        assert_eq!(of("2 M3\n", false), "3 M3\n");
        assert_eq!(Numbers::default().copied(b"; new\n".to_vec(), true), b"; new\n");
    }
}
