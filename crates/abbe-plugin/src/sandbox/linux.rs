//! Linux: Landlock for files and network, a filter of system calls for the rest.

use std::path::PathBuf;

use landlock::{
    ABI, Access, AccessFs, AccessNet, CompatLevel, Compatible, Ruleset, RulesetAttr, RulesetCreatedAttr, Scope,
    path_beneath_rules,
};
use seccompiler::apply_filter;

use super::calls::filters;
use super::{Allowance, resources};

/// Where programs and libraries of the system are.
const SYSTEM: [&str; 10] = [
    "/usr",
    "/lib",
    "/lib32",
    "/lib64",
    "/nix/store",
    "/etc/ld.so.cache",
    "/etc/ld.so.preload",
    "/etc/localtime",
    "/dev/null",
    "/dev/urandom",
];

/// What this system lacks to confine plugins; none if nothing.
pub fn missing() -> Option<&'static str> {
    let has_landlock = Ruleset::default()
        .set_compatibility(CompatLevel::HardRequirement)
        .handle_access(AccessFs::from_all(ABI::V1))
        .is_ok_and(|ruleset| ruleset.create().is_ok());
    (!has_landlock).then_some("this system has no Landlock: isolated plugins may read files")
}

/// Takes away from this process, for ever, what a plugin does not need. Call it before other threads are started.
pub fn confine(allowance: &Allowance) -> Result<(), String> {
    resources(allowance)?;
    files_and_network(allowance).map_err(|error| format!("files cannot be closed: {error}"))?;
    for program in filters(allowance.is_on_trial)? {
        apply_filter(&program).map_err(|error| format!("system calls cannot be filtered: {error}"))?;
    }
    Ok(())
}

/// Landlock: reads what is allowed, writes nothing, no network, no signals to others. Each system does as much of it as it can.
fn files_and_network(allowance: &Allowance) -> Result<(), landlock::RulesetError> {
    let abi = ABI::V6;
    let searched = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    let mut readable: Vec<PathBuf> = SYSTEM.map(PathBuf::from).to_vec();
    readable.extend(std::env::split_paths(&searched).filter(|folder| folder.is_absolute()));
    readable.extend(allowance.may_read.iter().cloned());
    Ruleset::default()
        .set_compatibility(CompatLevel::BestEffort)
        .handle_access(AccessFs::from_all(abi))?
        .handle_access(AccessNet::from_all(abi))?
        .scope(Scope::from_all(abi))?
        .create()?
        .add_rules(path_beneath_rules(&readable, AccessFs::from_read(abi)))?
        .restrict_self()
        .map(drop)
}
