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
    /// From the last frame to the first.
    pub reverse: bool,
    /// First frame that is shown.
    pub from: u64,
    /// Frame that ends the playback, not shown itself.
    pub to: u64,
    /// Show this frame first and hold it until told to go on.
    pub hold_at: Option<u64>,
}

impl Default for PlayOptions {
    fn default() -> Self {
        Self {
            speed: 1.0,
            looped: false,
            reverse: false,
            from: 0,
            to: u64::MAX,
            hold_at: None,
        }
    }
}

/// What the user asks for while a recording plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// End.
    Stop,
    /// Hold the picture, or go on.
    Pause,
    /// So many frames on (or back) from the one shown, and hold.
    Step(i64),
    /// To this frame, and hold.
    To(u64),
}

/// A source of frames, one after another.
pub trait Frames {
    /// What ends the playback.
    type Error;
    /// A decoded frame put aside.
    type Kept;

    /// Number of frames.
    fn frames(&self) -> u64;

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

    /// Puts the frame last decoded aside.
    fn keep(&self) -> Self::Kept;

    /// Makes a frame that was put aside the one last decoded, as far as showing it goes.
    fn put_back(&mut self, kept: Self::Kept);
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
    /// Number of the first frame shown.
    pub first: Option<u64>,
    /// Number of the last frame shown.
    pub last: Option<u64>,
}

/// Longest single wait, so that `show` or the caller's commands are asked for often enough.
const LONGEST_WAIT: Duration = Duration::from_millis(20);

/// Plays `frames`: calls `show` with each frame's number when it is due. `command` is asked before
/// each wait and each frame.
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
    command: impl FnMut() -> Option<Command>,
    show: impl FnMut(&mut F, u64) -> Result<(), F::Error>,
) -> Result<PlayReport, F::Error> {
    let player = Player {
        walk: Walk::new(options, frames.frames()),
        frames,
        clock,
        command,
        show,
        pacer: Pacer::new(options.speed),
        report: PlayReport::default(),
    };
    player.run(options)
}

/// What comes after a frame.
enum Then {
    Next,
    Stop,
}

struct Player<'a, F: Frames, C, A, S> {
    frames: &'a mut F,
    clock: &'a mut C,
    command: A,
    show: S,
    walk: Walk<F::Kept>,
    pacer: Pacer,
    report: PlayReport,
}

