//! Tables that a user gives: by Arrow's interface (pandas, polars, pyarrow), as a structured array of NumPy, or as
//! columns by name.

use std::sync::Arc;

use abbe_core::{Cells, Error, Table, TableColumn};
use arrow_array::cast::AsArray;
use arrow_array::ffi_stream::RecordBatchStreamReader;
use arrow_array::types::{
    Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef, ArrowPrimitiveType};
use arrow_pyarrow::FromPyArrow;
use arrow_schema::DataType;
use pyo3::buffer::{Element, PyBuffer};
use pyo3::exceptions::PyImportError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat, PyInt, PyString};

use crate::failure::raised;

/// What to give.
const EXPECTED: &str = "give a table of pandas, polars or pyarrow, a structured array of NumPy, or a dict of arrays: \
                        {\"X_mm\": [0.0, 100.0], \"feature\": [1, 1]}";

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
    let mut columns = Vec::new();
    for name in names.try_iter()? {
        let name = name?;
        let cells = cells_of(&value.get_item(&name)?, &name.str()?.to_string_lossy())?;
        columns.push(TableColumn { name: name.str()?.to_string_lossy().into_owned(), parts: vec![cells] });
    }
    Ok(Table { columns })
}

fn of_arrow(value: &Bound<'_, PyAny>) -> PyResult<Table> {
    let py = value.py();
    let reader = RecordBatchStreamReader::from_pyarrow_bound(value)?;
    let names = arrow_array::RecordBatchReader::schema(&reader);
    let named = |field: &Arc<arrow_schema::Field>| TableColumn { name: field.name().clone(), parts: Vec::new() };
    let mut table = Table { columns: names.fields().iter().map(named).collect() };
    for batch in reader {
        let batch = batch.map_err(|error| raised(py, &Error::data(format!("the table cannot be read: {error}"))))?;
        for (column, array) in table.columns.iter_mut().zip(batch.columns()) {
            column.parts.push(of_array(array, &column.name).map_err(|error| raised(py, &error))?);
        }
    }
    Ok(table)
}

/// The cells of an array of Arrow; numbers of full width that are all there are not copied.
fn of_array(array: &ArrayRef, name: &str) -> Result<Cells, Error> {
    let has_all = array.null_count() == 0;
    Ok(match array.data_type() {
        DataType::Float64 if has_all => Cells::Numbers(Arc::new(array.as_primitive::<Float64Type>().values().clone())),
        DataType::Float64 => numbers::<Float64Type>(array, |number| number),
        DataType::Float32 => numbers::<Float32Type>(array, f64::from),
        DataType::Int8 => whole::<Int8Type>(array, i64::from),
        DataType::Int16 => whole::<Int16Type>(array, i64::from),
        DataType::Int32 => whole::<Int32Type>(array, i64::from),
        DataType::Int64 => whole::<Int64Type>(array, |number| number),
        DataType::UInt8 => whole::<UInt8Type>(array, i64::from),
        DataType::UInt16 => whole::<UInt16Type>(array, i64::from),
        DataType::UInt32 => whole::<UInt32Type>(array, i64::from),
        DataType::UInt64 => Cells::Texts(Arc::new(
            array.as_primitive::<UInt64Type>().iter().map(|it| it.map(|it| it.to_string())).collect(),
        )),
        DataType::Utf8 => texts(array.as_string::<i32>().iter()),
        DataType::LargeUtf8 => texts(array.as_string::<i64>().iter()),
        DataType::Utf8View => texts(array.as_string_view().iter()),
        DataType::Boolean => texts(array.as_boolean().iter().map(|it| it.map(|it| if it { "true" } else { "false" }))),
        DataType::Null => Cells::Texts(Arc::new(vec![None; array.len()])),
        DataType::Dictionary(..) => {
            let dictionary = array.as_any_dictionary();
            let values = of_array(dictionary.values(), name)?;
            if dictionary.values().is_empty() {
                return Ok(Cells::Texts(Arc::new(vec![None; array.len()])));
            }
            let keys = dictionary.normalized_keys();
            let text = |row: usize| if array.is_null(row) { None } else { text(&values, keys[row]) };
            Cells::Texts(Arc::new((0..array.len()).map(text).collect()))
        }
        other => {
            let message = format!("the column `{name}` has the type {other}; numbers or texts were expected");
            return Err(Error::data(message).help("give it as numbers (a time in seconds), or leave it out"));
        }
    })
}

fn numbers<T: ArrowPrimitiveType>(array: &ArrayRef, number: impl Fn(T::Native) -> f64) -> Cells {
    let all = array.as_primitive::<T>().iter().map(|it| it.map_or(f64::NAN, &number));
    Cells::Numbers(Arc::new(all.collect::<Vec<f64>>()))
}

