//! Frames worked on by several threads and taken in their order, with few of them in memory.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

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
    /// What the work gave, or the panic that it ended with.
    results: BTreeMap<usize, thread::Result<Result<R>>>,
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

    fn finish(&self, index: usize, result: thread::Result<Result<R>>) {
        self.lock().results.insert(index, result);
        self.changed.notify_all();
    }

    fn take(&self, index: usize) -> Result<R> {
        let mut state = self.lock();
        loop {
            if let Some(result) = state.results.remove(&index) {
                state.taken += 1;
                self.changed.notify_all();
                drop(state);
                return result.unwrap_or_else(|panic| resume_unwind(panic));
            }
            state = self.wait(state);
        }
    }
}

/// Lets the threads end when the one that takes results has ended, be it by a panic: they would wait for it for ever.
struct StopAtEnd<'a, R>(&'a Queue<R>);

impl<R> Drop for StopAtEnd<'_, R> {
    fn drop(&mut self) {
        self.0.lock().stopped = true;
        self.0.changed.notify_all();
    }
}

/// Calls `work` on the items, several at once on `threads` threads, and `take` with the results on the caller's, one after
/// another in the order of the items. At most two results a thread are in memory. The first error in the order of the
/// items ends it, whatever the threads.
///
/// # Errors
/// Those of `work` and `take`.
///
/// # Panics
/// If `work` or `take` do.
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
    thread::scope(|scope| {
        // Before there are threads: one that cannot be started must not leave the others waiting.
        let _stop = StopAtEnd(queue);
        for pool in pools {
            scope.spawn(move || {
                while let Some(index) = queue.begin(items.len(), AHEAD * workers) {
                    // Whoever takes the result gets the panic; here it would only leave the others waiting.
                    let work = AssertUnwindSafe(|| pool.install(|| work(&items[index])));
                    queue.finish(index, catch_unwind(work));
                }
            });
        }
        items.iter().enumerate().try_for_each(|(index, item)| take(item, queue.take(index)?))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc;
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
                    thread::sleep(Duration::from_micros((item as u64 * 7919) % 500));
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

    #[test]
    fn a_panic_ends_it_too() {
        let items: Vec<usize> = (0..50).collect();
        // The item at which the work panics, and the one at which the result is taken.
        for (threads, at_work, at_take) in [(1, 6, 99), (3, 6, 99), (8, 0, 99), (1, 99, 4), (3, 99, 4)] {
            let (sender, receiver) = mpsc::channel();
            let items = items.clone();
            // On a thread of its own, for a program that hangs is no result of a test.
            thread::spawn(move || {
                let mut taken = 0;
                let work = |&item: &usize| if item == at_work { panic!("work") } else { Ok(()) };
                let ended = catch_unwind(AssertUnwindSafe(|| {
                    in_order(threads, &items, work, |&item, ()| {
                        assert!(item != at_take, "take");
                        taken += 1;
                        Ok(())
                    })
                }));
                let panic = ended.expect_err("a panic");
                let said = panic.downcast_ref::<&str>().map(|said| (*said).to_owned());
                sender.send((said, taken)).expect("a test that waits");
            });
            let expected = if at_work < 50 { ("work", at_work) } else { ("take", at_take) };
            let (said, taken) = receiver.recv_timeout(Duration::from_secs(60)).expect("an end");
            assert_eq!((said.as_deref(), taken), (Some(expected.0), expected.1), "{threads} threads");
        }
    }
}