impl<F, C, A, S> Player<'_, F, C, A, S>
where
    F: Frames,
    C: Clock,
    A: FnMut() -> Option<Command>,
    S: FnMut(&mut F, u64) -> Result<(), F::Error>,
{
    fn run(mut self, options: &PlayOptions) -> Result<PlayReport, F::Error> {
        if let Some(frame) = options.hold_at {
            self.go(frame)?;
            if let Then::Stop = self.hold()? {
                return Ok(self.report);
            }
        }
        loop {
            self.report.rounds += 1;
            let seen = self.report.shown + self.report.skipped;
            // a frame that was held is where the first round begins
            if self.report.rounds > 1 || options.hold_at.is_none() {
                self.walk.begin(self.frames)?;
            }
            let mut before: Option<i64> = None;
            let mut in_a_row = 0;
            while let Some((number, time_ns)) = self.walk.next(self.frames)? {
                let time_ns = if options.reverse {
                    time_ns.saturating_neg()
                } else {
                    time_ns
                };
                let step = before.map(|before| time_ns.saturating_sub(before));
                before = Some(time_ns);
                if let Then::Stop = self.present(number, time_ns, step, &mut in_a_row)? {
                    return Ok(self.report);
                }
            }
            let empty = self.report.shown + self.report.skipped == seen;
            if !options.looped || empty || (self.command)() == Some(Command::Stop) {
                return Ok(self.report);
            }
            self.pacer.restart();
        }
    }

    /// Waits until a frame is due and shows it, or leaves it out.
    fn present(
        &mut self,
        number: u64,
        time_ns: i64,
        step: Option<i64>,
        in_a_row: &mut u64,
    ) -> Result<Then, F::Error> {
        let mut due = self.pacer.due(time_ns, self.clock.now());
        loop {
            match (self.command)() {
                None => {}
                Some(Command::Stop) => return Ok(Then::Stop),
                Some(Command::Pause) => {
                    let shown = self.report.shown;
                    if let Then::Stop = self.hold()? {
                        return Ok(Then::Stop);
                    }
                    if self.report.shown > shown {
                        return Ok(Then::Next); // the user has gone elsewhere
                    }
                    due = self.pacer.due(time_ns, self.clock.now());
                }
                Some(command) => {
                    self.obey(command)?;
                    return self.hold();
                }
            }
            let pace = match self.pacer.pace(due, step, self.clock.now()) {
                Pace::Skip if *in_a_row == MOST_SKIPPED => Pace::Show,
                pace => pace,
            };
            match pace {
                Pace::Wait(time) => self.clock.wait(time.min(LONGEST_WAIT)),
                Pace::Show => {
                    *in_a_row = 0;
                    self.show(number)?;
                    return Ok(Then::Next);
                }
                Pace::Skip => {
                    *in_a_row += 1;
                    self.report.skipped += 1;
                    return Ok(Then::Next);
                }
            }
        }
    }

    /// Holds the picture until told to go on.
    fn hold(&mut self) -> Result<Then, F::Error> {
        loop {
            match (self.command)() {
                None => self.clock.wait(LONGEST_WAIT),
                Some(Command::Stop) => return Ok(Then::Stop),
                Some(Command::Pause) => {
                    self.pacer.restart();
                    return Ok(Then::Next);
                }
                Some(command) => self.obey(command)?,
            }
        }
    }

    fn obey(&mut self, command: Command) -> Result<(), F::Error> {
        match command {
            Command::Step(frames) => {
                let shown = self.report.last.unwrap_or(0);
                self.go(shown.saturating_add_signed(frames))
            }
            Command::To(frame) => self.go(frame),
            Command::Stop | Command::Pause => Ok(()),
        }
    }

    /// Shows a frame out of the order, at once.
    fn go(&mut self, frame: u64) -> Result<(), F::Error> {
        match self.walk.go(self.frames, frame)? {
            Some(number) => self.show(number),
            None => Ok(()),
        }
    }

    fn show(&mut self, number: u64) -> Result<(), F::Error> {
        (self.show)(self.frames, number)?;
        self.report.shown += 1;
        self.report.first.get_or_insert(number);
        self.report.last = Some(number);
        Ok(())
    }
}

/// Frames kept at the most while a recording is played backwards.
const MOST_KEPT: usize = 64;

/// The order in which frames come. Backwards, the frames from a key frame on are decoded once, in
/// order, and put aside; of a longer group the last [`MOST_KEPT`] are, and the others later.
struct Walk<K> {
    reverse: bool,
    from: u64,
    to: u64,
    /// Frame that the source decodes next.
    at: u64,
    /// Backwards: the frame shown last, or the end.
    above: u64,
    kept: Vec<(u64, i64, K)>,
}

impl<K> Walk<K> {
    fn new(options: &PlayOptions, frames: u64) -> Self {
        Self {
            reverse: options.reverse,
            from: options.from,
            to: options.to.min(frames),
            at: 0,
            above: 0,
            kept: Vec::new(),
        }
    }

    /// Goes to where the playback begins.
    fn begin<F: Frames<Kept = K>>(&mut self, frames: &mut F) -> Result<(), F::Error> {
        self.kept.clear();
        self.above = self.to;
        if !self.reverse {
            self.at = frames.seek(self.from)?;
        }
        Ok(())
    }

    /// The next frame: its number and time, ns.
    fn next<F: Frames<Kept = K>>(
        &mut self,
        frames: &mut F,
    ) -> Result<Option<(u64, i64)>, F::Error> {
        if self.reverse {
            return self.back(frames);
        }
        while let Some((number, time_ns)) = frames.advance()? {
            self.at = number + 1;
            if number >= self.to {
                break;
            }
            if number >= self.from {
                return Ok(Some((number, time_ns)));
            }
        }
        Ok(None)
    }

