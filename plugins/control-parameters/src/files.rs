//! Numbers as files have them.

use abbe_core::ExportedFile;

/// A number with so many decimals, as it is read back from a file; zero has no sign.
pub fn rounded(value: f64, decimals: i32) -> f64 {
    let factor = 10_f64.powi(decimals);
    (value * factor).round() / factor + 0.0
}

/// A file with this text.
pub fn file(name: &str, text: String) -> ExportedFile {
    ExportedFile { name: name.to_owned(), content: text.into_bytes() }
}
