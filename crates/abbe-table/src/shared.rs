//! Tables that a program holds in memory: the same meaning as a table in a file.

use std::borrow::Cow;
use std::path::Path;

use abbe_core::{ColumnCells, Dataset, Result, Table};

use crate::columns::{DataOfColumns, NamedColumns};
use crate::layout::Layout;

/// Marks under `no_data` of a number that is missing. Programs make no difference: pandas has NaN for both.
const MISSING: [&str; 2] = ["", "nan"];

/// The data set that a table is, and the number of rows that are left out because a number was not measured. `path` is the file in whose
/// place the table stands; it names the rows.
///
/// Of a layout only the columns, the marks of `no_data` and how numbers are written count. Fails as reading a file of columns does.
pub fn of_table(path: &Path, table: &Table, layout: &Layout) -> Result<(Dataset, usize)> {
    let layout = &of_program(layout);
    let named = NamedColumns::new(path, &table.fields, layout)?;
    let taken = named.fields();
    let mut data = DataOfColumns::new(named, layout, u64::MAX);
    for part in &table.parts {
        let cells: Vec<&dyn ColumnCells> = taken.iter().map(|field| &*part.cells[*field] as _).collect();
        data.add(part.rows, &cells)?;
    }
    data.finish()
}

/// The same without its rows. Fails for names and units alone.
pub fn of_table_without_rows(path: &Path, table: &Table, layout: &Layout) -> Result<Dataset> {
    Ok(NamedColumns::new(path, &table.fields, layout)?.without_rows())
}

/// The layout with all marks of a missing number, if it has one.
fn of_program(layout: &Layout) -> Cow<'_, Layout> {
    let is_missing = |mark: &String| MISSING.contains(&mark.to_lowercase().as_str());
    if !layout.no_data.iter().any(is_missing) {
        return Cow::Borrowed(layout);
    }
    let no_data = layout.no_data.iter().cloned().chain(MISSING.map(str::to_owned)).collect();
    Cow::Owned(Layout { no_data, ..layout.clone() })
}

#[cfg(test)]
mod tests {
    use abbe_core::{Cell, Field, RowsOfTable, SharedCells};

    use super::*;

    fn field(name: &str) -> Field {
        Field { name: name.to_owned(), unit: None }
    }

    fn text(text: &'static str) -> Cell<'static> {
        Cell::Text(text.into())
    }

    /// The same rows, as a file and as a table in two parts, give the same data set to the last bit; a table has no lines.
    #[test]
    fn a_table_means_what_a_file_means() {
        let file = "feature,X_mm,B_deg,E_um,T_degC,dir_X\n7,0.1,33.3,-0.7,20.5,1\na b,-12.25,0.7,1e3,19.875,-1\n";
        let path = Path::new("touches.csv");
        let mut expected = crate::parse(path, file.as_bytes()).unwrap();
        expected.origins.iter_mut().for_each(|origin| origin.line = 0);
        let part = |feature, [x, b, e]: [f64; 3], temperature, direction: i64| {
            let numbers = [x, b, e].map(|number| Box::new(vec![number]) as SharedCells);
            let mut cells: Vec<SharedCells> = vec![Box::new(vec![feature])];
            cells.extend(numbers);
            cells.push(Box::new(vec![text(temperature)]));
            cells.push(Box::new(vec![direction]));
            RowsOfTable { rows: 1, cells }
        };
        let table = Table {
            fields: ["feature", "X_mm", "B_deg", "E_um", "T_degC", "dir_X"].map(field).into(),
            parts: vec![
                part(Cell::Whole(7), [0.1, 33.3, -0.7], "20.5", 1),
                part(text(" a b"), [-12.25, 0.7, 1e3], "19.875", -1),
            ],
        };
        let (found, left_out) = of_table(path, &table, &Layout::default()).unwrap();
        assert_eq!((&found, left_out), (&expected, 0));
        assert_eq!(of_table_without_rows(path, &table, &Layout::default()).unwrap().headers(), found.headers());
    }

    #[test]
    fn a_missing_number_is_marked_either_way() {
        let table = |cells: Vec<Cell<'static>>| Table {
            fields: vec![field("X_mm"), field("a")],
            parts: vec![RowsOfTable {
                rows: cells.len(),
                cells: vec![Box::new(cells.clone()), Box::new(vec![text("p"); cells.len()])],
            }],
        };
        let cells = vec![Cell::Number(f64::NAN), Cell::Number(2.0), Cell::Number(-9999.0), Cell::Missing];
        for mark in ["NaN", ""] {
            let layout = Layout { no_data: [mark, "-9999"].map(str::to_owned).into(), ..Layout::default() };
            let (data, left_out) = of_table(Path::new("t"), &table(cells.clone()), &layout).unwrap();
            assert_eq!((left_out, data.rows(), data.origins[0].row), (3, 1, 2));
        }
        for (cell, expected) in [(Cell::Missing, "is empty"), (Cell::Number(f64::NAN), "which is not a finite number")]
        {
            let other = Layout { no_data: vec!["-9999".to_owned()], ..Layout::default() };
            let error = of_table(Path::new("t"), &table(vec![Cell::Whole(1), cell]), &other).unwrap_err().to_string();
            assert!(error.starts_with("t: row 2: `X_mm` ") && error.contains(expected), "{error}");
        }
    }
}
