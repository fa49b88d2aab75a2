//! Ingest plugins `parquet` and `arrow-ipc`.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;

use abbe_assembly::{Assembly, Average, Filters, InBatches, Join, Motion, Paths, Ranges, check_batches, tell_left_out};
use abbe_core::{
    Batches, ColumnHeader, Context, Dataset, Ingest, InputFile, Kind, Label, Result, SettingsError, Table,
};
use abbe_table::{Declared, Layout};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::format::{self, Format};

/// Measurements in files that hold columns.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The file or files, relative to the recipe. `*` and `?` in a file name stand for any characters and for one; the
    /// files that match come in natural order (`sphere-2` before `sphere-10`). Many files give one data set.
    path: Paths,
    /// What stands in the place of a number that was not measured: `""` for a cell without a value, `nan`, or a number. Rows with
    /// such a cell in a column of numbers are left out, and counted in a remark.
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
    /// Estimates that can be made so are (`gauss-newton`); what needs all rows at once is refused. Without it all rows are held.
    batch_rows: Option<NonZeroUsize>,
}

abbe_core::register!(
    Ingest,
    "parquet",
    "reads Parquet files whose columns carry units",
    Settings,
    of_parquet,
    parquet,
    "../reference/ingest-parquet.md",
);

abbe_core::register!(
    Ingest,
    "arrow-ipc",
    "reads Arrow IPC files (Feather) and streams whose columns carry units",
    Settings,
    of_arrow,
    arrow_ipc,
    "../reference/ingest-arrow-ipc.md",
);

fn of_parquet() -> Value {
    example("parquet")
}

fn of_arrow() -> Value {
    example("arrow")
}

fn example(ending: &str) -> Value {
    json!({
        "path": [format!("bar-*.{ending}")],
        "constants": { "cycle": 1, "T_degC": 20.5 },
        "join": { "table": "measurements.csv", "on": "file" },
        "ignore": { "point": [1, 2] },
        "keep": { "stylus": [1] },
        "average": { "over": "file", "by": ["point"] }
    })
}

fn parquet(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    build(Format::Parquet, settings, context)
}

fn arrow_ipc(settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    build(Format::ArrowIpc, settings, context)
}

fn build(format: Format, settings: Settings, context: &Context) -> Result<Box<dyn Ingest>, SettingsError> {
    format::check(format, Kind::Ingest)?;
    let Settings { path, no_data, columns, constants, join, motion, within, ignore, keep, average, batch_rows } =
        settings;
    if batch_rows.is_some() {
        check_batches(&[("motion", motion.is_some()), ("average", average.is_some())])?;
    }
    let layout = Declared { no_data, columns, ..Declared::default() }.layout()?;
    let assembly = Assembly::new(path, constants, join, [ignore, keep], context)?.in_passing(motion, within)?;
    Ok(Box::new(Columnar { format, assembly: assembly.averaged(average), layout, table: None, batch_rows }))
}

/// The stage.
struct Columnar {
    format: Format,
    assembly: Assembly,
    layout: Layout,
    /// What stands in the place of the files.
    table: Option<Arc<Table>>,
    /// Rows of a batch, if not all are held.
    batch_rows: Option<NonZeroUsize>,
}

impl Ingest for Columnar {
    fn inputs(&self) -> Vec<InputFile> {
        self.assembly.inputs()
    }

    fn headers(&self) -> Result<Vec<ColumnHeader>> {
        let data = self.assembly.without_rows(&|path| match &self.table {
            Some(table) => abbe_table::of_table_without_rows(path, table, &self.layout),
            None => format::without_rows(self.format, path, &self.layout),
        })?;
        Ok(data.headers())
    }

    fn read(&self) -> Result<Dataset> {
        self.assembly.read(&|path| {
            let (data, left_out) = match &self.table {
                Some(table) => abbe_table::of_table(path, table, &self.layout)?,
                None => format::read(self.format, path, &self.layout)?,
            };
            tell_left_out(path, left_out);
            Ok(data)
        })
    }

    /// The table of a program is in memory already.
    fn batch_rows(&self) -> Option<usize> {
        self.batch_rows.filter(|_| self.table.is_none()).map(NonZeroUsize::get)
    }

    fn batches(&self) -> Result<Box<dyn Batches + '_>> {
        let rows = self.batch_rows.map_or(usize::MAX, NonZeroUsize::get);
        let file = |path: &Path| format::in_batches(self.format, path, &self.layout, rows);
        Ok(Box::new(InBatches::new(&self.assembly, rows, file)?))
    }

    fn with_table(self: Box<Self>, table: Arc<Table>) -> Result<Box<dyn Ingest>> {
        Ok(Box::new(Self { assembly: self.assembly.of_one_table(), table: Some(table), ..*self }))
    }

    fn is_of_tables(&self) -> bool {
        false
    }
}
