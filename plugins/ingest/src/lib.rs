//! Ingest of CSV files: many files give one data set, with columns set as constants or joined from a table.
//!
//! The columns, in this order: those of the first file; `file`, the name of the row's file without its extension
//! (always there, so that splitting a file in two changes no column; a `file` column of the files' own is kept
//! instead); the constants by name; the columns of the joined table. Only then are rows left out, so that `ignore` and
//! `keep` may name any of them, and every row needs a match in the joined table. Means (`average`) are those of the rows that stay.

mod average;
mod files;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use abbe_core::{
    Column, ColumnHeader, Context, DataRow, Dataset, Error, Ingest, InputFile, Label, PathItem, Result, RowOrigin,
    SettingsError, Values,
};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use abbe_table::{Decimal, Declared, Encoding, Layout, Separator, Thousands};
use average::Average;
use files::Source;

/// Measurements in CSV files.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The file or files, relative to the recipe. `*` and `?` in a file name stand for any characters and for one; the
    /// files that match come in natural order (`sphere-2` before `sphere-10`). Many files give one data set.
    path: Paths,
    /// What separates the columns of the files.
    #[serde(default)]
    separator: Separator,
    /// The character before the decimals of all numbers of the files.
    #[serde(default)]
    decimal: Decimal,
    /// What separates groups of three digits in the numbers of the files. Without it numbers with such separators are refused.
    #[serde(default)]
    thousands: Thousands,
    /// How the characters of the files are stored.
    #[serde(default)]
    encoding: Encoding,
    /// Lines before the header row: titles.
    #[serde(default)]
    #[schemars(range(max = 10000))]
    skip_lines: usize,
    /// Rows between the header row and the first row of data, for example one with units.
    #[serde(default)]
    #[schemars(range(max = 10000))]
    skip_after_header: usize,
    /// Whether there is a header row; without one `columns` numbers the columns.
    #[serde(default = "yes")]
    header: bool,
    /// What stands in the place of a number that was not measured. Rows with such a cell in a column of numbers are left out,
    /// and counted in a remark.
    #[serde(default)]
    no_data: Vec<Label>,
    /// The columns to take, all others are left out: name with unit, and the name that it has in the files.
    columns: Option<BTreeMap<String, abbe_table::Source>>,
    /// Columns with the same value in every row: name, with its unit where it has one, and value.
    #[serde(default)]
    constants: BTreeMap<String, Label>,
    /// A table with further columns, looked up by a label of each row.
    join: Option<Join>,
    /// Rows to leave out: column and the labels that mark them.
    #[serde(default)]
    ignore: Filters,
    /// Rows to take; all others are left out: column and the labels that mark them.
    #[serde(default)]
    keep: Filters,
    /// Take means of repeated rows, after `ignore` and `keep`.
    average: Option<Average>,
}

fn yes() -> bool {
    true
}

/// Columns and listed labels.
type Filters = BTreeMap<String, Vec<Label>>;

#[derive(Debug, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a path or a list of paths was expected")]
enum Paths {
    /// One path or pattern.
    One(String),
    /// Several.
    Many(Vec<String>),
}

#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Join {
    /// The CSV file of the table, relative to the recipe.
    table: String,
    /// The column that both have and whose labels are looked up; in the table each occurs once. For `file`, the table
    /// may write file names with or without their extension.
    on: String,
}

/// The stage.
struct Csv {
    sources: Vec<Source>,
    layout: Layout,
    constants: BTreeMap<String, Constant>,
    join: Option<(PathBuf, String)>,
    ignore: Filters,
    keep: Filters,
    average: Option<Average>,
}

enum Constant {
    Number(f64),
    Label(String),
}

abbe_core::register!(
    Ingest,
    "csv",
    "reads CSV files whose column names carry units",
    Settings,
    example,
    build,
    "../reference/ingest-csv.md",
);

fn example() -> Value {
    json!({
        "path": ["bar-*.csv"],
        "constants": { "cycle": 1, "T_degC": 20.5 },
        "join": { "table": "measurements.csv", "on": "file" },
        "ignore": { "point": [1, 2] },
        "keep": { "stylus": [1] },
        "average": { "over": "file", "by": ["point"] }
    })
}

fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    let paths = match settings.path {
        Paths::One(path) => vec![path],
        Paths::Many(paths) => paths,
    };
    if paths.is_empty() {
        return Err(SettingsError::new("path", "at least one file was expected").help("write `path: measured.csv`"));
    }
    let layout = Declared {
        separator: settings.separator,
        decimal: settings.decimal,
        thousands: settings.thousands,
        encoding: settings.encoding,
        skip_lines: settings.skip_lines,
        skip_after_header: settings.skip_after_header,
        header: settings.header,
        no_data: settings.no_data,
        columns: settings.columns,
    };
    let sources = paths.iter().map(|path| Source::new(path, context)).collect::<Result<_, _>>();
    Ok(Box::new(Csv {
        sources: sources.map_err(|message| SettingsError::new("path", message))?,
        layout: layout.layout()?,
        constants: constants(settings.constants)?,
        join: settings.join.map(|join| (context.path(&join.table), join.on)),
        ignore: settings.ignore,
        keep: settings.keep,
        average: settings.average,
    }))
}

