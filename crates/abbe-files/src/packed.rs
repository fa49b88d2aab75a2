//! Files that gzip or Zstandard has packed, read as what they hold.
//!
//! The content decides, not the name. What comes out is bounded: a few bytes may stand for gigabytes.

use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, ErrorKind, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::bufread::MultiGzDecoder;
use flate2::write::GzEncoder;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

/// How many times as large as a packed file its content may be. Measurements have digits that no program foresees.
const MOST_TIMES: u64 = 100;

/// Bytes of the content that any packed file may have: 64 MiB.
const ALWAYS: u64 = 64 << 20;

/// Bytes of the largest content of a packed file: 16 GiB.
const LARGEST_CONTENT: u64 = 16 << 30;

/// Bytes that tell how a file is packed.
const HEAD: usize = 4;

/// The endings of packed files.
const ENDINGS: [&str; 2] = ["gz", "zst"];

/// How many bytes the content of a packed file of so many bytes may have.
pub fn most_content(packed: u64) -> u64 {
    packed.saturating_mul(MOST_TIMES).clamp(ALWAYS, LARGEST_CONTENT)
}

/// The name of a file without the ending that a program of packing adds: `a.csv` of `a.csv.gz`.
///
/// ```
/// # use std::path::Path;
/// assert_eq!(abbe_files::without_packing(Path::new("data/a.csv.zst")), Path::new("data/a.csv"));
/// assert_eq!(abbe_files::without_packing(Path::new("data/a.csv")), Path::new("data/a.csv"));
/// ```
pub fn without_packing(file: &Path) -> std::path::PathBuf {
    match file.extension().and_then(|ending| ending.to_str()) {
        Some(ending) if ENDINGS.contains(&ending) => file.with_extension(""),
        _ => file.to_owned(),
    }
}

/// How a file is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packing {
    /// Not at all.
    None,
    /// By gzip (RFC 1952).
    Gzip,
    /// By Zstandard (RFC 8878).
    Zstandard,
}

impl Packing {
    /// How a file is packed that begins so.
    pub fn of(head: &[u8]) -> Self {
        match head {
            [0x1f, 0x8b, 0x08, ..] => Self::Gzip,
            [0x28, 0xb5, 0x2f, 0xfd, ..] | [0x50..=0x5f, 0x2a, 0x4d, 0x18, ..] => Self::Zstandard,
            _ => Self::None,
        }
    }

    /// The content packed in this way; the same bytes for the same content.
    pub fn pack(self, content: Vec<u8>) -> Vec<u8> {
        match self {
            Self::None => content,
            Self::Gzip => {
                let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
                // Writing into memory does not fail.
                let packed = encoder.write_all(&content).and_then(|()| encoder.finish());
                packed.unwrap_or_default()
            }
            Self::Zstandard => compress_to_vec(content.as_slice(), CompressionLevel::Fastest),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Gzip => "gzip",
            Self::Zstandard => "Zstandard",
        }
    }
}

/// Why a packed file cannot be read.
#[derive(Debug)]
struct Unreadable(String);

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Unreadable {}

/// Whether an error is one of the content of a packed file, and not of the disk.
pub fn is_of_packing(error: &io::Error) -> bool {
    error.get_ref().is_some_and(|error| error.is::<Unreadable>())
}

/// The content of a file, packed or not.
pub struct Content<R: Read> {
    source: Source<R>,
    packing: Packing,
    /// Bytes that were read, and the most that there may be.
    read: u64,
    most: u64,
}

type Bytes<R> = BufReader<io::Chain<Cursor<Vec<u8>>, R>>;

enum Source<R: Read> {
    Plain(Bytes<R>),
    Gzip(Box<MultiGzDecoder<Bytes<R>>>),
    Zstandard(Box<Frames<Bytes<R>>>),
}

/// The content of a regular file: what is packed in it if gzip or Zstandard has packed it, else the file itself.
///
/// # Errors
/// As [`crate::open`]; reading fails for a packed file that is broken or whose content is too large ([`is_of_packing`]).
pub fn open_content(path: &Path) -> io::Result<Content<File>> {
    let file = crate::open(path)?;
    let size = file.metadata()?.len();
    Content::new(file, size)
}

