//! Loads plugin libraries: hashes the file, loads a sealed copy of what was hashed, then reads its table.
#![allow(unsafe_code, reason = "runs the code of libraries; every block says why it is sound")]

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use abbe_core::{
    Build, Constructor, Context, Error, EstimateSource, Kind, Origin, Plugin, Provider, Registry, Result,
    SettingsError, from_json, harmless,
};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::abi::*;
use crate::border::{LibraryText, Record, read_library};
use crate::float_control;
use crate::peer::{Failure, Peer, Received};
use crate::proxy::{Estimator, Stage};

/// A library that is loaded, or that is run in processes of its own.
pub struct Library {
    /// Its file.
    pub file: PathBuf,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// Its plugins.
    pub plugins: Vec<Plugin>,
}

/// Writes a line of a library into the log of the program.
unsafe extern "C" fn log(level: u32, text: AbbeText) {
    // SAFETY: a text of the ABI is readable during the call.
    let Ok(text) = (unsafe { text.read() }) else { return };
    match level {
        // A closed output changes nothing.
        0 | 1 => drop(writeln!(io::stderr(), "{}", harmless(&text))),
        _ => {}
    }
}

static HOST: AbbeHost = AbbeHost {
    abi_major: ABBE_ABI_MAJOR,
    abi_minor: ABBE_ABI_MINOR,
    size: size_of::<AbbeHost>() as u64,
    log: Some(log),
};

/// The bytes of a library, whose hash is known and, if one was asked for, right.
pub(crate) struct Hashed {
    bytes: Vec<u8>,
    /// Its file, from which it is loaded where there are no sealed copies.
    #[cfg(not(target_os = "linux"))]
    file: File,
    pub sha256: String,
}

/// Opens the file of a library.
pub(crate) fn open_library(path: &Path) -> Result<File> {
    abbe_files::open(path).map_err(|error| unreadable(path, &error))
}

fn unreadable(path: &Path, error: &io::Error) -> Error {
    Error::usage(match error.kind() {
        io::ErrorKind::NotFound => format!("the plugin library {} does not exist", path.display()),
        _ => format!("the plugin library {} cannot be read: {error}", path.display()),
    })
}

/// Bytes that tell whether a file is a library, and how one begins: on Linux, on Windows, on macOS for one processor and for several.
const HEAD: u64 = 4;
const LIBRARIES: [&[u8]; 4] = [b"\x7fELF", b"MZ", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe"];

/// Opens a library and hashes it; refuses one that is not what `pin` says.
pub(crate) fn hashed(path: &Path, pin: Option<&str>) -> Result<Hashed> {
    let mut file = open_library(path)?;
    let mut bytes = Vec::new();
    let failed = |error: io::Error| unreadable(path, &error);
    Read::by_ref(&mut file).take(HEAD).read_to_end(&mut bytes).map_err(failed)?;
    // A large file that is something else is not read.
    if !LIBRARIES.iter().any(|start| bytes.starts_with(start)) {
        let message =
            format!("the plugin library {} cannot be loaded: it does not begin as a library does", path.display());
        return Err(Error::usage(message).help("name the library that `cargo build` made of the plugin"));
    }
    file.read_to_end(&mut bytes).map_err(failed)?;
    if truncated(&bytes) {
        let message =
            format!("the plugin library {} cannot be loaded: the file is shorter than it says", path.display());
        return Err(Error::usage(message).help("it was not copied completely"));
    }
    let sha256: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    match pin {
        Some(pin) if !pin.eq_ignore_ascii_case(&sha256) => {
            let message = format!("the plugin library {} has another SHA-256 than it is pinned to", path.display());
            Err(Error::usage(message).help(format!("pinned {pin}, found {sha256}; it was not loaded")))
        }
        _ => Ok(Hashed {
            bytes,
            #[cfg(not(target_os = "linux"))]
            file,
            sha256,
        }),
    }
}

/// Whether a 64-bit little-endian ELF file ends before its segments or its table of sections do: the system's loader maps such a
/// file and the program dies where it is read.
pub(crate) fn truncated(bytes: &[u8]) -> bool {
    if !bytes.starts_with(b"\x7fELF\x02\x01") {
        return false;
    }
    let number = |at: u64, size: u64| -> Option<u64> {
        let end = at.checked_add(size)?;
        let field = bytes.get(usize::try_from(at).ok()?..usize::try_from(end).ok()?)?;
        Some(field.iter().rev().fold(0, |all, byte| all << 8 | u64::from(*byte)))
    };
    let fits = |start: u64, size: u64| start.checked_add(size).is_some_and(|end| end <= bytes.len() as u64);
    let whole = || -> Option<bool> {
        let (segments, sections) = (number(0x20, 8)?, number(0x28, 8)?);
        let sections_fit = fits(sections, number(0x3a, 2)? * number(0x3c, 2)?);
        let (size, count) = (number(0x36, 2)?, number(0x38, 2)?);
        let segment = |index: u64| {
            let at = segments.checked_add(index * size)?;
            Some(fits(number(at.checked_add(8)?, 8)?, number(at.checked_add(32)?, 8)?))
        };
        Some(sections_fit && (0..count).all(|index| segment(index) == Some(true)))
    };
    whole() != Some(true)
}

/// What is loaded: a copy of the bytes that were hashed, which nobody can change.
pub(crate) struct Sealed {
    file: File,
    sha256: String,
}

impl Hashed {
    /// Its copy in memory. Elsewhere than on Linux it is the file itself.
    pub fn sealed(self, path: &Path) -> Result<Sealed> {
        let file = sealed(&self).map_err(|error| {
            Error::data(format!(
                "the plugin library {} cannot be copied into memory: {}",
                path.display(),
                abbe_files::why(&error)
            ))
        })?;
        Ok(Sealed { file, sha256: self.sha256 })
    }
}

#[cfg(target_os = "linux")]
fn sealed(library: &Hashed) -> io::Result<File> {
    use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, memfd_create};
    const NAME: &str = "plugin library";
    let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
    // Older systems do not know the flag, and let everything be executed.
    let copy = match memfd_create(NAME, flags | MemfdFlags::EXEC) {
        Err(rustix::io::Errno::INVAL) => memfd_create(NAME, flags)?,
        copy => copy?,
    };
    let mut copy = File::from(copy);
    copy.write_all(&library.bytes)?;
    fcntl_add_seals(&copy, SealFlags::WRITE | SealFlags::GROW | SealFlags::SHRINK | SealFlags::SEAL)?;
    Ok(copy)
}

