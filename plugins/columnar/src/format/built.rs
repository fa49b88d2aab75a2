//! Reading and writing by the libraries of Apache Arrow.

use std::path::Path;

use abbe_core::{ColumnHeader, Dataset, Kind, Result, SettingsError};
use abbe_table::{ColumnsOfFile, Field, Layout, NamedColumns};
use arrow_array::RecordBatch;
use arrow_schema::Schema;

use super::cells::cells_of;
use super::guard::guarded;
use super::{Format, arrow_ipc, parquet as of_parquet};
use crate::tables::Table;

/// The key of the metadata of a column that states its unit.
pub(super) const UNIT: &str = "unit";

/// Whether stages of that kind are built: they are.
pub fn check(_: Format, _: Kind) -> Result<(), SettingsError> {
    Ok(())
}

/// The columns of a file, without its rows.
pub fn headers(format: Format, path: &Path, layout: &Layout) -> Result<Vec<ColumnHeader>> {
    guarded(format, path, || {
        let named = |schema: &Schema| NamedColumns::new(path, &fields(schema), layout);
        let named = match format {
            Format::Parquet => named(&of_parquet::schema(path)?),
            Format::ArrowIpc => named(&arrow_ipc::schema(path)?),
        }?;
        Ok(named.headers())
    })
}

/// The data set of a file, and the number of rows that are left out because a number was not measured.
pub fn read(format: Format, path: &Path, layout: &Layout) -> Result<(Dataset, usize)> {
    guarded(format, path, || match format {
        Format::Parquet => of_parquet::read(path, layout),
        Format::ArrowIpc => arrow_ipc::read(path, layout),
    })
}

/// A table as a Parquet file.
pub fn parquet(table: &Table) -> Result<Vec<u8>> {
    of_parquet::write(table)
}

/// The columns that a schema describes.
pub(super) fn fields(schema: &Schema) -> Vec<Field> {
    let field = |field: &arrow_schema::FieldRef| Field {
        name: field.name().clone(),
        unit: field.metadata().get(UNIT).cloned(),
    };
    schema.fields().iter().map(field).collect()
}

/// A data set that grows by batches of rows.
pub(super) struct Growing<'a> {
    path: &'a Path,
    /// The places of its columns in a batch.
    places: Vec<usize>,
    data: ColumnsOfFile<'a>,
}

impl<'a> Growing<'a> {
    /// `places` are those of the columns in a batch, in the order of `named`; `size` is that of the file in bytes.
    pub fn new(path: &'a Path, named: NamedColumns, places: Vec<usize>, layout: &'a Layout, size: u64) -> Self {
        Self { path, places, data: ColumnsOfFile::new(named, layout, abbe_files::most_content(size)) }
    }

    /// Adds the rows of a batch.
    pub fn add(&mut self, batch: &RecordBatch) -> Result<()> {
        let schema = batch.schema_ref();
        let column = |&place: &usize| {
            cells_of(batch.column(place), schema.field(place).name()).map_err(|error| error.in_file(self.path))
        };
        let cells = self.places.iter().map(column).collect::<Result<Vec<_>>>()?;
        self.data.add(batch.num_rows(), &cells)
    }

    /// The data set, and the number of rows that are left out.
    pub fn finish(self) -> Result<(Dataset, usize)> {
        self.data.finish()
    }
}
