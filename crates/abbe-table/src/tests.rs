use std::io::Cursor;
use std::path::{Path, PathBuf};

use abbe_core::{Class, DataRow, Dataset, Error, Quantity, Values};
use proptest::prelude::*;

use crate::{
    ColumnSource, Decimal, Encoding, FileInBatches, Layout, Separator, Unit, parse, parse::dataset, parse::headers,
    parse::headers_laid_out, points, read, read_headers, read_laid_out, unique_labels, vectors,
};

fn table(text: &str) -> Result<Dataset, Error> {
    parse(Path::new("t.csv"), text.as_bytes())
}

/// `read` and `read_headers` as one would use them, and what has to hold between the two.
fn parsed(bytes: &[u8]) -> Result<Dataset, Error> {
    let path = Path::new("t.csv");
    let headers = headers(path, Cursor::new(bytes));
    let data = parse(path, bytes);
    match (&headers, &data) {
        (headers, Ok(data)) => assert_eq!(headers.as_ref(), Ok(&data.headers())),
        (Ok(_), Err(error)) => assert_eq!(error.class, Class::Data, "{error}: the header was found good"),
        (Err(_), Err(_)) => {}
    }
    data
}

#[test]
fn what_is_wrong_is_said_with_its_place() {
    let cases: &[(&[u8], &str)] = &[
        (b"", "Data: t.csv: the file is empty"),
        (b"\xef\xbb\xbf# nothing\n\n", "Data: t.csv: the file is empty"),
        (b"X_mm\n", "Data: t.csv: the file has no data rows"),
        (b"X_mm,Y_mm,X_mm\n1,2,3\n", "Use: t.csv:1:11: there are two columns `X_mm`"),
        (b"# note\nX_mm, X_deg\n1,2\n", "Use: t.csv:2:7: the columns `X_mm` and `X_deg` are both named `X`"),
        (b"X_mm,,Y_mm\n1,2,3\n", "Use: t.csv:1:6: a column has no name"),
        (b"X_mm,Y_mm,\n1,2,3\n", "Use: t.csv:1:11: a column has no name"),
        (b"X_mm,\"Y_mm\n1,2\n", "Use: t.csv:1:6: a quotation mark is not closed in its line"),
        (b"X_mm,Y_mm\n1\n", "Data: t.csv:2: the row has 1 cell; 2 were expected"),
        (b"X_mm,Y_mm\n1,2\n# note\n\n1,2,3\n", "Data: t.csv:5: the row has 3 cells; 2 were expected"),
        (
            b"f,X_mm\n\"a,\"\"b\",\"12,5\"\n",
            "Data: t.csv:2:9: `X_mm` is `12,5`; a number with a decimal point was expected (write `decimal: comma` where it is read by `ingest: csv`)",
        ),
        (b"f,X_mm\r\n\r\n\xc3\xa9,  one\r\n", "Data: t.csv:3:5: `X_mm` is `one`; a number was expected"),
        (b"f,X_mm\na,nan\n", "Data: t.csv:2:3: `X_mm` is `nan`, which is not a finite number"),
        (b"f,X_mm\na,-1e999\n", "Data: t.csv:2:3: `X_mm` is `-1e999`, which is not a finite number"),
        (b"X_mm,f\n ,a\n", "Data: t.csv:2:2: `X_mm` is empty; a number was expected"),
        (b"f,dir_X\na,+\n", "Data: t.csv:2:3: `dir_X` is `+`; a number was expected"),
        (b"f,X_mm\na,1\n\"b,2\nc,3\n", "Data: t.csv:3:1: a quotation mark is not closed in its line"),
        (b"f,X_mm\n\xc3\xa9\xff,1\n", "Data: t.csv:2:2: the file is not text in UTF-8"),
        (b"\xef\xbb\xbff,X_mm\ra,b\r", "Data: t.csv:2:3: `X_mm` is `b`; a number was expected"),
        (b"f,X_mm\ra,1\r\r\nb,\n", "Data: t.csv:4:3: `X_mm` is empty; a number was expected"),
        (b"f,X_mm\r\"a\rb\",1\r", "Data: t.csv:2:1: a quotation mark is not closed in its line"),
        (b"f,X_mm\na,1\n\0\0", "Data: t.csv:3:1: the file holds a zero byte: it is no text"),
        (b"\0\0\0", "Data: t.csv:1:1: the file holds a zero byte: it is no text"),
        (
            b"\xff\xfef\0",
            "Data: t.csv: the file is text in UTF-16; UTF-8 was expected (save it as UTF-8; for a table that `ingest: csv` reads, `encoding: utf-16` does)",
        ),
        (
            b"X_mm;Y_mm\n1;2\n",
            "Use: t.csv:1:1: the columns are separated by semicolons; a comma was expected (write `separator: semicolon` where it is read by `ingest: csv`, or save the table with commas, and with points in its numbers)",
        ),
        (
            b"X_mm Y_mm\n1 2\n",
            "Use: t.csv:1:1: the columns are separated by spaces; a comma was expected (write `separator: space` where it is read by `ingest: csv`, or save the table with commas, and with points in its numbers)",
        ),
    ];
    for (bytes, expected) in cases {
        let error = parsed(bytes).unwrap_err();
        let told = format!("{:?}: {error}", error.class);
        assert!(told.starts_with(expected), "{told}");
    }
}

