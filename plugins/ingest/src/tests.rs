use std::fs;
use std::path::Path;
use std::sync::Arc;

use abbe_core::{
    Cell, Class, Context, DataRow, Dataset, Field, Ingest, RowsOfTable, SharedCells, Table, Values, path_text,
};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::csv::{build, example};

type Files<'a> = &'a [(&'a str, &'a str)];

fn stage(folder: &Path, settings: &Value) -> Result<Box<dyn Ingest>, String> {
    abbe_core::from_settings(settings)
        .and_then(|settings| build(settings, &Context { base: folder.to_owned() }))
        .map_err(|error| format!("settings: {error}"))
}

/// Reads `files` with `settings`; what is wrong is told with class and setting, and paths without the folder.
fn read(files: Files<'_>, settings: &Value) -> Result<Dataset, String> {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    let stage = stage(folder.path(), settings)?;
    let (headers, data) = (stage.headers(), stage.read());
    match (&headers, &data) {
        (headers, Ok(data)) => assert_eq!(headers.as_ref(), Ok(&data.headers())),
        (headers, Err(error)) if error.class == Class::Use => assert_eq!(headers.as_ref(), Err(error)),
        (headers, Err(_)) => assert!(headers.is_ok(), "{headers:?}"),
    }
    data.map_err(|error| {
        let setting = if error.setting.is_empty() { String::new() } else { format!(" {}", path_text(&error.setting)) };
        let text = format!("{:?}{setting}: {error}", error.class);
        text.replace(&format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR), "")
    })
}

fn names(data: &Dataset) -> String {
    data.columns.iter().map(|column| column.header.header.as_str()).collect::<Vec<_>>().join(" ")
}

/// The cells of a data set row by row, to be compared with text.
fn rows(data: &Dataset) -> Vec<String> {
    let cell = |values: &Values, row: usize| match values {
        Values::Numbers(numbers) => numbers[row].to_string(),
        Values::Labels(labels) => labels[row].to_string(),
    };
    let row = |row| data.columns.iter().map(|column| cell(&column.values, row)).collect::<Vec<_>>().join(" ");
    (0..data.rows()).map(row).collect()
}

fn check(files: Files<'_>, settings: Value, columns: &str, expected: &[&str]) {
    let data = read(files, &settings).unwrap();
    assert_eq!(names(&data), columns, "{settings}");
    assert_eq!(rows(&data), expected, "{settings}");
}

fn check_error(files: Files<'_>, settings: Value, expected: &str) {
    let told = read(files, &settings).unwrap_err();
    assert!(told.starts_with(expected), "{settings}: {told}");
}

const TOUCHES: (&str, &str) = ("touches.csv", "feature,X_mm\n1,0.5\n2,1.5\n3,2.5\n");
const BARS: [(&str, &str); 4] = [
    ("bar-10.csv", "X_mm,point\n3,a\n"),
    ("bar-2.csv", "# note\npoint,X_mm\na,1\n\nb,2\n"),
    (".bar-3.csv", "left by an editor"),
    ("measurements.csv", "measurement,file,stylus,tip_um\nm1,bar-2.csv,1,5\nm2,bar-10,2,6\nm3,bar-11,2,6\n"),
];