fn constants(written: BTreeMap<String, Label>) -> Result<BTreeMap<String, Constant>, SettingsError> {
    let constant = |(name, Label(text)): (String, Label)| {
        let wrong = |message: String| SettingsError::new(&name, message).under([PathItem::Key("constants".to_owned())]);
        let header = ColumnHeader::parse(&name);
        if header.name.trim().is_empty() {
            return Err(wrong("a column needs a name".to_owned()).help("write its name and unit: `T_degC: 20`"));
        }
        let value = match abbe_table::empty_column(header).values {
            Values::Numbers(_) => Constant::Number(abbe_table::number(&name, &text).map_err(wrong)?),
            Values::Labels(_) => Constant::Label(text),
        };
        Ok((name, value))
    };
    written.into_iter().map(constant).collect()
}

impl Ingest for Csv {
    fn inputs(&self) -> Vec<InputFile> {
        let input = |setting| move |path| InputFile { setting, path };
        let files = self.sources.iter().flat_map(|source| match source.files() {
            files if files.is_empty() => vec![source.path.clone()],
            files => files,
        });
        let table = self.join.iter().map(|(table, _)| table.clone());
        files.map(input("path")).chain(table.map(input("join"))).collect()
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        // What `read` does, on tables without rows: so the columns cannot differ.
        let without_rows = |path: &Path, layout: &Layout| {
            let headers = abbe_table::read_headers_laid_out(path, layout)?;
            let columns = headers.into_iter().map(abbe_table::empty_column).collect();
            Ok(Dataset { columns, origins: Vec::new(), files: vec![path.to_owned()], averaged: false, is_log: false })
        };
        let data = self.assemble(&without_rows)?;
        Ok(match &self.average {
            Some(average) => average.of(&data)?.headers(),
            None => data.headers(),
        })
    }

    fn read(&self) -> Result<Dataset> {
        let data = self.assemble(&rows_of)?;
        let mut stays = vec![true; data.rows()];
        for (setting, filters, wanted) in self.filters() {
            for (name, listed) in filters {
                let labels = abbe_table::labels(&data, name)?;
                // A recipe may name rows that other data do not have.
                for label in listed.iter().filter(|label| !labels.contains(&label.0)) {
                    tracing::warn!("`{setting}` names {name} {}, which is in no row of these data", label.0);
                }
                for (stays, label) in stays.iter_mut().zip(labels) {
                    *stays &= listed.iter().any(|listed| listed.0 == *label) == wanted;
                }
            }
        }
        if !stays.contains(&true) {
            return Err(Error::data("no row is left after `ignore` and `keep`")
                .help("name other rows there; `abbe data RECIPE` shows the labels of the columns"));
        }
        let data = selected(data, &stays);
        match &self.average {
            Some(average) => average.of(&data),
            None => Ok(data),
        }
    }
}

impl Csv {
    /// The data set before rows are left out, from what `load` reads of each file.
    fn assemble(&self, load: &dyn Fn(&Path, &Layout) -> Result<Dataset>) -> Result<Dataset> {
        let mut data = Dataset::default();
        for source in &self.sources {
            let files = source.files();
            if files.is_empty() {
                return Err(Error::usage(format!("no file matches `{}`", source.path.display()))
                    .help("`*` and `?` stand for parts of the name of a file; the folder has to be there")
                    .setting("path"));
            }
            for file in files {
                append(&mut data, load(&file, &self.layout)?)?;
            }
        }
        let by_file = add_file_column(&mut data)?;
        for (name, constant) in &self.constants {
            let header = ColumnHeader::parse(name);
            if let Some(twin) = data.column(&header.name) {
                let message = format!("there is a column `{}` already", twin.header.header);
                let error = Error::usage(message).help("leave it out here: the files say it");
                return Err(in_settings(error, "constants", name));
            }
            let values = match constant {
                Constant::Number(number) => Values::Numbers(vec![*number; data.rows()]),
                Constant::Label(label) => Values::Labels(vec![label.clone(); data.rows()]),
            };
            data.columns.push(Column { header, values });
        }
        if let Some((path, on)) = &self.join {
            join(&mut data, &load(path, &Layout::default())?, on, by_file && on == "file")?;
        }
        for (setting, filters, _) in self.filters() {
            for name in filters.keys() {
                abbe_table::labels(&data, name).map_err(|error| in_settings(error, setting, name))?;
            }
        }
        Ok(data)
    }

