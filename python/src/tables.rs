//! Tables that a user gives: by Arrow's interface (pandas, polars, pyarrow), as a structured array of NumPy, or as
//! columns by name.

use abbe_columnar::arrow::{fields, rows_of};
use abbe_core::{Cell, Error, Field, RowsOfTable, SharedCells, Table};
use arrow_array::RecordBatchReader;
use arrow_array::ffi_stream::RecordBatchStreamReader;
use arrow_pyarrow::FromPyArrow;
use pyo3::exceptions::PyImportError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat, PyInt, PyString};

use crate::arrays::Numbers;
use crate::failure::{OrRaise, raised};

/// What to give.
const EXPECTED: &str = "give a table of pandas, polars or pyarrow, a structured array of NumPy, or a dict of arrays: \
                        {\"X_mm\": [0.0, 100.0], \"feature\": [1, 1]}";

/// What pandas calls the numbers of its rows, which are no column of a measurement.
const ROW_NUMBERS: &str = "__index_level_";

/// The table that an object of Python is.
pub fn table_of(value: &Bound<'_, PyAny>) -> PyResult<Table> {
    let py = value.py();
    if value.hasattr(intern!(py, "__arrow_c_stream__"))? {
        match of_arrow(value) {
            // pandas needs pyarrow for this.
            Err(error) if error.is_instance_of::<PyImportError>(py) => {}
            other => return other,
        }
    }
    let names = value.getattr("dtype").and_then(|kind| kind.getattr("names")).ok().filter(|names| !names.is_none());
    let names = match names {
        Some(names) => names,
        None => match value.call_method0("keys") {
            Ok(keys) => keys,
            Err(_) => {
                let found = value.get_type().name()?;
                let error = Error::data(format!("a table was expected, not {found}")).help(EXPECTED);
                return Err(raised(py, &error));
            }
        },
    };
    of_columns(value, &names)
}

/// The columns of these names.
fn of_columns(value: &Bound<'_, PyAny>, names: &Bound<'_, PyAny>) -> PyResult<Table> {
    let (mut fields, mut cells) = (Vec::new(), Vec::new());
    let mut rows = None;
    for name in names.try_iter()? {
        let name = name?;
        let field = Field { name: name.str()?.to_string_lossy().into_owned(), unit: None };
        let (length, column) = cells_of(&value.get_item(&name)?, &field.name)?;
        let expected = *rows.get_or_insert(length);
        if length != expected {
            let message = format!("the column `{}` has {length} rows; {expected} were expected", field.name);
            return Err(raised(value.py(), &Error::data(message).help("all columns of a table have the same length")));
        }
        fields.push(field);
        cells.push(column);
    }
    Ok(Table { fields, parts: vec![RowsOfTable { rows: rows.unwrap_or(0), cells }] })
}

/// A table by Arrow's interface: its cells stay where they are.
fn of_arrow(value: &Bound<'_, PyAny>) -> PyResult<Table> {
    let py = value.py();
    let reader = RecordBatchStreamReader::from_pyarrow_bound(value)?;
    let all = fields(&reader.schema());
    let places: Vec<usize> = (0..all.len()).filter(|place| !all[*place].name.starts_with(ROW_NUMBERS)).collect();
    let mut table = Table { fields: places.iter().map(|place| all[*place].clone()).collect(), parts: Vec::new() };
    for batch in reader {
        let batch = batch.map_err(|error| raised(py, &Error::data(format!("the table cannot be read: {error}"))))?;
        table.parts.push(rows_of(&batch, &places).or_raise(py)?);
    }
    Ok(table)
}

/// The cells of a column and their number: an array of numbers where it lies, else a copy of any sequence of numbers and
/// texts.
fn cells_of(value: &Bound<'_, PyAny>, name: &str) -> PyResult<(usize, SharedCells)> {
    // Columns of pandas, polars and pyarrow are arrays, too, or become some.
    let array = value.call_method0(intern!(value.py(), "to_numpy"));
    let value = array.as_ref().unwrap_or(value);
    if let Some(numbers) = Numbers::of(value)? {
        return Ok((numbers.rows(), Box::new(numbers)));
    }
    let py = value.py();
    let listed = if value.hasattr(intern!(py, "tolist"))? { value.call_method0("tolist")? } else { value.clone() };
    let wrong = |found: &str| {
        let error = Error::data(format!("the column `{name}` holds {found}; numbers or texts were expected"));
        raised(py, &error.help(EXPECTED))
    };
    if listed.is_instance_of::<PyString>() {
        return Err(wrong("one text"));
    }
    let mut all = Vec::new();
    for cell in listed.try_iter().map_err(|_| wrong("no list"))? {
        all.push(cell_of(&cell?).map_err(|found| wrong(&found))?);
    }
    Ok((all.len(), Box::new(all)))
}

/// The cell that an object is, or the name of its type.
fn cell_of(value: &Bound<'_, PyAny>) -> Result<Cell<'static>, String> {
    if value.is_none() {
        return Ok(Cell::Missing);
    }
    if let Ok(flag) = value.cast::<PyBool>() {
        return Ok(Cell::Text(if flag.is_true() { "true" } else { "false" }.into()));
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(Cell::Text(text.to_string_lossy().into_owned().into()));
    }
    if value.is_instance_of::<PyInt>() {
        return Ok(value.extract().map_or_else(|_| Cell::Text(value.to_string().into()), Cell::Whole));
    }
    let found = || value.get_type().name().map_or_else(|_| "something else".to_owned(), |name| name.to_string());
    // Numbers of NumPy are numbers, too.
    match value.is_instance_of::<PyFloat>() || value.hasattr("__float__").unwrap_or(false) {
        true => value.extract().map(Cell::Number).map_err(|_| found()),
        false => Err(found()),
    }
}