/// The content of bytes as [`open_content`] reads it from a file, and how they are packed.
///
/// # Errors
/// As reading what [`open_content`] gives.
pub fn content_of(bytes: Vec<u8>) -> io::Result<(Vec<u8>, Packing)> {
    let packing = Packing::of(&bytes);
    if packing == Packing::None {
        return Ok((bytes, packing));
    }
    let mut content = Vec::new();
    Content::new(bytes.as_slice(), bytes.len() as u64)?.read_to_end(&mut content)?;
    Ok((content, packing))
}

impl<R: Read> Content<R> {
    fn new(mut file: R, size: u64) -> io::Result<Self> {
        let mut head = Vec::with_capacity(HEAD);
        file.by_ref().take(HEAD as u64).read_to_end(&mut head)?;
        let packing = Packing::of(&head);
        let bytes = BufReader::new(Cursor::new(head).chain(file));
        let source = match packing {
            Packing::None => Source::Plain(bytes),
            Packing::Gzip => Source::Gzip(Box::new(MultiGzDecoder::new(bytes))),
            Packing::Zstandard => Source::Zstandard(Box::new(Frames::new(bytes))),
        };
        Ok(Self { source, packing, read: 0, most: most_content(size) })
    }

    /// How the file is packed.
    pub fn packing(&self) -> Packing {
        self.packing
    }

    fn unreadable(&self, kind: ErrorKind, message: String) -> io::Error {
        io::Error::new(kind, Unreadable(format!("it is packed by {}, {message}", self.packing.name())))
    }
}

impl<R: Read> Read for Content<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let found = match &mut self.source {
            Source::Plain(bytes) => return bytes.read(buffer),
            Source::Gzip(decoder) => decoder.read(buffer),
            Source::Zstandard(frames) => frames.read(buffer),
        };
        let count = found.map_err(|error| match error.kind() {
            ErrorKind::Interrupted => error,
            ErrorKind::UnexpectedEof => {
                let message = format!("and ends too early, after {} bytes of its content", self.read);
                self.unreadable(ErrorKind::InvalidData, message)
            }
            // What the library says of it helps nobody.
            ErrorKind::InvalidData | ErrorKind::InvalidInput => {
                let message = format!("and broken after {} bytes of its content", self.read);
                self.unreadable(ErrorKind::InvalidData, message)
            }
            _ => error,
        })?;
        self.read += count as u64;
        match self.read > self.most {
            true => {
                let most = self.most >> 20;
                let message =
                    format!("and its content has more than {most} MiB, the most that is read of a file of its size");
                Err(self.unreadable(ErrorKind::FileTooLarge, message))
            }
            false => Ok(count),
        }
    }
}

/// The frames of Zstandard one after the other.
struct Frames<R> {
    bytes: R,
    decoder: FrameDecoder,
    is_begun: bool,
}

impl<R: BufRead> Frames<R> {
    fn new(bytes: R) -> Self {
        Self { bytes, decoder: FrameDecoder::new(), is_begun: false }
    }

    /// Goes to the next frame that has content; false if there is none.
    fn begin(&mut self) -> io::Result<bool> {
        while !self.bytes.fill_buf()?.is_empty() {
            match self.decoder.reset(&mut self.bytes) {
                Ok(()) => {
                    self.is_begun = true;
                    return Ok(true);
                }
                Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                    let length = u64::from(length);
                    if io::copy(&mut self.bytes.by_ref().take(length), &mut io::sink())? < length {
                        return Err(ErrorKind::UnexpectedEof.into());
                    }
                }
                Err(error) => return Err(io::Error::new(ErrorKind::InvalidData, error.to_string())),
            }
        }
        Ok(false)
    }

    /// Refuses a frame whose content is not that of its check sum.
    fn end(&mut self) -> io::Result<()> {
        self.is_begun = false;
        match (self.decoder.get_checksum_from_data(), self.decoder.get_calculated_checksum()) {
            (Some(stated), Some(found)) if stated != found => {
                Err(io::Error::new(ErrorKind::InvalidData, "its check sum does not agree"))
            }
            _ => Ok(()),
        }
    }
}

