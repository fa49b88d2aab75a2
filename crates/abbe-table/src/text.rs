//! From bytes to text, whatever editor or control has written them.

use std::borrow::Cow;
use std::io::{self, BufRead};
use std::path::Path;
use std::str;

use abbe_core::{Error, Result};

use crate::layout::Encoding;

pub const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Byte order marks of UTF-16, in which spreadsheets write "Unicode text".
const OF_UTF_16: [&[u8]; 2] = [b"\xff\xfe", b"\xfe\xff"];

/// How files in UTF-32 begin; the first as one in UTF-16 does, but no text in UTF-16 begins with a zero.
const OF_UTF_32: [&[u8]; 2] = [b"\xff\xfe\x00", b"\x00\x00\xfe\xff"];

/// Bytes of the longest line of a header: 16 MiB.
pub const LONGEST_LINE: usize = 16 << 20;

/// What is wrong with a longer one.
pub const NO_LINE_END: &str = "no line ends within 16 MiB: it is no table with one row a line";

/// Whether bytes may be text in UTF-16: they begin with its mark, or every second of the first is zero.
pub fn may_be_utf_16(bytes: &[u8]) -> bool {
    OF_UTF_16.iter().any(|mark| bytes.starts_with(mark))
        || (bytes.len() >= 4 && bytes[0] != 0 && bytes[1] == 0 && bytes[2] != 0 && bytes[3] == 0)
}

/// The format of a file that is a table by columns, and what reads it.
fn of_columns(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    match bytes {
        [b'P', b'A', b'R', b'1', ..] => Some(("Parquet", "parquet")),
        [b'A', b'R', b'R', b'O', b'W', b'1', 0, ..] => Some(("Arrow IPC", "arrow-ipc")),
        _ => None,
    }
}

/// The text of a file without byte order mark, in which every line ends in LF or CRLF.
///
/// Fails for what is no text in this encoding, and for zero bytes.
pub fn text<'a>(path: &Path, bytes: &'a [u8], encoding: Encoding) -> Result<Cow<'a, str>> {
    if OF_UTF_32.iter().any(|mark| bytes.starts_with(mark)) {
        let error = Error::data("the file is text in UTF-32, which is not read").in_file(path);
        return Err(
            error.help("save it as UTF-8; for a table that `ingest: csv` reads, UTF-16 with `encoding: utf-16` does")
        );
    }
    if let Some((format, plugin)) = of_columns(bytes) {
        return Err(Error::data(format!("the file is a table in the format {format}, and no text"))
            .in_file(path)
            .help(format!("`ingest: {plugin}` reads it")));
    }
    let is_marked = OF_UTF_16.iter().any(|mark| bytes.starts_with(mark));
    match encoding {
        Encoding::Utf8 if is_marked => Err(Error::data("the file is text in UTF-16; UTF-8 was expected")
            .in_file(path)
            .help("save it as UTF-8; for a table that `ingest: csv` reads, `encoding: utf-16` does")),
        Encoding::Utf8 => utf_8(path, bytes),
        Encoding::Utf16 => utf_16(path, bytes),
        Encoding::Latin1 => characters(path, bytes, encoding_rs::WINDOWS_1252, "Latin-1"),
        Encoding::Gb18030 => characters(path, bytes, encoding_rs::GB18030, "GB 18030"),
    }
}

/// The same of a part of a file, which begins after so many lines. It may not be in UTF-16.
pub fn text_of_part<'a>(path: &Path, bytes: &'a [u8], encoding: Encoding, lines: usize) -> Result<Cow<'a, str>> {
    let text = match encoding {
        Encoding::Utf8 => utf_8(path, bytes),
        _ => text(path, bytes, encoding),
    };
    text.map_err(|mut error| {
        if let Some(line) = error.place.as_mut().and_then(|place| place.line.as_mut()) {
            *line += lines;
        }
        error
    })
}

/// Text in an encoding of bytes that is none of Unicode's own.
fn characters<'a>(
    path: &Path,
    bytes: &'a [u8],
    encoding: &'static encoding_rs::Encoding,
    name: &str,
) -> Result<Cow<'a, str>> {
    if let Some((marked, _)) = encoding_rs::Encoding::for_bom(bytes) {
        let unicode = if marked == encoding_rs::UTF_8 { "8" } else { "16" };
        let error = Error::data(format!("the file is text in UTF-{unicode}; {name} was expected"));
        return Err(error.in_file(path).help(format!("write `encoding: utf-{unicode}`")));
    }
    let (text, is_wrong) = encoding.decode_without_bom_handling(bytes);
    match text.find(char::REPLACEMENT_CHARACTER).filter(|_| is_wrong) {
        Some(at) => Err(wrong(path, &format!("the file is not text in {name}"), &text[..at])),
        None => no_zeros(path, text),
    }
}

