//! Errors as text and as JSON.

use std::fmt;
use std::path::Path;

use abbe_core::{Class, Error, harmless};
use miette::{
    Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, MietteError, MietteSpanContents, NamedSource,
    SourceCode, SourceSpan, SpanContents,
};
use serde_json::{Value, json};

/// An error with the text that it points into.
#[derive(Debug)]
struct Report {
    message: String,
    help: Option<String>,
    source: Option<NamedSource<Excerpt>>,
    span: Option<SourceSpan>,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Report {}

impl Diagnostic for Report {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.help.as_ref().map(|help| Box::new(help) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.source.as_ref().map(|source| source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let span = self.span?;
        Some(Box::new(std::iter::once(LabeledSpan::new_with_span(None, span))))
    }
}

/// The error for a terminal or a log: message, the place in the file, what to do.
pub fn text(error: &Error) -> String {
    let stage = error.stage.as_ref().map_or(String::new(), |stage| format!("stage `{stage}`: "));
    let message = format!("{stage}{}", error.message);
    let mut place_before = String::new();
    let (mut source, mut span) = (None, None);
    if let Some(place) = &error.place {
        let name = harmless(&place.file.display().to_string()).into_owned();
        match (place.line, place.line.and_then(|line| Excerpt::of(&place.file, line))) {
            (_, Some(excerpt)) => {
                span = Some(excerpt.span(place.column));
                source = Some(NamedSource::new(name, excerpt));
            }
            // The file is no text, does not exist, or has endless lines: the message has its place without an excerpt.
            (Some(line), None) => {
                let column = place.column.map_or_else(String::new, |column| format!("{column}:"));
                place_before = format!("{name}:{line}:{column} ");
            }
            (None, _) => place_before = format!("{name}: "),
        }
    }
    let report = Report {
        message: format!("{place_before}{}", readable(&message)),
        help: error.help.as_deref().map(readable),
        source,
        span,
    };
    let mut text = String::new();
    let colour = std::env::var_os("NO_COLOR").is_none() && std::io::IsTerminal::is_terminal(&std::io::stderr());
    let theme = if colour { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
    let handler = GraphicalReportHandler::new_themed(theme).with_width(120).with_context_lines(1);
    match handler.render_report(&mut text, &report) {
        Ok(()) => text,
        Err(_) => readable(&format!("{error}\n")),
    }
}

/// Characters of the longest word of a message, and of the longest space in it: names and cells from files may be longer.
const LONGEST_WORD: usize = 300;
const LONGEST_SPACE: usize = 40;

/// Characters of the longest message.
const LONGEST_MESSAGE: usize = 20_000;

/// The first characters of a text, and whether it has more.
fn cut(text: &str) -> (&str, bool) {
    match text.char_indices().nth(LONGEST_MESSAGE) {
        Some((end, _)) => (&text[..end], true),
        None => (text, false),
    }
}

/// Text from files and libraries as a person can read it: no characters that a terminal obeys, no endless words or spaces.
pub fn readable(text: &str) -> String {
    let mut shown = String::new();
    let harmless = harmless(text);
    let (mut rest, is_cut) = cut(&harmless);
    while !rest.is_empty() {
        let end = rest.find(|letter: char| !letter.is_whitespace()).unwrap_or(rest.len());
        let (space, after) = rest.split_at(end);
        let end = after.find(char::is_whitespace).unwrap_or(after.len());
        let (word, after) = after.split_at(end);
        shown.push_str(if space.chars().count() > LONGEST_SPACE { " " } else { space });
        match word.char_indices().nth(LONGEST_WORD) {
            Some((end, _)) => shown.push_str(&format!("{}...", &word[..end])),
            None => shown.push_str(word),
        }
        rest = after;
    }
    if is_cut {
        shown.push_str(" ...");
    }
    shown
}

/// Characters of the longest line that is shown.
const LONGEST_LINE: usize = 1000;

/// A line of a file, with the one before and the one after it.
#[derive(Debug)]
struct Excerpt {
    /// The lines, as a terminal may have them.
    text: String,
    /// The number of the first one, from 0.
    first: usize,
    /// Which of them is meant.
    meant: usize,
}

impl Excerpt {
    /// None if the file is no text, or if one of the lines is too long to be looked at.
    fn of(file: &Path, line: usize) -> Option<Self> {
        let text = abbe_files::read_text(file, abbe_files::LARGEST_RESULT).ok()?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let line = line.saturating_sub(1);
        let first = line.saturating_sub(1);
        let lines: Vec<&str> = lines(text).skip(first).take(2 + line - first).collect();
        let is_short = |line: &&str| line.chars().nth(LONGEST_LINE).is_none();
        if !lines.iter().all(is_short) {
            return None;
        }
        let text: String = lines.iter().map(|line| format!("{}\n", harmless(&without_password(line)))).collect();
        Some(Self { text, first, meant: line - first })
    }

    /// The span at a column of the line that is meant, to the end of the word.
    fn span(&self, column: Option<usize>) -> SourceSpan {
        span_at(&self.text, self.meant + 1, column)
    }
}

/// A line without the password of an address, wherever it stands in it. Logs and screenshots outlive what was corrected.
fn without_password(line: &str) -> String {
    let Some((before, address)) = line.split_once("://") else { return line.to_owned() };
    let of_user = address.rfind('@').unwrap_or(0);
    let user = address.find(':').filter(|colon| *colon < of_user);
    let mut shown = match user {
        Some(colon) => format!("{before}://{}:…{}", &address[..colon], &address[of_user..]),
        None => line.to_owned(),
    };
    if let Some(place) = shown.to_lowercase().find("password=")
        && shown.is_char_boundary(place + 9)
    {
        shown.replace_range(place + 9.., "…");
    }
    shown
}

/// Lines that end in LF, CRLF or CR.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    text.split_inclusive('\n').flat_map(|line| {
        let line = line.strip_suffix('\n').map_or(line, |line| line.strip_suffix('\r').unwrap_or(line));
        line.split('\r')
    })
}

