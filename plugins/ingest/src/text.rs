//! Ingest plugin `text`: logs whose lines a pattern describes.
//!
//! Controls and other programs write free text. A regular expression with named groups says what a line of it looks like; a
//! group is a column, with its unit in its name as in a table.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use abbe_core::{
    ColumnHeader, Context, Dataset, Error, Ingest, InputFile, Label, PathItem, Result, RowOrigin, SettingsError, Values,
};
use abbe_table::{Decimal, Encoding, Unit};
use regex_lite::Regex;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use abbe_assembly::{Assembly, Filters, Join, Paths};

/// Measurements in lines of text.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The file or files, as of `ingest: csv`.
    path: Paths,
    /// What a whole line with a measurement looks like: a regular expression. Its named groups are the columns:
    /// `(?<X_mm>\S+)`. Space at both ends of a line does not count.
    line: String,
    /// Lines whose named groups hold for all measurements below, up to the next such line: a line with the angles of the
    /// rotary axes, the number of a tool.
    #[serde(default)]
    headings: Vec<String>,
    /// Other lines that may be there. Empty lines may; any other line is an error.
    #[serde(default)]
    skip: Vec<String>,
    /// The line behind which the measurements begin: what stands before it may be anything.
    begins_after: Option<String>,
    /// The line before which the measurements end: what stands behind it may be anything.
    ends_before: Option<String>,
    /// Units in which numbers are written, by column, where it is another one than that of the name of the column.
    #[serde(default)]
    units: BTreeMap<String, String>,
    /// The character before the decimals of all numbers.
    #[serde(default)]
    decimal: Decimal,
    /// How the characters of the files are stored.
    #[serde(default)]
    encoding: Encoding,
    /// As of `ingest: csv`.
    #[serde(default)]
    constants: BTreeMap<String, Label>,
    /// As of `ingest: csv`: the plan of the touches, looked up by their numbers.
    join: Option<Join>,
    /// As of `ingest: csv`.
    #[serde(default)]
    ignore: Filters,
    /// As of `ingest: csv`.
    #[serde(default)]
    keep: Filters,
}

abbe_core::register!(
    Ingest,
    "text",
    "reads logs whose lines a pattern describes",
    Settings,
    example,
    build,
    "../reference/ingest-text.md",
);

