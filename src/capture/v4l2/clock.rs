//! From the driver's buffer stamps to frame times.

use crate::frame::FrameTime;

/// What was done to a stamp that could not be used as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockNote {
    /// The stamp lay in the future; the arrival time was used.
    Future,
    /// The driver does not say its stamps are CLOCK_MONOTONIC; they look like it and are used.
    Unmarked,
    /// The stamp is on no clock we know; the arrival time was used.
    Unknown,
}

/// The oldest age a stamp without its clock's mark may have to be believed, ns.
const BELIEVABLE_AGE_NS: i64 = 2_000_000_000;

/// Maps stamps on CLOCK_MONOTONIC to device and wall time.
///
/// The offset between the two clocks is read once: a step of the wall clock does not tear
/// the intervals between frames.
#[derive(Clone, Copy, Debug)]
pub struct FrameClock {
    wall_minus_monotonic_ns: i64,
}

impl FrameClock {
    /// A clock from one reading of both, ns.
    #[must_use]
    pub fn new(monotonic_ns: i64, wall_ns: i64) -> Self {
        Self {
            wall_minus_monotonic_ns: wall_ns.saturating_sub(monotonic_ns),
        }
    }

    /// A clock from the machine's.
    #[must_use]
    pub fn now() -> Self {
        Self::new(monotonic_ns(), wall_ns())
    }

    /// The time of a frame stamped `stamp_ns` that arrived at `arrival_ns`.
    #[must_use]
    pub fn frame_time(
        &self,
        stamp_ns: i64,
        marked_monotonic: bool,
        arrival_ns: i64,
    ) -> (FrameTime, Option<ClockNote>) {
        let age = arrival_ns.saturating_sub(stamp_ns);
        let (device_ns, note) = match (marked_monotonic, age) {
            (true, ..0) => (arrival_ns, Some(ClockNote::Future)),
            (true, _) => (stamp_ns, None),
            (false, 0..=BELIEVABLE_AGE_NS) => (stamp_ns, Some(ClockNote::Unmarked)),
            (false, _) => (arrival_ns, Some(ClockNote::Unknown)),
        };
        (self.at(device_ns), note)
    }

    /// The same moment on both clocks, from the monotonic one.
    #[must_use]
    pub fn at(&self, device_ns: i64) -> FrameTime {
        FrameTime {
            device_ns,
            wall_ns: device_ns.saturating_add(self.wall_minus_monotonic_ns),
        }
    }

    /// The same moment on both clocks, from the wall clock.
    #[must_use]
    pub fn at_wall(&self, wall_ns: i64) -> FrameTime {
        FrameTime {
            device_ns: wall_ns.saturating_sub(self.wall_minus_monotonic_ns),
            wall_ns,
        }
    }
}

/// CLOCK_MONOTONIC now, ns: the clock of V4L2 stamps, so a frame's age is this minus its
/// `device_ns`.
#[must_use]
pub fn monotonic_ns() -> i64 {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the pointer is to a live timespec; the call writes nothing else. It cannot fail for
    // this clock, and leaves zero if it did.
    #[allow(unsafe_code)]
    unsafe {
        libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now);
    }
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}

/// The wall clock now, ns since the Unix epoch; 0 before it.
#[must_use]
pub fn wall_ns() -> i64 {
    std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .ok()
        .and_then(|age| i64::try_from(age.as_nanos()).ok())
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_believed_clamped_or_replaced() {
        let clock = FrameClock::new(1_000, 500_000);
        let time = |device_ns| FrameTime {
            device_ns,
            wall_ns: device_ns + 499_000,
        };
        assert_eq!(clock.frame_time(900, true, 1_000), (time(900), None));
        let future = clock.frame_time(2_000, true, 1_000);
        assert_eq!(future, (time(1_000), Some(ClockNote::Future)));
        let unmarked = clock.frame_time(900, false, 1_000);
        assert_eq!(unmarked, (time(900), Some(ClockNote::Unmarked)));
        let late = BELIEVABLE_AGE_NS * 3;
        let unknown = clock.frame_time(900, false, late);
        assert_eq!(unknown, (time(late), Some(ClockNote::Unknown)));
        let wild = clock.frame_time(i64::MAX, false, 1_000);
        assert_eq!(wild, (time(1_000), Some(ClockNote::Unknown)));
        assert_eq!(clock.at_wall(500_000), clock.at(1_000));
    }

    #[test]
    fn the_monotonic_clock_does_not_go_back() {
        let first = monotonic_ns();
        assert!(first > 0);
        assert!(monotonic_ns() >= first);
    }
}
