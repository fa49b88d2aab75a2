//! One data set from many files.
//!
//! The columns, in this order: those of the first file; `file`, the name of the row's file without its extension
//! (always there, so that splitting a file in two changes no column; a `file` column of the files' own is kept
//! instead); the constants by name; the columns of the joined table. Only then are rows left out, so that `ignore` and
//! `keep` may name any of them, and every row needs a match in the joined table.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use abbe_core::{
    Column, ColumnHeader, Context, DataRow, Dataset, Error, InputFile, Label, LabelText, PathItem, Quantity, Result,
    SettingsError, Values,
};
use abbe_table::Layout;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::average::Average;
use crate::files::Source;
use crate::motion::Motion;

/// Columns and listed labels.
pub type Filters = BTreeMap<String, Vec<Label>>;

/// Columns with their units, and the range of the rows that stay.
pub type Ranges = BTreeMap<String, [f64; 2]>;

/// The setting `path`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "a path or a list of paths was expected")]
pub enum Paths {
    /// One path or pattern.
    One(String),
    /// Several.
    Many(Vec<String>),
}

/// The setting `join`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Join {
    /// The CSV file of the table, relative to the recipe.
    table: String,
    /// The column that both have and whose labels are looked up; in the table each occurs once. For `file`, the table
    /// may write file names with or without their extension.
    on: String,
}

enum Constant {
    Number(f64),
    Label(String),
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

/// What makes a file a data set.
pub type Load<'a> = &'a dyn Fn(&Path) -> Result<Dataset>;

/// Files, and what is done to their rows.
pub struct Assembly {
    sources: Vec<Source>,
    constants: BTreeMap<String, Constant>,
    join: Option<(PathBuf, String)>,
    ignore: Filters,
    keep: Filters,
    motion: Option<Motion>,
    within: Ranges,
    /// One table stands in the place of all files.
    is_one_table: bool,
    average: Option<Average>,
}

impl Assembly {
    /// Fails for settings that are none.
    pub fn new(
        path: Paths,
        constants: BTreeMap<String, Label>,
        join: Option<Join>,
        [ignore, keep]: [Filters; 2],
        context: &Context,
    ) -> Result<Self, SettingsError> {
        let paths = match path {
            Paths::One(path) => vec![path],
            Paths::Many(paths) => paths,
        };
        if paths.is_empty() {
            return Err(SettingsError::new("path", "at least one file was expected").help("write `path: measured.csv`"));
        }
        let sources = paths.iter().map(|path| Source::new(path, context)).collect::<Result<_, _>>();
        Ok(Self {
            sources: sources.map_err(|message| SettingsError::new("path", message))?,
            constants: self::constants(constants)?,
            join: join.map(|join| (context.path(&join.table), join.on)),
            ignore,
            keep,
            motion: None,
            within: Ranges::new(),
            is_one_table: false,
            average: None,
        })
    }

    /// The same with columns for the motion of axes, and with the rows of these ranges only. Fails for ranges that are none.
    pub fn in_passing(self, motion: Option<Motion>, within: Ranges) -> Result<Self, SettingsError> {
        let is_none = |[from, to]: &[f64; 2]| from.is_nan() || to.is_nan() || from > to;
        if let Some((header, [from, to])) = within.iter().find(|(_, range)| is_none(range)) {
            let error = SettingsError::new(header, format!("{from} to {to} is no range")).help("write `[from, to]`");
            return Err(error.under([PathItem::Key("within".to_owned())]));
        }
        Ok(Self { motion, within, ..self })
    }

    /// The same with means of repeated rows, taken in the end.
    pub fn averaged(self, average: Option<Average>) -> Self {
        Self { average, ..self }
    }

    /// The same with one table in the place of all files. It is named as the first of them.
    pub fn of_one_table(self) -> Self {
        Self { is_one_table: true, ..self }
    }

    /// The files that it reads.
    pub fn inputs(&self) -> Vec<InputFile> {
        let input = |setting| move |path| InputFile { setting, path };
        let files = self.sources.iter().flat_map(|source| match source.files() {
            files if files.is_empty() => vec![source.path.clone()],
            files => files,
        });
        let table = self.join.iter().map(|(table, _)| table.clone());
        files.filter(|_| !self.is_one_table).map(input("path")).chain(table.map(input("join"))).collect()
    }

