//! How many threads a process may have: counted by who started it, since no limit of the system counts those of one process.

use std::num::NonZero;

/// Threads that a plugin may have beside two for each processor.
const THREADS: usize = 128;

/// Threads that the process of a plugin may have. Pools of one thread for each processor are usual.
pub(crate) fn most_threads() -> usize {
    THREADS + 2 * std::thread::available_parallelism().map_or(1, NonZero::get)
}

/// The number of threads of a process, if the system tells it.
#[cfg(target_os = "linux")]
pub(crate) fn threads_of(process: u32) -> Option<usize> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    status.lines().find_map(|line| line.strip_prefix("Threads:")?.trim().parse().ok())
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn threads_of(_: u32) -> Option<usize> {
    None
}

/// What is wrong with a process, if it has too many.
pub(crate) fn too_many(process: u32) -> Option<String> {
    let (most, threads) = (most_threads(), threads_of(process)?);
    (threads > most).then(|| format!("started more than {most} threads"))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::sync::Barrier;

    use super::{threads_of, too_many};

    #[test]
    fn threads_of_a_process_are_counted() {
        let own = std::process::id();
        let before = threads_of(own).expect("this process is there");
        let barrier = Barrier::new(41);
        std::thread::scope(|scope| {
            (0..40).for_each(|_| drop(scope.spawn(|| barrier.wait())));
            assert!(threads_of(own).expect("it is there") >= 40.max(before));
            assert_eq!(too_many(own), None);
            barrier.wait();
        });
        assert_eq!(threads_of(u32::MAX), None);
    }
}
