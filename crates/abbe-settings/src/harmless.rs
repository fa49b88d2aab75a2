//! Text from files and libraries, for terminals.

use std::borrow::Cow;

/// The text without what a terminal would obey and not show: control characters but line ends and tabs are shown as their
/// pictures (`␛` for the one that starts an escape sequence), and those that reverse the direction of writing as `\u{fffd}`.
///
/// ```
/// assert_eq!(abbe_settings::harmless("a\u{1b}[2Jb\n"), "a␛[2Jb\n");
/// ```
pub fn harmless(text: &str) -> Cow<'_, str> {
    if !text.chars().any(|letter| picture(letter) != letter) {
        return text.into();
    }
    text.chars().map(picture).collect()
}

/// The same for JSON, whose strings stay what they are: characters are written as escapes.
///
/// ```
/// assert_eq!(abbe_settings::harmless_json("{ \"a\": \"\u{9b}2J\" }"), r#"{ "a": "\u009b2J" }"#);
/// ```
pub fn harmless_json(json: &str) -> Cow<'_, str> {
    if !json.chars().any(|letter| picture(letter) != letter) {
        return json.into();
    }
    let mut text = String::with_capacity(json.len());
    for letter in json.chars() {
        match picture(letter) {
            same if same == letter => text.push(letter),
            // All that is dangerous is in the basic plane.
            _ => text.push_str(&format!("\\u{:04x}", u32::from(letter))),
        }
    }
    text.into()
}

fn picture(letter: char) -> char {
    match letter {
        '\n' | '\t' => letter,
        '\0'..='\u{1f}' => char::from_u32(0x2400 + u32::from(letter)).unwrap_or('\u{fffd}'),
        '\u{7f}' => '\u{2421}',
        // Control characters of 8 bits; marks and overrides of the direction of writing; line and paragraph separators.
        '\u{80}'..='\u{9f}'
        | '\u{61c}'
        | '\u{200e}'
        | '\u{200f}'
        | '\u{2028}'..='\u{202e}'
        | '\u{2066}'..='\u{2069}' => '\u{fffd}',
        _ => letter,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_left_that_a_terminal_obeys() {
        let all: String = (0..0x3000).filter_map(char::from_u32).collect();
        let (shown, json) = (harmless(&all), harmless_json(&all));
        assert!(shown.chars().all(|letter| !letter.is_control() || "\n\t".contains(letter)));
        assert!(json.chars().all(|letter| !letter.is_control() || "\n\t".contains(letter)));
        assert!(!shown.contains('\u{202e}') && !json.contains('\u{202e}'));
        // Letters stay, also of two bytes and more, and each picture takes the place of one character.
        assert_eq!(harmless("µm, 20 °C, Prüfstück"), "µm, 20 °C, Prüfstück");
        assert_eq!(shown.chars().count(), all.chars().count());
    }
}
