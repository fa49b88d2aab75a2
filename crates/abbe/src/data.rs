//! `abbe data`: what is understood of data files, and which settings a file seems to need.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use abbe_core::{ColumnHeader, Error, Quantity, Result, Values, from_settings};
use abbe_engine::{Understood, prepare};
use abbe_table::{Contents, Decimal, Declared, Found, Layout, Likely, Separator, Summary, Thousands, contents, likely};
use clap::Args;

use crate::libraries::Libraries;
use crate::lines::{self, counted};
use crate::table::{self, plain};

/// What is asked.
#[derive(Debug, Args)]
pub struct Data {
    /// Data files, or recipes (`.yaml`) whose data are shown as their settings read them.
    #[arg(required = true, value_name = "FILE|RECIPE")]
    files: Vec<PathBuf>,
}

impl Data {
    /// Looks at the files; gives what to print.
    pub fn run(&self, libraries: &Libraries) -> Result<String> {
        let mut parts = Vec::new();
        for file in &self.files {
            let is_recipe = file.extension().is_some_and(|extension| extension == "yaml" || extension == "yml");
            match is_recipe {
                true => parts.push(of_recipe(file, libraries)?),
                false => parts.push(of_file(file)?),
            }
        }
        Ok(parts.join("\n"))
    }
}

/// A file or a stage with nothing to look at is an error, as it is for a run.
fn some_rows(file: &Path, told: &Contents) -> Result<()> {
    let (message, help) = match (told.columns.is_empty(), told.rows) {
        (true, _) => ("the file is empty", "a row with the names of the columns was expected, and rows of data"),
        (false, 0) => ("the file has names of columns, and no rows of data", "each row needs a line of its own"),
        _ => return Ok(()),
    };
    Err(Error::data(message).in_file(file).help(help))
}

/// A file by itself: what it seems to be.
fn of_file(file: &Path) -> Result<String> {
    let found = likely(file)?;
    let told = contents(file, &found.layout)?;
    some_rows(file, &told)?;
    let width = lines::width();
    let mut text = format!("{}\n", file.display());
    text.push_str(&layout_lines(&found.layout, &told));
    let mut rows = vec![["column", "holds", "from", "to", "missing", "unit"].map(str::to_owned).to_vec()];
    rows.extend(told.columns.iter().map(column_of_file));
    let _ = write!(text, "\nColumns\n{}", table::within(&rows, &[2, 3], 1, width));
    text.push_str(&first_rows(&told, width));
    text.push_str(&lines::wrapped(&faults(&told), width));
    match abbe_table::read(file) {
        Ok(data) if is_understood(&told, &found.layout) => {
            let rows = counted(data.rows(), "row", "rows");
            let _ = writeln!(text, "\n`ingest: csv` reads this file as it is: {rows}");
        }
        Ok(_) => {
            let read = "`ingest: csv` reads this file as it is, but columns without a unit in their names as labels.";
            let _ = write!(text, "\n{}", lines::wrapped(read, width));
            text.push_str(&settings(file, &found, &told));
        }
        Err(error) => {
            let read = format!("`ingest: csv` does not read this file as it is: {}", bare(&error));
            let _ = write!(text, "\n{}", lines::wrapped(&read, width));
            text.push_str(&settings(file, &found, &told));
        }
    }
    for open in &found.open {
        text.push_str(&lines::wrapped(&format!("  ? {open}"), width));
    }
    Ok(text)
}

/// An error with its line, without the file that stands above.
fn bare(error: &Error) -> String {
    let line = error.place.as_ref().and_then(|place| place.line);
    line.map_or_else(|| error.message.clone(), |line| format!("line {line}: {}", error.message))
}

/// Whether every column that holds numbers is one of numbers by its name.
fn is_understood(told: &Contents, layout: &Layout) -> bool {
    let is_number = |column: &Found| ColumnHeader::parse(&column.name).quantity != Quantity::Label;
    // A thousand with a separator is no label.
    let counts = |column: &Found| {
        layout.thousands == Thousands::None
            && column.range.is_some_and(|ends| ends.iter().all(|end| end.fract() == 0.0))
    };
    told.columns.iter().all(|column| !column.is_numeric() || counts(column) || is_number(column))
}

