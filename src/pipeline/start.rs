//! Streams that begin together: none takes a frame while another still makes ready, which would cost
//! that frame its time.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Longest wait between two looks at whether the run is over.
const NAP: Duration = Duration::from_millis(20);

/// Streams that are not ready yet.
#[derive(Debug)]
struct Line {
    missing: Mutex<usize>,
    complete: Condvar,
}

/// One stream's place in the line. Dropped, it keeps nobody waiting.
#[derive(Debug)]
pub struct Place(Arc<Line>);

/// Places for so many streams.
#[must_use]
pub fn together(streams: usize) -> Vec<Place> {
    let line = Arc::new(Line {
        missing: Mutex::new(streams),
        complete: Condvar::new(),
    });
    (0..streams).map(|_| Place(Arc::clone(&line))).collect()
}

impl Place {
    /// This stream is ready: waits until all are, or until `stopping`.
    pub(super) fn wait(self, stopping: &dyn Fn() -> bool) {
        let line = Arc::clone(&self.0);
        drop(self);
        let mut missing = line.missing.lock().unwrap_or_else(PoisonError::into_inner);
        while *missing > 0 && !stopping() {
            let waited = line.complete.wait_timeout(missing, NAP);
            missing = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let missing = self.0.missing.lock();
        *missing.unwrap_or_else(PoisonError::into_inner) -= 1;
        self.0.complete.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn all_begin_when_the_last_is_ready_or_gone() {
        let ready = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for (n, place) in together(4).into_iter().enumerate() {
                let ready = &ready;
                scope.spawn(move || {
                    ready.fetch_add(1, Ordering::SeqCst);
                    if n > 0 {
                        // the first one fails and is dropped
                        place.wait(&|| false);
                        assert_eq!(ready.load(Ordering::SeqCst), 4);
                    }
                });
            }
        });
    }

    #[test]
    fn a_stop_ends_the_wait() {
        let mut places = together(2);
        let place = places.pop().unwrap();
        place.wait(&|| true);
        assert_eq!(places.len(), 1);
    }
}
