//! Paced playback: which frame is shown when.
//!
//! Every frame is decoded, since the next one may refer to it; a frame is not *shown* when the one
//! after it is due already. The decision is a pure function of times ([`Pacer::pace`]); [`play`]
//! drives it with a clock and a source of frames that are handed in, so tests run on a clock of
//! their own.

use std::time::{Duration, Instant};

/// A gap longer than this in the recording (a pause, a clock that jumped) is played as this long.
const LONGEST_GAP: Duration = Duration::from_secs(5);
/// After this many frames left out in a row one is shown, however late: a machine too slow to keep
/// up still shows something.
const MOST_SKIPPED: u64 = 5;

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

/// What is played, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlayOptions {
    /// Times as fast as recorded.
    pub speed: f64,
    /// Begin again at the end, for ever.
    pub looped: bool,
    /// First frame that is shown.
    pub from: u64,
    /// Frame that ends the playback, not shown itself.
    pub to: u64,
}

impl Default for PlayOptions {
    fn default() -> Self {
        Self {
            speed: 1.0,
            looped: false,
            from: 0,
            to: u64::MAX,
        }
    }
}

/// A source of frames, one after another.
pub trait Frames {
    /// What ends the playback.
    type Error;

    /// Goes to where frame `frame` can be decoded from; gives the number of the frame that
    /// [`advance`](Self::advance) decodes next.
    ///
    /// # Errors
    /// The source's own.
    fn seek(&mut self, frame: u64) -> Result<u64, Self::Error>;

    /// Decodes the next frame; gives its number and time (ns), or `None` at the end.
    ///
    /// # Errors
    /// The source's own.
    fn advance(&mut self) -> Result<Option<(u64, i64)>, Self::Error>;
}

/// A clock to play by.
pub trait Clock {
    /// Time since any fixed moment.
    fn now(&self) -> Duration;
    /// Lets this much time pass.
    fn wait(&mut self, time: Duration);
}

/// The machine's clock.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock(Instant);

impl Default for SystemClock {
    fn default() -> Self {
        Self(Instant::now())
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        self.0.elapsed()
    }

    fn wait(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// What a playback did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PlayReport {
    /// Frames shown.
    pub shown: u64,
    /// Frames decoded and left out because they were late.
    pub skipped: u64,
    /// Rounds begun.
    pub rounds: u64,
}

/// Longest single wait, so that `show` or the caller's stop flag is asked often enough.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// Plays `frames`: calls `show` with each frame's number when it is due. `keep_on` is asked before
/// each wait and each frame; `false` ends the playback.
///
/// A frame is late when the time of one whole frame has gone since it was due: the gap to the
/// frame before stands for the gap to the next, which is not decoded yet. The last frame may be
/// left out so, too.
///
/// # Errors
/// What the source or `show` say.
pub fn play<F: Frames>(
    frames: &mut F,
    options: &PlayOptions,
    clock: &mut impl Clock,
    mut keep_on: impl FnMut() -> bool,
    mut show: impl FnMut(&mut F, u64) -> Result<(), F::Error>,
) -> Result<PlayReport, F::Error> {
    let mut report = PlayReport::default();
    let mut pacer = Pacer::new(options.speed);
    loop {
        report.rounds += 1;
        let seen = report.shown + report.skipped;
        frames.seek(options.from)?;
        let mut step = None;
        let mut in_a_row = 0;
        let mut last_ns = None;
        while let Some((number, time_ns)) = frames.advance()? {
            if number >= options.to || !keep_on() {
                break;
            }
            if number < options.from {
                continue;
            }
            if let Some(last_ns) = last_ns.replace(time_ns) {
                step = Some(time_ns.saturating_sub(last_ns));
            }
            let due = pacer.due(time_ns, clock.now());
            loop {
                let pace = match pacer.pace(due, step, clock.now()) {
                    Pace::Skip if in_a_row == MOST_SKIPPED => Pace::Show,
                    pace => pace,
                };
                match pace {
                    Pace::Wait(time) => {
                        clock.wait(time.min(LONGEST_WAIT));
                        if !keep_on() {
                            return Ok(report);
                        }
                    }
                    Pace::Show => {
                        show(frames, number)?;
                        report.shown += 1;
                        in_a_row = 0;
                        break;
                    }
                    Pace::Skip => {
                        report.skipped += 1;
                        in_a_row += 1;
                        break;
                    }
                }
            }
        }
        let empty = report.shown + report.skipped == seen;
        if !options.looped || empty || !keep_on() {
            return Ok(report);
        }
        pacer.restart();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::convert::Infallible;

    const MS: i64 = 1_000_000;

    /// Frames at these times, a key frame each `every`; decoding one takes `cost` on the clock.
    struct Tape<'a> {
        times: Vec<i64>,
        every: u64,
        at: u64,
        decoded: Vec<u64>,
        cost: Duration,
        clock: &'a Cell<Duration>,
    }

    impl Frames for Tape<'_> {
        type Error = Infallible;
        fn seek(&mut self, frame: u64) -> Result<u64, Infallible> {
            self.at = frame / self.every * self.every;
            Ok(self.at)
        }
        fn advance(&mut self) -> Result<Option<(u64, i64)>, Infallible> {
            let Some(time) = self.times.get(self.at as usize) else {
                return Ok(None);
            };
            self.clock.set(self.clock.get() + self.cost);
            self.decoded.push(self.at);
            self.at += 1;
            Ok(Some((self.at - 1, *time)))
        }
    }

