//! Paced playback: which frame is shown when.
//!
//! Every frame is decoded, since the next one may refer to it; a frame is not *shown* when the one
//! after it is due already. The decision is a pure function of times ([`Pacer::pace`]); [`play`]
//! drives it with a clock and a source of frames that are handed in, so tests run on a clock of
//! their own.

mod pacer;
#[cfg(test)]
mod tests;
mod walk;

pub use pacer::{Pace, Pacer};

use std::time::{Duration, Instant};
use walk::Walk;

/// After this many frames left out in a row one is shown, however late: a machine too slow to keep
/// up still shows something.
const MOST_SKIPPED: u64 = 5;

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
