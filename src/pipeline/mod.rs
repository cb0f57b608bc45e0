//! The real-time loop, and the file to read first: one place spawns, names and joins the threads.
//!
//! ```text
//!            mailbox            channel            channel
//!  capture ───────────► model ───────────► encode ───────────► sink ◄──── color
//!     ▲                   │                   │                  │
//!     └───────────────────┴───── empty packets go back ──────────┘
//! ```
//!
//! *Queues.* Every queue is bounded, and a fixed number of packets goes round, so nothing is
//! allocated per frame. Replay ([`Pace::Block`]) waits for room and loses nothing. Live and
//! `--realtime` keep the newest frame: the mailbox gives up the **oldest** waiting frame and
//! counts it. There are as many packets as all stages and queues can hold, so the capture thread
//! of a live camera never waits for one.
//!
//! *Beginning.* Live and `--realtime`, made-up frames take the way of real ones first
//! ([`rehearsal`]), so that the first real one finds memory taken and costs known. Cameras of a rig
//! begin together ([`start`]).
//!
//! *Shutting down.* A stop flag, a failure or the end of the source ends capture; each stage
//! empties its queue and drops its sender; threads are joined in the order of the stages. A stage
//! that failed goes on emptying its queue and counts what it gives up, so the sum of written and
//! dropped frames is the number of frames the sensor made. What was written is kept.
//!
//! *One thread.* With `threads = 1` the same steps run one after the other in the caller's thread,
//! and the bytes are the same. A live camera is drained by a thread of its own even then
//! (`alone`): `threads` counts those that compute.
//!
//! *Time.* The age of a frame is counted from its device stamp (live), from the moment it was due
//! (`--realtime`) or from the moment work on it began (replay). [`budget`] decides what a frame
//! may still cost; [`statistics`] keeps the account; [`trace`] draws it.

mod alone;
pub mod budget;
pub mod clock;
pub mod coding_cost;
pub mod color;
mod engines;
mod error;
mod intake;
pub mod mailbox;
pub mod packet;
pub mod percentiles;
pub mod recorder;
pub mod rehearsal;
pub mod report;
pub mod stages;
pub mod start;
pub mod statistics;
mod threads;
pub mod trace;

#[cfg(test)]
mod tests;

pub use error::{PipelineError, Stage, StageError};
pub use threads::Priority;

use crate::capture::{CaptureError, FrameSource};
use alone::Rest;
use budget::Budget;
use clock::Clock;
use color::ColorSource;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded, never, select};
use error::panic_message;
use intake::{Intake, Taken};
use mailbox::mailbox;
use packet::Packet;
use rehearsal::Rehearsal;
use report::Report;
use stages::{Encode, Model, Shared, Sink};
use start::Place;
use statistics::DropCause;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Scope, ScopedJoinHandle};
use std::time::Duration;
use trace::Trace;

/// Frames that may wait between capture and model.
const WAITING: usize = 1;
/// The same where frames are kept, not shown: as many as a disk may take its time for.
const WAITING_TO_KEEP: usize = 64;
/// Frames that may wait between the later stages of a replay, which evens out their times. Live
/// they are handed over from stage to stage: a frame that waits there would only grow old.
const HANDED_OVER: usize = 1;
/// One packet in each stage; with those that wait in queues, a live source always finds an empty
/// one.
const IN_STAGES: usize = 4;
/// How often the observer is called.
const TICK: Duration = Duration::from_millis(100);

/// Without a frame for this long the sink is told so.
const IDLE: Duration = Duration::from_millis(100);

/// How frames are taken from the source.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// As fast as the pipeline goes; nothing is dropped (replay).
    #[default]
    Block,
    /// At the pace of their time stamps; the oldest waiting frame is dropped when we are late.
    Realtime,
    /// As the device gives them; the oldest waiting frame is dropped when we are late.
    Live,
    /// As the device gives them, to be kept: age does not matter and many frames may wait before
    /// the oldest is dropped.
    Keep,
}

