//! Parquet and Arrow IPC, exchanged with another implementation: that of the Python package pyarrow.
#![cfg(feature = "parquet")]

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::columnar::exported;
use crate::packed::{found, touches, with_touches};
use crate::support::{abbe, fit, skipped, temporary};

/// Writes the table in CSV `1` into the folder `2`, in many formats.
const WRITE: &str = r##"
import csv, gzip, sys
import pyarrow as pa, pyarrow.parquet as pq, pyarrow.feather as feather
lines = [line for line in open(sys.argv[1]) if not line.startswith("#")]
rows = list(csv.DictReader(lines))
units = ["mm", "deg", "s"]
fields, arrays = [], []
for name in rows[0]:
    cells = [row[name] for row in rows]
    base, _, unit = name.rpartition("_")
    if name.startswith("dir_"):
        array, metadata = pa.array([int(cell) for cell in cells], pa.int8()), None
    elif unit in units:
        array, metadata = pa.array([float(cell) for cell in cells]), {"unit": unit}
        name = base
    elif name == "feature":
        array, metadata = pa.array(cells).dictionary_encode(), None
    elif name == "touch":
        array, metadata = pa.array([int(cell) for cell in cells], pa.int32()), None
    else:
        array, metadata = pa.array(cells), None
    fields.append(pa.field(name, array.type, metadata=metadata))
    arrays.append(array)
table = pa.table(arrays, schema=pa.schema(fields))
to = sys.argv[2] + "/"
pq.write_table(table, to + "snappy.parquet", compression="snappy", row_group_size=100)
pq.write_table(table, to + "zstd.parquet", compression="zstd", version="2.6", data_page_version="2.0", data_page_size=512)
pq.write_table(table, to + "gzip.parquet", compression="gzip", use_dictionary=False)
pq.write_table(table, to + "split.parquet", compression="lz4", use_dictionary=False, use_byte_stream_split=[
    field.name for field in fields if field.type == pa.float64()])
feather.write_feather(table, to + "lz4.arrow", compression="lz4")
feather.write_feather(table, to + "zstd.arrow", compression="zstd")
with pa.OSFile(to + "stream.arrow", "wb") as sink, pa.ipc.new_stream(sink, table.schema) as writer:
    writer.write_table(table, max_chunksize=77)
text = open(sys.argv[1], "rb").read()
with gzip.open(to + "touches.csv.gz", "wb") as packed:
    packed.write(text)
with pa.CompressedOutputStream(to + "touches.csv.zst", "zstd") as packed:
    packed.write(text)
"##;

/// Prints what a Parquet file has: columns, units, numbers as their bits.
const READ: &str = r#"
import json, struct, sys
import pyarrow as pa, pyarrow.parquet as pq
table = pq.read_table(sys.argv[1])
found = {}
for field, column in zip(table.schema, table.columns):
    cells = column.to_pylist()
    if field.type == pa.float64():
        cells = [None if cell is None else struct.pack(">d", cell).hex() for cell in cells]
    unit = (field.metadata or {}).get(b"unit", b"").decode()
    found[field.name] = {"unit": unit, "cells": cells}
print(json.dumps(found))
"#;

fn has_pyarrow(test: &str) -> bool {
    let found = Command::new("python3").args(["-c", "import pyarrow"]).output();
    let (is_there, why) = match found {
        Ok(found) => (found.status.success(), "the Python package pyarrow is not installed"),
        Err(_) => (false, "Python is not installed"),
    };
    if !is_there {
        skipped(test, why);
    }
    is_there
}

fn python(script: &str, arguments: &[&Path]) -> String {
    let found = Command::new("python3").args(["-c", script]).args(arguments).output().expect("Python");
    assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
    String::from_utf8(found.stdout).expect("text")
}

