//! What a vendor's crate needs: the traits and types of Abbe, and [`export!`](crate::export).
//!
//! A plugin that is loaded implements the same traits as one that is built in, and registers with the same record.
#![allow(unsafe_code, reason = "gives the library's table; every block says why it is sound")]

use std::sync::OnceLock;

pub use abbe_core::*;
pub use {nalgebra, schemars, serde, serde_json};

use crate::abi::*;
use crate::border::create_for;

/// The record of a plugin for the other side, and the plugin itself.
#[repr(C)]
struct Exported {
    // First, so that a pointer to it is a pointer to this.
    record: AbbePlugin,
    plugin: &'static Plugin,
}

/// The library's table and the data to which it points.
struct Library(AbbeLibrary);

// SAFETY: tables are constant once made, and what they point to lives for ever.
unsafe impl Send for Library {}
// SAFETY: as above.
unsafe impl Sync for Library {}

/// The log of the program; empty until the program gives it.
static LOG: OnceLock<unsafe extern "C" fn(u32, AbbeText)> = OnceLock::new();

/// Severity of a line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// An error.
    Error = 0,
    /// A warning.
    Warning = 1,
    /// Information about the work.
    Information = 2,
    /// Details for finding the cause of an error.
    Detail = 3,
}

/// Writes a line into the log of the program.
pub fn log(level: Level, text: &str) {
    if let Some(log) = LOG.get() {
        // SAFETY: the function of the host takes a text that lives through the call.
        unsafe { log(level as u32, AbbeText::of(text)) }
    }
}

/// A text that is never freed.
fn forever(text: String) -> AbbeText {
    AbbeText::of(Box::leak(text.into_boxed_str()))
}

unsafe extern "C" fn create(
    plugin: *const AbbePlugin,
    settings: AbbeText,
    base: AbbeText,
    reply: *const AbbeReply,
) -> u32 {
    // SAFETY: the host gives back one of the records that `library` made, each the first field of an `Exported`.
    let exported = unsafe { &*plugin.cast::<Exported>() };
    // SAFETY: texts and reply are valid during the call by the ABI.
    unsafe { create_for(exported.plugin, settings, base, reply) }
}

/// The table of this library: all plugins that are registered in it. Made once; for [`export!`](crate::export).
///
/// # Safety
/// `host` is null or what the ABI promises.
pub unsafe fn library(host: *const AbbeHost, name: &'static str, version: &'static str) -> *const AbbeLibrary {
    static LIBRARY: OnceLock<Library> = OnceLock::new();
    // SAFETY: null or a table that has at least the fields of version 1.0.
    if let Some(log) = unsafe { host.as_ref() }.and_then(|host| host.log) {
        let _ = LOG.set(log);
    }
    let library = LIBRARY.get_or_init(|| {
        let exported = inventory::iter::<Plugin>.into_iter().map(|plugin| {
            let record = AbbePlugin {
                size: size_of::<AbbePlugin>() as u64,
                kind: Kind::ALL.iter().position(|kind| *kind == plugin.kind()).unwrap_or_default() as u32,
                name: AbbeText::of(&plugin.name),
                about: AbbeText::of(&plugin.about),
                schema: forever(plugin.schema.get().to_string()),
                example: forever(plugin.example.get().to_string()),
                create: Some(create),
                reference: AbbeText::of(plugin.reference),
            };
            &raw const Box::leak(Box::new(Exported { record, plugin })).record
        });
        let plugins: &[*const AbbePlugin] = Vec::leak(exported.collect());
        Library(AbbeLibrary {
            abi_major: ABBE_ABI_MAJOR,
            abi_minor: ABBE_ABI_MINOR,
            size: size_of::<AbbeLibrary>() as u64,
            name: AbbeText::of(name),
            version: AbbeText::of(version),
            plugins: plugins.as_ptr(),
            plugin_count: plugins.len() as u64,
        })
    });
    &library.0
}

/// Exports the plugins of a `cdylib`: those in the parentheses, and all others that are registered in the library.
///
/// ```ignore
/// abbe_plugin::export!(Plugin::built_in("mine", "what it does", schema, example, Build::Model(Constructor::Static(build))));
/// ```
#[macro_export]
macro_rules! export {
    ($($plugin:expr),* $(,)?) => {
        $($crate::sdk::inventory::submit! { $plugin })*

        /// The table of this plugin library.
        ///
        /// # Safety
        /// `host` is null or what the ABI of Abbe promises.
        #[allow(unsafe_code)]
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn abbe_plugin(
            host: *const $crate::abi::AbbeHost,
        ) -> *const $crate::abi::AbbeLibrary {
            unsafe { $crate::sdk::library(host, env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION")) }
        }
    };
}
