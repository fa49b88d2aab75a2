//! A file in batches of rows: where each begins is looked up once, and each is read when it is asked for.
//!
//! A packed file is unpacked once to look it up, and once for each time that all batches are asked for in turn.

use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use abbe_core::{Dataset, Error, Result};
use abbe_files::Packing;

use crate::layout::{Encoding, Layout};
use crate::lost_rows::no_lost_row;
use crate::parse::{Head, cells, dataset};
use crate::text::{BYTE_ORDER_MARK, LONGEST_LINE, NO_LINE_END, text, text_of_part};
use crate::unpacking::{Part, Unpacking};
use crate::{bytes_of, unreadable};

/// The rows of a file in batches. A batch has so many rows of data, the last one may have less.
///
/// The file has to be as it was when it was looked through, and is not held open.
pub struct FileInBatches {
    path: PathBuf,
    layout: Layout,
    head: Head,
    batches: Vec<Span>,
    /// What is unpacked, if the file is packed.
    packed: Option<Mutex<Unpacking>>,
}

/// Where a batch stands in its file, or in what is packed there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Span {
    /// Bytes before it.
    start: u64,
    /// Its bytes.
    length: u64,
    /// Lines before it.
    lines: usize,
    /// Rows of data before it.
    before: usize,
    /// Its rows of data.
    rows: usize,
}

impl FileInBatches {
    /// Looks through a file.
    ///
    /// Fails as reading the whole file does where its header or its first row is wrong, and for what has no lines that can be found
    /// without reading all: text in UTF-16, and lines that end in a carriage return alone.
    pub fn new(path: &Path, layout: &Layout, rows: usize) -> Result<Self> {
        let content = abbe_files::open_content(path).map_err(|error| unreadable(path, &error))?;
        let packed = (content.packing() != Packing::None).then(|| Mutex::new(Unpacking::new(path)));
        if layout.encoding == Encoding::Utf16 {
            let error = Error::usage("text in UTF-16 is not read in batches").in_file(path);
            return Err(error.help("save it as UTF-8, or leave `batch_rows` out"));
        }
        let mut lines = Lines {
            path,
            layout,
            reader: BufReader::with_capacity(1 << 16, content),
            line: Vec::new(),
            read: 0,
            bytes: 0,
        };
        let mut head = lines.head()?;
        let batches = lines.batches(&mut head, rows)?;
        if batches.is_empty() {
            // The error that says why.
            dataset(path, &bytes_of(path)?, layout)?;
        }
        Ok(Self { path: path.to_owned(), layout: layout.clone(), head, batches, packed })
    }

    /// How many batches there are.
    pub fn count(&self) -> usize {
        self.batches.len()
    }

    /// How many rows of data a batch has, those that are left out too.
    pub fn rows(&self, batch: usize) -> usize {
        self.batches.get(batch).map_or(0, |batch| batch.rows)
    }

    /// The rows of a batch, and how many are left out because a number was not measured; none may be left.
    pub fn read(&self, batch: usize) -> Result<(Dataset, usize)> {
        let path = &self.path;
        let none = || Error::data(format!("there is no batch {batch}")).in_file(path);
        let span = self.batches.get(batch).ok_or_else(none)?;
        let bytes = self.bytes(batch, *span).map_err(|error| unreadable(path, &error))?;
        if bytes.len() as u64 != span.length {
            let error = Error::data("the file has become shorter while it was read").in_file(path);
            return Err(error.help("run again, with files that stay as they are meanwhile"));
        }
        let text = text_of_part(path, &bytes, self.layout.encoding, span.lines)?;
        self.head.part(path, &text, [span.lines, span.before], &self.layout)
    }

    /// The bytes of a batch, as many as there are.
    fn bytes(&self, batch: usize, Span { start, length, .. }: Span) -> io::Result<Vec<u8>> {
        if let Some(packed) = &self.packed {
            let parts: Vec<Part> = self.batches.iter().map(|span| (span.start, span.length)).collect();
            return packed.lock().unwrap_or_else(PoisonError::into_inner).part(batch, &parts);
        }
        let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
        let mut file = abbe_files::open(&self.path)?;
        file.seek(SeekFrom::Start(start))?;
        file.take(length).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// The lines of a file, one at a time.
struct Lines<'a, R: Read> {
    path: &'a Path,
    layout: &'a Layout,
    reader: BufReader<R>,
    /// The present line, with the character that ends it.
    line: Vec<u8>,
    /// Lines that were read.
    read: usize,
    /// Their bytes.
    bytes: u64,
}

impl<R: Read> Lines<'_, R> {
    /// Goes to the next line; false if there is none.
    fn advance(&mut self) -> Result<bool> {
        self.line.clear();
        let most = LONGEST_LINE as u64;
        let count = self.reader.by_ref().take(most).read_until(b'\n', &mut self.line);
        let count = count.map_err(|error| unreadable(self.path, &error))? as u64;
        self.read += usize::from(count > 0);
        self.bytes += count;
        let wrong = |message: &str, help: &str| Err(Error::data(message).at(self.path, self.read, None).help(help));
        let own = self.line.strip_suffix(b"\r\n").unwrap_or(&self.line);
        if own.contains(&b'\r') {
            return wrong(
                "the line ends in a carriage return alone, and such files are not read in batches",
                "save it with line feeds, or leave `batch_rows` out",
            );
        }
        if count == most {
            return wrong(NO_LINE_END, "name another file");
        }
        Ok(count > 0)
    }

