use std::path::Path;

use abbe_core::Values;

use super::*;
use crate::layout::ColumnSource;

fn field(name: &str, unit: &str) -> Field {
    Field { name: name.to_owned(), unit: Some(unit.to_owned()).filter(|unit| !unit.is_empty()) }
}

fn text(text: &'static str) -> Cell<'static> {
    Cell::Text(text.into())
}

/// The data set of columns with all their cells.
fn read(columns: &[(Field, Vec<Cell<'static>>)], layout: &Layout) -> Result<(Dataset, usize)> {
    let fields: Vec<Field> = columns.iter().map(|(field, _)| field.clone()).collect();
    let named = NamedColumns::new(Path::new("t.parquet"), &fields, layout)?;
    let cells: Vec<Box<dyn ColumnCells>> =
        named.fields().into_iter().map(|field| Box::new(columns[field].1.clone()) as Box<dyn ColumnCells>).collect();
    let rows = columns.first().map_or(0, |(_, cells)| cells.len());
    let mut data = DataOfColumns::new(named, layout, 1 << 20);
    let cells: Vec<&dyn ColumnCells> = cells.iter().map(|cells| &**cells).collect();
    data.add(rows, &cells)?;
    data.finish()
}

fn one(name: &str, unit: &str, cells: Vec<Cell<'static>>) -> Result<(Dataset, usize)> {
    read(&[(field(name, unit), cells)], &Layout::default())
}

fn message(name: &str, unit: &str, cells: Vec<Cell<'static>>) -> String {
    one(name, unit, cells).unwrap_err().to_string()
}

#[test]
fn units_stand_in_names_or_beside_them() {
    for (name, unit, header, expected) in [
        ("X_mm", "", "X_mm", 2.0),
        ("X_mm", "mm", "X_mm", 2.0),
        ("X", "mm", "X_mm", 2.0),
        ("d", "µm", "d_um", 2e-3),
        ("X", "in", "X_mm", 50.8),
        ("B", "°", "B_deg", 2.0 * std::f64::consts::PI / 180.0),
        ("T", "degF", "T_degC", (2.0 - 32.0) * (5.0 / 9.0)),
        ("T", "°C", "T_degC", 2.0),
        ("scale", "um/m", "scale_um_per_m", 2e-6),
        ("scale_um_per_m", "um/m", "scale_um_per_m", 2e-6),
        ("scale_um_per_m", "µm/m", "scale_um_per_m", 2e-6),
        ("scale_um_per_m", "", "scale_um_per_m", 2e-6),
        ("a", "1/K", "a_per_K", 2.0),
        ("feed", "mm/min", "feed_mm_per_min", 2.0 / 60.0),
        ("nx", "1", "nx", 2.0),
        ("nx", "", "nx", 2.0),
    ] {
        let (data, _) =
            one(name, unit, vec![Cell::Number(2.0)]).unwrap_or_else(|error| panic!("{name} {unit}: {error}"));
        assert_eq!(data.columns[0].header, ColumnHeader::parse(header), "{name} {unit}");
        assert_eq!(data.columns[0].values, Values::Numbers(vec![expected]), "{name} {unit}");
    }
    for (name, unit, expected) in [
        ("X_mm", "um", "the table says that `X_mm` is in `um`, and its name says another unit"),
        ("X_mm", "deg", "is in `deg`, which is no unit of `X_mm`"),
        ("scale_um_per_m", "mm", "is in `mm`, which is no unit of `scale_um_per_m`"),
        ("X", "furlong", "is in `furlong`, which is no known unit"),
        ("ratio", "%", "its name is not one of a number without a unit"),
    ] {
        let message = message(name, unit, vec![Cell::Number(2.0)]);
        assert!(message.starts_with("t.parquet: ") && message.contains(expected), "{message}");
    }
}

#[test]
fn columns_are_taken_with_the_unit_of_the_file() {
    let layout = |unit: Option<&str>| Layout {
        columns: Some(
            [(
                "X_mm".to_owned(),
                ColumnSource {
                    column: "Meas X".to_owned(),
                    unit: unit.map(|unit| Unit::of(unit, &ColumnHeader::parse("X_mm")).unwrap()),
                },
            )]
            .into(),
        ),
        ..Layout::default()
    };
    let read = |stated: &str, declared| {
        let columns = [(field("other", ""), vec![text("a")]), (field("Meas X", stated), vec![Cell::Whole(3)])];
        read(&columns, &layout(declared)).map(|(data, _)| data.columns[0].values.clone())
    };
    let number = |value: f64| Values::Numbers(vec![value]);
    assert_eq!(read("", None).unwrap(), number(3.0));
    assert_eq!(read("", Some("um")).unwrap(), number(3e-3));
    assert_eq!(read("um", None).unwrap(), number(3e-3));
    assert_eq!(read("µm", Some("um")).unwrap(), number(3e-3));
    assert!(read("um", Some("in")).unwrap_err().message.contains("`columns` says `in`"));
    assert!(read("deg", None).unwrap_err().message.contains("no unit of `X_mm`"));
}

#[test]
fn cells_mean_what_they_mean_in_csv() {
    let label = |cells| one("point", "", cells).unwrap().0.columns[0].values.clone();
    let labels = |all: &[&str]| Values::Labels(all.iter().map(|&label| label.into()).collect());
    let cells = vec![text(" a "), Cell::Whole(12), Cell::Number(1.0), Cell::Number(0.1), Cell::Missing];
    assert_eq!(label(cells), labels(&["a", "12", "1", "0.1", ""]));

    let expected = "t.parquet: row 2: `X_mm` is empty; a number was expected";
    assert!(message("X_mm", "", vec![Cell::Number(1.0), Cell::Missing]).starts_with(expected));
    assert!(
        message("X_mm", "", vec![Cell::Number(f64::NAN)]).contains("row 1: `X_mm` is `NaN`, which is not a finite")
    );
    assert!(message("X_mm", "", vec![text("one")]).contains("`X_mm` is `one`; a number was expected"));
    assert!(message("T_degC", "", vec![Cell::Number(293.15e3)]).contains("a temperature from"));
    assert!(message("a", "", vec![text("one\ntwo")]).contains("several lines"));
    assert!(message("a", "", vec![Cell::Text("x".repeat(70_000).into())]).contains("69 KiB; at most 64"));
    assert!(message("X_mm", "", Vec::new()).contains("no data rows"));
    assert_eq!(one("X_mm", "", vec![text("1.5")]).unwrap().0.columns[0].values, Values::Numbers(vec![1.5]));

    let layout = Layout { no_data: ["", "nan", "-9999"].map(str::to_owned).into(), ..Layout::default() };
    let cells =
        vec![Cell::Missing, Cell::Number(f64::NAN), Cell::Whole(-9999), Cell::Number(-9999.0), Cell::Number(4.0)];
    let (data, left_out) = read(&[(field("X_mm", ""), cells)], &layout).unwrap();
    assert_eq!((data.rows(), left_out, data.origins[0]), (1, 4, RowOrigin { file: 0, line: 0, row: 5 }));
}

#[test]
fn names_are_there_once() {
    let all = |names: &[&str]| {
        let columns: Vec<(Field, Vec<Cell<'static>>)> =
            names.iter().map(|name| (field(name, ""), vec![text("1")])).collect();
        read(&columns, &Layout::default()).unwrap_err().to_string()
    };
    assert!(all(&["X_mm", "X_um"]).contains("the columns `X_mm` and `X_um` are both named `X`"));
    assert!(all(&["a", "a"]).contains("there are two columns `a`"));
    assert!(all(&["a", " "]).contains("a column has no name"));
    assert!(all(&[]).contains("no columns"));
    assert!(all(&["a", &"x".repeat(66 << 10)]).contains("the name of column 2 has 66 KiB; at most 64 are read"));
}

#[test]
fn little_does_not_become_much() {
    let cells = vec![Cell::Text("x".repeat(60_000).into()); 20];
    assert!(message("a", "", cells).contains("row 18: the content has more than 1 MiB"));
}
