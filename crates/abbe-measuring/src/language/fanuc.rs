//! Fanuc and Haas, Custom Macro B: `G31` stops at the skip signal and leaves where in #5061 to #5063, in the work offset that is active;
//! without a signal these hold the end of the block.

use super::plain;

/// A move that ends further than this from its end was stopped by the probe, mm.
pub const STOPPED_MM: f64 = 0.01;

/// Length of an alarm's text that every control shows.
const ALARM_TEXT: usize = 26;

/// A text for the screen: capitals, as long as every control shows.
pub fn short(text: &str) -> String {
    let text: String = plain(text).to_uppercase().chars().take(ALARM_TEXT).collect();
    text.trim_end().to_owned()
}

/// A remark of the program.
pub fn remark(text: &str) -> String {
    format!("({})", plain(text).to_uppercase())
}

/// An alarm.
pub fn alarm(number: u32, text: &str) -> String {
    format!("#3000={number}({})", short(text))
}

/// A stop with a text, after which the operator goes on.
pub fn stop(text: &str) -> String {
    format!("#3006=1({})", short(text))
}

/// The variable with the skip position of an axis; none of another axis than X, Y and Z.
pub fn skipped(letter: &str) -> Option<String> {
    let place = ["X", "Y", "Z"].iter().position(|name| *name == letter)?;
    Some(format!("#{}", 5061 + place))
}

/// A move until the skip signal: `skip` is the word for it.
pub fn until_contact(skip: &str, words: &str, feed: &str) -> String {
    format!("{skip} {words} F{feed}")
}

/// The condition that a move of an axis was stopped before its end by more than [`STOPPED_MM`], given in the unit of the program.
pub fn was_stopped(skipped: &str, end: &str, stopped: &str) -> String {
    let end = if end.starts_with('#') { end.to_owned() } else { format!("[{end}]") };
    format!("[ABS[{skipped}-{end}] GT {stopped}]")
}

/// A move that nothing may stop: `axes` are letters and ends.
pub fn guarded(skip: &str, axes: &[(&str, String)], [feed, stopped]: [&str; 2], alarm: &str) -> Vec<String> {
    let words: Vec<String> = axes.iter().map(|(letter, end)| format!("{letter}{end}")).collect();
    let mut lines = vec![until_contact(skip, &words.join(" "), feed)];
    let watched = axes.iter().filter_map(|(letter, end)| Some((skipped(letter)?, end)));
    lines.extend(watched.map(|(skipped, end)| format!("IF {} THEN {alarm}", was_stopped(&skipped, end, stopped))));
    lines
}

/// The lines that refuse a work offset that is not zero: positions of a program are then those of the machine.
pub fn zero_offset(alarm: &str) -> Vec<String> {
    (1..=3).map(|axis| format!("IF [ABS[#502{axis}-#504{axis}] GT 0.001] THEN {alarm}")).collect()
}
