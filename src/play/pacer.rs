//! When a frame is due: times of the recording on the clock of the player.

use std::time::Duration;

/// A gap longer than this in the recording (a pause, a clock that jumped) is played as this long.
const LONGEST_GAP: Duration = Duration::from_secs(5);

/// What to do with a decoded frame now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Not due yet: wait this long.
    Wait(Duration),
    /// Show it.
    Show,
    /// The next frame is due already: go on without showing this one.
    Skip,
}

/// Turns the times of a recording into times of the playing clock.
#[derive(Clone, Debug)]
pub struct Pacer {
    speed: f64,
    /// Time of the frame before, ns, and when it was due.
    last: Option<(i64, Duration)>,
}

impl Pacer {
    /// Plays `speed` times as fast as recorded. A speed that is not a number above 0 plays as fast
    /// as the machine can.
    #[must_use]
    pub fn new(speed: f64) -> Self {
        Self { speed, last: None }
    }

    /// When a frame taken at `time_ns` (ns) is due, on a clock that reads `now`; frames come in
    /// the order they are played. The first is due at once; time that runs backwards counts as
    /// no time.
    pub fn due(&mut self, time_ns: i64, now: Duration) -> Duration {
        let due = match self.last {
            None => now,
            Some((last_ns, last_due)) => last_due + self.gap(last_ns, time_ns),
        };
        self.last = Some((time_ns, due));
        due
    }

    /// What to do at `now` with a frame that is due at `due` and followed by one taken
    /// `step_ns` (ns) later, where it is known that one follows.
    #[must_use]
    pub fn pace(&self, due: Duration, step_ns: Option<i64>, now: Duration) -> Pace {
        if now < due {
            return Pace::Wait(due - now);
        }
        let follower = step_ns.map(|step| due + self.gap(0, step));
        match follower {
            Some(next) if next > due && next <= now => Pace::Skip,
            _ => Pace::Show,
        }
    }

    /// Begins anew: the next frame is due at once (after a jump, at each round of a loop).
    pub fn restart(&mut self) {
        self.last = None;
    }

    fn gap(&self, from_ns: i64, to_ns: i64) -> Duration {
        let recorded = to_ns.saturating_sub(from_ns).max(0) as f64 * 1e-9;
        let played = (recorded / self.speed).min(LONGEST_GAP.as_secs_f64());
        // an unpaced player (speed 0, infinite, not a number) waits for nothing
        if self.speed > 0.0 && played.is_finite() {
            Duration::from_secs_f64(played)
        } else {
            Duration::ZERO
        }
    }
}
