//! What stands in files of columns, and how it is written.

#[cfg(feature = "parquet")]
mod arrow_ipc;
#[cfg(feature = "parquet")]
mod arrow_rows;
#[cfg(feature = "parquet")]
mod batches;
#[cfg(feature = "parquet")]
mod guard;
#[cfg(not(feature = "parquet"))]
mod not_built;
#[cfg(feature = "parquet")]
mod parquet;
#[cfg(feature = "parquet")]
mod parquet_rows;
#[cfg(all(test, feature = "parquet"))]
mod tests;

#[cfg(feature = "parquet")]
mod built;
#[cfg(feature = "parquet")]
pub use batches::in_batches;
#[cfg(feature = "parquet")]
pub use built::{check, parquet, read, without_rows};
#[cfg(not(feature = "parquet"))]
pub use not_built::{check, in_batches, parquet, read, without_rows};

/// A format of files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Apache Parquet.
    Parquet,
    /// Apache Arrow, its format for files (Feather version 2) or for streams.
    ArrowIpc,
}

impl Format {
    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Parquet => "Parquet",
            Self::ArrowIpc => "Arrow IPC",
        }
    }
}
