//! Siemens SINUMERIK: `MEAS` ends a block where the probe triggers, `$AC_MEA` tells whether it did, `$AA_MM` where in machine coordinates;
//! `SUPA` suppresses all offsets.

use super::plain;

/// A remark of the program.
pub fn remark(text: &str) -> String {
    format!("; {}", plain(text))
}

/// A text on the screen.
pub fn message(text: &str) -> String {
    format!("MSG(\"{}\")", plain(text))
}

/// A stop with a text, after which the operator goes on.
pub fn stop(text: &str) -> [String; 2] {
    [message(text), "M0".to_owned()]
}

/// An alarm out of which only reset leads.
pub fn alarm(number: u32, text: &str) -> Vec<String> {
    let mut lines = vec![message(text), "STOPRE".to_owned(), format!("SETAL({number})")];
    lines.extend(["; ONLY RESET LEADS OUT OF HERE", "LOOP", "M0", "ENDLOOP"].map(str::to_owned));
    lines
}

/// A move with feed, machine coordinates.
pub fn to(words: &str, feed: &str) -> String {
    format!("G1 SUPA {words} F{feed}")
}

/// A move that ends where the probe at this measuring input triggers.
pub fn until_contact(input: u32, words: &str, feed: &str) -> String {
    format!("MEAS={input} {}", to(words, feed))
}

/// Whether the probe triggered in the last move of that kind.
pub fn touched(input: u32) -> String {
    format!("$AC_MEA[{input}]")
}

/// Where an axis was then.
pub fn measured(letter: &str) -> String {
    format!("$AA_MM[{letter}]")
}

/// The lines after a move that nothing may stop, which raise an alarm if something did.
pub fn watch(input: u32, number: u32, text: &str) -> Vec<String> {
    let mut lines = vec!["STOPRE".to_owned(), format!("IF {}>=1", touched(input))];
    lines.extend(alarm(number, text).into_iter().map(|line| format!("  {line}")));
    lines.push("ENDIF".to_owned());
    lines
}
