//! Tables in Parquet and Arrow IPC: ingest with the meaning of `ingest: csv`, and results as Parquet.
//!
//! `format` knows the libraries, which are there with the feature `parquet` only. All else is built always: a program without the
//! feature knows the stages, and says that they are not built. `arrow` alone takes batches of Arrow from a program.

#[cfg(feature = "arrow")]
pub mod arrow;
mod export;
mod format;
mod ingest;
mod tables;

pub use format::parquet;
pub use tables::{OfRows, OfTable, Table};