#[test]
fn files_of_another_implementation_give_the_same_calibration() {
    if !has_pyarrow("files_of_another_implementation_give_the_same_calibration") {
        return;
    }
    let folder = temporary();
    let expected = found(&with_touches("csv", &touches()), folder.path());
    python(WRITE, &[&touches(), folder.path()]);
    for (plugin, name) in [
        ("csv", "touches.csv.gz"),
        ("csv", "touches.csv.zst"),
        ("parquet", "snappy.parquet"),
        ("parquet", "zstd.parquet"),
        ("parquet", "gzip.parquet"),
        ("parquet", "split.parquet"),
        ("arrow-ipc", "lz4.arrow"),
        ("arrow-ipc", "zstd.arrow"),
        ("arrow-ipc", "stream.arrow"),
    ] {
        let calibration = found(&with_touches(plugin, &folder.path().join(name)), folder.path());
        assert_eq!(calibration, expected, "{name}");
    }
}

/// Writes the table in CSV `1` as Parquet with check sums to `2`, and with another digit of a number in it to `3`.
const DAMAGE: &str = r##"
import csv, struct, sys
import pyarrow as pa, pyarrow.parquet as pq
rows = list(csv.DictReader(line for line in open(sys.argv[1]) if not line.startswith("#")))
names = [name for name in rows[0] if name.endswith("_mm")]
columns = {name: [float(row[name]) if name in names else row[name] for row in rows] for name in rows[0]}
pq.write_table(pa.table(columns), sys.argv[2], compression="none", use_dictionary=False, write_statistics=False,
    write_page_checksum=True)
content = bytearray(open(sys.argv[2], "rb").read())
at = content.find(struct.pack("<d", columns[names[0]][3]))
assert at > 0
content[at + 4] ^= 1
open(sys.argv[3], "wb").write(content)
"##;

#[test]
fn check_sums_of_parquet_are_compared() {
    if !has_pyarrow("check_sums_of_parquet_are_compared") {
        return;
    }
    let folder = temporary();
    let [whole, damaged] = ["whole.parquet", "damaged.parquet"].map(|name| folder.path().join(name));
    python(DAMAGE, &[&touches(), &whole, &damaged]);
    for (file, status) in [(whole, 0), (damaged, 1)] {
        let recipe = with_touches("parquet", &file).write(folder.path());
        let run = abbe(folder.path(), &["run", &recipe.display().to_string(), "--out", "out"]);
        assert_eq!(run.status, status, "{}", run.stderr);
        assert_eq!(run.stderr.contains("cannot be read as Parquet"), status == 1, "{}", run.stderr);
    }
}

#[test]
fn another_implementation_reads_results() {
    if !has_pyarrow("another_implementation_reads_results") {
        return;
    }
    let folder = temporary();
    let (_, outcome) = exported(folder.path());
    let read =
        |name: &str| -> Value { serde_json::from_str(&python(READ, &[&folder.path().join(name)])).expect("JSON") };
    let bits = |number: f64| Value::from(format!("{:016x}", number.to_bits()));
    let calibration = &fit(&outcome, "fit").calibration;
    let parameters = read("fit.parameters.parquet");
    let all: Vec<_> = calibration.parameters.iter().chain(&calibration.artefacts).collect();
    for (index, own) in all.iter().enumerate() {
        assert_eq!(parameters["name"]["cells"][index], own.name);
        assert_eq!(parameters["value"]["cells"][index], bits(own.value), "{}", own.name);
        assert_eq!(parameters["unit"]["cells"][index], own.unit);
    }
    let covariance = read("fit.covariance.parquet");
    for (row, entries) in calibration.covariance.rows.iter().enumerate() {
        for (name, entry) in calibration.covariance.order.iter().zip(entries) {
            assert_eq!(covariance[name]["cells"][row], bits(*entry), "{name}");
        }
    }
    let residuals = read("fit.residuals.parquet");
    let expected = abbe_estimation::residual_rows(fit(&outcome, "fit")).expect("residuals");
    for (index, row) in expected.iter().enumerate() {
        assert_eq!(residuals["residual_mm"]["cells"][index], bits(row.value));
        assert_eq!(residuals["residual_rad"]["cells"][index], Value::Null);
    }
    for (column, unit) in
        [("residual_mm", "mm"), ("residual_rad", "rad"), ("time_s", "s"), ("direction_x", "1"), ("B_rad", "rad")]
    {
        assert_eq!(residuals[column]["unit"], unit, "{column}");
    }
    assert_eq!(read("trials.samples.parquet")["dxt"]["unit"], "mm");
    assert_eq!(read("fit.volumetric.parquet")["xy_mm2"]["unit"], "mm^2");
}
