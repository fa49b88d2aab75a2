//! What the process of an isolated plugin may do: compute. It reads the files that the recipe names and the libraries of the system,
//! and nothing else; it writes no files, starts no processes, has no network and signals nobody; memory and processor time have limits.
//!
//! Files and network are closed by Landlock, the rest by a filter of system calls (seccomp) and by limits of resources. What the system
//! does not have is told ([`missing`]), and the rest holds.

#[cfg(target_os = "linux")]
mod calls;
#[cfg(target_os = "linux")]
mod linux;

use std::path::{Path, PathBuf};

use serde_json::Value;

/// What one process may use.
#[derive(Debug, Clone)]
pub struct Allowance {
    /// Files and folders that it may read, beside the libraries of the system.
    pub may_read: Vec<PathBuf>,
    /// Memory, MiB.
    pub memory_limit_mib: u64,
    /// Processor time, s.
    pub processor_limit_s: u64,
    /// A refused system call ends the process, so that who tries one is found out; else the call fails.
    pub is_on_trial: bool,
}

/// Memory of an isolated plugin unless the recipe states another limit, MiB.
pub const MEMORY_LIMIT_MIB: u64 = 1024;

/// Processor time of an isolated plugin, s: a day.
pub const PROCESSOR_LIMIT_S: u64 = 86_400;

impl Default for Allowance {
    fn default() -> Self {
        Self {
            may_read: Vec::new(),
            memory_limit_mib: MEMORY_LIMIT_MIB,
            processor_limit_s: PROCESSOR_LIMIT_S,
            is_on_trial: false,
        }
    }
}

/// The files and folders that settings name: every text in them that names one, from the folder of the recipe; of a pattern the folder
/// in which it is looked for.
pub(crate) fn named(settings: &str, base: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    if let Ok(settings) = serde_json::from_str(settings) {
        add_named(&settings, base, &mut found);
    }
    found.sort();
    found.dedup();
    found
}

fn add_named(value: &Value, base: &Path, found: &mut Vec<PathBuf>) {
    match value {
        Value::String(text) if !text.is_empty() => {
            let path = base.join(text);
            let is_pattern = text.contains(['*', '?', '[']);
            match path.exists() {
                true => found.push(path),
                false if is_pattern => found.extend(path.parent().filter(|parent| parent.is_dir()).map(Path::to_owned)),
                false => {}
            }
        }
        Value::Array(list) => list.iter().for_each(|value| add_named(value, base, found)),
        Value::Object(map) => map.values().for_each(|value| add_named(value, base, found)),
        _ => {}
    }
}

#[cfg(target_os = "linux")]
pub(crate) use linux::confine;
#[cfg(target_os = "linux")]
pub use linux::missing;

#[cfg(not(target_os = "linux"))]
pub(crate) fn confine(allowance: &Allowance) -> Result<(), String> {
    resources(allowance)
}

/// What this system lacks to confine plugins; none if nothing.
#[cfg(not(target_os = "linux"))]
pub fn missing() -> Option<&'static str> {
    Some("files, network and processes of isolated plugins are not confined on this system")
}

/// Files that may be open at once: each may hold memory of the system.
#[cfg(unix)]
const OPEN_FILES: u64 = 256;

/// Limits of resources; one that is lower already stays.
#[cfg(unix)]
fn resources(allowance: &Allowance) -> Result<(), String> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    const MIB: u64 = 1 << 20;
    // Threads reserve addresses that they never use.
    const ADDRESSES_MIB: u64 = 16 * 1024;
    let memory = allowance.memory_limit_mib.saturating_mul(MIB);
    let limits = [
        (Resource::Core, 0),
        (Resource::Fsize, 0),
        (Resource::Nofile, OPEN_FILES),
        (Resource::Cpu, allowance.processor_limit_s),
        (Resource::Data, memory),
        (Resource::As, memory.saturating_add(ADDRESSES_MIB * MIB)),
    ];
    for (resource, limit) in limits {
        let limit = getrlimit(resource).maximum.map_or(limit, |present| present.min(limit));
        setrlimit(resource, Rlimit { current: Some(limit), maximum: Some(limit) })
            .map_err(|error| format!("a limit ({resource:?}) cannot be set: {error}"))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::named;

    #[test]
    fn settings_name_the_files_that_may_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("logs")).unwrap();
        for file in ["touches.csv", "other.csv", "logs/1.csv"] {
            fs::write(at(file), "").unwrap();
        }
        let settings = r#"{ "path": "touches.csv", "mode": "good", "of": [{ "logs": "logs/*.csv", "": "", "n": 1 }] }"#;
        assert_eq!(named(settings, folder.path()), [at("logs"), at("touches.csv")]);
        assert!(named("{", folder.path()).is_empty());
    }
}
