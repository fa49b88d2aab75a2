//! Dynamic plugins: stages that a vendor ships as a library.
//!
//! - [`abi`] is the C interface between program and library.
//! - `sdk` (feature) is what a vendor's crate needs: the traits of Abbe and the macro `export!`.
//! - `load` and `isolated` (feature `host`) give the plugins of a library as records of the registry, like built-in ones; the
//!   latter runs them in processes of their own.
//!
//! **Architecture invariant:** this is the only crate with unsafe code, and every block says why it is sound. Everything from
//! the other side is checked here: other crates use a proxy like a built-in plugin.

pub mod abi;
mod border;
#[cfg(feature = "host")]
pub mod check;
#[cfg(feature = "host")]
mod exit;
mod float_control;
#[cfg(all(feature = "host", unix))]
mod isolation;
#[cfg(all(feature = "host", not(unix)))]
#[path = "no_isolation.rs"]
mod isolation;
#[cfg(feature = "host")]
mod loader;
#[cfg(feature = "host")]
pub mod messages;
mod peer;
mod proxy;
mod questions;
#[cfg(feature = "host")]
mod sandbox;
#[cfg(feature = "sdk")]
pub mod sdk;
mod served;
mod texts;
#[cfg(feature = "host")]
mod threads;
#[cfg(all(feature = "host", unix))]
#[doc(hidden)]
pub mod trials;

#[cfg(feature = "host")]
pub use exit::{expect_exit, guard_exit};
#[cfg(feature = "host")]
pub use isolation::{Limits, isolated, serve};
#[cfg(feature = "host")]
pub use loader::{Library, load};
#[cfg(feature = "host")]
pub use sandbox::{Allowance, MEMORY_LIMIT_MIB, missing};
