//! Random tables of many types against the same tables in CSV, and files that are broken.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{Dataset, Result};
use abbe_table::Layout;
use arrow_array::types::Int16Type;
use arrow_array::{
    Array, ArrayRef, BooleanArray, Date32Array, Decimal128Array, DictionaryArray, Float32Array, Float64Array,
    Int32Array, Int64Array, LargeStringArray, RecordBatch, StringArray, StringViewArray, UInt8Array,
};
use arrow_ipc::writer::{FileWriter, IpcWriteOptions, StreamWriter};
use arrow_ipc::{CompressionType, MetadataVersion};
use arrow_schema::{Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, GzipLevel, ZstdLevel};
use parquet::file::properties::{WriterProperties, WriterVersion};

use super::{Format, built};
use crate::arrow::UNIT;

/// Numbers that are the same for the same seed (SplitMix64).
pub(super) struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    fn number(&mut self) -> f64 {
        let magnitude = 10f64.powi(self.below(9) as i32 - 5);
        (self.next() as f64 / u64::MAX as f64 - 0.5) * magnitude
    }
}

/// A table as columns of Arrow, and as text.
pub(super) struct Tried {
    fields: Vec<Field>,
    arrays: Vec<ArrayRef>,
    csv: String,
}

/// Names of columns of numbers with their units.
const NUMBERS: [(&str, &str); 6] =
    [("X", "mm"), ("B", "deg"), ("d", "um"), ("time", "s"), ("feed", "mm/min"), ("scale", "um/m")];

const LABELS: [&str; 4] = ["feature", "group", "cycle", "note"];

/// A column of numbers: as an array, and as text.
fn numbers(random: &mut Random, rows: usize, with_nulls: bool) -> (ArrayRef, Vec<String>) {
    let is_null: Vec<bool> = (0..rows).map(|_| with_nulls && random.below(9) == 0).collect();
    let some = |random: &mut Random| (0..rows).map(|_| random.number()).collect::<Vec<f64>>();
    let known = |values: &[String]| {
        values.iter().zip(&is_null).map(|(text, null)| if *null { String::new() } else { text.clone() }).collect()
    };
    macro_rules! optional {
        ($array:ident, $values:expr) => {{
            let values = $values;
            let text: Vec<String> = values.iter().map(ToString::to_string).collect();
            let all = values.into_iter().zip(&is_null).map(|(value, null)| (!null).then_some(value));
            (Arc::new(all.collect::<$array>()) as ArrayRef, known(&text))
        }};
    }
    match random.below(6) {
        0 | 1 => optional!(Float64Array, some(random)),
        2 => {
            let values: Vec<f32> = some(random).into_iter().map(|value| value as f32).collect();
            let text: Vec<String> = values.iter().map(|value| f64::from(*value).to_string()).collect();
            let all = values.into_iter().zip(&is_null).map(|(value, null)| (!null).then_some(value));
            (Arc::new(all.collect::<Float32Array>()), known(&text))
        }
        3 => optional!(Int32Array, some(random).into_iter().map(|value| (value * 1e4) as i32).collect::<Vec<_>>()),
        4 => {
            let values: Vec<i128> = some(random).into_iter().map(|value| (value * 1e3) as i128).collect();
            let text = |value: &i128| {
                let (sign, size) = (if *value < 0 { "-" } else { "" }, value.unsigned_abs());
                format!("{sign}{}.{:03}", size / 1000, size % 1000)
            };
            let text: Vec<String> = values.iter().map(text).collect();
            let all = values.into_iter().zip(&is_null).map(|(value, null)| (!null).then_some(value));
            let array = all.collect::<Decimal128Array>().with_precision_and_scale(20, 3).unwrap();
            (Arc::new(array), known(&text))
        }
        _ => {
            let text: Vec<String> = some(random).iter().map(ToString::to_string).collect();
            let all = text.iter().zip(&is_null).map(|(value, null)| (!null).then_some(value));
            (Arc::new(all.collect::<StringArray>()), known(&text))
        }
    }
}