#[test]
fn rows_and_columns_are_what_the_settings_say() {
    let touches = &[TOUCHES];
    check(
        touches,
        json!({ "path": "touches.csv" }),
        "feature X_mm file",
        &["1 0.5 touches", "2 1.5 touches", "3 2.5 touches"],
    );
    check(
        touches,
        json!({ "path": ["touches.csv"], "constants": { "stylus": 2, "bar": "long one", "d_um": 500, "dir_X": -1 } }),
        "feature X_mm file bar d_um dir_X stylus",
        &["1 0.5 touches long one 0.5 -1 2", "2 1.5 touches long one 0.5 -1 2", "3 2.5 touches long one 0.5 -1 2"],
    );
    check(
        touches,
        json!({ "path": "touches.csv", "ignore": { "feature": [1, "3"] } }),
        "feature X_mm file",
        &["2 1.5 touches"],
    );
    check(
        touches,
        json!({ "path": "t*.csv", "keep": { "feature": [1, 3], "file": ["touches"] }, "ignore": { "feature": [3] } }),
        "feature X_mm file",
        &["1 0.5 touches"],
    );
    check(&BARS, json!({ "path": "bar-*" }), "point X_mm file", &["a 1 bar-2", "b 2 bar-2", "a 3 bar-10"]);
    check(&BARS, json!({ "path": "bar-?.csv" }), "point X_mm file", &["a 1 bar-2", "b 2 bar-2"]);
    check(
        &BARS,
        json!({ "path": ["bar-10.csv", "bar-2.csv"] }),
        "X_mm point file",
        &["3 a bar-10", "1 a bar-2", "2 b bar-2"],
    );
    check(
        &BARS,
        json!({
            "path": "bar-*.csv",
            "join": { "table": "measurements.csv", "on": "file" },
            "keep": { "stylus": [2], "measurement": ["m2"] }
        }),
        "point X_mm file measurement stylus tip_um",
        &["a 3 bar-10 m2 2 0.006"],
    );
    check(
        &[("a/t.csv", "file,X_mm\np,1\n"), ("b/t.csv", "file,X_mm\nq,2\n"), ("n.csv", "file,u\np,5\nq,6\n")],
        json!({ "path": ["a/*.csv", "b/t.csv"], "join": { "table": "n.csv", "on": "file" } }),
        "file X_mm u",
        &["p 1 5", "q 2 6"],
    );
}

#[test]
fn rows_keep_their_places() {
    let data = read(&BARS, &json!({ "path": "bar-*.csv", "keep": { "point": ["b"], "file": ["bar-2"] } })).unwrap();
    assert_eq!((data.origins[0].line, data.origins[0].row), (5, 2));
    assert!(data.error_at(DataRow(0), "x").to_string().ends_with("bar-2.csv:5: x"));
    let data = read(&BARS, &json!({ "path": "bar-*.csv", "keep": { "file": ["bar-10"] } })).unwrap();
    assert!(data.error_at(DataRow(0), "x").to_string().ends_with("bar-10.csv:2: x"));
}