#[cfg(not(target_os = "linux"))]
fn sealed(library: &Hashed) -> io::Result<File> {
    library.file.try_clone()
}

/// Loads a library into this program, unless its hash is not `pin`.
///
/// Fails for a file that is no library, for a missing or wrong table, and for forbidden names of plugins. Loading runs the
/// code of the library, and a faulty library can end the program. [`isolated`](crate::isolated) prevents that.
pub fn load(path: &Path, pin: Option<&str>) -> Result<Library> {
    load_sealed(path, hashed(path, pin)?.sealed(path)?)
}

/// Loads a library of this path from its copy.
pub(crate) fn load_sealed(path: &Path, sealed: Sealed) -> Result<Library> {
    let Sealed { file, sha256 } = sealed;
    let wrong = |what: String| Error::usage(format!("the plugin library {} {what}", path.display()));
    let opened = open(path, file).map_err(|error| wrong(format!("cannot be loaded: {}", reason(&error))))?;
    // SAFETY: the symbol is the entry of Abbe's ABI. Another function under this name cannot be detected.
    let entry = unsafe { opened.get::<AbbeEntry>(ENTRY.as_bytes()) };
    let entry = *entry.map_err(|_| wrong(format!("exports no `{ENTRY}`: it is no plugin library")))?;
    // A library is never unloaded: its code may run, or be registered somewhere, at any time.
    std::mem::forget(opened);
    // SAFETY: as above; `HOST` lives for ever.
    let table = unsafe { read_library(entry, &HOST) }.map_err(wrong)?;
    let LibraryText { name, version, plugins } = table;
    let origin = Origin::Library { file: path.to_owned(), sha256: sha256.clone() };
    let plugins = plugins.into_iter().map(|plugin| {
        let about = About {
            kind: plugin.kind,
            name: plugin.name,
            version: version.clone(),
            about: plugin.about,
            reference: plugin.reference,
            schema: plugin.schema,
            example: plugin.example,
        };
        about.plugin(path, &origin, in_process(plugin.record))
    });
    let plugins = plugins.collect::<Result<_, String>>().map_err(wrong)?;
    Ok(Library { file: path.to_owned(), sha256, name, version, plugins })
}

/// The reason why a library cannot be opened.
fn reason(error: &libloading::Error) -> String {
    use std::error::Error as _;
    error.source().map_or_else(|| error.to_string(), ToString::to_string)
}

/// Opens the copy of what was hashed.
fn open(path: &Path, file: File) -> Result<libloading::Library, libloading::Error> {
    #[cfg(target_os = "linux")]
    {
        use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
        use std::os::fd::AsRawFd;
        let _ = path;
        let opened = format!("/proc/self/fd/{}", file.as_raw_fd());
        // Kept open: the loader identifies libraries by name, and would take another file with this descriptor number for
        // this one.
        std::mem::forget(file);
        // SAFETY: runs the constructors of a library that the user named; the floating-point state is put back.
        float_control::kept(|| unsafe { Library::open(Some(opened), RTLD_NOW | RTLD_LOCAL) }).map(Into::into)
    }
    #[cfg(not(target_os = "linux"))]
    {
        drop(file);
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        // SAFETY: as above; an absolute path is never searched for.
        float_control::kept(|| unsafe { libloading::Library::new(path) })
    }
}

/// Builds stages: settings and folder to an object; `who` is for messages.
pub(crate) type Create = Arc<dyn Fn(&str, &str, &str) -> Result<Received, Failure> + Send + Sync>;

