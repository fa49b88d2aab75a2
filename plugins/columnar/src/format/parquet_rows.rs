//! Some rows of a Parquet file: pages before them are passed over, and one page of each column is held.

use std::ops::Range;
use std::path::{Path, PathBuf};

use abbe_core::{Dataset, Result};
use abbe_table::Layout;
use parquet::arrow::arrow_reader::{ArrowReaderMetadata, ParquetRecordBatchReaderBuilder};

use super::Format::Parquet;
use super::batches::{AnyRows, check_rows, parts_of};
use super::guard::broken;
use super::parquet::{metadata, of_columns, opened};

/// The rows of a file, which is not held open.
pub struct Rows {
    path: PathBuf,
    layout: Layout,
    size: u64,
    metadata: ArrowReaderMetadata,
    /// Rows of the groups in which they stand.
    groups: Vec<usize>,
    count: usize,
}

impl Rows {
    /// Reads what the file tells of its columns and groups.
    pub fn new(path: &Path, layout: &Layout) -> Result<Self> {
        let (file, size) = opened(path)?;
        let metadata = metadata(path, &file, size)?;
        let failed = |why: &str| broken(Parquet, path, &why);
        let groups = metadata.metadata().row_groups().iter().map(|group| usize::try_from(group.num_rows()));
        let groups: Vec<usize> =
            groups.collect::<Result<_, _>>().map_err(|_| failed("a group has a negative length"))?;
        let count = groups.iter().try_fold(0usize, |all, rows| all.checked_add(*rows));
        let count = count.ok_or_else(|| failed("it has too many rows"))?;
        check_rows(path, count, metadata.schema().fields().len(), size)?;
        Ok(Self { path: path.to_owned(), layout: layout.clone(), size, metadata, groups, count })
    }
}

impl AnyRows for Rows {
    fn count(&self) -> usize {
        self.count
    }

    fn read(&self, rows: Range<usize>) -> Result<(Dataset, usize)> {
        let (file, _) = opened(&self.path)?;
        let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone());
        let parts = parts_of(self.groups.iter().copied(), &rows);
        let offset = parts.first().map_or(0, |(_, rows)| rows.start);
        let groups = parts.into_iter().map(|(group, _)| group).collect();
        let builder = builder.with_row_groups(groups).with_offset(offset).with_limit(rows.len());
        let (batches, data) = of_columns(&self.path, builder, &self.layout, self.size)?;
        let (mut data, mut found) = (data.after(rows.start), 0);
        for batch in batches {
            let batch = batch.map_err(|why| broken(Parquet, &self.path, &why))?;
            found += batch.num_rows();
            data.add(&batch)?;
        }
        match found == rows.len() {
            true => Ok(data.finish_part()),
            false => Err(broken(Parquet, &self.path, &"it has other rows than it says")),
        }
    }
}
