//! Arrow IPC: files, which are called Feather (version 2) too, and streams.
//!
//! A file is a stream between two marks, with a list of its parts behind it. The list is not needed to read all rows in turn.

use std::fmt::Display;
use std::io::Read;
use std::path::Path;

use abbe_core::{Dataset, Result};
use abbe_table::{Layout, NamedColumns, unreadable};
use arrow_array::RecordBatch;
use arrow_buffer::Buffer;
use arrow_ipc::reader::StreamDecoder;
use arrow_ipc::{Message, RecordBatch as Described, root_as_message};
use arrow_schema::Schema;

use super::Format::ArrowIpc;
use super::built::{Growing, fields};
use super::guard::broken;

/// What a file begins and ends with; the beginning has two zeros more.
const MARK: &[u8] = b"ARROW1";

/// Bytes of the beginning of a file.
const BEGIN: usize = 8;

/// What stands before the length of a part, since version 0.15 of the format.
const CONTINUES: [u8; 4] = [0xff; 4];

/// Bytes in which the description of the columns has to be: 16 MiB.
const LARGEST_SCHEMA: u64 = 16 << 20;

/// The schema of a file.
pub fn schema(path: &Path) -> Result<Schema> {
    let failed = |why: &dyn Display| broken(ArrowIpc, path, why);
    let file = abbe_files::open(path).map_err(|error| unreadable(path, &error))?;
    let mut bytes = Vec::new();
    file.take(LARGEST_SCHEMA).read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
    let mut stream = Stream::new(bytes);
    stream.advance().map_err(|why| failed(&why))?;
    let schema = stream.decoder.schema().ok_or_else(|| failed(&"it does not describe its columns"))?;
    Ok(schema.as_ref().clone())
}

/// The data set of a file, and the number of rows that are left out.
pub fn read(path: &Path, layout: &Layout) -> Result<(Dataset, usize)> {
    let failed = |why: &dyn Display| broken(ArrowIpc, path, why);
    let mut file = abbe_files::open(path).map_err(|error| unreadable(path, &error))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
    if bytes.starts_with(MARK) && (bytes.len() < BEGIN + MARK.len() || !bytes.ends_with(MARK)) {
        return Err(failed(&"it ends too early"));
    }
    let size = bytes.len() as u64;
    let mut stream = Stream::new(bytes);
    let mut data: Option<Growing> = None;
    loop {
        let batch = match stream.advance().map_err(|why| failed(&why))? {
            Part::Rows(batch) => Some(batch),
            Part::Other => None,
            Part::End => break,
        };
        if let (None, Some(schema)) = (&data, stream.decoder.schema()) {
            let named = NamedColumns::new(path, &fields(&schema), layout)?;
            let places = named.fields();
            data = Some(Growing::new(path, named, places, layout, size));
        }
        if let (Some(data), Some(batch)) = (&mut data, batch) {
            data.add(&batch)?;
        }
    }
    data.ok_or_else(|| failed(&"it does not describe its columns"))?.finish()
}

/// A part of a stream.
enum Part {
    /// Rows.
    Rows(RecordBatch),
    /// The schema, or values that later rows refer to.
    Other,
    /// The end.
    End,
}

/// The parts of a stream one after the other, each looked at before room is made for what it says.
struct Stream {
    bytes: Buffer,
    at: usize,
    /// Bytes that the content may have.
    most: u64,
    decoder: StreamDecoder,
}

impl Stream {
    fn new(bytes: Vec<u8>) -> Self {
        let at = if bytes.starts_with(MARK) { BEGIN.min(bytes.len()) } else { 0 };
        let most = abbe_files::most_content(bytes.len() as u64);
        Self { bytes: Buffer::from_vec(bytes), at, most, decoder: StreamDecoder::new() }
    }

    fn advance(&mut self) -> Result<Part, String> {
        let start = self.at;
        // A stream that was cut off between two parts would be one with fewer rows: the mark of its end has to be there.
        let mut length = self.four(start)?;
        let mut head = start + 4;
        if length == CONTINUES {
            length = self.four(head)?;
            head += 4;
        }
        let length = u32::from_le_bytes(length) as usize;
        if length == 0 {
            return Ok(Part::End);
        }
        let bytes = self.bytes.as_slice();
        let behind = head.checked_add(length).filter(|end| *end <= bytes.len()).ok_or(TOO_EARLY)?;
        let message = root_as_message(&bytes[head..behind]).map_err(|why| why.to_string())?;
        let body = usize::try_from(message.bodyLength()).map_err(|_| "a part of it has a negative length")?;
        let end = behind.checked_add(body).filter(|end| *end <= bytes.len()).ok_or(TOO_EARLY)?;
        check(&message, &bytes[behind..end], self.most)?;
        let mut part = self.bytes.slice_with_length(start, end - start);
        self.at = end;
        let rows = self.decoder.decode(&mut part).map_err(|why| why.to_string())?;
        Ok(rows.map_or(Part::Other, Part::Rows))
    }

    fn four(&self, at: usize) -> Result<[u8; 4], String> {
        let found = self.bytes.as_slice().get(at..at + 4).and_then(|four| four.try_into().ok());
        found.ok_or_else(|| TOO_EARLY.to_owned())
    }
}

const TOO_EARLY: &str = "it ends too early";

/// Refuses packed columns that would become larger than what is read of such a file: room is made for them first.
fn check(message: &Message<'_>, body: &[u8], most: u64) -> Result<(), String> {
    let of_dictionary = message.header_as_dictionary_batch().and_then(|dictionary| dictionary.data());
    let Some(described) = message.header_as_record_batch().or(of_dictionary) else { return Ok(()) };
    let mut content = 0u64;
    for length in lengths(&described, body)? {
        content = content.saturating_add(length);
        if content > most {
            return Err(format!(
                "its content has more than {} MiB, the most that is read of a file of its size",
                most >> 20
            ));
        }
    }
    Ok(())
}

/// The lengths of the columns' content.
fn lengths(described: &Described<'_>, body: &[u8]) -> Result<Vec<u64>, String> {
    let buffers = described.buffers().into_iter().flatten();
    let is_packed = described.compression().is_some();
    let length = |buffer: &arrow_ipc::Buffer| {
        let (from, length) = (usize::try_from(buffer.offset()).ok()?, usize::try_from(buffer.length()).ok()?);
        let content = body.get(from..from.checked_add(length)?)?;
        Some(match content.first_chunk::<8>() {
            // The length of what is packed stands before it; -1 says that it is not.
            Some(stated) if is_packed => u64::try_from(i64::from_le_bytes(*stated)).unwrap_or(length as u64),
            _ => length as u64,
        })
    };
    let outside = || "a column of it stands outside of its part".to_owned();
    buffers.map(|buffer| length(buffer).ok_or_else(outside)).collect()
}
