//! The pipeline with stages made for the purpose: exact counts, no device, no real time.

mod balance;
mod mocks;
mod realtime;
mod rehearsed;

use super::budget::{Budget, Late};
use super::clock::fake::FakeClock;
use super::clock::{Clock, Monotonic};
use super::*;
use mocks::{Event, MockColor, MockEncode, MockModel, MockSink, MockSource, Work};
use proptest::prelude::*;
use std::sync::atomic::AtomicU64;

fn options(threads: usize) -> Options {
    Options {
        threads,
        stage_threads: 0,
        priority: Priority::Usual,
        pace: Pace::Block,
        budget: Budget::UNLIMITED,
        frames: None,
        duration: None,
    }
}

/// Runs mocks and checks what must hold for every run: the sum, one end, order.
fn run_mocks(
    source: &mut MockSource<'_>,
    model: &mut MockModel<'_>,
    encode: &mut MockEncode,
    sink: &mut MockSink<'_>,
    options: &Options,
    clock: &dyn Clock,
) -> Outcome {
    let stop = AtomicBool::new(false);
    let stages = Stages {
        source,
        color: None,
        model,
        encode,
        sink,
        trace: None,
        start: None,
    };
    let outcome = run(stages, options, clock, &stop, &mut |_| ());
    let report = &outcome.report;
    assert_eq!(
        report.sensor_frames,
        report.frames + report.drops.total(),
        "the sum does not balance: {report:?}"
    );
    assert_eq!(report.frames, sink.sequences.len() as u64);
    assert_eq!(sink.finished, 1, "the sink is closed once");
    assert!(sink.sequences.is_sorted(), "{:?}", sink.sequences);
    outcome
}

fn plain(source: &mut MockSource<'_>, threads: usize) -> (Outcome, Vec<u64>, Vec<u8>) {
    let mut sink = MockSink::default();
    let outcome = run_mocks(
        source,
        &mut MockModel::default(),
        &mut MockEncode::default(),
        &mut sink,
        &options(threads),
        &FakeClock::default(),
    );
    (outcome, sink.sequences, sink.bytes)
}

#[test]
fn replay_keeps_order_drops_nothing_and_threads_do_not_change_the_bytes() {
    let (one, sequences, bytes) = plain(&mut MockSource::frames(500), 1);
    one.result.unwrap();
    assert_eq!(sequences, (0..500).collect::<Vec<_>>());
    for threads in [2, 4] {
        let (many, got, got_bytes) = plain(&mut MockSource::frames(500), threads);
        many.result.unwrap();
        assert_eq!(got, sequences);
        assert!(got_bytes == bytes, "bytes differ with {threads} threads");
        assert_eq!(many.report.drops.total(), 0);
        assert_eq!(many.report.bytes, bytes.len() as u64);
    }
}

#[test]
fn back_pressure_bounds_the_frames_under_way() {
    let (given, written) = (AtomicU64::new(0), AtomicU64::new(0));
    let most = AtomicU64::new(0);
    let mut source = MockSource::frames(200);
    source.before = Box::new(|_| {
        let under_way = given.fetch_add(1, Ordering::SeqCst) + 1 - written.load(Ordering::SeqCst);
        most.fetch_max(under_way, Ordering::SeqCst);
    });
    let mut sink = MockSink {
        after: Some(Box::new(|_| {
            std::thread::yield_now();
            written.fetch_add(1, Ordering::SeqCst);
        })),
        ..MockSink::default()
    };
    let outcome = run_mocks(
        &mut source,
        &mut MockModel::default(),
        &mut MockEncode::default(),
        &mut sink,
        &options(4),
        &FakeClock::default(),
    );
    outcome.result.unwrap();
    let most = most.load(Ordering::SeqCst);
    assert!(
        most <= (IN_STAGES + 2 * HANDED_OVER + WAITING) as u64,
        "{most} frames under way"
    );
    assert_eq!(sink.sequences.len(), 200);
}

#[test]
fn live_drops_the_oldest_waiting_frame_and_counts_it() {
    // with one thread to compute in, the camera is drained all the same
    for threads in [1, 4] {
        live_drops_the_oldest(threads);
    }
}