fn whole<T: ArrowPrimitiveType>(array: &ArrayRef, number: impl Fn(T::Native) -> i64) -> Cells {
    let all = array.as_primitive::<T>().iter().map(|it| it.map(&number));
    match array.null_count() {
        0 => Cells::Whole(Arc::new(all.flatten().collect())),
        _ => Cells::Texts(Arc::new(all.map(|it| it.map(|it| it.to_string())).collect())),
    }
}

fn texts<'a>(all: impl Iterator<Item = Option<&'a str>>) -> Cells {
    Cells::Texts(Arc::new(all.map(|it| it.map(str::to_owned)).collect()))
}

fn text(cells: &Cells, index: usize) -> Option<String> {
    match cells {
        Cells::Numbers(numbers) => Some((**numbers).as_ref()[index]).filter(|it| !it.is_nan()).map(|it| it.to_string()),
        Cells::Whole(numbers) => Some(numbers[index].to_string()),
        Cells::Texts(texts) => texts[index].clone(),
    }
}

/// The cells of a column: an array of numbers by the buffer protocol, else any sequence of numbers and texts.
fn cells_of(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Cells> {
    if let Some(numbers) = buffer::<f64>(value)? {
        return Ok(Cells::Numbers(Arc::new(numbers)));
    }
    if let Some(numbers) = buffer::<f32>(value)? {
        return Ok(Cells::Numbers(Arc::new(numbers.into_iter().map(f64::from).collect::<Vec<f64>>())));
    }
    if let Some(numbers) = buffer::<i64>(value)? {
        return Ok(Cells::Whole(Arc::new(numbers)));
    }
    if let Some(numbers) = buffer::<i32>(value)? {
        return Ok(Cells::Whole(Arc::new(numbers.into_iter().map(i64::from).collect())));
    }
    let py = value.py();
    let listed = if value.hasattr(intern!(py, "tolist"))? { value.call_method0("tolist")? } else { value.clone() };
    let mut all = Vec::new();
    let wrong = |found: &str| {
        let error = Error::data(format!("the column `{name}` holds {found}; numbers or texts were expected"));
        raised(py, &error.help(EXPECTED))
    };
    if listed.is_instance_of::<PyString>() {
        return Err(wrong("one text"));
    }
    for cell in listed.try_iter().map_err(|_| wrong("no list"))? {
        all.push(cell_of(&cell?).map_err(|found| wrong(&found))?);
    }
    Ok(of_cells(all))
}

/// The numbers of a one-dimensional array of this type; none if it is something else.
fn buffer<T: Element>(value: &Bound<'_, PyAny>) -> PyResult<Option<Vec<T>>> {
    match PyBuffer::<T>::get(value) {
        Ok(buffer) if buffer.dimensions() == 1 => buffer.to_vec(value.py()).map(Some),
        _ => Ok(None),
    }
}

/// A cell of a sequence.
enum Cell {
    Missing,
    Number(f64),
    Whole(i64),
    Text(String),
}

fn cell_of(value: &Bound<'_, PyAny>) -> Result<Cell, String> {
    let text = |text: &str| Cell::Text(text.to_owned());
    if value.is_none() {
        return Ok(Cell::Missing);
    }
    if let Ok(flag) = value.cast::<PyBool>() {
        return Ok(text(if flag.is_true() { "true" } else { "false" }));
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(Cell::Text(text.to_string_lossy().into_owned()));
    }
    if value.is_instance_of::<PyInt>() {
        return Ok(value.extract().map_or_else(|_| text(&value.to_string()), Cell::Whole));
    }
    let found = || value.get_type().name().map_or_else(|_| "something else".to_owned(), |name| name.to_string());
    // Numbers of NumPy are numbers, too.
    match value.is_instance_of::<PyFloat>() || value.hasattr("__float__").unwrap_or(false) {
        true => value.extract::<f64>().map(Cell::Number).map_err(|_| found()),
        false => Err(found()),
    }
}

/// Numbers if all cells are, else texts.
fn of_cells(all: Vec<Cell>) -> Cells {
    if all.iter().all(|cell| matches!(cell, Cell::Whole(_))) {
        let whole = |cell| if let Cell::Whole(number) = cell { number } else { 0 };
        return Cells::Whole(Arc::new(all.into_iter().map(whole).collect()));
    }
    if all.iter().all(|cell| matches!(cell, Cell::Number(_) | Cell::Missing)) {
        let number = |cell| if let Cell::Number(number) = cell { number } else { f64::NAN };
        return Cells::Numbers(Arc::new(all.into_iter().map(number).collect::<Vec<f64>>()));
    }
    let text = |cell| match cell {
        Cell::Missing => None,
        Cell::Number(number) => Some(number).filter(|number| !number.is_nan()).map(|number| number.to_string()),
        Cell::Whole(number) => Some(number.to_string()),
        Cell::Text(text) => Some(text),
    };
    Cells::Texts(Arc::new(all.into_iter().map(text).collect()))
}
