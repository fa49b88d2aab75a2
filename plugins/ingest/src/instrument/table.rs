//! What all readers of instruments' files share: settings, the stage, and a table that is filled row by row.

use std::collections::BTreeMap;
use std::path::Path;

use abbe_core::{
    ColumnHeader, Context, Dataset, Error, Ingest, InputFile, Label, Result, RowOrigin, SettingsError, Values,
};
use schemars::JsonSchema;
use serde::Deserialize;

use abbe_assembly::{Assembly, Filters, Join, Paths, emptied};

/// The file of an instrument or of other software.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Settings {
    /// The file or files, as of `ingest: csv`.
    pub(crate) path: Paths,
    /// The unit of lengths. A file that states its unit needs none, and may not state another one.
    pub(crate) units: Option<Units>,
    /// As of `ingest: csv`.
    #[serde(default)]
    pub(crate) constants: BTreeMap<String, Label>,
    /// As of `ingest: csv`.
    pub(crate) join: Option<Join>,
    /// As of `ingest: csv`.
    #[serde(default)]
    pub(crate) ignore: Filters,
    /// As of `ingest: csv`.
    #[serde(default)]
    pub(crate) keep: Filters,
}

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
pub(crate) enum Units {
    /// Millimetres.
    #[serde(rename = "mm")]
    Millimetres,
    /// Inches.
    #[serde(rename = "in")]
    Inches,
}

impl Units {
    /// mm in one of it.
    pub(crate) fn scale(self) -> f64 {
        if self == Self::Inches { 25.4 } else { 1.0 }
    }

    pub(crate) fn name(self) -> &'static str {
        if self == Self::Inches { "in" } else { "mm" }
    }
}

/// What a reader gets: the file's name and text, and the unit that the recipe states. It gives a data set, and remarks.
pub(crate) type Read = fn(&Path, &str, Option<Units>) -> Result<(Dataset, Vec<String>)>;

/// A reader that knows all that the recipe states.
type ReadAsStated = Box<dyn Fn(&Path, &str) -> Result<(Dataset, Vec<String>)> + Send + Sync>;

/// The stage of all these readers.
struct Instrument {
    assembly: Assembly,
    read: ReadAsStated,
}

/// The stage of a reader.
pub(crate) fn stage(settings: Settings, context: &Context, read: Read) -> Result<Box<dyn Ingest>, SettingsError> {
    let Settings { path, units, constants, join, ignore, keep } = settings;
    let assembly = Assembly::new(path, constants, join, [ignore, keep], context)?;
    Ok(Box::new(Instrument { assembly, read: Box::new(move |path, text| read(path, text, units)) }))
}

/// The stage of a reader with settings of its own.
pub(crate) fn stage_of(
    path: Paths,
    constants: BTreeMap<String, Label>,
    filters: [Filters; 2],
    context: &Context,
    read: ReadAsStated,
) -> Result<Box<dyn Ingest>, SettingsError> {
    Ok(Box::new(Instrument { assembly: Assembly::new(path, constants, None, filters, context)?, read }))
}

impl Ingest for Instrument {
    fn inputs(&self) -> Vec<InputFile> {
        self.assembly.inputs()
    }

    fn is_of_tables(&self) -> bool {
        false
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        // Which columns there are is known only with the rows.
        let load = |path: &Path| Ok(emptied((self.read)(path, &abbe_table::read_text(path)?)?.0));
        Ok(self.assembly.without_rows(&load)?.headers())
    }

    fn read(&self) -> Result<Dataset> {
        self.assembly.read(&|path| {
            let (data, remarks) = (self.read)(path, &abbe_table::read_text(path)?)?;
            remarks.iter().for_each(|remark| tracing::warn!("{}: {remark}", path.display()));
            Ok(data)
        })
    }
}

/// An error for a file that does not say its unit, where the recipe does not either.
pub(crate) fn no_unit(path: &Path) -> Error {
    Error::data("the file does not say the unit of its lengths")
        .in_file(path)
        .help("write `units: mm` or `units: in`; it is not guessed")
}

/// A table that is filled row by row: labels, then numbers in the units of memory.
pub(crate) struct Rows {
    data: Dataset,
}

impl Rows {
    /// A table with these columns.
    pub(crate) fn new(path: &Path, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|name| abbe_table::empty_column(ColumnHeader::parse(name))).collect();
        Self { data: Dataset { columns, files: vec![path.to_owned()], ..Dataset::default() } }
    }

    /// Adds a row; labels and numbers come in the order of their columns.
    pub(crate) fn push(&mut self, line: usize, labels: &[&str], numbers: &[f64]) {
        let (mut labels, mut numbers) = (labels.iter(), numbers.iter());
        for column in &mut self.data.columns {
            match &mut column.values {
                Values::Labels(own) => own.push(labels.next().map(|label| (*label).into()).unwrap_or_default()),
                Values::Numbers(own) => own.push(numbers.next().copied().unwrap_or(f64::NAN)),
            }
        }
        let row = self.data.origins.len() + 1;
        self.data.origins.push(RowOrigin { file: 0, line, row });
    }

    /// The data set; fails if it has no row.
    pub(crate) fn finish(self, what: &str) -> Result<Dataset> {
        match self.data.files.first() {
            Some(path) if self.data.origins.is_empty() => {
                Err(Error::data(format!("there is no {what} in the file")).in_file(path))
            }
            _ => Ok(self.data),
        }
    }
}

/// A finite number as other software writes it: `.4187`, `0.`, `-5`, `+1.5E-3`.
pub(crate) fn number(written: &str) -> Option<f64> {
    let written = written.trim();
    let is_written = |it: char| it.is_ascii_digit() || "+-.eE".contains(it);
    written.chars().all(is_written).then(|| written.parse::<f64>().ok().filter(|it| it.is_finite())).flatten()
}
