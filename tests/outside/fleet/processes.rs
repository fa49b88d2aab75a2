//! Processes that a test has started, and those that these have started.

use std::collections::BTreeSet;
use std::fs;
use std::process::{Child, Command};
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
        all.into_iter().for_each(|id| drop(kill(id)));
    }
}

/// A port of the loopback interface that nobody listens on.
pub fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("its address").port()
}

/// Asks again and again until it is so.
pub fn until(what: &str, most: Duration, mut is_so: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_so() {
        assert!(began.elapsed() < most, "{what} after {most:?}");
        std::thread::sleep(Duration::from_millis(100));
    }
}