fn layout_lines(layout: &Layout, told: &Contents) -> String {
    let mut lines = vec![
        ("encoding", layout.encoding.name().to_owned()),
        ("separator", format!("{}, {} columns", layout.separator.name(), told.columns.len())),
        ("decimal mark", layout.decimal.name().to_owned()),
    ];
    if layout.thousands != Thousands::None {
        lines.push(("thousands", layout.thousands.name().to_owned()));
    }
    let some = |count: usize, one, several| (count > 0).then(|| counted(count, one, several));
    let titles = some(layout.skip_lines, "line before it", "lines before it");
    let units = some(layout.skip_after_header, "row between it and the data", "rows between it and the data");
    let around: Vec<String> = [titles, units].into_iter().flatten().collect();
    let around = if around.is_empty() { String::new() } else { format!(" ({})", around.join(", ")) };
    lines.push(match told.header_line {
        Some(line) => ("header row", format!("line {line}{around}")),
        None => ("header row", format!("none{around}")),
    });
    let (first, last) = told.lines;
    let rows = match told.rows {
        0 => "none".to_owned(),
        1 => format!("1 (line {first})"),
        rows => format!("{rows} (lines {first} to {last})"),
    };
    lines.push(("rows", rows));
    if told.comments > 0 {
        let comments = counted(told.comments, "line that begins with #", "lines that begin with #");
        lines.push(("comments", format!("{comments}, left out")));
    }
    let rows: Vec<Vec<String>> = lines.into_iter().map(|(name, value)| vec![name.to_owned(), value]).collect();
    table::text(&rows, &[])
}

/// Characters that are shown of a cell.
const LONGEST: usize = 60;

/// The beginning of a long cell.
fn cut(cell: &str) -> String {
    match cell.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &cell[..end]),
        None => cell.to_owned(),
    }
}

/// Marks or labels that are shown of a column.
const SHOWN: usize = 3;

fn column_of_file(column: &Found) -> Vec<String> {
    let [from, to] =
        column.range.filter(|_| column.is_numeric()).map_or([String::new(), String::new()], |ends| ends.map(plain));
    let marks = column.marks();
    let quoted = |(mark, count): &(&str, usize)| match mark.is_empty() {
        true => format!("{count} empty"),
        false => format!("{count} `{mark}`"),
    };
    let missing: Vec<String> = match column.is_numeric() {
        true => marks.iter().take(SHOWN).map(quoted).collect(),
        false => marks.iter().filter(|(mark, _)| mark.is_empty()).map(quoted).collect(),
    };
    let header = ColumnHeader::parse(&column.name);
    let (holds, unit) = match (column.is_numeric(), header.quantity) {
        (true, Quantity::Label) => ("numbers".to_owned(), "none in its name".to_owned()),
        (true, quantity) => ("numbers".to_owned(), written_unit(&header, quantity)),
        (false, Quantity::Label) => (labels(column), String::new()),
        (false, quantity) => (labels(column), format!("{}, but it holds no numbers", written_unit(&header, quantity))),
    };
    vec![cut(&column.name), holds, from, to, missing.join(", "), unit]
}

fn labels(column: &Found) -> String {
    let some: Vec<String> = column.texts.keys().take(SHOWN).map(|text| cut(text)).collect();
    match column.texts.len() {
        0 => "nothing".to_owned(),
        count if count > some.len() => format!("{count} labels: {}, ...", some.join(", ")),
        _ => format!("labels: {}", some.join(", ")),
    }
}

/// The unit in a name, as people write it.
fn written_unit(header: &ColumnHeader, quantity: Quantity) -> String {
    let suffix = header.header.strip_prefix(&header.name).unwrap_or_default().trim_start_matches('_');
    match suffix {
        "" if quantity == Quantity::Ratio => "1".to_owned(),
        "um" => "µm".to_owned(),
        "urad" => "µrad".to_owned(),
        "um_per_m" => "µm/m".to_owned(),
        "deg" => "°".to_owned(),
        "degC" => "°C".to_owned(),
        "rpm" => "1/min".to_owned(),
        other => other.replace("_per_", "/").replace("per_", "1/"),
    }
}

fn first_rows(told: &Contents, width: usize) -> String {
    let mut rows = vec![told.columns.iter().map(|column| cut(&column.name)).collect::<Vec<_>>()];
    rows.extend(told.first.iter().map(|row| row.iter().map(|cell| cut(cell)).collect()));
    let all: Vec<usize> = (0..told.columns.len()).collect();
    format!("\nFirst rows\n{}", table::within(&rows, &all, 0, width))
}

