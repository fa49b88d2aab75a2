//! Ingest of files: tables (`csv`), logs whose lines a pattern describes (`text`), logs of measuring programs (`log`), and files
//! of other software (`instrument`).
//!
//! Many files give one data set, with columns set as constants or joined from a table (`abbe-assembly`).

mod csv;
mod instrument;
mod log;
mod text;

#[cfg(test)]
mod tests;
