//! Processes that a test has started, and those that these have started.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The processes that a process has started, and theirs.
pub fn descendants(of: u32) -> Vec<u32> {
    let mut parents = Vec::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(id) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else { continue };
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        // The name of a program may have blanks and brackets.
        let after = stat.rsplit_once(") ").map(|(_, after)| after.to_owned()).unwrap_or_default();
        if let Some(parent) = after.split_whitespace().nth(1).and_then(|parent| parent.parse::<u32>().ok()) {
            parents.push((id, parent));
        }
    }
    let (mut found, mut next) = (BTreeSet::new(), vec![of]);
    while let Some(parent) = next.pop() {
        for (id, _) in parents.iter().filter(|(_, of)| *of == parent) {
            if found.insert(*id) {
                next.push(*id);
            }
        }
    }
    found.into_iter().collect()
}

/// The words that a process was started with.
pub fn name_of(process: u32) -> Option<String> {
    let words = fs::read(format!("/proc/{process}/cmdline")).ok()?;
    let text = String::from_utf8_lossy(&words).replace('\0', " ");
    (!text.trim().is_empty()).then_some(text)
}

pub fn kill(process: u32) -> bool {
    Command::new("kill").args(["-9", &process.to_string()]).output().is_ok_and(|output| output.status.success())
}

/// A service that ends with the test, with all that it has started.
pub struct Service(pub Child);

impl Service {
    pub fn id(&self) -> u32 {
        self.0.id()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let mut all = descendants(self.0.id());
        let _ = Command::new("kill").arg(self.0.id().to_string()).output();
        let began = Instant::now();
        while self.0.try_wait().is_ok_and(|ended| ended.is_none()) && began.elapsed() < Duration::from_secs(5) {
            all.extend(descendants(self.0.id()));
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.0.kill();
        let _ = self.0.wait();
        // What has ended in the meantime is no child of anybody.
        for id in all.into_iter().filter(|id| name_of(*id).is_some()) {
            kill(id);
        }
    }
}

/// A network of its own that has the loopback interface alone: services of engines listen on all interfaces that there are.
pub struct Loopback(Service);

impl Loopback {
    /// Why there can be none.
    pub fn missing() -> Option<String> {
        let user = Command::new("id").arg("-u").output().map(|output| output.stdout).unwrap_or_default();
        if user != b"0\n" {
            return Some("a network of its own needs root".to_owned());
        }
        let made = Command::new("unshare").args(["--net", "ip", "link", "set", "lo", "up"]).output();
        let is_made = made.is_ok_and(|made| made.status.success());
        (!is_made).then(|| "`unshare --net` and `ip` can make no network of its own here".to_owned())
    }

    pub fn new() -> Self {
        // Who looks up names is told of none by the C library where 127.0.0.1 is the only address.
        let script = "ip link set lo up && ip addr add 127.0.0.2/32 dev lo && echo up && exec sleep 1800";
        let mut command = Command::new("unshare");
        command.args(["--net", "sh", "-c", script]).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut held = command.spawn().expect("a network");
        let mut line = String::new();
        let output = held.stdout.take().expect("a pipe");
        std::io::BufRead::read_line(&mut std::io::BufReader::new(output), &mut line).expect("a line");
        assert_eq!(line, "up\n");
        Self(Service(held))
    }

    /// A program in this network.
    pub fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new("nsenter");
        command.arg(format!("--net=/proc/{}/ns/net", self.0.id())).arg("--").arg(program);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }
}

/// Asks again and again until it is so.
pub fn until(what: &str, most: Duration, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < most, "{what} after {most:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
}