#[test]
fn what_is_wrong_is_said_with_its_place() {
    let touches = &[TOUCHES];
    let with_path = |key: &str, value: Value| json!({ "path": "touches.csv", key: value });
    let cases: Vec<(Files<'_>, Value, &str)> = vec![
        (touches, json!({ "path": 5 }), "settings: path: a path or a list of paths was expected"),
        (touches, json!({ "path": [] }), "settings: path: at least one file was expected"),
        (touches, json!({ "paths": "touches.csv" }), "settings: paths: unknown setting `paths` (did you mean `path`?)"),
        (
            touches,
            json!({ "path": "run-*/touches.csv" }),
            "settings: path: `*` and `?` may stand in the name of a file, not of a folder as in `run-*/touches.csv`",
        ),
        (touches, json!({ "path": "touch.csv" }), "Use: touch.csv: there is no such file"),
        (touches, json!({ "path": "bar-*.csv" }), "Use path: no file matches `bar-*.csv`"),
        (touches, json!({ "path": "nowhere/bar-*.csv" }), "Use path: no file matches `nowhere/bar-*.csv`"),
        (
            touches,
            json!({ "path": ["touches.csv", "t*.csv"] }),
            "Use path: `touches.csv` and `touches.csv` would both be `touches` in the column `file`",
        ),
        (
            &[("a.csv", "feature,X_mm\n1,x\n")],
            json!({ "path": "a.csv" }),
            "Data: a.csv:2:3: `X_mm` is `x`; a number was expected",
        ),
        (
            &[TOUCHES, ("u.csv", "feature,X_mm,day\n1,2,3\n")],
            json!({ "path": ["touches.csv", "u.csv"] }),
            "Use: touches.csv: there is no column `day`, which `u.csv` has",
        ),
        (
            &[TOUCHES, ("u.csv", "feature,X_um\n1,2\n")],
            json!({ "path": ["touches.csv", "u.csv"] }),
            "Use: u.csv: there is no column `X_mm`, which `touches.csv` has",
        ),
        (touches, with_path("constants", json!({ "X_um": 1 })), "Use constants.X_um: there is a column `X_mm` already"),
        (
            touches,
            with_path("constants", json!({ "file": "a" })),
            "Use constants.file: there is a column `file` already",
        ),
        (
            touches,
            with_path("constants", json!({ "Y_mm": "far" })),
            "settings: constants.Y_mm: `Y_mm` is `far`; a number was expected",
        ),
        (touches, with_path("constants", json!({ "": 1 })), "settings: constants: a column needs a name"),
        (
            touches,
            with_path("constants", json!({ "Y_mm": [1] })),
            "settings: constants.Y_mm: a name or a number was expected, not a list",
        ),
        (
            touches,
            with_path("keep", json!({ "featur": [1] })),
            "Use keep.featur: touches.csv: there is no column `featur`; the columns are `feature`, `X_mm`, `file` (did you mean \
             `feature`?)",
        ),
        (
            touches,
            with_path("ignore", json!({ "X": [0.5] })),
            "Use ignore.X: touches.csv: the column `X_mm` holds numbers; labels were expected",
        ),
        (
            touches,
            with_path("ignore", json!({ "feature": [1, 2, 3] })),
            "Data: no row is left after `ignore` and `keep`",
        ),
        (touches, with_path("join", json!({ "table": "t.csv", "on": "feature" })), "Use: t.csv: there is no such file"),
        (
            &[TOUCHES, ("t.csv", "feature,u\n1,5\n2,6\n")],
            with_path("join", json!({ "table": "t.csv", "on": "feature" })),
            "Data: touches.csv:4: feature `3` is not in the table `t.csv`",
        ),
        (
            &[TOUCHES, ("t.csv", "feature,u\n1,5\n2,6\n3,7\n1,5\n")],
            with_path("join", json!({ "table": "t.csv", "on": "feature" })),
            "Data: t.csv:5: feature `1` is in line 2 already",
        ),
        (
            &[TOUCHES, ("t.csv", "feature,X_um\n1,5\n2,6\n3,7\n")],
            with_path("join", json!({ "table": "t.csv", "on": "feature" })),
            "Use: t.csv: the column `X_mm` is in the data already",
        ),
        (
            &[TOUCHES, ("t.csv", "point,u\n1,5\n")],
            with_path("join", json!({ "table": "t.csv", "on": "point" })),
            "Use join.on: touches.csv: there is no column `point`; the columns are `feature`, `X_mm`, `file`",
        ),
        (
            &[TOUCHES, ("t.csv", "point,u\n1,5\n")],
            with_path("join", json!({ "table": "t.csv", "on": "feature" })),
            "Use join.on: t.csv: there is no column `feature`; the columns are `point`, `u`",
        ),
    ];
    for (files, settings, expected) in cases {
        check_error(files, settings, expected);
    }
}

#[test]
fn inputs_are_listed_without_reading_them() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["bar-10.csv", "bar-9.csv", "other.csv"] {
        fs::write(folder.path().join(name), "").unwrap();
    }
    let settings =
        json!({ "path": ["bar-*.csv", "gone-*.csv", "one.csv"], "join": { "table": "m.csv", "on": "file" } });
    let inputs = stage(folder.path(), &settings).unwrap().inputs();
    let found: Vec<_> = inputs
        .iter()
        .map(|input| (input.setting, input.path.strip_prefix(folder.path()).unwrap().to_str().unwrap()))
        .collect();
    let expected = ["bar-9.csv", "bar-10.csv", "gone-*.csv", "one.csv"].map(|name| ("path", name));
    assert_eq!(found, [&expected[..], &[("join", "m.csv")]].concat());
}

/// What matches a pattern and cannot be read is not left out.
#[test]
fn whatever_matches_a_pattern_is_an_input() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("bar-1.csv"), "X_mm\n1\n").unwrap();
    fs::create_dir(folder.path().join("bar-2.csv")).unwrap();
    let built = stage(folder.path(), &json!({ "path": "bar-*.csv" })).unwrap();
    assert_eq!(built.inputs().len(), 2);
    let error = built.read().unwrap_err().to_string();
    assert!(error.contains("bar-2.csv") && error.contains("it is a folder; a file was expected"), "{error}");
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::ffi::OsStrExt;
        fs::remove_dir(folder.path().join("bar-2.csv")).unwrap();
        let name = std::ffi::OsStr::from_bytes(b"bar-\xff.csv");
        fs::write(folder.path().join(name), "X_mm\n2\n").unwrap();
        let built = stage(folder.path(), &json!({ "path": "bar-*.csv" })).unwrap();
        assert_eq!(built.read().unwrap().numbers("X").unwrap(), [1.0, 2.0]);
    }
}

