//! Tables that grow row by row: CSV, and Parquet where that is built.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use abbe_core::{Error, Result};
use abbe_engine::temporary_file;
use serde_json::Value;

use crate::own_files::OwnFiles;
use crate::unwritable;

#[cfg(feature = "parquet")]
mod parquet;

/// A cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell<'a> {
    /// A text.
    Text(&'a str),
    /// A number; one that is not finite is missing.
    Number(f64),
    /// Nothing, where a number could be.
    Missing,
}

/// What a column has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// Texts.
    Text(&'static str),
    /// Numbers.
    Number(&'static str),
}

impl Column {
    fn name(self) -> &'static str {
        match self {
            Self::Text(name) | Self::Number(name) => name,
        }
    }
}

/// A table that is written.
pub struct Table {
    path: PathBuf,
    csv: csv::Writer<BufWriter<tempfile::NamedTempFile>>,
    #[cfg(feature = "parquet")]
    columnar: parquet::Columnar,
}

impl Table {
    /// A new table in `folder`.
    ///
    /// # Errors
    /// If the disk does not take it.
    pub fn new(folder: &Path, name: &str, columns: &[Column]) -> Result<Self> {
        let path = folder.join(format!("{name}.csv"));
        let file = temporary_file(folder).map_err(|error| unwritable(&path, &error))?;
        let mut csv = csv::Writer::from_writer(BufWriter::new(file));
        csv.write_record(columns.iter().map(|column| column.name())).map_err(|error| failed(&path, error))?;
        Ok(Self {
            csv,
            #[cfg(feature = "parquet")]
            columnar: parquet::Columnar::new(&path.with_extension("parquet"), columns)?,
            path,
        })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// If the disk does not take it.
    pub fn push(&mut self, row: &[Cell<'_>]) -> Result<()> {
        #[cfg(feature = "parquet")]
        self.columnar.push(row)?;
        for cell in row {
            let written = match cell {
                Cell::Text(text) => self.csv.write_field(text),
                Cell::Number(number) if number.is_finite() => self.csv.write_field(Value::from(*number).to_string()),
                Cell::Number(_) | Cell::Missing => self.csv.write_field(""),
            };
            written.map_err(|error| failed(&self.path, error))?;
        }
        self.csv.write_record(None::<&[u8]>).map_err(|error| failed(&self.path, error))
    }

    /// Fails if a file of somebody is at its place.
    pub fn check(&self, own: &OwnFiles) -> Result<()> {
        #[cfg(feature = "parquet")]
        own.check(&self.path.with_extension("parquet"))?;
        own.check(&self.path)
    }

    /// Writes the rest of the table, which waits with the others of the merge for its place.
    ///
    /// # Errors
    /// If the disk does not take it, or a file of somebody is there.
    pub fn finish(self, own: &mut OwnFiles) -> Result<()> {
        let Self { path, csv, .. } = self;
        let written = (|| {
            let buffer = csv.into_inner().map_err(|error| error.into_error())?;
            let mut file = buffer.into_inner().map_err(|error| error.into_error())?;
            file.flush()?;
            Ok(file)
        })();
        own.keep(written.map_err(|error: io::Error| unwritable(&path, &error))?, &path)?;
        #[cfg(feature = "parquet")]
        self.columnar.finish(own)?;
        Ok(())
    }
}

fn failed(path: &Path, error: csv::Error) -> Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => unwritable(path, &error),
        kind => Error::data(format!("the file cannot be written: {kind:?}")).in_file(path),
    }
}
