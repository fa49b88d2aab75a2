//! Some rows of an Arrow IPC file: where its record batches stand is looked up once, and they are read when rows of them are asked for.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use abbe_core::{Dataset, Error, Result};
use abbe_table::{Layout, NamedColumns, unreadable};
use arrow_array::RecordBatch;
use arrow_buffer::Buffer;
use arrow_ipc::reader::StreamDecoder;
use arrow_ipc::root_as_message;

use super::Format::ArrowIpc;
use super::arrow_ipc::{
    BEHIND, CONTINUES, MARK, NO_SCHEMA, Part, TOO_EARLY, begin, decoded_schema, more_follows, part,
};
use super::batches::{AnyRows, check_rows, parts_of};
use super::built::Growing;
use super::guard::broken;
use crate::arrow::fields;

/// Bytes in which a file begins: its mark and zeros.
const LARGEST_BEGIN: u64 = 1 << 16;

/// Where a part stands: bytes before it, and its own.
type Place = (u64, u64);

/// Values that rows refer to.
struct Dictionary {
    id: i64,
    /// They are added to earlier ones.
    is_more: bool,
    place: Place,
}

/// Rows that were written together.
struct Group {
    place: Place,
    rows: usize,
    /// How many dictionaries come before.
    dictionaries: usize,
}

/// The rows of a file, which is not held open.
pub struct Rows {
    path: PathBuf,
    layout: Layout,
    size: u64,
    /// What describes the columns.
    schema: Place,
    dictionaries: Vec<Dictionary>,
    groups: Vec<Group>,
    count: usize,
    /// The group that was read last: its rows are asked for one part after another.
    last: Mutex<Option<(usize, RecordBatch)>>,
}

/// What a part of a file is.
enum Kind {
    Schema,
    Dictionary { id: i64, is_more: bool },
    Rows(usize),
}

impl Rows {
    /// Looks through the file, one part after another.
    pub fn new(path: &Path, layout: &Layout) -> Result<Self> {
        let unreadable = |error: io::Error| unreadable(path, &error);
        let failed = |why: &dyn Display| broken(ArrowIpc, path, why);
        let mut file = abbe_files::open(path).map_err(unreadable)?;
        let size = file.metadata().map_err(unreadable)?.len();
        let mut head = Vec::new();
        file.by_ref().take(LARGEST_BEGIN).read_to_end(&mut head).map_err(unreadable)?;
        let is_file = head.starts_with(MARK);
        if is_file && !ends_with_mark(&mut file, size).map_err(unreadable)? {
            return Err(failed(&TOO_EARLY));
        }
        let mut at = begin(&head) as u64;
        file.seek(SeekFrom::Start(at)).map_err(unreadable)?;
        let mut reader = BufReader::with_capacity(1 << 16, file);
        let (mut schema, mut dictionaries, mut groups) = (None, Vec::new(), Vec::new());
        loop {
            let message = message(&mut reader).map_err(|why| why.in_words(path))?;
            let is_last = match part(&message, 0, abbe_files::most_content(size)).map_err(|why| failed(&why))? {
                Part::Of(_) => false,
                Part::Last(_) => true,
            };
            let place = (at, message.len() as u64);
            at += place.1;
            if is_last {
                break;
            }
            match (kind(&message).map_err(|why| failed(&why))?, &schema) {
                (Kind::Schema, None) => {
                    let described = decoded_schema(&message).map_err(|why| failed(&why))?;
                    NamedColumns::new(path, &fields(&described), layout)?;
                    schema = Some((place, described.fields().len()));
                }
                (Kind::Schema, Some(_)) => return Err(failed(&"it describes its columns twice")),
                (_, None) => return Err(failed(&NO_SCHEMA)),
                (Kind::Dictionary { id, is_more }, _) => dictionaries.push(Dictionary { id, is_more, place }),
                (Kind::Rows(rows), _) => groups.push(Group { place, rows, dictionaries: dictionaries.len() }),
            }
        }
        let mut rest = Vec::new();
        reader.read_to_end(&mut rest).map_err(unreadable)?;
        if more_follows(is_file, &rest) {
            return Err(failed(&BEHIND));
        }
        let (schema, columns) = schema.ok_or_else(|| failed(&NO_SCHEMA))?;
        let count = groups.iter().try_fold(0usize, |all, group| all.checked_add(group.rows));
        let count = count.ok_or_else(|| failed(&"it has too many rows"))?;
        check_rows(path, count, columns, size)?;
        let (path, layout) = (path.to_owned(), layout.clone());
        Ok(Self { path, layout, size, schema, dictionaries, groups, count, last: Mutex::new(None) })
    }

