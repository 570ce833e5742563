//! Frames worked on by several threads and taken in their order, with few of them in memory.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use anyhow::Result;

use crate::options::thread_pool;

/// Results that may wait to be taken, a thread: one being made while one waits.
const AHEAD: usize = 2;

/// What the threads share.
struct Queue<R> {
    state: Mutex<State<R>>,
    changed: Condvar,
}

struct State<R> {
    /// The item that is begun next.
    next: usize,
    /// How many results were taken.
    taken: usize,
    results: BTreeMap<usize, Result<R>>,
    stopped: bool,
}

impl<R> Queue<R> {
    fn lock(&self) -> MutexGuard<'_, State<R>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State<R>>) -> MutexGuard<'a, State<R>> {
        self.changed.wait(state).unwrap_or_else(PoisonError::into_inner)
    }

    /// The next item to work on, once no more than `ahead` results wait; `None` if there is none.
    fn begin(&self, items: usize, ahead: usize) -> Option<usize> {
        let mut state = self.lock();
        while !state.stopped && state.next < items && state.next >= state.taken + ahead {
            state = self.wait(state);
        }
        let index = state.next;
        state.next += 1;
        (!state.stopped && index < items).then_some(index)
    }

    fn finish(&self, index: usize, result: Result<R>) {
        self.lock().results.insert(index, result);
        self.changed.notify_all();
    }

    fn take(&self, index: usize) -> Result<R> {
        let mut state = self.lock();
        loop {
            if let Some(result) = state.results.remove(&index) {
                state.taken += 1;
                self.changed.notify_all();
                return result;
            }
            state = self.wait(state);
        }
    }

    fn stop(&self) {
        self.lock().stopped = true;
        self.changed.notify_all();
    }
}

/// Calls `work` on the items, several at once on `threads` threads, and `take` with the results, one after another in
/// the order of the items. At most two results a thread are in memory. The first error in the order of the items ends
/// it, whatever the threads.
///
/// # Errors
/// Those of `work` and `take`.
pub fn in_order<T: Sync, R: Send>(
    threads: usize,
    items: &[T],
    work: impl Fn(&T) -> Result<R> + Sync,
    mut take: impl FnMut(&T, R) -> Result<()>,
) -> Result<()> {
    let state = State { next: 0, taken: 0, results: BTreeMap::new(), stopped: false };
    let queue = Queue { state: Mutex::new(state), changed: Condvar::new() };
    let workers = threads.min(items.len()).max(1);
    // What does not divide goes to the first.
    let own = |worker| threads.max(1) / workers + usize::from(worker < threads % workers);
    let pools = (0..workers).map(|worker| thread_pool(Some(own(worker)))).collect::<Result<Vec<_>>>()?;
    let (queue, work) = (&queue, &work);
    std::thread::scope(|scope| {
        for pool in pools {
            scope.spawn(move || {
                while let Some(index) = queue.begin(items.len(), AHEAD * workers) {
                    queue.finish(index, pool.install(|| work(&items[index])));
                }
            });
        }
        let taken = items.iter().enumerate().try_for_each(|(index, item)| take(item, queue.take(index)?));
        queue.stop();
        taken
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use anyhow::bail;

    use super::*;

    #[test]
    fn results_come_in_order_and_few_wait() {
        let items: Vec<usize> = (0..60).collect();
        for threads in [1, 2, 5, 100] {
            let (begun, mut taken) = (AtomicUsize::new(0), Vec::new());
            in_order(
                threads,
                &items,
                |&item| {
                    begun.fetch_add(1, Ordering::SeqCst);
                    std::thread::sleep(Duration::from_micros((item as u64 * 7919) % 500));
                    Ok(3 * item)
                },
                |&item, result| {
                    assert_eq!(result, 3 * item);
                    taken.push(item);
                    let ahead = begun.load(Ordering::SeqCst) - taken.len();
                    assert!(ahead <= AHEAD * threads.min(items.len()), "{ahead} ahead of {threads} threads");
                    Ok(())
                },
            )
            .unwrap();
            assert_eq!(taken, items);
        }
        in_order(2, &[], |_: &u8| Ok(()), |_, ()| bail!("nothing to take")).unwrap();
    }

    #[test]
    fn the_first_error_ends_it_whatever_the_threads() {
        let items: Vec<usize> = (0..50).collect();
        for threads in [1, 3, 8] {
            let mut taken = Vec::new();
            let work = |&item: &usize| if item % 7 == 6 { bail!("item {item}") } else { Ok(()) };
            let error = in_order(threads, &items, work, |&item, ()| {
                taken.push(item);
                Ok(())
            });
            assert_eq!(error.unwrap_err().to_string(), "item 6");
            assert_eq!(taken, [0, 1, 2, 3, 4, 5]);
        }
        let error =
            in_order(4, &items, |_| Ok(()), |&item, ()| if item == 3 { bail!("full") } else { Ok(()) });
        assert_eq!(error.unwrap_err().to_string(), "full");
    }
}
