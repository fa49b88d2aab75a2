//! Lists of numbers that are used again: to make room for derivatives anew for every call takes longer than to fill it.

use std::sync::{Mutex, PoisonError};

use abbe_core::Poses;

/// Poses that nobody uses at the moment, one for each thread that asked at once.
#[derive(Default)]
pub(crate) struct Spare(Mutex<Vec<Poses>>);

impl Spare {
    /// Poses with any content.
    pub fn take(&self) -> Poses {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    /// Keeps poses for the next one.
    pub fn give_back(&self, poses: Poses) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(poses);
    }
}
