//! Ingest plugin `csv`: tables of text.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

use abbe_assembly::{
    Assembly, Average, Filters, InBatches, Join, Motion, Paths, Ranges, RowsOfFile, check_batches, tell_left_out,
    without_rows,
};
use abbe_core::{Batches, ColumnHeader, Context, Dataset, Ingest, InputFile, Label, Result, SettingsError, Table};
use abbe_table::{Decimal, Declared, Encoding, FileInBatches, Layout, Separator, Thousands};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

/// Measurements in CSV files.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Settings {
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
    /// What stands in the place of a number that was not measured. A number is one however it is
    /// written. Rows with such a cell in a column of numbers are left out, and counted in a remark.
    #[serde(default)]
    no_data: Vec<Label>,
    /// The columns to take, all others are left out: name with unit, and the name that it has in the files.
    columns: Option<BTreeMap<String, abbe_table::Source>>,
    /// Columns with the same value in every row: name, with its unit where it has one, and value.
    #[serde(default)]
    constants: BTreeMap<String, Label>,
    /// A table with further columns, looked up by a label of each row.
    join: Option<Join>,
    /// Readings in passing: adds the direction and the velocity of axes, from their commands and times (column `time`, or `feed`
    /// where it is stated), and leaves out the rows at which an axis turns or all stand.
    motion: Option<Motion>,
    /// Rows to take, by the range of a column of numbers: `angle_deg: [0, 360]` leaves the overshoot of a circle out. Its ends
    /// belong to it.
    #[serde(default)]
    within: Ranges,
    /// Rows to leave out: column and the labels that mark them.
    #[serde(default)]
    ignore: Filters,
    /// Rows to take; all others are left out: column and the labels that mark them.
    #[serde(default)]
    keep: Filters,
    /// Take means of repeated rows, after `ignore` and `keep`.
    average: Option<Average>,
    /// Read the files in batches of so many rows and never hold all of them: 20000 for more measurements than there is memory for.
    /// Estimates that can be made so are (`gauss-newton`, those of spindles); what needs all rows at once is refused. Without it all rows are held.
    batch_rows: Option<NonZeroUsize>,
}

fn yes() -> bool {
    true
}

/// The stage.
struct Csv {
    assembly: Assembly,
    layout: Layout,
    /// A table of a program, in the place of the files.
    table: Option<Arc<Table>>,
    /// Rows of a batch, if not all are held.
    batch_rows: Option<NonZeroUsize>,
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

pub(crate) fn example() -> Value {
    json!({
        "path": ["bar-*.csv"],
        "constants": { "cycle": 1, "T_degC": 20.5 },
        "join": { "table": "measurements.csv", "on": "file" },
        "ignore": { "point": [1, 2] },
        "keep": { "stylus": [1] },
        "average": { "over": "file", "by": ["point"] }
    })
}

pub(crate) fn build(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    let batch_rows = settings.batch_rows;
    if batch_rows.is_some() {
        check_batches(&[("motion", settings.motion.is_some()), ("average", settings.average.is_some())])?;
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
    let Settings { path, constants, join, ignore, keep, average, motion, within, .. } = settings;
    let assembly = Assembly::new(path, constants, join, [ignore, keep], context)?.in_passing(motion, within)?;
    Ok(Box::new(Csv { assembly: assembly.averaged(average), layout: layout.layout()?, table: None, batch_rows }))
}

impl Ingest for Csv {
    fn inputs(&self) -> Vec<InputFile> {
        self.assembly.inputs()
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        let data = self.assembly.without_rows(&|path| match &self.table {
            Some(table) => abbe_table::of_table_without_rows(path, table, &self.layout),
            None => without_rows(path, &self.layout),
        })?;
        Ok(data.headers())
    }

    fn read(&self) -> Result<Dataset> {
        self.assembly.read(&|path| self.rows_of(path))
    }

    /// The table of a program is in memory already.
    fn batch_rows(&self) -> Option<usize> {
        self.batch_rows.filter(|_| self.table.is_none()).map(NonZeroUsize::get)
    }

    fn batches(&self) -> Result<Box<dyn Batches + '_>> {
        let rows = self.batch_rows.map_or(usize::MAX, NonZeroUsize::get);
        let file = |path: &Path| Ok(Box::new(FileInBatches::new(path, &self.layout, rows)?) as Box<dyn RowsOfFile>);
        Ok(Box::new(InBatches::new(&self.assembly, rows, file)?))
    }

    fn with_table(self: Box<Self>, table: Arc<Table>) -> Result<Box<dyn Ingest>> {
        Ok(Box::new(Self { assembly: self.assembly.of_one_table(), table: Some(table), ..*self }))
    }
}

impl Csv {
    fn rows_of(&self, path: &Path) -> Result<Dataset> {
        let (data, left_out) = match &self.table {
            Some(table) => abbe_table::of_table(path, table, &self.layout)?,
            None => abbe_table::read_laid_out(path, &self.layout)?,
        };
        tell_left_out(path, left_out);
        Ok(data)
    }
}
