//! The stages as the pipeline sees them, and the one step each of them makes for a frame.
//!
//! A step never lets a panic or an error out: it is kept as the pipeline's failure, the frame is
//! counted and its packet goes back. So every stage can go on emptying its queue, and shutting
//! down after a failure is the same as shutting down after the last frame.

use super::budget::{
    Budget, Coding, CostModel, Decision, Late, WorkLeft, decide, leaves_much, likely_left,
};
use super::clock::Clock;
use super::coding_cost::CodingCost;
use super::error::{PipelineError, Stage, StageError, panic_message};
use super::packet::{CodingReport, ModelReport, Packet, Span};
use super::report::Report;
use super::statistics::{DropCause, Drops, Statistics};
use super::threads::Schedule;
use super::trace::Trace;
use super::{Options, Pace, Priority};
use crate::codec::EncodedFrame;
use crate::contact_map::labels::SaintFrame;
use crate::frame::{ColorFrame, DepthFrame};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Finds the spheres and the contact map of a frame.
pub trait Model: Send {
    /// Models `depth` into `saint`. `deadline` turns true when no time is left for refinement;
    /// the result must be complete all the same (what no sphere explains says so).
    ///
    /// # Errors
    /// Whatever makes this frame impossible to model.
    fn model(
        &mut self,
        depth: &DepthFrame,
        saint: &mut SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<ModelReport, StageError>;

    /// Forgets every frame so far: the next one comes out as a new stage's first would, in buffers
    /// that are there. False where it cannot; it is then not rehearsed (see [`super::rehearsal`]).
    fn start_over(&mut self) -> bool {
        false
    }
}

/// Writes a modelled frame as bytes.
pub trait Encode: Send {
    /// Encodes the frame, of which the model stage says `modelled`, into `encoded`, whose buffer is
    /// reused.
    ///
    /// # Errors
    /// Whatever makes this frame impossible to code.
    fn encode(
        &mut self,
        depth: &DepthFrame,
        saint: &SaintFrame,
        modelled: &ModelReport,
        encoded: &mut EncodedFrame,
    ) -> Result<CodingReport, StageError>;

    /// As [`Model::start_over`].
    fn start_over(&mut self) -> bool {
        false
    }
}

/// Takes finished frames: a file, a pipe, nothing.
pub trait Sink: Send {
    /// Takes a frame; packets come in order.
    ///
    /// # Errors
    /// The output failed; the pipeline then stops.
    fn frame(&mut self, packet: &Packet) -> Result<(), StageError>;

    /// Takes a colour image.
    ///
    /// # Errors
    /// The output failed; the pipeline then stops.
    fn color(&mut self, color: &ColorFrame) -> Result<(), StageError> {
        let _ = color;
        Ok(())
    }

    /// Told before each frame and before [`finish`](Self::finish): the frames given up so far, by
    /// cause.
    fn account(&mut self, drops: &Drops) {
        let _ = drops;
    }

    /// Frames that are safe in the output, where that is fewer than it took: an output that
    /// failed may have held some of them in memory. Asked at the end.
    fn kept(&self) -> Option<u64> {
        None
    }

    /// Called about ten times a second while no frame comes, so that nothing waits in memory.
    ///
    /// # Errors
    /// The output failed; the pipeline then stops.
    fn idle(&mut self) -> Result<(), StageError> {
        Ok(())
    }

    /// Closes the output. Called once, at the end, also after a failure.
    ///
    /// # Errors
    /// The output failed.
    fn finish(&mut self) -> Result<(), StageError> {
        Ok(())
    }
}

/// What the stages learnt of their cost.
#[derive(Debug, Default)]
struct Costs {
    model: CostModel,
    encode: CodingCost,
    /// Per pixel, however many are on a sphere (VGA, three sensors: 1.6 to 3.1 ms with few left without,
    /// 1.5 to 2.5 with most).
    plain: CostModel,
    sink: CostModel,
    /// Pixels a whole fit is likely to leave without a sphere.
    left: u64,
    /// The last frame that was to be coded was not hurried.
    settled: bool,
    /// Pixels the last frame left without a sphere; a first frame may leave all.
    last_left: Option<u64>,
}

impl Costs {
    /// What coding a frame of `pixels` takes, of which `left` are on no sphere.
    fn coding(&self, pixels: u64, left: u64) -> Coding {
        Coding {
            whole: self.encode.predict_or_guess(pixels, left),
            plain: self.plain.predict(pixels),
        }
    }