/// How a pipeline runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// 1 runs every stage in the caller's thread (but capture of a live camera), more gives each
    /// stage its own.
    pub threads: usize,
    /// Threads that model and encode work with, each, where they have a thread of their own, that one
    /// included; 0 leaves their work to the process's common pool.
    pub stage_threads: usize,
    /// Priority to ask for; with one thread none is.
    pub priority: Priority,
    /// How frames are taken.
    pub pace: Pace,
    /// Latency budget and what to do about late frames.
    pub budget: Budget,
    /// Take at most this many frames from the source.
    pub frames: Option<u64>,
    /// Take frames for this long, by their time stamps (live: also by the clock).
    pub duration: Option<Duration>,
}

/// The parts of a pipeline.
pub struct Stages<'a> {
    /// Where frames come from.
    pub source: &'a mut dyn FrameSource,
    /// The colour camera beside it.
    pub color: Option<&'a mut dyn ColorSource>,
    /// Spheres and contact map.
    pub model: &'a mut dyn Model,
    /// Payload.
    pub encode: &'a mut dyn Encode,
    /// Output.
    pub sink: &'a mut dyn Sink,
    /// Timeline file.
    pub trace: Option<Trace>,
    /// Where streams begin together: this one's place among them.
    pub start: Option<Place>,
}

/// How a run ended.
#[derive(Debug)]
pub struct Outcome {
    /// Everything that was counted.
    pub report: Report,
    /// Why it ended early, where it did.
    pub result: Result<(), PipelineError>,
    /// Why the colour camera ended early, where it did; depth goes on without it.
    pub color: Option<CaptureError>,
}

/// A view on the running statistics, for the observer.
pub struct Meter<'a, 'b>(&'a Shared<'b>);

impl Meter<'_, '_> {
    /// Now, ns on the pipeline's clock.
    #[must_use]
    pub fn now_ns(&self) -> i64 {
        self.0.clock.now_ns()
    }

    /// The run so far.
    #[must_use]
    pub fn total(&self) -> Report {
        self.0.total()
    }

    /// The time since this was last called, which begins anew.
    #[must_use]
    pub fn interval(&self) -> Report {
        self.0.interval()
    }
}

/// Runs a pipeline until its source ends, `stop` turns true, a limit is reached or a stage fails.
///
/// `observe` is called on the caller's thread, about ten times a second.
pub fn run(
    stages: Stages<'_>,
    options: &Options,
    clock: &dyn Clock,
    stop: &AtomicBool,
    observe: &mut dyn FnMut(&Meter<'_, '_>),
) -> Outcome {
    let Stages {
        source,
        color,
        model,
        encode,
        sink,
        trace,
        start,
    } = stages;
    let shared = Shared::new(clock, stop, options, trace);
    let done = AtomicBool::new(false);
    let color = std::thread::scope(|scope| {
        let (shared, done) = (&shared, &done);
        let (producer, consumer) = color::queue();
        let color = color.and_then(|source| {
            spawn(scope, Stage::Color, shared, move || {
                color::run(source, &producer, shared, done)
            })
        });
        let colors = Colors {
            queue: color.is_some().then_some(consumer),
            done,
        };
        let alone = options.threads <= 1;
        let rehearsal = match options.pace {
            Pace::Live | Pace::Realtime => Rehearsal::of(source.camera(), model, encode, start),
            Pace::Block | Pace::Keep => {
                drop(start);
                None
            }
        };
        let intake = Intake::new(source, options, alone, clock.now_ns());
        let rest = Rest {
            model,
            encode,
            sink,
            colors,
        };
        match (alone, options.pace) {
            (true, Pace::Live) => {
                alone::run_beside_capture(scope, intake, rest, rehearsal, shared, observe);
            }
            (true, _) => {
                alone::run_in_one_thread(intake, rest, rehearsal, shared, observe);
            }
            (false, _) => run_in_threads(scope, intake, rest, rehearsal, shared, observe),
        }
        color.and_then(|thread| join(thread, Stage::Color, shared).flatten())
    });
    shared.finish_trace();
    let report = shared.total();
    Outcome {
        report,
        result: shared.take_failure().map_or(Ok(()), Err),
        color,
    }
}