/// A column of labels: as an array, and as text.
fn labels(random: &mut Random, rows: usize) -> (ArrayRef, Vec<String>) {
    let whole: Vec<usize> = (0..rows).map(|_| random.below(7)).collect();
    let words = ["a", "b 2", "ü", "", "c,d", "#5", "12"];
    let text: Vec<&str> = whole.iter().map(|index| words[*index]).collect();
    // An empty text and a cell without a value are the same label.
    let optional = || text.iter().map(|text| (!text.is_empty()).then_some(*text));
    let as_text = |all: &[&str]| all.iter().map(ToString::to_string).collect();
    let digits = |all: &[usize]| all.iter().map(ToString::to_string).collect::<Vec<String>>();
    match random.below(8) {
        0 => (Arc::new(optional().collect::<StringArray>()), as_text(&text)),
        1 => (Arc::new(optional().collect::<LargeStringArray>()), as_text(&text)),
        2 => (Arc::new(optional().collect::<StringViewArray>()), as_text(&text)),
        3 => (Arc::new(optional().collect::<DictionaryArray<Int16Type>>()), as_text(&text)),
        4 => (Arc::new(whole.iter().map(|&label| Some(label as i64 - 3)).collect::<Int64Array>()), {
            whole.iter().map(|&label| (label as i64 - 3).to_string()).collect()
        }),
        5 => (Arc::new(whole.iter().map(|&label| Some(label as u8)).collect::<UInt8Array>()), digits(&whole)),
        6 => (Arc::new(whole.iter().map(|&label| Some(label as f64)).collect::<Float64Array>()), digits(&whole)),
        _ => (Arc::new(whole.iter().map(|&label| Some(label > 3)).collect::<BooleanArray>()), {
            whole.iter().map(|label| (*label > 3).to_string()).collect()
        }),
    }
}

pub(super) fn tried(random: &mut Random, with_nulls: bool) -> Tried {
    let rows = 1 + random.below(400);
    let (mut fields, mut arrays, mut names, mut cells) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (name, unit) in
        NUMBERS.into_iter().filter(|(name, _)| *name == "X" || !random.next().is_multiple_of(3)).collect::<Vec<_>>()
    {
        let (array, text) = numbers(random, rows, with_nulls);
        let full = format!("{name}_{}", unit.replace('/', "_per_"));
        let is_beside = random.next().is_multiple_of(2);
        let field = Field::new(if is_beside { name } else { &full }, array.data_type().clone(), true);
        // What the name says may be said beside it as well.
        let says = is_beside || random.next().is_multiple_of(2);
        let metadata = says.then(|| (UNIT.to_owned(), unit.to_owned()));
        fields.push(field.with_metadata(metadata.into_iter().collect::<HashMap<_, _>>()));
        arrays.push(array);
        names.push(full);
        cells.push(text);
    }
    for name in
        LABELS.into_iter().filter(|name| *name == "feature" || random.next().is_multiple_of(2)).collect::<Vec<_>>()
    {
        let (array, text) = labels(random, rows);
        fields.push(Field::new(name, array.data_type().clone(), true));
        arrays.push(array);
        names.push(name.to_owned());
        cells.push(text);
    }
    let mut csv = names.join(",") + "\n";
    for row in 0..rows {
        let row: Vec<String> = cells.iter().map(|column| format!("\"{}\"", column[row])).collect();
        csv.push_str(&(row.join(",") + "\n"));
    }
    Tried { fields, arrays, csv }
}

impl Tried {
    fn batch(&self) -> RecordBatch {
        RecordBatch::try_new(Arc::new(Schema::new(self.fields.clone())), self.arrays.clone()).unwrap()
    }

