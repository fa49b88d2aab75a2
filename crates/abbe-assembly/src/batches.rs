//! The rows of many files in batches.

use std::path::PathBuf;

use abbe_core::{Batch, Batches, Dataset, Error, Result};
use abbe_table::{FileInBatches, Layout};

use crate::assembly::{Assembly, append};

/// The rows of tables of text in batches, with what the settings do to them: each as it is in the data set of all rows.
pub struct InBatches<'a> {
    assembly: &'a Assembly,
    files: Vec<FileInBatches>,
    /// The parts of files of each batch: file, and batch of that file.
    batches: Vec<Vec<(usize, usize)>>,
    table: Option<Dataset>,
}

impl<'a> InBatches<'a> {
    /// Looks through the files. A batch has at most `rows` rows, before some are left out; small files share one.
    ///
    /// What needs more rows than one batch (motion, means) must not be among the settings.
    pub fn new(assembly: &'a Assembly, layout: &Layout, rows: usize) -> Result<Self> {
        let paths: Vec<PathBuf> = assembly.files()?;
        let files = paths.iter().map(|path| FileInBatches::new(path, layout, rows)).collect::<Result<Vec<_>>>()?;
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