/// What to do is said as well, and what is said helps.
#[test]
fn what_is_wrong_is_said_with_what_to_do() {
    let cases: [(&[u8], &str, &str); 8] = [
        (
            b"T_degC\n293.15\n",
            "a temperature from -100 to 200",
            "in kelvin, write `columns: { T_degC: { column: NAME, unit: K } }`",
        ),
        (b"\xff\xfe\0\0X\0\0\0", "UTF-32", "save it as UTF-8"),
        (b"\0\0\xfe\xff\0\0\0X", "UTF-32", "save it as UTF-8"),
        (b"X_mm,Y_mm", "the file is one line", "each row needs a line of its own"),
        (b"X_mm,X_mm\n1,2\n", "two columns", "take columns by number"),
        (b"X_mm,Y_mm,-1,2,-1,3\n", "two columns `-1`", "does no line end?"),
        (b"X_mm,Y_mm\n1\n", "1 cell; 2 were expected", "correct the file"),
        (b"X_mm,Y_mm\n,1\n", "a number was expected", "`no_data"),
    ];
    for (bytes, message, help) in cases {
        let text = String::from_utf8_lossy(bytes);
        let error = parse(Path::new("t.csv"), bytes).expect_err("it is wrong");
        if bytes.starts_with(b"\xff\xfe") {
            assert_eq!(
                headers(Path::new("t.csv"), Cursor::new(bytes)).expect_err("it is wrong").message,
                error.message
            );
        }
        let told = error.help.clone().unwrap_or_default();
        assert!(error.message.contains(message) && told.contains(help), "{text}: {error} ({told})");
        assert!(!told.contains("thousands"), "{text}: {told}");
    }
}

#[test]
fn cells_and_names_may_be_long() {
    let cell = |length: usize| parsed(format!("f,X_mm\n{},1\n", "a".repeat(length)).as_bytes());
    assert!(cell(64 << 10).is_ok());
    let error = cell((64 << 10) + 1).unwrap_err().to_string();
    assert!(error.starts_with("t.csv:2:1: a cell has 65 KiB; at most 64 are read"), "{error}");
    // Spaces and semicolons in a name separate nothing.
    assert_eq!(parsed(b"name of the point\na b\n").unwrap().columns[0].header.name, "name of the point");
    assert!(parsed(b"tool length_mm\n1\n").is_ok() && parsed(b"a;b,X_mm\nc;d,1\n").is_ok());
    let error = parsed(format!("X_mm\n{}\n", "9".repeat(1000)).as_bytes()).unwrap_err().to_string();
    let expected = format!("t.csv:2:1: `X_mm` is `{}...`, which is not a finite number", "9".repeat(60));
    assert!(error.starts_with(&expected), "{error}");
}

