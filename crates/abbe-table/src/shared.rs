//! Tables that a program holds in memory: the same meaning as a table in a file.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use abbe_core::{Cells, Column, ColumnHeader, Dataset, Error, Quantity, Result, RowOrigin, Table, TableColumn, Values};

use crate::layout::{Layout, Unit};
use crate::number::{number_of, shown};

/// What to do about a column that is named twice, or not at all.
const NAMES: &str = "give every column a name of its own, with its unit: `X_mm`, `B_deg`";

/// What to do about a cell without a number.
const NO_DATA: &str =
    "leave such rows out of the table, or write `no_data: [nan]` where the recipe reads it by `ingest: csv`";

/// What numbers that are missing are called under `no_data`.
const MISSING: [&str; 2] = ["", "nan"];

/// The data set that a table is, and the number of rows that are left out because a number was not measured. `path` is the file in whose
/// place the table stands; it names the rows, of which the first is in line 2, as below a head.
///
/// Of a layout only the columns and the marks of `no_data` count. Fails for columns without a name, or with the same one, for columns of
/// different lengths, and for cells that are no numbers where numbers were expected.
pub fn of_table(path: &Path, table: &Table, layout: &Layout) -> Result<(Dataset, usize)> {
    let taken = taken(table, layout).map_err(|error| error.in_file(path))?;
    let rows = table.rows();
    if let Some(column) = table.columns.iter().find(|column| column.rows() != rows) {
        let message = format!("the column `{}` has {} rows; {rows} were expected", column.name, column.rows());
        return Err(Error::data(message).in_file(path).help("all columns of a table have the same length"));
    }
    let absent = absent(&taken, rows, layout);
    let kept: Option<Vec<usize>> = absent.contains(&true).then(|| (0..rows).filter(|row| !absent[*row]).collect());
    let columns = taken.iter().map(|column| column.read(path, layout, &absent));
    let columns = columns.collect::<Result<Vec<Column>>>()?;
    let origin = |row: usize| RowOrigin { file: 0, line: row + 2, row: row + 1 };
    let origins: Vec<RowOrigin> = match &kept {
        Some(kept) => kept.iter().map(|row| origin(*row)).collect(),
        None => (0..rows).map(origin).collect(),
    };
    let left_out = rows - origins.len();
    if rows > 0 && left_out == rows {
        return Err(Error::data("all rows of the table hold a mark of `no_data`").in_file(path));
    }
    Ok((Dataset { columns, origins, files: vec![path.to_owned()], ..Dataset::default() }, left_out))
}

/// A column of the data set, and where it comes from.
struct Taken<'a> {
    header: ColumnHeader,
    from: &'a TableColumn,
    unit: Option<Unit>,
}

/// The columns that a layout takes: `columns` if it has some, else all.
fn taken<'a>(table: &'a Table, layout: &Layout) -> Result<Vec<Taken<'a>>> {
    let mut names: HashMap<&str, &str> = HashMap::new();
    let mut all = Vec::new();
    for column in &table.columns {
        let name = column.name.trim();
        let header = ColumnHeader::parse(name);
        if header.name.is_empty() {
            return Err(Error::usage("a column has no name").help(NAMES));
        }
        all.push(Taken { header, from: column, unit: None });
    }
    if let Some(columns) = &layout.columns {
        let found = columns.iter().map(|(name, source)| {
            let from = table.columns.iter().find(|column| column.name.trim() == source.column.trim());
            let from = from.ok_or_else(|| {
                let there: Vec<String> = table.columns.iter().map(|column| format!("`{}`", column.name)).collect();
                let message =
                    format!("there is no column `{}`; the columns are {}", shown(&source.column), there.join(", "));
                Error::usage(message).help("`columns` of the recipe names those of the table that are taken")
            })?;
            Ok(Taken { header: ColumnHeader::parse(name), from, unit: source.unit })
        });
        return found.collect();
    }
    for column in &all {
        let ColumnHeader { name, header, .. } = &column.header;
        let message = match names.insert(name, header) {
            None => continue,
            Some(twin) if twin == header => format!("there are two columns `{header}`"),
            Some(twin) => format!("the columns `{twin}` and `{header}` are both named `{name}`"),
        };
        return Err(Error::usage(message).help(NAMES));
    }
    Ok(all)
}

