//! Ray.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use super::processes::{Service, descendants, free_port, until};
use super::{ABBE, BATCH, example, survives};
use crate::support::{root, skipped, temporary};

/// A Python that has Ray: the one of `.ci/run`, or that of the machine.
fn python() -> Option<PathBuf> {
    let own = root().join("target/ray/bin/python");
    [own, "python3".into()].into_iter().find(|python| {
        let found = Command::new(python).args(["-c", "import ray"]).stderr(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
    })
}

#[test]
fn workers_that_are_killed_under_ray_change_nothing() {
    let Some(python) = python() else {
        return skipped("workers_that_are_killed_under_ray_change_nothing", "the Python package ray is not installed");
    };
    let folder = temporary();
    let ray = |arguments: &[&str]| {
        let mut command = Command::new(&python);
        command.args(["-m", "ray.scripts.scripts"]).args(arguments);
        command.env("RAY_USAGE_STATS_ENABLED", "0").env("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0");
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    let address = format!("127.0.0.1:{}", free_port());
    let port = format!("--port={}", address.rsplit_once(':').map_or("0", |(_, port)| port));
    let place = format!("--temp-dir={}", folder.path().display());
    let head = ["start", "--head", "--block", "--node-ip-address=127.0.0.1", "--include-dashboard=false"];
    let sizes = ["--num-cpus=2", "--num-gpus=0", "--object-store-memory=80000000", &port, &place];
    let cluster = Service(ray(&[&head[..], &sizes].concat()).spawn().expect("Ray starts"));
    until("Ray is not there", Duration::from_secs(60), || {
        std::net::TcpStream::connect(&address).is_ok() && descendants(cluster.id()).len() > 2
    });
    let wrapper = |at: &Path| {
        let mut command = Command::new(&python);
        command.arg(example("ray_fleet.py")).args(["fleet.manifest.jsonl", BATCH]).current_dir(at);
        command.env("ABBE", ABBE).env("RAY_ADDRESS", &address).env("RAY_USAGE_STATS_ENABLED", "0");
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    // Those of Ray that do a task, and the program that they start.
    let is_worker = |name: &str, fleet: &str| {
        name.starts_with("ray::batch_of_jobs") || name.contains("fleet job") && name.contains(fleet)
    };
    survives(31, || descendants(cluster.id()), wrapper, is_worker);
}
