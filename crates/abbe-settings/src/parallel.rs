//! Independent work on several threads.

use std::cell::RefCell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

thread_local! {
    static SHARED_WITH: RefCell<Option<Shared>> = const { RefCell::new(None) };
}

/// What the threads of one [`in_parallel`] share.
#[derive(Clone)]
struct Shared {
    /// Cores for all of them.
    cores: usize,
    /// How many of them are at work.
    working: Arc<AtomicUsize>,
}

/// Number of threads that work may start now: as many as there are cores for this process; where this thread is one of several that
/// [`in_parallel`] started, its share of those that they had, which grows when others of them have nothing more to do.
pub fn free_threads() -> usize {
    SHARED_WITH.with_borrow(|shared| match shared {
        Some(Shared { cores, working }) => (cores / working.load(Ordering::Relaxed).max(1)).max(1),
        None => cores(),
    })
}

/// Number of cores that this process may use, as the system says when it is asked first: an answer takes as long as a small fit.
fn cores() -> usize {
    static CORES: OnceLock<usize> = OnceLock::new();
    *CORES.get_or_init(|| std::thread::available_parallelism().map_or(1, usize::from))
}

/// Applies `work` to all items on `threads` threads ([`free_threads`] if none are given); the results are in the order of the items.
pub fn in_parallel<T: Sync, R: Send>(items: &[T], threads: Option<usize>, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let free = threads.unwrap_or_else(free_threads);
    let threads = free.min(items.len());
    if threads <= 1 {
        return items.iter().map(work).collect();
    }
    let next = AtomicUsize::new(0);
    let results: Vec<Mutex<Option<R>>> = items.iter().map(|_| Mutex::new(None)).collect();
    let shared = Shared { cores: free, working: Arc::new(AtomicUsize::new(threads)) };
    let take_part = || {
        let before = SHARED_WITH.replace(Some(shared.clone()));
        while let Some((item, result)) = {
            let index = next.fetch_add(1, Ordering::Relaxed);
            items.get(index).zip(results.get(index))
        } {
            *result.lock().unwrap_or_else(PoisonError::into_inner) = Some(work(item));
        }
        shared.working.fetch_sub(1, Ordering::Relaxed);
        SHARED_WITH.set(before);
    };
    std::thread::scope(|scope| {
        // Where the system gives no more threads, those that are there do it: this one at least.
        for missing in (1..threads).rev() {
            if std::thread::Builder::new().spawn_scoped(scope, take_part).is_err() {
                shared.working.fetch_sub(missing, Ordering::Relaxed);
                break;
            }
        }
        take_part();
    });
    results.into_iter().filter_map(|result| result.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

/// What two pieces of independent work make, side by side where a core is free.
pub fn both<A: Send, B: Send>(one: impl Fn() -> A + Sync, other: impl Fn() -> B + Sync) -> (A, B) {
    let (of_one, of_other) = (Mutex::new(None), Mutex::new(None));
    in_parallel(&[true, false], None, |is_first| match is_first {
        true => *of_one.lock().unwrap_or_else(PoisonError::into_inner) = Some(one()),
        false => *of_other.lock().unwrap_or_else(PoisonError::into_inner) = Some(other()),
    });
    let of_one = of_one.into_inner().unwrap_or_else(PoisonError::into_inner);
    let of_other = of_other.into_inner().unwrap_or_else(PoisonError::into_inner);
    (of_one.unwrap_or_else(&one), of_other.unwrap_or_else(&other))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tells the process of this test that it is the one without threads.
    const ALONE: &str = "ABBE_TEST_WITHOUT_THREADS";

    #[test]
    fn both_make_what_they_make() {
        assert_eq!(both(|| 1, || "two".to_owned()), (1, "two".to_owned()));
        assert_eq!(in_parallel(&[1, 2, 3], Some(3), |item| both(|| item + 1, free_threads).0), [2, 3, 4]);
    }

    /// Who is left alone takes the cores of those that have ended.
    #[test]
    fn the_last_one_has_all_threads() {
        assert_eq!(free_threads(), cores());
        let others_have_ended = || {
            SHARED_WITH
                .with_borrow(|shared| shared.as_ref().is_some_and(|shared| shared.working.load(Ordering::Relaxed) == 1))
        };
        let began = AtomicUsize::new(0);
        let found = in_parallel(&[true, false, false], Some(6), |stays| {
            began.fetch_add(1, Ordering::Relaxed);
            while began.load(Ordering::Relaxed) < 3 {
                std::thread::yield_now();
            }
            let first = free_threads();
            while *stays && !others_have_ended() {
                std::thread::yield_now();
            }
            (first, free_threads(), in_parallel(&[(), ()], None, |()| free_threads()))
        });
        let (_, at_last, within) = &found[0];
        assert!(*at_last == 6 && within.iter().all(|share| [3, 6].contains(share)), "{found:?}");
        assert!(found[1..].iter().all(|(first, ..)| [2, 3].contains(first)), "{found:?}");
        assert_eq!(free_threads(), cores());
    }

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
