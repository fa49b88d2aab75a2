//! Ray.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use super::processes::{Loopback, Service, descendants, until};
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
    if let Some(why) = Loopback::missing() {
        return skipped("workers_that_are_killed_under_ray_change_nothing", &why);
    }
    let (folder, network) = (temporary(), Loopback::new());
    let place = format!("--temp-dir={}", folder.path().display());
    let mut ray = network.command(&python);
    ray.args(["-m", "ray.scripts.scripts", "start", "--head", "--block", "--include-dashboard=false", &place]);
    // Ray takes 127.0.0.1 for a mistake and looks for another interface.
    ray.args(["--node-ip-address=127.0.0.2", "--port=6379", "--num-cpus=2", "--num-gpus=0"]);
    ray.arg("--object-store-memory=80000000").env("RAY_USAGE_STATS_ENABLED", "0");
    let cluster = Service(ray.spawn().expect("Ray starts"));
    let socket = folder.path().join("session_latest/sockets/raylet");
    until("Ray is not there", Duration::from_secs(300), || socket.exists());
    let wrapper = |at: &Path| {
        let mut command = network.command(&python);
        command.arg(example("ray_fleet.py")).args(["fleet.manifest.jsonl", BATCH]).current_dir(at);
        command.env("ABBE", ABBE).env("RAY_ADDRESS", "127.0.0.2:6379").env("RAY_USAGE_STATS_ENABLED", "0");
        command
    };
    // Those of Ray that do a task, and the program that they start.
    let is_worker = |_: u32, name: &str, fleet: &str| {
        name.starts_with("ray::batch_of_jobs") || name.contains("fleet job") && name.contains(fleet)
    };
    survives(31, || descendants(cluster.id()), wrapper, is_worker);
}
