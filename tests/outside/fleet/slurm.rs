//! Slurm.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use super::processes::{Loopback, Service, descendants, until};
use super::{ABBE, BATCH, example, survives};
use crate::support::{skipped, temporary, write};

/// The programs of a cluster.
const NEEDED: [&str; 6] = ["slurmctld", "slurmd", "munged", "sbatch", "sinfo", "mungekey"];

/// Why there can be no cluster on this machine.
fn missing() -> Option<String> {
    let is_there = |name: &&str| ["/usr/sbin", "/usr/bin"].iter().any(|at| Path::new(at).join(name).exists());
    if let Some(name) = NEEDED.iter().find(|name| !is_there(name)) {
        return Some(format!("`{name}` of Slurm is not installed"));
    }
    Loopback::missing()
}

/// What `sh` prints.
fn told(script: &str) -> String {
    let output = Command::new("sh").args(["-c", script]).output().expect("a shell");
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

#[test]
fn tasks_that_are_killed_under_slurm_change_nothing() {
    if let Some(why) = missing() {
        return skipped("tasks_that_are_killed_under_slurm_change_nothing", &why);
    }
    let folder = temporary();
    let at = folder.path();
    // The service of keys refuses folders that others may write to on the way to its socket, except those with the sticky bit.
    fs::set_permissions(at, fs::Permissions::from_mode(0o755)).expect("a folder of ours");
    let place = |name: &str| at.join(name).display().to_string();
    let (host, network) = (told("hostname -s"), Loopback::new());
    let made = Command::new("mungekey").args(["--create", "--keyfile", &place("key")]).status();
    assert!(made.is_ok_and(|status| status.success()), "no key can be made");
    write(
        &at.join("slurm.conf"),
        &format!(
            "ClusterName=fleet\nSlurmctldHost={host}(127.0.0.1)\nAuthType=auth/munge\nAuthInfo=socket={}\n\
             CredType=cred/munge\nSlurmUser=root\nSlurmdUser=root\nSlurmctldPort=6817\nSlurmdPort=6818\n\
             StateSaveLocation={}\nSlurmdSpoolDir={}\nSlurmctldPidFile={}\nSlurmdPidFile={}\n\
             ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nMpiDefault=none\nReturnToService=2\n\
             SelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\nSchedulerType=sched/backfill\n\
             SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1\n\
             KillWait=1\nMinJobAge=10\nNodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN\n\
             PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP\n",
            place("munge.socket"),
            place("state"),
            place("spool"),
            place("ctld.pid"),
            place("d.pid"),
        ),
    );
    for name in ["state", "spool"] {
        fs::create_dir(at.join(name)).expect("a folder");
    }
    let service = |program: &str, arguments: &[&str]| {
        let mut command = network.command(program);
        command.args(arguments).env("SLURM_CONF", at.join("slurm.conf"));
        Service(command.spawn().expect("a service"))
    };
    let files = ["socket", "pid-file", "log-file", "seed-file"];
    let files = files.map(|name| format!("--{name}={}", place(&format!("munge.{}", name.replace("-file", "")))));
    let key = format!("--key-file={}", place("key"));
    let _keys = service(
        "munged",
        &[&["--foreground", "--force", "--num-threads=2", &key][..], &files.each_ref().map(String::as_str)].concat(),
    );
    until("there is no service of keys", Duration::from_secs(60), || at.join("munge.socket").exists());
    let log = |name: &str| place(&format!("{name}.log"));
    let _control = service("slurmctld", &["-D", "-L", &log("ctld")]);
    let node = service("slurmd", &["-D", "-L", &log("d")]);
    until("the node is not idle", Duration::from_secs(300), || {
        let state = network
            .command("sinfo")
            .args(["-h", "-o", "%t"])
            .stdout(Stdio::piped())
            .env("SLURM_CONF", at.join("slurm.conf"))
            .output();
        state.is_ok_and(|state| state.stdout.starts_with(b"idle"))
    });
    let wrapper = |fleet: &Path| {
        let mut command = network.command("sh");
        command.arg(example("slurm_fleet.sh")).args(["fleet.manifest.jsonl", BATCH]).current_dir(fleet);
        command.env("ABBE", ABBE).env("SLURM_CONF", at.join("slurm.conf"));
        command
    };
    // The program, and the script of a task that turns into it.
    let own = at.display().to_string();
    let is_worker = |_: u32, name: &str, fleet: &str| {
        name.contains("fleet job") && name.contains(fleet) || name.contains("slurm_script") && name.contains(&own)
    };
    // What is killed runs under a process of the node that is no child of it any more.
    let engine = || {
        let steps = descendants(1)
            .into_iter()
            .filter(|id| super::name_of(*id).is_some_and(|name| name.starts_with("slurmstepd")));
        let of_steps: Vec<u32> = steps.flat_map(descendants).collect();
        of_steps.into_iter().chain(descendants(node.id())).collect()
    };
    survives(41, engine, wrapper, is_worker);
}
