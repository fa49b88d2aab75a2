//! An interpreter of LinuxCNC that is ended by something else than Abbe.

use std::os::unix::fs::PermissionsExt;

use crate::controls::law::Machine;
use crate::support::{printed, program, read, temporary, write};

/// It is told as that, and what it had started does not go on.
#[test]
fn an_interpreter_that_is_ended_is_told_and_leaves_nothing_running() {
    let folder = temporary();
    let at = folder.path();
    write(&at.join("errors.calibration.json"), &Machine::public("three-axis").calibration.to_json().expect("JSON"));
    write(&at.join("part.ngc"), "G21\nG1 X1 Y1 Z1 F100\nM2\n");
    let started = at.join("started");
    let interpreter = at.join("rs274");
    write(
        &interpreter,
        &format!("#!/bin/sh\nsleep 300 >/dev/null 2>&1 &\necho $! > '{}'\nkill -9 $$\n", started.display()),
    );
    std::fs::set_permissions(&interpreter, std::fs::Permissions::from_mode(0o755)).expect("it can be run");
    let path = format!("{}:{}", at.display(), std::env::var("PATH").unwrap_or_default());
    let arguments = ["compensate", "errors.calibration.json", "part.ngc", "--dialect", "linuxcnc", "--write-out"];
    let found = printed(
        program(at, &[&arguments[..], &["--start", "X0,Y0,Z0", "--out", "done.ngc"]].concat()).env("PATH", path),
    );
    assert!(found.status == 1 && found.stderr.contains("was ended before the end of the program"), "{}", found.stderr);
    assert!(!at.join("done.ngc").exists());
    let status = format!("/proc/{}/stat", read(&started).trim());
    // Who has ended, and is waited for by nobody yet, has the state Z.
    let is_gone = || std::fs::read_to_string(&status).map_or(true, |stat| stat.contains(") Z "));
    assert!((0..100).any(|_| is_gone() || {
        std::thread::sleep(std::time::Duration::from_millis(50));
        false
    }));
}
