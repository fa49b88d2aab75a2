//! Reading and writing by the libraries of Apache Arrow.

use std::path::Path;

use abbe_core::{ColumnCells, Dataset, Kind, Result, SettingsError};
use abbe_table::{DataOfColumns, Layout, NamedColumns};
use arrow_array::RecordBatch;
use arrow_schema::Schema;

use super::guard::guarded;
use super::{Format, arrow_ipc, parquet as of_parquet};
use crate::arrow::{fields, rows_of};
use crate::tables::Table;

/// Whether stages of that kind are built: they are.
pub fn check(_: Format, _: Kind) -> Result<(), SettingsError> {
    Ok(())
}

/// The data set of a file, without its rows.
pub fn without_rows(format: Format, path: &Path, layout: &Layout) -> Result<Dataset> {
    guarded(format, path, || {
        let named = |schema: &Schema| NamedColumns::new(path, &fields(schema), layout);
        let named = match format {
            Format::Parquet => named(&of_parquet::schema(path)?),
            Format::ArrowIpc => named(&arrow_ipc::schema(path)?),
        }?;
        Ok(named.without_rows())
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

/// A data set that grows by batches of rows.
pub(super) struct Growing<'a> {
    path: &'a Path,
    /// The places of its columns in a batch.
    places: Vec<usize>,
    data: DataOfColumns<'a>,
}

impl<'a> Growing<'a> {
    /// `places` are those of the columns in a batch, in the order of `named`; `size` is that of the file in bytes.
    pub fn new(path: &'a Path, named: NamedColumns, places: Vec<usize>, layout: &'a Layout, size: u64) -> Self {
        Self { path, places, data: DataOfColumns::new(named, layout, abbe_files::most_content(size)) }
    }

    /// The same of rows before which there are so many.
    pub fn after(self, rows: usize) -> Self {
        Self { data: self.data.after(rows), ..self }
    }

    /// Adds the rows of a batch.
    pub fn add(&mut self, batch: &RecordBatch) -> Result<()> {
        let found = rows_of(batch, &self.places).map_err(|error| error.in_file(self.path))?;
        let cells: Vec<&dyn ColumnCells> = found.cells.iter().map(|cells| &**cells as _).collect();
        self.data.add(found.rows, &cells)
    }

    /// The data set, and the number of rows that are left out.
    pub fn finish(self) -> Result<(Dataset, usize)> {
        self.data.finish()
    }
    /// The same; no row may be left.
    pub fn finish_part(self) -> (Dataset, usize) {
        self.data.finish_part()
    }
}