/// The rows that have a mark of a number that was not measured.
fn absent(taken: &[Taken<'_>], rows: usize, layout: &Layout) -> Vec<bool> {
    let mut absent = vec![false; rows];
    if layout.no_data.is_empty() {
        return absent;
    }
    let is_mark = |cell: &str| layout.no_data.iter().any(|mark| mark == cell.trim());
    let missing = layout.no_data.iter().any(|mark| MISSING.contains(&mark.to_lowercase().as_str()));
    for column in taken.iter().filter(|column| column.header.quantity != Quantity::Label) {
        let mut row = 0;
        for cells in &column.from.parts {
            for index in 0..cells.len() {
                absent[row] |= match text(cells, index) {
                    None => missing,
                    Some(text) => is_mark(&text),
                };
                row += 1;
            }
        }
    }
    absent
}

/// A cell as it would stand in a file; none for one without content.
fn text(cells: &Cells, index: usize) -> Option<Cow<'_, str>> {
    match cells {
        Cells::Numbers(numbers) => {
            let number = (**numbers).as_ref()[index];
            (!number.is_nan()).then(|| number.to_string().into())
        }
        Cells::Whole(numbers) => Some(numbers[index].to_string().into()),
        Cells::Texts(texts) => texts[index].as_deref().map(Cow::Borrowed),
    }
}

