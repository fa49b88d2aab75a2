//! Errors as text and as JSON.

use std::fmt;
use std::fs;

use abbe_core::{Class, Error};
use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, LabeledSpan, NamedSource, SourceCode, SourceSpan};
use serde_json::{Value, json};

/// An error with the text that it points into.
#[derive(Debug)]
struct Report {
    message: String,
    help: Option<String>,
    source: Option<NamedSource<String>>,
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
    let mut message = format!("{stage}{}", error.message);
    let (mut source, mut span) = (None, None);
    if let Some(place) = &error.place {
        let name = place.file.display().to_string();
        match (place.line, fs::read_to_string(&place.file)) {
            (Some(line), Ok(text)) => {
                span = Some(span_at(&text, line, place.column));
                source = Some(NamedSource::new(name, text));
            }
            // The file is no text or does not exist: the message has its place without an excerpt.
            (Some(line), Err(_)) => message = format!("{name}:{line}: {message}"),
            (None, _) => message = format!("{name}: {message}"),
        }
    }
    let report = Report { message, help: error.help.clone(), source, span };
    let mut text = String::new();
    let colour = std::env::var_os("NO_COLOR").is_none() && std::io::IsTerminal::is_terminal(&std::io::stderr());
    let theme = if colour { GraphicalTheme::unicode() } else { GraphicalTheme::unicode_nocolor() };
    let handler = GraphicalReportHandler::new_themed(theme).with_width(120).with_context_lines(1);
    match handler.render_report(&mut text, &report) {
        Ok(()) => text,
        Err(_) => format!("{error}\n"),
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

/// The error as one JSON object.
pub fn json(error: &Error) -> Value {
    let place = error.place.as_ref();
    json!({ "error": {
        "class": match error.class { Class::Use => "use", Class::Data => "data", Class::Interrupted => "interrupted" },
        "message": error.message,
        "help": error.help,
        "stage": error.stage,
        "file": place.map(|place| place.file.display().to_string()),
        "line": place.and_then(|place| place.line),
        "column": place.and_then(|place| place.column),
        "convergence": error.convergence,
    } })
}
