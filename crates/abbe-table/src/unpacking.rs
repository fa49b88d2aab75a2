//! A packed file, of which one part after another is unpacked.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::thread::available_parallelism;

use abbe_files::Content;

/// A part of the content: bytes before it, and its own.
pub(crate) type Part = (u64, u64);

/// A packed file whose parts are asked for nearly in their order. To go back means to unpack from the beginning, so parts that are passed
/// over wait until they are asked for: several threads ask for neighbours, and one of them is first.
pub(crate) struct Unpacking {
    path: PathBuf,
    /// What is not read yet; none before the beginning.
    content: Option<Content<File>>,
    /// Bytes of the content that are read.
    read: u64,
    /// The part that comes next.
    next: usize,
    /// Parts that were passed over.
    waiting: BTreeMap<usize, Vec<u8>>,
    /// How many parts wait at most.
    most: usize,
    /// How often the file was opened.
    opened: usize,
}

impl Unpacking {
    pub fn new(path: &Path) -> Self {
        let most = available_parallelism().map_or(1, usize::from);
        Self { path: path.to_owned(), content: None, read: 0, next: 0, waiting: BTreeMap::new(), most, opened: 0 }
    }

    /// One of the parts, shorter where the content ends too early.
    pub fn part(&mut self, wanted: usize, parts: &[Part]) -> io::Result<Vec<u8>> {
        if let Some(found) = self.waiting.remove(&wanted) {
            return Ok(found);
        }
        if self.next > wanted || self.content.is_none() {
            self.rewind()?;
        }
        self.next = self.next.max(wanted.saturating_sub(self.most));
        while self.next < wanted {
            let passed = self.unpack(parts[self.next])?;
            self.waiting.insert(self.next, passed);
            self.next += 1;
        }
        while self.waiting.len() > self.most {
            self.waiting.pop_first();
        }
        let found = self.unpack(parts[wanted])?;
        self.next += 1;
        Ok(found)
    }

    fn rewind(&mut self) -> io::Result<()> {
        self.content = Some(abbe_files::open_content(&self.path)?);
        (self.read, self.next) = (0, 0);
        self.opened += 1;
        Ok(())
    }

    /// Unpacks up to the end of a part that is not behind.
    fn unpack(&mut self, (start, length): Part) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0));
        // After an error the next part begins from the beginning.
        let Some(mut content) = self.content.take() else { return Ok(bytes) };
        self.read += io::copy(&mut content.by_ref().take(start.saturating_sub(self.read)), &mut io::sink())?;
        self.read += content.by_ref().take(length).read_to_end(&mut bytes)? as u64;
        self.content = Some(content);
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use abbe_files::Packing;

    use super::*;

    #[test]
    fn parts_that_are_passed_over_wait() {
        let content: Vec<u8> = (0..=255).collect();
        // A gap before every part.
        let parts: Vec<Part> = (0..16).map(|part| (16 * part + 3, 13)).collect();
        for packing in [Packing::Gzip, Packing::Zstandard] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a");
            std::fs::write(&path, packing.pack(content.clone())).unwrap();
            let mut file = Unpacking { most: 2, ..Unpacking::new(&path) };
            let mut asked = |part: usize| {
                let found = file.part(part, &parts).unwrap();
                assert_eq!(found, content[16 * part + 3..16 * part + 16], "{part}");
                file.opened
            };
            for part in [1, 0, 3, 4, 2, 7, 5, 6, 9, 8, 10] {
                assert_eq!(asked(part), 1, "{part}");
            }
            // Three further on: the first of those that are passed over does not wait.
            assert_eq!([asked(14), asked(13), asked(12), asked(11)], [1, 1, 1, 2]);
            assert_eq!([asked(15), asked(0)], [2, 3]);
        }
    }

    #[test]
    fn a_file_that_ends_too_early_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, Packing::Gzip.pack(b"1234".to_vec())).unwrap();
        let mut file = Unpacking::new(&path);
        assert_eq!(file.part(1, &[(0, 2), (2, 9)]).unwrap(), b"34");
        let packed = std::fs::read(&path).unwrap();
        std::fs::write(&path, &packed[..packed.len() - 9]).unwrap();
        assert!(file.part(0, &[(0, 4)]).is_err() || file.part(0, &[(0, 5)]).is_err());
    }
}
