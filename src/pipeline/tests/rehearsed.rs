//! A rehearsal before the stream: played in the stages' threads, and in no count.

use super::*;
use crate::pipeline::rehearsal::Act;

/// A run whose stages can start over; (outcome, written frames, bytes, frames rehearsed).
fn rehearsed(threads: usize, pace: Pace) -> (Outcome, Vec<u64>, Vec<u8>, [Option<u32>; 2]) {
    let mut model = MockModel {
        rehearsed: Some(0),
        ..MockModel::default()
    };
    let mut encode = MockEncode {
        rehearsed: Some(0),
        ..MockEncode::default()
    };
    let mut sink = MockSink::default();
    let options = Options {
        pace,
        frames: Some(1),
        ..options(threads)
    };
    let outcome = run_mocks(
        &mut MockSource::frames(1),
        &mut model,
        &mut encode,
        &mut sink,
        &options,
        &FakeClock::default(),
    );
    let seen = [model.rehearsed, encode.rehearsed];
    (outcome, sink.sequences, sink.bytes, seen)
}

#[test]
fn made_up_frames_reach_the_stages_and_no_count() {
    let (_, _, bytes, _) = rehearsed(1, Pace::Block);
    let acts = Some(Act::Plain as u32 + 1);
    for threads in [1, 4] {
        for (pace, frames) in [
            (Pace::Live, acts),
            (Pace::Realtime, acts),
            (Pace::Block, Some(0)),
            (Pace::Keep, Some(0)),
        ] {
            let (outcome, sequences, got, seen) = rehearsed(threads, pace);
            outcome.result.unwrap();
            assert_eq!(seen, [frames; 2], "{threads} threads, {pace:?}");
            assert_eq!(sequences, [0]);
            assert!(got == bytes, "{threads} threads, {pace:?}: other bytes");
            let report = outcome.report;
            assert_eq!((report.sensor_frames, report.frames), (1, 1));
            assert_eq!(report.bytes, bytes.len() as u64);
        }
    }
}

#[test]
fn a_stage_that_fails_in_the_rehearsal_ends_the_run() {
    for threads in [1, 4] {
        for stage in [Stage::Model, Stage::Encode] {
            let at = |s| (s == stage).then_some(0);
            let mut model = MockModel {
                rehearsed: Some(0),
                panic_at: at(Stage::Model),
                ..MockModel::default()
            };
            let mut encode = MockEncode {
                rehearsed: Some(0),
                panic_at: at(Stage::Encode),
                ..MockEncode::default()
            };
            let options = Options {
                pace: Pace::Live,
                ..options(threads)
            };
            let outcome = run_mocks(
                &mut MockSource::frames(9),
                &mut model,
                &mut encode,
                &mut MockSink::default(),
                &options,
                &FakeClock::default(),
            );
            assert!(outcome.result.is_err(), "{stage:?}, {threads} threads");
            assert_eq!(outcome.report.sensor_frames, 0);
        }
    }
}

/// A scene whose first frames are dear, by a clock that stages wind: the fit needs so many ms and
/// leaves what it did not come to; a whole coding takes 8 ms and much more where much is left, a plain
/// one 6 ms.
struct Dear<'a> {
    clock: &'a FakeClock,
    needs_ms: &'a (dyn Fn(u64) -> u32 + Sync),
    rehearsed: bool,
}

const POINTS: u32 = 1000;

impl Model for Dear<'_> {
    fn model(
        &mut self,
        depth: &crate::frame::DepthFrame,
        saint: &mut crate::contact_map::labels::SaintFrame,
        deadline: &dyn Fn() -> bool,
    ) -> Result<packet::ModelReport, StageError> {
        saint.contacts = crate::contact_map::labels::Contacts::Labels(vec![0; depth.depth.len()]);
        let needs = (self.needs_ms)(depth.sequence);
        let mut done = 0;
        while done < needs && !deadline() {
            self.clock.advance(1_000_000);
            done += 1;
        }
        Ok(packet::ModelReport {
            points: POINTS,
            explained: POINTS * done / needs,
            degraded: done < needs,
            ..packet::ModelReport::default()
        })
    }

    fn start_over(&mut self) -> bool {
        self.rehearsed
    }
}

struct DearCoding<'a>(&'a FakeClock);

impl Encode for DearCoding<'_> {
    fn encode(
        &mut self,
        depth: &crate::frame::DepthFrame,
        _: &crate::contact_map::labels::SaintFrame,
        modelled: &packet::ModelReport,
        encoded: &mut crate::codec::EncodedFrame,
    ) -> Result<packet::CodingReport, StageError> {
        encoded.sequence = depth.sequence;
        self.0.advance(if modelled.hurried {
            6_000_000
        } else {
            8_000_000 + 80_000 * i64::from(modelled.left())
        });
        Ok(packet::CodingReport::default())
    }

    fn start_over(&mut self) -> bool {
        true
    }
}

/// Thirty frames of a scene under a budget of one period of 33 ms.
fn dear(needs_ms: &(dyn Fn(u64) -> u32 + Sync), rehearsed: bool) -> Report {
    let clock = FakeClock::default();
    let mut source = MockSource::frames(30);
    source.period_ns = 33_000_000;
    let mut sink = MockSink::default();
    let stages = Stages {
        source: &mut source,
        color: None,
        model: &mut Dear {
            clock: &clock,
            needs_ms,
            rehearsed,
        },
        encode: &mut DearCoding(&clock),
        sink: &mut sink,
        trace: None,
        start: None,
    };
    let options = Options {
        pace: Pace::Realtime,
        budget: Budget {
            limit: Duration::from_millis(33),
            late: Late::Degrade,
        },
        ..options(1)
    };
    let stop = AtomicBool::new(false);
    let outcome = run(stages, &options, &clock, &stop, &mut |_| ());
    outcome.result.unwrap();
    outcome.report
}

#[test]
fn a_rehearsed_stream_keeps_its_budget_from_the_first_frame_on() {
    // what a fit from nothing had no time for goes on in the next frames
    for first in [20, 40, 60, 400] {
        let needs = |n: u64| (first >> n.min(8)).max(5);
        let report = dear(&needs, true);
        assert_eq!(report.late, 0, "first {first}: {:?}", report.age_ms);
        assert_eq!(report.frames, 30);
        assert!(report.degraded <= 8, "first {first}: {report:?}");
    }
    // nothing known, the first frame is late
    let report = dear(&|n| if n == 0 { 60 } else { 5 }, false);
    assert!(report.late >= 1, "{report:?}");
}

#[test]
fn one_dear_frame_costs_its_own_quality_and_no_age() {
    let report = dear(&|n| if n == 10 { 60 } else { 5 }, true);
    assert_eq!(report.late, 0, "{:?}", report.age_ms);
    assert_eq!(report.degraded, 1, "{report:?}");
}