    fn parquet(&self, random: &mut Random) -> Vec<u8> {
        let packed = [
            Compression::UNCOMPRESSED,
            Compression::SNAPPY,
            Compression::ZSTD(ZstdLevel::default()),
            Compression::LZ4_RAW,
            Compression::GZIP(GzipLevel::default()),
        ];
        let versions = [WriterVersion::PARQUET_1_0, WriterVersion::PARQUET_2_0];
        let properties = WriterProperties::builder()
            .set_compression(packed[random.below(packed.len())])
            .set_writer_version(versions[random.below(2)])
            .set_dictionary_enabled(random.next().is_multiple_of(2))
            .set_max_row_group_row_count(Some(1 + random.below(300)))
            .set_data_page_row_count_limit(1 + random.below(100))
            .build();
        let batch = self.batch();
        let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), Some(properties)).unwrap();
        writer.write(&batch).unwrap();
        writer.into_inner().unwrap()
    }

    fn arrow_ipc(&self, random: &mut Random) -> Vec<u8> {
        let packed = [None, Some(CompressionType::LZ4_FRAME), Some(CompressionType::ZSTD)][random.below(3)];
        // Before version 0.15 of the format, nothing but the length stood before a part.
        let (version, is_old) = match packed.is_none() && random.next().is_multiple_of(3) {
            true => (MetadataVersion::V4, random.next().is_multiple_of(2)),
            false => (MetadataVersion::V5, false),
        };
        let alignment = [8, 16, 64][random.below(3)];
        let options = IpcWriteOptions::try_new(alignment, is_old, version).unwrap();
        let options = options.try_with_compression(packed).unwrap();
        let batch = self.batch();
        let size = 1 + random.below(batch.num_rows());
        let parts: Vec<RecordBatch> = (0..batch.num_rows())
            .step_by(size)
            .map(|start| batch.slice(start, size.min(batch.num_rows() - start)))
            .collect();
        match random.next().is_multiple_of(2) {
            true => {
                let mut writer = FileWriter::try_new_with_options(Vec::new(), &batch.schema(), options).unwrap();
                // A file has one list of values for each column that refers to one.
                writer.write(&batch).unwrap();
                writer.into_inner().unwrap()
            }
            false => {
                let mut writer = StreamWriter::try_new_with_options(Vec::new(), &batch.schema(), options).unwrap();
                parts.iter().for_each(|part| writer.write(part).unwrap());
                writer.into_inner().unwrap()
            }
        }
    }
}

fn read(format: Format, folder: &Path, bytes: &[u8], layout: &Layout) -> Result<(Dataset, usize)> {
    let file = folder.join("tried");
    std::fs::write(&file, bytes).unwrap();
    let without_rows = built::without_rows(format, &file, layout);
    let found = built::read(format, &file, layout);
    if let (Ok(without_rows), Ok((data, _))) = (without_rows, &found) {
        assert_eq!(without_rows.headers(), data.headers());
    }
    found
}

/// What does not depend on the format: columns, numbers of rows, and how many are left out.
fn told((data, left_out): (Dataset, usize)) -> (Vec<abbe_core::Column>, Vec<usize>, usize) {
    (data.columns, data.origins.iter().map(|origin| origin.row).collect(), left_out)
}

pub(super) const FORMATS: [Format; 2] = [Format::Parquet, Format::ArrowIpc];

pub(super) fn bytes(format: Format, tried: &Tried, random: &mut Random) -> Vec<u8> {
    match format {
        Format::Parquet => tried.parquet(random),
        Format::ArrowIpc => tried.arrow_ipc(random),
    }
}