fn in_process(record: Record) -> Create {
    Arc::new(move |settings, base, who| record.create(settings, base, who))
}

/// The description of a plugin.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub(crate) struct About {
    pub kind: u32,
    pub name: String,
    pub version: String,
    pub about: String,
    pub reference: String,
    pub schema: String,
    pub example: String,
}

impl About {
    /// The record of the registry, if everything is in order.
    pub fn plugin(self, path: &Path, origin: &Origin, create: Create) -> Result<Plugin, String> {
        let name = &self.name;
        let letters = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || !name.chars().all(letters) {
            return Err(format!("has a plugin `{name}`: letters, digits, `-` and `_` were expected"));
        }
        let kind = Kind::ALL.get(self.kind as usize).copied();
        let kind = kind.ok_or_else(|| format!("has a plugin `{name}` of the unknown kind {}", self.kind))?;
        if self.about.is_empty() || self.about.contains('\n') {
            return Err(format!("does not say in one line what its plugin `{name}` does"));
        }
        let json = |what: &str, text: &str| -> Result<Value, String> {
            from_json(text).map_err(|error| format!("has a plugin `{name}` whose {what} is no JSON: {error}"))
        };
        let (schema, example) = (json("schema", &self.schema)?, json("example", &self.example)?);
        let library = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
        let who = format!("the plugin `{name}` of {library}");
        Ok(Plugin {
            version: Cow::Owned(self.version),
            about: Cow::Owned(self.about),
            // Libraries are never unloaded, so their texts may live for ever.
            reference: self.reference.leak(),
            origin: origin.clone(),
            schema: Provider::Value(schema),
            example: Provider::Value(example),
            build: build(kind, create, who),
            estimate_source: EstimateSource::default(),
            name: Cow::Owned(self.name),
        })
    }
}

fn build(kind: Kind, create: Create, who: String) -> Build {
    let peer = move |settings: &Value, context: &Context| -> Result<Arc<dyn Peer>, SettingsError> {
        let base = context.base.to_str();
        let base =
            base.ok_or_else(|| SettingsError::new("", "the folder of the recipe has a name that is not UTF-8"))?;
        match create(&settings.to_string(), base, &who).map_err(|failure| failure.settings_error(&who))? {
            Received::Remote(peer) => Ok(peer),
            Received::Local(_) => Err(SettingsError::new("", format!("{who} gave one of the program's own objects"))),
        }
    };
    /// Errors of the first questions to a stage get the place of its settings.
    fn wrong(error: Error) -> SettingsError {
        let Error { class, setting, message, help, .. } = error;
        SettingsError { path: setting, key: false, message, help, class }
    }
    let stage = move |settings: &Value, context: &Context| peer(settings, context);
    match kind {
        Kind::Ingest => Build::Ingest(Constructor::Dynamic(Arc::new(move |settings, context| {
            Ok(Box::new(Stage::new(stage(settings, context)?).map_err(wrong)?))
        }))),
        Kind::Artefact => Build::Artefact(Constructor::Dynamic(Arc::new(move |settings, context| {
            Ok(Box::new(Stage::new(stage(settings, context)?).map_err(wrong)?))
        }))),
        Kind::Model => Build::Model(Constructor::Dynamic(Arc::new(move |settings, context| {
            Ok(Box::new(Stage::new(stage(settings, context)?).map_err(wrong)?))
        }))),
        Kind::Estimate => Build::Estimate(Constructor::Dynamic(Arc::new(move |settings, context| {
            Ok(Box::new(Estimator::new(stage(settings, context)?)))
        }))),
        Kind::Validate => Build::Validate(Constructor::Dynamic(Arc::new(move |settings, context| {
            Ok(Box::new(Stage::validator(stage(settings, context)?).map_err(wrong)?))
        }))),
        Kind::Export => Build::Export(Constructor::Dynamic(Arc::new(move |settings, context| {
            Ok(Box::new(Stage::new(stage(settings, context)?).map_err(wrong)?))
        }))),
    }
}

impl Library {
    /// Adds the plugins to a registry; a name that is taken is refused.
    pub fn register(self, registry: &mut Registry) -> Result<()> {
        for plugin in self.plugins {
            let (kind, name) = (plugin.kind(), plugin.name.to_string());
            registry.add(plugin).map_err(|_| {
                let message = format!(
                    "the plugin library {} has a {kind} plugin `{name}`, and there is one of that name already",
                    self.file.display()
                );
                Error::usage(message).help("a vendor's plugin needs a name of its own")
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A table of segments that would lie beyond all numbers.
    #[test]
    fn heads_that_point_beyond_all_numbers_are_those_of_no_whole_file() {
        for start in [u64::MAX, u64::MAX - 7, u64::MAX - 31, u64::MAX / 2] {
            let mut bytes = vec![0; 120];
            bytes[..6].copy_from_slice(b"\x7fELF\x02\x01");
            bytes[0x20..0x28].copy_from_slice(&start.to_le_bytes());
            bytes[0x38] = 1;
            assert!(truncated(&bytes), "{start}");
        }
    }
}
