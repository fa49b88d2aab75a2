//! The words of controls that programs with a touch probe are made of: moves that the probe guards, touches, alarms and stops. The programs
//! of plans (`controls`) and those of rapid verification (`plugins/rapid-verify`) write the same ones.

pub mod fanuc;
pub mod siemens;

/// A number with at most so many decimals, and at least one.
///
/// ```
/// assert_eq!(abbe_measuring::language::number(-12.5, 4), "-12.5");
/// assert_eq!(abbe_measuring::language::number(3.0, 4), "3.0");
/// ```
pub fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = text.trim_end_matches('0');
    let text = if text.ends_with('.') { format!("{text}0") } else { text.to_owned() };
    if text == "-0.0" { "0.0".to_owned() } else { text }
}

/// Text in letters that every control shows: letters, digits and few signs.
pub fn plain(text: &str) -> String {
    let shown = |letter: char| letter.is_ascii_alphanumeric() || " +-.,:".contains(letter);
    text.chars().map(|letter| if shown(letter) { letter } else { ' ' }).collect()
}
