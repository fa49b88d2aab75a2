//! Packed files and files of columns in batches: the estimate is that of a run that holds all rows of the same files in CSV.

use std::path::Path;

use abbe_core::Calibration;
use abbe_files::Packing;
use serde_json::{Value, json};

use super::{calibration, of_parts, run};
use crate::fleet::shards::agree;
use crate::support::{Variant, read, temporary, write};

const NAME: &str = "tango-hu40t";
const ESTIMATE: &str = "fit-S2";

fn recipe() -> Variant {
    of_parts(NAME, ESTIMATE)
}

/// The touches of the recipe, as it names them.
fn touches() -> String {
    read(&recipe().path("touches", "path"))
}

/// The touches in two tables with the same columns.
fn halves() -> [String; 2] {
    let text = touches();
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
    let half = lines.len() / 2;
    let table = |rows: &[&str]| lines[0].to_owned() + "\n" + &rows.join("\n") + "\n";
    [table(&lines[1..half]), table(&lines[half..])]
}

/// Runs the recipe with other files of its touches, in batches, and compares the estimate with that of a run that holds all rows.
fn same_estimate(at: &Path, ingest: &str, path: &Value, rows: usize) {
    let what = format!("{ingest} {path}, {rows} rows a batch");
    let mut changed = recipe().set("touches", "batch_rows", json!(rows)).set("touches", "path", path.clone());
    changed.stage("touches")["ingest"] = json!(ingest);
    changed.write(at);
    let printed = run(at, "batches");
    assert!([0, 1, 3].contains(&printed.status), "{what}: {}", printed.stderr);
    let [found, mut expected] = ["batches", "whole"].map(|out| calibration(at, out, ESTIMATE));
    // The rows have other files.
    let count = |of: &Calibration| of.data.iter().flat_map(|own| &own.rows).map(|[a, b]| b + 1 - a).sum::<usize>();
    assert_eq!(count(&found), count(&expected), "{what}");
    expected.data.clone_from(&found.data);
    agree(&what, &found, &expected);
}

/// A folder with the results of a run that holds all rows.
fn with_whole() -> tempfile::TempDir {
    let folder = temporary();
    recipe().write(folder.path());
    let printed = run(folder.path(), "whole");
    assert!([0, 1, 3].contains(&printed.status), "{}", printed.stderr);
    folder
}

#[test]
fn packed_and_plain_files_are_one_estimate() {
    let folder = with_whole();
    let at = folder.path();
    let [first, second] = halves();
    let packed = |name: &str, packing: Packing, text: &str| {
        std::fs::write(at.join(name), packing.pack(text.to_owned().into_bytes())).expect("a file");
    };
    packed("all.csv.gz", Packing::Gzip, &touches());
    packed("all.csv.zst", Packing::Zstandard, &touches());
    write(&at.join("first.csv"), &first);
    packed("second.csv.gz", Packing::Gzip, &second);
    for path in [json!("all.csv.gz"), json!("all.csv.zst"), json!(["first.csv", "second.csv.gz"])] {
        for rows in [100_000, 29] {
            same_estimate(at, "csv", &path, rows);
        }
    }
}

#[test]
fn rows_of_packed_files_are_named() {
    let folder = temporary();
    let at = folder.path();
    let text = touches();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let place = lines.len() - 3;
    lines[place] = lines[place].replacen(',', ",wrong", 3);
    std::fs::write(at.join("all.csv.gz"), Packing::Gzip.pack((lines.join("\n") + "\n").into_bytes())).expect("a file");
    recipe().set("touches", "batch_rows", json!(29)).set("touches", "path", json!("all.csv.gz")).write(at);
    let printed = run(at, "out");
    assert!(printed.status == 1 && !at.join("out").exists(), "{printed:?}");
    assert!(printed.stderr.contains(&format!("all.csv.gz:{}", place + 1)), "{}", printed.stderr);
}

#[cfg(feature = "parquet")]
mod of_columns {
    use super::*;
    use crate::columnar::parquet;

    #[test]
    fn parquet_in_batches_is_the_same_estimate() {
        let folder = with_whole();
        let at = folder.path();
        let halves = halves().map(|text| parquet(&text));
        for (name, content) in ["first.parquet", "second.parquet"].iter().zip(halves) {
            std::fs::write(at.join(name), content).expect("a file");
        }
        for rows in [100_000, 29] {
            same_estimate(at, "parquet", &json!(["first.parquet", "second.parquet"]), rows);
        }
    }

    #[test]
    fn rows_of_parquet_are_named_and_counted_from_the_first() {
        let folder = temporary();
        let at = folder.path();
        let text = touches();
        let place = text.lines().filter(|line| !line.starts_with('#')).count() - 3;
        let mut table: Vec<String> = text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect();
        let column = table[0].split(',').position(|name| name == "X_mm").expect("a column");
        let cells = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let mut wrong = cells(&table[place]);
        wrong[column] = "NaN".to_owned();
        table[place] = wrong.join(",");
        std::fs::write(at.join("all.parquet"), parquet(&(table.join("\n") + "\n"))).expect("a file");
        let mut changed = recipe().set("touches", "batch_rows", json!(29)).set("touches", "path", json!("all.parquet"));
        changed.stage("touches")["ingest"] = json!("parquet");
        changed.write(at);
        let printed = run(at, "out");
        assert!(printed.status == 1 && !at.join("out").exists(), "{printed:?}");
        let named = ["all.parquet".to_owned(), format!("row {place}: `X_mm` is `NaN`")];
        assert!(named.iter().all(|words| printed.stderr.contains(words)), "{}", printed.stderr);
    }

    /// Twenty times the rows, and hardly more memory: of one file in Parquet, and of packed text.
    #[cfg(target_os = "linux")]
    #[test]
    fn memory_does_not_grow_with_the_rows() {
        let folder = temporary();
        let at = folder.path();
        let text = touches();
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        let header = lines.next().expect("a header");
        let rows: Vec<&str> = lines.collect();
        for (ingest, name) in [("parquet", "touches.parquet"), ("csv", "touches.csv.gz")] {
            let mut changed = recipe().set("touches", "batch_rows", json!(2000)).set("touches", "path", json!(name));
            changed.stage("touches")["ingest"] = json!(ingest);
            changed.write(at);
            let of = |count: usize| {
                let text: Vec<&str> = std::iter::once(header).chain(rows.iter().copied().cycle().take(count)).collect();
                let text = text.join("\n") + "\n";
                let content = match ingest {
                    "parquet" => parquet(&text),
                    _ => Packing::Gzip.pack(text.into_bytes()),
                };
                std::fs::write(at.join(name), content).expect("a file");
                let (peak, status) = super::super::peak(at);
                assert_eq!(status, Some(0), "{count} rows");
                peak
            };
            let [few, many] = [6_000, 120_000].map(of);
            assert!(few > 10_000 && many < few + few / 10, "{name}: {few} kB for 6,000 rows, {many} kB for 120,000");
        }
    }
}
