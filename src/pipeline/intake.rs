//! The capture stage: asks the source, keeps its losses, paces a replay, knows when to end.

use super::clock::live_stamp_ns;
use super::error::{PipelineError, Stage};
use super::packet::{Packet, Span};
use super::stages::{Shared, locked};
use super::statistics::DropCause;
use super::{Options, Pace};
use crate::capture::{FrameSource, Next};
use std::time::Duration;

/// Longest uninterrupted sleep, so that a stop is noticed.
const NAP: Duration = Duration::from_millis(50);
/// A single thread that is late never skips more frames in a row than this.
const MOST_SKIPPED: u32 = 30;

/// A recording whose reading is so far behind its clock never catches up: it goes on from now.
const MOST_BEHIND_NS: i64 = 500_000_000;

/// What came of asking for a frame.
pub(super) enum Taken {
    /// The packet holds a frame.
    Frame,
    /// Nothing yet; ask again.
    Again,
    /// No more frames.
    End,
}

/// The source and where it stands.
pub(super) struct Intake<'a> {
    source: &'a mut dyn FrameSource,
    options: &'a Options,
    /// One thread does all: being late shows here, not in a queue.
    alone: bool,
    started_ns: i64,
    /// Frames from before `started_ns` may still come, and are thrown away.
    stale: bool,
    taken: u64,
    first_device_ns: Option<i64>,
    last_device_ns: i64,
    /// Least time between two frames so far, 0 before there were two.
    period_ns: i64,
    /// What reading the last frame took.
    reading_ns: i64,
    skipped: u32,
    said: Option<String>,
    /// Reading fell behind the recording's clock.
    slow: bool,
}

impl<'a> Intake<'a> {
    pub(super) fn new(
        source: &'a mut dyn FrameSource,
        options: &'a Options,
        alone: bool,
        now_ns: i64,
    ) -> Self {
        Self {
            source,
            options,
            alone,
            started_ns: now_ns,
            stale: false,
            taken: 0,
            first_device_ns: None,
            last_device_ns: 0,
            period_ns: 0,
            reading_ns: 0,
            skipped: 0,
            said: None,
            slow: false,
        }
    }

    /// The stream begins at `now_ns`: what a live camera gave before, while all was made ready, is
    /// not part of it.
    pub(super) fn begin(&mut self, now_ns: i64) {
        self.started_ns = now_ns;
        self.stale = true;
    }

    /// As [`Options::stage_threads`].
    pub(super) fn stage_threads(&self) -> usize {
        self.options.stage_threads
    }

    pub(super) fn pace(&self) -> Pace {
        self.options.pace
    }

    /// True where a frame that finds no room pushes the oldest out instead of waiting.
    pub(super) fn drops_oldest(&self) -> bool {
        self.options.pace != Pace::Block
    }

