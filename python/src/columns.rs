//! Tables that results are: columns of numbers and texts, which other libraries take by Arrow's interface without a
//! copy.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::ffi_stream::FFI_ArrowArrayStream;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{Array, ArrayRef, Float64Array, Int64Array, RecordBatch, RecordBatchIterator, StringArray};
use arrow_schema::{ArrowError, DataType};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyCapsule};

/// Columns of one length.
#[pyclass(frozen, module = "abbe._abbe")]
pub struct Columns(RecordBatch);

/// Columns that are being collected.
#[derive(Default)]
pub struct Collected(Vec<(String, ArrayRef)>);

impl Collected {
    /// Adds numbers; NaN stays NaN.
    pub fn numbers(&mut self, name: impl Into<String>, numbers: Vec<f64>) {
        self.0.push((name.into(), Arc::new(Float64Array::from(numbers))));
    }

    /// Adds numbers of which some are not there.
    pub fn some_numbers(&mut self, name: impl Into<String>, numbers: Vec<Option<f64>>) {
        self.0.push((name.into(), Arc::new(Float64Array::from(numbers))));
    }

    /// Adds counts.
    pub fn counts(&mut self, name: impl Into<String>, counts: impl Iterator<Item = usize>) {
        let counts: Int64Array = counts.map(|count| i64::try_from(count).ok()).collect();
        self.0.push((name.into(), Arc::new(counts)));
    }

    /// Adds texts.
    pub fn texts<T: AsRef<str>>(&mut self, name: impl Into<String>, texts: impl Iterator<Item = Option<T>>) {
        self.0.push((name.into(), Arc::new(texts.collect::<StringArray>())));
    }

    /// The table.
    pub fn finish(self) -> PyResult<Columns> {
        RecordBatch::try_from_iter(self.0).map(Columns).map_err(wrong)
    }
}

fn wrong(error: ArrowError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

impl Columns {
    fn column(&self, name: &str) -> PyResult<&ArrayRef> {
        self.0.column_by_name(name).ok_or_else(|| {
            let names: Vec<String> = self.names();
            PyKeyError::new_err(format!("there is no column `{name}`; the columns are {}", names.join(", ")))
        })
    }
}

#[pymethods]
impl Columns {
    /// Names, in their order.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.0.schema_ref().fields().iter().map(|field| field.name().clone()).collect()
    }

    fn __len__(&self) -> usize {
        self.0.num_rows()
    }

    /// What a column holds: "float64", "int64" or "text".
    fn kind(&self, name: &str) -> PyResult<&'static str> {
        Ok(match self.column(name)?.data_type() {
            DataType::Float64 => "float64",
            DataType::Int64 => "int64",
            _ => "text",
        })
    }

    /// The bytes of a column of numbers; NaN where there is none.
    fn bytes<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyByteArray>> {
        let column = self.column(name)?;
        if let Some(numbers) = column.as_primitive_opt::<Float64Type>() {
            return match numbers.null_count() {
                0 => bytes_of(py, numbers.values()),
                _ => bytes_of(py, &numbers.iter().map(|number| number.unwrap_or(f64::NAN)).collect::<Vec<f64>>()),
            };
        }
        match column.as_primitive_opt::<Int64Type>() {
            Some(counts) => filled(py, counts.values().iter().map(|count| count.to_ne_bytes())),
            None => Err(PyValueError::new_err(format!("`{name}` holds texts"))),
        }
    }

    /// A column of texts; None where there is none.
    fn texts(&self, name: &str) -> PyResult<Vec<Option<String>>> {
        let column = self.column(name)?.as_string_opt::<i32>();
        let column = column.ok_or_else(|| PyValueError::new_err(format!("`{name}` holds numbers")))?;
        Ok(column.iter().map(|text| text.map(str::to_owned)).collect())
    }

    /// The table by Arrow's interface for Python.
    #[pyo3(signature = (requested_schema=None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // The interface allows to give the own types whatever is wished.
        drop(requested_schema);
        let batches = RecordBatchIterator::new([Ok(self.0.clone())], self.0.schema());
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(Box::new(batches)), c"arrow_array_stream")
    }
}

/// The bytes of numbers, which NumPy takes as an array that can be written.
pub fn bytes_of<'py>(py: Python<'py>, numbers: &[f64]) -> PyResult<Bound<'py, PyByteArray>> {
    filled(py, numbers.iter().map(|number| number.to_ne_bytes()))
}

fn filled<'py>(py: Python<'py>, numbers: impl ExactSizeIterator<Item = [u8; 8]>) -> PyResult<Bound<'py, PyByteArray>> {
    PyByteArray::new_with(py, numbers.len() * 8, |bytes| {
        bytes.as_chunks_mut().0.iter_mut().zip(numbers).for_each(|(place, number)| *place = number);
        Ok(())
    })
}
