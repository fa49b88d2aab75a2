//! Independent work on several threads.

use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

thread_local! {
    static ONE_OF_SEVERAL: Cell<bool> = const { Cell::new(false) };
}

/// Whether this thread is one of several that [`in_parallel`] started: no core is free for more threads.
fn is_one_of_several() -> bool {
    ONE_OF_SEVERAL.get()
}

/// Number of threads that work may start: as many as there are cores for this process, or one where this thread itself is one of
/// several that [`in_parallel`] started.
pub fn free_threads() -> usize {
    if is_one_of_several() { 1 } else { cores() }
}

/// Number of cores that this process may use.
fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Applies `work` to all items on `threads` threads (as many as there are cores if none are given); the results are in the
/// order of the items.
pub fn in_parallel<T: Sync, R: Send>(items: &[T], threads: Option<usize>, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let threads = threads.unwrap_or_else(cores).min(items.len());
    if threads <= 1 {
        return items.iter().map(work).collect();
    }
    let next = AtomicUsize::new(0);
    let results: Vec<Mutex<Option<R>>> = items.iter().map(|_| Mutex::new(None)).collect();
    let take_part = || {
        let before = ONE_OF_SEVERAL.replace(true);
        while let Some((item, result)) = {
            let index = next.fetch_add(1, Ordering::Relaxed);
            items.get(index).zip(results.get(index))
        } {
            *result.lock().unwrap_or_else(PoisonError::into_inner) = Some(work(item));
        }
        ONE_OF_SEVERAL.set(before);
    };
    std::thread::scope(|scope| {
        // Where the system gives no more threads, those that are there do it: this one at least.
        for _ in 1..threads {
            if std::thread::Builder::new().spawn_scoped(scope, take_part).is_err() {
                break;
            }
        }
        take_part();
    });
    results.into_iter().filter_map(|result| result.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tells the process of this test that it is the one without threads.
    const ALONE: &str = "ABBE_TEST_WITHOUT_THREADS";

    /// A process that asks for a stack which no machine has room for can make no thread.
    #[cfg(target_os = "linux")]
    #[test]
    fn without_threads_the_calling_one_does_all() {
        let items: Vec<usize> = (0..1000).collect();
        let squares = in_parallel(&items, Some(4), |item| item * item);
        assert!(squares.iter().enumerate().all(|(item, square)| *square == item * item) && squares.len() == 1000);
        if std::env::var_os(ALONE).is_some() {
            assert!(std::thread::Builder::new().spawn(|| ()).is_err(), "threads can be made");
            return;
        }
        let name = "parallel::tests::without_threads_the_calling_one_does_all";
        let output = std::process::Command::new(std::env::current_exe().expect("this program"))
            .args([name, "--exact", "--test-threads=1"])
            .env(ALONE, "1")
            .env("RUST_MIN_STACK", (1_u64 << 46).to_string())
            .output()
            .expect("it starts");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && text.contains("1 passed"),
            "{text}{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}