#[test]
fn the_example_builds() {
    assert!(stage(Path::new("nowhere"), &example()).is_ok());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn splitting_a_file_changes_nothing_but_the_file(
        numbers in prop::collection::vec(-1e3..1e3f64, 2..20),
        place in any::<prop::sample::Index>(),
    ) {
        let cut = 1 + place.index(numbers.len() - 1);
        let lines: Vec<String> = numbers.iter().enumerate().map(|(i, x)| format!("{i},{x},{x}\n")).collect();
        let file = |lines: &[String]| format!("touch,X_mm,C_deg\n{}", lines.concat());
        let settings = json!({ "path": "t*.csv", "constants": { "stylus": 1 } });
        let whole = read(&[("t1.csv", &file(&lines))], &settings).unwrap();
        let split = read(&[("t1.csv", &file(&lines[..cut])), ("t2.csv", &file(&lines[cut..]))], &settings).unwrap();
        prop_assert_eq!(whole.headers(), split.headers());
        for (one, other) in whole.columns.iter().zip(&split.columns).filter(|(one, _)| one.header.name != "file") {
            prop_assert_eq!(one, other);
        }
        let file = |row: usize| if row < cut { "t1" } else { "t2" };
        prop_assert_eq!(split.labels("file").unwrap(), (0..numbers.len()).map(file).collect::<Vec<_>>());
    }
}

#[test]
fn series_are_averaged_row_by_row() {
    let files = [
        ("s-1.csv", "config,X_mm,A_deg,time_s,day\n1,10.0,0,5,1\n2,20.5,30,15,1\n1,10.5,0,25,1\n"),
        ("s-2.csv", "config,X_mm,A_deg,time_s,day\n1,10.5,0,7,2\n2,21.5,30,17,2\n1,11.0,0,27,2\n"),
    ];
    let settings = json!({ "path": "s-*.csv", "average": { "over": "file", "by": ["config"] } });
    let columns = "config X_mm A_deg time_s";
    let turned = 30_f64.to_radians();
    let expected = ["1 10.25 0 6".to_owned(), format!("2 21 {turned} 16"), "1 10.75 0 26".to_owned()];
    check(&files, settings, columns, &expected.each_ref().map(String::as_str));
    let without =
        json!({ "path": "s-*.csv", "ignore": { "config": [2] }, "average": { "over": "day", "by": ["config"] } });
    check(&files, without, columns, &["1 10.25 0 6", "1 10.75 0 26"]);
    check_error(
        &files,
        json!({ "path": "s-*.csv", "average": { "over": "file", "by": ["config", "tim"] } }),
        "Use average.by: s-1.csv: there is no column `tim`; the columns are `config`, `X_mm`, `A_deg`, `time_s`, `day`, `file` (did you mean `time_s`?)",
    );
    check_error(
        &files,
        json!({ "path": "s-*.csv", "average": { "over": "config", "by": ["day"] } }),
        "Data: s-1.csv:3: `A_deg` differs from that of line 2 of `s-1.csv`, with which this row would be averaged (name under `by` of `average` all columns that tell points apart)",
    );
}

#[test]
fn files_of_instruments_are_read_as_declared() {
    let file = "Titel;;\nMeas X;Joint 1 [°];;T\n[in];[dms];;[F]\n1,5;-0 30 0;x;68\n---;1 0 0;x;68\n2;90;y;50\n";
    let settings = json!({
        "path": "a.txt", "separator": "semicolon", "decimal": "comma", "skip_lines": 1, "skip_after_header": 1,
        "no_data": ["---"],
        "columns": {
            "X_mm": { "column": "Meas X", "unit": "in" }, "a_rad": { "column": "Joint 1 [°]", "unit": "dms" },
            "T_degC": { "column": "T", "unit": "degF" }
        }
    });
    let data = read(&[("a.txt", file)], &settings).unwrap();
    assert_eq!(names(&data), "T_degC X_mm a_rad file");
    assert_eq!(data.numbers("X"), Some(&[1.5 * 25.4, 50.8][..]));
    assert_eq!(data.numbers("a"), Some(&[-0.5f64.to_radians(), 90f64.to_radians()][..]));
    assert!((data.numbers("T").unwrap()[1] - 10.0).abs() < 1e-12);
    assert_eq!(data.origins.iter().map(|origin| (origin.line, origin.row)).collect::<Vec<_>>(), [(4, 1), (6, 3)]);
    // A table without a header row.
    let settings =
        json!({ "path": "a.txt", "separator": "space", "header": false, "columns": { "X_mm": 2, "feature": 1 } });
    let data = read(&[("a.txt", "  7   1.5 9\n 8\t2 9\n")], &settings).unwrap();
    assert_eq!(
        (names(&data).as_str(), rows(&data)),
        ("X_mm feature file", vec!["1.5 7 a".to_owned(), "2 8 a".to_owned()])
    );
}