    fn back<F: Frames<Kept = K>>(
        &mut self,
        frames: &mut F,
    ) -> Result<Option<(u64, i64)>, F::Error> {
        while self.kept.is_empty() && self.above > self.from {
            let target = self.above - 1;
            let key = frames.seek(target)?;
            while let Some((number, time_ns)) = frames.advance()? {
                if number > target {
                    break;
                }
                if number >= self.from {
                    if self.kept.len() == MOST_KEPT {
                        self.kept.remove(0);
                    }
                    self.kept.push((number, time_ns, frames.keep()));
                }
                if number == target {
                    break;
                }
            }
            // frames that cannot be decoded are passed over
            self.above = self.kept.first().map_or(key.min(target), |kept| kept.0);
        }
        let Some((number, time_ns, kept)) = self.kept.pop() else {
            return Ok(None);
        };
        frames.put_back(kept);
        Ok(Some((number, time_ns)))
    }

    /// Decodes the frame of this number, or the next that can be decoded; gives its number.
    fn go<F: Frames<Kept = K>>(
        &mut self,
        frames: &mut F,
        frame: u64,
    ) -> Result<Option<u64>, F::Error> {
        let Some(last) = self.to.checked_sub(1).filter(|last| *last >= self.from) else {
            return Ok(None);
        };
        let target = frame.clamp(self.from, last);
        self.kept.clear();
        self.above = target;
        if self.reverse || self.at != target {
            self.at = frames.seek(target)?;
        }
        while let Some((number, _)) = frames.advance()? {
            self.at = number + 1;
            if number >= target {
                return Ok(Some(number));
            }
        }
        Ok(None)
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
        /// The frame that would be shown.
        now: u64,
        decoded: Vec<u64>,
        cost: Duration,
        clock: &'a Cell<Duration>,
    }

