//! Detects a library that ends the program: this is an error, and not the end of the work.
#![allow(unsafe_code, reason = "asks the C library to be told of the end; every block says why it is sound")]

use std::ffi::c_int;
use std::io::Write as _;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

unsafe extern "C" {
    fn atexit(at_exit: extern "C" fn()) -> c_int;
    fn _exit(status: c_int) -> !;
}

static EXPECTED: AtomicBool = AtomicBool::new(false);

/// Detects a library that calls `exit`: if the process ends by `exit` without a call of [`expect_exit`] before, it writes a
/// message and ends with the status 1.
///
/// This is for programs whose status shows whether they did their work. `_exit` and signals are not detected.
pub fn guard_exit() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: the function may be called with any function of this type; if there is no room for it, nothing is guarded.
        unsafe { atexit(at_exit) };
    });
}

/// The program itself ends the process: the end is no error of a library.
pub fn expect_exit() {
    EXPECTED.store(true, Ordering::SeqCst);
}

extern "C" fn at_exit() {
    if !EXPECTED.load(Ordering::SeqCst) {
        // A closed output changes nothing.
        let _ = writeln!(std::io::stderr(), "a plugin library ended the program before its work was done");
        // SAFETY: ends the process at once; nothing runs after it.
        unsafe { _exit(1) }
    }
}