/// Places that are told of each kind of fault.
const PLACES: usize = 4;

fn faults(told: &Contents) -> String {
    let mut lines = Vec::new();
    let places = |all: Vec<String>| match all.len() > PLACES {
        true => format!("{}, ...", all[..PLACES].join(", ")),
        false => all.join(", "),
    };
    if !told.ragged.is_empty() {
        let all = told.ragged.iter().map(|(line, cells)| format!("line {line} has {cells}")).collect();
        lines.push(format!(
            "{} another number of cells than {}: {}; no setting mends that, and a run refuses it: correct the file (a separator \
             is missing there or one too many, or a text with one in it is not quoted)",
            counted(told.ragged.len(), "row has", "rows have"),
            told.columns.len(),
            places(all)
        ));
    }
    if told.header_line.is_none() && told.lines == (1, 1) {
        lines.push("the file is one line: each row needs a line of its own, and so has the header row".to_owned());
    }
    for name in &told.twins {
        lines.push(format!(
            "several columns are named `{name}`, so that no setting can name one of them: give them other names in the file, or \
             take all columns by number (`header: false`, the header row among `skip_lines`, `columns: {{ X_mm: 1 }}`)"
        ));
    }
    if !told.repeated.is_empty() {
        let all = told.repeated.iter().map(|(one, other)| format!("lines {one} and {other}")).collect();
        lines.push(format!("{} there twice: {}", counted(told.repeated.len(), "row is", "rows are"), places(all)));
    }
    lines.extend(summaries(told));
    let (back, jumps): (Vec<_>, Vec<_>) = told.jumps.iter().partition(|jump| jump.step < 0.0);
    for (what, found) in [("goes back", back), ("jumps", jumps)] {
        let Some(first) = found.first() else { continue };
        let all = found.iter().map(|jump| format!("by {} at line {}", plain(jump.step), jump.line)).collect();
        lines.push(format!("{} {what} (its usual step is {}): {}", first.column, plain(first.usual), places(all)));
    }
    let mut text = match lines.is_empty() {
        true => "\nNo gaps, jumps of time or rows that are there twice\n".to_owned(),
        false => format!("\nTo look at\n{}", lines.iter().map(|line| format!("  {line}\n")).collect::<String>()),
    };
    for name in &told.other_times {
        let _ = writeln!(text, "  Not looked at: order and steps of `{name}`; the time of rows is a column `time_s`");
    }
    text
}

/// Rows of sums and means at the end, with the setting that leaves them out, by the column of the word that says so.
fn summaries(told: &Contents) -> Vec<String> {
    let of_column = |rows: &[Summary]| {
        let column = &told.columns[rows[0].column];
        let at: Vec<String> = rows.iter().map(|row| format!("line {} (`{}`)", row.line, row.word)).collect();
        let words: Vec<String> = rows.iter().map(|row| quoted(&row.word)).collect();
        let setting = match column.is_numeric() {
            true => format!("`no_data: [{}]`", words.join(", ")),
            false => format!(
                "`ignore: {{ NAME: [{}] }}`, with the name that you give to column `{}`,",
                words.join(", "),
                column.name
            ),
        };
        format!(
            "{} seems to hold sums or means of the rows above, and no measurement: {setting} leaves it out",
            at.join(", ")
        )
    };
    told.summaries.chunk_by(|one, other| one.column == other.column).map(of_column).collect()
}

