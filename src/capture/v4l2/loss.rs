//! What became of each frame: the driver's sequence numbers, and how long to wait for a silent
//! camera. Pure decisions; time and numbers are passed in.

use std::time::Duration;

/// Widens the driver's 32-bit frame numbers and counts those it skipped.
///
/// Numbers keep growing over a restart of the stream, where the driver begins again at 0.
#[derive(Clone, Copy, Debug, Default)]
pub struct SequenceCounter {
    last: Option<u32>,
    next: u64,
    from_zero: bool,
}

impl SequenceCounter {
    /// A counter for a driver that numbers the first frame of every stream 0 (`from_zero`), so
    /// that frames lost before the first one we get are known, or one that promises nothing.
    #[must_use]
    pub fn new(from_zero: bool) -> Self {
        Self {
            from_zero,
            ..Self::default()
        }
    }

    /// Takes the driver's number of a frame; returns its own number and how many were skipped.
    ///
    /// A number that does not grow means the driver began again: the frame is the next one.
    pub fn accept(&mut self, raw: u32) -> (u64, u64) {
        let gap = match self.last {
            None if self.from_zero => u64::from(raw),
            None => 0,
            // A step of more than half the range is a step back.
            Some(last) => match raw.wrapping_sub(last) {
                0 => 0,
                step if step > u32::MAX / 2 => 0,
                step => u64::from(step - 1),
            },
        };
        self.last = Some(raw);
        let number = self.next + gap;
        self.next = number + 1;
        (number, gap)
    }

    /// The stream was started anew: the driver's next number says nothing about losses.
    pub fn restart(&mut self) {
        self.last = None;
    }
}

/// What to do about a camera that sends nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Silence {
    /// Nothing unusual yet.
    Wait,
    /// Worth telling.
    Tell,
    /// Start the stream anew.
    Restart,
    /// It will not come back.
    GiveUp,
}

/// Silence worth telling: three frames of the slowest depth cameras (6 frames/s).
const TELL_AFTER: Duration = Duration::from_millis(500);
/// Silence after which the stream is started anew, again and again.
const RESTART_EVERY: Duration = Duration::from_secs(5);

/// Judges a silence of `silent` since the last frame, after `restarts` of the stream. A camera is
/// given up after `give_up`, but not before it was due for a restart.
#[must_use]
pub fn judge_silence(silent: Duration, restarts: u32, give_up: Option<Duration>) -> Silence {
    if give_up.is_some_and(|limit| silent >= limit.max(RESTART_EVERY)) {
        Silence::GiveUp
    } else if silent >= RESTART_EVERY * (restarts.saturating_add(1)) {
        Silence::Restart
    } else if silent >= TELL_AFTER {
        Silence::Tell
    } else {
        Silence::Wait
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_over_the_wrap_and_not_over_a_restart() {
        let mut counter = SequenceCounter::default();
        assert_eq!(
            counter.accept(7),
            (0, 0),
            "the first frame is not after a gap"
        );
        assert_eq!(counter.accept(8), (1, 0));
        assert_eq!(counter.accept(11), (4, 2));
        counter.restart();
        assert_eq!(counter.accept(3), (5, 0));
        let mut counter = SequenceCounter::new(true);
        assert_eq!(counter.accept(2), (2, 2), "0 and 1 were lost");
        counter.restart();
        assert_eq!(counter.accept(1), (4, 1), "and 0 of the new stream");
        let mut counter = SequenceCounter::default();
        counter.accept(u32::MAX - 1);
        assert_eq!(counter.accept(1), (3, 2), "MAX and 0 were skipped");
    }

    #[test]
    fn a_number_that_does_not_grow_is_the_next_frame() {
        let mut counter = SequenceCounter::default();
        counter.accept(50);
        assert_eq!(counter.accept(50), (1, 0));
        assert_eq!(counter.accept(0), (2, 0));
        assert_eq!(counter.accept(1), (3, 0));
    }

    #[test]
    fn a_silent_camera_is_told_restarted_then_given_up() {
        let at = |ms, restarts| judge_silence(Duration::from_millis(ms), restarts, None);
        assert_eq!(at(499, 0), Silence::Wait);
        assert_eq!(at(500, 0), Silence::Tell);
        assert_eq!(at(5_000, 0), Silence::Restart);
        assert_eq!(at(5_001, 1), Silence::Tell, "one restart per five seconds");
        assert_eq!(at(15_000, 2), Silence::Restart);
        assert_eq!(at(3_600_000, 719), Silence::Restart, "and so on");
        let limited = |ms, limit_s| {
            judge_silence(
                Duration::from_millis(ms),
                1,
                Some(Duration::from_secs(limit_s)),
            )
        };
        assert_eq!(limited(11_999, 12), Silence::Restart);
        assert_eq!(limited(12_000, 12), Silence::GiveUp);
        assert_eq!(
            limited(4_999, 0),
            Silence::Tell,
            "silence may be a slow start"
        );
        assert_eq!(limited(5_000, 0), Silence::GiveUp);
    }
}
