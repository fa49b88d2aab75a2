//! What the process of an isolated plugin may do: compute. It reads the files that the recipe names and the libraries of the system,
//! and nothing else; it writes no files, starts no processes, has no network and signals nobody; memory and processor time have limits.
//!
//! Files and network are closed by Landlock, the rest by a filter of system calls (seccomp) and by limits of resources. What the system
//! does not have is told ([`missing`]), and the rest holds.

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
}

/// Memory of an isolated plugin unless the recipe states another limit, MiB.
pub const MEMORY_LIMIT_MIB: u64 = 1024;

/// Processor time of an isolated plugin, s: a day.
pub const PROCESSOR_LIMIT_S: u64 = 86_400;

impl Default for Allowance {
    fn default() -> Self {
        Self { may_read: Vec::new(), memory_limit_mib: MEMORY_LIMIT_MIB, processor_limit_s: PROCESSOR_LIMIT_S }
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

/// Limits of resources.
#[cfg(unix)]
fn resources(allowance: &Allowance) -> Result<(), String> {
    use rustix::process::{Resource, Rlimit, setrlimit};
    const MIB: u64 = 1 << 20;
    // Threads reserve addresses that they never use.
    const ADDRESSES_MIB: u64 = 16 * 1024;
    let memory = allowance.memory_limit_mib.saturating_mul(MIB);
    let limits = [
        (Resource::Core, 0),
        (Resource::Fsize, 0),
        (Resource::Cpu, allowance.processor_limit_s),
        (Resource::Data, memory),
        (Resource::As, memory.saturating_add(ADDRESSES_MIB * MIB)),
    ];
    for (resource, limit) in limits {
        setrlimit(resource, Rlimit { current: Some(limit), maximum: Some(limit) })
            .map_err(|error| format!("a limit ({resource:?}) cannot be set: {error}"))?;
    }
    Ok(())
}

#[cfg(target_os = "linux")]
mod linux {
    use std::collections::BTreeMap;
    use std::io;
    use std::path::PathBuf;

    use landlock::{
        ABI, Access, AccessFs, AccessNet, CompatLevel, Compatible, Ruleset, RulesetAttr, RulesetCreatedAttr, Scope,
        path_beneath_rules,
    };
    use seccompiler::{
        BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
        apply_filter,
    };

    use super::{Allowance, resources};

    /// Where programs and libraries of the system are.
    const SYSTEM: [&str; 11] = [
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
        "/dev/zero",
    ];

    /// What this system lacks to confine plugins; none if nothing.
    pub fn missing() -> Option<&'static str> {
        let has_landlock = Ruleset::default()
            .set_compatibility(CompatLevel::HardRequirement)
            .handle_access(AccessFs::from_all(ABI::V1))
            .is_ok_and(|ruleset| ruleset.create().is_ok());
        (!has_landlock).then_some("this system has no Landlock: isolated plugins may read and write files")
    }

    /// Takes away from this process, for ever, what a plugin does not need. Call it before other threads are started.
    pub fn confine(allowance: &Allowance) -> Result<(), String> {
        resources(allowance)?;
        files_and_network(allowance).map_err(|error| format!("files cannot be closed: {error}"))?;
        for program in filters()? {
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

    /// Calls that are refused, whatever their arguments: new programs, sockets, others' processes and memory, attributes of files, the
    /// system itself, and what outlives a process.
    const REFUSED: &[i64] = &[
        libc::SYS_execve,
        libc::SYS_execveat,
        libc::SYS_socket,
        libc::SYS_socketpair,
        libc::SYS_connect,
        libc::SYS_bind,
        libc::SYS_listen,
        libc::SYS_accept,
        libc::SYS_accept4,
        libc::SYS_tkill,
        libc::SYS_rt_sigqueueinfo,
        libc::SYS_rt_tgsigqueueinfo,
        libc::SYS_pidfd_open,
        libc::SYS_pidfd_send_signal,
        libc::SYS_pidfd_getfd,
        libc::SYS_ptrace,
        libc::SYS_process_vm_readv,
        libc::SYS_process_vm_writev,
        libc::SYS_kcmp,
        libc::SYS_setrlimit,
        libc::SYS_setpriority,
        libc::SYS_fchmod,
        libc::SYS_fchmodat,
        libc::SYS_fchown,
        libc::SYS_fchownat,
        libc::SYS_setxattr,
        libc::SYS_lsetxattr,
        libc::SYS_fsetxattr,
        libc::SYS_removexattr,
        libc::SYS_lremovexattr,
        libc::SYS_fremovexattr,
        libc::SYS_utimensat,
        libc::SYS_mknodat,
        libc::SYS_open_by_handle_at,
        libc::SYS_shmget,
        libc::SYS_msgget,
        libc::SYS_semget,
        libc::SYS_mq_open,
        libc::SYS_mount,
        libc::SYS_umount2,
        libc::SYS_pivot_root,
        libc::SYS_chroot,
        libc::SYS_unshare,
        libc::SYS_setns,
        libc::SYS_bpf,
        libc::SYS_perf_event_open,
        libc::SYS_io_uring_setup,
        libc::SYS_userfaultfd,
        libc::SYS_add_key,
        libc::SYS_request_key,
        libc::SYS_keyctl,
        libc::SYS_init_module,
        libc::SYS_finit_module,
        libc::SYS_delete_module,
        libc::SYS_kexec_load,
        libc::SYS_reboot,
        libc::SYS_swapon,
        libc::SYS_swapoff,
        libc::SYS_sethostname,
        libc::SYS_setdomainname,
        libc::SYS_settimeofday,
        libc::SYS_clock_settime,
        libc::SYS_adjtimex,
        libc::SYS_clock_adjtime,
        libc::SYS_acct,
        libc::SYS_quotactl,
        libc::SYS_syslog,
    ];

    /// The same, which not every processor has.
    #[cfg(target_arch = "x86_64")]
    const OLD: &[i64] = &[
        libc::SYS_fork,
        libc::SYS_vfork,
        libc::SYS_chmod,
        libc::SYS_chown,
        libc::SYS_lchown,
        libc::SYS_utime,
        libc::SYS_utimes,
        libc::SYS_futimesat,
        libc::SYS_mknod,
        libc::SYS_iopl,
        libc::SYS_ioperm,
    ];
    #[cfg(not(target_arch = "x86_64"))]
    const OLD: &[i64] = &[];

    /// Numbers of the calls of x86-64 with short addresses: the same calls under other numbers.
    #[cfg(target_arch = "x86_64")]
    const SHORT_ADDRESSES: Option<i64> = Some(0x4000_0000);
    #[cfg(not(target_arch = "x86_64"))]
    const SHORT_ADDRESSES: Option<i64> = None;

    type Rules = BTreeMap<i64, Vec<SeccompRule>>;

    /// The filters of system calls: refused calls fail as if the user had no right to them.
    fn filters() -> Result<[BpfProgram; 2], String> {
        let own = u64::from(std::process::id());
        let if_argument = |argument, length, operator, value| {
            SeccompCondition::new(argument, length, operator, value)
                .and_then(|condition| SeccompRule::new(vec![condition]))
        };
        let word = SeccompCmpArgLen::Dword;
        let mut rules: Rules = REFUSED.iter().chain(OLD).map(|call| (*call, Vec::new())).collect();
        let of_thread = u64::from(libc::CLONE_THREAD.unsigned_abs());
        let conditional = [
            // Threads are allowed, processes are not.
            (libc::SYS_clone, if_argument(0, SeccompCmpArgLen::Qword, SeccompCmpOp::MaskedEq(of_thread), 0)),
            // A process may end itself.
            (libc::SYS_kill, if_argument(0, word.clone(), SeccompCmpOp::Ne, own)),
            (libc::SYS_tgkill, if_argument(0, word, SeccompCmpOp::Ne, own)),
            // Limits may be asked for.
            (libc::SYS_prlimit64, if_argument(2, SeccompCmpArgLen::Qword, SeccompCmpOp::Ne, 0)),
        ];
        for (call, rule) in conditional {
            rules.insert(call, vec![rule.map_err(|error| error.to_string())?]);
        }
        // Without it threads are made by `clone`, of which the flags can be seen.
        let unknown: Rules = [(libc::SYS_clone3, Vec::new())].into();
        Ok([program(rules, libc::EPERM)?, program(unknown, libc::ENOSYS)?])
    }

    fn program(mut rules: Rules, error: i32) -> Result<BpfProgram, String> {
        if let Some(offset) = SHORT_ADDRESSES {
            let others: Rules = rules.iter().map(|(call, rules)| (call + offset, rules.clone())).collect();
            rules.extend(others);
        }
        let refuse = SeccompAction::Errno(error.unsigned_abs());
        let arch = std::env::consts::ARCH.try_into().map_err(|_| unsupported().to_string())?;
        SeccompFilter::new(rules, SeccompAction::Allow, refuse, arch)
            .and_then(TryInto::try_into)
            .map_err(|error: seccompiler::BackendError| error.to_string())
    }

    fn unsupported() -> io::Error {
        io::Error::new(io::ErrorKind::Unsupported, "this processor has no filter of system calls here")
    }
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