#[test]
fn layouts_that_cannot_be_are_refused() {
    let files: Files<'_> = &[("a.txt", "X;Y\n1;2\n")];
    let with = |more: Value| {
        let mut settings = json!({ "path": "a.txt", "separator": "semicolon" });
        settings.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        settings
    };
    for (more, expected) in [
        (json!({ "header": false }), "without a header row `columns` has to say what the columns are"),
        (json!({ "columns": {} }), "at least one column was expected"),
        (json!({ "columns": { "X_mm": { "column": "X", "unit": "deg" } } }), "`deg` is no unit of `X_mm`"),
        (json!({ "columns": { "X_mm": { "column": "X", "unit": "inches" } } }), "there is no unit `inches`"),
        (json!({ "columns": { "X_mm": "X", "X_deg": "Y" } }), "are both named `X`"),
        (json!({ "columns": { "X_mm": "Z" } }), "there is no column `Z`; the columns are `X`, `Y`"),
        (json!({ "header": false, "columns": { "X_mm": "X" } }), "`X` is no number of a column"),
        (json!({ "header": false, "columns": { "X_mm": 3 } }), "the row has 2 cells, and none for `X_mm`"),
        (json!({ "skip_lines": 1_000_000 }), "at most 10000 are skipped"),
        (json!({ "skip_lines": 9, "columns": { "X_mm": "X" } }), "there is no row after the 9 lines of `skip_lines`"),
        (json!({ "separator": "dot" }), "unknown choice `dot`"),
    ] {
        let error = read(files, &with(more.clone())).unwrap_err();
        assert!(error.contains(expected), "{more}: {error}");
    }
}

/// Settings do to a table of a program what they do to the file in whose place it stands, which nobody reads.
#[test]
fn a_table_stands_in_the_place_of_files() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("styli.csv"), "point,tip_um\na,5\nb,6\nc,7\n").unwrap();
    let settings = json!({ "path": "bar-1.csv", "constants": { "T_degC": 20 }, "join": { "table": "styli.csv", "on": "point" },
        "columns": { "point": "p", "X_mm": { "column": "x", "unit": "um" } }, "no_data": [-1], "ignore": { "point": ["c"] },
        "average": { "over": "file", "by": ["point"] } });
    let points = ["a", "b", "a", "c", "b"];
    let numbers = [1000.0, 2000.0, 3000.0, 7.0, -1.0];
    let fields = ["p", "x"].map(|name| Field { name: name.to_owned(), unit: None }).into();
    let part = |range: std::ops::Range<usize>| {
        let texts: Vec<Cell<'static>> = points[range.clone()].iter().map(|text| Cell::Text((*text).into())).collect();
        let cells: Vec<SharedCells> = vec![Box::new(texts), Box::new(numbers[range.clone()].to_vec())];
        RowsOfTable { rows: range.len(), cells }
    };
    let table = Table { fields, parts: vec![part(0..2), part(2..5)] };
    let given = stage(folder.path(), &settings).unwrap().with_table(Arc::new(table)).unwrap();
    let found = given.read().unwrap();
    assert_eq!(given.inputs().iter().map(|input| input.setting).collect::<Vec<_>>(), ["join"]);
    assert_eq!(given.headers().unwrap(), found.headers());
    let file: String = points.iter().zip(numbers).map(|(point, number)| format!("{point},{number}\n")).collect();
    fs::write(folder.path().join("bar-1.csv"), format!("p,x\n{file}")).unwrap();
    let mut expected = stage(folder.path(), &settings).unwrap().read().unwrap();
    // A table has rows and no lines.
    expected.origins.iter_mut().for_each(|origin| origin.line = 0);
    assert_eq!(found, expected);
    assert_eq!(found.rows(), 3);
}