    /// Reads the lines up to the first that may be a row of data: titles, the header row, rows after it.
    fn head(&mut self) -> Result<Head> {
        let (mut head, mut wanted) = (Vec::new(), usize::from(self.layout.has_header) + self.layout.skip_after_header);
        while (self.read < self.layout.skip_lines || wanted > 0) && self.advance()? {
            head.extend_from_slice(&self.line);
            let is_title = self.read <= self.layout.skip_lines;
            wanted -= usize::from(!is_title && self.is_row()?);
        }
        Head::new(self.path, &text(self.path, &head, self.layout.encoding)?, self.layout)
    }

    /// Reads all other lines. Where no header row says how many cells a row has, the first row does.
    fn batches(&mut self, head: &mut Head, rows: usize) -> Result<Vec<Span>> {
        let mut batches: Vec<Span> = Vec::new();
        let (mut start, mut before) = ((self.bytes, self.read), 0);
        while self.advance()? {
            if self.is_row()? {
                if head.width.is_none() {
                    head.width = Some(self.cells()?.len());
                }
                if batches.last().is_none_or(|last| last.rows == rows) {
                    // What stands between two batches belongs to the second one.
                    batches.push(Span { start: start.0, length: 0, lines: start.1, before, rows: 0 });
                }
                before += 1;
                if let Some(last) = batches.last_mut() {
                    last.rows += 1;
                    last.length = self.bytes - last.start;
                }
                start = (self.bytes, self.read);
            }
        }
        Ok(batches)
    }

