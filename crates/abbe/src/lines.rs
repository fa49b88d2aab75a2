//! Lines that fit a terminal.

use std::io;

/// Width of what is no terminal and where `COLUMNS` does not say it.
const WIDTH: usize = 120;

/// Narrower ones are taken as this.
const NARROWEST: usize = 40;

/// Columns of the terminal.
pub fn width() -> usize {
    let terminal = terminal_size::terminal_size_of(io::stdout()).map(|(width, _)| usize::from(width.0));
    let declared = || std::env::var("COLUMNS").ok().and_then(|columns| columns.trim().parse().ok());
    terminal.or_else(declared).unwrap_or(WIDTH).max(NARROWEST)
}

/// A line as lines that are no longer than `width`, cut between words; those that follow are indented by two more. A word that is
/// longer, as a path may be, stays whole.
pub fn rows(line: &str, width: usize) -> Vec<String> {
    if line.chars().count() <= width {
        return vec![line.to_owned()];
    }
    let indent: String = line.chars().take_while(|character| *character == ' ').collect();
    let mut rows = vec![indent.clone()];
    let mut is_begun = false;
    for word in line.split_whitespace() {
        let last = rows.len() - 1;
        if is_begun && rows[last].chars().count() + 1 + word.chars().count() > width {
            rows.push(format!("{indent}  {word}"));
            continue;
        }
        if is_begun {
            rows[last].push(' ');
        }
        rows[last].push_str(word);
        is_begun = true;
    }
    rows
}

/// A text whose lines are no longer than `width`.
pub fn wrapped(text: &str, width: usize) -> String {
    text.lines().flat_map(|line| rows(line, width)).fold(String::new(), |text, row| text + &row + "\n")
}

/// A line that fits.
pub fn cut(line: &str, width: usize) -> String {
    let line = line.replace('\n', " ");
    match line.chars().count() > width {
        true => line.chars().take(width.saturating_sub(1)).collect::<String>() + "…",
        false => line,
    }
}

/// The count with the word in the number that it asks for.
pub fn counted(count: usize, one: &str, several: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { several })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_fit_and_words_stay_whole() {
        assert_eq!(rows("  one two three four", 12), ["  one two", "    three", "    four"]);
        assert_eq!(rows("one", 12), ["one"]);
        assert_eq!(rows("", 12), [""]);
        assert_eq!(rows("  /a/very/long/path and more", 12), ["  /a/very/long/path", "    and more"]);
        assert_eq!(wrapped("a b\n\nc\n", 40), "a b\n\nc\n");
    }
}
