//! Ingest of files: tables (`csv`), logs whose lines a pattern describes (`text`), and logs of measuring programs (`log`).
//!
//! Many files give one data set, with columns set as constants or joined from a table (`assembly`).

mod assembly;
mod average;
mod csv;
mod files;
mod log;
mod text;

#[cfg(test)]
mod tests;
