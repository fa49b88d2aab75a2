//! Tables of libraries.
#![allow(unsafe_code, reason = "the C ABI; every block says why it is sound")]

use super::slice;
use super::theirs::with_reply;
use crate::abi::*;
use crate::float_control;
use crate::peer::{Failure, Received};

/// A plugin of a library, to build stages with.
pub(crate) struct Record {
    record: *const AbbePlugin,
    create: unsafe extern "C" fn(*const AbbePlugin, AbbeText, AbbeText, *const AbbeReply) -> u32,
}

// SAFETY: records are constant, and by the ABI `create` may be called from several threads at once.
unsafe impl Send for Record {}
// SAFETY: as above.
unsafe impl Sync for Record {}

impl Record {
    /// Builds a stage; the text after the path of the folder is lent for the call.
    pub fn create(&self, settings: &str, base: &str, who: &str) -> Result<Received, Failure> {
        let (settings, base) = (AbbeText::of(settings), AbbeText::of(base));
        // SAFETY: record and function belong together and stay valid; texts and reply live through the call.
        let answer = with_reply(who, |reply| unsafe { (self.create)(self.record, settings, base, reply) })?;
        answer.objects.into_iter().next().ok_or_else(|| Failure::of(who, "gave no stage and no error"))
    }
}

/// The content of the table of a library.
pub(crate) struct LibraryText {
    pub name: String,
    pub version: String,
    pub plugins: Vec<PluginText>,
}

/// The content of the record of a plugin.
pub(crate) struct PluginText {
    pub kind: u32,
    pub name: String,
    pub about: String,
    pub reference: String,
    pub schema: String,
    pub example: String,
    pub record: Record,
}

/// Largest accepted number of plugins of a library. A larger one is taken as an error of the library.
const MOST_PLUGINS: u64 = 1000;

/// Asks a library for its table and reads it.
///
/// # Safety
/// `entry` is the exported function of a plugin library.
pub(crate) unsafe fn read_library(entry: AbbeEntry, host: &'static AbbeHost) -> Result<LibraryText, String> {
    // SAFETY: the function is what its name promises; everything that it gives is checked as far as that can be done, and
    // nothing behind the stated size of a structure is read.
    unsafe {
        let library = float_control::kept(|| entry(host));
        if library.is_null() || !library.is_aligned() {
            return Err("gives no table: it refuses to work with this program".to_owned());
        }
        let (major, size) = ((*library).abi_major, (*library).size);
        if major != ABBE_ABI_MAJOR {
            return Err(format!(
                "speaks version {major} of the plugin interface, this program speaks version {ABBE_ABI_MAJOR}: build it again with the \
                 header or the crate `abbe-plugin` of this program"
            ));
        }
        if size < size_of::<AbbeLibrary>() as u64 {
            return Err(format!("gives a table of {size} bytes; at least {} were expected", size_of::<AbbeLibrary>()));
        }
        let library = &*library;
        let (name, version) = (library.name.read()?, library.version.read()?);
        if library.plugin_count == 0 || library.plugin_count > MOST_PLUGINS {
            return Err(format!("says that it has {} plugins", library.plugin_count));
        }
        let records =
            slice(library.plugins, library.plugin_count).map_err(|_| "gives no list of plugins".to_owned())?;
        let plugins = records.iter().map(|&record| read_plugin(record)).collect::<Result<_, _>>()?;
        Ok(LibraryText { name, version, plugins })
    }
}

/// # Safety
/// `record` is null or the record of a plugin, valid for ever.
unsafe fn read_plugin(record: *const AbbePlugin) -> Result<PluginText, String> {
    // SAFETY: as this function asks for; the size is checked before anything behind it is read.
    unsafe {
        if record.is_null() || !record.is_aligned() {
            return Err("has a null pointer in its list of plugins".to_owned());
        }
        if (*record).size < size_of::<AbbePlugin>() as u64 {
            return Err(format!("has a plugin whose record is of {} bytes", (*record).size));
        }
        let plugin = &*record;
        let name = plugin.name.read()?;
        let create = plugin.create.ok_or_else(|| format!("has a plugin `{name}` without a function `create`"))?;
        Ok(PluginText {
            kind: plugin.kind,
            about: plugin.about.read()?,
            reference: plugin.reference.read()?,
            schema: plugin.schema.read()?,
            example: plugin.example.read()?,
            record: Record { record, create },
            name,
        })
    }
}
