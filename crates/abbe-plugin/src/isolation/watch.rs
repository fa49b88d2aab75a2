//! Looks at the process of a plugin while it works.

use std::io;
use std::process::Child;
use std::sync::{Arc, Mutex, OnceLock, Weak};
use std::time::Duration;

use super::locked;
use crate::peer::Failure;
use crate::threads::{threads_of, too_many};

/// How often the threads of a process are counted.
const PERIOD: Duration = Duration::from_millis(20);

/// Ends a process that has too many threads, and says so in `lost`, as long as somebody has the process.
pub(super) fn watch(child: &Arc<Mutex<Child>>, lost: &Arc<OnceLock<Failure>>, who: &str) -> io::Result<()> {
    if threads_of(std::process::id()).is_none() {
        // This system does not tell.
        return Ok(());
    }
    let (child, lost, who) = (Arc::downgrade(child), lost.clone(), who.to_owned());
    let watcher = std::thread::Builder::new().name("plugin's threads".to_owned());
    watcher
        .spawn(move || {
            while is_in_order(&child, &lost, &who) {
                std::thread::sleep(PERIOD)
            }
        })
        .map(drop)
}

/// Whether the process goes on.
fn is_in_order(child: &Weak<Mutex<Child>>, lost: &OnceLock<Failure>, who: &str) -> bool {
    let Some(child) = child.upgrade() else { return false };
    let mut child = locked(&child);
    if !matches!(child.try_wait(), Ok(None)) {
        return false;
    }
    let Some(wrong) = too_many(child.id()) else { return true };
    let _ = lost.set(Failure::of(who, format!("{wrong}; its process was ended")));
    let _ = child.kill();
    false
}