#[test]
fn units_places_and_labels_are_read() {
    let bytes = b"\xef\xbb\xbf# made by hand\r\n\r\nfeature , X_mm,d_um,C_deg,dir_X\r\n\
        07, +1.5 ,2,180,-1\r\n  \r\n# a comment, \"open\r\n\"a,b\",1e3,.5,-90,1";
    let data = parsed(bytes).unwrap();
    assert_eq!(data.labels("feature"), Some(&["07".into(), "a,b".into()][..]));
    assert_eq!(data.numbers("X"), Some(&[1.5, 1000.0][..]));
    assert_eq!(data.numbers("d"), Some(&[0.002, 0.0005][..]));
    assert_eq!(data.numbers("C"), Some(&[180f64.to_radians(), -90f64.to_radians()][..]));
    assert_eq!(data.numbers("dir_X"), Some(&[-1.0, 1.0][..]));
    assert_eq!(data.origins.iter().map(|origin| (origin.line, origin.row)).collect::<Vec<_>>(), [(4, 1), (7, 2)]);
    assert_eq!(data.files, [PathBuf::from("t.csv")]);
}

#[test]
fn a_row_that_begins_as_a_comment_is_not_lost() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.csv");
    for (text, line) in [
        ("X_mm,Y_mm\n1,2\n#N/A,3\n4,5\n", Some(3)),
        ("X_mm,Y_mm\n1,2\n#SPILL!,3\n4,5\n", Some(3)),
        ("X_mm,Y_mm\n1,2\n4,5\n########,3\n", Some(4)),
        ("X_mm,Y_mm\r\n# note\r\n\r\n#DIV/0!,3\r\n4,5\r\n", Some(4)),
        ("X_mm;Y_mm\n1;2\n#NV;3", Some(3)),
        ("X_mm,Y_mm\n1,2\n# NUM! says the sheet\n#N/A values are left out\n#NAME\n#VALUES! of today,1\n3,4\n", None),
    ] {
        let separator = if text.contains(';') { Separator::Semicolon } else { Separator::Comma };
        let layout = Layout { separator, ..Layout::default() };
        std::fs::write(&path, text).unwrap();
        let whole = read_laid_out(&path, &layout).map(|(data, _)| data);
        let in_batches = FileInBatches::new(&path, &layout, 2).map(|file| file.count());
        match line {
            None => assert!(whole.unwrap().rows() == 2 && in_batches.unwrap() == 1),
            Some(line) => {
                let start = format!("{}:{line}: the line begins with `#", path.display());
                for error in [whole.unwrap_err(), in_batches.unwrap_err()] {
                    assert!(error.to_string().starts_with(&start), "{error}");
                }
            }
        }
    }
}

#[test]
fn files_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.csv");
    let missing = format!("{}: there is no such file", path.display());
    for error in [read(&path).unwrap_err(), read_headers(&path).unwrap_err()] {
        assert!(error.class == Class::Use && error.to_string().starts_with(&missing), "{error}");
    }
    assert_eq!(read(folder.path()).unwrap_err().class, Class::Use);
    assert_eq!(read_headers(folder.path()).unwrap_err().class, Class::Use);
    // A row that is wrong does not matter for the header.
    std::fs::write(&path, b"# note\nfeature,x_mm\n1,\xff\n").unwrap();
    assert_eq!(read_headers(&path).unwrap().len(), 2);
    assert_eq!(read(&path).unwrap_err().class, Class::Data);
}

