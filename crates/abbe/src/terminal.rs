//! What people read on a terminal.

use std::io::{self, Write};

use abbe_core::harmless;

/// Text for people on standard error. Who has closed it, or has no room for it, gets the status.
pub fn tell(text: &str) {
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// A log without what a terminal would obey; every write is a whole line. If it cannot be written the work goes on.
pub struct Harmless<W>(pub W);

impl<W: Write> Write for Harmless<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let _ = self.0.write_all(harmless(&String::from_utf8_lossy(bytes)).as_bytes());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let _ = self.0.flush();
        Ok(())
    }
}
