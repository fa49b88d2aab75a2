//! Lengths of tools.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{Error, Result};

/// The lengths of tools, from the gauge line of the spindle, mm.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tools {
    /// One length for whatever a program calls.
    pub only: Option<f64>,
    /// Lengths by number.
    pub by_number: BTreeMap<u32, f64>,
}

impl Tools {
    /// Reads a tool table of LinuxCNC: `T1 P1 Z120.5 D6 ;comment`, lengths in mm.
    ///
    /// Fails for a line without a number or a length, and for a number twice.
    pub fn read(text: &str, file: &Path) -> Result<Self> {
        let mut by_number = BTreeMap::new();
        for (index, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            let own = line.split(';').next().unwrap_or_default().trim();
            if own.is_empty() {
                continue;
            }
            let value = |letter: char| {
                let words = own.split_whitespace();
                words
                    .filter_map(|word| word.strip_prefix([letter, letter.to_ascii_lowercase()])?.parse::<f64>().ok())
                    .next()
            };
            let at = |message: &str| {
                Error::data(message.to_owned()).help("a line is `T1 P1 Z120.5 D6`").at(file, index + 1, None)
            };
            let is_word = |word: &str| {
                let letter = word.chars().next().is_some_and(|letter| letter.is_ascii_alphabetic());
                letter && word[1..].parse::<f64>().is_ok_and(f64::is_finite)
            };
            if let Some(other) = own.split_whitespace().find(|word| !is_word(word)) {
                return Err(at(&format!("`{other}` is no letter with a number")));
            }
            let number = value('T').filter(|number| *number >= 0.0 && number.fract() == 0.0 && *number < 1e6);
            let number = number.ok_or_else(|| at("a line of a tool table without the number of a tool"))?;
            let of_letter =
                |letter: char| own.split_whitespace().filter(move |word| word.to_ascii_uppercase().starts_with(letter));
            if let Some(letter) = "TZ".chars().find(|letter| of_letter(*letter).count() > 1) {
                return Err(at(&format!("a line of a tool table with {letter} twice")));
            }
            if let Some(letter) = "XYABCUVW".chars().find(|letter| value(*letter).is_some_and(|offset| offset != 0.0)) {
                let help = "only lengths are counted: correct programs for tools without other offsets";
                return Err(at(&format!("a tool with an offset along {letter}")).help(help));
            }
            let length = value('Z').filter(|length| length.is_finite());
            let length = length.ok_or_else(|| at("a tool without a length"))?;
            if length < 0.0 {
                let help = "lengths count from the gauge line of the spindle, as a presetter measures them; offsets by touching off do not \
                            say how far the tip is from it";
                return Err(at("a tool with a length below 0").help(help));
            }
            if by_number.insert(number as u32, length).is_some() {
                return Err(at("a tool that stands here twice"));
            }
        }
        Ok(Self { only: None, by_number })
    }

    /// The length of a tool.
    pub fn length(&self, number: u32) -> Option<f64> {
        self.only.or_else(|| self.by_number.get(&number).copied())
    }

    /// What to do about a tool whose length is not known.
    pub(crate) fn help(&self) -> &'static str {
        match self.by_number.is_empty() {
            true => "give it: `--tools tool.tbl`, or `--tool-length-mm`",
            false => "the table of tools has no line for it: add one, or give `--tool-length-mm`",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tool_tables_have_lengths() {
        let read = |text| Tools::read(text, Path::new("tool.tbl"));
        let tools = read("T4 P4 Z87.5 D6 ; end mill\n\nT5 P5 Z+120\n").expect("a table");
        assert_eq!((tools.length(4), tools.length(5), tools.length(6)), (Some(87.5), Some(120.0), None));
        for wrong in [
            "T4 P4\n",
            "T1 Z1\nT1 Z2\n",
            "T1 Z120.5 Z20\n",
            "T1 P1 Z120 X200 Y-50\n",
            "T1 Z120 A5\n",
            "T1 P1 Z120 .5\n",
            "T1 Z120.5 junk\n",
            "T1 Z1e999\n",
        ] {
            assert!(read(wrong).is_err_and(|error| error.place.is_some_and(|place| place.line.is_some())), "{wrong}");
        }
        assert!(read("\u{feff}T1 P1 Z120 X0 Y+0\n").is_ok());
        assert!(read("T1 Z-350.5\n").is_err_and(|error| error.help.is_some_and(|help| help.contains("gauge line"))));
    }
}
