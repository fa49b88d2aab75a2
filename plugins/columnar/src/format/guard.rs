//! Nothing that a file holds ends the program: a panic of a library is an error of the file.

use std::cell::Cell;
use std::fmt::Display;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::sync::Once;

use abbe_core::{Error, Result};

use super::Format;

thread_local! {
    /// Whether this thread reads a file, so that a panic is told as an error and not by its hook.
    static READS: Cell<bool> = const { Cell::new(false) };
}

/// Does the work; if it panics, the file is to blame.
pub fn guarded<T>(format: Format, path: &Path, work: impl FnOnce() -> Result<T>) -> Result<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let others = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !READS.get() {
                others(info);
            }
        }));
    });
    READS.set(true);
    let found = panic::catch_unwind(AssertUnwindSafe(work));
    READS.set(false);
    found.unwrap_or_else(|_| Err(broken(format, path, &"the library that reads it gave up")))
}

/// The error for a file that is none of its format, or a broken one.
pub fn broken(format: Format, path: &Path, why: &dyn Display) -> Error {
    let mut why = why.to_string();
    if let Some((end, _)) = why.char_indices().nth(LONGEST) {
        why.truncate(end);
    }
    Error::data(format!("the file cannot be read as {}: {why}", format.name()))
        .in_file(path)
        .help("write it again; `ingest: csv` reads tables of text")
}

/// Characters of a library's own words that are told.
const LONGEST: usize = 300;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_of_the_file() {
        let broken = guarded::<()>(Format::Parquet, Path::new("a.parquet"), || panic!("inside")).unwrap_err();
        assert!(
            broken.to_string().starts_with("a.parquet: the file cannot be read as Parquet: the library"),
            "{broken}"
        );
        assert_eq!(guarded(Format::Parquet, Path::new("a"), || Ok(1)).unwrap(), 1);
        assert!(panic::catch_unwind(|| panic!("outside")).is_err());
    }
}