#[test]
fn features_have_points_and_normals() {
    let data = table("feature,x_mm,y_um,z_mm,nx,ny,nz\n7,1,2,3,0,0,1\n8,4,5,6,1,0,0\n").unwrap();
    assert_eq!(
        unique_labels(&data, "feature").unwrap().into_iter().collect::<Vec<_>>(),
        [("7", DataRow(0)), ("8", DataRow(1))]
    );
    assert_eq!(points(&data, ["x", "y", "z"]).unwrap(), [[1.0, 0.002, 3.0], [4.0, 0.005, 6.0]]);
    assert_eq!(vectors(&data, ["nx", "ny", "nz"]).unwrap(), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]);

    let cases = [
        ("feature,x_mm,y_mm,z_mm\n7,1,2,3\n# note\n7,1,2,3\n", "t.csv:4: feature `7` is in line 2 already"),
        (
            "featur,x_mm,y_mm,z_mm\n7,1,2,3\n",
            "t.csv: there is no column `feature`; the columns are `featur`, `x_mm`, `y_mm`, `z_mm` (did you mean \
             `featur`?)",
        ),
        ("feature_mm,x_mm,y_mm,z_mm\n7,1,2,3\n", "t.csv: the column `feature_mm` holds numbers; labels were expected"),
        (
            "feature,x_mm,y_mm,z\n7,1,2,3\n",
            "t.csv: the column `z` does not say its unit (write its unit into its name: `z_mm`)",
        ),
        ("feature,x_mm,y_deg,z_mm\n7,1,2,3\n", "t.csv: the column `y_deg` has the wrong unit; mm was expected"),
        ("feature,x_mm,y_mm\n7,1,2\n", "t.csv: there is no column `z_mm`; the columns are `feature`, `x_mm`, `y_mm`"),
    ];
    for (text, expected) in cases {
        let data = table(text).unwrap();
        let found = unique_labels(&data, "feature").and_then(|_| points(&data, ["x", "y", "z"]));
        let told = found.unwrap_err().to_string();
        assert!(told.starts_with(expected), "{told}");
    }
}

fn finite() -> impl Strategy<Value = f64> {
    use prop::num::f64::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
}

const VALID: &[u8] =
    b"\xef\xbb\xbf# c\r\nfeature,X_mm,\"C_deg\",dir_X\n1,1.5,-90,+1\n\n# d\n\"2,\"\"x\",1e-3, 7 ,-1\r\n";

proptest! {
    #[test]
    fn numbers_round_trip(rows in prop::collection::vec((finite(), finite()), 1..20)) {
        let mut text = "X_mm,a_rad\n".to_owned();
        rows.iter().for_each(|(x, a)| text.push_str(&format!("{x},{a:e}\n")));
        let data = parsed(text.as_bytes()).unwrap();
        prop_assert_eq!(data.numbers("X").unwrap(), rows.iter().map(|row| row.0).collect::<Vec<_>>());
        prop_assert_eq!(data.numbers("a").unwrap(), rows.iter().map(|row| row.1).collect::<Vec<_>>());
    }

    #[test]
    fn random_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = parsed(&bytes);
    }

    #[test]
    fn random_tables_do_no_harm(text in "(\u{feff}|[#,\"\r\n \u{a0}éxX1.+_-]|_mm|_deg|1e9|nan){0,60}") {
        let _ = parsed(text.as_bytes());
    }

    #[test]
    fn random_changes_do_no_harm(
        changes in prop::collection::vec((any::<prop::sample::Index>(), 0usize..4, any::<u8>()), 1..6),
    ) {
        let mut bytes = VALID.to_vec();
        for (place, removed, inserted) in changes {
            let at = place.index(bytes.len() + 1);
            let end = (at + removed).min(bytes.len());
            bytes.splice(at..end, (removed < 3).then_some(inserted));
        }
        if let Ok(data) = parsed(&bytes) {
            for column in &data.columns {
                let rows = match &column.values {
                    Values::Numbers(numbers) => numbers.len(),
                    Values::Labels(labels) => labels.len(),
                };
                prop_assert_eq!(rows, data.rows());
                prop_assert_eq!(column.header.quantity == Quantity::Label, matches!(column.values, Values::Labels(_)));
            }
        }
    }
}

