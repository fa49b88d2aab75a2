//! Parquet files.

use std::collections::HashMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{Dataset, Error, Result};
use abbe_table::{Layout, NamedColumns, unreadable};
use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use parquet::arrow::{ArrowWriter, ProjectionMask};
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::metadata::ParquetMetaData;
use parquet::file::properties::WriterProperties;

use super::Format::Parquet;
use super::built::Growing;
use super::guard::broken;
use crate::arrow::{UNIT, fields};
use crate::tables::{OfRows, Table};

/// Rows that are read at a time.
const ROWS: usize = 8192;

/// The schema of a file.
pub fn schema(path: &Path) -> Result<Schema> {
    Ok(open(path)?.0.schema().as_ref().clone())
}

/// The data set of a file, and the number of rows that are left out.
pub fn read(path: &Path, layout: &Layout) -> Result<(Dataset, usize)> {
    let (file, size) = open(path)?;
    let (batches, mut data) = of_columns(path, file, layout, size)?;
    for batch in batches {
        data.add(&batch.map_err(|why| broken(Parquet, path, &why))?)?;
    }
    data.finish()
}

/// What reads the columns of a file that are taken, and the data set without rows yet.
pub(super) fn of_columns<'a>(
    path: &'a Path,
    file: ParquetRecordBatchReaderBuilder<File>,
    layout: &'a Layout,
    size: u64,
) -> Result<(ParquetRecordBatchReader, Growing<'a>)> {
    let named = NamedColumns::new(path, &fields(file.schema()), layout)?;
    // A batch has the columns that are taken in the order of the file.
    let wanted = named.fields();
    let mut in_file = wanted.clone();
    in_file.sort_unstable();
    in_file.dedup();
    let places = wanted.iter().filter_map(|field| in_file.binary_search(field).ok()).collect();
    let mask = ProjectionMask::roots(file.parquet_schema(), in_file);
    let batches =
        file.with_projection(mask).with_batch_size(ROWS).build().map_err(|why| broken(Parquet, path, &why))?;
    Ok((batches, Growing::new(path, named, places, layout, size)))
}

fn open(path: &Path) -> Result<(ParquetRecordBatchReaderBuilder<File>, u64)> {
    let (file, size) = opened(path)?;
    let metadata = metadata(path, &file, size)?;
    Ok((ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata), size))
}

/// The file, and its bytes.
pub(super) fn opened(path: &Path) -> Result<(File, u64)> {
    let unreadable = |error: std::io::Error| unreadable(path, &error);
    let file = abbe_files::open(path).map_err(unreadable)?;
    let size = file.metadata().map_err(unreadable)?.len();
    Ok((file, size))
}

/// What a file tells of its columns and groups of rows.
pub(super) fn metadata(path: &Path, file: &File, size: u64) -> Result<ArrowReaderMetadata> {
    let found = ArrowReaderMetadata::load(file, ArrowReaderOptions::new());
    let metadata = found.map_err(|why| broken(Parquet, path, &why))?;
    check(metadata.metadata(), size).map_err(|why| broken(Parquet, path, &why))?;
    Ok(metadata)
}

/// Refuses columns that stand outside of the file: room would be made for them before they are read.
fn check(metadata: &ParquetMetaData, size: u64) -> Result<(), &'static str> {
    for group in metadata.row_groups() {
        for column in group.columns() {
            let start = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
            let end = u64::try_from(start).ok().zip(u64::try_from(column.compressed_size()).ok());
            if end.and_then(|(start, length)| start.checked_add(length)).is_none_or(|end| end > size) {
                return Err("a column of it stands outside of the file; was it cut off?");
            }
        }
    }
    Ok(())
}

/// A table as a file, packed by Zstandard.
pub fn write(table: &Table) -> Result<Vec<u8>> {
    let failed = |why: &dyn std::fmt::Display| Error::data(format!("`{}` cannot be written: {why}", table.name));
    let (mut columns, mut described): (Vec<ArrayRef>, Vec<Field>) = (Vec::new(), Vec::new());
    for column in &table.columns {
        let (values, is_optional): (ArrayRef, bool) = match &column.values {
            OfRows::Numbers(numbers) => (Arc::new(Float64Array::from(numbers.clone())), false),
            OfRows::Optional(numbers) => (Arc::new(Float64Array::from(numbers.clone())), true),
            OfRows::Whole(numbers) => (Arc::new(Int64Array::from(numbers.clone())), false),
            OfRows::Labels(labels) => (Arc::new(StringArray::from_iter_values(labels)), false),
        };
        let kind: DataType = values.data_type().clone();
        let unit = column.unit.iter().map(|unit| (UNIT.to_owned(), unit.clone()));
        described.push(Field::new(&column.name, kind, is_optional).with_metadata(unit.collect::<HashMap<_, _>>()));
        columns.push(values);
    }
    let schema = Arc::new(Schema::new(described));
    let batch = RecordBatch::try_new(schema.clone(), columns).map_err(|why| failed(&why))?;
    let packed = Compression::ZSTD(ZstdLevel::default());
    let properties = WriterProperties::builder().set_compression(packed).build();
    let mut writer = ArrowWriter::try_new(Vec::new(), schema, Some(properties)).map_err(|why| failed(&why))?;
    writer.write(&batch).map_err(|why| failed(&why))?;
    writer.into_inner().map_err(|why| failed(&why))
}