impl<R: BufRead> Read for Frames<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            if !self.is_begun && !self.begin()? {
                return Ok(0);
            }
            while self.decoder.can_collect() == 0 && !self.decoder.is_finished() {
                self.decoder
                    .decode_blocks(&mut self.bytes, BlockDecodingStrategy::UptoBlocks(1))
                    .map_err(|error| io::Error::new(ErrorKind::InvalidData, error.to_string()))?;
            }
            let count = self.decoder.read(buffer)?;
            if count > 0 {
                return Ok(count);
            }
            self.end()?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Packing; 2] = [Packing::Gzip, Packing::Zstandard];

    fn text(rows: usize) -> Vec<u8> {
        (0..rows).flat_map(|row| format!("{row},{}\n", (row as f64).sin()).into_bytes()).collect()
    }

    fn refused(bytes: Vec<u8>) -> String {
        let error = content_of(bytes).unwrap_err();
        assert!(is_of_packing(&error), "{error}");
        error.to_string()
    }

    #[test]
    fn what_is_packed_is_read_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("named.csv");
        for packing in ALL {
            for content in [Vec::new(), b"a".to_vec(), text(20_000)] {
                let packed = packing.pack(content.clone());
                assert_eq!(packing.pack(content.clone()), packed);
                assert_eq!(content_of(packed.clone()).unwrap(), (content.clone(), packing));
                // Several parts one after the other are one content.
                let twice = [packed.clone(), packed.clone()].concat();
                assert_eq!(content_of(twice).unwrap().0, [content.clone(), content.clone()].concat());
                std::fs::write(&file, &packed).unwrap();
                let mut read = Vec::new();
                let mut opened = open_content(&file).unwrap();
                opened.read_to_end(&mut read).unwrap();
                assert_eq!((read, opened.packing()), (content, packing));
            }
        }
        assert_eq!(content_of(b"\x1f\x8b".to_vec()).unwrap(), (b"\x1f\x8b".to_vec(), Packing::None));
        // A part that holds no content is skipped.
        let skipped =
            [&[0x51, 0x2a, 0x4d, 0x18, 2, 0, 0, 0, 9, 9][..], &Packing::Zstandard.pack(b"b".to_vec())].concat();
        assert_eq!(content_of(skipped).unwrap().0, b"b");
    }

    #[test]
    fn what_is_broken_is_refused() {
        for packing in ALL {
            let packed = packing.pack(text(3_000));
            for end in [5, packed.len() / 2, packed.len() - 1] {
                refused(packed[..end].to_vec());
            }
            let mut changed = 0;
            for at in (10..packed.len()).step_by(97) {
                let mut broken = packed.clone();
                broken[at] ^= 0x10;
                // A changed name or time in the head of gzip changes no content.
                match content_of(broken) {
                    Ok((content, _)) => assert_eq!(content, text(3_000), "{packing:?} at {at}"),
                    Err(error) => {
                        assert!(is_of_packing(&error), "{error}");
                        changed += 1;
                    }
                }
            }
            assert!(changed > 50, "{changed}");
            let message = refused([&packed[..], b"what is no part"].concat());
            assert!(message.contains("broken after"), "{message}");
        }
    }

    #[test]
    fn a_few_bytes_do_not_become_gigabytes() {
        for packing in ALL {
            let packed = packing.pack(vec![b'1'; 65 << 20]);
            assert!(packed.len() < 1 << 20, "{packing:?}: {}", packed.len());
            let message = refused(packed);
            assert!(message.contains("more than 64 MiB"), "{message}");
        }
        assert_eq!(most_content(1 << 20), 100 << 20);
        assert_eq!(most_content(u64::MAX), 16 << 30);
    }
}
