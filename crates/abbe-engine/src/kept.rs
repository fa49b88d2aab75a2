//! Batches that are read from their files once: what they hold is kept as numbers in a temporary file, for the passes that follow.
//!
//! To read text again takes as long as all else that a pass does. The file has no name, so that nothing of it stays, and is in the
//! folder for temporary files (`TMPDIR`). Where it cannot be written, files are read again.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};

use abbe_core::{Batch, Batches, Column, ColumnHeader, Dataset, LabelText, Result, RowOrigin, StatedTip, Values};
use serde::{Deserialize, Serialize};

use crate::batches::Sources;
use crate::prepare::Prepared;

/// Batches of a data set, each of which is read from its files once.
pub(crate) struct Kept<'a> {
    source: Box<dyn Batches + 'a>,
    /// The columns of all batches.
    headers: OnceLock<Vec<ColumnHeader>>,
    store: Mutex<Store>,
}

/// What is kept of batches, one after another.
struct Store {
    /// None where nothing can be kept.
    file: Option<File>,
    /// Its bytes.
    length: u64,
    /// Where each batch stands, and its bytes.
    places: Vec<Option<(u64, usize)>>,
}

/// A batch as it is kept. The numbers of its columns follow, one column after another: to read them one by one takes long.
#[derive(Serialize, Deserialize)]
struct Content {
    columns: Vec<Cells>,
    origins: Vec<Run>,
    files: Vec<PathBuf>,
    averaged: bool,
    is_log: bool,
    /// Diameter, file and line of stated tips.
    tips: Vec<(f64, usize, usize)>,
    left_out: usize,
}

/// Rows that stand one below the other in a file.
#[derive(Serialize, Deserialize)]
struct Run {
    rows: usize,
    file: usize,
    /// Line and row of the first; a file without lines has lines of zero.
    line: usize,
    row: usize,
}

/// The cells of a column. Labels repeat: each stands there once, and cells have its place.
#[derive(Serialize, Deserialize)]
enum Cells {
    /// So many.
    Numbers(usize),
    Labels {
        distinct: Vec<LabelText>,
        places: Vec<u32>,
    },
}

impl Prepared {
    /// The data sets that are read in batches, for several passes.
    pub(crate) fn sources_read_once(&self) -> Result<Sources<'_>> {
        let kept = |source| Box::new(Kept::new(source)) as Box<dyn Batches>;
        Ok(self.sources()?.into_iter().map(|(ingest, source)| (ingest, kept(source))).collect())
    }
}

impl<'a> Kept<'a> {
    /// The same batches.
    pub fn new(source: Box<dyn Batches + 'a>) -> Self {
        let places = vec![None; source.count()];
        let store = Store { file: tempfile::tempfile().ok(), length: 0, places };
        Self { source, headers: OnceLock::new(), store: Mutex::new(store) }
    }

    /// A batch that is kept.
    fn found(&self, batch: usize) -> Option<Batch> {
        let bytes = self.store.lock().unwrap_or_else(PoisonError::into_inner).read(batch)?;
        let (content, numbers) = postcard::take_from_bytes::<Content>(&bytes).ok()?;
        content.batch(self.headers.get()?, numbers)
    }

    fn keep(&self, number: usize, batch: &Batch) {
        let headers = batch.data.headers();
        // Other columns than those of the first batch: read again.
        let is_kept = *self.headers.get_or_init(|| headers.clone()) == headers;
        if let Some(mut bytes) = is_kept.then(|| postcard::to_stdvec(&Content::of(batch)).ok()).flatten() {
            for column in &batch.data.columns {
                if let Values::Numbers(numbers) = &column.values {
                    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
                }
            }
            self.store.lock().unwrap_or_else(PoisonError::into_inner).write(number, &bytes);
        }
    }
}

impl Batches for Kept<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn read(&self, batch: usize) -> Result<Batch> {
        if let Some(found) = self.found(batch) {
            return Ok(found);
        }
        let read = self.source.read(batch)?;
        self.keep(batch, &read);
        Ok(read)
    }
}

impl Store {
    fn read(&mut self, batch: usize) -> Option<Vec<u8>> {
        let (start, length) = (*self.places.get(batch)?)?;
        let file = self.file.as_mut()?;
        let mut bytes = vec![0; length];
        file.seek(SeekFrom::Start(start)).and_then(|_| file.read_exact(&mut bytes)).ok()?;
        Some(bytes)
    }

    /// Adds a batch. A file that cannot be written, on a disk that is full, gives back its room.
    fn write(&mut self, batch: usize, bytes: &[u8]) {
        let Some(file) = &mut self.file else { return };
        let written = file.seek(SeekFrom::Start(self.length)).and_then(|_| file.write_all(bytes));
        match (written, self.places.get_mut(batch)) {
            (Ok(()), Some(place)) => {
                *place = Some((self.length, bytes.len()));
                self.length += bytes.len() as u64;
            }
            _ => self.file = None,
        }
    }
}

impl Content {
    fn of(batch: &Batch) -> Self {
        let Batch { data, left_out } = batch;
        Self {
            columns: data.columns.iter().map(|column| Cells::of(&column.values)).collect(),
            origins: Run::of(&data.origins),
            files: data.files.clone(),
            averaged: data.averaged,
            is_log: data.is_log,
            tips: data.stated_tips.iter().map(|tip| (tip.diameter, tip.file, tip.line)).collect(),
            left_out: *left_out,
        }
    }

