//! The same tables as Parquet, in groups of rows.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{Error, Result};
use abbe_engine::temporary_file;
use arrow_array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::WriterProperties;

use super::{Cell, Column};
use crate::own_files::OwnFiles;
use crate::unwritable;

/// Rows of a group.
const ROWS: usize = 1 << 16;

/// The cells of a column that are not written yet.
enum Waiting {
    Texts(Vec<String>),
    Numbers(Vec<Option<f64>>),
}

/// A file that is written.
pub struct Columnar {
    path: PathBuf,
    schema: Arc<Schema>,
    writer: ArrowWriter<tempfile::NamedTempFile>,
    waiting: Vec<Waiting>,
    rows: usize,
}

impl Columnar {
    pub fn new(path: &Path, columns: &[Column]) -> Result<Self> {
        let field = |column: &Column| match column {
            Column::Text(name) => Field::new(*name, DataType::Utf8, false),
            Column::Number(name) => Field::new(*name, DataType::Float64, true),
        };
        let schema = Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()));
        let folder = path.parent().unwrap_or(Path::new("."));
        let file = temporary_file(folder).map_err(|error| unwritable(path, &error))?;
        let packed = Compression::ZSTD(ZstdLevel::default());
        let properties = WriterProperties::builder().set_compression(packed).build();
        let writer = ArrowWriter::try_new(file, schema.clone(), Some(properties)).map_err(|why| failed(path, &why))?;
        let waiting = |column: &Column| match column {
            Column::Text(_) => Waiting::Texts(Vec::new()),
            Column::Number(_) => Waiting::Numbers(Vec::new()),
        };
        Ok(Self { path: path.to_owned(), schema, writer, waiting: columns.iter().map(waiting).collect(), rows: 0 })
    }

    pub fn push(&mut self, row: &[Cell<'_>]) -> Result<()> {
        for (column, cell) in self.waiting.iter_mut().zip(row) {
            match (column, cell) {
                (Waiting::Texts(texts), Cell::Text(text)) => texts.push((*text).to_owned()),
                (Waiting::Texts(texts), _) => texts.push(String::new()),
                (Waiting::Numbers(numbers), Cell::Number(number)) => {
                    numbers.push(Some(*number).filter(|number| number.is_finite()));
                }
                (Waiting::Numbers(numbers), _) => numbers.push(None),
            }
        }
        self.rows += 1;
        if self.rows == ROWS { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> Result<()> {
        let array = |column: &mut Waiting| -> ArrayRef {
            match column {
                Waiting::Texts(texts) => Arc::new(StringArray::from_iter_values(std::mem::take(texts))),
                Waiting::Numbers(numbers) => Arc::new(Float64Array::from(std::mem::take(numbers))),
            }
        };
        let columns = self.waiting.iter_mut().map(array).collect();
        self.rows = 0;
        let batch = RecordBatch::try_new(self.schema.clone(), columns).map_err(|why| failed(&self.path, &why))?;
        let written = self.writer.write(&batch).and_then(|()| self.writer.flush());
        written.map_err(|why| failed(&self.path, &why))
    }

    pub fn finish(mut self, own: &mut OwnFiles) -> Result<()> {
        if self.rows > 0 {
            self.write()?;
        }
        let file = self.writer.into_inner().map_err(|why| failed(&self.path, &why))?;
        own.keep(file, &self.path)
    }
}

fn failed(path: &Path, why: &dyn std::fmt::Display) -> Error {
    Error::data(format!("the file cannot be written: {why}")).in_file(path)
}