impl Taken<'_> {
    fn read(&self, path: &Path, layout: &Layout, absent: &[bool]) -> Result<Column> {
        let values = match self.header.quantity {
            Quantity::Label => Values::Labels(self.labels(path, absent)?),
            _ => Values::Numbers(self.numbers(path, layout, absent)?),
        };
        Ok(Column { header: self.header.clone(), values })
    }

    fn wrong(&self, path: &Path, row: usize, message: String) -> Error {
        Error::data(message).at(path, row + 2, None)
    }

    fn labels(&self, path: &Path, absent: &[bool]) -> Result<Vec<String>> {
        let mut labels = Vec::with_capacity(absent.len());
        let mut row = 0;
        for cells in &self.from.parts {
            for index in 0..cells.len() {
                let label = text(cells, index).unwrap_or_default();
                if label.contains(['\n', '\r']) {
                    let message = format!("`{}` has several lines; a name was expected", self.header.header);
                    return Err(self.wrong(path, row, message));
                }
                if !absent[row] {
                    labels.push(label.trim().to_owned());
                }
                row += 1;
            }
        }
        Ok(labels)
    }

    /// The numbers in the units of memory: the one copy that is made of them.
    fn numbers(&self, path: &Path, layout: &Layout, absent: &[bool]) -> Result<Vec<f64>> {
        let (_, quantity, factor) = Quantity::of_column(&self.header.header);
        // What is not finite, and temperatures, are looked at as a cell of a file is.
        let is_plain = self.unit.is_none() && quantity != Quantity::Temperature;
        let mut numbers = Vec::with_capacity(absent.len());
        let mut row = 0;
        for cells in &self.from.parts {
            let plain = match cells {
                Cells::Numbers(all) if is_plain => Some((**all).as_ref()),
                _ => None,
            };
            for index in 0..cells.len() {
                if !absent[row] {
                    numbers.push(match plain.map(|all| all[index]).filter(|number| number.is_finite()) {
                        Some(number) => number * factor,
                        None => self.number(layout, cells, index).map_err(|message| {
                            let error = self.wrong(path, row, message);
                            if text(cells, index).is_none() { error.help(NO_DATA) } else { error }
                        })?,
                    });
                }
                row += 1;
            }
        }
        Ok(numbers)
    }

    /// A number, read as a cell of a file is; or what is wrong with it.
    fn number(&self, layout: &Layout, cells: &Cells, index: usize) -> Result<f64, String> {
        let cell = text(cells, index).unwrap_or_default();
        match cells {
            Cells::Texts(_) => number_of(&self.header.header, &cell, self.unit, layout),
            _ => number_of(&self.header.header, &cell, self.unit, &Layout::default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::layout::ColumnSource;

    fn numbers(name: &str, all: &[f64]) -> TableColumn {
        TableColumn { name: name.to_owned(), parts: vec![Cells::Numbers(Arc::new(all.to_vec()))] }
    }

    fn texts(name: &str, all: &[&str]) -> TableColumn {
        let all = all.iter().map(|text| Some((*text).to_owned())).collect();
        TableColumn { name: name.to_owned(), parts: vec![Cells::Texts(Arc::new(all))] }
    }

    fn read(columns: Vec<TableColumn>, layout: &Layout) -> Result<(Dataset, usize)> {
        of_table(Path::new("touches.csv"), &Table { columns }, layout)
    }

    /// The same rows, as a file and as a table in parts, give the same data set to the last bit.
    #[test]
    fn a_table_means_what_a_file_means() {
        let file = "feature,X_mm,B_deg,E_um,T_degC,dir_X\n7,0.1,33.3,-0.7,20.5,1\na b,-12.25,0.7,1e3,19.875,-1\n";
        let path = Path::new("touches.csv");
        let expected = crate::parse(path, file.as_bytes()).unwrap();
        let parts = |name: &str, [one, two]: [f64; 2]| TableColumn {
            name: name.to_owned(),
            parts: [one, two].map(|number| Cells::Numbers(Arc::new(vec![number]))).into(),
        };
        let feature = TableColumn {
            name: "feature".to_owned(),
            parts: vec![Cells::Whole(Arc::new(vec![7])), Cells::Texts(Arc::new(vec![Some(" a b".to_owned())]))],
        };
        let columns = vec![
            feature,
            parts("X_mm", [0.1, -12.25]),
            numbers("B_deg", &[33.3, 0.7]),
            numbers("E_um", &[-0.7, 1e3]),
            texts("T_degC", &["20.5", "19.875"]),
            TableColumn { name: "dir_X".to_owned(), parts: vec![Cells::Whole(Arc::new(vec![1, -1]))] },
        ];
        assert_eq!(read(columns, &Layout::default()).unwrap(), (expected, 0));
    }

    #[test]
    fn columns_are_taken_in_their_units() {
        let unit = crate::Unit::of("in", &ColumnHeader::parse("X_mm"));
        let source = ColumnSource { column: "Meas X".to_owned(), unit: Some(unit.unwrap()) };
        let layout = Layout { columns: Some([("X_mm".to_owned(), source)].into()), ..Layout::default() };
        let (data, _) = read(vec![texts("other", &["a"]), numbers("Meas X", &[2.0])], &layout).unwrap();
        assert_eq!((data.columns.len(), &data.columns[0].values), (1, &Values::Numbers(vec![50.8])));
        let error = read(vec![numbers("X", &[2.0])], &layout).unwrap_err();
        assert_eq!(error.message, "there is no column `Meas X`; the columns are `X`");
    }

    #[test]
    fn what_is_no_number_is_refused_or_left_out() {
        let message = |columns| read(columns, &Layout::default()).unwrap_err().to_string();
        let empty = message(vec![numbers("X_mm", &[1.0, f64::NAN])]);
        assert!(empty.starts_with("touches.csv:3: `X_mm` is empty; a number was expected"), "{empty}");
        assert!(message(vec![numbers("X_mm", &[f64::INFINITY])]).contains("not a finite number"));
        assert!(message(vec![texts("X_mm", &["one"])]).contains("`X_mm` is `one`; a number was expected"));
        assert!(message(vec![numbers("T_degC", &[293_150.0])]).contains("a temperature from"));
        assert!(message(vec![texts("a", &["one\ntwo"])]).contains("several lines"));
        assert!(message(vec![numbers("X_mm", &[1.0]), numbers("Y_mm", &[1.0, 2.0])]).contains("2 rows; 1 were"));
        assert!(message(vec![numbers("X_mm", &[1.0]), numbers("X_um", &[1.0])]).contains("both named `X`"));
        assert!(message(vec![numbers(" ", &[1.0])]).contains("has no name"));

        let layout = Layout { no_data: ["NaN", "-9999"].map(str::to_owned).into(), ..Layout::default() };
        let (data, left_out) =
            read(vec![numbers("X_mm", &[f64::NAN, 2.0, -9999.0]), texts("a", &["p", "q", "r"])], &layout).unwrap();
        assert_eq!((left_out, data.labels("a").unwrap(), data.origins[0].line), (2, &["q".to_owned()][..], 3));
    }
}