    /// What the fit of a frame of `pixels` leaves to its coding, where that may be hurried: then
    /// pixels on no sphere cost no more than the rest.
    fn kept_for_coding(&self, pixels: u64) -> Duration {
        let left = self.last_left.unwrap_or(pixels);
        let plain = self.coding(pixels, left).plain;
        let whole = self.coding(pixels, 0).whole;
        Coding { whole, plain }.kept(!self.settled)
    }
}

/// What all stages of one run share.
pub(super) struct Shared<'a> {
    pub(super) clock: &'a dyn Clock,
    pub(super) statistics: Mutex<Statistics>,
    budget: Budget,
    /// True where age begins when work on the frame begins (unpaced replay).
    age_from_model: bool,
    stop: &'a AtomicBool,
    failing: AtomicBool,
    failure: Mutex<Option<(Stage, PipelineError)>>,
    costs: Mutex<Costs>,
    pub(super) schedule: Schedule,
    trace: Mutex<Option<Trace>>,
}

/// A lock that a panicking stage cannot take away from the others.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn ns(from: i64, to: i64) -> Duration {
    Duration::from_nanos(u64::try_from(to - from).unwrap_or(0))
}

impl<'a> Shared<'a> {
    pub(super) fn new(
        clock: &'a dyn Clock,
        stop: &'a AtomicBool,
        options: &Options,
        trace: Option<Trace>,
    ) -> Self {
        let budget = options.budget;
        let limit_ns = i64::try_from(budget.limit.as_nanos()).unwrap_or(i64::MAX);
        Self {
            clock,
            statistics: Mutex::new(Statistics::new(clock.now_ns(), limit_ns)),
            budget,
            age_from_model: options.pace == Pace::Block,
            stop,
            failing: AtomicBool::new(false),
            failure: Mutex::new(None),
            costs: Mutex::new(Costs::default()),
            schedule: Schedule::new(match options.threads {
                0 | 1 => Priority::Usual,
                _ => options.priority,
            }),
            trace: Mutex::new(trace),
        }
    }

