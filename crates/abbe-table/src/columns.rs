//! Tables that come by columns, of files or of programs: the same meaning as a table in CSV.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use abbe_core::{
    Cell, Column, ColumnCells, ColumnHeader, Dataset, Error, Field, LabelText, Quantity, Result, RowOrigin, Values,
};

use crate::empty_column;
use crate::layout::{Layout, Unit};
use crate::number::{help_for, number_held, number_of, shown};
use crate::parse::LONGEST_CELL;

/// A column of the data set, and where it stands in the table.
struct Taken {
    header: ColumnHeader,
    field: usize,
    unit: Option<Unit>,
    /// From the unit of the header to the one used in memory.
    factor: f64,
}

impl Taken {
    fn new(header: ColumnHeader, field: usize, unit: Option<Unit>) -> Self {
        let (.., factor) = Quantity::of_column(&header.header);
        Self { header, field, unit, factor }
    }
}

/// The columns that a layout takes of a table: `columns` if it has some, else all.
pub struct NamedColumns {
    path: PathBuf,
    taken: Vec<Taken>,
}

impl NamedColumns {
    /// Fails for names that are missing or there twice, and for units that are not known or contradict a name.
    pub fn new(path: &Path, fields: &[Field], layout: &Layout) -> Result<Self> {
        let wrong = |error: Error| error.in_file(path);
        if let Some(place) = fields.iter().position(|field| field.name.len() > LONGEST_CELL) {
            let (number, length) = (place + 1, fields[place].name.len().div_ceil(1024));
            let message =
                format!("the name of column {number} has {length} KiB; at most {} are read", LONGEST_CELL >> 10);
            return Err(wrong(Error::usage(message).help("is it a table of measurements?")));
        }
        let mut taken: Vec<Taken> = Vec::new();
        match &layout.columns {
            Some(columns) => {
                for (name, source) in columns {
                    let field = place_of(&source.column, fields).map_err(wrong)?;
                    let header = ColumnHeader::parse(name);
                    let unit = unit_of(&header, source.unit, &fields[field]).map_err(wrong)?;
                    taken.push(Taken::new(header, field, unit));
                }
            }
            None => {
                for (index, field) in fields.iter().enumerate() {
                    let (header, unit) = named(field).map_err(wrong)?;
                    taken.push(Taken::new(header, index, unit));
                }
                check_names(&taken).map_err(wrong)?;
            }
        }
        if taken.is_empty() {
            return Err(wrong(Error::usage("there are no columns").help("a table of measurements was expected")));
        }
        Ok(Self { path: path.to_owned(), taken })
    }

    /// The columns of the data set.
    pub fn headers(&self) -> Vec<ColumnHeader> {
        self.taken.iter().map(|column| column.header.clone()).collect()
    }

    /// The columns in the table, by their indices, in the order of [`NamedColumns::headers`].
    pub fn fields(&self) -> Vec<usize> {
        self.taken.iter().map(|column| column.field).collect()
    }

    /// The data set without its rows.
    pub fn without_rows(&self) -> Dataset {
        let columns = self.headers().into_iter().map(empty_column).collect();
        Dataset { columns, files: vec![self.path.clone()], ..Dataset::default() }
    }
}

/// The header of a column that is taken as the file names it, and the unit of its numbers if that is another one.
fn named(field: &Field) -> Result<(ColumnHeader, Option<Unit>)> {
    let name = field.name.trim();
    let header = ColumnHeader::parse(name);
    let Some(symbol) = stated(field) else { return Ok((header, None)) };
    // A name may end in its unit: `scale_um_per_m` is a ratio as `dir_X` is, which has none.
    if header.name != name || !matches!(header.quantity, Quantity::Label | Quantity::Ratio) {
        let unit = unit_of(&header, None, field)?;
        return Ok((header, unit));
    }
    let with_suffix = ColumnHeader::parse(&format!("{name}_{}", as_suffix(symbol)));
    if with_suffix.name == name && with_suffix.quantity != Quantity::Label {
        return Ok((with_suffix, None));
    }
    let unit = Unit::named(symbol).ok_or_else(|| unknown(name, symbol))?;
    let header = ColumnHeader::parse(&format!("{name}{}", unit.quantity().usual_suffix()));
    match header.quantity == unit.quantity() {
        true => Ok((header, (symbol != "1").then_some(unit))),
        // A label has no unit, and is none of these numbers.
        false if symbol == "1" => Ok((header, None)),
        false => {
            Err(Error::usage(format!("`{name}` is in `{symbol}`, and its name is not one of a number without a unit"))
                .help("name it under `columns`, with the unit that it has in the data set"))
        }
    }
}