#[test]
fn a_table_means_what_it_means_in_csv() {
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("tried.csv");
    for seed in 0..150 {
        let random = &mut Random(seed);
        let with_nulls = seed % 2 == 1;
        let mut tried = tried(random, with_nulls);
        std::fs::write(&csv, &tried.csv).unwrap();
        let no_data = if with_nulls { vec![String::new()] } else { Vec::new() };
        let layout = Layout { no_data, ..Layout::default() };
        let Ok(expected) = abbe_table::read_laid_out(&csv, &layout) else {
            assert!(with_nulls, "seed {seed}: {:?}", abbe_table::read_laid_out(&csv, &layout));
            continue;
        };
        let expected = told(expected);
        for format in FORMATS {
            let bytes = bytes(format, &tried, random);
            let found =
                read(format, folder.path(), &bytes, &layout).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            assert_eq!(found.0.origins[0].line, 0);
            assert_eq!(told(found), expected, "seed {seed}, {format:?}");
            if with_nulls && expected.2 > 0 {
                let error = read(format, folder.path(), &bytes, &Layout::default()).unwrap_err().to_string();
                assert!(error.contains(": row ") && error.contains("is empty; a number was expected"), "{error}");
            }
        }
        // A number with the other sign is another table.
        if let Some(numbers) = tried.arrays[0].as_any().downcast_ref::<Float64Array>() {
            tried.arrays[0] =
                Arc::new(numbers.iter().map(|number| number.map(|number| -number)).collect::<Float64Array>());
            for format in FORMATS {
                let bytes = bytes(format, &tried, random);
                assert_ne!(told(read(format, folder.path(), &bytes, &layout).unwrap()), expected, "seed {seed}");
            }
        }
    }
}

#[test]
fn broken_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (mut refused, mut taken) = (0, 0);
    for seed in 0..20 {
        let random = &mut Random(1000 + seed);
        let tried = tried(random, false);
        for format in FORMATS {
            let whole = bytes(format, &tried, random);
            for _ in 0..4 {
                let cut = &whole[..random.below(whole.len())];
                let error = read(format, folder.path(), cut, &Layout::default()).unwrap_err().to_string();
                assert!(error.contains("cannot be read as") || error.contains("no data rows"), "{error}");
            }
            for _ in 0..40 {
                let mut broken = whole.clone();
                for _ in 0..1 + random.below(4) {
                    // The beginning and the end say how large parts are.
                    let at = match random.below(3) {
                        0 => random.below(broken.len().min(64)),
                        1 => broken.len() - 1 - random.below(broken.len().min(400)),
                        _ => random.below(broken.len()),
                    };
                    broken[at] = [0xff, 0x7f, 0x80, 0, random.next() as u8][random.below(5)];
                }
                match read(format, folder.path(), &broken, &Layout::default()) {
                    Ok(_) => taken += 1,
                    Err(error) => {
                        refused += 1;
                        assert!(error.place.is_some(), "{error}");
                    }
                }
            }
        }
    }
    assert!(refused > 250 && taken > 25, "{refused} refused, {taken} taken");
}

/// Several files in one: the rows of the first alone would be taken for all.
#[test]
fn what_follows_the_end_of_arrow_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for seed in 0..20 {
        let random = &mut Random(2000 + seed);
        let tried = tried(random, false);
        let [first, second] = [0, 1].map(|_| bytes(Format::ArrowIpc, &tried, random));
        let read = |bytes: &[u8]| read(Format::ArrowIpc, folder.path(), bytes, &Layout::default());
        assert!(read(&first).is_ok());
        let is_stream = !first.starts_with(b"ARROW1");
        if is_stream {
            assert!(read(&[&first[..], &[0; 8]].concat()).is_ok());
        }
        for more in [&second[..], &[7; 5000]] {
            let error = read(&[&first[..], more].concat()).unwrap_err().to_string();
            assert!(error.contains("more follows") || !is_stream && error.contains("ends too early"), "{error}");
        }
    }
}

#[test]
fn what_is_no_such_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let message =
        |format: Format, bytes: &[u8]| read(format, folder.path(), bytes, &Layout::default()).unwrap_err().to_string();
    for format in FORMATS {
        for bytes in [&b""[..], b"X_mm,feature\n1,2\n", b"PAR1", b"ARROW1\0\0", b"PAR1PAR1PAR1PAR1", &[0xff; 4096]] {
            let message = message(format, bytes);
            assert!(message.contains(&format!("cannot be read as {}", format.name())), "{message}");
        }
        let pipe = built::read(format, folder.path(), &Layout::default()).unwrap_err().to_string();
        assert!(pipe.contains("it is a folder"), "{pipe}");
    }
}

