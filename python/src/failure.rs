//! Errors of the project as exceptions of Python: `abbe.RecipeError`, `abbe.DataError`, `KeyboardInterrupt`.

use abbe_core::{Class, Error, PathItem};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

/// The exception that an error is.
pub fn raised(py: Python<'_>, error: &Error) -> PyErr {
    match error.class {
        Class::Interrupted => PyKeyboardInterrupt::new_err(error.message.clone()),
        _ => exception(py, error).map_or_else(|other| other, PyErr::from_value),
    }
}

fn exception<'py>(py: Python<'py>, error: &Error) -> PyResult<Bound<'py, PyAny>> {
    let name = if error.class == Class::Use { "RecipeError" } else { "DataError" };
    let setting = PyList::empty(py);
    for item in &error.setting {
        match item {
            PathItem::Key(key) => setting.append(key)?,
            PathItem::Index(index) => setting.append(index)?,
        }
    }
    let place = error.place.as_ref();
    let details = PyDict::new(py);
    details.set_item("help", &error.help)?;
    details.set_item("file", place.map(|place| place.file.display().to_string()))?;
    details.set_item("line", place.and_then(|place| place.line))?;
    details.set_item("column", place.and_then(|place| place.column))?;
    details.set_item("stage", &error.stage)?;
    details.set_item("setting", setting)?;
    py.import("abbe._errors")?.getattr(name)?.call((&error.message,), Some(&details))
}

/// A result with the exception in the place of its error.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> OrRaise<T> for abbe_core::Result<T> {
    fn or_raise(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|error| raised(py, &error))
    }
}

/// An error of code in Python that stands in a recipe, as an error of the project.
pub fn of_python(py: Python<'_>, what: &str, error: &PyErr) -> Error {
    let place = error.traceback(py).and_then(|traceback| traceback.format().ok()).unwrap_or_default();
    let error = Error::data(format!("{what} failed in Python: {error}")).fatal();
    match place.trim().lines().rev().nth(1) {
        Some(line) => error.help(line.trim().to_owned()),
        None => error,
    }
}
