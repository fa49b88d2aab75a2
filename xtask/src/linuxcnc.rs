//! The files for LinuxCNC, proven on LinuxCNC itself (`tests/outside/linuxcnc.rs`), and the loop of measuring and
//! correcting on it (`tests/outside/measured.rs`).

use std::process::{Command, Stdio};

use crate::gate::FEATURES;
use crate::{Outcome, cargo, run as run_command};

/// The user that runs the control: it refuses root.
const USER: &str = "abbe-linuxcnc";

/// The tests that run the control.
pub const TESTS: [&str; 2] = ["outside::linuxcnc", "outside::measured"];

/// Runs the tests on the control; they say what is missing where they are skipped. With `create`, the user is created first.
pub fn run(create: bool) -> Outcome {
    if create {
        create_user()?;
    }
    let whole = ["test", "--workspace", "--test", "whole", "--locked"];
    run_command(cargo(&[&whole[..], &FEATURES, &["--", "--nocapture"], &TESTS].concat()))
}

/// Creates the user, unless it is there; without LinuxCNC, or if this is not root, nothing is done.
pub fn create_user() -> Outcome {
    let is_there = succeeds("id", &[USER]);
    if is_there || !succeeds("sh", &["-c", "command -v linuxcnc && test \"$(id -u)\" = 0"]) {
        return Ok(());
    }
    let mut command = Command::new("useradd");
    command.args(["--system", "--shell", "/bin/sh", USER]);
    run_command(command)
}

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    let status = Command::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok_and(|status| status.success())
}