fn utf_8<'a>(path: &Path, bytes: &'a [u8]) -> Result<Cow<'a, str>> {
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    if let Some(zero) = bytes.iter().position(|byte| *byte == 0) {
        return Err(wrong(path, NO_TEXT, &String::from_utf8_lossy(&bytes[..zero])));
    }
    let text = str::from_utf8(bytes).map_err(|error| {
        let before = String::from_utf8_lossy(&bytes[..error.valid_up_to()]);
        wrong(path, "the file is not text in UTF-8", &before)
    })?;
    Ok(with_line_feeds(Cow::Borrowed(text)))
}

fn utf_16<'a>(path: &Path, bytes: &[u8]) -> Result<Cow<'a, str>> {
    let [low_first, high_first] = OF_UTF_16;
    let (bytes, high) = match bytes.strip_prefix(high_first) {
        Some(rest) => (rest, 0),
        None => (bytes.strip_prefix(low_first).unwrap_or(bytes), 1),
    };
    if bytes.len() % 2 == 1 {
        let error = Error::data("the file has an odd number of bytes, so that it is no text in UTF-16");
        return Err(error.in_file(path).help("`encoding` has to be that of the file"));
    }
    let units = bytes.chunks_exact(2).map(|pair| u16::from(pair[high]) << 8 | u16::from(pair[1 - high]));
    let mut text = String::with_capacity(bytes.len() / 2);
    for character in char::decode_utf16(units) {
        match character {
            Ok(character) => text.push(character),
            Err(_) => return Err(wrong(path, "the file is not text in UTF-16", &text)),
        }
    }
    no_zeros(path, Cow::Owned(text))
}

/// The bytes of a text in an encoding, so that [`text()`] gives it back; characters that the encoding does not have become references.
pub fn encoded(text: &str, encoding: Encoding) -> Vec<u8> {
    match encoding {
        Encoding::Utf8 => text.as_bytes().to_vec(),
        Encoding::Utf16 => {
            let units = text.encode_utf16().flat_map(u16::to_le_bytes);
            OF_UTF_16[0].iter().copied().chain(units).collect()
        }
        Encoding::Latin1 => encoding_rs::WINDOWS_1252.encode(text).0.into_owned(),
        Encoding::Gb18030 => encoding_rs::GB18030.encode(text).0.into_owned(),
    }
}

const NO_TEXT: &str = "the file holds a zero byte: it is no text";

fn no_zeros<'a>(path: &Path, text: Cow<'a, str>) -> Result<Cow<'a, str>> {
    match text.find('\0') {
        Some(zero) => Err(wrong(path, NO_TEXT, &text[..zero])),
        None => Ok(with_line_feeds(text)),
    }
}

/// An error at the place that follows this text.
fn wrong(path: &Path, message: &str, before: &str) -> Error {
    let good = with_line_feeds(Cow::Borrowed(before));
    let column = good.chars().rev().take_while(|&c| c != '\n').count() + 1;
    let help = "`abbe data FILE` tells the likely encoding; `encoding` says it where the file is read by `ingest: csv`";
    Error::data(message).at(path, 1 + newlines(&good), Some(column)).help(help)
}

/// The text with a line feed where a carriage return alone ends a line.
fn with_line_feeds(text: Cow<'_, str>) -> Cow<'_, str> {
    let bytes = text.as_bytes();
    let ends_line = |(at, _): (usize, &str)| bytes.get(at + 1) != Some(&b'\n');
    if !text.match_indices('\r').any(ends_line) {
        return text;
    }
    Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n"))
}

/// Number of line ends in a text.
pub fn newlines(text: &str) -> usize {
    text.bytes().filter(|&byte| byte == b'\n').count()
}

/// Adds the next line to `line`, with the character that ends it; a zero byte ends it as well. False if there is none.
pub fn read_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    let start = line.len();
    loop {
        let buffer = reader.fill_buf()?;
        if buffer.is_empty() {
            return Ok(line.len() > start);
        }
        let end = buffer.iter().position(|byte| matches!(byte, b'\n' | b'\r' | 0));
        let taken = end.map_or(buffer.len(), |end| end + 1);
        line.extend_from_slice(&buffer[..taken]);
        reader.consume(taken);
        if end.is_some() {
            return Ok(true);
        }
        if line.len() - start > LONGEST_LINE {
            return Err(io::Error::new(io::ErrorKind::InvalidData, NO_LINE_END));
        }
    }
}
