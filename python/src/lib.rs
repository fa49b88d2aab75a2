//! The Python package `abbe`: the module `abbe._abbe`, on which the classes of `python/abbe` stand.
//!
//! Nothing is computed here: recipes are run by `abbe-engine`, and results are those of the command line. While work
//! is done the lock of the interpreter is released.

mod arrays;
mod artefact;
mod calibration;
mod columns;
mod failure;
mod problem;
mod recipe;
mod run;
mod tables;
mod told;
mod work;

// Naming the bundle links the plugins of the stock program.
use abbe_bundle as _;

/// The part of the package `abbe` that is written in Rust. Use `abbe` instead: names here may change.
#[pyo3::pymodule(name = "_abbe")]
mod module {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::calibration::{Calibration, read_calibration};
    #[pymodule_export]
    use crate::columns::Columns;
    #[pymodule_export]
    use crate::problem::{Factor, Problem, combine, problems};
    #[pymodule_export]
    use crate::run::{Outcome, check, run};
    #[pymodule_export]
    use crate::told::take_warnings;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::told::listen();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