/// The unit of the numbers of a column that has a unit in the data set, if it is another one.
fn unit_of(header: &ColumnHeader, declared: Option<Unit>, field: &Field) -> Result<Option<Unit>> {
    let Some(symbol) = stated(field) else { return Ok(declared) };
    let suffix = header.header.strip_prefix(&header.name).unwrap_or_default().trim_start_matches('_');
    let is_that_of_the_name = as_suffix(symbol) == suffix;
    let of_file = Unit::named(symbol).or_else(|| Unit::named(as_suffix(symbol).as_str()));
    if header.quantity == Quantity::Label && symbol == "1" {
        return Ok(None);
    }
    match (declared, of_file) {
        (None, _) if is_that_of_the_name => Ok(None),
        (None, Some(unit)) if unit.quantity() == header.quantity => match header.header == field.name.trim() {
            true => Err(contradiction(field, symbol)),
            // The unit in the name is that of the data set: the file says in what its numbers are.
            false => Ok(Some(unit)),
        },
        (None, Some(_)) => Err(contradiction_of(&header.header, field, symbol)),
        (None, None) => Err(unknown(&field.name, symbol)),
        (Some(declared), Some(unit)) if declared.is_same(unit) => Ok(Some(declared)),
        (Some(declared), _) => Err(Error::usage(format!(
            "the table says that `{}` is in `{symbol}`, `columns` says `{}`",
            shown(&field.name),
            declared.symbol()
        ))
        .help("leave `unit` out: the table has it")),
    }
}

/// The unit that a file states for a column.
fn stated(field: &Field) -> Option<&str> {
    field.unit.as_deref().map(str::trim).filter(|unit| !unit.is_empty())
}

/// A unit as the suffix of a name: `um_per_m` of `µm/m`.
fn as_suffix(symbol: &str) -> String {
    match symbol {
        "°" => "deg".to_owned(),
        "°C" => "degC".to_owned(),
        "1/K" => "per_K".to_owned(),
        "1/min" => "rpm".to_owned(),
        _ => symbol.replace('µ', "u").replace('/', "_per_"),
    }
}

fn unknown(name: &str, symbol: &str) -> Error {
    let message = format!("the table says that `{}` is in `{}`, which is no known unit", shown(name), shown(symbol));
    Error::usage(message).help(format!("known are {}, 1/K", Unit::symbols()))
}

fn contradiction(field: &Field, symbol: &str) -> Error {
    Error::usage(format!(
        "the table says that `{}` is in `{symbol}`, and its name says another unit",
        shown(&field.name)
    ))
    .help("correct it: one of them is wrong")
}

fn contradiction_of(header: &str, field: &Field, symbol: &str) -> Error {
    Error::usage(format!(
        "the table says that `{}` is in `{symbol}`, which is no unit of `{header}`",
        shown(&field.name)
    ))
    .help("correct the name under `columns`, or the unit")
}

/// The place of a column by its name.
fn place_of(name: &str, fields: &[Field]) -> Result<usize> {
    let mut places = (0..fields.len()).filter(|&place| fields[place].name.trim() == name.trim());
    match (places.next(), places.next()) {
        (Some(place), None) => Ok(place),
        (Some(_), Some(_)) => {
            Err(Error::usage(format!("there are two columns `{}`", shown(name))).help("give one of them another name"))
        }
        _ => {
            let named: Vec<String> = fields.iter().map(|field| format!("`{}`", shown(&field.name))).collect();
            let message = format!("there is no column `{}`; the columns are {}", shown(name), named.join(", "));
            Err(Error::usage(message).suggest(name, fields.iter().map(|field| field.name.as_str())))
        }
    }
}

fn check_names(taken: &[Taken]) -> Result<()> {
    let mut names: HashMap<&str, &str> = HashMap::new();
    for Taken { header, .. } in taken {
        if header.name.is_empty() {
            return Err(Error::usage("a column has no name").help("give it one, or leave it out by `columns`"));
        }
        if let Some(twin) = names.insert(&header.name, &header.header) {
            let message = match twin == header.header {
                true => format!("there are two columns `{twin}`"),
                false => format!("the columns `{twin}` and `{}` are both named `{}`", header.header, header.name),
            };
            return Err(Error::usage(message).help("give one of them another name"));
        }
    }
    Ok(())
}

/// A data set that grows by rows, some at a time: those of a table, or of a part of it.
pub struct DataOfColumns<'a> {
    named: NamedColumns,
    layout: &'a Layout,
    columns: Vec<Column>,
    origins: Vec<RowOrigin>,
    /// Rows of the table before its own.
    before: usize,
    /// Rows of the table up to its last one.
    rows: usize,
    /// Bytes of the content, and the most that there may be.
    content: u64,
    most: u64,
    numbers: Vec<f64>,
}

impl<'a> DataOfColumns<'a> {
    /// Without rows yet. `most` is the number of bytes that the content may have: 8 for each cell, and those of texts.
    pub fn new(named: NamedColumns, layout: &'a Layout, most: u64) -> Self {
        let columns = named.headers().into_iter().map(empty_column).collect();
        Self { named, layout, columns, origins: Vec::new(), before: 0, rows: 0, content: 0, most, numbers: Vec::new() }
    }

    /// The same of a part of the table, which begins after so many rows.
    pub fn after(self, before: usize) -> Self {
        Self { before, rows: before, ..self }
    }