    /// The columns of the data set, from what `load` tells of each file without rows.
    pub fn without_rows(&self, load: Load<'_>) -> Result<Dataset> {
        // What `read` does, on tables without rows: so the columns cannot differ.
        self.mean(self.assemble(load, &|path| without_rows(path, &Layout::default()))?.0)
    }

    /// The data set after the means are taken.
    fn mean(&self, data: Dataset) -> Result<Dataset> {
        match &self.average {
            Some(average) => average.of(&data),
            None => Ok(data),
        }
    }

    /// The data set, from what `load` reads of each file.
    pub fn read(&self, load: Load<'_>) -> Result<Dataset> {
        let (data, stays) = self.assemble(load, &abbe_table::read)?;
        self.tell_unknown(&data)?;
        let stays = self.filtered(&data, stays)?;
        match stays.contains(&true) {
            true => self.mean(selected(data, &stays)),
            false if self.motion.is_some() || !self.within.is_empty() => Err(Error::data(
                "no row is left after `motion`, `within`, `ignore` and `keep`",
            )
            .help("take a wider range, or a shorter way behind reversals; `abbe data RECIPE` shows the columns")),
            false => Err(Error::data("no row is left after `ignore` and `keep`")
                .help("name other rows there; `abbe data RECIPE` shows the labels of the columns")),
        }
    }

    /// The data set of some rows of the files, from the joined table as it was read; no row may be left.
    pub(crate) fn part(&self, rows: Dataset, table: Option<&Dataset>) -> Result<Dataset> {
        let (data, stays) =
            self.completed(rows, &|_| table.cloned().ok_or_else(|| Error::data("no table was read")))?;
        let stays = self.filtered(&data, stays)?;
        Ok(selected(data, &stays))
    }

    /// The joined table, if there is one.
    pub(crate) fn joined_table(&self) -> Result<Option<Dataset>> {
        self.join.as_ref().map(|(path, _)| abbe_table::read(path)).transpose()
    }

    /// Tells labels of `ignore` and `keep` that no row has: a recipe may name rows that other data do not have.
    fn tell_unknown(&self, data: &Dataset) -> Result<()> {
        for (setting, filters, _) in self.filters() {
            for (name, listed) in filters {
                let there: BTreeSet<&str> = abbe_table::labels(data, name)?.iter().map(LabelText::as_str).collect();
                for Label(label) in listed {
                    let other = same_number(label, &there);
                    let as_written = other.map_or(String::new(), |other| {
                        format!("; {name} {other} is the same number: if it is meant, write it in quotes")
                    });
                    match there.contains(label.as_str()) {
                        true if other.is_none() => {}
                        true => tracing::warn!("`{setting}` names {name} {label}{as_written}"),
                        false => tracing::warn!(
                            "`{setting}` names {name} {label}, which is in no row of these data{as_written}"
                        ),
                    }
                }
            }
        }
        Ok(())
    }

    /// Which rows stay after `within`, `ignore` and `keep`, of those that stay before.
    fn filtered(&self, data: &Dataset, mut stays: Vec<bool>) -> Result<Vec<bool>> {
        for (header, [from, to]) in &self.within {
            let (name, quantity, factor) = Quantity::of_column(header);
            let numbers = abbe_table::numbers(data, name, quantity)?;
            for (stays, number) in stays.iter_mut().zip(numbers) {
                *stays &= (from * factor..=to * factor).contains(number);
            }
        }
        for (_, filters, wanted) in self.filters() {
            for (name, listed) in filters {
                let labels = abbe_table::labels(data, name)?;
                let listed: BTreeSet<&str> = listed.iter().map(|label| label.0.as_str()).collect();
                for (stays, label) in stays.iter_mut().zip(labels) {
                    *stays &= listed.contains(label.as_str()) == wanted;
                }
            }
        }
        Ok(stays)
    }

    /// The data set before rows are left out, from what `load` reads of each file, and `table` of the joined one; and which
    /// rows stay after `motion`.
    fn assemble(&self, load: Load<'_>, table: Load<'_>) -> Result<(Dataset, Vec<bool>)> {
        let mut data = Dataset::default();
        for file in self.files()? {
            append(&mut data, load(&file)?)?;
        }
        self.completed(data, table)
    }

