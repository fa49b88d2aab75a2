//! Ingest of files: tables (`csv`), logs whose lines a pattern describes (`text`), logs of measuring programs (`log`), and files
//! of other software (`instrument`).
//!
//! Many files give one data set, with columns set as constants or joined from a table (`assembly`).

mod assembly;
mod average;
mod csv;
mod files;
mod instrument;
mod log;
mod motion;
mod text;

#[cfg(test)]
mod tests;
