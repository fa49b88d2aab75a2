//! The rows of many files in batches.

use std::path::{Path, PathBuf};

use abbe_core::{Batch, Batches, Dataset, Error, Result, SettingsError};
use abbe_table::FileInBatches;

use crate::assembly::{Assembly, append};

/// The rows of one file in batches.
pub trait RowsOfFile: Send + Sync {
    /// How many batches there are.
    fn count(&self) -> usize;

    /// How many rows a batch has, those that are left out too.
    fn rows(&self, batch: usize) -> usize;

    /// The rows of a batch, and how many are left out because a number was not measured; none may be left.
    fn read(&self, batch: usize) -> Result<(Dataset, usize)>;
}

impl RowsOfFile for FileInBatches {
    fn count(&self) -> usize {
        self.count()
    }

    fn rows(&self, batch: usize) -> usize {
        self.rows(batch)
    }

    fn read(&self, batch: usize) -> Result<(Dataset, usize)> {
        self.read(batch)
    }
}

/// The rows of files in batches, with what the settings do to them: each as it is in the data set of all rows.
pub struct InBatches<'a> {
    assembly: &'a Assembly,
    files: Vec<Box<dyn RowsOfFile>>,
    /// The parts of files of each batch: file, and batch of that file.
    batches: Vec<Vec<(usize, usize)>>,
    table: Option<Dataset>,
}

impl<'a> InBatches<'a> {
    /// Looks through the files by `file`, which gives each in batches of at most `rows` rows, before some are left out. Small files share
    /// a batch.
    ///
    /// What needs more rows than one batch (motion, means) must not be among the settings.
    pub fn new(
        assembly: &'a Assembly,
        rows: usize,
        file: impl Fn(&Path) -> Result<Box<dyn RowsOfFile>>,
    ) -> Result<Self> {
        let paths: Vec<PathBuf> = assembly.files()?;
        let files = paths.iter().map(|path| file(path)).collect::<Result<Vec<_>>>()?;
        let mut batches: Vec<Vec<(usize, usize)>> = Vec::new();
        let mut room = 0;
        for (number, file) in files.iter().enumerate() {
            for part in 0..file.count() {
                let own = file.rows(part);
                match batches.last_mut().filter(|_| own <= room) {
                    Some(last) => last.push((number, part)),
                    None => {
                        batches.push(vec![(number, part)]);
                        room = rows;
                    }
                }
                room = room.saturating_sub(own);
            }
        }
        Ok(Self { assembly, files, batches, table: assembly.joined_table()? })
    }
}

impl Batches for InBatches<'_> {
    fn count(&self) -> usize {
        self.batches.len()
    }

    fn read(&self, batch: usize) -> Result<Batch> {
        let none = || Error::data(format!("there is no batch {batch}"));
        let (mut data, mut left_out) = (Dataset::default(), 0);
        for (file, part) in self.batches.get(batch).ok_or_else(none)? {
            let (rows, out) = self.files[*file].read(*part)?;
            append(&mut data, rows)?;
            left_out += out;
        }
        Ok(Batch { data: self.assembly.part(data, self.table.as_ref())?, left_out })
    }
}

/// Refuses batches where a row needs rows of other batches: the settings by name, and whether they are there.
pub fn check_batches(needs: &[(&str, bool)]) -> Result<(), SettingsError> {
    match needs.iter().find(|(_, is_there)| *is_there) {
        Some((setting, _)) => Err(SettingsError::new(
            "batch_rows",
            format!("`{setting}` needs rows of other batches: this stage cannot be read in batches"),
        )
        .help(format!("leave out `batch_rows`, or `{setting}`"))),
        None => Ok(()),
    }
}