    /// The batch, with its numbers; none if what was kept is not whole.
    fn batch(self, headers: &[ColumnHeader], mut numbers: &[u8]) -> Option<Batch> {
        let rows = self.origins.iter().map(|run| run.rows).sum();
        let columns = headers.iter().zip(self.columns);
        let columns = columns
            .map(|(header, cells)| Some(Column { header: header.clone(), values: cells.values(rows, &mut numbers)? }));
        let tips = self.tips.into_iter().map(|(diameter, file, line)| StatedTip { diameter, file, line });
        let data = Dataset {
            columns: columns.collect::<Option<Vec<Column>>>().filter(|columns| columns.len() == headers.len())?,
            origins: self.origins.iter().flat_map(Run::origins).collect(),
            files: self.files,
            averaged: self.averaged,
            is_log: self.is_log,
            stated_tips: tips.collect(),
        };
        Some(Batch { data, left_out: self.left_out })
    }
}

impl Run {
    fn of(origins: &[RowOrigin]) -> Vec<Self> {
        let is_next = |one: &RowOrigin, other: &RowOrigin| {
            let has_lines = usize::from(one.line > 0);
            (one.file, one.line + has_lines, one.row + 1) == (other.file, other.line, other.row)
        };
        let run =
            |rows: &[RowOrigin]| Self { rows: rows.len(), file: rows[0].file, line: rows[0].line, row: rows[0].row };
        origins.chunk_by(is_next).map(run).collect()
    }

    fn origins(&self) -> impl Iterator<Item = RowOrigin> + use<> {
        let Self { rows, file, line, row } = *self;
        let has_lines = usize::from(line > 0);
        (0..rows).map(move |next| RowOrigin { file, line: line + has_lines * next, row: row + next })
    }
}

impl Cells {
    fn of(values: &Values) -> Self {
        match values {
            Values::Numbers(numbers) => Self::Numbers(numbers.len()),
            Values::Labels(labels) => {
                let (mut distinct, mut known) = (Vec::new(), HashMap::new());
                let mut places = Vec::with_capacity(labels.len());
                for label in labels {
                    let next = distinct.len() as u32;
                    let place = *known.entry(label).or_insert(next);
                    if place == next {
                        distinct.push(label.clone());
                    }
                    places.push(place);
                }
                Self::Labels { distinct, places }
            }
        }
    }

    /// The cells of `count` rows; numbers are the next ones.
    fn values(self, count: usize, numbers: &mut &[u8]) -> Option<Values> {
        match self {
            Self::Numbers(own) => {
                let bytes = numbers.split_off(..(own == count).then_some(8 * count)?)?;
                Some(Values::Numbers(bytes.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()))
            }
            Self::Labels { distinct, places } => {
                let labels = places.into_iter().map(|place| distinct.get(place as usize).cloned());
                let labels: Option<Vec<LabelText>> = labels.collect();
                labels.filter(|labels| labels.len() == count).map(Values::Labels)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Batches that count how often they are read.
    struct Counted(AtomicUsize);

    impl Batches for &Counted {
        fn count(&self) -> usize {
            3
        }

        fn read(&self, batch: usize) -> Result<Batch> {
            self.0.fetch_add(1, Ordering::Relaxed);
            let number = batch as f64;
            let column = |header: &str, values| Column { header: ColumnHeader::parse(header), values };
            let columns = vec![
                column("X_mm", Values::Numbers(vec![0.1 + number, -0.0, f64::NAN, f64::MIN_POSITIVE])),
                column("feature", Values::Labels(["a", "µ", "a", ""].map(LabelText::from).to_vec())),
            ];
            let origin = |row| RowOrigin { file: row % 2, line: 100 * batch + row, row: 99 * batch + row };
            let data = Dataset {
                columns,
                origins: (0..4).map(origin).collect(),
                files: vec![PathBuf::from("a.csv"), PathBuf::from(format!("{batch}.csv"))],
                stated_tips: vec![StatedTip { diameter: number, file: 1, line: 2 }],
                ..Dataset::default()
            };
            Ok(Batch { data, left_out: batch })
        }
    }

    /// All that a batch has; NaN, too, with the bits of numbers.
    fn shown(batch: &Batch) -> (String, Vec<u64>) {
        let numbers = batch.data.numbers("X").unwrap().iter().map(|number| number.to_bits());
        (format!("{batch:?}"), numbers.collect())
    }

    #[test]
    fn batches_are_read_once_and_stay_as_they_are() {
        let counted = Counted(AtomicUsize::new(0));
        let kept = Kept::new(Box::new(&counted));
        for _ in 0..3 {
            for batch in [2, 0, 1] {
                assert_eq!(
                    shown(&kept.read(batch).unwrap()),
                    shown(&(&Counted(AtomicUsize::new(0))).read(batch).unwrap())
                );
            }
        }
        assert_eq!(counted.0.load(Ordering::Relaxed), 3);
    }

    #[test]
    fn without_a_file_they_are_read_again() {
        let counted = Counted(AtomicUsize::new(0));
        let kept = Kept::new(Box::new(&counted));
        kept.read(0).unwrap();
        kept.store.lock().unwrap().file = None;
        for batch in [0, 1, 0] {
            assert_eq!(kept.read(batch).unwrap().left_out, batch);
        }
        assert_eq!(counted.0.load(Ordering::Relaxed), 4);
    }
}