fn live_drops_the_oldest(threads: usize) {
    // The model holds frame 0 until the source has given all frames.
    let (tx, rx) = bounded::<()>(1);
    let (begun_tx, begun) = bounded::<()>(1);
    let mut source = MockSource::frames(10);
    source.script.push(Event::Waiting);
    source.before = Box::new(move |n| {
        if n == 1 {
            begun.recv().unwrap();
        }
        if n == 9 {
            // frames 1 to 8 were put before this one was asked for
            tx.send(()).unwrap();
        }
    });
    let mut model = MockModel {
        work: Some(Box::new(move |n, _| {
            if n == 0 {
                begun_tx.send(()).unwrap();
                rx.recv().unwrap();
            }
            false
        })),
        ..MockModel::default()
    };
    let mut sink = MockSink::default();
    let options = Options {
        pace: Pace::Live,
        ..options(threads)
    };
    let outcome = run_mocks(
        &mut source,
        &mut model,
        &mut MockEncode::default(),
        &mut sink,
        &options,
        &FakeClock::default(),
    );
    outcome.result.unwrap();
    // the newest always arrives; 8 arrives too if the model was quicker than frame 9
    assert_eq!(sink.sequences.first(), Some(&0));
    assert_eq!(sink.sequences.last(), Some(&9));
    assert!(sink.sequences.len() <= 3, "{:?}", sink.sequences);
    assert!(sink.sequences[1] >= 8, "{:?}", sink.sequences);
    assert_eq!(outcome.report.drops.queue, 10 - sink.sequences.len() as u64);
}

#[test]
fn a_source_error_keeps_what_was_written() {
    for threads in [1, 4] {
        let mut source = MockSource::frames(7);
        source.script.push(Event::Error);
        source.script.push(Event::Frame);
        let (outcome, sequences, _) = plain(&mut source, threads);
        assert_eq!(sequences, (0..7).collect::<Vec<_>>());
        let error = outcome.result.unwrap_err();
        assert!(matches!(error, PipelineError::Source(_)), "{error}");
    }
}

#[test]
fn a_panic_reaches_the_caller_from_every_stage() {
    for threads in [1, 4] {
        for (stage, written) in [(Stage::Capture, 5), (Stage::Model, 5), (Stage::Encode, 5)] {
            let mut source = MockSource::frames(if stage == Stage::Capture { 5 } else { 40 });
            if stage == Stage::Capture {
                source.script.push(Event::Panic);
            }
            let at = |s| (s == stage).then_some(5);
            let mut model = MockModel {
                panic_at: at(Stage::Model),
                ..MockModel::default()
            };
            let mut encode = MockEncode {
                panic_at: at(Stage::Encode),
                ..MockEncode::default()
            };
            let mut sink = MockSink::default();
            let outcome = run_mocks(
                &mut source,
                &mut model,
                &mut encode,
                &mut sink,
                &options(threads),
                &FakeClock::default(),
            );
            match outcome.result {
                Err(PipelineError::Panic {
                    stage: got,
                    message,
                }) => {
                    assert_eq!(got, stage);
                    assert!(message.contains("told to panic"), "{message}");
                }
                other => panic!("{stage:?}, {threads} threads: {other:?}"),
            }
            assert_eq!(sink.sequences, (0..written).collect::<Vec<u64>>());
        }
    }
}

#[test]
fn a_stage_error_names_the_frame() {
    let mut model = MockModel {
        fail_at: Some(3),
        ..MockModel::default()
    };
    let mut sink = MockSink::default();
    let outcome = run_mocks(
        &mut MockSource::frames(10),
        &mut model,
        &mut MockEncode::default(),
        &mut sink,
        &options(4),
        &FakeClock::default(),
    );
    let text = outcome.result.unwrap_err().to_string();
    assert!(text.contains("frame 3") && text.contains("model"), "{text}");
    assert_eq!(sink.sequences, [0, 1, 2]);
    assert!(outcome.report.drops.failed >= 1);
}