    /// The files, in their order. Fails for a pattern that no file matches.
    pub(crate) fn files(&self) -> Result<Vec<PathBuf>> {
        let mut all = Vec::new();
        let sources = if self.is_one_table { &self.sources[..1] } else { &self.sources };
        for source in sources {
            let files = if self.is_one_table { vec![source.path.clone()] } else { source.files() };
            if files.is_empty() {
                return Err(Error::usage(format!("no file matches `{}`", source.path.display()))
                    .help("`*` and `?` stand for parts of the name of a file; the folder has to be there")
                    .setting("path"));
            }
            all.extend(files);
        }
        Ok(all)
    }

    /// Adds what the settings say to the rows of files; and which rows stay after `motion`.
    fn completed(&self, mut data: Dataset, table: Load<'_>) -> Result<(Dataset, Vec<bool>)> {
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
                Constant::Label(label) => Values::Labels(vec![label.into(); data.rows()]),
            };
            data.columns.push(Column { header, values });
        }
        if let Some((path, on)) = &self.join {
            join(&mut data, &table(path)?, on, by_file && on == "file")?;
        }
        for (setting, filters, _) in self.filters() {
            for name in filters.keys() {
                abbe_table::labels(&data, name).map_err(|error| in_settings(error, setting, name))?;
            }
        }
        for header in self.within.keys() {
            let (name, quantity, _) = Quantity::of_column(header);
            abbe_table::numbers(&data, name, quantity).map_err(|error| in_settings(error, "within", header))?;
        }
        let stays = match &self.motion {
            Some(motion) => motion.add(&mut data)?,
            None => vec![true; data.rows()],
        };
        Ok((data, stays))
    }

    /// The settings that leave rows out, and whether a listed label means that the row stays.
    fn filters(&self) -> [(&'static str, &Filters, bool); 2] {
        [("ignore", &self.ignore, false), ("keep", &self.keep, true)]
    }
}

/// A table without its rows.
pub fn without_rows(path: &Path, layout: &Layout) -> Result<Dataset> {
    let headers = abbe_table::read_headers_laid_out(path, layout)?;
    let columns = headers.into_iter().map(abbe_table::empty_column).collect();
    Ok(Dataset { columns, files: vec![path.to_owned()], ..Dataset::default() })
}

/// Tells how many rows of a file are left out because a number was not measured.
pub fn tell_left_out(path: &Path, left_out: usize) {
    if left_out > 0 {
        let [holds, are] = if left_out == 1 { ["row holds", "is"] } else { ["rows hold", "are"] };
        tracing::warn!("{}: {left_out} {holds} a mark of `no_data` and {are} left out", path.display());
    }
}

/// The columns of a data set that had to be read to know them.
pub fn emptied(data: Dataset) -> Dataset {
    let columns = data.headers().into_iter().map(abbe_table::empty_column).collect();
    Dataset { columns, origins: Vec::new(), ..data }
}

/// The error at a place of the settings: the statement of the recipe about the file is wrong.
fn in_settings(error: Error, setting: &str, key: &str) -> Error {
    error.setting_at(&[setting, key])
}