    struct TestClock<'a>(&'a Cell<Duration>);

    impl Clock for TestClock<'_> {
        fn now(&self) -> Duration {
            self.0.get()
        }
        fn wait(&mut self, time: Duration) {
            self.0.set(self.0.get() + time);
        }
    }

    /// Plays; gives the frames shown with the times (ms) they were shown at, and the report.
    fn run(
        times: Vec<i64>,
        cost_ms: u64,
        options: PlayOptions,
        rounds: u64,
    ) -> (Vec<(u64, u64)>, PlayReport) {
        let clock = Cell::new(Duration::from_secs(9));
        let mut tape = Tape {
            times,
            every: 10,
            at: 0,
            decoded: vec![],
            cost: Duration::from_millis(cost_ms),
            clock: &clock,
        };
        let mut shown = vec![];
        let begun = Cell::new(0u64);
        let report = play(
            &mut tape,
            &options,
            &mut TestClock(&clock),
            || begun.get() < rounds,
            |tape, number| {
                if number + 1 == tape.times.len() as u64 {
                    begun.set(begun.get() + 1);
                }
                let now = clock.get() - Duration::from_secs(9);
                shown.push((number, now.as_millis() as u64));
                Ok(())
            },
        );
        let Ok(report) = report;
        (shown, report)
    }

    fn even(count: i64) -> Vec<i64> {
        (0..count).map(|n| 777 + n * 40 * MS).collect()
    }

    #[test]
    fn frames_are_shown_at_their_times() {
        let (shown, report) = run(even(25), 0, PlayOptions::default(), 9);
        let expected: Vec<_> = (0..25).map(|n| (n, n * 40)).collect();
        assert_eq!(shown, expected);
        assert_eq!((report.shown, report.skipped, report.rounds), (25, 0, 1));
        let fast = PlayOptions {
            speed: 4.0,
            ..PlayOptions::default()
        };
        let (shown, _) = run(even(25), 0, fast, 9);
        assert_eq!(shown, (0..25).map(|n| (n, n * 10)).collect::<Vec<_>>());
    }

    #[test]
    fn decoding_time_does_not_add_up() {
        let (shown, _) = run(even(25), 30, PlayOptions::default(), 9);
        assert_eq!(shown[0], (0, 30));
        assert_eq!(shown[24], (24, 30 + 24 * 40));
    }

    #[test]
    fn late_frames_are_decoded_and_not_shown() {
        let (shown, report) = run(even(101), 60, PlayOptions::default(), 9);
        assert_eq!(report.shown + report.skipped, 101);
        assert!(report.skipped > 30, "{report:?}");
        // decoding needs 60 ms a frame for 40 ms of film: it cannot keep up, but goes on showing
        let gap = shown.windows(2).map(|pair| pair[1].0 - pair[0].0).max();
        assert_eq!(gap, Some(MOST_SKIPPED + 1), "{shown:?}");
    }

    #[test]
    fn a_range_is_decoded_from_its_key_frame() {
        let range = PlayOptions {
            from: 14,
            to: 17,
            ..PlayOptions::default()
        };
        let (shown, _) = run(even(25), 0, range, 9);
        assert_eq!(shown, [(14, 0), (15, 40), (16, 80)]);
    }

    #[test]
    fn a_loop_begins_again_at_once_and_ends_on_demand() {
        let looped = PlayOptions {
            looped: true,
            ..PlayOptions::default()
        };
        let (shown, report) = run(even(3), 0, looped, 3);
        let expected = [
            (0, 0),
            (1, 40),
            (2, 80),
            (0, 80),
            (1, 120),
            (2, 160),
            (0, 160),
            (1, 200),
            (2, 240),
        ];
        assert_eq!(shown, expected);
        assert_eq!(report.rounds, 3);
        let (shown, report) = run(vec![], 0, looped, 3);
        assert!(
            shown.is_empty() && report.rounds == 1,
            "an empty loop must end"
        );
    }

    #[test]
    fn odd_times_and_speeds_stop_nothing() {
        let times = vec![5, i64::MIN, i64::MAX, 0, 40 * MS];
        for speed in [1.0, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e300] {
            let options = PlayOptions {
                speed,
                ..PlayOptions::default()
            };
            let (shown, report) = run(times.clone(), 0, options, 9);
            assert_eq!(report.shown, 5, "speed {speed}: {shown:?}");
            assert!(shown.last().unwrap().1 <= 4 * 5000);
        }
    }
}