impl SourceCode for Excerpt {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        lines_before: usize,
        lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let shown = self.text.read_span(span, lines_before, lines_after)?;
        let (line, column, count) = (shown.line() + self.first, shown.column(), shown.line_count());
        Ok(Box::new(MietteSpanContents::new(shown.data(), *shown.span(), line, column, count)))
    }
}

/// The span at a line and column, to the end of the word. Without a column it is the line.
fn span_at(text: &str, line: usize, column: Option<usize>) -> SourceSpan {
    let start: usize = text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
    let content = text[start..].lines().next().unwrap_or("");
    let Some(column) = column else { return (start, content.len()).into() };
    let from = content.char_indices().nth(column.saturating_sub(1)).map_or(content.len(), |(index, _)| index);
    let rest = &content[from..];
    let word = match rest.chars().next() {
        // A quoted text, to the closing quote; anything else to the end of the word.
        Some(quote @ ('"' | '\'')) => rest[1..].find(quote).map(|end| end + 2),
        Some('[' | '{') => Some(1),
        _ => rest.find([' ', ',', ':', '}', ']']),
    }
    .unwrap_or(rest.len());
    (start + from, word.max(1).min(content.len() - from)).into()
}

/// The error as one JSON object. Its message has at most [`LONGEST_MESSAGE`] characters.
pub fn json(error: &Error) -> Value {
    let place = error.place.as_ref();
    let bounded = |text: &str| match cut(text) {
        (start, true) => format!("{start} ..."),
        (whole, false) => whole.to_owned(),
    };
    json!({ "error": {
        "class": match error.class { Class::Use => "use", Class::Data => "data", Class::Interrupted => "interrupted" },
        "message": bounded(&error.message),
        "help": error.help.as_deref().map(bounded),
        "stage": error.stage,
        "file": place.map(|place| place.file.display().to_string()),
        "line": place.and_then(|place| place.line),
        "column": place.and_then(|place| place.column),
        "convergence": error.convergence,
    } })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_excerpt_has_no_password() {
        for (line, shown) in [
            ("history: postgres://me:secret@plant/abbe", "history: postgres://me:…@plant/abbe"),
            ("history: postgres://me:a@b:secret@plant/abbe", "history: postgres://me:…@plant/abbe"),
            (
                "history: postgres://plant/abbe?user=me&password=secret",
                "history: postgres://plant/abbe?user=me&password=…",
            ),
            ("history: postgres://plant:5433/abbe", "history: postgres://plant:5433/abbe"),
            ("name: a: b@c", "name: a: b@c"),
        ] {
            assert_eq!(without_password(line), shown);
        }
    }

    #[test]
    fn messages_are_readable() {
        let message = "stage `fit`: a message\n  with lines  ";
        assert_eq!(readable(message), message);
        assert_eq!(readable(&format!("a{}b", "\n".repeat(1000))), "a b");
        assert_eq!(readable(&"x".repeat(1000)), format!("{}...", "x".repeat(300)));
        let long = readable(&"word ".repeat(100_000));
        assert!(long.len() < 21_000 && long.ends_with(" ..."));
        assert_eq!(readable("\u{1b}[2J"), "␛[2J");
        let long = json(&Error::usage("word ".repeat(100_000)).help("x".repeat(100_000)));
        for text in ["message", "help"] {
            assert!(long["error"][text].as_str().is_some_and(|text| text.len() < 21_000 && text.ends_with(" ...")));
        }
    }

    #[test]
    fn lines_end_as_files_have_them() {
        assert_eq!(lines("a\nb\r\nc\rd").collect::<Vec<_>>(), ["a", "b", "c", "d"]);
        assert_eq!(lines("a\r\r\nb\r\rc\n").collect::<Vec<_>>(), ["a", "", "b", "", "c"]);
    }
}