/// A table as a spreadsheet of some country or an instrument writes it: title lines, its separator, decimal character and encoding.
fn written(rows: &[(f64, f64)], layout: &Layout, names: [&str; 3]) -> Vec<u8> {
    let between = match layout.separator {
        Separator::Space => "  \t".to_owned(),
        other => other.character().to_string(),
    };
    let mut text: String = (0..layout.skip_lines).map(|line| format!("Größe; title, {line}\n")).collect();
    if layout.has_header {
        text.push_str(&(names.join(&between) + "\r\n"));
    }
    (0..layout.skip_after_header).for_each(|_| text.push_str(&(["[mm]", "[°]", "-"].join(&between) + "\r\n")));
    for (index, (x, a)) in rows.iter().enumerate() {
        let number = |value: f64| match layout.decimal {
            Decimal::Point => value.to_string(),
            Decimal::Comma if layout.separator == Separator::Comma => {
                format!("\"{}\"", value.to_string().replace('.', ","))
            }
            Decimal::Comma => value.to_string().replace('.', ","),
        };
        text.push_str(&([number(*x), number(*a), format!("ß{index}")].join(&between) + "\r\n"));
    }
    match layout.encoding {
        Encoding::Utf8 => text.into_bytes(),
        Encoding::Utf16 => [0xFF, 0xFE].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect(),
        Encoding::Gb18030 => encoding_rs::GB18030.encode(&text).0.into_owned(),
        Encoding::Latin1 => text.chars().map(|character| u8::try_from(u32::from(character)).unwrap()).collect(),
    }
}

fn layouts() -> impl Strategy<Value = Layout> {
    let separators = Separator::ALL.map(|(separator, ..)| separator).to_vec();
    (
        prop::sample::select(separators),
        prop::sample::select(vec![Decimal::Point, Decimal::Comma]),
        prop::sample::select(vec![Encoding::Utf8, Encoding::Utf16, Encoding::Latin1, Encoding::Gb18030]),
        (0usize..4, 0usize..3, any::<bool>()),
    )
        .prop_map(|(separator, decimal, encoding, (skip_lines, skip_after_header, has_header))| Layout {
            separator,
            decimal,
            encoding,
            skip_lines,
            skip_after_header,
            has_header,
            ..Layout::default()
        })
}

proptest! {
    #[test]
    fn tables_of_all_countries_are_read(layout in layouts(), rows in prop::collection::vec((-1e6..1e6f64, -400.0..400.0f64), 1..12)) {
        let names = ["Meas_X_[mm]", "Joint_1_[°]", "Bemerkung"];
        let bytes = written(&rows, &layout, names);
        let place = |index: usize| if layout.has_header { names[index].to_owned() } else { (index + 1).to_string() };
        let column = |index, unit: Option<&str>, name: &str| ColumnSource {
            column: place(index),
            unit: unit.map(|unit| Unit::of(unit, &abbe_core::ColumnHeader::parse(name)).unwrap()),
        };
        let columns = [("X_mm", column(0, Some("in"), "X_mm")), ("a_deg", column(1, None, "a_deg")), ("note", column(2, None, "note"))];
        let layout = Layout { columns: Some(columns.map(|(name, source)| (name.to_owned(), source)).into()), ..layout };
        let (data, left_out) = dataset(Path::new("t.csv"), &bytes, &layout).unwrap();
        prop_assert_eq!(left_out, 0);
        prop_assert_eq!(headers_laid_out(Path::new("t.csv"), &bytes, &layout).unwrap(), data.headers());
        prop_assert_eq!(data.numbers("X").unwrap(), rows.iter().map(|row| row.0 * 25.4).collect::<Vec<_>>());
        prop_assert_eq!(data.numbers("a").unwrap(), rows.iter().map(|row| row.1 * (std::f64::consts::PI / 180.0)).collect::<Vec<_>>());
        let labels: Vec<String> = (0..rows.len()).map(|index| format!("ß{index}")).collect();
        prop_assert_eq!(data.labels("note").unwrap(), labels);
        let first = 1 + layout.skip_lines + usize::from(layout.has_header) + layout.skip_after_header;
        prop_assert_eq!(data.origins[0].line, first);
    }

    #[test]
    fn random_bytes_with_a_layout_do_no_harm(layout in layouts(), bytes in prop::collection::vec(any::<u8>(), 0..120)) {
        let _ = dataset(Path::new("t.csv"), &bytes, &layout);
        let columns = [("X_mm".to_owned(), ColumnSource { column: "1".to_owned(), unit: None })];
        let _ = dataset(Path::new("t.csv"), &bytes, &Layout { columns: Some(columns.into()), ..layout });
    }
}

