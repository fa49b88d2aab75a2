//! A library that ends the program is told apart from an end that the program wants: it is no success.
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

/// From now on the status of the process is 1, with a message, if it ends by `exit` without [`expect_exit`] before: then a
/// library called `exit`.
///
/// For programs whose status tells whether they did their work. What ends without any last words (`_exit`, a signal) cannot be told.
pub fn guard_exit() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: the function may be called with any function of this type; if there is no room for it, nothing is guarded.
        unsafe { atexit(at_exit) };
    });
}

/// The program ends as it wants to.
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
