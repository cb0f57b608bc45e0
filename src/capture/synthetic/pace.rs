//! A camera that does not wait, as a pure function of the clock.
//!
//! It imitates a driver with six buffers: a finished frame takes a free buffer or is lost; a
//! reader gets the oldest one. Sequence numbers count lost frames too, so a late reader sees gaps.

/// Buffers of the imitated driver.
const BUFFERS: usize = 6;
/// Length of a stall, and of an unplug, nanoseconds.
pub(super) const PAUSE_NS: i64 = 1_000_000_000;

/// When frames are due, nanoseconds after the first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Schedule {
    period_ns: f64,
    /// A pause of a second follows every so many frames, of two kinds; 0 = never.
    pauses: [u64; 2],
}

impl Schedule {
    pub fn new(frames_per_second: f64, pauses: [u64; 2]) -> Self {
        Self {
            period_ns: 1e9 / frames_per_second,
            pauses,
        }
    }

    /// When frame `index` is due.
    pub fn due_ns(&self, index: u64) -> i64 {
        let pauses = self
            .pauses
            .map(|every| index.checked_div(every).unwrap_or(0));
        let pauses = i64::try_from(pauses[0].saturating_add(pauses[1])).unwrap_or(i64::MAX);
        ((index as f64 * self.period_ns) as i64).saturating_add(pauses.saturating_mul(PAUSE_NS))
    }

    /// Number of frames due at `now_ns` or before.
    fn produced(&self, now_ns: i64) -> u64 {
        // due_ns grows with the index: first index due after now
        let (mut low, mut high) = (0, (now_ns.max(0) as f64 / self.period_ns) as u64 + 2);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.due_ns(middle) <= now_ns {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        low
    }
}

/// What the reader finds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    /// This frame has been waiting.
    Ready(u64),
    /// The next frame, and when it is due.
    Due(u64, i64),
}

/// The driver's side: filled buffers and the next frame number.
#[derive(Clone, Debug)]
pub(super) struct Driver {
    schedule: Schedule,
    next: u64,
    filled: [u64; BUFFERS],
    count: usize,
}

impl Driver {
    pub fn new(schedule: Schedule) -> Self {
        Self {
            schedule,
            next: 0,
            filled: [0; BUFFERS],
            count: 0,
        }
    }

    /// The reader asks at `now_ns`. A [`Turn::Ready`] frame leaves its buffer.
    pub fn turn(&mut self, now_ns: i64) -> Turn {
        let produced = self.schedule.produced(now_ns).max(self.next);
        while self.count < BUFFERS && self.next < produced {
            self.filled[self.count] = self.next;
            self.count += 1;
            self.next += 1;
        }
        // no buffer was free for the rest
        self.next = produced;
        if self.count == 0 {
            return Turn::Due(self.next, self.schedule.due_ns(self.next));
        }
        let oldest = self.filled[0];
        self.filled.rotate_left(1);
        self.count -= 1;
        Turn::Ready(oldest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn a_reader_in_time_gets_every_frame() {
        let mut driver = Driver::new(Schedule::new(100.0, [0, 0]));
        for index in 0..50 {
            let due = index as i64 * 10 * MS;
            assert_eq!(driver.turn(due - 1), Turn::Due(index, due));
            assert_eq!(driver.turn(due), Turn::Ready(index));
        }
    }

    #[test]
    fn a_late_reader_gets_the_six_oldest_and_then_a_gap() {
        let mut driver = Driver::new(Schedule::new(100.0, [0, 0]));
        assert_eq!(driver.turn(0), Turn::Ready(0));
        // frames 1 to 6 fill the buffers, 7 to 9 find none
        for number in 1..=6 {
            assert_eq!(driver.turn(95 * MS), Turn::Ready(number));
        }
        assert_eq!(driver.turn(97 * MS), Turn::Due(10, 100 * MS));
        assert_eq!(driver.turn(101 * MS), Turn::Ready(10));
    }

    #[test]
    fn a_stall_moves_all_later_frames_by_a_second() {
        let schedule = Schedule::new(100.0, [5, 0]);
        assert_eq!(schedule.due_ns(4), 40 * MS);
        assert_eq!(schedule.due_ns(5), 1_050 * MS);
        assert_eq!(schedule.due_ns(10), 2_100 * MS);
        for now in [0, 40, 41, 1_049, 1_050, 2_099, 2_100].map(|ms| ms * MS) {
            let slow = (0..1000).take_while(|&i| schedule.due_ns(i) <= now).count();
            assert_eq!(schedule.produced(now), slow as u64, "at {now}");
        }
    }
}
