//! Work on several threads whose results are added up in the order of the items, as soon as they are there.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use abbe_core::{Result, in_parallel};

/// What has been added up so far.
struct Sum<R> {
    /// The next item whose result is added.
    next: usize,
    /// Results that wait for those of items before them.
    waiting: BTreeMap<usize, R>,
    all: Option<R>,
    /// The first item that failed.
    failed: Option<(usize, abbe_core::Error)>,
}

/// Applies `work` to all items and joins the results in the order of the items, so that the sum does not depend on how many threads
/// there are. Only results that wait for an earlier one are held. `told` gets the number of items that are done.
///
/// Fails with the error of the first item that fails; what comes after it is not begun.
pub(crate) fn in_order<T: Sync, R: Send>(
    items: &[T],
    threads: usize,
    work: impl Fn(&T) -> Result<R> + Sync,
    join: impl Fn(&mut R, R) -> Result<()> + Sync,
    told: impl Fn(usize) + Sync,
) -> Result<Option<R>> {
    let sum = Mutex::new(Sum { next: 0, waiting: BTreeMap::new(), all: None, failed: None });
    let numbered: Vec<(usize, &T)> = items.iter().enumerate().collect();
    in_parallel(&numbered, Some(threads), |(index, item)| {
        let has_failed =
            || sum.lock().unwrap_or_else(PoisonError::into_inner).failed.as_ref().is_some_and(|(at, _)| at < index);
        if has_failed() {
            return;
        }
        let found = work(item);
        let mut sum = sum.lock().unwrap_or_else(PoisonError::into_inner);
        sum.add(*index, found, &join);
        if sum.failed.is_none() {
            told(sum.next);
        }
    });
    let Sum { all, failed, .. } = sum.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.map_or(Ok(all), |(_, error)| Err(error))
}

impl<R> Sum<R> {
    /// Adds a result, and those that have waited for it.
    fn add(&mut self, index: usize, found: Result<R>, join: &impl Fn(&mut R, R) -> Result<()>) {
        match found {
            Ok(found) => drop(self.waiting.insert(index, found)),
            Err(error) => self.fail(index, error),
        }
        while let Some(found) = self.waiting.remove(&self.next) {
            let joined = match &mut self.all {
                Some(all) => join(all, found),
                None => {
                    self.all = Some(found);
                    Ok(())
                }
            };
            if let Err(error) = joined {
                self.fail(self.next, error);
            }
            self.next += 1;
        }
    }

    fn fail(&mut self, index: usize, error: abbe_core::Error) {
        if self.failed.as_ref().is_none_or(|(first, _)| index < *first) {
            self.failed = Some((index, error));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use abbe_core::Error;

    /// Later items are done sooner; the sum is in their order all the same.
    #[test]
    fn the_order_is_that_of_the_items() {
        let items: Vec<u64> = (0..40).collect();
        let work = |item: &u64| {
            std::thread::sleep(std::time::Duration::from_micros(40 * (item % 7)));
            Ok(vec![*item])
        };
        let join = |all: &mut Vec<u64>, more: Vec<u64>| {
            all.extend(more);
            Ok(())
        };
        for threads in [1, 2, 5] {
            assert_eq!(in_order(&items, threads, work, join, |_| ()).unwrap(), Some(items.clone()));
        }
        assert_eq!(in_order(&[], 3, work, join, |_| ()).unwrap(), None);
    }

    #[test]
    fn the_first_error_counts() {
        let items: Vec<u64> = (0..40).collect();
        let work = |item: &u64| match item % 10 {
            7 => Err(Error::data(format!("item {item}"))),
            _ => Ok(*item),
        };
        for threads in [1, 2, 5] {
            let error = in_order(&items, threads, work, |_, _| Ok(()), |_| ()).unwrap_err();
            assert_eq!(error.message, "item 7");
        }
        let join = |_: &mut u64, more: u64| if more == 3 { Err(Error::data("joined")) } else { Ok(()) };
        assert_eq!(in_order(&items[..6], 2, work, join, |_| ()).unwrap_err().message, "joined");
    }
}