    /// The settings that leave rows out, and whether a listed label means that the row stays.
    fn filters(&self) -> [(&'static str, &Filters, bool); 2] {
        [("ignore", &self.ignore, false), ("keep", &self.keep, true)]
    }
}

fn rows_of(path: &Path, layout: &Layout) -> Result<Dataset> {
    let (data, left_out) = abbe_table::read_laid_out(path, layout)?;
    if left_out > 0 {
        let [holds, are] = if left_out == 1 { ["row holds", "is"] } else { ["rows hold", "are"] };
        tracing::warn!("{}: {left_out} {holds} a mark of `no_data` and {are} left out", path.display());
    }
    Ok(data)
}

/// The error at a place of the settings instead of a file: the statement of the recipe about the file is wrong.
fn in_settings(error: Error, setting: &str, key: &str) -> Error {
    Error { place: None, setting: [setting, key].map(|key| PathItem::Key(key.to_owned())).into(), ..error }
}

/// Appends the rows of one file, which must have the same columns in any order.
fn append(data: &mut Dataset, mut part: Dataset) -> Result<()> {
    let Some(first) = data.files.first() else {
        *data = part;
        return Ok(());
    };
    let only = |this: &Dataset, other: &Dataset| {
        this.headers().into_iter().find(|header| !other.headers().contains(header)).map(|header| header.header)
    };
    let differ = |column: String, with: &Path, without: &Path| {
        Error::usage(format!("there is no column `{column}`, which `{}` has", with.display()))
            .in_file(without)
            .help("files of one stage have the same columns; read others by a stage of their own")
    };
    if let Some(path) = part.files.first() {
        if let Some(column) = only(data, &part) {
            return Err(differ(column, first, path));
        }
        if let Some(column) = only(&part, data) {
            return Err(differ(column, path, first));
        }
    }
    for column in &mut data.columns {
        let more = part.columns.iter_mut().find(|other| other.header == column.header);
        match (&mut column.values, more.map(|column| &mut column.values)) {
            (Values::Numbers(numbers), Some(Values::Numbers(more))) => numbers.append(more),
            (Values::Labels(labels), Some(Values::Labels(more))) => labels.append(more),
            // Columns of the same header hold the same kind of values.
            _ => {}
        }
    }
    let files = data.files.len();
    data.origins.extend(part.origins.into_iter().map(|origin| RowOrigin { file: origin.file + files, ..origin }));
    data.files.append(&mut part.files);
    Ok(())
}

/// Adds the column `file`; false if the files have one of their own.
fn add_file_column(data: &mut Dataset) -> Result<bool> {
    if data.column("file").is_some() {
        return Ok(false);
    }
    let mut stems: Vec<String> = Vec::new();
    for path in &data.files {
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        if let Some(twin) = stems.iter().position(|other| *other == stem) {
            let message = format!(
                "`{}` and `{}` would both be `{stem}` in the column `file`",
                data.files[twin].display(),
                path.display()
            );
            return Err(Error::usage(message).help("give one of them another name").setting("path"));
        }
        stems.push(stem);
    }
    let labels = data.origins.iter().map(|origin| stems[origin.file].clone()).collect();
    data.columns.push(Column { header: ColumnHeader::parse("file"), values: Values::Labels(labels) });
    Ok(true)
}

/// Adds the columns of a table, by the label that each row has in the column `on`; `by_file`: the label is the name of
/// its file, which the table may write with the extension.
fn join(data: &mut Dataset, table: &Dataset, on: &str, by_file: bool) -> Result<()> {
    let keys = abbe_table::unique_labels(table, on)?;
    let labels = abbe_table::labels(data, on).map_err(|error| in_settings(error, "join", "on"))?;
    let path = table.files.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
    let mut rows = Vec::new();
    for (row, (label, origin)) in DataRow::enumerate(labels.iter().zip(&data.origins)) {
        let name = data.files[origin.file].file_name().and_then(|name| name.to_str()).filter(|_| by_file);
        match keys.get(label.as_str()).or_else(|| keys.get(name?)) {
            Some(&found) => rows.push(found),
            None => {
                let error = data.error_at(row, format!("{on} `{label}` is not in the table `{}`", path.display()));
                return Err(error.help("add a row for it to the table, or leave these rows out by `ignore`"));
            }
        }
    }
    for column in table.columns.iter().filter(|column| column.header.name != on) {
        if let Some(twin) = data.column(&column.header.name) {
            let message = format!("the column `{}` is in the data already", twin.header.header);
            return Err(Error::usage(message).in_file(path).help("take it out of the table, or rename it there"));
        }
        data.columns.push(Column { header: column.header.clone(), values: pick(&column.values, &rows) });
    }
    Ok(())
}

/// The rows that stay; each keeps its origin.
fn selected(data: Dataset, stays: &[bool]) -> Dataset {
    let rows: Vec<DataRow> = data.row_indices().filter(|&row| stays[row]).collect();
    let columns =
        data.columns.iter().map(|column| Column { header: column.header.clone(), values: pick(&column.values, &rows) });
    Dataset { columns: columns.collect(), origins: rows.iter().map(|&row| data.origins[row]).collect(), ..data }
}

fn pick(values: &Values, rows: &[DataRow]) -> Values {
    match values {
        Values::Numbers(numbers) => Values::Numbers(rows.iter().map(|&row| numbers[row]).collect()),
        Values::Labels(labels) => Values::Labels(rows.iter().map(|&row| labels[row].clone()).collect()),
    }
}

#[cfg(test)]
mod tests;
