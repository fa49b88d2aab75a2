//! The text that LinuxCNC's interpreter is given.

use std::collections::BTreeSet;
use std::fmt::Write;

use abbe_core::{Error, Result};

use super::{MOST_LINES, NO_LENGTH, UNKNOWN};
use crate::geometry::LETTERS;
use crate::options::Options;
use crate::refusal::Refusal;

/// What LinuxCNC's interpreter reads.
#[derive(Debug, Clone, PartialEq)]
pub struct Prepared {
    /// The program: without comments, each line with its number in the file.
    pub program: String,
    /// The tool table, lengths in inches, as an interpreter without a machine takes them.
    pub tools: String,
    /// The parameters: work offsets, in inches.
    pub parameters: String,
    /// Whether the program says its unit.
    pub has_unit: bool,
    /// Whether it uses inches.
    pub has_inches: bool,
}

/// Makes the text for the interpreter.
///
/// Fails at what only the running control knows.
pub fn prepare(text: &str, options: &Options) -> Result<Prepared> {
    let mut scan = Scan::default();
    let mut program = prelude(options);
    for (index, line) in text.lines().enumerate() {
        if index >= MOST_LINES {
            let error = Error::data(format!("a program of more than {MOST_LINES} lines is not written out"));
            return Err(error.help("write out its subprograms and variables").at(&options.file, index + 1, None));
        }
        let kept = scan.line(line.as_bytes(), options.block_delete);
        match kept.map_err(|refusal| refusal.at(&options.file, index + 1, line.as_bytes()))? {
            kept if kept.is_empty() || kept == "%" => program.extend([&kept, "\n"]),
            kept => _ = writeln!(program, "N{} {kept}", index + 1),
        }
    }
    Ok(Prepared {
        program,
        tools: tools(options, &scan.tools),
        parameters: parameters(options),
        has_unit: scan.has_unit,
        has_inches: scan.has_inches,
    })
}

/// Axes stand where they are said to stand, or far away: moves from there are found by it. The number of the line is 0.
fn prelude(options: &Options) -> String {
    let place = |axis: usize| options.start[axis].unwrap_or(UNKNOWN);
    let words: Vec<String> = (0..6).map(|axis| format!("{}{:.4}", char::from(LETTERS[axis]), place(axis))).collect();
    format!("N0 G21 G90 G53 G0 {}\nN0 G80\n", words.join(" "))
}

fn tools(options: &Options, called: &BTreeSet<u32>) -> String {
    let known = options.tools.by_number.keys().copied();
    let all: BTreeSet<u32> = known.chain(called.iter().copied()).filter(|number| *number > 0).collect();
    let line = |number: u32| {
        let length = options.tools.length(number).unwrap_or(NO_LENGTH);
        format!("T{number} P{number} Z{:.9}\n", length / 25.4)
    };
    all.into_iter().map(line).collect()
}

/// Parameters 5221 to 5389: nine for each work offset. The others are those that a control has to have.
fn parameters(options: &Options) -> String {
    let mut text: String = (0..9).map(|index| format!("{}\t0\n", 5161 + index)).collect();
    text.extend((0..9).map(|index| format!("{}\t0\n", 5181 + index)));
    text.push_str("5210\t0\n");
    text.extend((0..9).map(|index| format!("{}\t0\n", 5211 + index)));
    text.push_str("5220\t1\n");
    for system in 0..9 {
        let offset = options.offsets.get(&system).copied().unwrap_or([0.0; 9]);
        for (axis, value) in offset.iter().enumerate() {
            let value = if crate::geometry::is_rotary(axis) { *value } else { value / 25.4 };
            _ = writeln!(text, "{}\t{value:.9}", 5221 + 20 * system + axis);
        }
        _ = writeln!(text, "{}\t0", 5230 + 20 * system);
    }
    text
}

/// What was seen of a program.
#[derive(Default)]
struct Scan {
    tools: BTreeSet<u32>,
    has_unit: bool,
    has_inches: bool,
}

const KNOWN_TO_THE_CONTROL: &str = "correct the blocks around it apart from each other";