fn example() -> Value {
    json!({
        "path": "touches.txt",
        "headings": ["INDEX B(?<B_deg>\\S+) C(?<C_deg>\\S+)"],
        "line": "T(?<touch>\\d+) X(?<X_mm>\\S+) Y(?<Y_mm>\\S+) Z(?<Z_mm>\\S+)",
        "skip": ["%", "\\(.*\\)"],
        "units": { "X_mm": "in" }
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    let lines = Lines::new(&settings)?;
    let Settings { path, constants, join, ignore, keep, .. } = settings;
    let assembly = Assembly::new(path, constants, join, [ignore, keep], context)?;
    Ok(Box::new(Text { lines, assembly }))
}

struct Text {
    lines: Lines,
    assembly: Assembly,
}

impl Ingest for Text {
    fn inputs(&self) -> Vec<InputFile> {
        self.assembly.inputs()
    }

    fn is_of_tables(&self) -> bool {
        false
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        Ok(self.assembly.without_rows(&|path| Ok(self.lines.empty(path)))?.headers())
    }

    fn read(&self) -> Result<Dataset> {
        self.assembly.read(&|path| {
            let text = abbe_table::read_text_in(path, self.lines.encoding)?;
            self.lines.read(path, &text)
        })
    }
}

/// Most patterns under one setting: more is a mistake.
const MOST_PATTERNS: usize = 100;

/// What lines look like.
#[derive(Debug)]
pub(crate) struct Lines {
    line: Regex,
    headings: Vec<Regex>,
    skip: Vec<Regex>,
    begins_after: Option<Regex>,
    ends_before: Option<Regex>,
    columns: Vec<LineColumn>,
    decimal: Decimal,
    encoding: Encoding,
}

/// A column: a group of the line or of a heading.
#[derive(Debug)]
struct LineColumn {
    header: ColumnHeader,
    unit: Option<Unit>,
}

impl Lines {
    fn new(settings: &Settings) -> Result<Self, SettingsError> {
        let line = pattern("line", &settings.line)?;
        let headings = patterns("headings", &settings.headings)?;
        let mut columns: Vec<LineColumn> = Vec::new();
        let of_line = groups(&line);
        if of_line.is_empty() {
            let message = "no named group: `(?<X_mm>\\S+)` makes the column `X_mm` of what it matches";
            return Err(SettingsError::new("line", message));
        }
        let of_headings = headings.iter().map(groups).collect::<Vec<_>>();
        if let Some(index) = of_headings.iter().position(Vec::is_empty) {
            let message = "no named group; a line without one belongs under `skip`";
            let mut error = SettingsError::new("headings", message);
            error.path.push(PathItem::Index(index));
            return Err(error);
        }
        let own = of_line.into_iter().map(|name| ("line", name));
        // Several headings may give one column: each form of a heading sets it.
        let above: BTreeSet<String> = of_headings.into_iter().flatten().collect();
        for (setting, name) in own.chain(above.into_iter().map(|name| ("headings", name))) {
            let header = ColumnHeader::parse(&name);
            if let Some(twin) = columns.iter().find(|column| column.header.name == header.name) {
                let message =
                    format!("two groups give the column `{}`: `{}` and `{name}`", header.name, twin.header.header);
                return Err(SettingsError::new(setting, message));
            }
            let wrong = |message| SettingsError::new(&name, message).under([PathItem::Key("units".to_owned())]);
            let unit = settings.units.get(&name).map(|unit| Unit::of(unit, &header).map_err(wrong)).transpose()?;
            columns.push(LineColumn { header, unit });
        }
        if let Some(unknown) = settings.units.keys().find(|name| !columns.iter().any(|it| it.header.header == **name)) {
            let names: Vec<&str> = columns.iter().map(|column| column.header.header.as_str()).collect();
            let message = format!("no group has this name; the groups are {}", names.join(", "));
            return Err(SettingsError::new(unknown, message).under([PathItem::Key("units".to_owned())]));
        }
        let one = |setting, written: &Option<String>| written.as_ref().map(|it| pattern(setting, it)).transpose();
        Ok(Self {
            line,
            headings,
            skip: patterns("skip", &settings.skip)?,
            begins_after: one("begins_after", &settings.begins_after)?,
            ends_before: one("ends_before", &settings.ends_before)?,
            columns,
            decimal: settings.decimal,
            encoding: settings.encoding,
        })
    }

    /// The columns without rows.
    fn empty(&self, path: &Path) -> Dataset {
        let columns = self.columns.iter().map(|column| abbe_table::empty_column(column.header.clone())).collect();
        Dataset { columns, files: vec![path.to_owned()], ..Dataset::default() }
    }

    /// The rows of a text.
    fn read(&self, path: &Path, text: &str) -> Result<Dataset> {
        let mut data = self.empty(path);
        let mut above: BTreeMap<&str, &str> = BTreeMap::new();
        for (line, written) in self.measured(path, text)? {
            let content = written.trim();
            let heading = || self.headings.iter().find_map(|heading| Some((heading, heading.captures(content)?)));
            if let Some(groups) = self.line.captures(content) {
                let indent = written.chars().take_while(|letter| letter.is_whitespace()).count();
                self.add_row(&mut data, &Found { path, line, indent, content, groups, above: &above })?;
            } else if let Some((heading, groups)) = heading() {
                let names = heading.capture_names().flatten();
                // A group that matches nothing has no value below: the one above does not go on.
                for name in names {
                    match groups.name(name) {
                        Some(found) => above.insert(name, found.as_str()),
                        None => above.remove(name),
                    };
                }
            } else if !content.is_empty() && !self.skip.iter().any(|skip| skip.is_match(content)) {
                return Err(no_line(content).at(path, line, Some(1)));
            }
        }
        match data.rows() {
            0 => Err(Error::data("no line of the file matches `line`").in_file(path)),
            _ => Ok(data),
        }
    }

    /// Numbered lines between the two marks.
    fn measured<'a>(&self, path: &Path, text: &'a str) -> Result<Vec<(usize, &'a str)>> {
        let all: Vec<(usize, &str)> = text.lines().enumerate().map(|(index, line)| (index + 1, line)).collect();
        let place = |setting: &str, mark: &Option<Regex>, from: usize| {
            let Some(mark) = mark else { return Ok(None) };
            let found = all[from..].iter().position(|(_, line)| mark.is_match(line.trim()));
            let missing = || Error::data(format!("no line matches `{setting}`: `{mark}`")).in_file(path);
            found.map(|place| Some(from + place)).ok_or_else(missing)
        };
        let first = place("begins_after", &self.begins_after, 0)?.map_or(0, |mark| mark + 1);
        let end = place("ends_before", &self.ends_before, first)?.unwrap_or(all.len());
        Ok(all[first..end].to_vec())
    }

    /// Adds the measurement of a line.
    fn add_row(&self, data: &mut Dataset, row: &Found<'_>) -> Result<()> {
        for (column, cells) in self.columns.iter().zip(&mut data.columns) {
            let name = column.header.header.as_str();
            let own = row.groups.name(name);
            let cell = own.map(|found| found.as_str()).or_else(|| row.above.get(name).copied()).ok_or_else(|| {
                let is_own = self.line.capture_names().flatten().any(|group| group == name);
                let message = match is_own {
                    true => format!("`{name}` has no value: its group matches nothing in this line"),
                    false => format!("`{name}` has no value: no heading above this line has it"),
                };
                let help = "correct the log, or declare such lines under `skip`";
                Error::data(message).at(row.path, row.line, Some(1)).help(help)
            })?;
            match &mut cells.values {
                Values::Labels(labels) => labels.push(cell.trim().into()),
                Values::Numbers(numbers) => {
                    let column_of = || own.map(|found| row.indent + row.content[..found.start()].chars().count() + 1);
                    let number = abbe_table::number_in(name, cell, column.unit, self.decimal);
                    numbers.push(number.map_err(|message| Error::data(message).at(row.path, row.line, column_of()))?);
                }
            }
        }
        let row_number = data.origins.len() + 1;
        data.origins.push(RowOrigin { file: 0, line: row.line, row: row_number });
        Ok(())
    }
}

/// A line with a measurement.
struct Found<'a> {
    path: &'a Path,
    /// Its number, from 1.
    line: usize,
    /// Space before its content.
    indent: usize,
    content: &'a str,
    groups: regex_lite::Captures<'a>,
    /// What the headings above it say.
    above: &'a BTreeMap<&'a str, &'a str>,
}