    /// Whether the present line is a row: no comment, and not blank.
    fn is_row(&self) -> Result<bool> {
        let line = match self.read {
            1 => self.line.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&self.line),
            _ => &self.line,
        };
        // Nearly all lines are decided by their first character.
        let is_sure = line.iter().any(|byte| byte.is_ascii_graphic() && *byte != b'"');
        if line.starts_with(b"#") {
            return no_lost_row(self.path, self.read, &String::from_utf8_lossy(line)).map(|()| false);
        }
        if is_sure {
            return Ok(true);
        }
        let cells = self.cells()?;
        Ok(cells.len() > 1 || cells.iter().any(|cell| !cell.trim().is_empty()))
    }

    /// The cells of the present line.
    fn cells(&self) -> Result<Vec<String>> {
        let text = text_of_part(self.path, &self.line, self.layout.encoding, self.read.saturating_sub(1))?;
        cells(self.path, &text, self.layout.separator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(content: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("touches.csv");
        std::fs::write(&path, content).unwrap();
        (folder, path)
    }

    /// All batches of a file one after another, and the rows that are left out.
    fn joined(path: &Path, layout: &Layout, rows: usize) -> Result<(Dataset, usize)> {
        let file = FileInBatches::new(path, layout, rows)?;
        let mut all: Option<(Dataset, usize)> = None;
        for batch in 0..file.count() {
            let (data, left_out) = file.read(batch)?;
            let Some((all, out)) = &mut all else {
                all = Some((data, left_out));
                continue;
            };
            *out += left_out;
            all.origins.extend(data.origins);
            for (column, more) in all.columns.iter_mut().zip(data.columns) {
                match (&mut column.values, more.values) {
                    (abbe_core::Values::Numbers(all), abbe_core::Values::Numbers(more)) => all.extend(more),
                    (abbe_core::Values::Labels(all), abbe_core::Values::Labels(more)) => all.extend(more),
                    _ => panic!("another kind of column"),
                }
            }
        }
        Ok(all.expect("a batch"))
    }

    #[test]
    fn batches_are_the_rows_of_the_file() {
        let plain =
            "\u{feff}# titles\nfeature,X_mm\n\na,1\n# a note\n\"b\",2\n \n\"\"\n\u{a0}\nc,-\nd,4\r\ne,5\n#\nPAR1,6";
        let no_header = "t\nt\n1 2\n3 4\n5 6\n";
        let columns = |x: &str| {
            let source = crate::ColumnSource { column: x.to_owned(), unit: None };
            Some([("X_mm".to_owned(), source)].into())
        };
        let units = "X_mm;n\nmm;-\n1,5;\u{e4}\n2,5;b\n";
        let latin = abbe_latin(units);
        for (content, layout) in [
            (plain.as_bytes(), Layout { no_data: vec!["-".to_owned()], ..Layout::default() }),
            (
                no_header.as_bytes(),
                Layout {
                    skip_lines: 2,
                    has_header: false,
                    separator: crate::Separator::Space,
                    columns: columns("2"),
                    ..Layout::default()
                },
            ),
            (
                &latin,
                Layout {
                    separator: crate::Separator::Semicolon,
                    decimal: crate::Decimal::Comma,
                    encoding: Encoding::Latin1,
                    skip_after_header: 1,
                    ..Layout::default()
                },
            ),
        ] {
            let (_folder, path) = file(content);
            let expected = crate::read_laid_out(&path, &layout).unwrap();
            for rows in 1..8 {
                assert_eq!(joined(&path, &layout, rows).unwrap(), expected, "{rows}");
            }
            for packing in [Packing::Gzip, Packing::Zstandard] {
                std::fs::write(&path, packing.pack(content.to_vec())).unwrap();
                for rows in 1..8 {
                    assert_eq!(joined(&path, &layout, rows).unwrap(), expected, "{packing:?} {rows}");
                }
            }
        }
    }

    /// Whatever the order in which batches are asked for, and by how many threads.
    #[test]
    fn packed_batches_come_in_any_order() {
        let rows: String = (0..400).map(|row| format!("f{row},{row}\n")).collect();
        let (_folder, path) = file(&Packing::Gzip.pack(format!("feature,X_mm\n{rows}").into_bytes()));
        let batches = FileInBatches::new(&path, &Layout::default(), 7).unwrap();
        let read = |batch: usize| {
            let (data, _) = batches.read(batch).unwrap();
            assert_eq!(data.required_numbers("X").unwrap()[0], 7.0 * batch as f64);
            assert_eq!(data.origins[0], abbe_core::RowOrigin { file: 0, line: 7 * batch + 2, row: 7 * batch + 1 });
        };
        (0..batches.count()).rev().chain([3, 50, 3]).for_each(read);
        let all: Vec<usize> = (0..batches.count()).collect();
        abbe_core::in_parallel(&all, Some(5), |batch| read(*batch));
    }

    fn abbe_latin(text: &str) -> Vec<u8> {
        crate::text::encoded(text, Encoding::Latin1)
    }

    #[test]
    fn errors_are_those_of_the_file() {
        let rows = "a,1\nb,2\nc,3\n";
        for wrong in ["d,x\n", "d\n", "d,1,2\n", "\"d,1\ne,2\n", "d,1\u{0}\n", "d,\n"] {
            let (_folder, path) = file(format!("feature,X_mm\n{rows}{wrong}{rows}").as_bytes());
            let expected = crate::read(&path).unwrap_err();
            for rows in 1..9 {
                let found = joined(&path, &Layout::default(), rows).unwrap_err();
                assert_eq!((&found.message, &found.place), (&expected.message, &expected.place), "{wrong:?} {rows}");
            }
        }
        let (_folder, path) = file(b"feature,X_mm\na,1\n\xff,2\n");
        let expected = crate::read(&path).unwrap_err();
        assert_eq!(joined(&path, &Layout::default(), 1).unwrap_err(), expected);
        for nothing in ["", "feature,X_mm\n", "feature,X_mm", "#\n"] {
            let (_folder, path) = file(nothing.as_bytes());
            let expected = crate::read(&path).unwrap_err();
            assert_eq!(FileInBatches::new(&path, &Layout::default(), 5).err(), Some(expected), "{nothing:?}");
        }
    }

    #[test]
    fn what_has_no_lines_is_refused() {
        let refused = |content: &[u8], encoding| {
            let (_folder, path) = file(content);
            let layout = Layout { encoding, ..Layout::default() };
            FileInBatches::new(&path, &layout, 5).err().expect("it is refused").to_string()
        };
        assert!(refused(&Packing::Gzip.pack(b"X_mm\r1\r".to_vec()), Encoding::Utf8).contains("carriage return alone"));
        assert!(refused(b"X_mm\n1\n", Encoding::Utf16).contains("UTF-16"));
        assert!(refused(b"X_mm\r1\r2\r", Encoding::Utf8).contains("carriage return alone"));
    }

    #[test]
    fn a_file_that_becomes_shorter_is_told() {
        let (_folder, path) = file(b"X_mm\n1\n2\n3\n");
        let batches = FileInBatches::new(&path, &Layout::default(), 1).unwrap();
        std::fs::write(&path, b"X_mm\n1\n").unwrap();
        assert!(batches.read(0).is_ok());
        assert!(batches.read(2).unwrap_err().to_string().contains("has become shorter"));
        let packed = |content: &[u8]| std::fs::write(&path, Packing::Gzip.pack(content.to_vec())).unwrap();
        packed(b"X_mm\n1\n2\n3\n");
        let batches = FileInBatches::new(&path, &Layout::default(), 1).unwrap();
        packed(b"X_mm\n1\n");
        assert!(batches.read(0).is_ok());
        assert!(batches.read(2).unwrap_err().to_string().contains("has become shorter"));
    }

    #[test]
    fn a_broken_packed_file_is_told_at_once() {
        let packed = Packing::Gzip.pack((0..9999).map(|row| format!("{row}\n")).collect::<String>().into_bytes());
        let (_folder, path) = file(&packed[..packed.len() / 2]);
        let error = FileInBatches::new(&path, &Layout::default(), 100).err().unwrap().to_string();
        assert!(error.contains("packed by gzip, and ends too early"), "{error}");
    }
}
