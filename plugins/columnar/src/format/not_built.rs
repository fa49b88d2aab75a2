//! A program without the libraries for these formats.

use std::path::Path;

use abbe_assembly::RowsOfFile;
use abbe_core::{Dataset, Error, Kind, Result, SettingsError};
use abbe_table::Layout;

use super::Format;
use crate::tables::Table;

/// What to do about it.
const HELP: &str = "build it with `cargo build --release --features parquet`, or use tables in CSV";

/// Fails: the stage of that kind is not built.
pub fn check(format: Format, kind: Kind) -> Result<(), SettingsError> {
    Err(SettingsError::new(kind.key(), format!("this program was built without {}", format.name())).help(HELP))
}

/// Fails.
pub fn without_rows(format: Format, path: &Path, _: &Layout) -> Result<Dataset> {
    Err(not_built(format).in_file(path))
}

/// Fails.
pub fn read(format: Format, path: &Path, _: &Layout) -> Result<(Dataset, usize)> {
    Err(not_built(format).in_file(path))
}

/// Fails.
pub fn in_batches(format: Format, path: &Path, _: &Layout, _: usize) -> Result<Box<dyn RowsOfFile>> {
    Err(not_built(format).in_file(path))
}

/// Fails.
pub fn parquet(_: &Table) -> Result<Vec<u8>> {
    Err(not_built(Format::Parquet))
}

fn not_built(format: Format) -> Error {
    Error::usage(format!("this program was built without {}", format.name())).help(HELP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_without_them_says_how_to_get_them() {
        for format in [Format::Parquet, Format::ArrowIpc] {
            let error = without_rows(format, Path::new("a"), &Layout::default()).unwrap_err().to_string();
            assert!(error.starts_with(&format!("a: this program was built without {}", format.name())), "{error}");
            assert!(error.contains("cargo build --release --features parquet"), "{error}");
        }
    }
}