    /// The rows of a group.
    fn group(&self, number: usize) -> Result<RecordBatch> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        match &*last {
            Some((known, rows)) if *known == number => return Ok(rows.clone()),
            _ => *last = None,
        }
        let rows = self.read_group(number)?;
        *last = Some((number, rows.clone()));
        Ok(rows)
    }

    fn read_group(&self, number: usize) -> Result<RecordBatch> {
        let group = &self.groups[number];
        let mut places = vec![self.schema];
        places.extend(needed(&self.dictionaries[..group.dictionaries]));
        places.push(group.place);
        let bytes = self.bytes(&places).map_err(|error| unreadable(&self.path, &error))?;
        let mut bytes = Buffer::from_vec(bytes);
        let found = StreamDecoder::new().decode(&mut bytes).map_err(|why| broken(ArrowIpc, &self.path, &why))?;
        let whole = found.filter(|rows| rows.num_rows() == group.rows);
        whole.ok_or_else(|| broken(ArrowIpc, &self.path, &"it has other rows than it says"))
    }

    /// Parts of the file as a stream of their own.
    fn bytes(&self, places: &[Place]) -> io::Result<Vec<u8>> {
        let mut file = abbe_files::open(&self.path)?;
        let mut bytes = Vec::new();
        for (start, length) in places {
            file.seek(SeekFrom::Start(*start))?;
            file.by_ref().take(*length).read_to_end(&mut bytes)?;
        }
        // A part is known when the end follows.
        bytes.extend([CONTINUES, [0; 4]].concat());
        Ok(bytes)
    }
}

impl AnyRows for Rows {
    fn count(&self) -> usize {
        self.count
    }

    fn read(&self, rows: Range<usize>) -> Result<(Dataset, usize)> {
        let mut data: Option<Growing> = None;
        for (number, own) in parts_of(self.groups.iter().map(|group| group.rows), &rows) {
            let group = self.group(number)?.slice(own.start, own.len());
            let data = match &mut data {
                Some(data) => data,
                None => {
                    let named = NamedColumns::new(&self.path, &fields(group.schema_ref()), &self.layout)?;
                    let places = named.fields();
                    let begun = Growing::new(&self.path, named, places, &self.layout, self.size);
                    data.insert(begun.after(rows.start))
                }
            };
            data.add(&group)?;
        }
        let data = data.ok_or_else(|| broken(ArrowIpc, &self.path, &"it has other rows than it says"))?;
        Ok(data.finish_part())
    }
}

/// Why there is no part.
enum NoPart {
    Unreadable(io::Error),
    Broken(String),
}

impl NoPart {
    fn in_words(self, path: &Path) -> Error {
        match self {
            Self::Unreadable(error) => unreadable(path, &error),
            Self::Broken(why) => broken(ArrowIpc, path, &why),
        }
    }
}

/// The part that begins here.
fn message(file: &mut impl Read) -> Result<Vec<u8>, NoPart> {
    let mut bytes = Vec::new();
    let mut more = |bytes: &mut Vec<u8>, count: u64| {
        let found = file.by_ref().take(count).read_to_end(bytes).map_err(NoPart::Unreadable)?;
        match found as u64 == count {
            true => Ok(()),
            false => Err(NoPart::Broken(TOO_EARLY.to_owned())),
        }
    };
    more(&mut bytes, 4)?;
    if bytes == CONTINUES {
        more(&mut bytes, 4)?;
    }
    let head = bytes.len();
    let length = bytes.last_chunk::<4>().map_or(0, |length| u32::from_le_bytes(*length));
    if length > 0 {
        more(&mut bytes, u64::from(length))?;
        let described = root_as_message(&bytes[head..]).map_err(|why| NoPart::Broken(why.to_string()))?;
        let body = u64::try_from(described.bodyLength());
        let body = body.map_err(|_| NoPart::Broken("a part of it has a negative length".to_owned()))?;
        more(&mut bytes, body)?;
    }
    Ok(bytes)
}

/// What a part is; nothing else is known.
fn kind(message: &[u8]) -> Result<Kind, String> {
    let head = if message.starts_with(&CONTINUES) { 8 } else { 4 };
    let message = root_as_message(message.get(head..).unwrap_or_default()).map_err(|why| why.to_string())?;
    if let Some(dictionary) = message.header_as_dictionary_batch() {
        return Ok(Kind::Dictionary { id: dictionary.id(), is_more: dictionary.isDelta() });
    }
    match message.header_as_record_batch() {
        Some(rows) => match usize::try_from(rows.length()) {
            Ok(rows) => Ok(Kind::Rows(rows)),
            Err(_) => Err("a part of it has a negative number of rows".to_owned()),
        },
        None if message.header_as_schema().is_some() => Ok(Kind::Schema),
        None => Err("a part of it is neither rows nor values that rows refer to".to_owned()),
    }
}

/// Where the values stand that are valid after these: of each list the last, and what was added to it.
fn needed(dictionaries: &[Dictionary]) -> Vec<Place> {
    let (mut found, mut whole) = (Vec::new(), BTreeSet::new());
    for dictionary in dictionaries.iter().rev() {
        if !whole.contains(&dictionary.id) {
            found.push(dictionary.place);
            if !dictionary.is_more {
                whole.insert(dictionary.id);
            }
        }
    }
    found.reverse();
    found
}

/// Whether a file that begins with the mark ends with another one.
fn ends_with_mark(file: &mut File, size: u64) -> io::Result<bool> {
    let mark = MARK.len() as u64;
    if size < 8 + mark {
        return Ok(false);
    }
    let mut end = Vec::new();
    file.seek(SeekFrom::Start(size - mark))?;
    file.by_ref().take(mark).read_to_end(&mut end)?;
    Ok(end == MARK)
}
