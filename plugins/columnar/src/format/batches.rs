//! Files of columns in batches of rows. What a batch needs of its file is read when it is asked for.

use std::ops::Range;
use std::path::{Path, PathBuf};

use abbe_assembly::RowsOfFile;
use abbe_core::{Dataset, Error, Result};
use abbe_table::Layout;

use super::guard::guarded;
use super::{Format, arrow_rows, parquet_rows};

/// A file of which any rows can be read without those before them.
pub(super) trait AnyRows: Send + Sync {
    /// How many rows it has.
    fn count(&self) -> usize;

    /// These rows, and how many of them are left out because a number was not measured.
    fn read(&self, rows: Range<usize>) -> Result<(Dataset, usize)>;
}

/// The rows of a file in batches.
struct InBatches {
    format: Format,
    path: PathBuf,
    file: Box<dyn AnyRows>,
    /// Rows of a batch.
    rows: usize,
}

/// A file in batches of so many rows; the last one may have less. Groups of rows in the file do not matter.
pub fn in_batches(format: Format, path: &Path, layout: &Layout, rows: usize) -> Result<Box<dyn RowsOfFile>> {
    let file = guarded(format, path, || -> Result<Box<dyn AnyRows>> {
        Ok(match format {
            Format::Parquet => Box::new(parquet_rows::Rows::new(path, layout)?),
            Format::ArrowIpc => Box::new(arrow_rows::Rows::new(path, layout)?),
        })
    })?;
    if file.count() == 0 {
        // The error that says so.
        super::built::read(format, path, layout)?;
    }
    Ok(Box::new(InBatches { format, path: path.to_owned(), file, rows: rows.max(1) }))
}

impl InBatches {
    fn range(&self, batch: usize) -> Range<usize> {
        let end = |batches: usize| self.rows.saturating_mul(batches).min(self.file.count());
        end(batch)..end(batch.saturating_add(1))
    }
}

impl RowsOfFile for InBatches {
    fn count(&self) -> usize {
        self.file.count().div_ceil(self.rows)
    }

    fn rows(&self, batch: usize) -> usize {
        self.range(batch).len()
    }

    fn read(&self, batch: usize) -> Result<(Dataset, usize)> {
        guarded(self.format, &self.path, || self.file.read(self.range(batch)))
    }
}

/// Refuses more rows than the content of a file of this size may have, 8 bytes a cell.
pub(super) fn check_rows(path: &Path, rows: usize, columns: usize, size: u64) -> Result<()> {
    let (content, most) =
        ((rows as u64).saturating_mul(8).saturating_mul(columns as u64), abbe_files::most_content(size));
    if content <= most {
        return Ok(());
    }
    let message = format!("the content has more than {} MiB, the most that is read of a file of its size", most >> 20);
    Err(Error::data(message).in_file(path).help("is it a table of measurements? One by one they take more room"))
}

/// The groups in which rows stand, with the rows of each that are wanted. `groups` are the rows of each group.
pub(super) fn parts_of(groups: impl IntoIterator<Item = usize>, wanted: &Range<usize>) -> Vec<(usize, Range<usize>)> {
    let (mut parts, mut before) = (Vec::new(), 0);
    for (group, rows) in groups.into_iter().enumerate() {
        let end = before + rows;
        let (from, to) = (wanted.start.max(before), wanted.end.min(end));
        if from < to {
            parts.push((group, from - before..to - before));
        }
        before = end;
    }
    parts
}

#[cfg(test)]
mod tests {
    use abbe_core::Values;

    use super::super::tests::{FORMATS, Random, bytes, tried};
    use super::super::{arrow_ipc, built};
    use super::*;

    /// All batches of a file one after another, and the rows that are left out. The last batch is read first.
    fn joined(format: Format, path: &Path, layout: &Layout, rows: usize) -> Result<(Dataset, usize)> {
        let file = in_batches(format, path, layout, rows)?;
        file.read(file.count() - 1)?;
        let (mut all, mut out) = file.read(0)?;
        for batch in 1..file.count() {
            assert!(file.rows(batch) <= rows && file.rows(batch - 1) == rows);
            let (data, left_out) = file.read(batch)?;
            out += left_out;
            all.origins.extend(data.origins);
            for (column, more) in all.columns.iter_mut().zip(data.columns) {
                match (&mut column.values, more.values) {
                    (Values::Numbers(all), Values::Numbers(more)) => all.extend(more),
                    (Values::Labels(all), Values::Labels(more)) => all.extend(more),
                    _ => panic!("another kind of column"),
                }
            }
        }
        Ok((all, out))
    }

    #[test]
    fn batches_are_the_rows_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tried");
        for seed in 0..60 {
            let random = &mut Random(seed);
            let tried = tried(random, seed % 3 == 0);
            let no_data = if seed % 3 == 0 { vec![String::new()] } else { Vec::new() };
            let layout = Layout { no_data, ..Layout::default() };
            for format in FORMATS {
                std::fs::write(&path, bytes(format, &tried, random)).unwrap();
                let whole = built::read(format, &path, &layout);
                for rows in [1 + random.below(20), 1 + random.below(400), usize::MAX] {
                    let found = joined(format, &path, &layout, rows);
                    match (&found, &whole) {
                        (Ok(found), Ok(whole)) => assert_eq!(found, whole, "{seed} {format:?} {rows}"),
                        // Where no row is left the stage says so, of all its files.
                        (Ok((data, _)), Err(_)) => assert_eq!(data.rows(), 0, "{seed} {format:?} {rows}"),
                        (Err(found), _) => panic!("{seed} {format:?} {rows}: {found}"),
                    }
                }
            }
        }
    }

    /// Broken files end with an error, as they do as a whole.
    #[test]
    fn broken_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tried");
        let (mut refused, layout) = (0, Layout::default());
        for seed in 0..60 {
            let random = &mut Random(seed);
            let tried = tried(random, false);
            for format in FORMATS {
                let mut content = bytes(format, &tried, random);
                match seed % 2 {
                    0 => content.truncate(random.below(content.len())),
                    _ => (0..5).for_each(|_| {
                        let place = random.below(content.len());
                        content[place] ^= 1 << random.below(8);
                    }),
                }
                std::fs::write(&path, content).unwrap();
                let (whole, found) = (built::read(format, &path, &layout), joined(format, &path, &layout, 17));
                refused += usize::from(found.is_err());
                assert!(seed % 2 == 1 || found.is_err() && whole.is_err(), "{seed} {format:?}");
            }
        }
        assert!(refused > 60, "{refused}");
    }

    #[test]
    fn what_follows_the_end_of_arrow_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tried");
        let random = &mut Random(3);
        let content = bytes(Format::ArrowIpc, &tried(random, false), random);
        std::fs::write(&path, [content.clone(), content].concat()).unwrap();
        let error = in_batches(Format::ArrowIpc, &path, &Layout::default(), 10).err().unwrap();
        assert_eq!(error, arrow_ipc::read(&path, &Layout::default()).unwrap_err());
    }

    #[test]
    fn more_rows_than_a_file_can_have_are_refused() {
        assert!(check_rows(Path::new("a"), usize::MAX, 3, 1000).unwrap_err().to_string().contains("64 MiB"));
        assert!(check_rows(Path::new("a"), 1000, 3, 1000).is_ok());
    }
}