/// Frames that may wait between capture and model.
fn waiting(pace: Pace) -> usize {
    match pace {
        Pace::Keep => WAITING_TO_KEEP,
        Pace::Block | Pace::Realtime | Pace::Live => WAITING,
    }
}

/// Every stage in its own thread; the caller's thread observes.
fn run_in_threads<'scope, 'env: 'scope>(
    scope: &'scope Scope<'scope, 'env>,
    intake: Intake<'env>,
    rest: Rest<'scope>,
    rehearsal: Option<Rehearsal>,
    shared: &'scope Shared<'env>,
    observe: &mut dyn FnMut(&Meter<'_, '_>),
) {
    let Rest {
        model,
        encode,
        sink,
        colors,
    } = rest;
    let stage_threads = intake.stage_threads();
    let waiting = waiting(intake.pace());
    let (captured_tx, captured) = mailbox::<Box<Packet>>(waiting);
    let handed_over = match intake.pace() {
        Pace::Block | Pace::Keep => HANDED_OVER,
        Pace::Realtime | Pace::Live => 0,
    };
    let packets = IN_STAGES + 2 * handed_over + waiting;
    let (modelled_tx, modelled) = bounded::<Box<Packet>>(handed_over);
    let (encoded_tx, encoded) = bounded::<Box<Packet>>(handed_over);
    let (empty, empties) = bounded::<Box<Packet>>(packets);
    let (ended, end) = bounded::<()>(0);
    for _ in 0..packets {
        // the channel holds exactly this many
        let _ = empty.send(Box::default());
    }
    let (empty_of_model, empty_of_encode, empty_of_sink) = (empty.clone(), empty.clone(), empty);

    let sink = spawn(scope, Stage::Sink, shared, move || {
        write_all(&encoded, &empty_of_sink, sink, &colors, shared);
        drop(ended);
    });
    let encode = spawn(scope, Stage::Encode, shared, move || {
        let _workers = threads::workers(stage_threads);
        for mut packet in modelled {
            let next = if shared.encode_step(encode, &mut packet) {
                &encoded_tx
            } else {
                &empty_of_encode
            };
            let _ = next.send(packet);
        }
    });
    let model = spawn(scope, Stage::Model, shared, move || {
        let _workers = threads::workers(stage_threads);
        while let Some(mut packet) = captured.take() {
            let next = if shared.model_step(model, &mut packet) {
                &modelled_tx
            } else {
                &empty_of_model
            };
            let _ = next.send(packet);
        }
    });
    let capture = spawn(scope, Stage::Capture, shared, move || {
        capture_all(intake, &captured_tx, &empties, rehearsal, shared);
    });

    while let Err(RecvTimeoutError::Timeout) = end.recv_timeout(TICK) {
        observe(&Meter(shared));
    }
    let threads = [
        (capture, Stage::Capture),
        (model, Stage::Model),
        (encode, Stage::Encode),
        (sink, Stage::Sink),
    ];
    for (thread, stage) in threads {
        thread.and_then(|thread| join(thread, stage, shared));
    }
}

