//! From bytes to text, whatever editor or control has written them.

use std::borrow::Cow;
use std::io::{self, BufRead};
use std::path::Path;
use std::str;

use abbe_core::{Error, Result};

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Byte order marks of UTF-16, in which spreadsheets write "Unicode text".
const OF_UTF_16: [&[u8]; 2] = [b"\xff\xfe", b"\xfe\xff"];

/// Bytes of the longest line of a header: 16 MiB.
const LONGEST_LINE: usize = 16 << 20;

/// The text of a file without byte order mark, in which every line ends in LF or CRLF.
///
/// Fails for what is no text: other encodings, zero bytes.
pub fn text<'a>(path: &Path, bytes: &'a [u8]) -> Result<Cow<'a, str>> {
    if OF_UTF_16.iter().any(|mark| bytes.starts_with(mark)) {
        return Err(Error::data("the file is text in UTF-16; UTF-8 was expected")
            .in_file(path)
            .help("save it as UTF-8"));
    }
    let bytes = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let wrong = |message: &str, before: &[u8]| {
        let good = with_line_feeds(Cow::Owned(String::from_utf8_lossy(before).into_owned()));
        let column = good.chars().rev().take_while(|&c| c != '\n').count() + 1;
        Error::data(message).at(path, 1 + newlines(&good), Some(column))
    };
    if let Some(zero) = bytes.iter().position(|byte| *byte == 0) {
        return Err(wrong("the file holds a zero byte: it is no text", &bytes[..zero]));
    }
    let text =
        str::from_utf8(bytes).map_err(|error| wrong("the file is not text in UTF-8", &bytes[..error.valid_up_to()]))?;
    Ok(with_line_feeds(Cow::Borrowed(text)))
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
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a line of it has no end within 16 MiB"));
        }
    }
}