#[test]
fn what_a_layout_does_not_fit_is_said_with_its_place() {
    let read = |text: &[u8], layout: Layout| {
        dataset(Path::new("t.csv"), text, &layout).map(|(data, _)| data.rows()).unwrap_err().to_string()
    };
    let semicolon = || Layout { separator: Separator::Semicolon, decimal: Decimal::Comma, ..Layout::default() };
    let told = read(b"X_mm,Y_mm\n1,2\n", semicolon());
    assert!(told.starts_with("t.csv:1:1: the columns are separated by commas; a semicolon was expected"), "{told}");
    assert_eq!(
        read(b"X_mm;Y_mm\n1.234,5;2\n", semicolon()),
        "t.csv:2:1: `X_mm` is `1.234,5`; a number with a decimal comma and without separators of thousands was expected \
         (write `thousands: point` where it is read by `ingest: csv`)"
    );
    let spaces = Layout { separator: Separator::Space, ..Layout::default() };
    let told = read(b"f X_mm\n a  \tone\n", spaces);
    assert!(told.starts_with("t.csv:2:6: `X_mm` is `one`; a number was expected"), "{told}");
    let named = |name: &str, no_data: &[&str]| Layout {
        columns: Some([("X_mm".to_owned(), ColumnSource { column: name.to_owned(), unit: None })].into()),
        no_data: no_data.iter().map(|mark| (*mark).to_owned()).collect(),
        ..Layout::default()
    };
    let told = read(b"Meas X,Meas X\n1,2\n", named("Meas X", &[]));
    assert!(told.starts_with("t.csv:1:8: there are two columns `Meas X`"), "{told}");
    let told = read(b"Meas X,Meas Y\n1,2\n", named("Meas Z", &[]));
    assert!(told.starts_with("t.csv:1: there is no column `Meas Z`; the columns are `Meas X`, `Meas Y`"), "{told}");
    let told = read(b"a\n---\n", named("a", &["---"]));
    assert!(told.starts_with("t.csv: all rows of the file hold a mark of `no_data`"), "{told}");
    let utf_16 = Layout { encoding: Encoding::Utf16, ..Layout::default() };
    assert!(read(b"X_m", utf_16.clone()).contains("an odd number of bytes"));
    assert!(read(b"\xff\xfea\0\n\0\0\xd8b\0", utf_16).starts_with("t.csv:2:1: the file is not text in UTF-16"));
    let latin = Layout { encoding: Encoding::Latin1, ..Layout::default() };
    assert!(read(b"\xff\xfea\0", latin).contains("write `encoding: utf-16`"));
    // A mark that is a number is one, however it is written: a recipe has `0.50` as 0.5.
    for (mark, cell) in [("0.5", "0.50"), ("-999", "-999.0"), ("0.5", "+.5"), ("999", "9.99e2"), ("0", "0.0000")] {
        let told = read(format!("a\n{cell}\n").as_bytes(), named("a", &[mark]));
        assert!(told.starts_with("t.csv: all rows of the file hold a mark of `no_data`"), "{mark} {cell}: {told}");
    }
    // Rows without a number keep the others' lines and numbers.
    let layout = named("a", &["---", ""]);
    let (data, left_out) = dataset(Path::new("t.csv"), b"b,a\n1,2\n1,---\n3, \n4,5\n", &layout).unwrap();
    assert_eq!((data.numbers("X").unwrap(), left_out), (&[2.0, 5.0][..], 2));
    assert_eq!(data.origins.iter().map(|origin| (origin.line, origin.row)).collect::<Vec<_>>(), [(2, 1), (5, 4)]);
}
