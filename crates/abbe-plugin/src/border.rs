//! The border in C: tables of functions for our objects, and objects for the tables of the other side.
#![allow(unsafe_code, reason = "the C ABI; every block says why it is sound")]

#[cfg(feature = "host")]
mod library;
mod ours;
mod theirs;

use crate::abi::AbbeText;
use crate::peer::Failure;

#[cfg(feature = "host")]
pub(crate) use library::{LibraryText, Record, read_library};
#[cfg(feature = "sdk")]
pub(crate) use ours::create_for;

/// Longest text that is accepted, bytes. A larger length is taken as an error of the other side.
const LONGEST: u64 = 1 << 32;

impl AbbeText {
    /// A text of ours, valid as long as `text` is.
    pub(crate) const fn of(text: &str) -> Self {
        Self { data: text.as_ptr().cast(), length: text.len() as u64 }
    }

    /// The text of the other side.
    ///
    /// # Safety
    /// `data` is null or the first of `length` readable bytes.
    pub(crate) unsafe fn read(self) -> Result<String, String> {
        if self.length == 0 {
            return Ok(String::new());
        }
        if self.data.is_null() {
            return Err("gave a null pointer for a text".to_owned());
        }
        if self.length > LONGEST {
            return Err(format!("gave a text of {} bytes", self.length));
        }
        // SAFETY: not null, and readable by the contract of this function.
        let bytes = unsafe { std::slice::from_raw_parts(self.data.cast::<u8>(), self.length as usize) };
        let text = std::str::from_utf8(bytes).map_err(|error| format!("gave a text that is not UTF-8: {error}"))?;
        Ok(text.to_owned())
    }
}

/// The slice of the other side; no elements may be a null pointer.
///
/// # Safety
/// `data` is null or the first of `count` readable elements, which nobody changes while the slice is used.
unsafe fn slice<'a, T>(data: *const T, count: u64) -> Result<&'a [T], Failure> {
    match (count, data.is_null() || !data.is_aligned()) {
        (0, _) => Ok(&[]),
        (_, true) => Err(Failure::of("the other side", "gave a null or misaligned pointer")),
        // SAFETY: not null, aligned, readable by the contract of this function.
        (_, false) => Ok(unsafe { std::slice::from_raw_parts(data, count as usize) }),
    }
}

/// As [`slice`], to be written.
///
/// # Safety
/// `data` is null or the first of `count` writable elements that nobody else uses meanwhile.
unsafe fn slice_mut<'a, T>(data: *mut T, count: u64) -> Result<&'a mut [T], Failure> {
    match (count, data.is_null() || !data.is_aligned()) {
        (0, _) => Ok(&mut []),
        (_, true) => Err(Failure::of("the other side", "gave a null or misaligned pointer")),
        // SAFETY: not null, aligned, writable and exclusive by the contract of this function.
        (_, false) => Ok(unsafe { std::slice::from_raw_parts_mut(data, count as usize) }),
    }
}
