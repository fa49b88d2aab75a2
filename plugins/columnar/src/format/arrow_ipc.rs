//! Arrow IPC: files, which are called Feather (version 2) too, and streams.
//!
//! A file is a stream between two marks, with a list of its parts behind it. The list is not needed to read all rows in turn.

use std::fmt::Display;
use std::io::Read;
use std::path::Path;

use abbe_core::{Dataset, Result};
use abbe_table::{Layout, NamedColumns, unreadable};
use arrow_buffer::Buffer;
use arrow_ipc::reader::StreamDecoder;
use arrow_ipc::{Message, RecordBatch as Described, root_as_message};
use arrow_schema::Schema;

use super::Format::ArrowIpc;
use super::built::Growing;
use super::guard::broken;
use crate::arrow::fields;

/// What a file begins and ends with. Zeros follow at the beginning, so that the stream begins at a multiple of 8; some writers add
/// more of them.
pub(super) const MARK: &[u8] = b"ARROW1";

/// Bytes of the beginning of a file, if no more zeros follow than have to.
const BEGIN: usize = 8;

/// What stands before the length of a part, since version 0.15 of the format.
pub(super) const CONTINUES: [u8; 4] = [0xff; 4];

/// Bytes in which the description of the columns has to be: 16 MiB.
const LARGEST_SCHEMA: u64 = 16 << 20;

/// The schema of a file.
pub fn schema(path: &Path) -> Result<Schema> {
    let failed = |why: &dyn Display| broken(ArrowIpc, path, why);
    let file = abbe_files::open(path).map_err(|error| unreadable(path, &error))?;
    let mut bytes = Vec::new();
    file.take(LARGEST_SCHEMA).read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
    let begin = begin(&bytes);
    let (Part::Of(end) | Part::Last(end)) = part(&bytes, begin, 0).map_err(|why| failed(&why))?;
    // A part is known when the next one begins, or the end.
    four(&bytes, end).map_err(|why| failed(&why))?;
    decoded_schema(&bytes[begin..end]).map_err(|why| failed(&why))
}

/// The schema in the first part of a stream.
pub(super) fn decoded_schema(part: &[u8]) -> Result<Schema, String> {
    // The decoder goes on to what follows, if it is there.
    let mut first = Buffer::from_vec([part, &CONTINUES].concat());
    let mut decoder = StreamDecoder::new();
    decoder.decode(&mut first).map_err(|why| why.to_string())?;
    Ok(decoder.schema().ok_or(NO_SCHEMA)?.as_ref().clone())
}

/// The data set of a file, and the number of rows that are left out.
pub fn read(path: &Path, layout: &Layout) -> Result<(Dataset, usize)> {
    let failed = |why: &dyn Display| broken(ArrowIpc, path, why);
    let mut file = abbe_files::open(path).map_err(|error| unreadable(path, &error))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
    if bytes.starts_with(MARK) && (bytes.len() < BEGIN + MARK.len() || !bytes.ends_with(MARK)) {
        return Err(failed(&TOO_EARLY));
    }
    let size = bytes.len() as u64;
    let begin = begin(&bytes);
    let end = checked(&bytes, begin, abbe_files::most_content(size)).map_err(|why| failed(&why))?;
    if more_follows(bytes.starts_with(MARK), &bytes[end..]) {
        return Err(failed(&BEHIND));
    }
    let mut rest = Buffer::from_vec(bytes).slice_with_length(begin, end - begin);
    let mut decoder = StreamDecoder::new();
    let mut data: Option<Growing> = None;
    loop {
        let batch = decoder.decode(&mut rest).map_err(|why| failed(&why))?;
        if let (None, Some(schema)) = (&data, decoder.schema()) {
            let named = NamedColumns::new(path, &fields(&schema), layout)?;
            let places = named.fields();
            data = Some(Growing::new(path, named, places, layout, size));
        }
        match (&mut data, batch) {
            (Some(data), Some(batch)) => data.add(&batch)?,
            _ => break,
        }
    }
    data.ok_or_else(|| failed(&NO_SCHEMA))?.finish()
}

pub(super) const TOO_EARLY: &str = "it ends too early";

/// What follows a file.
pub(super) const BEHIND: &str = "more follows behind the mark of its end: are several files in one?";

pub(super) const NO_SCHEMA: &str = "it does not describe its columns";

/// Where the stream begins.
pub(super) fn begin(bytes: &[u8]) -> usize {
    if !bytes.starts_with(MARK) {
        return 0;
    }
    let begin = BEGIN.min(bytes.len());
    // No part begins with 8 zeros: its length and its description follow each other.
    let zeros = bytes[begin..].chunks_exact(8).take_while(|bytes| bytes.iter().all(|byte| *byte == 0)).count();
    begin + 8 * zeros
}

/// A part of a stream, by its end.
pub(super) enum Part {
    /// The schema, rows, or values that later rows refer to.
    Of(usize),
    /// The mark of the end. A stream that was cut off between two parts would be one with fewer rows without it.
    Last(usize),
}

/// Looks at all parts before room is made for what they say; gives the end of the stream.
fn checked(bytes: &[u8], begin: usize, most: u64) -> Result<usize, String> {
    let mut at = begin;
    loop {
        match part(bytes, at, most)? {
            Part::Of(end) => at = end,
            Part::Last(end) => return Ok(end),
        }
    }
}

/// Whether anything but zeros stands between the end of the stream and the list of its parts, or the end of what has none. `rest` is what
/// follows the stream; a file that begins with the mark has the list.
pub(super) fn more_follows(is_file: bool, mut rest: &[u8]) -> bool {
    if is_file {
        // The list, its length in four bytes, and the mark.
        let length =
            rest.len().checked_sub(MARK.len() + 4).and_then(|at| rest[at..].first_chunk::<4>().map(|four| (at, *four)));
        let Some((at, length)) = length else { return true };
        let Some(list) = at.checked_sub(u32::from_le_bytes(length) as usize) else { return true };
        rest = &rest[..list];
    }
    rest.iter().any(|byte| *byte != 0)
}

/// The part that begins at a place. Its content may have `most` bytes.
pub(super) fn part(bytes: &[u8], start: usize, most: u64) -> Result<Part, String> {
    let mut length = four(bytes, start)?;
    let mut head = start + 4;
    if length == CONTINUES {
        length = four(bytes, head)?;
        head += 4;
    }
    let length = u32::from_le_bytes(length) as usize;
    if length == 0 {
        return Ok(Part::Last(head));
    }
    let behind = head.checked_add(length).filter(|end| *end <= bytes.len()).ok_or(TOO_EARLY)?;
    let message = root_as_message(&bytes[head..behind]).map_err(|why| why.to_string())?;
    let body = usize::try_from(message.bodyLength()).map_err(|_| "a part of it has a negative length")?;
    let end = behind.checked_add(body).filter(|end| *end <= bytes.len()).ok_or(TOO_EARLY)?;
    check(&message, &bytes[behind..end], most)?;
    Ok(Part::Of(end))
}

fn four(bytes: &[u8], at: usize) -> Result<[u8; 4], String> {
    let found = bytes.get(at..).and_then(|rest| rest.first_chunk::<4>());
    found.copied().ok_or_else(|| TOO_EARLY.to_owned())
}

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