impl Scan {
    /// A line without its comments, its number and the blanks before it; nothing of a block that is left out.
    fn line(&mut self, text: &[u8], block_delete: Option<bool>) -> std::result::Result<String, Refusal> {
        let mut plain = without_comments(text);
        if plain.first().is_some_and(|(_, byte)| *byte == b'%') {
            return Ok("%".to_owned());
        }
        if let Some((column, _)) = plain.first().copied().filter(|(_, byte)| *byte == b'/') {
            match block_delete {
                Some(true) => return Ok(String::new()),
                Some(false) => _ = plain.remove(0),
                None => {
                    let help = "say how the switch of the control stands: `--block-delete on`, or `off`";
                    return Err(Refusal::new(column, "/", "an optional block", help));
                }
            }
        }
        if plain.first().is_some_and(|(_, byte)| *byte == b'N') {
            let digits = plain[1..].iter().take_while(|(_, byte)| byte.is_ascii_digit() || *byte == b'.').count();
            plain.drain(..1 + digits);
        }
        self.words(&plain)?;
        Ok(plain.iter().map(|(_, byte)| char::from(*byte)).collect())
    }

    fn words(&mut self, plain: &[(usize, u8)]) -> std::result::Result<(), Refusal> {
        let is_flow = plain.first().is_some_and(|(_, byte)| *byte == b'O');
        let (mut depth, mut at) = (0_usize, 0);
        while let Some(&(column, byte)) = plain.get(at) {
            at += 1;
            match byte {
                b'[' => depth += 1,
                b']' => depth = depth.saturating_sub(1),
                b'#' => parameter(&plain[at..], column)?,
                b'<' => at += plain[at..].iter().position(|(_, byte)| *byte == b'>').map_or(0, |length| length + 1),
                b'A'..=b'Z' if depth == 0 && !is_flow => self.word(byte, plain, at)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// A word of a block; what follows its letter begins at `after`.
    fn word(&mut self, letter: u8, plain: &[(usize, u8)], after: usize) -> std::result::Result<(), Refusal> {
        let column = plain[after - 1].0;
        let digits =
            plain[after..].iter().map(|(_, byte)| *byte).take_while(|byte| byte.is_ascii_digit() || *byte == b'.');
        let number: String = digits.map(char::from).collect();
        let value = number.parse::<f64>().ok();
        let word = format!("{}{number}", char::from(letter));
        let refused = |what: &str| Err(Refusal::new(column, &word, what, KNOWN_TO_THE_CONTROL));
        match (letter, value) {
            (b'G' | b'M', None) => refused("a code that is computed"),
            (b'G', Some(value)) => match (value * 10.0).round() as i64 {
                200 => {
                    (self.has_unit, self.has_inches) = (true, true);
                    Ok(())
                }
                210 => {
                    self.has_unit = true;
                    Ok(())
                }
                280 | 281 | 300 | 301 => refused("a reference point, which only the control knows"),
                380..=389 => refused("a probing move, whose target is never corrected"),
                410 | 420 => refused("cutter compensation with a radius that no tool table here has"),
                530 => refused("a block in machine coordinates, which is never corrected"),
                920 | 923 => refused("an origin where the axes stand, and they stand at corrected positions"),
                100 if !is_offset(plain) => refused("a change of what the control keeps"),
                _ => Ok(()),
            },
            (b'M', Some(66.0)) => refused("an input of the control"),
            (b'M', Some(100.0..=199.0)) => refused("a program of the control's user"),
            (b'U' | b'V' | b'W', _) => refused("an axis that LinuxCNC's interpreter does not print"),
            (b'T' | b'H', Some(value)) if (0.0..1e5).contains(&value) => {
                self.tools.insert(value as u32);
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

/// Whether the block sets a work offset to numbers: its only L is 2, and not computed.
fn is_offset(plain: &[(usize, u8)]) -> bool {
    let (mut depth, mut found) = (0_usize, Vec::new());
    for (at, (_, byte)) in plain.iter().enumerate() {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            b'L' if depth == 0 => {
                let number = plain[at + 1..].iter().map(|(_, byte)| char::from(*byte));
                let number: String = number.take_while(|byte| byte.is_ascii_digit() || *byte == '.').collect();
                found.push(number.parse::<f64>().ok());
            }
            _ => {}
        }
    }
    found == [Some(2.0)]
}

/// Refuses parameters that a running control gives their values.
fn parameter(rest: &[(usize, u8)], column: usize) -> std::result::Result<(), Refusal> {
    let bytes: Vec<u8> = rest.iter().map(|(_, byte)| *byte).collect();
    if bytes.first() == Some(&b'<') {
        let end = bytes.iter().position(|byte| *byte == b'>').map_or(bytes.len(), |end| end + 1);
        let name = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let of_control = ["<_HAL", "<_INI", "<_TASK", "<_REMAP", "<_VALUE"];
        let inner = name.trim_matches(['<', '>']);
        let is_position = inner.strip_prefix('_').is_some_and(|name| {
            let axis = name.strip_prefix("ABS_").unwrap_or(name);
            axis.len() == 1 && LETTERS.contains(&axis.as_bytes()[0])
        });
        if is_position || of_control.iter().any(|prefix| name.starts_with(prefix)) {
            let what = "a value that only the running control knows";
            return Err(Refusal::new(column, &format!("#{}", name.to_lowercase()), what, KNOWN_TO_THE_CONTROL));
        }
        return Ok(());
    }
    let digits: String = bytes.iter().take_while(|byte| byte.is_ascii_digit()).map(|byte| char::from(*byte)).collect();
    if digits.parse::<u32>().is_ok_and(|number| (5000..6000).contains(&number)) {
        let what = "a parameter that only the running control knows";
        return Err(Refusal::new(column, &format!("#{digits}"), what, KNOWN_TO_THE_CONTROL));
    }
    Ok(())
}

/// Upper-case bytes with their columns, without blanks and comments.
fn without_comments(text: &[u8]) -> Vec<(usize, u8)> {
    let mut found = Vec::new();
    let mut is_comment = false;
    for (column, byte) in text.iter().enumerate() {
        match byte {
            b';' if !is_comment => break,
            b'(' => is_comment = true,
            b')' if is_comment => is_comment = false,
            byte if is_comment || byte.is_ascii_whitespace() => {}
            byte => found.push((column, byte.to_ascii_uppercase())),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::Dialect;

    #[test]
    fn lines_keep_their_numbers_and_lose_their_comments() {
        let options = Options::new(Dialect::Linuxcnc);
        let text = "%\n(LOGOPEN,file)\nN10 g21 #1 = 3 ; three\n/ g0 x#1\no100 sub\no100 endsub\nT4 M6\nG43 H5\n%\n";
        let options = Options { block_delete: Some(false), ..options };
        let prepared = prepare(text, &options).expect("a program");
        let lines: Vec<&str> = prepared.program.lines().skip(2).collect();
        assert_eq!(
            lines,
            ["%", "", "N3 G21#1=3", "N4 G0X#1", "N5 O100SUB", "N6 O100ENDSUB", "N7 T4M6", "N8 G43H5", "%"]
        );
        assert!(prepared.has_unit && !prepared.has_inches);
        assert_eq!(prepared.tools.lines().count(), 2);
        let without = Options { block_delete: Some(true), ..options };
        assert!(!prepare(text, &without).expect("a program").program.contains("G0X#1"));
    }

    #[test]
    fn what_only_the_control_knows_is_refused_where_it_stands() {
        let options = Options::new(Dialect::Linuxcnc);
        for (text, column, word) in [
            ("G1 X#5061", 5, "#5061"),
            ("#1=[2*#5422]", 7, "#5422"),
            ("X[1+#<_hal[x.y]>]", 5, "#<_hal"),
            ("X[#<_z>]", 3, "#<_z>"),
            ("G28", 1, "G28"),
            ("G0 G53 Z0", 4, "G53"),
            ("G38.2 Z-5", 1, "G38.2"),
            ("G92 X0", 1, "G92"),
            ("G41 D2", 1, "G41"),
            ("G10 L20 P1 X0", 1, "G10"),
            ("L20 G10 P1 X0", 5, "G10"),
            ("G10 L[10*2] P1 X0", 1, "G10"),
            ("G10 L#3 P1 X0", 1, "G10"),
            ("G[#1]", 1, "G"),
            ("M66 P1", 1, "M66"),
            ("M101", 1, "M101"),
            ("/X5", 1, "/"),
            ("X5 U2", 4, "U2"),
        ] {
            let error = prepare(&format!("G21\n{text}\n"), &options).expect_err(text);
            let place = error.place.clone().expect("a place");
            assert_eq!((place.line, place.column), (Some(2), Some(column)), "{text}: {error}");
            assert!(error.message.contains(word) && error.help.is_some(), "{text}: {error}");
        }
        for text in ["#<step>=2", "#101=5", "G41.1 D3", "G10 L2 P1 X5", "o1 call [5]", "G1 X[ABS[-5]]", "G92.1"] {
            prepare(text, &options).unwrap_or_else(|error| panic!("{text}: {error}"));
        }
    }
}
