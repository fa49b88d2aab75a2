//! What people read on a terminal.

use std::io::{self, Write};

use crate::failure::readable;

/// Text for people on standard error. Who has closed it, or has no room for it, gets the status.
pub fn tell(text: &str) {
    let _ = io::stderr().lock().write_all(text.as_bytes());
}

/// A log without what a terminal would obey, and without endless words; every write is a whole line. If it cannot be written the work
/// goes on.
pub struct Harmless<W>(pub W);

impl<W: Write> Write for Harmless<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        let mut shown = readable(&text);
        if text.ends_with('\n') && !shown.ends_with('\n') {
            shown.push('\n');
        }
        let _ = self.0.write_all(shown.as_bytes());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let _ = self.0.flush();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_a_log_have_an_end() {
        let shown = |line: &str| {
            let mut written = Vec::new();
            Harmless(&mut written).write_all(line.as_bytes()).unwrap();
            String::from_utf8(written).unwrap()
        };
        assert_eq!(shown(" WARN no row has 12\n"), " WARN no row has 12\n");
        assert_eq!(
            shown(&format!(" WARN no row has {}\n", "9".repeat(1_000))),
            format!(" WARN no row has {}...\n", "9".repeat(300))
        );
        let many = shown(&format!(" WARN {}\n", "word ".repeat(100_000)));
        assert!(many.len() < 21_000 && many.ends_with(" ...\n"), "{}", many.len());
    }
}
