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