/// Letters of a line that a message shows.
const SHOWN: usize = 60;

fn no_line(content: &str) -> Error {
    let more = if content.chars().nth(SHOWN).is_some() { "..." } else { "" };
    let shown: String = content.chars().take(SHOWN).collect();
    Error::data(format!("`{shown}{more}` is no line of this log")).help(
        "`line` has to match a whole line; `skip` lists what else may be there, `headings` what holds for the lines below",
    )
}

/// The names of the groups of a pattern.
fn groups(pattern: &Regex) -> Vec<String> {
    pattern.capture_names().flatten().map(str::to_owned).collect()
}

/// A pattern for a whole line.
fn pattern(setting: &str, written: &str) -> Result<Regex, SettingsError> {
    Regex::new(&format!("^(?:{written})$")).map_err(|error| {
        // The library draws the place over several lines; the last one says what is wrong.
        let reason = error.to_string();
        let reason = reason.lines().last().unwrap_or_default().trim().trim_start_matches("error: ").to_owned();
        SettingsError::new(setting, format!("`{written}` is no regular expression: {reason}"))
    })
}

fn patterns(setting: &str, written: &[String]) -> Result<Vec<Regex>, SettingsError> {
    if written.len() > MOST_PATTERNS {
        return Err(SettingsError::new(setting, format!("{} patterns; at most {MOST_PATTERNS} do", written.len())));
    }
    let numbered = written.iter().enumerate();
    numbered
        .map(|(index, written)| {
            pattern(setting, written).map_err(|mut error| {
                error.path.push(PathItem::Index(index));
                error
            })
        })
        .collect()
}

#[cfg(test)]
mod tests;
