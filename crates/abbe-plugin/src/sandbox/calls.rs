//! The filter of system calls of an isolated plugin.

use std::collections::BTreeMap;

use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
};

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
    libc::SYS_process_madvise,
    libc::SYS_process_mrelease,
    libc::SYS_move_pages,
    libc::SYS_migrate_pages,
    libc::SYS_ioprio_set,
    libc::SYS_truncate,
    libc::SYS_mkdirat,
    libc::SYS_unlinkat,
    libc::SYS_linkat,
    libc::SYS_symlinkat,
    libc::SYS_renameat2,
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
    libc::SYS_creat,
    libc::SYS_mkdir,
    libc::SYS_rmdir,
    libc::SYS_unlink,
    libc::SYS_link,
    libc::SYS_symlink,
    libc::SYS_rename,
    libc::SYS_renameat,
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

/// What an argument of a call must not be.
struct Forbidden {
    call: i64,
    argument: u8,
    is: SeccompCmpOp,
    value: u64,
}

const fn forbidden(call: i64, argument: u8, is: SeccompCmpOp, value: u64) -> Forbidden {
    Forbidden { call, argument, is, value }
}

/// Calls that are refused with some arguments.
fn conditional() -> Vec<Forbidden> {
    use SeccompCmpOp::{Eq, MaskedEq, Ne};
    let bits = |flags: i32| u64::from(flags.unsigned_abs());
    let with = |call, argument, flag| forbidden(call, argument, MaskedEq(bits(flag)), bits(flag));
    let own = u64::from(std::process::id());
    let mut all = vec![
        // Threads are allowed, processes are not.
        forbidden(libc::SYS_clone, 0, MaskedEq(bits(libc::CLONE_THREAD)), 0),
        // A process may end itself.
        forbidden(libc::SYS_kill, 0, Ne, own),
        forbidden(libc::SYS_tgkill, 0, Ne, own),
        // Limits may be asked for.
        forbidden(libc::SYS_prlimit64, 2, Ne, 0),
        // Its own threads may be put on processors, others not.
        forbidden(libc::SYS_sched_setaffinity, 0, Ne, 0),
        forbidden(libc::SYS_sched_setscheduler, 0, Ne, 0),
        forbidden(libc::SYS_sched_setparam, 0, Ne, 0),
        forbidden(libc::SYS_sched_setattr, 0, Ne, 0),
        // A signal to another process when something happens to a file.
        forbidden(libc::SYS_fcntl, 1, Eq, bits(libc::F_SETOWN)),
        forbidden(libc::SYS_fcntl, 1, Eq, SET_SIGNAL),
        forbidden(libc::SYS_fcntl, 1, Eq, SET_OWNER_EX),
        // Memory of the system beside that of the process.
        forbidden(libc::SYS_fcntl, 1, Eq, SET_PIPE_SIZE),
        forbidden(libc::SYS_mmap, 3, MaskedEq(bits(libc::MAP_ANONYMOUS | MAP_TYPE)), bits(ANONYMOUS_SHARED)),
    ];
    all.extend(REQUESTS.map(|request| forbidden(libc::SYS_ioctl, 1, Eq, request)));
    // No limit counts memory that grows downwards.
    all.push(with(libc::SYS_mmap, 3, libc::MAP_GROWSDOWN));
    for &(call, argument) in OPENS {
        // The modes are bits; one with both is asked for by nobody.
        all.extend([libc::O_WRONLY, libc::O_RDWR, libc::O_TRUNC, libc::O_CREAT].map(|flag| with(call, argument, flag)));
    }
    all
}

/// `F_SETSIG`, `F_SETOWN_EX` and `F_SETPIPE_SZ`, which not every C library names.
const SET_SIGNAL: u64 = 10;
const SET_OWNER_EX: u64 = 15;
const SET_PIPE_SIZE: u64 = 1031;

/// Requests to devices: `FIOSETOWN` and `SIOCSPGRP` (signals to others), `TIOCSTI` and `TIOCLINUX` (input of terminals).
const REQUESTS: [u64; 4] = [0x8901, 0x8902, 0x5412, 0x541c];

/// The part of the flags of `mmap` that says whether memory is shared.
const MAP_TYPE: i32 = 0x0f;

const ANONYMOUS_SHARED: i32 = libc::MAP_ANONYMOUS | libc::MAP_SHARED;

/// Calls that open files, and which argument has the flags.
#[cfg(target_arch = "x86_64")]
const OPENS: &[(i64, u8)] = &[(libc::SYS_openat, 2), (libc::SYS_open, 1)];
#[cfg(not(target_arch = "x86_64"))]
const OPENS: &[(i64, u8)] = &[(libc::SYS_openat, 2)];

/// Calls that the system seems not to know, so that others are used of which the flags can be seen.
const UNKNOWN: [i64; 2] = [libc::SYS_clone3, libc::SYS_openat2];

/// The filters of system calls: refused calls fail as if the user had no right to them, or end a process that is on trial.
pub(super) fn filters(is_on_trial: bool) -> Result<[BpfProgram; 2], String> {
    let mut rules: Rules = REFUSED.iter().chain(OLD).map(|call| (*call, Vec::new())).collect();
    for Forbidden { call, argument, is, value } in conditional() {
        let condition = SeccompCondition::new(argument, SeccompCmpArgLen::Dword, is, value);
        let rule = condition.and_then(|condition| SeccompRule::new(vec![condition]));
        rules.entry(call).or_default().push(rule.map_err(|error| error.to_string())?);
    }
    let refused = match is_on_trial {
        true => SeccompAction::KillProcess,
        false => SeccompAction::Errno(libc::EPERM.unsigned_abs()),
    };
    let unknown: Rules = UNKNOWN.into_iter().map(|call| (call, Vec::new())).collect();
    Ok([program(rules, refused)?, program(unknown, SeccompAction::Errno(libc::ENOSYS.unsigned_abs()))?])
}

fn program(mut rules: Rules, refuse: SeccompAction) -> Result<BpfProgram, String> {
    if let Some(offset) = SHORT_ADDRESSES {
        let others: Rules = rules.iter().map(|(call, rules)| (call + offset, rules.clone())).collect();
        rules.extend(others);
    }
    let arch = std::env::consts::ARCH.try_into();
    let arch = arch.map_err(|_| "there is no filter of system calls for this processor".to_owned())?;
    SeccompFilter::new(rules, SeccompAction::Allow, refuse, arch)
        .and_then(TryInto::try_into)
        .map_err(|error: seccompiler::BackendError| error.to_string())
}
