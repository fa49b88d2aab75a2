//! What is told beside results: remarks of the engine become warnings of Python.

use std::io::{self, Write};
use std::sync::Mutex;

use pyo3::prelude::*;

static TOLD: Mutex<Vec<u8>> = Mutex::new(Vec::new());

/// Most bytes of remarks that wait to be taken.
const MOST: usize = 1 << 20;

struct Kept;

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Ok(mut told) = TOLD.lock()
            && told.len() < MOST
        {
            told.extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Keeps remarks from now on. Where a program listens already, that goes on instead.
pub fn listen() {
    let listener = tracing_subscriber::fmt()
        .with_writer(|| Kept)
        .with_max_level(tracing::Level::WARN)
        .without_time()
        .with_level(false)
        .with_target(false)
        .finish();
    let _ = tracing::subscriber::set_global_default(listener);
}

/// The remarks since the last call, one a text.
#[pyfunction]
pub fn take_warnings() -> Vec<String> {
    let told = TOLD.lock().map(|mut told| std::mem::take(&mut *told)).unwrap_or_default();
    String::from_utf8_lossy(&told).lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty()).collect()
}
