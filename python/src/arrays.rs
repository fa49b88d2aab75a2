//! Arrays of numbers by the buffer protocol, as those of NumPy: cells are read where they lie, many at a time, so that
//! there is no copy of the whole.

use std::sync::{Mutex, PoisonError};

use abbe_core::{Cell, ColumnCells};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyMemoryView, PySlice};

/// How many cells are read at once: 512 KiB of `float64`.
const WINDOW: usize = 1 << 16;

/// The number that bytes are.
type Read = fn(&[u8]) -> Cell<'static>;

/// The cells of an array of one dimension. The array cannot change its length while this is there.
pub struct Numbers {
    view: Py<PyMemoryView>,
    rows: usize,
    /// Bytes of a number.
    size: usize,
    read: Read,
    window: Mutex<Window>,
}

/// Cells that were read last.
#[derive(Default)]
struct Window {
    /// Row of the first.
    first: usize,
    bytes: Vec<u8>,
}

impl Numbers {
    /// The cells of an array; none if the object is no array of numbers of this processor, or has other dimensions.
    pub fn of(value: &Bound<'_, PyAny>) -> PyResult<Option<Self>> {
        // An array with a mask lends its numbers without it.
        if value.hasattr("mask")? {
            return Ok(None);
        }
        let Ok(view) = PyMemoryView::from(value) else { return Ok(None) };
        let format: String = view.getattr("format")?.extract()?;
        let (dimensions, size): (usize, usize) =
            (view.getattr("ndim")?.extract()?, view.getattr("itemsize")?.extract()?);
        let Some(read) = read_of(&format, size).filter(|_| dimensions == 1) else { return Ok(None) };
        let rows = view.len()?;
        Ok(Some(Self { view: view.unbind(), rows, size, read, window: Mutex::default() }))
    }

    /// Number of cells.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The bytes of the cells that begin at a row.
    fn bytes(&self, first: usize) -> PyResult<Vec<u8>> {
        Python::attach(|py| {
            let place = |row: usize| isize::try_from(row.min(self.rows));
            let rows = PySlice::new(py, place(first)?, place(first + WINDOW)?, 1);
            let bytes = self.view.bind(py).get_item(rows)?.call_method0("tobytes")?;
            Ok(bytes.cast::<PyBytes>()?.as_bytes().to_vec())
        })
    }
}

impl ColumnCells for Numbers {
    fn cell(&self, row: usize) -> Cell<'_> {
        let mut window = self.window.lock().unwrap_or_else(PoisonError::into_inner);
        let is_there =
            |window: &Window| row >= window.first && (row - window.first + 1) * self.size <= window.bytes.len();
        if !is_there(&window) {
            let first = row - row % WINDOW;
            match self.bytes(first) {
                Ok(bytes) => *window = Window { first, bytes },
                // Such as memory that is used up: no number, so that whoever reads it says so.
                Err(error) => return Cell::Text(format!("not readable: {error}").into()),
            }
        }
        let start = (row - window.first) * self.size;
        window.bytes.get(start..start + self.size).map_or(Cell::Missing, self.read)
    }
}

/// Reads a number of this type from its bytes.
macro_rules! read {
    ($number:ty, $cell:ident) => {
        |bytes: &[u8]| {
            let number = bytes.first_chunk().map(|bytes| <$number>::from_ne_bytes(*bytes));
            number.map_or(Cell::Missing, |number| Cell::$cell(number.into()))
        }
    };
}

/// How a number is read, by the letter that the module `struct` of Python has for it, and by its size.
fn read_of(format: &str, size: usize) -> Option<Read> {
    let own = if cfg!(target_endian = "little") { '<' } else { '>' };
    Some(match (format.strip_prefix(['@', '=', own]).unwrap_or(format), size) {
        ("d", 8) => read!(f64, Number),
        ("f", 4) => read!(f32, Number),
        ("b", 1) => read!(i8, Whole),
        ("B", 1) => read!(u8, Whole),
        ("h", 2) => read!(i16, Whole),
        ("H", 2) => read!(u16, Whole),
        ("i" | "l", 4) => read!(i32, Whole),
        ("I" | "L", 4) => read!(u32, Whole),
        ("q" | "l", 8) => read!(i64, Whole),
        ("Q" | "L", 8) => read!(u64, Whole),
        _ => return None,
    })
}
