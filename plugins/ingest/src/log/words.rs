//! Words of a line: a letter and a number each, as DPRNT, WRITE, FN 16 and `(LOG,...)` print them.

/// A letter and its number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Word {
    pub(crate) letter: char,
    pub(crate) value: f64,
    /// Character at which it begins, from 1.
    pub(crate) column: usize,
}

/// What is wrong with a line, and at which character of it.
pub(crate) type Wrong = (String, usize);

/// The words of a line. Blanks may stand between words, and between letter, sign and digits (`Y-   91.200`); they need not.
/// A comma before the decimals is a point, since no comma separates words.
pub(crate) fn words(line: &str) -> Result<Vec<Word>, Wrong> {
    let characters: Vec<char> = line.chars().collect();
    let mut at = 0;
    let mut found: Vec<Word> = Vec::new();
    loop {
        at = after(&characters, at, |it| it.is_whitespace());
        let Some(&letter) = characters.get(at) else { return Ok(found) };
        if !letter.is_ascii_uppercase() {
            return Err((format!("`{letter}` stands where a capital letter was expected"), at + 1));
        }
        if found.iter().any(|word| word.letter == letter) {
            return Err((format!("`{letter}` stands twice in the line"), at + 1));
        }
        let begin = at;
        let (written, end) = number(&characters, at + 1);
        let value = written.parse::<f64>().ok().filter(|value| value.is_finite());
        let value = value.ok_or_else(|| (format!("a number was expected behind `{letter}`"), at + 2))?;
        found.push(Word { letter, value, column: begin + 1 });
        at = end;
    }
}

/// A number as Rust reads it, and where it ends.
fn number(characters: &[char], from: usize) -> (String, usize) {
    let mut written = String::new();
    let mut at = after(characters, from, |it| it.is_whitespace());
    if let Some(sign @ ('+' | '-')) = characters.get(at) {
        written.push(*sign);
        at = after(characters, at + 1, |it| it.is_whitespace());
    }
    let end = after(characters, at, |it| it.is_ascii_digit() || ".,".contains(it));
    written.extend(characters[at..end].iter().map(|it| if *it == ',' { '.' } else { *it }));
    // `1.5E-05`, and `1.5EX-05` of Siemens.
    let mut exponent = after(characters, end, |it| it == 'E');
    if exponent == end + 1 && end > at {
        exponent = after(characters, exponent, |it| it == 'X');
        let sign = after(characters, exponent, |it| "+-".contains(it));
        let last = after(characters, sign, |it| it.is_ascii_digit());
        written.push('e');
        written.extend(&characters[exponent..last]);
        return (written, last);
    }
    (written, end)
}

/// The first place from `at` on whose character is another one.
fn after(characters: &[char], at: usize, is: impl Fn(char) -> bool) -> usize {
    characters[at.min(characters.len())..].iter().position(|it| !is(*it)).map_or(characters.len(), |more| at + more)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Vec<(char, f64)> {
        words(line).expect("words").into_iter().map(|word| (word.letter, word.value)).collect()
    }

    #[test]
    fn words_are_read_as_controls_pad_them() {
        assert_eq!(read("  T   12 R1 H1 X12.5"), [('T', 12.0), ('R', 1.0), ('H', 1.0), ('X', 12.5)]);
        assert_eq!(read("T023X   128.474Y-    91.200"), [('T', 23.0), ('X', 128.474), ('Y', -91.2)]);
        assert_eq!(read("X+.5 Y-0. Z1,25"), [('X', 0.5), ('Y', -0.0), ('Z', 1.25)]);
        assert_eq!(read("X1.5E-05Y2EX+1 Z3"), [('X', 1.5e-5), ('Y', 20.0), ('Z', 3.0)]);
        assert_eq!(read(" \t "), []);
    }

    #[test]
    fn what_is_no_word_is_refused_with_its_column() {
        for (line, column) in [
            ("T1 x2", 4),
            ("T1 X", 5),
            ("T1 X1.2.3", 5),
            ("T1 X1 2", 7),
            ("T1 X- -2", 5),
            ("T1 X1 T2", 7),
            ("X1E", 2),
            ("X1E999", 2),
            ("µ1", 1),
            ("X1,2,3", 2),
        ] {
            assert_eq!(words(line).expect_err("an error").1, column, "{line}");
        }
    }
}
