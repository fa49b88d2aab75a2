//! Identities: which error is the same in two estimates.
//!
//! All estimates that use the same bar, ball, stylus, sensor or certificate share its error. Two inputs with one identity are
//! one quantity. It is counted once in an estimate that uses it twice, and it correlates estimates of different days.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// The statement of the value of a known input. It identifies the input.
///
/// Without a declared `id` the identity of the input is a hash of this statement.
///
/// ```
/// use abbe_results::Certificate;
/// let bar = |length: f64| Certificate::new("length", format!("bar 7: {length} mm, u = 0.0004 mm"));
/// assert_eq!(bar(500.0012).identity(), bar(500.0012).identity());
/// assert_ne!(bar(500.0012).identity(), bar(500.0013).identity());
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Certificate {
    /// Name of the quantity on this certificate, the same wherever the certificate is used: `length`, `point[3].x`.
    pub quantity: String,
    /// Content of the certificate: labels, values, units, uncertainties.
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
        // Half of the digest (128 bits) is enough to distinguish all certificates.
        let digest: String = digest.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
        format!("sha256:{digest}/{}", self.quantity)
    }

    /// The identity of this quantity of an object with a declared id: `bar 0815/length`.
    pub fn declared_identity(&self, id: &str) -> String {
        format!("{id}/{}", self.quantity)
    }
}
