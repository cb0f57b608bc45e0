//! The clock the pipeline lives by, as a trait: tests run on one they wind themselves.

use std::time::Duration;

/// A device stamp farther than this from our own clock belongs to another clock, ns.
const SAME_CLOCK_NS: i64 = 10_000_000_000;

/// A monotonic clock in nanoseconds.
pub trait Clock: Sync {
    /// Now, ns. Only differences mean anything, except that [`Monotonic`] counts as V4L2 does.
    fn now_ns(&self) -> i64;
    /// Lets `time` pass.
    fn sleep(&self, time: Duration);
}

/// The machine's CLOCK_MONOTONIC, the clock V4L2 stamps its buffers with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Monotonic;

impl Clock for Monotonic {
    fn now_ns(&self) -> i64 {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        now.tv_sec * 1_000_000_000 + now.tv_nsec
    }

    fn sleep(&self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// When a live frame began to age: its device stamp where that is on our clock, else its arrival.
///
/// Stamps that lie in the future (some drivers give them) and stamps of another clock count from
/// the arrival, so an age is never negative and never absurd.
#[must_use]
pub fn live_stamp_ns(device_ns: i64, arrival_ns: i64) -> i64 {
    match arrival_ns.checked_sub(device_ns) {
        Some(transport) if (0..SAME_CLOCK_NS).contains(&transport) => device_ns,
        _ => arrival_ns,
    }
}

#[cfg(test)]
pub(crate) mod fake {
    //! A clock that moves only when told to.
    use super::Clock;
    use std::sync::atomic::{AtomicI64, Ordering};
    use std::time::Duration;

    #[derive(Debug, Default)]
    pub(crate) struct FakeClock(AtomicI64);

    impl FakeClock {
        pub(crate) fn advance(&self, ns: i64) {
            self.0.fetch_add(ns, Ordering::SeqCst);
        }
    }

    impl Clock for FakeClock {
        fn now_ns(&self) -> i64 {
            self.0.load(Ordering::SeqCst)
        }
        fn sleep(&self, time: Duration) {
            self.advance(i64::try_from(time.as_nanos()).unwrap());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_on_our_clock_is_kept() {
        assert_eq!(live_stamp_ns(1_000, 9_000), 1_000);
    }

    #[test]
    fn foreign_and_future_stamps_count_from_the_arrival() {
        assert_eq!(live_stamp_ns(9_001, 9_000), 9_000);
        assert_eq!(live_stamp_ns(0, 60_000_000_000), 60_000_000_000);
        assert_eq!(live_stamp_ns(i64::MIN, 5), 5);
    }
}
