//! The program as a user starts it, with bounds on its time, its memory and what it writes.

use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// How long a case may take. A machine that does other things, too, is slow.
pub const LIMIT: Duration = Duration::from_secs(120);

/// KiB of memory that a case may have.
const MEMORY: u64 = 6 << 20;

/// Bytes that are kept of what a process says.
const KEPT: u64 = 4 << 20;

/// How the program ended.
pub struct Ended {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

/// What a process may have, beside its time and memory.
#[derive(Debug, Clone, Copy, Default)]
pub struct Bounds {
    /// Units of 512 bytes that a file may have; writing more fails as on a full disk.
    pub file_size: Option<u64>,
    /// Processor time, s.
    pub processor_s: Option<u64>,
    /// Files that may be open at once.
    pub open_files: Option<u64>,
}

/// A command in a folder.
pub fn command(program: &Path, folder: &Path, arguments: &[&str], bounds: Bounds) -> Command {
    let mut limits = format!("ulimit -v {MEMORY}; ");
    if let Some(size) = bounds.file_size {
        // A signal would end the program before it could say a word; without it writing fails.
        limits.push_str(&format!("ulimit -f {size}; "));
    }
    if let Some(seconds) = bounds.processor_s {
        limits.push_str(&format!("ulimit -t {seconds}; "));
    }
    if let Some(files) = bounds.open_files {
        limits.push_str(&format!("ulimit -n {files}; "));
    }
    let mut command = Command::new("sh");
    command.args(["-c", &format!("{limits}exec \"$0\" \"$@\"")]).arg(program).args(arguments);
    command.current_dir(folder).env("ABBE_CAMPAIGN_PROGRAM", "1").env("NO_COLOR", "1").stdin(Stdio::null());
    command
}

/// Runs the program in a folder; none if it had to be ended.
pub fn ended(program: &Path, folder: &Path, arguments: &[&str], bounds: Bounds) -> Option<Ended> {
    let mut command = command(program, folder, arguments, bounds);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    let said = [read(child.stdout.take()), read(child.stderr.take())];
    let status = waited(&mut child, LIMIT);
    let [stdout, stderr] = said.map(|said| said.join().expect("what was said"));
    Some(Ended { status: status?, stdout, stderr })
}

/// Reads what a process says while it works.
fn read(from: Option<impl Read + Send + 'static>) -> std::thread::JoinHandle<String> {
    std::thread::spawn(move || {
        let (mut said, Some(mut from)) = (Vec::new(), from) else { return String::new() };
        let _ = (&mut from).take(KEPT).read_to_end(&mut said);
        let _ = std::io::copy(&mut from, &mut std::io::sink());
        String::from_utf8_lossy(&said).into_owned()
    })
}

/// Waits for a process; ends it when the time is over.
pub fn waited(child: &mut Child, limit: Duration) -> Option<ExitStatus> {
    let start = Instant::now();
    loop {
        match child.try_wait().expect("the process can be waited for") {
            Some(status) => return Some(status),
            None if start.elapsed() > limit => {
                let _ = child.kill();
                let _ = child.wait();
                return None;
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
}