#[test]
fn types_that_are_no_numbers_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let days: ArrayRef = Arc::new(Date32Array::from(vec![1, 2]));
    let numbers: ArrayRef = Arc::new(Float64Array::from(vec![1.5, 2.5]));
    let fields = vec![
        Field::new("day", days.data_type().clone(), false),
        Field::new("X_mm", numbers.data_type().clone(), false),
    ];
    let tried = Tried { fields, arrays: vec![days, numbers], csv: String::new() };
    let source = abbe_table::ColumnSource { column: "X_mm".to_owned(), unit: None };
    let taken = Layout { columns: Some([("X_mm".to_owned(), source)].into()), ..Layout::default() };
    for format in FORMATS {
        let bytes = bytes(format, &tried, &mut Random(5));
        let error = read(format, folder.path(), &bytes, &Layout::default()).unwrap_err().to_string();
        assert!(error.contains("the column `day` has the type Date32; numbers or texts were expected"), "{error}");
        assert_eq!(read(format, folder.path(), &bytes, &taken).unwrap().0.columns.len(), 1);
    }
}

#[test]
fn a_few_bytes_do_not_become_gigabytes() {
    let folder = tempfile::tempdir().unwrap();
    // Runs of one value take a few bytes, however long they are.
    let rows = 6_000_000;
    let arrays: Vec<ArrayRef> =
        vec![Arc::new(Float64Array::from(vec![1.0; rows])), Arc::new(Int64Array::from(vec![1; rows]))];
    let fields = ["X_mm", "feature"]
        .iter()
        .zip(&arrays)
        .map(|(name, array)| Field::new(*name, array.data_type().clone(), false));
    let tried = Tried { fields: fields.collect(), arrays, csv: String::new() };
    let properties = WriterProperties::builder().set_compression(Compression::ZSTD(ZstdLevel::default())).build();
    let batch = tried.batch();
    let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::ZSTD)).unwrap();
    let mut stream = StreamWriter::try_new_with_options(Vec::new(), &batch.schema(), options).unwrap();
    stream.write(&batch).unwrap();
    for (format, bytes) in
        [(Format::Parquet, writer.into_inner().unwrap()), (Format::ArrowIpc, stream.into_inner().unwrap())]
    {
        assert!(bytes.len() < 500_000, "{format:?}: {}", bytes.len());
        let error = read(format, folder.path(), &bytes, &Layout::default()).unwrap_err().to_string();
        assert!(error.contains("content has more than 64 MiB"), "{error}");
    }
}

/// The files that inputs for the readers are made from: one table, written by the Python package pyarrow in six ways.
#[test]
fn files_of_another_implementation_are_read() {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/seeds");
    let mut count = 0;
    for (format, folder) in [(Format::Parquet, "parquet"), (Format::ArrowIpc, "arrow-ipc")] {
        for file in std::fs::read_dir(seeds.join(folder)).unwrap() {
            let file = file.unwrap().path();
            let layout = Layout { no_data: vec![String::new()], ..Layout::default() };
            let (data, left_out) = built::read(format, &file, &layout).unwrap_or_else(|error| panic!("{error}"));
            // A number of the third row is missing.
            assert_eq!((data.origins.iter().map(|origin| origin.row).collect(), left_out), (vec![1, 2, 4], 1));
            assert_eq!(data.numbers("X").unwrap(), [1.5, 2.5, -4.25], "{}", file.display());
            assert_eq!(data.numbers("B").unwrap(), [30.0, 60.0, -90.0].map(f64::to_radians), "{}", file.display());
            assert_eq!(data.numbers("dir_X").unwrap(), [1.0, -1.0, -1.0], "{}", file.display());
            assert_eq!(data.labels("feature").unwrap(), ["a", "b", "a"], "{}", file.display());
            assert_eq!(data.labels("touch").unwrap(), ["1", "2", "4"], "{}", file.display());
            count += 1;
        }
    }
    assert_eq!(count, 6);
}