#[test]
fn a_failed_sink_stops_everything_and_is_told_apart_from_a_closed_pipe() {
    for threads in [1, 4] {
        let mut sink = MockSink {
            fail_at: Some(4),
            ..MockSink::default()
        };
        let mut source = MockSource::frames(100_000);
        let outcome = run_mocks(
            &mut source,
            &mut MockModel::default(),
            &mut MockEncode::default(),
            &mut sink,
            &options(threads),
            &FakeClock::default(),
        );
        assert_eq!(sink.sequences, [0, 1, 2, 3]);
        assert!(source.at < 100, "the source went on to {}", source.at);
        let error = outcome.result.unwrap_err();
        assert!(error.is_broken_pipe(), "{error}");
        assert_eq!(outcome.report.drops.sink, source.at as u64 - 4);
    }
    let other = PipelineError::Sink("disk full".into());
    assert!(!other.is_broken_pipe());
}

#[test]
fn a_stop_writes_what_is_under_way() {
    for threads in [1, 4] {
        let stop = AtomicBool::new(false);
        let mut source = MockSource::frames(100_000);
        let mut sink = MockSink {
            after: Some(Box::new(|n| {
                if n == 20 {
                    stop.store(true, Ordering::SeqCst);
                }
            })),
            ..MockSink::default()
        };
        let stages = Stages {
            source: &mut source,
            color: None,
            model: &mut MockModel::default(),
            encode: &mut MockEncode::default(),
            sink: &mut sink,
            trace: None,
            start: None,
        };
        let outcome = run(stages, &options(threads), &Monotonic, &stop, &mut |_| ());
        outcome.result.unwrap();
        assert_eq!(outcome.report.drops.total(), 0);
        assert_eq!(
            sink.sequences.len(),
            source.at,
            "all taken frames are written"
        );
        assert!(
            source.at <= 21 + IN_STAGES + 2 * HANDED_OVER + WAITING,
            "{} frames taken",
            source.at
        );
    }
}

#[test]
fn limits_count_frames_and_frame_time() {
    let limited = |frames, duration| {
        let mut sink = MockSink::default();
        let options = Options {
            frames,
            duration,
            ..options(4)
        };
        run_mocks(
            &mut MockSource::frames(50),
            &mut MockModel::default(),
            &mut MockEncode::default(),
            &mut sink,
            &options,
            &FakeClock::default(),
        );
        sink.sequences.len()
    };
    assert_eq!(limited(Some(5), None), 5);
    assert_eq!(limited(None, Some(Duration::from_millis(200))), 20);
    assert_eq!(limited(Some(0), None), 0);
}

#[test]
fn degrade_cuts_the_model_at_the_deadline_and_recovers() {
    let clock = FakeClock::default();
    let mut model = MockModel {
        work: Some(Box::new(|n, deadline: &dyn Fn() -> bool| {
            // ten slices of 1 ms; from frame 10 to 19 a hundred
            for _ in 0..if (10..20).contains(&n) { 100 } else { 10 } {
                if deadline() {
                    return true;
                }
                clock.advance(1_000_000);
            }
            false
        })),
        ..MockModel::default()
    };
    let mut source = MockSource::frames(40);
    source.period_ns = 20_000_000;
    let options = Options {
        pace: Pace::Realtime,
        budget: Budget {
            limit: Duration::from_millis(20),
            late: Late::Degrade,
        },
        ..options(1)
    };
    let outcome = run_mocks(
        &mut source,
        &mut model,
        &mut MockEncode::default(),
        &mut MockSink::default(),
        &options,
        &clock,
    );
    assert_eq!(outcome.report.degraded, 10);
    assert_eq!(outcome.report.drops.total(), 0);
    assert_eq!(outcome.report.late, 0, "{:?}", outcome.report.age_ms);
    // the histogram is within 1 %
    assert!(
        outcome.report.age_ms.max <= 20.2,
        "{:?}",
        outcome.report.age_ms
    );
}

