//! Values of trials that were solved before, in blocks.

use std::io::{self, BufReader, Read};
use std::path::Path;

use abbe_core::{Error, Result};

use crate::{Found, MAY_FAIL, Propagation};

impl Propagation {
    /// Adds the trials of a file, in the order of their numbers. A trial that failed has no number at all.
    ///
    /// Fails for a file that has not as many numbers as there are trials and quantities, and as solving the trials here does if too
    /// many of them failed.
    pub(crate) fn read(&self, path: &Path, quantities: usize, found: &mut Found) -> Result<()> {
        let unreadable = |error: io::Error| Error::data(format!("the file cannot be read: {error}")).in_file(path);
        let file = abbe_files::open(path).map_err(unreadable)?;
        let trials = self.settings.trials.get();
        let (expected, size) = (8 * trials as u64 * quantities as u64, file.metadata().map_err(unreadable)?.len());
        if size != expected {
            let message =
                format!("{trials} trials of {quantities} quantities are {expected} bytes; the file has {size}");
            return Err(Error::data(message).help("name the file that was made for this recipe").in_file(path));
        }
        let mut reader = BufReader::with_capacity(1 << 16, file);
        let mut row = vec![0.0; quantities];
        for _ in 0..trials {
            for value in &mut row {
                let mut bytes = [0; 8];
                reader.read_exact(&mut bytes).map_err(unreadable)?;
                *value = f64::from_le_bytes(bytes);
            }
            if !row.is_empty() && row.iter().all(|value| value.is_nan()) {
                found.failed += 1;
                continue;
            }
            found.trials.push(&row);
            if let (Some(samples), true) = (&mut found.samples, self.settings.keep_samples) {
                samples.extend_from_slice(&row);
            }
        }
        match found.failed as f64 > MAY_FAIL * trials as f64 {
            true => Err(Error::data(format!("{} of {trials} trials failed", found.failed))),
            false => Ok(()),
        }
    }
}