    /// True when no more frames are to be taken from the source.
    pub(super) fn stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.failing.load(Ordering::Relaxed)
    }

    /// The run so far.
    pub(super) fn total(&self) -> Report {
        Report {
            priority: self.schedule.got(),
            ..locked(&self.statistics).total(self.clock.now_ns())
        }
    }

    /// The time since this was last called.
    pub(super) fn interval(&self) -> Report {
        Report {
            priority: self.schedule.got(),
            ..locked(&self.statistics).interval(self.clock.now_ns())
        }
    }

    /// Keeps the first failure; the source then ends.
    pub(super) fn fail(&self, stage: Stage, error: PipelineError) {
        locked(&self.failure).get_or_insert((stage, error));
        self.failing.store(true, Ordering::Relaxed);
    }

    pub(super) fn take_failure(&self) -> Option<PipelineError> {
        locked(&self.failure).take().map(|(_, error)| error)
    }

    /// Where `stage` or a later one has failed: why its frames cannot be finished.
    fn hopeless(&self, stage: Stage) -> Option<DropCause> {
        if !self.failing.load(Ordering::Relaxed) {
            return None;
        }
        match &*locked(&self.failure) {
            Some((Stage::Sink, _)) => Some(DropCause::Sink),
            Some((failed, _)) if *failed >= stage && *failed != Stage::Color => {
                Some(DropCause::Failed)
            }
            _ => None,
        }
    }

    /// Counts a frame that was given up.
    pub(super) fn dropped(&self, packet: &Packet, cause: DropCause) {
        if packet.act.is_some() {
            return; // the sensor did not make it
        }
        locked(&self.statistics).dropped(cause);
        let name = match cause {
            DropCause::Queue => "queue",
            DropCause::Budget => "budget",
            DropCause::Sink => "sink",
            DropCause::Failed => "failed",
        };
        self.traced(|trace, now| trace.dropped(packet.depth.sequence, name, now));
    }

    fn traced(&self, write: impl FnOnce(&mut Trace, i64) -> std::io::Result<()>) {
        let mut trace = locked(&self.trace);
        if let Some(open) = trace.as_mut()
            && let Err(error) = write(open, self.clock.now_ns())
        {
            *trace = None;
            drop(trace);
            self.fail(Stage::Color, PipelineError::Trace(error));
        }
    }

    pub(super) fn finish_trace(&self) {
        self.traced(|trace, _| trace.flush());
    }

    /// Runs a stage's own code; an error or a panic becomes the pipeline's failure.
    pub(super) fn guarded<T>(
        &self,
        stage: Stage,
        sequence: u64,
        work: impl FnOnce() -> Result<T, StageError>,
    ) -> Option<T> {
        let error = match catch_unwind(AssertUnwindSafe(work)) {
            Ok(Ok(value)) => return Some(value),
            Ok(Err(source)) if stage == Stage::Sink => PipelineError::Sink(source),
            Ok(Err(source)) => PipelineError::Stage {
                stage,
                sequence,
                source,
            },
            Err(payload) => PipelineError::Panic {
                stage,
                message: panic_message(payload.as_ref()),
            },
        };
        self.fail(stage, error);
        None
    }

    /// Counts the frame of a stage that just failed.
    fn give_up(&self, stage: Stage, packet: &Packet) -> bool {
        let cause = self.hopeless(stage).unwrap_or(DropCause::Failed);
        self.dropped(packet, cause);
        false
    }

    /// Models a packet; false where it goes no further (and was counted).
    pub(super) fn model_step(&self, model: &mut dyn Model, packet: &mut Packet) -> bool {
        if let Some(cause) = self.hopeless(Stage::Model) {
            self.dropped(packet, cause);
            return false;
        }
        if let Some(act) = packet.act {
            return self.rehearse_model(act, model, packet);
        }
        let start = self.clock.now_ns();
        if self.age_from_model {
            packet.record.stamp_ns = start;
        }
        let pixels = packet.depth.depth.len() as u64;
        let work = {
            let costs = locked(&self.costs);
            let coding = if self.budget.late == Late::Degrade {
                costs.kept_for_coding(pixels)
            } else {
                costs.encode.predict(pixels, costs.left)
            };
            WorkLeft {
                stage: costs.model.predict(pixels),
                after: coding + costs.sink.predict(1),
            }
        };
        let age = ns(packet.record.stamp_ns, start);
        let until = match decide(age, work, self.budget) {
            Decision::Run => i64::MAX,
            Decision::RunFor(time) => {
                start.saturating_add(i64::try_from(time.as_nanos()).unwrap_or(i64::MAX))
            }
            Decision::GiveUp => {
                locked(&self.costs).model.relax();
                self.dropped(packet, DropCause::Budget);
                return false;
            }
        };
        let deadline = || until != i64::MAX && self.clock.now_ns() >= until;
        let report = self.guarded(Stage::Model, packet.depth.sequence, || {
            model.model(&packet.depth, &mut packet.saint, &deadline)
        });
        let Some(report) = report else {
            return self.give_up(Stage::Model, packet);
        };
        let end = self.clock.now_ns();
        packet.record.modelled = report;
        packet.record.model = Span {
            start_ns: start,
            end_ns: end,
        };
        let mut costs = locked(&self.costs);
        costs.model.observe(pixels, ns(start, end));
        costs.last_left = Some(u64::from(report.left()));
        costs.left = likely_left(u64::from(report.points), u64::from(report.left()));
        true
    }

    /// Encodes a packet; false where it goes no further (and was counted).
    pub(super) fn encode_step(&self, encode: &mut dyn Encode, packet: &mut Packet) -> bool {
        if let Some(cause) = self.hopeless(Stage::Encode) {
            self.dropped(packet, cause);
            return false;
        }
        if let Some(act) = packet.act {
            return self.rehearse_encode(act, encode, packet);
        }
        let start = self.clock.now_ns();
        let pixels = packet.depth.depth.len() as u64;
        let left = u64::from(packet.record.modelled.left());
        let (work, coding) = {
            let costs = locked(&self.costs);
            let work = WorkLeft {
                stage: costs.encode.predict(pixels, left),
                after: costs.sink.predict(1),
            };
            (work, costs.coding(pixels, left))
        };
        // only the drop policy refuses: a payload is never cut short by time
        let modelled = &mut packet.record.modelled;
        match decide(ns(packet.record.stamp_ns, start), work, self.budget) {
            Decision::Run => {}
            Decision::RunFor(time) => {
                let much = leaves_much(u64::from(modelled.points), left);
                let behind = !locked(&self.costs).settled;
                modelled.hurried = coding.hurries(time, much, behind);
                modelled.degraded |= modelled.hurried;
            }
            Decision::GiveUp => {
                locked(&self.costs).encode.relax();
                self.dropped(packet, DropCause::Budget);
                return false;
            }
        }
        locked(&self.costs).settled = !modelled.hurried;
        let report = self.guarded(Stage::Encode, packet.depth.sequence, || {
            encode.encode(
                &packet.depth,
                &packet.saint,
                &packet.record.modelled,
                &mut packet.encoded,
            )
        });
        let Some(report) = report else {
            return self.give_up(Stage::Encode, packet);
        };
        let end = self.clock.now_ns();
        packet.record.coded = report;
        packet.record.encode = Span {
            start_ns: start,
            end_ns: end,
        };
        packet.record.bytes = packet.encoded.payload.len() as u64;
        packet.record.key = packet.encoded.key;
        self.learn_coding(packet, start, end);
        true
    }

    /// Learns from a frame that was coded from `start` to `end`, ns.
    pub(super) fn learn_coding(&self, packet: &Packet, start: i64, end: i64) {
        let pixels = packet.depth.depth.len() as u64;
        let modelled = &packet.record.modelled;
        let (points, left) = (u64::from(modelled.points), u64::from(modelled.left()));
        let mut costs = locked(&self.costs);
        if modelled.hurried {
            costs.plain.observe(pixels, ns(start, end));
            if leaves_much(points, left) {
                costs.encode.fade();
            } else {
                // a whole coding is soon tried again: what is feared may have been a moment's
                costs.encode.relax();
            }
        } else {
            costs.encode.observe(pixels, left, ns(start, end));
        }
    }

    /// The stream begins now.
    pub(super) fn begin(&self) -> i64 {
        let now_ns = self.clock.now_ns();
        locked(&self.statistics).begin(now_ns);
        now_ns
    }

    /// Writes a packet and counts it.
    pub(super) fn sink_step(&self, sink: &mut dyn Sink, packet: &mut Packet) {
        if packet.act.is_some() {
            return;
        }
        if let Some(cause) = self.hopeless(Stage::Sink) {
            self.dropped(packet, cause);
            return;
        }
        // the image first: who reads the frame has it then
        if let Some(color) = &packet.color {
            self.color_step(sink, color);
        }
        let start = self.clock.now_ns();
        let drops = locked(&self.statistics).drops();
        let written = self.guarded(Stage::Sink, packet.depth.sequence, || {
            sink.account(&drops);
            sink.frame(packet)
        });
        if written.is_none() {
            self.give_up(Stage::Sink, packet);
            return;
        }
        let end = self.clock.now_ns();
        packet.record.sink = Span {
            start_ns: start,
            end_ns: end,
        };
        locked(&self.costs).sink.observe(1, ns(start, end));
        locked(&self.statistics).written(&packet.record);
        self.traced(|trace, _| trace.frame(&packet.record));
    }

    /// Writes an image of the colour camera and counts it.
    pub(super) fn color_step(&self, sink: &mut dyn Sink, color: &ColorFrame) {
        let written = self.hopeless(Stage::Sink).is_none()
            && self
                .guarded(Stage::Sink, color.sequence, || sink.color(color))
                .is_some();
        locked(&self.statistics).color(written);
    }

    /// Nothing came for a while.
    pub(super) fn idle_step(&self, sink: &mut dyn Sink) {
        if self.hopeless(Stage::Sink).is_none() {
            let _ = self.guarded(Stage::Sink, 0, || sink.idle());
        }
    }

    /// Closes the output, whatever happened before. Frames it took and lost again are dropped
    /// frames.
    pub(super) fn finish_sink(&self, sink: &mut dyn Sink) {
        let drops = locked(&self.statistics).drops();
        let kept = self.guarded(Stage::Sink, 0, || {
            sink.account(&drops);
            let result = sink.finish();
            Ok((sink.kept(), result))
        });
        let Some((kept, result)) = kept else {
            return;
        };
        if let Some(kept) = kept {
            locked(&self.statistics).kept(kept);
        }
        let _ = self.guarded(Stage::Sink, 0, || result);
    }
}
