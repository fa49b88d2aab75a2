//! Programs that are started to do a part of the work.

use std::process::{Child, Command};

/// Lets a program that is started, and all that it starts, be ended together.
pub fn apart(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}

/// Ends a program that was started [`apart`] with all that it has started: that would go on writing, and keep its output open.
pub fn end(child: &mut Child) {
    #[cfg(unix)]
    let _ = rustix::process::kill_process_group(rustix::process::Pid::from_child(child), rustix::process::Signal::KILL);
    let _ = child.kill().and_then(|()| child.wait());
}
