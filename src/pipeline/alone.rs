//! All computing in the caller's thread: the stages one after the other.
//!
//! A recorded source waits, so it is asked in the same thread. A live camera does not: even here
//! it has a thread that does nothing but take its frames, else the driver would throw frames away
//! while a frame is modelled, and nobody could tell them from frames the sensor lost.

use super::intake::{Intake, Taken};
use super::mailbox::{Wait, mailbox};
use super::packet::Packet;
use super::rehearsal::Rehearsal;
use super::stages::{Encode, Model, Shared, Sink};
use super::{Colors, IDLE, Meter, Stage, TICK, bounded, capture_all, join, spawn, waiting};
use std::thread::Scope;
use std::time::{Duration, Instant};

/// The stages after capture.
pub(super) struct Rest<'a> {
    pub model: &'a mut dyn Model,
    pub encode: &'a mut dyn Encode,
    pub sink: &'a mut dyn Sink,
    pub colors: Colors<'a>,
}

impl Rest<'_> {
    /// All steps of one frame.
    fn frame(&mut self, packet: &mut Packet, shared: &Shared<'_>) {
        if shared.model_step(self.model, packet) && shared.encode_step(self.encode, packet) {
            shared.sink_step(self.sink, packet);
        }
    }

    fn finish(self, shared: &Shared<'_>) {
        self.colors.finish(self.sink, shared);
        shared.finish_sink(self.sink);
    }
}

/// Every stage in the caller's thread, in order.
pub(super) fn run_in_one_thread(
    mut intake: Intake<'_>,
    mut rest: Rest<'_>,
    rehearsal: Option<Rehearsal>,
    shared: &Shared<'_>,
    observe: &mut dyn FnMut(&Meter<'_, '_>),
) {
    let mut packet = Packet::default();
    if let Some(mut rehearsal) = rehearsal {
        rehearsal.alone(rest.model, rest.encode, &mut packet, shared);
        rehearsal.wait_for_all(shared);
        intake.begin(shared.begin());
    }
    let mut told_ns = shared.clock.now_ns();
    loop {
        match intake.take(&mut packet, shared) {
            Taken::Frame => rest.frame(&mut packet, shared),
            Taken::Again => shared.idle_step(rest.sink),
            Taken::End => break,
        }
        rest.colors.write_waiting(rest.sink, shared);
        let now_ns = shared.clock.now_ns();
        if ns_since(told_ns, now_ns) >= TICK {
            told_ns = now_ns;
            observe(&Meter(shared));
        }
    }
    rest.finish(shared);
}

/// A thread that drains the camera; every other stage in the caller's thread.
pub(super) fn run_beside_capture<'scope, 'env: 'scope>(
    scope: &'scope Scope<'scope, 'env>,
    intake: Intake<'env>,
    mut rest: Rest<'_>,
    rehearsal: Option<Rehearsal>,
    shared: &'scope Shared<'env>,
    observe: &mut dyn FnMut(&Meter<'_, '_>),
) {
    let waiting = waiting(intake.pace());
    let (captured_tx, captured) = mailbox::<Box<Packet>>(waiting);
    // one is filled, one worked on
    let packets = 2 + waiting;
    let (empty, empties) = bounded::<Box<Packet>>(packets);
    for _ in 0..packets {
        // the channel holds exactly this many
        let _ = empty.send(Box::default());
    }
    let capture = spawn(scope, Stage::Capture, shared, move || {
        capture_all(intake, &captured_tx, &empties, rehearsal, shared);
    });
    let (mut told, mut busy) = (Instant::now(), Instant::now());
    loop {
        match captured.take_within(TICK) {
            Wait::Item(mut packet) => {
                rest.frame(&mut packet, shared);
                let _ = empty.send(packet);
                busy = Instant::now();
            }
            Wait::TimedOut if busy.elapsed() >= IDLE => {
                shared.idle_step(rest.sink);
                busy = Instant::now();
            }
            Wait::TimedOut => {}
            Wait::Closed => break,
        }
        rest.colors.write_waiting(rest.sink, shared);
        if told.elapsed() >= TICK {
            told = Instant::now();
            observe(&Meter(shared));
        }
    }
    capture.and_then(|thread| join(thread, Stage::Capture, shared));
    rest.finish(shared);
}

fn ns_since(from: i64, to: i64) -> Duration {
    Duration::from_nanos(u64::try_from(to.saturating_sub(from)).unwrap_or(0))
}