    impl Frames for Tape<'_> {
        type Error = Infallible;
        type Kept = u64;
        fn frames(&self) -> u64 {
            self.times.len() as u64
        }
        fn keep(&self) -> u64 {
            self.at - 1
        }
        fn put_back(&mut self, kept: u64) {
            self.now = kept;
        }
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
            self.now = self.at;
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
        let ended = Cell::new(0u64);
        let count = times.len() as u64;
        run_with(times, cost_ms, options, |shown| {
            if shown.is_some_and(|number| number + 1 == count) {
                ended.set(ended.get() + 1);
            }
            (shown.is_none() && ended.get() >= rounds).then_some(Command::Stop)
        })
    }

    /// As [`run`]; `command` is told each frame shown, and asked with `None`.
    fn run_with(
        times: Vec<i64>,
        cost_ms: u64,
        options: PlayOptions,
        command: impl Fn(Option<u64>) -> Option<Command>,
    ) -> (Vec<(u64, u64)>, PlayReport) {
        let clock = Cell::new(Duration::from_secs(9));
        let mut tape = Tape {
            times,
            every: 10,
            at: 0,
            now: 0,
            decoded: vec![],
            cost: Duration::from_millis(cost_ms),
            clock: &clock,
        };
        let mut shown = vec![];
        let report = play(
            &mut tape,
            &options,
            &mut TestClock(&clock),
            || command(None),
            |tape, number| {
                assert_eq!(tape.now, number, "another frame is in the picture");
                command(Some(number));
                let now = clock.get() - Duration::from_secs(9);
                shown.push((number, now.as_millis() as u64));
                Ok(())
            },
        );
        let Ok(report) = report;
        (shown, report)
    }

    /// Obeys a script: the command stands beside the number of frames shown before it.
    fn scripted(script: &[(usize, Command)], options: PlayOptions) -> Vec<u64> {
        let shown = Cell::new(0);
        let at = Cell::new(0);
        let (frames, _) = run_with(even(50), 0, options, |number| {
            if number.is_some() {
                shown.set(shown.get() + 1);
                return None;
            }
            let (after, command) = script.get(at.get())?;
            if shown.get() < *after {
                return None;
            }
            at.set(at.get() + 1);
            Some(*command)
        });
        frames.into_iter().map(|(number, _)| number).collect()
    }

    #[test]
    fn frames_are_stepped_through_both_ways() {
        use Command::{Pause, Step, Stop, To};
        let shown = scripted(
            &[
                (3, Step(-1)),
                (4, Step(-1)),
                (5, Step(-1)),
                (6, Step(1)),
                (7, To(33)),
                (8, Step(5)),
                (9, Step(1000)),
                (10, To(20)),
                (11, Pause),
                (13, Stop),
            ],
            PlayOptions::default(),
        );
        assert_eq!(shown, [0, 1, 2, 1, 0, 0, 1, 33, 38, 49, 20, 21, 22]);
        let held = PlayOptions {
            hold_at: Some(17),
            ..PlayOptions::default()
        };
        let shown = scripted(
            &[(1, Step(-1)), (2, Pause), (4, Pause), (4, Pause), (5, Stop)],
            held,
        );
        assert_eq!(shown, [17, 16, 17, 18, 19]);
    }

    #[test]
    fn backwards_shows_each_frame_in_its_time() {
        let reverse = PlayOptions {
            reverse: true,
            from: 3,
            to: 24,
            ..PlayOptions::default()
        };
        let (shown, report) = run(even(50), 0, reverse, 9);
        let expected: Vec<_> = (0..21).map(|n| (23 - n, n * 40)).collect();
        assert_eq!(shown, expected);
        assert_eq!((report.first, report.last), (Some(23), Some(3)));
        let shown = scripted(
            &[
                (2, Command::Step(7)),
                (3, Command::Pause),
                (5, Command::Stop),
            ],
            PlayOptions {
                reverse: true,
                to: 40,
                ..reverse
            },
        );
        assert_eq!(shown, [39, 38, 39, 38, 37]);
    }

    #[test]
    fn a_long_group_is_decoded_in_pieces_backwards() {
        let clock = Cell::new(Duration::ZERO);
        let mut tape = Tape {
            times: even(200),
            every: 200,
            at: 0,
            now: 0,
            decoded: vec![],
            cost: Duration::ZERO,
            clock: &clock,
        };
        let reverse = PlayOptions {
            reverse: true,
            ..PlayOptions::default()
        };
        let mut walk = Walk::new(&reverse, 200);
        walk.begin(&mut tape).unwrap();
        for expected in (0..200).rev() {
            assert_eq!(
                walk.next(&mut tape).unwrap().map(|(n, _)| n),
                Some(expected)
            );
            assert!(walk.kept.len() < MOST_KEPT);
        }
        assert_eq!(walk.next(&mut tape).unwrap(), None);
    }

    /// A clock that oversleeps by 300 µs each time, as systems do.
    struct Sleepy(Duration);

    impl Clock for Sleepy {
        fn now(&self) -> Duration {
            self.0
        }
        fn wait(&mut self, time: Duration) {
            self.0 += time + Duration::from_micros(300);
        }
    }

    #[test]
    fn an_hour_drifts_by_less_than_a_millisecond() {
        // 90 fps, times rounded to the nanosecond as a source does
        let time = |n: u64| (n as f64 * 1e9 / 90.0).round() as i64;
        for speed in [1.0, 0.7] {
            let mut pacer = Pacer::new(speed);
            let mut clock = Sleepy(Duration::from_secs(5));
            let start = clock.now();
            for n in 0..90 * 3600 {
                let due = pacer.due(time(n), clock.now());
                while let Pace::Wait(left) = pacer.pace(due, None, clock.now()) {
                    clock.wait(left.min(LONGEST_WAIT));
                }
                let shown = clock.now() - start;
                let right = time(n) as f64 * 1e-9 / speed;
                let late = shown.as_secs_f64() - right;
                // each is late by one oversleep, none by the sum of them
                assert!((-1e-6..1e-3).contains(&late), "frame {n}: {late} s");
            }
        }
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
