//! Fleets on engines that deal out jobs: real clusters of Ray, Slurm and Dask, on this machine and its loopback interface alone.
//! Workers are killed at random, jobs are lost and done twice; the merged bytes are those of one process.
#![cfg(target_os = "linux")]

mod dask;
mod kubernetes;
mod processes;
mod ray;
mod slurm;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::fleet::plant::{Plant, bounded, ok, quiet, start};
use crate::fleet::{merged, same, shards};
use crate::support::{Random, root, temporary, tree};
use processes::{descendants, kill, name_of};

/// The program that wrappers start.
const ABBE: &str = env!("CARGO_BIN_EXE_abbe-under-test");

/// Jobs of a batch.
const BATCH: &str = "4";

/// Kills that are enough.
const KILLS: usize = 6;

/// What takes longer hangs. Machines differ by three times, and other tests run beside.
const LONGEST: Duration = Duration::from_secs(240);

/// How often a wrapper is started whose engine hangs.
const TRIES: usize = 3;

/// Does the jobs of a plant by a wrapper that is started by `wrapper` in a folder, while every process under `engine` that does jobs may
/// be killed, and while another program does the same jobs. Then results are lost; in the end all is as one process makes it.
fn survives(
    seed: u64,
    engine: impl Fn() -> Vec<u32>,
    wrapper: impl Fn(&Path) -> Command,
    is_worker: impl Fn(u32, &str, &str) -> bool,
) {
    let mut random = Random::new(seed);
    let plant = Plant { weeks: (1..=4).collect(), ..Plant::of(10) };
    let one = temporary();
    plant.write(one.path());
    shards::added(one.path(), &mut Random::new(seed));
    ok(&quiet(one.path(), &["fleet", "plan", "fleet.yaml"]));
    ok(&quiet(one.path(), &["fleet", "run", "fleet.manifest.jsonl", "--workers", "1"]));
    let expected = merged(one.path());

    let folder = temporary();
    plant.write(folder.path());
    shards::added(folder.path(), &mut Random::new(seed));
    ok(&quiet(folder.path(), &["fleet", "plan", "fleet.yaml"]));
    let place = folder.path().display().to_string();
    let mut process = wrapper(folder.path()).spawn().expect("the wrapper starts");
    let (mut killed, mut twice) = (0, None);
    let (mut began, mut tries) = (Instant::now(), 1);
    while process.try_wait().expect("a process").is_none() {
        // An engine may wait for ever for workers that were killed: then somebody starts it again, and what is done stays done.
        if began.elapsed() > LONGEST {
            assert!(tries < TRIES, "the wrapper does not end");
            let all = descendants(process.id());
            let _ = process.kill();
            let _ = process.wait();
            for id in all.into_iter().filter(|id| name_of(*id).is_some()) {
                kill(id);
            }
            process = wrapper(folder.path()).spawn().expect("the wrapper starts");
            (began, tries) = (Instant::now(), tries + 1);
            continue;
        }
        let workers: Vec<u32> = (engine().into_iter().chain(descendants(process.id())))
            .filter(|id| name_of(*id).is_some_and(|name| is_worker(*id, &name, &place)))
            .collect();
        assert!(workers.len() < 100, "{} processes do jobs", workers.len());
        if killed < KILLS && !workers.is_empty() && random.unit() < 0.5 {
            killed += usize::from(kill(workers[random.below(workers.len())]));
            // Somebody else does the same jobs.
            if killed == 2 {
                twice = Some(start(
                    folder.path(),
                    &["fleet", "job", "fleet.manifest.jsonl", "--index", "3", "--count", "30"],
                ));
            }
        }
        std::thread::sleep(Duration::from_millis(25));
    }
    let ended = process.wait().expect("a process");
    if let Some(twice) = twice {
        ok(&bounded(twice, LONGEST));
    }
    assert!(killed > 0, "no worker was killed");
    assert!(ended.success(), "the wrapper ended with {ended}");
    let at = folder.path();
    same(&crate::fleet::contents_without_calibrations(at), &without_calibrations(&expected), "after the engine");
    // Some results are lost on the way home, the history with them.
    let store = at.join("fleet.results");
    for name in tree(&store).into_iter().filter(|name| name.extension() == Some("result".as_ref())) {
        if random.unit() < 0.3 {
            fs::remove_file(store.join(name)).expect("it goes");
        }
    }
    fs::remove_file(at.join("plant.sqlite")).expect("it goes");
    ok(&quiet(at, &["fleet", "run", "fleet.manifest.jsonl", "--workers", "2"]));
    same(&merged(at), &expected, "in the end");
}

fn without_calibrations<T: Clone>(files: &BTreeMap<PathBuf, T>) -> BTreeMap<PathBuf, T> {
    files
        .iter()
        .filter(|(name, _)| !name.starts_with("calibrations"))
        .map(|(name, it)| (name.clone(), it.clone()))
        .collect()
}

/// A wrapper of the folder `examples/fleet`.
fn example(name: &str) -> PathBuf {
    root().join("examples/fleet").join(name)
}

/// The Python packages that `.ci/run` installs for these tests.
fn packages() -> PathBuf {
    root().join("target/python-fleets")
}

/// Whether Python finds a module there, or on its own.
fn python_has(module: &str) -> bool {
    let mut python = Command::new("python3");
    let found = python.args(["-c", &format!("import {module}")]).env("PYTHONPATH", packages()).output();
    found.is_ok_and(|found| found.status.success())
}
