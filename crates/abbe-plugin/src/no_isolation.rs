//! Stands for isolation on systems without it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use abbe_core::{Error, Result};

use crate::loader::Library;
use crate::sandbox::Allowance;

/// How plugins would be isolated.
#[derive(Debug, Clone)]
pub struct Limits {
    /// The program that would be started, with the arguments before file and hash.
    pub program: PathBuf,
    /// Its first arguments.
    pub arguments: Vec<String>,
    /// How long a plugin may work without sending an answer or a question.
    pub answer_timeout: Duration,
    /// How long a stage of it may work altogether.
    pub total_time: Duration,
    /// Memory of the process, MiB.
    pub memory_limit_mib: u64,
}

/// Always an error: there is no isolation on this system, and a plugin that has to be isolated must not run without it.
pub fn isolated(path: &Path, _: Option<&str>, _: &Limits) -> Result<Library> {
    let message = format!("the plugin library {} cannot be isolated on this system", path.display());
    Err(Error::usage(message).help("plugins run in processes of their own on Linux, macOS and other Unix systems"))
}

/// Refuses, as [`isolated`] does.
pub fn serve(path: &Path, _: &str, _: &Allowance) -> Result<()> {
    let none = Limits {
        program: PathBuf::new(),
        arguments: Vec::new(),
        answer_timeout: Duration::ZERO,
        total_time: Duration::ZERO,
        memory_limit_mib: 0,
    };
    isolated(path, None, &none).map(drop)
}
