//! Hashes of contents.

use std::io::{self, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

/// SHA-256 of a content, 64 hexadecimal digits.
pub fn sha256(content: &[u8]) -> String {
    hexadecimal(Sha256::digest(content).as_slice())
}

/// Whether a text is such a hash.
pub fn is_sha256(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

/// SHA-256 of the content of a file.
pub fn sha256_of(file: &Path) -> io::Result<String> {
    let mut reader = abbe_files::open(file)?;
    let (mut digest, mut buffer) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match reader.read(&mut buffer)? {
            0 => return Ok(hexadecimal(digest.finalize().as_slice())),
            count => digest.update(&buffer[..count]),
        }
    }
}

/// Bytes as digits.
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
