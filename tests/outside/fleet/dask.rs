//! Dask.

use std::path::Path;

use super::processes::{Loopback, descendants, name_of};
use super::{ABBE, BATCH, example, packages, python_has, survives};
use crate::support::skipped;

#[test]
fn workers_that_are_killed_under_dask_change_nothing() {
    let test = "workers_that_are_killed_under_dask_change_nothing";
    if !python_has("distributed") {
        return skipped(test, "the Python package dask[distributed] is not installed");
    }
    if let Some(why) = Loopback::missing() {
        return skipped(test, &why);
    }
    let network = Loopback::new();
    let wrapper = |at: &Path| {
        let mut command = network.command("python3");
        command.arg(example("dask_fleet.py")).args(["fleet.manifest.jsonl", BATCH]).current_dir(at);
        command.env("ABBE", ABBE).env("PYTHONPATH", packages());
        command
    };
    // The program, and a process of Dask that has started it: one that starts itself is given up by Dask when it dies.
    let is_job = |name: &str| name.contains("fleet job");
    let has_job = |id| descendants(id).into_iter().filter_map(name_of).any(|name| is_job(&name));
    let is_worker = |id: u32, name: &str, fleet: &str| {
        is_job(name) && name.contains(fleet) || name.contains("multiprocessing.spawn") && has_job(id)
    };
    survives(51, Vec::new, wrapper, is_worker);
}
