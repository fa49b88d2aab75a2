//! Spreadsheets of five countries, written as these write them, are read as declared, and what they need is found.

use std::path::Path;

use proptest::prelude::*;

use super::{contents_of, likely_of};
use crate::layout::{ColumnSource, Decimal, Encoding, Layout, Separator, Thousands};
use crate::parse::dataset;
use crate::text::text;

/// How spreadsheets of a country write a table.
#[derive(Debug, Clone)]
struct Locale {
    layout: Layout,
    minus: &'static str,
    thousands: &'static str,
    names: [&'static str; 3],
    units: [&'static str; 3],
    title: &'static str,
}

fn locales() -> Vec<Locale> {
    let layout = |separator, decimal, thousands, encoding| Layout {
        separator,
        decimal,
        thousands,
        encoding,
        ..Layout::default()
    };
    use Encoding::{Gb18030, Latin1, Utf8, Utf16};
    use Separator::{Comma, Semicolon, Tab};
    let german = Locale {
        layout: layout(Semicolon, Decimal::Comma, Thousands::Point, Latin1),
        minus: "-",
        thousands: ".",
        names: ["Prüfpunkt", "Länge X", "Winkel"],
        units: ["-", "[mm]", "[°]"],
        title: "Prüfbericht für Maschine 3",
    };
    let french = Locale {
        layout: layout(Semicolon, Decimal::Comma, Thousands::Blank, Utf8),
        thousands: "\u{202f}",
        names: ["Repère", "Écart X", "Angle"],
        units: ["", "(mm)", "(°)"],
        title: "Métrologie de l'atelier",
        ..german.clone()
    };
    let english = Locale {
        layout: layout(Comma, Decimal::Point, Thousands::Comma, Utf8),
        thousands: ",",
        names: ["Point name", "Meas X", "Joint 1 [°]"],
        units: ["", "mm", "deg"],
        title: "Report of hall 3",
        ..german.clone()
    };
    let swedish = Locale {
        layout: layout(Semicolon, Decimal::Comma, Thousands::Blank, Utf8),
        minus: "\u{2212}",
        thousands: "\u{a0}",
        names: ["Mätpunkt", "Läge", "Vinkel"],
        units: ["", "mm", "grader"],
        title: "Mätning på åtta punkter",
    };
    let chinese = Locale {
        layout: layout(Comma, Decimal::Point, Thousands::None, Gb18030),
        thousands: "",
        names: ["测量点", "位置", "角度"],
        units: ["", "毫米", "度"],
        title: "机床测量报告",
        ..german.clone()
    };
    let unicode_text =
        Locale { layout: layout(Tab, Decimal::Comma, Thousands::None, Utf16), thousands: "", ..swedish.clone() };
    let plain_german =
        Locale { layout: layout(Semicolon, Decimal::Comma, Thousands::None, Utf8), thousands: "", ..german.clone() };
    vec![german, french, english, swedish, chinese, unicode_text, plain_german]
}

impl Locale {
    /// A number in thousandths.
    fn number(&self, thousandths: i64) -> String {
        let whole = (thousandths / 1000).unsigned_abs().to_string();
        let mut grouped = String::new();
        for (place, digit) in whole.chars().enumerate() {
            if place > 0 && (whole.len() - place).is_multiple_of(3) {
                grouped.push_str(self.thousands);
            }
            grouped.push(digit);
        }
        let sign = if thousandths < 0 { self.minus } else { "" };
        let decimal = if self.layout.decimal == Decimal::Comma { ',' } else { '.' };
        format!("{sign}{grouped}{decimal}{:03}0", thousandths.unsigned_abs() % 1000)
    }

    fn line(&self, cells: [&str; 3]) -> String {
        let separator = self.layout.separator.character();
        let quoted = |cell: &str| if cell.contains(separator) { format!("\"{cell}\"") } else { cell.to_owned() };
        cells.map(quoted).join(&separator.to_string()) + "\r\n"
    }

    fn file(&self, titles: usize, units: bool, rows: &[(i64, i64)]) -> Vec<u8> {
        let mut content: String = (0..titles).map(|_| format!("{}\r\n", self.title)).collect();
        content.push_str(&self.line(self.names));
        if units {
            content.push_str(&self.line(self.units));
        }
        for (index, (x, angle)) in rows.iter().enumerate() {
            content.push_str(&self.line([&format!("P{index}"), &self.number(*x), &self.number(*angle)]));
        }
        match self.layout.encoding {
            Encoding::Utf8 => content.into_bytes(),
            Encoding::Utf16 => {
                [0xFF, 0xFE].into_iter().chain(content.encode_utf16().flat_map(u16::to_le_bytes)).collect()
            }
            Encoding::Latin1 => encoding_rs::WINDOWS_1252.encode(&content).0.into_owned(),
            Encoding::Gb18030 => encoding_rs::GB18030.encode(&content).0.into_owned(),
        }
    }
}

proptest! {
    #[test]
    fn spreadsheets_of_five_countries_are_read(
        locale in prop::sample::select(locales()),
        titles in 0usize..3,
        units in any::<bool>(),
        // Some beyond a thousand, so that separators occur, and some negative.
        rows in prop::collection::vec((-9_000_000i64..9_000_000, -360_000i64..360_000), 6..30),
    ) {
        prop_assume!(rows.iter().any(|(x, _)| x.abs() >= 1_000_000));
        let path = Path::new("t.csv");
        let bytes = locale.file(titles, units, &rows);
        let layout = Layout { skip_lines: titles, skip_after_header: usize::from(units), ..locale.layout.clone() };
        // What the file needs is found.
        let found = likely_of(path, &bytes).unwrap();
        prop_assert_eq!(&found.layout, &layout);
        prop_assert!(found.open.iter().all(|open| open.contains("encoding")), "{:?}", found.open);
        // With that it is read back exactly.
        let source = |index: usize| ColumnSource { column: locale.names[index].to_owned(), unit: None };
        let columns = [("p", source(0)), ("X_mm", source(1)), ("a_rad", source(2))];
        let columns = Some(columns.map(|(name, source)| (name.to_owned(), source)).into());
        let (data, _) = dataset(path, &bytes, &Layout { columns, ..found.layout }).unwrap();
        let expected = |values: Vec<i64>| -> Vec<f64> { values.into_iter().map(|value| format!("{value}e-3").parse().unwrap()).collect() };
        prop_assert_eq!(data.numbers("X").unwrap(), expected(rows.iter().map(|row| row.0).collect()));
        prop_assert_eq!(data.numbers("a").unwrap(), expected(rows.iter().map(|row| row.1).collect()));
        // And told as it is.
        let content = text(path, &bytes, layout.encoding).unwrap();
        let told = contents_of(path, &content, &layout).unwrap();
        prop_assert_eq!(told.rows, rows.len());
        let names: Vec<&str> = told.columns.iter().map(|column| column.name.as_str()).collect();
        prop_assert_eq!(names, locale.names.to_vec());
        let largest = rows.iter().map(|row| row.0).max().unwrap() as f64 / 1000.0;
        prop_assert!((told.columns[1].range.unwrap()[1] - largest).abs() < 1e-9);
    }

    #[test]
    fn random_bytes_are_surveyed_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = likely_of(Path::new("t.csv"), &bytes);
    }

    #[test]
    fn random_tables_are_surveyed_without_harm(content in "(\u{feff}|[#,;\t|\"\r\n éxX1.+_-]|_mm|_deg|1e9|nan){0,60}") {
        let _ = likely_of(Path::new("t.csv"), content.as_bytes());
    }
}

fn surveyed(content: &str) -> (Layout, Vec<String>, super::Contents) {
    let path = Path::new("t.csv");
    let found = likely_of(path, content.as_bytes()).unwrap();
    let told = contents_of(path, content, &found.layout).unwrap();
    (found.layout, found.open, told)
}

#[test]
fn gaps_jumps_marks_and_repeated_rows_are_found() {
    let mut content = "n,time_s,X_mm,note\n".to_owned();
    for (row, time) in [0, 1, 2, 3, 4, 90, 91, 92, 50, 51].into_iter().enumerate() {
        let x = if row == 3 {
            "---".to_owned()
        } else if row == 4 {
            String::new()
        } else {
            format!("{}.5", row / 2)
        };
        content.push_str(&format!("{row},{time},{x},a\n"));
    }
    content.push_str("10,51,4.5,a\n");
    let (layout, open, told) = surveyed(&content);
    assert_eq!(layout, Layout { no_data: vec![String::new(), "---".to_owned()], ..Layout::default() });
    assert!(open.is_empty());
    assert_eq!((told.rows, told.header_line, told.lines), (11, Some(1), (2, 12)));
    let jumps: Vec<(usize, f64)> = told.jumps.iter().map(|jump| (jump.line, jump.step)).collect();
    assert_eq!(jumps, [(7, 86.0), (10, -42.0)]);
    // Column `n` counts the rows.
    assert_eq!(told.repeated, [(11, 12)]);
    assert_eq!((told.columns[2].numbers, told.columns[2].empty), (9, 1));
    assert!(told.columns[2].is_numeric() && !told.columns[3].is_numeric());
}

#[test]
fn what_a_file_does_not_tell_is_left_open() {
    let (layout, open, _) = surveyed("a;b\n1,234;2,500\n3,456;4,000\n");
    assert_eq!(layout.decimal, Decimal::Comma);
    assert!(open[0].contains("`thousands: comma`"), "{open:?}");
    let (_, open, _) = surveyed("a;b\n1,234;2,5\n3,456;4,000\n");
    assert!(open.is_empty());
    let (layout, ..) = surveyed("1 2.5 3\n4 5.5 6\n");
    assert_eq!((layout.separator, layout.has_header), (Separator::Space, false));
    let (layout, ..) =
        surveyed("Messung 12;;;\nHalle 3;;;\nPunkt;Meas X;Joint 1 [°];Temp\n;[mm];;[F]\n1;12,5;3;68,2\n2;---;4;68,2\n");
    assert_eq!((layout.skip_lines, layout.skip_after_header, layout.has_header), (2, 1, true));
}

/// The row of names is a row of the table as the others are; a title before it is none.
#[test]
fn long_cells_of_the_row_of_names_are_refused() {
    let path = Path::new("t.csv");
    let long = "x".repeat(66 << 10);
    let refused = |content: &str| likely_of(path, content.as_bytes()).map(drop).map_err(|error| error.to_string());
    for content in [format!("X_mm,{long}\n1,2\n3,4\n"), format!("a title\nX_mm;{long}\n1;2\n3;4\n")] {
        let line = content.lines().position(|line| line.contains(&long)).unwrap() + 1;
        let expected = format!("t.csv:{line}:6: a cell has 66 KiB; at most 64 are read");
        assert!(refused(&content).unwrap_err().starts_with(&expected), "{:?}", refused(&content));
    }
    assert_eq!(refused(&format!("X_mm,{}\n1,2\n3,4\n", &long[..64 << 10])), Ok(()));
    assert_eq!(refused(&format!("{long}\nX_mm,Y_mm\n1,2\n3,4\n")), Ok(()));
    assert_eq!(refused(&format!("#{long}\nX_mm,Y_mm\n1,2\n3,4\n")), Ok(()));
}