    /// Adds rows: the cells of each column, in the order of [`NamedColumns::headers`].
    ///
    /// Fails as reading the same table in CSV does, with the number of the row.
    pub fn add(&mut self, rows: usize, cells: &[&dyn ColumnCells]) -> Result<()> {
        self.origins.reserve(rows);
        for column in &mut self.columns {
            match &mut column.values {
                Values::Numbers(numbers) => numbers.reserve(rows),
                Values::Labels(labels) => labels.reserve(rows),
            }
        }
        for row in 0..rows {
            self.rows += 1;
            self.add_row(row, cells).map_err(|error| {
                let origin = RowOrigin { file: 0, line: 0, row: self.rows };
                origin.blame(error, &self.named.path)
            })?;
        }
        Ok(())
    }

    fn add_row(&mut self, row: usize, cells: &[&dyn ColumnCells]) -> Result<()> {
        self.numbers.clear();
        for (taken, cells) in self.named.taken.iter().zip(cells) {
            if taken.header.quantity == Quantity::Label {
                continue;
            }
            let cell = cells.cell(row);
            if self.layout.no_data.iter().any(|mark| is_marked(&cell, mark)) {
                return Ok(());
            }
            self.numbers.push(number(taken, &cell, self.layout)?);
        }
        let mut number = self.numbers.iter();
        for ((column, taken), cells) in self.columns.iter_mut().zip(&self.named.taken).zip(cells) {
            self.content += 8;
            match &mut column.values {
                Values::Numbers(numbers) => numbers.extend(number.next()),
                Values::Labels(labels) => {
                    let label = label(&taken.header.header, cells.cell(row))?;
                    self.content += label.len() as u64;
                    labels.push(label);
                }
            }
        }
        if self.content > self.most {
            let message = format!(
                "the content has more than {} MiB, the most that is read of a file of its size",
                self.most >> 20
            );
            return Err(Error::data(message).help("is it a table of measurements? One by one they take more room"));
        }
        self.origins.push(RowOrigin { file: 0, line: 0, row: self.rows });
        Ok(())
    }

    /// The data set, and the number of rows that are left out because a number was not measured. None may be left.
    pub fn finish_part(self) -> (Dataset, usize) {
        let left_out = self.rows - self.before - self.origins.len();
        let files = vec![self.named.path];
        (Dataset { columns: self.columns, origins: self.origins, files, ..Dataset::default() }, left_out)
    }

    /// The same. Fails if no row is left.
    pub fn finish(self) -> Result<(Dataset, usize)> {
        if self.origins.is_empty() {
            let (message, help) = match self.rows - self.before {
                0 => ("the table has no data rows", "one with measurements was expected"),
                _ => ("all rows of the table hold a mark of `no_data`", "`no_data` may list what is a number"),
            };
            return Err(Error::data(message).in_file(&self.named.path).help(help));
        }
        Ok(self.finish_part())
    }
}

/// Whether a cell holds a mark of a number that was not measured.
fn is_marked(cell: &Cell<'_>, mark: &str) -> bool {
    let is = |number: f64| mark.parse::<f64>().is_ok_and(|mark| mark == number || mark.is_nan() && number.is_nan());
    match cell {
        Cell::Missing => mark.is_empty(),
        Cell::Number(number) => is(*number),
        Cell::Whole(number) => is(*number as f64),
        Cell::Text(text) => text.trim() == mark,
    }
}

fn number(taken: &Taken, cell: &Cell<'_>, layout: &Layout) -> Result<f64> {
    let header = &taken.header.header;
    let of_text = |text: &str| {
        number_of(header, text, taken.unit, layout).map_err(|message| match help_for(header, text, layout) {
            Some(help) => Error::data(message).help(help.replace("`ingest: csv`", "`ingest`")),
            None => Error::data(message),
        })
    };
    let held = |number| number_held(header, (taken.header.quantity, taken.factor), number, taken.unit);
    match cell {
        Cell::Missing => of_text(""),
        Cell::Number(number) => held(*number).map_err(|message| help_held(message, *number)),
        Cell::Whole(number) => held(*number as f64).map_err(Error::data),
        Cell::Text(text) => of_text(text),
    }
}

fn help_held(message: String, number: f64) -> Error {
    let error = Error::data(message);
    match number.is_nan() {
        true => error.help("write `no_data: [nan]` where it is read to leave such rows out"),
        false => error.help("`no_data` lists what stands for a number that was not measured"),
    }
}

fn label(header: &str, cell: Cell<'_>) -> Result<LabelText> {
    let text = match cell {
        Cell::Missing => LabelText::default(),
        Cell::Number(number) => number.to_string().into(),
        Cell::Whole(number) => number.to_string().into(),
        Cell::Text(text) => text.trim().into(),
    };
    if text.len() > LONGEST_CELL {
        let length = text.len().div_ceil(1024);
        return Err(Error::data(format!("`{header}` has {length} KiB; at most {} are read", LONGEST_CELL >> 10)));
    }
    if text.contains(['\n', '\r', '\0']) {
        return Err(Error::data(format!(
            "`{header}` is `{}`, which has several lines",
            shown(&text.replace(['\n', '\r', '\0'], " "))
        ))
        .help("a label has one line"));
    }
    Ok(text)
}

#[cfg(test)]
mod tests;
