//! The queue between capture and model: it either waits for room or gives up its oldest item.
//!
//! A ring split in two halves cannot evict the oldest from the writing side, so this is a short
//! queue under one lock. It holds a handful of boxes and is touched twice per frame.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

struct State<T> {
    items: VecDeque<T>,
    closed: bool,
}

struct Inner<T> {
    state: Mutex<State<T>>,
    capacity: usize,
    changed: Condvar,
}

impl<T> Inner<T> {
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, guard: MutexGuard<'a, State<T>>) -> MutexGuard<'a, State<T>> {
        self.changed
            .wait(guard)
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }
}

/// The writing end; dropping it lets the reader take what is left and then ends it.
pub struct MailboxSender<T>(Arc<Inner<T>>);

/// The reading end; dropping it refuses every later item.
pub struct MailboxReceiver<T>(Arc<Inner<T>>);

/// A queue of at most `capacity` items (at least 1).
#[must_use]
pub fn mailbox<T>(capacity: usize) -> (MailboxSender<T>, MailboxReceiver<T>) {
    let capacity = capacity.max(1);
    let inner = Arc::new(Inner {
        state: Mutex::new(State {
            items: VecDeque::with_capacity(capacity),
            closed: false,
        }),
        capacity,
        changed: Condvar::new(),
    });
    (MailboxSender(Arc::clone(&inner)), MailboxReceiver(inner))
}

impl<T> MailboxSender<T> {
    /// Puts `item` without waiting and returns the oldest waiting item where there was no room.
    ///
    /// # Errors
    /// The item itself, when the reader is gone.
    pub fn put_latest(&self, item: T) -> Result<Option<T>, T> {
        let mut state = self.0.lock();
        if state.closed {
            return Err(item);
        }
        let evicted = if state.items.len() == self.0.capacity {
            state.items.pop_front()
        } else {
            None
        };
        state.items.push_back(item);
        // who is woken finds the lock free
        drop(state);
        self.0.changed.notify_all();
        Ok(evicted)
    }

    /// Puts `item`, waiting for room.
    ///
    /// # Errors
    /// The item itself, when the reader is gone.
    pub fn put_wait(&self, item: T) -> Result<(), T> {
        let mut state = self.0.lock();
        while !state.closed && state.items.len() == self.0.capacity {
            state = self.0.wait(state);
        }
        if state.closed {
            return Err(item);
        }
        state.items.push_back(item);
        drop(state);
        self.0.changed.notify_all();
        Ok(())
    }
}

/// What waiting for an item for some time gave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wait<T> {
    /// The oldest item.
    Item(T),
    /// None came in time (or the wait was cut short).
    TimedOut,
    /// The writer is gone and nothing is left.
    Closed,
}

impl<T> MailboxReceiver<T> {
    /// The oldest waiting item, waiting at most `time` for one.
    #[must_use]
    pub fn take_within(&self, time: Duration) -> Wait<T> {
        let mut state = self.0.lock();
        if state.items.is_empty() && !state.closed {
            let waited = self.0.changed.wait_timeout(state, time);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        match state.items.pop_front() {
            Some(item) => {
                self.0.changed.notify_all();
                Wait::Item(item)
            }
            None if state.closed => Wait::Closed,
            None => Wait::TimedOut,
        }
    }

    /// The oldest waiting item, waiting for one; `None` when the writer is gone and nothing is left.
    #[must_use]
    pub fn take(&self) -> Option<T> {
        let mut state = self.0.lock();
        loop {
            if let Some(item) = state.items.pop_front() {
                self.0.changed.notify_all();
                return Some(item);
            }
            if state.closed {
                return None;
            }
            state = self.0.wait(state);
        }
    }
}

impl<T> Drop for MailboxSender<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

impl<T> Drop for MailboxReceiver<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        /// Against the obvious model: a list that loses its head when it is full.
        #[test]
        fn the_oldest_goes_first(capacity in 1usize..5, takes in proptest::collection::vec(any::<bool>(), 0..60)) {
            let (tx, rx) = mailbox(capacity);
            let mut model: Vec<usize> = Vec::new();
            let (mut put, mut taken, mut evicted) = (0usize, 0usize, 0usize);
            for take in takes {
                if take && !model.is_empty() {
                    prop_assert_eq!(rx.take(), Some(model.remove(0)));
                    taken += 1;
                } else {
                    let expected = (model.len() == capacity).then(|| model.remove(0));
                    model.push(put);
                    let got = tx.put_latest(put).unwrap();
                    prop_assert_eq!(got, expected);
                    evicted += usize::from(got.is_some());
                    put += 1;
                }
            }
            drop(tx);
            while let Some(item) = rx.take() {
                prop_assert_eq!(item, model.remove(0));
                taken += 1;
            }
            prop_assert!(model.is_empty());
            prop_assert_eq!(put, taken + evicted);
        }
    }

    #[test]
    fn a_wait_ends_with_an_item_in_vain_or_with_the_writer() {
        let (tx, rx) = mailbox(1);
        assert_eq!(rx.take_within(Duration::ZERO), Wait::TimedOut);
        tx.put_wait(5).unwrap();
        drop(tx);
        assert_eq!(rx.take_within(Duration::ZERO), Wait::Item(5));
        assert_eq!(rx.take_within(Duration::from_secs(60)), Wait::Closed);
    }

    #[test]
    fn waiting_loses_nothing_and_keeps_the_order() {
        let (tx, rx) = mailbox(2);
        let got = std::thread::scope(|scope| {
            scope.spawn(move || {
                for n in 0..1000 {
                    tx.put_wait(n).unwrap();
                }
            });
            std::iter::from_fn(|| rx.take()).collect::<Vec<u32>>()
        });
        assert_eq!(got, (0..1000).collect::<Vec<_>>());
    }

    #[test]
    fn a_reader_that_left_refuses_the_item() {
        let (tx, rx) = mailbox(1);
        drop(rx);
        assert_eq!(tx.put_latest(1), Err(1));
        assert_eq!(tx.put_wait(2), Err(2));
    }

    #[test]
    fn a_reader_that_leaves_frees_a_waiting_writer() {
        let (tx, rx) = mailbox(1);
        tx.put_wait(1).unwrap();
        std::thread::scope(|scope| {
            let writer = scope.spawn(|| tx.put_wait(2));
            drop(rx);
            assert_eq!(writer.join().unwrap(), Err(2));
        });
    }
}