/// The settings that the file seems to need, to be copied into a recipe.
fn settings(file: &Path, found: &Likely, told: &Contents) -> String {
    let layout = &found.layout;
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let mut text = "It seems to need these settings; names and units are yours to say:\n\n".to_owned();
    // Columns of the same name can be told apart by their numbers alone.
    let by_number = !layout.has_header || !told.twins.is_empty();
    let skipped = told.header_line.filter(|_| by_number).unwrap_or(layout.skip_lines);
    let _ = writeln!(text, "  ingest: csv\n  path: {}", quoted(&name));
    let defaults = Layout::default();
    let mut line = |key: &str, value: String, is_other: bool| {
        if is_other {
            let _ = writeln!(text, "  {key}: {value}");
        }
    };
    line("separator", layout.separator.name().to_owned(), layout.separator != Separator::Comma);
    line("decimal", layout.decimal.name().to_owned(), layout.decimal != Decimal::Point);
    line("thousands", layout.thousands.name().to_owned(), layout.thousands != Thousands::None);
    line("encoding", layout.encoding.name().to_owned(), layout.encoding != defaults.encoding);
    line("skip_lines", skipped.to_string(), skipped > 0);
    line("skip_after_header", layout.skip_after_header.to_string(), layout.skip_after_header > 0);
    line("header", "false".to_owned(), by_number);
    let marks: Vec<String> = layout.no_data.iter().map(|mark| quoted(mark)).collect();
    line("no_data", format!("[{}]", marks.join(", ")), !marks.is_empty());
    if is_understood(told, layout) && !by_number {
        return text;
    }
    text.push_str("  columns:\n");
    for (index, column) in told.columns.iter().enumerate() {
        let header = ColumnHeader::parse(&column.name);
        let source = if by_number { (index + 1).to_string() } else { quoted(&column.name) };
        let _ = match (column.is_numeric(), header.quantity) {
            (true, Quantity::Label) => writeln!(text, "    NAME_UNIT: {source}"),
            (_, Quantity::Label) => writeln!(text, "    NAME: {source}"),
            _ => writeln!(text, "    {}: {source}", header.header),
        };
    }
    text
}

/// A text as YAML takes it.
fn quoted(text: &str) -> String {
    serde_json::to_string(text).unwrap_or_else(|_| text.to_owned())
}

/// The data of a recipe, as its settings read them.
fn of_recipe(recipe: &Path, libraries: &Libraries) -> Result<String> {
    let prepared = prepare(recipe, &libraries.registry(Some(recipe))?)?;
    let mut text = format!("{}\n", recipe.display());
    for stage in prepared.understood()? {
        let _ = write!(text, "\n{}", of_stage(&stage)?);
    }
    Ok(text)
}

fn of_stage(stage: &Understood) -> Result<String> {
    let data = &stage.data;
    let width = lines::width();
    let count = counted(data.rows(), "row", "rows");
    let mut text = format!("{} (ingest: {}): {count}\n", stage.stage, stage.plugin);
    let mut rows = vec![["column", "holds", "from", "to", "unit", "used as"].map(str::to_owned).to_vec()];
    for column in &data.columns {
        let (_, quantity, factor) = Quantity::of_column(&column.header.header);
        let role = stage.roles.get(&column.header.name).cloned().unwrap_or_default();
        let (holds, from, to) = match &column.values {
            Values::Numbers(numbers) => {
                let known = || numbers.iter().copied().filter(|number| number.is_finite());
                let ends = [known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max)];
                let [from, to] = ends.map(|end| if end.is_finite() { plain(end / factor) } else { String::new() });
                ("numbers".to_owned(), from, to)
            }
            Values::Labels(all) => {
                let mut column = Found::default();
                all.iter().for_each(|label| *column.texts.entry(label.to_string()).or_default() += 1);
                (labels(&column), String::new(), String::new())
            }
        };
        let unit = if quantity == Quantity::Label { String::new() } else { written_unit(&column.header, quantity) };
        rows.push(vec![column.header.header.clone(), holds, from, to, unit, role]);
    }
    text.push_str(&table::within(&rows, &[2, 3], 1, width));
    if let Some(repeated) = abbe_engine::repeated_in_words(data, data.row_indices()) {
        text.push_str(&lines::wrapped(&format!("  {repeated}"), width));
    }
    // What other plugins read has no layout of a table.
    if stage.plugin != "csv" {
        let files = stage.files.iter().map(|file| format!("\n  {}\n", file.display()));
        text.extend(files);
        return Ok(text);
    }
    let layout = from_settings::<Declared>(&stage.settings).and_then(Declared::layout).unwrap_or_default();
    for file in &stage.files {
        let told = contents(file, &layout)?;
        let kept = data.origins.iter().filter(|origin| data.files.get(origin.file) == Some(file)).count();
        let _ = write!(text, "\n  {}\n{}", file.display(), layout_lines(&layout, &told));
        if kept < told.rows && !data.averaged {
            let verb = if told.rows - kept == 1 { "is" } else { "are" };
            let all = counted(told.rows, "row", "rows");
            let _ = writeln!(text, "  {} of {all} {verb} left out by the settings", told.rows - kept);
        }
        text.push_str(&lines::wrapped(&faults(&told), width));
    }
    Ok(text)
}