    /// Fills `packet` with the next frame.
    pub(super) fn take(&mut self, packet: &mut Packet, shared: &Shared<'_>) -> Taken {
        if shared.stopping() || self.options.frames.is_some_and(|most| self.taken >= most) {
            return Taken::End;
        }
        self.wait_to_read(shared);
        let start = shared.clock.now_ns();
        let duration_ns = self
            .options
            .duration
            .map(|d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX));
        if matches!(self.options.pace, Pace::Live | Pace::Keep)
            && duration_ns.is_some_and(|most| start - self.started_ns >= most)
        {
            return Taken::End;
        }
        (packet.color, packet.act) = (None, None);
        let next = shared.guarded(Stage::Capture, self.taken, || {
            Ok(self.source.next(&mut packet.depth))
        });
        locked(&shared.statistics).losses(self.source.losses());
        match next {
            None => return Taken::End,
            Some(Err(error)) => {
                shared.fail(Stage::Capture, PipelineError::Source(error));
                return Taken::End;
            }
            Some(Ok(Next::End)) => return Taken::End,
            Some(Ok(Next::Waiting(text))) => {
                self.say(text);
                return Taken::Again;
            }
            Some(Ok(Next::Frame)) => self.said = None,
        }
        let device_ns = packet.depth.time.device_ns;
        if self.stale && self.options.pace == Pace::Live {
            let stamp_ns = live_stamp_ns(device_ns, shared.clock.now_ns());
            if stamp_ns < self.started_ns {
                return Taken::Again;
            }
            self.stale = false;
        }
        let first = *self.first_device_ns.get_or_insert(device_ns);
        if duration_ns.is_some_and(|most| device_ns.saturating_sub(first) >= most) {
            return Taken::End;
        }
        packet.color = self.source.take_color();
        let arrival = shared.clock.now_ns();
        packet.record = super::packet::FrameRecord {
            sequence: packet.depth.sequence,
            device_ns,
            stamp_ns: arrival,
            capture: Span {
                start_ns: start,
                end_ns: arrival,
            },
            ..Default::default()
        };
        self.taken += 1;
        locked(&shared.statistics).delivered();
        let period = device_ns.saturating_sub(self.last_device_ns);
        // a pause says nothing of when the frame behind it is due
        if self.taken > 1 && period > 0 && (self.period_ns == 0 || period < self.period_ns) {
            self.period_ns = period;
        }
        self.last_device_ns = device_ns;
        self.reading_ns = arrival.saturating_sub(start);
        match self.options.pace {
            Pace::Block => {}
            Pace::Live | Pace::Keep => packet.record.stamp_ns = live_stamp_ns(device_ns, arrival),
            Pace::Realtime => {
                let mut due = self
                    .started_ns
                    .saturating_add(device_ns.saturating_sub(first));
                let behind = arrival.saturating_sub(due);
                if !self.alone && behind > MOST_BEHIND_NS {
                    self.started_ns = self.started_ns.saturating_add(behind);
                    due = arrival;
                    if !self.slow {
                        tracing::warn!("frames are read slower than they were recorded");
                    }
                    self.slow = true;
                }
                self.wait_until(due, shared);
                packet.record.stamp_ns = due;
                packet.record.capture.end_ns = shared.clock.now_ns();
                let late = packet.record.capture.end_ns.saturating_sub(due);
                if self.alone && self.taken > 1 && late > period && self.skipped < MOST_SKIPPED {
                    self.skipped += 1;
                    shared.dropped(packet, DropCause::Queue);
                    return Taken::Again;
                }
                self.skipped = 0;
            }
        }
        if self.taken == 1 && self.options.pace == Pace::Realtime {
            // the recording's time begins when its first frame is there
            self.started_ns = packet.record.capture.end_ns;
            packet.record.stamp_ns = self.started_ns;
        }
        Taken::Frame
    }

    /// A paced recording's next frame is read in the second half of the time until it is due, or as
    /// early as reading takes: in the first half the frame before has the cores to itself.
    fn wait_to_read(&self, shared: &Shared<'_>) {
        if self.options.pace != Pace::Realtime || self.alone || self.period_ns == 0 {
            return;
        }
        let first = self.first_device_ns.unwrap_or(self.last_device_ns);
        let since = self.last_device_ns.saturating_sub(first);
        let due = self.started_ns.saturating_add(since);
        let due = due.saturating_add(self.period_ns);
        let lead = (self.period_ns / 2).max(self.reading_ns.saturating_mul(2));
        self.wait_until(due.saturating_sub(lead), shared);
    }

    fn wait_until(&self, due_ns: i64, shared: &Shared<'_>) {
        loop {
            let left = due_ns.saturating_sub(shared.clock.now_ns());
            match u64::try_from(left) {
                Ok(left) if left > 0 && !shared.stopping() => {
                    shared.clock.sleep(Duration::from_nanos(left).min(NAP));
                }
                _ => return,
            }
        }
    }

    /// Passes on what the source says while it has no frame, once.
    fn say(&mut self, text: Option<String>) {
        if let Some(text) = text
            && self.said.as_ref() != Some(&text)
        {
            tracing::warn!("{text}");
            self.said = Some(text);
        }
    }
}
