//! Identities: which error is the same in two estimates.
//!
//! Whoever uses a bar, a ball, a stylus, a sensor or a certificate shares its error. Two inputs with one identity are one
//! quantity: it is counted once in an estimate that uses it twice, and it correlates estimates of different days.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// What states the value of a known input, as far as it tells it from all others.
///
/// Without a declared `id` the identity is a hash of it.
///
/// ```
/// use abbe_core::Certificate;
/// let bar = |length: f64| Certificate::new("length", format!("bar 7: {length} mm, u = 0.0004 mm"));
/// assert_eq!(bar(500.0012).identity(), bar(500.0012).identity());
/// assert_ne!(bar(500.0012).identity(), bar(500.0013).identity());
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Certificate {
    /// What the input is on this certificate, called alike wherever the certificate is used: `length`, `point[3].x`.
    pub quantity: String,
    /// What the certificate says: labels, values, units, uncertainties.
    pub content: String,
}

impl Certificate {
    /// A quantity on a certificate.
    pub fn new(quantity: impl Into<String>, content: impl Into<String>) -> Self {
        Self { quantity: quantity.into(), content: content.into() }
    }

    /// The identity that follows from the content: the same text gives the same identity.
    pub fn identity(&self) -> String {
        let digest = Sha256::digest(self.content.as_bytes());
        // Half of the digest tells more certificates apart than will ever be written.
        let digest: String = digest.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
        format!("sha256:{digest}/{}", self.quantity)
    }

    /// The identity of this quantity of a thing that people gave a name: `bar 0815/length`.
    pub fn declared(&self, id: &str) -> String {
        format!("{id}/{}", self.quantity)
    }
}
