//! Ingest of files: tables (`csv`) and logs whose lines a pattern describes (`text`).
//!
//! Many files give one data set, with columns set as constants or joined from a table (`assembly`).

mod assembly;
mod average;
mod csv;
mod files;
mod text;

#[cfg(test)]
mod tests;