/// Appends the rows of one file, which must have the same columns in any order.
pub(crate) fn append(data: &mut Dataset, part: Dataset) -> Result<()> {
    let Some(first) = data.files.first() else {
        *data = part;
        return Ok(());
    };
    let headers =
        |data: &Dataset| -> Vec<String> { data.columns.iter().map(|column| column.header.header.clone()).collect() };
    let only = |this: &Dataset, other: &Dataset| {
        let theirs: BTreeSet<String> = headers(other).into_iter().collect();
        headers(this).into_iter().find(|header| !theirs.contains(header))
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
    if let Some(twin) = part.files.iter().find(|path| data.files.contains(path))
        && data.column("file").is_none()
    {
        return Err(of_one_name(twin, twin));
    }
    data.append(part)
}

/// What a file is called in the column `file`.
fn stem(path: &Path) -> String {
    let unpacked = abbe_files::without_packing(path);
    unpacked.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The error for two files that the column `file` does not tell apart.
fn of_one_name(one: &Path, other: &Path) -> Error {
    let (shown, stem) = ([one, other].map(Path::display), stem(other));
    let message = format!("`{}` and `{}` would both be `{stem}` in the column `file`", shown[0], shown[1]);
    Error::usage(message).help("give one of them another name").setting("path")
}

/// Adds the column `file`; false if the files have one of their own.
fn add_file_column(data: &mut Dataset) -> Result<bool> {
    if data.column("file").is_some() {
        return Ok(false);
    }
    let stems: Vec<LabelText> = data.files.iter().map(|path| stem(path).into()).collect();
    let mut first: BTreeMap<&str, usize> = BTreeMap::new();
    for (index, (path, stem)) in data.files.iter().zip(&stems).enumerate() {
        if let Some(twin) = first.insert(stem, index) {
            return Err(of_one_name(&data.files[twin], path));
        }
    }
    let labels = data.origins.iter().map(|origin| stems[origin.file].clone()).collect();
    data.columns.push(Column { header: ColumnHeader::parse("file"), values: Values::Labels(labels) });
    Ok(true)
}

/// Adds the columns of a table, by the label that each row has in the column `on`; `by_file`: the label is the name of
/// its file, which the table may write with the extension.
fn join(data: &mut Dataset, table: &Dataset, on: &str, by_file: bool) -> Result<()> {
    let lacks = |error: Error| in_settings(error, "join", "on");
    let labels = abbe_table::labels(data, on).map_err(lacks)?;
    abbe_table::labels(table, on).map_err(lacks)?;
    let keys = abbe_table::unique_labels(table, on)?;
    let path = table.files.first().map(PathBuf::as_path).unwrap_or(Path::new(""));
    let mut rows = Vec::new();
    for (row, (label, origin)) in DataRow::enumerate(labels.iter().zip(&data.origins)) {
        let file = &data.files[origin.file];
        let named = |file: &Path| keys.get(file.file_name().and_then(|name| name.to_str()).filter(|_| by_file)?);
        let of_label = keys.get(label.as_str());
        match of_label.or_else(|| named(file)).or_else(|| named(&abbe_files::without_packing(file))) {
            Some(&found) => rows.push(found),
            None => {
                let error = data.error_at(row, format!("{on} `{label}` is not in the table `{}`", path.display()));
                return Err(error.help(
                    "add a row for it to the table, or take these rows out of the file: `ignore` comes after the join",
                ));
            }
        }
    }
    let own: BTreeMap<String, String> =
        data.columns.iter().map(|column| (column.header.name.clone(), column.header.header.clone())).collect();
    for column in table.columns.iter().filter(|column| column.header.name != on) {
        if let Some(twin) = own.get(&column.header.name) {
            return Err(Error::usage(format!("the column `{twin}` is in the data already"))
                .in_file(path)
                .help("take it out of the table, or rename it there"));
        }
        data.columns.push(Column { header: column.header.clone(), values: pick(&column.values, &rows) });
    }
    Ok(())
}

/// The rows that stay; each keeps its origin. Where all stay nothing is copied.
fn selected(data: Dataset, stays: &[bool]) -> Dataset {
    if !stays.contains(&false) {
        return data;
    }
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

/// Another label that is the same number. A number that is written in a recipe without quotes, `1.10`, comes as the shortest one, `1.1`: what
/// is not the shortest one was in quotes.
fn same_number<'a>(label: &str, there: &BTreeSet<&'a str>) -> Option<&'a str> {
    let number = label.parse::<f64>().ok().filter(|number| number.is_finite())?;
    let is_shortest = [format!("{number}"), format!("{number:?}")].iter().any(|shortest| shortest == label);
    let is_other = |other: &&&str| **other != label && other.parse::<f64>().ok() == Some(number);
    there.iter().find(is_other).copied().filter(|_| is_shortest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_that_are_one_number_are_found() {
        let found = |label: &str, there: &[&'static str]| same_number(label, &there.iter().copied().collect());
        // `1.10` and `1.0` without quotes come as these.
        assert_eq!(found("1.1", &["1.1", "1.10", "2"]), Some("1.10"));
        assert_eq!(found("1.0", &["1", "2"]), Some("1"));
        assert_eq!(found("5", &["+5", "6"]), Some("+5"));
        for (label, there) in [("1.10", &["1.1", "1.10"][..]), ("1.1", &["1.1", "2"]), ("a", &["a", "b"])] {
            assert_eq!(found(label, there), None, "{label}");
        }
    }
}