/// The capture thread: fills empty packets and never waits for the model when live.
fn capture_all(
    mut intake: Intake<'_>,
    captured: &mailbox::MailboxSender<Box<Packet>>,
    empties: &Receiver<Box<Packet>>,
    rehearsal: Option<Rehearsal>,
    shared: &Shared<'_>,
) {
    let live = intake.drops_oldest();
    let mut spare = Vec::new();
    if let Some(mut rehearsal) = rehearsal {
        spare = rehearsal.in_threads(captured, empties, shared);
        rehearsal.wait_for_all(shared);
        intake.begin(shared.begin());
    }
    // no empty packet will ever come where all stages have gone
    while let Some(mut packet) = spare.pop().or_else(|| empties.recv().ok()) {
        match intake.take(&mut packet, shared) {
            Taken::End => return,
            Taken::Again => spare.push(packet),
            Taken::Frame if live => match captured.put_latest(packet) {
                Ok(evicted) => {
                    // the scheduler may have woken the model on this core: it goes first
                    std::thread::yield_now();
                    if let Some(evicted) = &evicted {
                        shared.dropped(evicted, DropCause::Queue);
                    }
                    spare.extend(evicted);
                }
                Err(refused) => return shared.dropped(&refused, DropCause::Failed),
            },
            Taken::Frame => {
                if let Err(refused) = captured.put_wait(packet) {
                    return shared.dropped(&refused, DropCause::Failed);
                }
            }
        }
    }
}

/// The sink thread: frames in order, colour images as they come, then the end of the file.
fn write_all(
    encoded: &Receiver<Box<Packet>>,
    empty: &Sender<Box<Packet>>,
    sink: &mut dyn Sink,
    colors: &Colors<'_>,
    shared: &Shared<'_>,
) {
    let mut images = colors
        .queue
        .as_ref()
        .map_or_else(never, |queue| queue.full.clone());
    loop {
        select! {
            recv(encoded) -> packet => match packet {
                Ok(mut packet) => {
                    shared.sink_step(sink, &mut packet);
                    let _ = empty.send(packet);
                }
                Err(_) => break,
            },
            recv(images) -> image => match image {
                Ok(image) => colors.write(image, sink, shared),
                Err(_) => images = never(),
            },
            default(IDLE) => shared.idle_step(sink),
        }
    }
    colors.finish(sink, shared);
    shared.finish_sink(sink);
}

/// The sink's side of the colour camera.
struct Colors<'a> {
    queue: Option<color::Consumer>,
    done: &'a AtomicBool,
}

impl Colors<'_> {
    fn write(&self, image: crate::frame::ColorFrame, sink: &mut dyn Sink, shared: &Shared<'_>) {
        shared.color_step(sink, &image);
        if let Some(queue) = &self.queue {
            // no room only where the colour thread has gone
            let _ = queue.empty.try_send(image);
        }
    }

    /// Writes what waits now.
    fn write_waiting(&self, sink: &mut dyn Sink, shared: &Shared<'_>) {
        if let Some(queue) = &self.queue {
            for image in queue.full.try_iter() {
                self.write(image, sink, shared);
            }
        }
    }

    /// Ends the colour thread and writes what it still had.
    fn finish(&self, sink: &mut dyn Sink, shared: &Shared<'_>) {
        self.done.store(true, Ordering::Relaxed);
        if let Some(queue) = &self.queue {
            for image in &queue.full {
                self.write(image, sink, shared);
            }
        }
    }
}

/// Starts a named thread; where the system refuses, the failure is kept and the stage's queues
/// close, which ends the others.
fn spawn<'scope, 'env, T: Send + 'scope>(
    scope: &'scope Scope<'scope, 'env>,
    stage: Stage,
    shared: &'scope Shared<'_>,
    work: impl FnOnce() -> T + Send + 'scope,
) -> Option<ScopedJoinHandle<'scope, T>> {
    std::thread::Builder::new()
        .name(stage.name().to_owned())
        .spawn_scoped(scope, move || {
            shared.schedule.enter();
            work()
        })
        .map_err(|source| shared.fail(stage, PipelineError::Spawn { stage, source }))
        .ok()
}

/// Waits for a thread; a panic that no step caught becomes the failure.
fn join<T>(thread: ScopedJoinHandle<'_, T>, stage: Stage, shared: &Shared<'_>) -> Option<T> {
    thread
        .join()
        .map_err(|payload| {
            let message = panic_message(payload.as_ref());
            shared.fail(stage, PipelineError::Panic { stage, message });
        })
        .ok()
}