#[test]
fn drop_gives_late_frames_up_and_counts_them() {
    let clock = FakeClock::default();
    let mut model = MockModel {
        work: Some(Box::new(|n, _| {
            clock.advance(if n < 5 { 100_000_000 } else { 1_000_000 });
            false
        })),
        ..MockModel::default()
    };
    let mut sink = MockSink::default();
    let options = Options {
        budget: Budget {
            limit: Duration::from_millis(20),
            late: Late::Drop,
        },
        ..options(1)
    };
    let outcome = run_mocks(
        &mut MockSource::frames(100),
        &mut model,
        &mut MockEncode::default(),
        &mut sink,
        &options,
        &clock,
    );
    let report = outcome.report;
    assert!(report.drops.budget > 0 && report.frames > 50, "{report:?}");
    assert_eq!(report.late, 0, "nothing late is written");
    assert_eq!(sink.sequences.last(), Some(&99), "the policy recovers");
}

#[test]
fn colour_reaches_the_sink_and_its_end_does_not_end_depth() {
    for threads in [1, 4] {
        let mut sink = MockSink::default();
        let mut color = MockColor { left: 3 };
        let stop = AtomicBool::new(false);
        let stages = Stages {
            source: &mut MockSource::frames(50),
            color: Some(&mut color),
            model: &mut MockModel::default(),
            encode: &mut MockEncode::default(),
            sink: &mut sink,
            trace: None,
            start: None,
        };
        let outcome = run(stages, &options(threads), &Monotonic, &stop, &mut |_| ());
        outcome.result.unwrap();
        assert_eq!(outcome.report.frames, 50);
        // depth may end before the colour thread begins; what it read is written
        assert_eq!(outcome.report.color_frames, sink.colors.len() as u64);
        assert_eq!(sink.colors.len() as u32, 3 - color.left);
        if color.left == 0 {
            assert_eq!(sink.colors, [vec![2], vec![1], vec![0]]);
        }
    }
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        8 => Just(Event::Frame),
        1 => (1u64..4).prop_map(Event::Gap),
        1 => Just(Event::Damaged),
        1 => Just(Event::Stall),
        1 => Just(Event::Waiting),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Random faults everywhere: the sum balances against the script, and the pipeline ends.
    #[test]
    fn every_sensor_frame_is_written_or_counted(
        script in proptest::collection::vec(event(), 0..80),
        model_fails in proptest::option::weighted(0.2, 0u64..80),
        encode_panics in proptest::option::weighted(0.2, 0u64..80),
        sink_fails in proptest::option::weighted(0.2, 0u64..80),
        pace in prop_oneof![Just(Pace::Block), Just(Pace::Live)],
        threads in prop_oneof![Just(1usize), Just(3)],
        slow in any::<bool>(),
    ) {
        let mut source = MockSource::new(script.clone());
        let clock = FakeClock::default();
        let mut model = MockModel {
            fail_at: model_fails,
            work: slow.then(|| Box::new(|n: u64, _: &dyn Fn() -> bool| {
                clock.advance(if n.is_multiple_of(7) { 50_000_000 } else { 1_000_000 });
                false
            }) as Work<'_>),
            ..MockModel::default()
        };
        let mut encode = MockEncode { panic_at: encode_panics, ..MockEncode::default() };
        let mut sink = MockSink { fail_at: sink_fails, ..MockSink::default() };
        let options = Options {
            pace,
            budget: Budget { limit: Duration::from_millis(20), late: Late::Drop },
            ..options(threads)
        };
        let outcome = run_mocks(&mut source, &mut model, &mut encode, &mut sink, &options, &clock);
        // what the sensor made, up to where the source was asked
        let made: u64 = script[..source.at].iter().map(|event| match event {
            Event::Frame | Event::Damaged | Event::Stall => 1,
            Event::Gap(n) => *n,
            _ => 0,
        }).sum();
        prop_assert_eq!(outcome.report.sensor_frames, made);
        prop_assert_eq!(made, sink.sequences.len() as u64 + outcome.report.drops.total());
        if outcome.result.is_ok() {
            prop_assert_eq!(source.at, script.len());
            prop_assert_eq!(outcome.report.drops.sink + outcome.report.drops.failed, 0);
        }
    }
}
